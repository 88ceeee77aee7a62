"""What the user can ask of a training; all are posted to the `Core`, as `viewer.window.actions` are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .. import camera_list
from ..core import Core
from .watching import Training


def training_of(core: Core) -> Training | None:
    """The training in this window; says so where there is none."""
    if core.training is None:
        core.tell("Nothing is being trained: start with splatview train CAPTURE")
    return core.training


def pause_or_resume(core: Core) -> None:
    training = training_of(core)
    if training is None:
        return
    if training.status.state == "training":
        training.thread.pause()
    else:
        training.thread.resume()


def step_once(core: Core) -> None:
    if training := training_of(core):
        training.thread.step_once()


def stop_and_save(core: Core) -> None:
    if training := training_of(core):
        training.thread.stop()


def save_checkpoint(core: Core) -> None:
    if training := training_of(core):
        training.thread.save_checkpoint()


def evaluate(core: Core) -> None:
    if training := training_of(core):
        training.thread.evaluate()


def export(core: Core) -> None:
    """Asks where, and writes the scene as it stands then."""
    training = training_of(core)
    if training is None:
        return
    proposal = training.thread.outputs.scene
    core.choose_files(
        "Export the scene",
        lambda paths: training.thread.export(Path(paths[0])),
        kind="save_scene",
        name=f"{proposal.stem}-{training.status.iteration}.ply",
    )


def change_settings(core: Core, **settings: Any) -> None:
    if training := training_of(core):
        training.thread.change(**settings)


def show_training(core: Core) -> None:
    """Back from something else that was opened."""
    if training := training_of(core):
        training.follow(core)


def show_now(core: Core) -> None:
    if training := training_of(core):
        training.thread.show_now()


def compare_photo(core: Core, index: int) -> None:
    """Compares photo `index`, counted round the list; the view stays."""
    if core.training is not None:
        core.training.photo_index = index % len(core.training.photos)


def go_to_photo(core: Core, index: int) -> None:
    """Looks from where photo `index` was taken, and compares it."""
    training = core.training
    if training is None:
        return
    compare_photo(core, index)
    core.cameras = training.cameras
    camera_list.go_to_camera(core, index)
