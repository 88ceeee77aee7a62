"""Starting a training from the window: what a folder of photos holds, the length and size asked for, and the
run that is readied beside the frame loop. No ImGui in here."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, Protocol, get_args

from splatview.raster.compiling import available_threads
from splatview.scene import InputError
from splatview.scene.captures import read_poses
from splatview.scene.captures.capture import MaskUse
from splatview.scene.captures.photos import downscaled_size
from splatview.scene.captures.points import MIN_POINTS
from splatview.scene.errors import parse_bytes
from splatview.scene.formats.sequence import NERF
from splatview.scene.formats.sequence import is_capture as holds_capture
from splatview.scene.progress import Cancelled, Progress
from splatview.trainer.memory import (
    Bound,
    Machine,
    MemoryPlan,
    PhotoSizes,
    begins_by_stereo,
    check_fits,
    plan,
    run_memory,
    sizes_of_files,
)
from splatview.trainer.photo_size import automatic_batch, automatic_growth_batch, downscale_for
from splatview.trainer.recipe import LEAST_LIMIT, automatic_limit, automatic_steps, most_scenes
from splatview.trainer.settings import TrainSettings
from splatview.viewer import open as opening
from splatview.viewer.camera import CameraLists
from splatview.viewer.editing.session import Editing
from splatview.viewer.loading import EMPTY_SCENE
from splatview.viewer.platform import give_way
from splatview.viewer.preferences import with_recent
from splatview.viewer.save import next_free
from splatview.viewer.state import AppState, Feature
from splatview.viewer.tasks import Task
from splatview.viewer.training.live import LiveTraining

NO_TORCH = "Training needs PyTorch, which is not installed: pip install 'splatview[train]'"

Length = Literal["1 minute", "3 minutes", "10 minutes", "30 minutes", "Best quality"]

LENGTHS: dict[Length, tuple[str, ...]] = {
    "1 minute": ("--minutes", "1"),
    "3 minutes": ("--minutes", "3"),
    "10 minutes": ("--minutes", "10"),
    "30 minutes": ("--minutes", "30"),
    "Best quality": (),
}
"""Options of `splatview train` for each length; the last is the whole recipe, however long it takes."""

AUTOMATIC = "What is free"

MEMORIES = (AUTOMATIC, "1 GB", "2 GB", "4 GB", "8 GB", "16 GB", "32 GB", "64 GB")
"""Bounds to choose from; the first is what the machine has left."""

BACKGROUNDS = {"auto": "auto", "black": "0,0,0", "white": "1,1,1"}
"""What may be behind the scene, and how `splatview train --background` has it."""

WHETHER = ("auto", "on", "off")
"""What can be asked for of a correction: auto looks at the photos."""

OUTLIERS = ("auto", "off")
"""The same of photos that disagree with the others."""

MASKS = get_args(MaskUse)
"""What masks of photos may mean, the first unless the user says otherwise."""

PASSING = ("auto", "stay")
"""The same of splats that one photo alone shows in front of what others do."""

DOWNSCALES = (1, 2, 4, 8)
"""What photos may be made smaller by each way, where the user wants something else than what time allows."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """What a folder holds, before its photos are read."""

    folder: Path
    """The folder, or the .json file that was named."""
    photos: tuple[Path, ...]
    size: tuple[int, int]
    """Width and height in px of the largest photo."""
    missing: int
    """Photos with a pose that are not there."""
    points: int
    """Points that the capture gives to begin with."""
    masks: int
    """Photos that come with a mask of their own."""
    automatic: dict[Length, int]
    """By what photos are made smaller each way unless the user says otherwise, for each length of a run."""
    sizes: dict[int, PhotoSizes]
    """By each of DOWNSCALES and of `automatic`."""


def look_through(folder: Path, progress: Progress) -> Found:
    """Raises InputError where `folder` is no capture."""
    _, posed = read_poses(folder, progress)
    threads = available_threads()
    automatic: dict[Length, int] = {
        length: downscale_for(posed, minutes=float(given[1]) if given else None, threads=threads)
        for length, given in LENGTHS.items()
    }
    largest = max((entry.camera for entry in posed.entries), key=lambda camera: camera.width * camera.height)
    return Found(
        folder=folder,
        photos=tuple(entry.path for entry in sorted(posed.entries, key=lambda entry: entry.name)),
        size=(largest.width, largest.height),
        missing=len(posed.missing),
        points=len(posed.points),
        masks=sum(entry.mask is not None for entry in posed.entries),
        automatic=automatic,
        sizes={
            factor: sizes_of_files(posed.entries, factor) for factor in {*DOWNSCALES, *automatic.values()}
        },
    )


def is_capture(path: Path) -> bool:
    """Whether `path` is a folder, or a transforms file, that may hold photos with their cameras, by its
    names alone."""
    if os.path.isdir(path):  # not is_dir: that raises where a name is too long, or locked
        return holds_capture(path)
    return path.name in NERF and os.path.isfile(path)


@dataclass(frozen=True, eq=False, kw_only=True)
class StartedTraining:
    """A training that is ready for its first step."""

    training: LiveTraining
    notes: tuple[str, ...]
    """What was found out on the way, lines for the user."""
    finish: Callable[[], None]
    """Ends it, saves what was trained and says where, on standard error."""


class Starter(Protocol):
    """Readies what `splatview train ARGUMENTS` would train. The window is given one, as it may not know of
    commands.

    Raises:
        InputError: the user asked for something that cannot be.
        Cancelled: `report` raised it.
    """

    def __call__(self, arguments: Sequence[str], report: Callable[[str], None]) -> StartedTraining: ...


@dataclass(kw_only=True)
class TrainingForm:
    """What the user has chosen."""

    length: Length = "3 minutes"
    downscale: int | None = None
    """One of DOWNSCALES; None: by the length."""
    memory: str = AUTOMATIC
    """One of MEMORIES."""
    masks: str = MASKS[0]
    """One of MASKS, where there are any."""
    exposure: str = WHETHER[0]
    """One of WHETHER, as `shading` and `sky` are."""
    shading: str = WHETHER[0]
    outliers: str = OUTLIERS[0]
    """One of OUTLIERS."""
    passing: str = PASSING[0]
    """One of PASSING."""
    sky: str = WHETHER[0]
    background: str = next(iter(BACKGROUNDS))
    """One of BACKGROUNDS."""
    output: Path = field(default_factory=Path)
    """File that will hold the scene."""


class TrainingStart(Feature):
    """The form of a new training, what is in its folder, and the run being readied."""

    def __init__(self) -> None:
        self.starter: Starter | None = None
        """Set by whoever opens the window; None: nothing can be trained from it."""
        self.wake: Callable[[], object] = lambda: None
        self.form = TrainingForm()
        self.folder: Path | None = None
        self.found: Found | None = None
        self.machine: Machine | None = None
        """What the machine had left when the folder was looked through."""
        self.problem = ""
        """Why the folder cannot be trained on, or training has not begun."""
        self.stage = ""
        """What is being done before the first step."""
        self.dropped: Path | None = None
        """Capture that was dropped and that the user is asked about."""
        self.started: list[StartedTraining] = []
        """Trainings of this window, the last in force."""
        self._looking: Task[Found] | None = None
        self._readying: Task[StartedTraining] | None = None

    @property
    def lacks(self) -> str:
        """Why nothing can be trained here; "" where it can."""
        if self.starter is None:
            return "This window was opened without training"
        return "" if find_spec("torch") else NO_TORCH

    @property
    def is_looking(self) -> bool:
        return self._looking is not None

    @property
    def is_readying(self) -> bool:
        return self._readying is not None

    def choose(self, folder: Path) -> None:
        """Looks through `folder`; through the one above where that is the capture, and `folder` but a part of
        it, such as its photos."""
        if not is_capture(folder):
            folder = next(
                (above for above in list(folder.absolute().parents)[:2] if is_capture(above)), folder
            )
        self.folder, self.found, self.problem = folder, None, ""
        if self._looking is not None:
            self._looking.cancel()
        self._looking = Task(
            lambda task: look_through(folder, Progress(cancelled=lambda: task.cancelled)),
            name="splatview-capture",
            on_done=self.wake,
        )

    def arguments(self) -> list[str]:
        """Those of `splatview train` for the form."""
        assert self.found is not None
        return [
            os.path.abspath(self.found.folder),
            *("-o", os.path.abspath(self.form.output)),
            *LENGTHS[self.form.length],
            *("--downscale", str(self.form.downscale or "auto")),
            *("--exposure", self.form.exposure, "--shading", self.form.shading, "--sky", self.form.sky),
            *("--outliers", self.form.outliers, "--passing", self.form.passing),
            *("--background", BACKGROUNDS[self.form.background]),
            *(("--masks", self.form.masks) if self.found.masks else ()),
            *(() if self.form.memory == AUTOMATIC else ("--memory", self.form.memory)),
        ]

    @property
    def downscale(self) -> int:
        """By what photos are made smaller each way, where memory has room for them."""
        assert self.found is not None
        return self.form.downscale or self.found.automatic[self.form.length]

    def planned_memory(self) -> MemoryPlan:
        """What the run of the form takes, by what is known before its photos are read: their opacity is not.

        Raises:
            InputError: it does not fit; the message says what to do.
        """
        assert self.found is not None and self.machine is not None
        form, length = self.form, LENGTHS[self.form.length]
        asked = None if form.memory == AUTOMATIC else parse_bytes(form.memory)
        bound = Bound(bytes=asked or self.machine.left, asked=asked is not None)
        sizes = self.found.sizes[self.downscale]
        points = self.found.points if self.found.points >= MIN_POINTS else 0
        minutes = float(length[1]) if length else None
        photos = round(len(self.found.photos) * sizes.trained / max(sizes.pixels, 1))
        steps = automatic_steps(photos)
        memory = run_memory(
            sizes,
            resolution=TrainSettings.resolution,
            batch=max(
                automatic_batch(minutes, steps, self.machine.threads),
                automatic_growth_batch(minutes, steps, self.machine.threads),
            ),
            stereo=begins_by_stereo(TrainSettings.start, points=points, pixels=sizes.largest),
            ensemble=1 if minutes is None else most_scenes(photos, minutes, self.machine.threads),
            machine=self.machine,
            window=True,
        )
        advice = "choose a smaller size, or {} of memory or more"
        check_fits(memory, bound, LEAST_LIMIT, f"These photos and {LEAST_LIMIT:,} splats", advice)
        # How much of the scene a photo shows is not known yet either: as many splats as there may be.
        return plan(memory, bound, automatic_limit(sizes.trained, minutes, steps, math.inf))

    def trained_size(self) -> tuple[int, int]:
        """Width and height of the largest photo as it is trained on, px."""
        assert self.found is not None
        return downscaled_size(*self.found.size, self.downscale)

    def start(self, app: AppState) -> None:
        """Readies the run of the form; the window goes on meanwhile. One that is under way is ended first,
        and what it has trained is saved."""
        starter, before = self.starter, self.started[-1] if self.started else None
        if starter is None or self.found is None or self._readying is not None or self.lacks:
            return
        arguments = self.arguments()
        self.problem, self.stage = "", "Loading the trainer"

        def work(task: Task[StartedTraining]) -> StartedTraining:
            def report(stage: str) -> None:
                if task.cancelled:
                    raise Cancelled
                self.stage = stage
                self.wake()

            if before is not None:
                report("Saving the training before")
                self.started.remove(before)
                before.finish()
            return starter(arguments, report)

        self._readying = Task(work, name="splatview-ready", on_done=self.wake)

    def before_frame(self, app: AppState) -> None:
        self._collect_found()
        task = self._readying
        if task is None or not task.done:
            return
        self._readying, self.stage = None, ""
        if task.cancelled or isinstance(task.error, Cancelled):
            if task.result is not None:
                task.result.finish()
            app.tell("Cancelled: nothing is trained")
        elif isinstance(task.error, InputError):
            self.problem = str(task.error)
        elif isinstance(task.error, ImportError):
            self.problem = NO_TORCH
        elif task.error is not None:
            self.problem = f"Training cannot begin: {type(task.error).__name__}: {task.error}"
        elif task.result is not None:
            app.post(adopt, task.result)

    def _collect_found(self) -> None:
        task = self._looking
        if task is None or not task.done:
            return
        self._looking = None
        if task.error is not None:
            known = isinstance(task.error, (InputError, Cancelled))
            self.problem = str(task.error) if known else f"{type(task.error).__name__}: {task.error}"
        elif task.result is not None:
            found = self.found = task.result
            self.machine = Machine.here()
            output = found.folder.absolute()
            folder = output.parent if os.access(output.parent, os.W_OK) else Path.cwd()
            stem = output.name if output.is_dir() else output.parent.name
            self.form.output = next_free(folder / f"{stem or 'scene'}.ply")
            self.form.downscale = None

    def busy(self, app: AppState) -> bool:
        return self._looking is not None or self._readying is not None

    def cancel(self, app: AppState) -> bool:
        if self._readying is None:
            return False
        self._readying.cancel()
        self.stage = "Cancelling; kernels that are being compiled are kept for the next time"
        return True

    def close(self, app: AppState) -> None:
        if self._readying is not None:
            self._readying.cancel()

    def finish(self) -> None:
        """Ends the training of this window, where there is one, and saves it: the window has closed."""
        if self.started:
            self.started[-1].finish()


def adopt(app: AppState, started: StartedTraining) -> None:
    """The window shows `started` from now on, and the first step is taken."""
    start = app.feature(TrainingStart)
    if (before := app.find(LiveTraining)) is not None:
        before.thread.stop()  # whoever began it ends it
        before.close(app)
    editing = app.feature(Editing)
    editing.close_session(app)
    opening.cancel_loading(app, quiet=True)
    # It comes first, as in a window that was opened for it.
    others = {kind: feature for kind, feature in app.features.items() if kind is not LiveTraining}
    app.features = {LiveTraining: started.training, **others}
    app.scene, app.dialog = EMPTY_SCENE, None
    app.page, app.strip = "Train", "Curves"
    app.bookmarks, app.bookmark_index = [], -1
    if start.folder is not None:
        app.preferences = with_recent(app.preferences, start.folder, "recent_photos")
    start.started.append(started)
    started.training.start(app, on_change=start.wake)
    give_way()  # the training's thread is there already, and keeps its priority
    for note in started.notes:
        app.tell(note)
    app.tell(
        f"Training {started.training.name}: the scene is saved to {started.training.thread.outputs.scene}"
    )


# Commands, to be posted.


def choose_photos(app: AppState) -> None:
    """Asks for a folder of photos and opens the form for it."""
    app.choose_files("Folder of the photos", lambda paths: app.post(open_form, paths[0]), kind="folder")


def choose_for_page(app: AppState) -> None:
    """The same for the form on the Train page."""
    app.choose_files("Folder of the photos", lambda paths: app.post(look_at, paths[0]), kind="folder")


def look_at(app: AppState, folder: Path) -> None:
    app.feature(TrainingStart).choose(folder)


def open_form(app: AppState, folder: Path) -> None:
    look_at(app, folder)
    app.dialog = "train"


def start_training(app: AppState) -> None:
    """Starts what the form says, after asking where the open scene has unsaved edits."""
    app.leave(app.feature(TrainingStart).start)


def choose_output(app: AppState) -> None:
    form = app.feature(TrainingStart).form

    def chosen(paths: list[Path]) -> None:
        form.output = paths[0] if paths[0].suffix else paths[0].with_suffix(".ply")

    app.choose_files("Save the trained scene as", chosen, kind="save_scene", name=form.output.name)


def open_dropped(app: AppState, paths: Sequence[Path]) -> None:
    """Opens what was dropped; of a capture it asks whether to train on it."""
    if len(paths) == 1 and is_capture(paths[0]):
        app.feature(TrainingStart).dropped = paths[0]
        app.dialog = "capture"
    else:
        opening.open_paths(app, paths)


def load_dropped_cameras(app: AppState) -> None:
    """Only the cameras of the dropped capture."""
    dropped, app.dialog = app.feature(TrainingStart).dropped, None
    if dropped is not None:
        app.feature(CameraLists).open(dropped)


def train_on_dropped(app: AppState) -> None:
    dropped = app.feature(TrainingStart).dropped
    if dropped is not None:
        open_form(app, dropped)
