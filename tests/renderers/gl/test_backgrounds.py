"""Every renderer has the same background behind its splats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview import raster
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import RenderSettings, look_at, reference
from splatview.scene.background import Background, Gradient, Panorama
from splatview.scene.lens import Lens

TOLERANCE = 1e-3
"""Of the panorama, whose pixels differ by up to 1: arctangents of float32 are good to some 1e-6 of a turn.
A colour and a gradient are as near as the splats before them, which have float32's rounding."""

CAMERA = look_at((1, -2, -3), (0, 0, 0), up=(0, -1, 0.2), width=161, height=93, fov_y=90)


@pytest.fixture(scope="module")
def backgrounds() -> dict[str, Background]:
    rng = np.random.default_rng(5)
    return {
        "colour": (0.1, 0.5, 0.9),
        "gradient": Gradient(top=(0, 0.2, 1), bottom=(1, 0.4, 0), up=(0, 0, 1)),
        "panorama": Panorama(pixels=rng.integers(0, 256, (64, 126, 3), dtype=np.uint8)),
    }


@pytest.mark.parametrize("make", [QuadsRenderer, TilesRenderer, QuadsGL33Renderer])
def test_gl_agrees_with_the_reference(ctx, random_gaussians, backgrounds, make):
    scene, renderer = random_gaussians(30), make(ctx)
    for background in (*backgrounds.values(), backgrounds["colour"]):
        settings = RenderSettings(background=background, blend="float32")
        truth = reference.render(scene, CAMERA, settings)
        image = renderer.render(FrameRequest(scene, CAMERA, settings))
        np.testing.assert_allclose(image, truth, atol=TOLERANCE)
        assert (1 - truth[..., 3]).mean() > 0.2  # or nothing of it would be seen
    renderer.close()


def test_the_cpu_agrees_with_the_reference(random_gaussians, backgrounds):
    scene = random_gaussians(30)
    for background in backgrounds.values():
        settings = RenderSettings(background=background)
        truth = reference.render(scene, CAMERA, settings)
        np.testing.assert_allclose(raster.render(scene, CAMERA, settings), truth, atol=TOLERANCE)


def test_only_the_background_is_drawn_anew(ctx, random_gaussians, backgrounds):
    renderer = QuadsRenderer(ctx)
    renderer.load(random_gaussians(30))
    counts = []
    for background in backgrounds.values():
        renderer.draw(FrameRequest(None, CAMERA, RenderSettings(background=background)))
        counts.append((renderer.stats().projected, renderer.stats().sorted, renderer.stats().drawn))
    assert counts == [(1, 1, 1)] * 3
    renderer.close()


def test_a_lens_bends_the_background_too(ctx, backgrounds, flat_scene):
    camera = replace(CAMERA, lens=Lens(model="SIMPLE_RADIAL", parameters=(0.1,)))
    renderer = QuadsRenderer(ctx)
    for name in ("gradient", "panorama"):
        settings = RenderSettings(background=backgrounds[name], blend="float32")
        straight = renderer.render(FrameRequest(flat_scene, CAMERA, settings))
        bent = renderer.render(FrameRequest(flat_scene, camera, settings))
        np.testing.assert_allclose(bent, reference.render(flat_scene, camera, settings), atol=TOLERANCE)
        assert np.abs(bent - straight).max() > 0.01
    renderer.close()


@pytest.fixture
def flat_scene(random_gaussians):
    """One splat behind the camera: only the background is seen, and no renderer needs to know the lens."""
    return replace(random_gaussians(1), means=(CAMERA.eye - 5 * CAMERA.forward)[None].astype(np.float32))
