"""What photos show of lenses, masks and transparency while they are read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import InputError, look_at
from splatview.scene.captures import load_capture
from splatview.scene.captures.capture import LEAST_DISPLACEMENT, largest_displacement
from splatview.scene.lens import COUNTS, Lens

CAMERA = look_at((0, 0, 0), (0, 0, 1), width=400, height=300, fov_y=50)
RADIAL = 3
"""COLMAP's number of a model with two radial coefficients."""


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV", "FULL_OPENCV", "RADIAL4", "THIN_PRISM_FISHEYE"])
def test_no_point_moves_farther_than_said(model, rng):
    """Denser by far than where it is looked for, and the other way round: what the lens's own pixels show."""
    x, y = np.meshgrid(np.linspace(0, 400, 331), np.linspace(0, 300, 251))
    pixels = np.stack([x, y], axis=-1)
    for strength in (1e-5, 1e-3, 3e-2):
        values = rng.normal(scale=strength, size=COUNTS[model])
        camera = replace(CAMERA, lens=Lens(model=model, parameters=tuple(values)))
        limit = largest_displacement(camera)
        rays = CAMERA.points_at(pixels, 1.0)
        assert np.linalg.norm(camera.image_points(rays) - pixels, axis=-1).max() <= limit
        if limit < 1:  # beyond, the two ways differ by more than the margin
            there = CAMERA.image_points(camera.points_at(pixels, 1.0))
            assert np.linalg.norm(there - pixels, axis=-1).max() <= 1.05 * limit


def test_a_pinhole_moves_nothing_and_a_lens_of_a_narrow_field_has_no_bound():
    assert largest_displacement(CAMERA) == 0
    folding = Lens(model="SIMPLE_RADIAL", parameters=(-3.0,))
    assert largest_displacement(replace(CAMERA, lens=folding)) == np.inf


@pytest.mark.parametrize(("k", "is_wrong"), [(0.1, False), (-0.1, False), (-40.0, True)])
def test_a_calibration_that_cannot_be_is_mentioned(k, is_wrong, tmp_path, colmap_capture):
    """A lens that turns back on itself within the photo, whatever is done about it."""
    colmap_capture(tmp_path, model=RADIAL, distortion=(k, 0.0))
    for use in ("through", "undistort"):
        warnings = [line for line in load_capture(tmp_path, lens=use).warnings if "calibration" in line]
        assert len(warnings) == is_wrong
        assert all(f"(RADIAL: {k:.4g}, 0)" in line for line in warnings)


def test_a_lens_that_shows_nothing_is_no_mask(tmp_path, colmap_capture):
    colmap_capture(tmp_path, model=RADIAL, distortion=(-3000.0, 0.0))
    with pytest.raises(InputError, match="of a photo is beyond what its lens"):
        load_capture(tmp_path)


def test_a_lens_that_does_not_show_is_left_out(tmp_path, colmap_capture):
    for name, k in (("weak", 1e-4), ("strong", 1e-2)):
        cameras = colmap_capture(tmp_path / name, model=RADIAL, distortion=(k, 0.0))
        lens = Lens(model="RADIAL", parameters=(k, 0.0))
        moved = max(largest_displacement(replace(camera, lens=lens)) for camera in cameras)
        capture = load_capture(tmp_path / name, lens="undistort")
        plain = colmap_capture(tmp_path / f"{name} pinhole") and load_capture(tmp_path / f"{name} pinhole")
        same = [
            np.array_equal(a.image(), b.image()) for a, b in zip(capture.photos, plain.photos, strict=True)
        ]
        statistics = capture.statistics
        assert statistics.displacement == pytest.approx(moved)
        left_out = moved <= LEAST_DISPLACEMENT
        assert left_out == (name == "weak")
        assert (statistics.lenses_left_out, statistics.lenses) == ((9, 0) if left_out else (0, 9))
        assert all(same) if left_out else not any(same)


def test_photos_become_smaller_and_so_does_what_lenses_do(tmp_path, colmap_capture):
    colmap_capture(tmp_path, model=RADIAL, distortion=(1e-2, 0.0))
    full, small = (load_capture(tmp_path, downscale=k).statistics.displacement for k in (1, 2))
    assert small == pytest.approx(full / 2)


def test_masks_are_counted(tmp_path, colmap_capture, png):
    colmap_capture(tmp_path)
    assert load_capture(tmp_path).statistics.masks == 0
    shape = load_capture(tmp_path).photos[0].image().shape
    mask = np.full(shape[:2], 255, np.uint8)
    mask[: shape[0] // 2] = 0
    png(tmp_path / "masks" / "p01.png", mask)
    statistics = load_capture(tmp_path).statistics
    assert statistics.masks == 1
    assert statistics.hidden == pytest.approx(0.5 / 9, abs=0.01)
