"""Withheld blocks: what a run does without, what they tell, and that they are given back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import RenderSettings
from splatview.scene.effects.effect import Effect, Saving
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.effects import BLOCKS
from splatview.trainer.run import Outputs, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.setup import memory_of, settings_for
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews
from splatview.trainer.withheld import (
    CHECK_ROUNDS,
    COARSE_RISE,
    FULL_RISE,
    GIVEN_BACK,
    SETTLED,
    Withheld,
)

from .conftest import EXTENT, capture_of

SETTINGS = RenderSettings(background=(0.2, 0.2, 0.2))
make_settings: Any = TrainSettings


def trainer_of(views: list[TrainView], start: Parameters, **settings: Any) -> Trainer:
    options = {"iterations": 4000, "max_splats": 600, "background": (0.2, 0.2, 0.2), "withheld": 0.25}
    return Trainer(TrainViews(views, 0), start, EXTENT, make_settings(**options | settings), threads=2)


def after(trainer: Trainer, steps: int) -> Trainer:
    while not trainer.done and trainer.counters.iteration < steps:
        trainer.step()
    return trainer


def large(view: TrainView) -> TrainView:
    """The same of many pixels, whatever they show."""
    pixels = np.zeros((240, 320, 3), np.uint8)
    return TrainView(view.camera.resized(320, 240), pixels)


def test_blocks_are_the_share_that_was_asked_for_and_no_others_by_the_seed(views: list[TrainView]) -> None:
    photos = [large(view) for view in views[:5]]
    found = Withheld(photos, 0.06, 0)
    assert all(blocks.shape == (240, 320) for blocks in found.blocks)
    assert np.mean(found.blocks) == pytest.approx(0.06, abs=0.02)
    same, other = Withheld(photos, 0.06, 0), Withheld(photos, 0.06, 1)
    assert all(np.array_equal(a, b) for a, b in zip(found.blocks, same.blocks, strict=True))
    assert any(not np.array_equal(a, b) for a, b in zip(found.blocks, other.blocks, strict=True))
    assert not np.array_equal(found.blocks[0], found.blocks[1])


def test_none_are_given_back_from_the_start(views: list[TrainView]) -> None:
    nothing = Withheld(views, 0.0, 0)
    assert nothing.given_back and not nothing.blocks
    assert not any(nothing.is_due(looked, 1) for looked in range(2000))


def test_the_error_is_that_of_the_blocks(views: list[TrainView], start: Parameters) -> None:
    withheld = Withheld(views, 0.25, 0)
    drawn = [draw_frame(start, view.camera, SETTINGS, Workspace()).image[..., :3] for view in views]
    met = [
        replace(view, pixels=(np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8))
        for view, image in zip(views, drawn, strict=True)
    ]
    assert withheld.error(start, met, SETTINGS, None, 2) < 1e-5
    others = [
        replace(view, pixels=np.where(blocks[..., None], view.pixels, 255 - view.pixels))
        for view, blocks in zip(met, withheld.blocks, strict=True)
    ]
    assert withheld.error(start, others, SETTINGS, None, 2) < 1e-5
    off = [
        replace(view, pixels=np.where(view.pixels < 128, view.pixels + 51, view.pixels - 51).astype(np.uint8))
        for view in met
    ]
    assert withheld.error(start, off, SETTINGS, None, 2) == pytest.approx(0.04, rel=0.02)
    # At the exposure of each photo.
    offset = np.stack([np.zeros(3), np.full(3, 0.2)], axis=1)
    lighter = [
        replace(view, pixels=(np.clip(image + 0.2, 0, 1) * 255 + 0.5).astype(np.uint8))
        for view, image in zip(views, drawn, strict=True)
    ]
    assert withheld.error(start, lighter, SETTINGS, lambda _: offset, 2) < 1e-5
    masked = [replace(view, mask=~blocks) for view, blocks in zip(met, withheld.blocks, strict=True)]
    assert math.isnan(withheld.error(start, masked, SETTINGS, None, 2))


def test_steps_do_without_the_blocks_in_every_size_until_they_are_given_back(views: list[TrainView]) -> None:
    taken = TrainViews(views, 0)
    whole = [taken.at(step, factor) for factor in (1, 2) for step in range(len(views))]
    blocks = Withheld(views, 0.25, 0).blocks
    taken.withhold(blocks)
    of = {view.camera.name: part for view, part in zip(views, blocks, strict=True)}
    for factor in (1, 2, 1):
        for step in range(len(views)):
            view = taken.at(step, factor)
            assert view.mask is not None
            full = view.mask.repeat(factor, 0).repeat(factor, 1)
            assert not full[of[view.camera.name]].any()
            assert full.any()
    assert all(view.mask is None for view in taken.all)
    taken.withhold(None)
    again = [taken.at(step, factor) for factor in (1, 2) for step in range(len(views))]
    assert all(
        a.mask is None and np.array_equal(a.pixels, b.pixels) for a, b in zip(again, whole, strict=True)
    )


def test_a_stage_teaches_until_the_error_rises() -> None:
    withheld = Withheld([], 0.0, 0)
    assert withheld.teaches(0.02, 2) and withheld.teaches(0.01, 2)
    assert withheld.teaches(0.01 * COARSE_RISE * 0.999, 2) and not withheld.teaches(
        0.01 * COARSE_RISE * 1.001, 2
    )
    assert withheld.teaches(0.05, 1), "full size has hardly begun"
    assert withheld.teaches(0.01 * FULL_RISE * 0.999, 1) and not withheld.teaches(0.01 * FULL_RISE * 1.001, 1)
    assert withheld.teaches(math.nan, 1)


def test_what_is_withheld_cannot_be_changed_in_a_run(views: list[TrainView], start: Parameters) -> None:
    with pytest.raises(ValueError, match="withheld cannot be changed in a run"):
        trainer_of(views, start).change(withheld=0.0)


def test_a_run_that_learns_goes_on_and_gets_its_blocks_back(
    views: list[TrainView], start: Parameters
) -> None:
    trainer = after(trainer_of(views, start), int(4000 * GIVEN_BACK) + 2)
    assert trainer.withheld.given_back and not trainer.withheld.settled_at
    assert trainer.settings.iterations == 4000
    assert trainer.views.at(0).mask is None


def test_a_run_whose_photos_do_not_agree_settles(views: list[TrainView], start: Parameters) -> None:
    """Each shows noise of its own, in squares that splats can meet."""
    rng = np.random.default_rng(2)
    noise = [
        replace(view, pixels=rng.integers(0, 256, (10, 12, 3)).astype(np.uint8).repeat(4, 0).repeat(4, 1))
        for view in views
    ]
    trainer = after(trainer_of(noise, start, resolution=((0.3, 2),)), 4000)
    settled = trainer.withheld.settled_at
    assert 0 < settled < 4000 * GIVEN_BACK and settled % (CHECK_ROUNDS * len(views)) == 0
    assert trainer.settings.iterations == math.ceil(settled / SETTLED) == trainer.counters.iteration
    assert trainer.withheld.given_back and trainer.views.at(0).mask is None


def test_a_resumed_run_goes_on_alike(views: list[TrainView], start: Parameters, tmp_path: Path) -> None:
    steps = 2 * CHECK_ROUNDS * len(views) + 10
    trainer = after(trainer_of(views, start), steps)
    trainer.withheld.coarse_is_over = True
    save_checkpoint(trainer, tmp_path / "run.safetensors")
    checkpoint = load_checkpoint(tmp_path / "run.safetensors")
    other = trainer_of(views, start)
    restore(other, checkpoint)
    assert np.array_equal(other.withheld.state()["withheld"], trainer.withheld.state()["withheld"])
    assert other.withheld.least < math.inf and not other.withheld.given_back and other.downscale == 1
    for _ in range(20):
        trainer.step()
        other.step()
    assert np.array_equal(other.splats.arrays.means, trainer.splats.arrays.means)
    trainer.withheld.given_back = True
    trainer.views.withhold(None)
    save_checkpoint(trainer, tmp_path / "run.safetensors")
    restore(other, load_checkpoint(tmp_path / "run.safetensors"))
    assert other.withheld.given_back and other.views.at(0).mask is None


def test_only_who_asks_for_it_does_without(
    views: list[TrainView], points: tuple[np.ndarray, np.ndarray]
) -> None:
    capture, photos = capture_of(views, *points), TrainViews(views, 0)
    recipe: Callable[..., TrainSettings] = settings_for
    assert recipe(capture, photos, minutes=1.0).withheld == 0
    chosen = recipe(capture, photos, minutes=1.0, withheld=0.06)
    assert chosen.withheld == 0.06
    assert (
        memory_of(capture, chosen, photos).photos > memory_of(capture, recipe(capture, photos), photos).photos
    )
    for wrong in (math.nan, -0.1, 0.6):
        with pytest.raises(ValueError, match="withheld must be 0 to"):
            recipe(capture, photos, withheld=wrong)


def test_a_run_says_what_blocks_have_told(views: list[TrainView], start: Parameters, tmp_path: Path) -> None:
    trainer, notes = trainer_of(views, start), []
    effect = Effect(name=BLOCKS, on=True, why="6% of each photo", saving=Saving())
    outputs = Outputs(
        scene=tmp_path / "s.ply", checkpoint=tmp_path / "s.safetensors", metrics=None, pictures=tmp_path / "p"
    )
    run = TrainingRun(trainer, [], outputs, started=0.0, effects=(effect,), on_note=notes.append)
    trainer.withheld.settled_at = 1234
    trainer.counters.iteration = 3000
    run.step()
    assert "after 1,234 steps" in run.effects[0].why and run.effects[0].why.startswith("6% of each photo")
    assert any("ends after 4,000 steps; --iterations asks for more" in note for note in notes)
