"""Tiles in each pixel's own order: as the CPU rasteriser, which is tested against full sorting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview import raster
from splatview.measure.metrics import psnr
from splatview.renderers.gl.tiles import HARDWARE, NEAREST, SOFTWARE, TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import ImageModel, InputError, RenderSettings, look_at
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits

SETTINGS = RenderSettings(order="per-pixel", early_stop=0.0, background=(0.2, 0.1, 0.4))
CAMERA = look_at((0.2, -0.3, -2.5), (0, 0, 0), up=(0, -1, 0), width=43, height=35)

CRAMPED = replace(SOFTWARE, pairs=replace(SOFTWARE.pairs, most_pairs=300, most_rounds=1))
"""Room for so few pairs that splats are left over, and tried in every tile."""


@pytest.fixture(params=[SOFTWARE, HARDWARE], ids=["software", "hardware"])
def tiles(request, ctx):
    made = TilesRenderer(ctx, tuning=request.param)
    yield made
    made.close()


def close(picture: np.ndarray, other: np.ndarray) -> bool:
    """But for pixels where an alpha sits on its cut, or two depths agree to float32's last digits."""
    apart = np.abs(picture - other).max(axis=2)
    return bool(np.mean(apart > 2e-3) < 5e-3) and psnr(picture, other) > 50


def test_they_are_the_pictures_of_the_cpu(tiles, random_gaussians):
    scene = random_gaussians(300, seed=3)
    picture = tiles.render(FrameRequest(scene, CAMERA, SETTINGS))
    assert close(picture, raster.render(scene, CAMERA, SETTINGS))
    assert not close(picture, tiles.render(FrameRequest(scene, CAMERA, replace(SETTINGS, order="32-bit"))))


def test_antialiased_and_cut_short_too(tiles, random_gaussians):
    scene = random_gaussians(200, seed=4)
    settings = replace(SETTINGS, model=ImageModel(antialiased=True), sigma_cut=2.0, early_stop=1e-2)
    assert close(tiles.render(FrameRequest(scene, CAMERA, settings)), raster.render(scene, CAMERA, settings))


def test_with_edits(tiles, random_gaussians):
    scene = random_gaussians(90, seed=8)
    turned = Adjustment(rotation=(0.8, 0.36, 0.48, 0.0), translation=(0.2, -0.1, 0.3), scale=1.3, size=0.8)
    marks = np.where(np.arange(90) % 3 == 0, 1 << PALETTE_SHIFT, 0).astype(np.uint32)
    edits = SceneEdits(marks=marks, palette=(IDENTITY, turned))
    picture = tiles.render(FrameRequest(scene, CAMERA, SETTINGS, edits=edits))
    assert close(picture, raster.render(scene, CAMERA, SETTINGS, edits=edits))


def test_what_finds_no_room_among_the_pairs_is_blended_behind(ctx, random_gaussians):
    """Nearest first in both parts; each ends with what it holds back."""
    scene = random_gaussians(300, seed=3)
    cramped = TilesRenderer(ctx, tuning=CRAMPED)
    picture = cramped.render(FrameRequest(scene, CAMERA, SETTINGS))
    cramped.close()
    assert psnr(picture, raster.render(scene, CAMERA, SETTINGS)) > 30
    np.testing.assert_allclose(picture[..., 3], raster.render(scene, CAMERA, SETTINGS)[..., 3], atol=5e-3)


def test_flat_splats_are_the_cpus(tiles, random_gaussians):
    flat = replace(SETTINGS, model=ImageModel().with_footprint("disc"))
    with pytest.raises(InputError, match="is not for --renderer tiles: cpu can do it"):
        tiles.render(FrameRequest(random_gaussians(5), CAMERA, flat))


def test_as_many_are_held_back_as_by_the_cpu():
    from splatview.raster import forward_per_pixel as per_pixel

    assert per_pixel.NEAREST == NEAREST
