"""The size of photos that a run trains in: as long as smaller ones teach."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.scene import Camera
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.progressive import (
    LATEST,
    ROUND_PHOTOS,
    ProgressiveResolution,
    detail_lost,
    mean_difference,
)
from splatview.trainer.views import TrainView, TrainViews

SIZE = 256


def view_of(pixels: np.ndarray, name: str = "a.png") -> TrainView:
    height, width = pixels.shape[:2]
    camera = Camera(
        width=width, height=height, fx=200.0, fy=200.0, cx=width / 2, cy=height / 2, world_to_camera=np.eye(4)
    )
    return TrainView(replace(camera, name=name), pixels)


def stripes(period: int) -> np.ndarray:
    """Vertical stripes, black and white."""
    row = (np.arange(SIZE) // (period // 2) % 2 * 255).astype(np.uint8)
    return np.repeat(np.repeat(row[None, :, None], SIZE, 0), 3, 2).copy()


def test_fine_detail_is_lost_and_smooth_pictures_lose_none() -> None:
    ramp = np.repeat(np.repeat(np.arange(SIZE, dtype=np.uint8)[None, :, None], SIZE, 0), 3, 2).copy()
    # Stripes of a pixel become grey: half of white is wrong everywhere.
    assert detail_lost([view_of(stripes(2))], 2) == pytest.approx(0.5, abs=0.01)
    assert detail_lost([view_of(ramp)], 2) < 0.005
    assert detail_lost([view_of(stripes(32))], 4) > detail_lost([view_of(stripes(32))], 2) > 0.01
    nothing = replace(view_of(stripes(2)), mask=np.zeros((SIZE, SIZE), bool))
    assert detail_lost([nothing], 2) == 0.0


@pytest.mark.parametrize(("period", "rounds"), [(2, (1, 2)), (64, (11, 13))])
def test_a_size_is_left_once_it_has_nothing_to_teach(period: int, rounds: tuple[int, int]) -> None:
    """A scene that becomes better by a quarter a round: early where much detail waits, late where not."""
    resolution = ProgressiveResolution(TrainViews([view_of(stripes(period))], 0))
    assert resolution.factor_at(0.0) == 4
    difference, left = 0.4, []
    for number in range(1, 30):
        before = resolution.level
        resolution.note(difference, ROUND_PHOTOS)
        left += [number] * (resolution.level - before)
        difference *= 0.75
    assert tuple(left) == rounds
    assert resolution.factor_at(0.1) == 1


def test_a_size_is_left_where_nothing_becomes_better() -> None:
    resolution = ProgressiveResolution(TrainViews([view_of(np.full((SIZE, SIZE, 3), 9, np.uint8))], 0))
    for _ in range(2):
        resolution.note(0.3, ROUND_PHOTOS)
    assert resolution.factor_at(0.1) == 2
    # A difference that is no number does not keep a run in small photos.
    resolution.note(float("nan"), ROUND_PHOTOS)
    assert resolution.factor_at(0.1) == 1


def test_small_photos_begin_in_full_size_and_full_size_comes_at_the_latest() -> None:
    small = ProgressiveResolution(TrainViews([view_of(stripes(8)[:100, :100].copy())], 0))
    assert small.factor_at(0.0) == 1
    large = ProgressiveResolution(TrainViews([view_of(stripes(8))], 0))
    assert (large.factor_at(0.0), large.factor_at(LATEST)) == (4, 1)


def test_differences_are_means_over_what_counts() -> None:
    photo = np.full((12, 12, 3), 51, np.uint8)
    image = np.zeros((12, 12, 4), np.float32)
    assert mean_difference(image, photo, None) == pytest.approx(0.2, abs=1e-6)
    image[:, 6:, :3] = 0.2
    mask = np.arange(12)[None, :].repeat(12, 0) < 6
    assert mean_difference(image, photo, mask) == pytest.approx(0.2, abs=1e-6)
    assert mean_difference(image, photo, np.zeros((12, 12), bool)) == 0.0


def test_a_resumed_run_goes_on_in_the_same_size(make_trainer, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("splatview.trainer.progressive.SMALLEST_SIDE", 15)
    trainer = make_trainer(iterations=400, resolution=None)
    assert trainer.downscale == 2
    while trainer.counters.iteration < 130:
        trainer.step()
    save_checkpoint(trainer, tmp_path / "c.safetensors")
    resumed = make_trainer(iterations=400, resolution=None)
    restore(resumed, load_checkpoint(tmp_path / "c.safetensors"))
    sizes = []
    for _ in range(100):
        for one in (trainer, resumed):
            one.step()
        assert trainer.downscale == resumed.downscale
        sizes.append(trainer.downscale)
    for ours, theirs in zip(trainer.splats.arrays, resumed.splats.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert sizes[-1] == 1
