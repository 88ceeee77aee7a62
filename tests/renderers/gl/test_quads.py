"""The GL 4.3 renderer against the float64 reference, on scenes made here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import TEXTBOOK, Camera, Gaussians, ImageModel, RenderSettings, look_at
from splatview.scene.reference import render as render_reference

Make = Callable[..., Gaussians]

BACKGROUND = (0.2, 0.5, 0.1)
EXACT = RenderSettings(blend="float32", background=BACKGROUND)


@pytest.fixture
def renderer(ctx: moderngl.Context) -> Iterator[QuadsRenderer]:
    made = QuadsRenderer(ctx)
    yield made
    made.close()


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    difference = image[..., :3].clip(0, 1).astype(np.float64) - truth[..., :3].clip(0, 1)
    return float(-10 * np.log10(np.mean(difference**2) + 1e-30))


def assert_true(
    renderer: QuadsRenderer,
    scene: Gaussians,
    camera: Camera,
    settings: RenderSettings = EXACT,
    *,
    least: float = 60.0,
    most: float = 4 / 255,
) -> np.ndarray:
    image = renderer.render(FrameRequest(scene, camera, settings))
    truth = render_reference(scene, camera, settings)
    assert image.shape == (camera.height, camera.width, 4)
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    assert psnr(image, truth) >= least
    assert np.abs(image - truth).max() <= most
    return image


def camera_at(*eye: float, width: int = 96, height: int = 64) -> Camera:
    return look_at(eye, (0.0, 0.0, 0.0), width=width, height=height)


@pytest.mark.parametrize("eye", [(0, 0.4, 3), (0.9, 0, 0.5), (0.1, 0.05, 0.1)], ids=["far", "near", "inside"])
@pytest.mark.parametrize(("blend", "least", "most"), [("float16", 50, 4 / 255), ("float32", 80, 0.5 / 255)])
def test_pictures_are_those_of_the_reference(renderer, random_gaussians: Make, eye, blend, least, most):
    settings = replace(EXACT, blend=blend)
    assert_true(renderer, random_gaussians(1500), camera_at(*eye), settings, least=least, most=most)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_degree_stored_and_asked_for(renderer, random_gaussians: Make, degree):
    camera = camera_at(0, 0, 2.5)
    assert_true(renderer, random_gaussians(300, sh_degree=degree), camera, least=80)
    asked = replace(EXACT, sh_degree=degree)
    assert_true(renderer, random_gaussians(300), camera, asked, least=80)


@pytest.mark.parametrize("size", [(1, 1), (17, 9), (130, 3)])
def test_odd_sizes(renderer, random_gaussians: Make, size):
    assert_true(renderer, random_gaussians(300), camera_at(0, 0, 2, width=size[0], height=size[1]), least=80)


def test_off_centre_principal_point(renderer, random_gaussians: Make):
    camera = replace(camera_at(0, 0, 1.2), cx=-20.0, cy=80.0, fx=70.0, fy=45.0)
    assert_true(renderer, random_gaussians(800), camera, least=80)


def test_antialiased_opacity(renderer, random_gaussians: Make):
    settings = replace(EXACT, model=ImageModel(antialiased=True))
    scene = random_gaussians(800)
    image = assert_true(renderer, scene, camera_at(0, 0, 9), settings, least=80)
    assert np.abs(image - renderer.render(FrameRequest(scene, camera_at(0, 0, 9), EXACT))).max() > 0.02


def test_bare_textbook_model(renderer, random_gaussians: Make):
    # No cut: every splat covers the whole picture.
    settings = replace(EXACT, model=TEXTBOOK)
    assert_true(renderer, random_gaussians(60), camera_at(0, 0, 2.5, width=40, height=30), settings, least=80)


def test_splats_about_the_near_plane(renderer, random_gaussians: Make):
    scene = random_gaussians(400)
    means = scene.means.copy()
    means[:, 2] = np.linspace(-0.02, 0.02, 400, dtype=np.float32)
    camera = look_at((0, 0, 0), (0, 0, 1), width=64, height=48)
    assert_true(renderer, replace(scene, means=means), camera, least=60)
    assert 0 < renderer.stats(wait=True).visible < 400


def test_an_empty_scene_shows_the_background(renderer, random_gaussians: Make):
    image = renderer.render(FrameRequest(random_gaussians(0), camera_at(0, 0, 2), EXACT))
    assert np.allclose(image, (*BACKGROUND, 0.0), atol=1e-6)
    assert renderer.stats(wait=True).visible == 0


def test_a_single_splat(renderer, random_gaussians: Make):
    scene = random_gaussians(1, seed=3)
    camera = look_at(scene.means[0] + np.array([0, 0, 1], np.float32), scene.means[0], width=64, height=48)
    image = assert_true(renderer, scene, camera, least=100)
    assert image[..., 3].max() > 0.1


@pytest.mark.parametrize("attribute", ["means", "quats", "log_scales", "opacity_logits", "sh"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_ill_values_cull_their_splat_alone(renderer, random_gaussians: Make, attribute, bad):
    scene = random_gaussians(200)
    values = getattr(scene, attribute).copy()
    values[::4].reshape(50, -1)[:, -1] = bad
    assert_true(renderer, replace(scene, **{attribute: values}), camera_at(0, 0, 2.5), least=80)


def test_quaternions_of_any_length(renderer, random_gaussians: Make):
    scene = random_gaussians(200)
    factors = np.resize(np.array([0, 1e-31, 1e-25, 1e25, 3], np.float32), 200)
    scaled = replace(scene, quats=scene.quats / np.abs(scene.quats).max(1, keepdims=True) * factors[:, None])
    assert_true(renderer, scaled, camera_at(0, 0, 2.5), least=80)
    whole = replace(EXACT, model=ImageModel(alpha_cut=1e-9))
    renderer.render(FrameRequest(scaled, camera_at(0, 0, 20), whole))
    assert renderer.stats(wait=True).visible == 120  # all but the zero ones and those below 1e-30


@pytest.mark.parametrize(
    "log_scales", [(-30, -30, -30), (30, 30, 30), (-14, -14, 0), (0, 0, -14), (30, -30, -2)]
)
def test_extreme_shapes_stay_visible(renderer, random_gaussians: Make, log_scales):
    scene = random_gaussians(12)
    scene = replace(scene, log_scales=np.tile(np.array(log_scales, np.float32), (12, 1)))
    image = assert_true(renderer, scene, camera_at(0, 0, 2.5), least=60)
    assert image[..., 3].max() > 0.2


def test_scenes_far_from_the_origin(renderer, random_gaussians: Make):
    scene = random_gaussians(500)
    shift = np.array([1e7, -2e7, 3e6])
    far = replace(scene, means=scene.means.astype(np.float64) + shift)
    camera = look_at(shift + np.array([0, 0, 2.5]), shift, width=96, height=64)
    image = assert_true(renderer, far, camera, least=75)
    near = renderer.render(FrameRequest(scene, camera_at(0, 0, 2.5), EXACT))
    assert np.abs(image - near).max() < 2e-3


def test_ties_are_drawn_by_index(renderer, random_gaussians: Make):
    # 700 coincident splats are more than one work group, so atomics alone would shuffle them.
    scene = random_gaussians(700)
    scene = replace(scene, means=np.zeros_like(scene.means), opacity_logits=np.full(700, -2, np.float32))
    assert_true(renderer, scene, camera_at(0, 0, 2.5), least=80)


def test_the_same_picture_twice(ctx: moderngl.Context, random_gaussians: Make):
    scene, camera = random_gaussians(3000), camera_at(0.2, 0, 0.4)
    pictures = []
    for _ in range(2):
        renderer = QuadsRenderer(ctx)
        pictures.append(renderer.render(FrameRequest(scene, camera, EXACT)))
        renderer.close()
    assert np.array_equal(*pictures)


def test_bright_colours_do_not_overflow(renderer, random_gaussians: Make):
    scene = random_gaussians(300)
    bright = replace(scene, sh=scene.sh * 40)
    image = renderer.render(FrameRequest(bright, camera_at(0, 0, 2.5), replace(EXACT, blend="float16")))
    truth = render_reference(bright, camera_at(0, 0, 2.5), EXACT)
    assert image.max() > 5
    assert np.allclose(image, truth, rtol=5e-3, atol=4 / 255)


@pytest.mark.parametrize("stop", [0.0, 1e-2])
def test_early_stop_costs_at_most_its_transmittance(renderer, random_gaussians: Make, stop):
    scene = random_gaussians(4000)
    scene = replace(scene, opacity_logits=scene.opacity_logits + 3)
    camera = camera_at(0, 0, 1.5)
    truth = render_reference(scene, camera, EXACT)
    renderer.early_stop = stop
    image = renderer.render(FrameRequest(scene, camera, EXACT))
    brightest = max(truth[..., :3].max(), 4.0)
    assert np.abs(image - truth).max() <= stop * brightest + 1e-4
    with pytest.raises(ValueError, match="early_stop"):
        renderer.early_stop = 1.0


def test_a_target_that_blends_float16_itself(renderer, random_gaussians: Make):
    # What a GPU does; llvmpipe truncates where GPUs round, so its bound here is the looser one.
    renderer._targets.truncates = False
    image = renderer.render(
        FrameRequest(random_gaussians(1500), camera_at(0, 0.4, 3), replace(EXACT, blend="float16"))
    )
    truth = render_reference(random_gaussians(1500), camera_at(0, 0.4, 3), EXACT)
    assert psnr(image, truth) >= 40


def test_nothing_is_done_again_when_nothing_changed(renderer, random_gaussians: Make):
    scene, camera = random_gaussians(200), camera_at(0, 0, 2.5)

    def counters() -> tuple[int, int, int]:
        stats = renderer.stats()
        return stats.projected, stats.sorted, stats.drawn

    renderer.render(FrameRequest(scene, camera, EXACT))
    assert counters() == (1, 1, 1)
    first = renderer.read()
    renderer.render(FrameRequest(scene, camera_at(0, 0, 2.5), replace(EXACT)))
    assert counters() == (1, 1, 1)
    assert np.array_equal(renderer.read(), first)

    # The background is blended at the end; precision and mode draw anew but need no new order.
    image = renderer.render(FrameRequest(scene, camera, replace(EXACT, background=(1, 1, 1))))
    assert counters() == (1, 1, 1)
    assert np.abs(image - first).max() > 0.3
    renderer.draw(FrameRequest(None, camera, replace(EXACT, blend="float16")))
    renderer.draw(FrameRequest(None, camera, EXACT, mode="overdraw"))
    assert counters() == (1, 1, 3)
    renderer.draw(FrameRequest(None, camera, EXACT))
    assert np.array_equal(renderer.read(), first)

    renderer.draw(FrameRequest(None, camera_at(0, 0, 2.6), EXACT))
    assert counters() == (2, 2, 5)
    renderer.load(random_gaussians(100, seed=1))
    renderer.draw(FrameRequest(None, camera_at(0, 0, 2.6), EXACT))
    assert counters() == (3, 3, 6)


def test_stats_tell_visible_splats_and_stages(renderer, random_gaussians: Make):
    scene = random_gaussians(1000)
    renderer.render(FrameRequest(scene, camera_at(0, 0, 3), EXACT))
    assert renderer.stats().splats == 1000
    finished = renderer.stats(wait=True)
    assert renderer.stats().visible == finished.visible
    assert 0 < finished.visible <= 1000
    assert set(finished.ms) == {"project", "sort", "draw"}
    renderer.draw(FrameRequest(None, look_at((0, 0, 3), (0, 0, 9), width=64, height=48), EXACT))
    renderer.read()
    assert renderer.stats(wait=True).visible == 0


def test_draw_leaves_the_callers_framebuffer_bound(ctx, renderer, random_gaussians: Make):
    before = ctx.detect_framebuffer()
    mine = ctx.simple_framebuffer((8, 8))
    mine.use()
    renderer.render(FrameRequest(random_gaussians(50), camera_at(0, 0, 3), EXACT))
    assert ctx.detect_framebuffer().glo == mine.glo
    before.use()  # releasing a bound framebuffer is an error in moderngl
    mine.release()


def test_draw_before_load_is_refused(renderer):
    with pytest.raises(RuntimeError, match="load"):
        renderer.draw(FrameRequest(None, camera_at(0, 0, 3), EXACT))
