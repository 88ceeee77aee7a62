"""Pixels end where the census says that nothing visible can follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview import raster
from splatview.renderers.gl import quads
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings, look_at, reference
from splatview.scene.effects import VISIBLE, settings_for
from splatview.scene.effects.appearance import LEAST_LIGHT

CAMERA = look_at((0, 0, -3), (0, 0, 0), width=24, height=16)

WALLS = 1200
"""Splats before the bright one. The last 300 lie behind the limit: renderers look for it only then."""


@pytest.fixture
def lamp_behind_walls(random_gaussians) -> Gaussians:
    """Thin walls one behind the other, and a lamp of 1000 times white behind them all."""
    scene = random_gaussians(WALLS + 1, sh_degree=0)
    means = np.zeros((WALLS + 1, 3), np.float32)
    means[:, 2] = np.linspace(-0.5, 0.5, WALLS + 1)
    sh = np.zeros((WALLS + 1, 1, 3), np.float32)
    sh[-1] = 1000 / 0.28209479
    logits = np.full(WALLS + 1, -4.64, np.float32)
    logits[-1] = 9
    log_scales = np.full((WALLS + 1, 3), 3.0, np.float32)
    return replace(scene, means=means, sh=sh, opacity_logits=logits, log_scales=log_scales)


def test_renderers_give_up_no_more_light_than_the_census_counts_with():
    assert quads.EARLY_STOP <= LEAST_LIGHT and raster.EARLY_STOP <= LEAST_LIGHT


@pytest.mark.parametrize("renderer", ["quads", "tiles", "cpu"])
def test_a_bright_lamp_behind_what_is_nearly_opaque(ctx, lamp_behind_walls, renderer):
    scene = lamp_behind_walls
    wanted = replace(settings_for(scene), blend="float32")
    assert wanted.early_stop is not None and wanted.early_stop < LEAST_LIGHT / 6

    def picture(settings: RenderSettings) -> np.ndarray:
        if renderer == "cpu":
            return raster.render(scene, CAMERA, settings)
        made = (QuadsRenderer if renderer == "quads" else TilesRenderer)(ctx)
        image = made.render(FrameRequest(scene, CAMERA, settings))
        made.close()
        return image

    truth = reference.render(scene, CAMERA)
    # A tenth for float32.
    assert np.abs(picture(wanted) - truth).max() <= 1.1 * VISIBLE
    coarse = replace(wanted, early_stop=LEAST_LIGHT)
    assert np.abs(picture(coarse) - truth).max() > VISIBLE
