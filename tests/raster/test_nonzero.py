"""Harmonics that are zero are not summed, and no picture can tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview import raster
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.edits import SceneEdits
from splatview.scene.gaussians import SH_COEFFICIENTS

CAMERA = look_at((0, 0, 2.5), (0, 0, 0), width=64, height=48)


def with_zeros(scene: Gaussians, degrees: np.ndarray) -> Gaussians:
    """Beyond each splat's degree."""
    kept = np.arange(scene.sh.shape[1]) < np.array(SH_COEFFICIENTS)[degrees][:, None]
    return replace(scene, sh=np.where(kept[..., None], scene.sh, np.float32(0)))


def summed(scene: Gaussians, settings=None, **options) -> np.ndarray:
    """The picture with zeros summed."""
    workspace = raster.Workspace()
    splats = raster.parameters_of(scene)
    return raster.draw_frame(splats, CAMERA, settings or RenderSettings(), workspace, **options).image


@pytest.mark.parametrize("edited", [False, True])
def test_own_degrees_change_no_bit(random_gaussians, edited):
    scene = random_gaussians(3000)
    scene = with_zeros(scene, np.random.default_rng(3).choice(4, len(scene), p=(0.6, 0.2, 0.1, 0.1)))
    nonzero = raster.nonzero_bands(scene)
    assert nonzero.in_use == 3 and nonzero.own_degrees is not None
    edits = SceneEdits(marks=np.zeros(len(scene), np.uint32)) if edited else None
    for settings in (RenderSettings(), RenderSettings(sh_degree=1), RenderSettings(sh_degree=0)):
        image = raster.render(scene, CAMERA, settings, edits=edits)
        assert np.array_equal(image, summed(scene, settings, edits=edits))


def test_what_the_scene_has_not_is_not_read(random_gaussians):
    """Told a lie about the scene, the rasteriser leaves out what it was told is zero."""
    scene = random_gaussians(500)
    nonzero = raster.NonzeroBands(3, np.zeros(500, np.uint8))
    splats = raster.parameters_of(scene)
    image = raster.draw_frame(splats, CAMERA, RenderSettings(), raster.Workspace(), nonzero=nonzero).image
    assert np.array_equal(image, summed(scene, RenderSettings(sh_degree=0)))


def test_a_padded_scene_is_drawn_as_the_unpadded_one(random_gaussians):
    scene = random_gaussians(500, sh_degree=0)
    padded = replace(scene, sh=np.pad(scene.sh, ((0, 0), (0, 15), (0, 0))))
    assert raster.nonzero_bands(padded) == (0, None)
    assert raster.nonzero_bands(padded) is raster.nonzero_bands(padded)
    assert np.array_equal(raster.render(padded, CAMERA), raster.render(scene, CAMERA))


def test_trained_scenes_have_one_layout(random_gaussians):
    assert raster.nonzero_bands(random_gaussians(500)) == (3, None)
    assert raster.nonzero_bands(random_gaussians(0)) == (0, None)
