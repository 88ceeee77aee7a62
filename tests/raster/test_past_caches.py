"""Rows written past the caches hold what others hold, wherever arrays begin and whatever their size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview import raster
from splatview.raster.gradients import Gradients, differentiate
from splatview.raster.parameters import Parameters
from splatview.raster.project import RECORD
from splatview.raster.simd import CACHE_LINE
from splatview.raster.sort import empty_at_line
from splatview.raster.transpose import MOST_CACHED
from splatview.scene import Gaussians, RenderSettings, look_at

CAMERA = look_at((0, 0, -3), (0, 0, 0), width=50, height=37)


def beside_line(array: np.ndarray) -> np.ndarray:
    """An array of this shape that begins 16 bytes behind a cache line, as large ones of numpy do."""
    whole = empty_at_line((array.nbytes + CACHE_LINE,), np.uint8)
    return whole[16 : 16 + array.nbytes].view(array.dtype).reshape(array.shape)


@pytest.mark.parametrize("shape", [(1,), (1000, 3), (7, 16, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_an_array_begins_at_a_line(shape, dtype) -> None:
    array = empty_at_line(shape, dtype)
    assert array.shape == shape and array.dtype == dtype and array.flags.c_contiguous
    assert array.ctypes.data % CACHE_LINE == 0


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gradients_are_the_same_wherever_their_arrays_begin(random_gaussians, degree, dtype) -> None:
    splats = raster.parameters_of(random_gaussians(333, sh_degree=degree))
    splats = Parameters(*(np.ascontiguousarray(array, dtype) for array in splats))
    frame = raster.draw_frame(splats, CAMERA, RenderSettings(), raster.Workspace(), dtype=dtype, threads=2)
    weights = np.random.default_rng(0).normal(size=frame.image.shape).astype(dtype)
    found = differentiate(splats, frame, weights)
    assert all(array.ctypes.data % CACHE_LINE == 0 for array in found.parameters)
    moved: Gradients = replace(
        found, parameters=Parameters(*(beside_line(array) for array in found.parameters))
    )
    beside = differentiate(splats, frame, weights, reuse=moved)
    assert beside.parameters.sh is moved.parameters.sh
    for ours, theirs in zip(beside.parameters, found.parameters, strict=True):
        assert np.array_equal(ours, theirs)


def test_a_scene_too_large_for_the_caches_has_the_same_picture(random_gaussians) -> None:
    few = random_gaussians(900)
    count = MOST_CACHED // (RECORD * 4) + 1000
    rows = np.sort(np.random.default_rng(1).permutation(count)[: len(few)])
    # All others are behind the camera.
    means = np.full((count, 3), (0.0, 0.0, -9.0), np.float32)
    means[rows] = few.means

    def among(array: np.ndarray) -> np.ndarray:
        whole = np.zeros((count, *array.shape[1:]), np.float32)
        whole[:] = array[0]
        whole[rows] = array
        return whole

    many = Gaussians(
        means=means,
        quats=among(few.quats),
        log_scales=among(few.log_scales),
        opacity_logits=among(few.opacity_logits),
        sh=among(few.sh),
    )
    expected, picture = (raster.render(scene, CAMERA, RenderSettings()) for scene in (few, many))
    assert expected.max() > 0.1
    assert np.array_equal(picture, expected)
