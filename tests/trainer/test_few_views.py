"""Splats that few photos can show stop learning; those that others show, and runs on few photos, do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.raster import Parameters
from splatview.scene import Lens, look_at
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.free_space import FEW_OF, in_picture, shown_by_few
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews

Make = Callable[..., Trainer]


def test_places_are_counted_by_the_pictures_that_have_them(rng: np.random.Generator) -> None:
    lens = Lens(model="SIMPLE_RADIAL", parameters=(-0.1,))
    cameras = [
        replace(look_at(eye, (0, 0, 0), width=40, height=30, fov_y=35), lens=lens if number % 2 else None)
        for number, eye in enumerate(rng.normal(0, 3, (7, 3)))
    ]
    places = np.concatenate([rng.normal(0, 2, (500, 3)), [[np.nan] * 3]])
    counts = np.sum([in_picture(places, camera) for camera in cameras], axis=0)
    assert counts.max() == 7 and counts.min() == 0
    for few in (0, 1, 3):
        assert np.array_equal(shown_by_few(places, cameras, few), counts <= few)
    assert shown_by_few(places, [], 2).all()


@pytest.fixture
def aside(views: list[TrainView], start: Parameters, rng: np.random.Generator) -> Parameters:
    """The start with its first splat where one photo alone shows it."""
    scene = Parameters(*(array.copy() for array in start))
    cameras = [view.camera for view in views[1:]]
    places = rng.uniform(-3, 3, (5000, 3))
    by_one = shown_by_few(places, cameras, 1) & ~shown_by_few(places, cameras, 0)
    far = np.min([np.linalg.norm(places - camera.eye, axis=1) for camera in cameras], axis=0) > 0.5
    scene.means[0] = places[by_one & far][0]
    scene.log_scales[0], scene.opacity_logits[0] = -2.5, 1.0
    return scene


def run(trainer: Trainer, views: list[TrainView], scene: Parameters, **settings) -> Trainer:
    """Its settings with others, on a scene and all photos but the first, to the end."""
    base = replace(trainer.settings, free_space=0.0, least_shown=0.0, least_visibility=0.0, most_of_one=1.0)
    made = Trainer(TrainViews(views[1:], 0), scene, 3.0, replace(base, **settings))
    while not made.done:
        made.step()
    return made


def moved(trainer: Trainer, scene: Parameters) -> np.ndarray:
    return np.abs(trainer.splats.arrays.sh[:, 0] - scene.sh[:, 0]).max(axis=1)


@pytest.mark.parametrize("visible_only", [True, False])
def test_what_few_photos_show_stops_learning(
    views: list[TrainView], aside: Parameters, make_trainer: Make, visible_only: bool
) -> None:
    given = {"iterations": 24, "strategy": "classic", "refine_from": 1.0, "visible_only": visible_only}
    frozen = run(make_trainer(), views, aside, few_views=1, few_views_rounds=0, **given)
    assert frozen.state["frozen"][0] and not frozen.state["frozen"].all()
    change = moved(frozen, aside)
    assert change[0] == 0
    assert (change[~frozen.state["frozen"]] > 0).mean() > 0.9
    free = run(make_trainer(), views, aside, few_views=0, **given)
    assert moved(free, aside)[0] > 0
    assert "frozen" not in free.state
    late = run(make_trainer(), views, aside, few_views=1, few_views_rounds=1, **given)
    assert moved(late, aside)[0] > 0


def test_a_run_on_few_photos_freezes_nothing(
    views: list[TrainView], aside: Parameters, make_trainer: Make
) -> None:
    enough = (len(views) - 1) // FEW_OF
    trainer = run(make_trainer(), views, aside, iterations=6, few_views=enough + 1, few_views_rounds=0)
    assert "frozen" not in trainer.state


def test_a_resumed_run_freezes_the_same(
    views: list[TrainView], aside: Parameters, make_trainer: Make, tmp_path: Path
) -> None:
    settings = replace(make_trainer().settings, iterations=12, few_views=1, few_views_rounds=0)
    trainers = [Trainer(TrainViews(views[1:], 0), aside, 3.0, settings) for _ in range(2)]
    for _ in range(5):
        trainers[0].step()
    save_checkpoint(trainers[0], tmp_path / "run.ckpt")
    restore(trainers[1], load_checkpoint(tmp_path / "run.ckpt"))
    assert np.array_equal(trainers[0].state["frozen"], trainers[1].state["frozen"])
    for trainer in trainers:
        while not trainer.done:
            trainer.step()
    for ours, theirs in zip(trainers[0].splats.arrays, trainers[1].splats.arrays, strict=True):
        assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("wrong", [{"few_views": -1}, {"few_views_rounds": -1}, {"few_views_rounds": np.nan}])
def test_settings_that_make_no_sense(make_trainer: Make, wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        replace(make_trainer().settings, **wrong)
