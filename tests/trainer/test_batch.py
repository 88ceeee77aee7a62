"""Photos of a step: how many there are, and more of them while splats grow."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from splatview.scene.captures import load_capture
from splatview.trainer import setup
from splatview.trainer.adam_kernels import FEWEST_FOR_FAST
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.photo_size import (
    GROWTH_BATCH,
    automatic_batch,
    automatic_growth_batch,
    automatic_levels,
    steps_of_a_minute,
)
from splatview.trainer.recipe import FEW_PHOTOS, GROWTH_BATCH_FROM
from splatview.trainer.setup import settings_for
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainViews, train_views

from .conftest import whole_and_resumed


def test_photos_of_a_step_are_as_many_as_there_is_time_for(capture_folder) -> None:
    minutes = (None, 0.1, 1, 3, 7, 10, 1e6)
    assert [automatic_batch(m, None, 2) for m in minutes] == [1, 1, 1, 2, 2, 4, 4]
    assert [automatic_batch(m, None, 2, everywhere=False) for m in minutes] == [1, 1, 1, 2, 2, 2, 2]
    assert [automatic_batch(3, None, threads) for threads in (1, 2, 8, 64)] == [1, 2, 4, 4]
    assert automatic_batch(10, 6_000, 2) == 1
    levels = automatic_levels([(800, 800)], 3, 2)
    assert automatic_batch(3, None, 2, steps_of_a_minute(800 * 800, levels)) == 1
    assert (
        automatic_batch(3, None, 2, steps_of_a_minute(200 * 200, automatic_levels([(200, 200)], 3, 2))) == 2
    )
    capture = load_capture(capture_folder)
    few = train_views(capture.train)
    many = TrainViews(few * (-(-FEW_PHOTOS // len(few))), 0)
    assert settings_for(capture, many, minutes=10, threads=2).batch == 2
    assert settings_for(capture, many, minutes=10, threads=2, batch=3).batch == 3
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setup, "find_backdrop", lambda views: None)
        assert settings_for(capture, many, minutes=10, threads=2).batch == 4, "they show something everywhere"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TrainViews, "pixel_count", 400_000 * len(many))
        levels = ((0.9, 4),)
        taken = [settings_for(capture, many, minutes=4, threads=2, resolution=r).batch for r in (levels, ())]
    assert taken == [2, 1], "by how long photos are smaller"
    assert settings_for(capture, many, minutes=10, iterations=100, threads=2).batch == 1
    assert settings_for(capture, TrainViews(few, 0), minutes=10, threads=2).batch == 1


def test_more_photos_of_a_step_while_splats_grow_where_minutes_end_the_run(capture_folder) -> None:
    minutes = (None, 0.1, 1, 3, 10, 1e6)
    assert [automatic_growth_batch(m, None, 2) for m in minutes] == [1, 1, 1, 4, 4, 4]
    assert [automatic_growth_batch(m, 28_000, 2) for m in minutes] == [1, 1, 1, 4, 1, 1], "steps end it"
    assert [automatic_growth_batch(1, None, threads) for threads in (2, 4)] == [1, 4]
    assert automatic_growth_batch(3, None, 2, everywhere=False) == 1
    assert automatic_growth_batch(3, None, 2, photos=FEWEST_FOR_FAST - 1) == 1
    assert automatic_growth_batch(3, None, 2, steps_of_a_minute(12e6, ())) == 1
    capture = load_capture(capture_folder)
    few = train_views(capture.train)
    many = TrainViews(few * (-(-FEW_PHOTOS // len(few))), 0)
    assert settings_for(capture, many, minutes=3, threads=2).growth_batch == 1, "they show an object"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setup, "find_backdrop", lambda views: None)
        assert settings_for(capture, many, minutes=3, threads=2).growth_batch == GROWTH_BATCH
        assert settings_for(capture, many, minutes=3, threads=2, batch=2).growth_batch == 1, "as asked for"
        assert settings_for(capture, many, minutes=3, iterations=9_000, threads=2).growth_batch == 1


@pytest.mark.parametrize(("loss", "more"), [(0.0, 3), (math.inf, 1)])
def test_photos_of_a_step_are_more_while_splats_grow_if_they_are_not_met(make_trainer, loss, more) -> None:
    trainer = make_trainer(iterations=60, refine_until=0.5, growth_batch=3, growth_loss=loss)
    trainer.resolution.factor_at = lambda progress: 1
    places, looked = [], trainer.views.at
    trainer.views.at = lambda place, factor=1: places.append(place) or looked(place, factor)
    found = []
    while not trainer.done:
        before, batch = trainer.counters.photos, trainer.batch
        at = trainer.scene_progress
        trainer.step()
        found.append((at, trainer.counters.photos - before))
        if at != pytest.approx(GROWTH_BATCH_FROM):  # the step that decides
            assert trainer.counters.photos - before == batch
    for at, photos in found:
        grows = GROWTH_BATCH_FROM - 1e-9 <= at < 0.5
        assert photos == (more if grows else 1), at
    count = trainer.counters.photos
    assert count == sum(photos for _, photos in found)
    assert set(places) == set(range(count)), "each photo in its turn"


def test_a_run_with_more_photos_while_splats_grow_goes_on_bit_for_bit(make_trainer, tmp_path: Path) -> None:
    def another() -> Trainer:
        return make_trainer(iterations=140, refine_until=0.5, growth_batch=3, growth_loss=0.0)

    path = tmp_path / "run.safetensors"
    whole, resumed = whole_and_resumed(another, path)  # it is saved while they grow, and grows until step 70
    assert load_checkpoint(path).counters.photos == 7 + 33 * 3
    assert whole.counters.photos == resumed.counters.photos == 7 + 63 * 3 + 20
    assert whole.batch == resumed.batch == 1


def test_checkpoints_from_before_photos_were_counted_go_on(make_trainer, tmp_path: Path) -> None:
    path = tmp_path / "run.safetensors"
    whole, part = make_trainer(batch=2), make_trainer(batch=2)
    for _ in range(20):
        whole.step()
        part.step()
    save_checkpoint(part, path)
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata()
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 not a dict
    description = json.loads(metadata["run"])
    assert description["counters"].pop("photos") == 40
    save_file(arrays, path, metadata | {"run": json.dumps(description)})
    resumed = make_trainer(batch=2)
    restore(resumed, load_checkpoint(path))
    for trainer in (whole, resumed):
        for _ in range(5):
            trainer.step()
    assert resumed.counters.photos == 50
    for ours, theirs in zip(resumed.splats.arrays, whole.splats.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)
