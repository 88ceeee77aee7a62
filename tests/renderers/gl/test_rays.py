"""Lenses and parallel rays on every renderer on the GPU, against the float64 reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.renderer import GLRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, InputError, Lens, RenderSettings, look_at
from splatview.scene.lens import COUNTS
from splatview.scene.reference import render as render_reference

BOUND = 2e-3
"""Of any pixel and channel in float32."""
HALF_BOUND = 4 / 255
"""The same where float16 blends."""

PINHOLE = look_at((0.2, 0.1, -1.3), (0, 0, 0), up=(0, -1, 0), fov_y=75, width=75, height=51)
PARALLEL = replace(PINHOLE, orthographic=True, fx=24.0, fy=21.0)

LENSES = {
    "SIMPLE_RADIAL": (-0.25,),
    "RADIAL": (-0.2, 0.05),
    "OPENCV": (-0.2, 0.05, 0.01, -0.02),
    "RADIAL4": (0.1, -0.02, 0.01, 0.001, 0.01, 0.01),
    "FULL_OPENCV": (0.1, -0.05, 0.01, -0.02, 0.02, 0.2, 0.05, 0.01),
    "OPENCV_FISHEYE": (0.05, -0.02, 0.01, 0.003),
    "FOV": (1.2,),
    "SIMPLE_RADIAL_FISHEYE": (0.05,),
    "RADIAL_FISHEYE": (0.05, -0.01),
    "THIN_PRISM_FISHEYE": (0.03, 0.01, 0.01, -0.02, 0.0, 0.01, 0.02, -0.01),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.03, 0.01, -0.01, 0.02, 0.0, 0.01, 0.01, -0.02, 0.02, 0.01, -0.01, 0.02),
}


def through(model: str, camera: Camera = PINHOLE) -> Camera:
    return replace(camera, lens=Lens(model=model, parameters=LENSES[model]))


@pytest.fixture(scope="module")
def made(session_context: moderngl.Context) -> Iterator[dict[str, GLRenderer]]:
    renderers: dict[str, GLRenderer] = {
        "quads": QuadsRenderer(session_context),
        "tiles": TilesRenderer(session_context),
        "legacy": QuadsGL33Renderer(session_context),
    }
    yield renderers
    for renderer in renderers.values():
        renderer.close()


@pytest.fixture(params=["quads", "tiles", "legacy"])
def renderer(
    ctx: moderngl.Context, made: dict[str, GLRenderer], request: pytest.FixtureRequest
) -> GLRenderer:
    return made[request.param]


def test_no_model_is_left_out():
    assert set(LENSES) == {model for model, count in COUNTS.items() if count}


def test_every_lens(renderer: GLRenderer, random_gaussians):
    scene = random_gaussians(300, sh_degree=1, seed=2)
    for model in LENSES:
        camera = through(model)
        truth = render_reference(scene, camera)
        for chosen, bound in ((RenderSettings(blend="float32"), BOUND), (RenderSettings(), HALF_BOUND)):
            image = renderer.render(FrameRequest(scene, camera, chosen))
            assert np.abs(image - truth).max() < bound, (model, chosen.blend)
        assert np.abs(truth - render_reference(scene, PINHOLE)).max() > 0.1, model


def test_parallel_rays(renderer: GLRenderer, random_gaussians):
    scene = random_gaussians(300, sh_degree=3, seed=3)
    image = renderer.render(FrameRequest(scene, PARALLEL, RenderSettings(blend="float32")))
    assert np.abs(image - render_reference(scene, PARALLEL)).max() < BOUND
    # Moving along the rays changes nothing but what is culled: also a check of the reference.
    matrix = PARALLEL.world_to_camera.copy()
    matrix[2, 3] += 5
    away = renderer.render(
        FrameRequest(scene, replace(PARALLEL, world_to_camera=matrix), RenderSettings(blend="float32"))
    )
    assert np.abs(image - away).max() < 1e-4


def test_the_picture_is_drawn_anew_when_only_the_lens_changes(renderer: GLRenderer, random_gaussians):
    scene, exact = random_gaussians(100, seed=4), RenderSettings(blend="float32")
    pictures = [
        renderer.render(FrameRequest(scene, camera, exact))
        for camera in (
            PINHOLE,
            through("FOV"),
            through("RADIAL"),
            PARALLEL,
            replace(PARALLEL, orthographic=False),
        )
    ]
    for first, second in pairwise(pictures):
        assert np.abs(first - second).max() > 0.05


def one_splat(mean: tuple[float, float, float], scale: float) -> Gaussians:
    return Gaussians(
        means=np.array([mean], np.float32),
        quats=np.array([(1, 0, 0, 0)], np.float32),
        log_scales=np.full((1, 3), np.log(scale), np.float32),
        opacity_logits=np.array([4.0], np.float32),
        sh=np.full((1, 1, 3), 1.5, np.float32),
    )


def test_beyond_the_fold_nothing_is_shown(renderer: GLRenderer):
    """r(1 - 0.3 r²) comes back to 0 at r = 1.83: a splat there would be drawn in the middle."""
    lens = Lens(model="SIMPLE_RADIAL", parameters=(-0.3,))
    camera = replace(look_at((0, 0, 0), (0, 0, 1), up=(0, -1, 0), width=64, height=48), lens=lens)
    exact = RenderSettings(blend="float32")
    for slope, is_shown in ((0.5, True), (1.0, True), (1.06, False), (1.5, False), (1.83, False)):
        scene = one_splat((slope * 2, 0, 2), 0.05)
        wide = replace(camera, fx=30.0, fy=30.0)
        assert (renderer.render(FrameRequest(scene, wide, exact))[..., 3].max() > 0.5) == is_shown, slope


def test_ellipsoids_of_parallel_rays_have_their_size_everywhere(renderer: GLRenderer):
    """Radius 1.5 sigma, wherever in the picture and at whatever depth; nearer ones hide farther ones."""
    sizes = []
    for mean in ((0, 0, 0), (0.6, 0.3, 0), (0, 0, 1.5)):
        scene = one_splat(mean, 0.2)
        image = renderer.render(
            FrameRequest(scene, PARALLEL, RenderSettings(blend="float32"), mode="ellipsoids")
        )
        sizes.append((image[..., 3] > 0.5).sum())
    expected = np.pi * (0.2 * 1.5) ** 2 * PARALLEL.fx * PARALLEL.fy
    np.testing.assert_allclose(sizes, expected, rtol=0.08)


def test_ellipsoids_through_a_lens_are_refused_in_one_line(renderer: GLRenderer):
    with pytest.raises(InputError, match="ellipsoids cannot be drawn through a lens"):
        renderer.render(
            FrameRequest(one_splat((0, 0, 0), 0.1), through("FOV"), RenderSettings(), mode="ellipsoids")
        )
    # And the renderer is as good as before.
    image = renderer.render(FrameRequest(one_splat((0, 0, 0), 0.1), through("FOV"), RenderSettings()))
    assert image[..., 3].max() > 0.5


@pytest.mark.parametrize("order", ["16-bit", "weighted"])
def test_other_orders_through_a_lens(made, ctx, order):
    """They do not ask how rays come: a single splat is the same in all of them."""
    scene, camera = one_splat((0.3, 0.2, 0.4), 0.2), through("OPENCV_FISHEYE")
    image = made["quads"].render(FrameRequest(scene, camera, RenderSettings(blend="float32", order=order)))
    assert np.abs(image - render_reference(scene, camera)).max() < BOUND
