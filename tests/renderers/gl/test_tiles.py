"""The renderer by tiles against the float64 reference, on scenes made here."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.measure.metrics import largest_error, psnr
from splatview.renderers import make_renderer
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import HARDWARE, LEAST_PAIRS, SOFTWARE, TilesRenderer, TileTuning
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import TEXTBOOK, Camera, Gaussians, ImageModel, InputError, RenderSettings, look_at
from splatview.scene.edits import HIDDEN, PREVIEW, SELECTED, SceneEdits, bake
from splatview.scene.reference import render as render_reference

Make = Callable[..., Gaussians]

BACKGROUND = (0.2, 0.5, 0.1)
EXACT = RenderSettings(background=BACKGROUND, early_stop=0.0)

CRAMPED = replace(SOFTWARE, pairs=replace(SOFTWARE.pairs, most_pairs=300, most_rounds=3))
"""Room for so few pairs that most pictures need several rounds, and leave splats over."""


@pytest.fixture(scope="module")
def made(session_context: moderngl.Context) -> Iterator[dict[str, TilesRenderer]]:
    renderers = {
        name: TilesRenderer(session_context, tuning=tuning)
        for name, tuning in (("software", SOFTWARE), ("hardware", HARDWARE), ("cramped", CRAMPED))
    }
    yield renderers
    for renderer in renderers.values():
        renderer.close()


@pytest.fixture
def renderer(ctx: moderngl.Context, made: dict[str, TilesRenderer]) -> TilesRenderer:
    return made["software"]


@pytest.fixture(params=["software", "hardware", "cramped"])
def any_renderer(ctx: moderngl.Context, made, request: pytest.FixtureRequest) -> TilesRenderer:
    return made[request.param]


def assert_true(
    renderer: TilesRenderer,
    scene: Gaussians,
    camera: Camera,
    settings: RenderSettings = EXACT,
    *,
    least: float = 80.0,
    most: float = 0.5 / 255,
) -> np.ndarray:
    image = renderer.render(FrameRequest(scene, camera, settings))
    truth = render_reference(scene, camera, settings)
    assert image.shape == (camera.height, camera.width, 4)
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    assert psnr(image, truth) >= least
    assert largest_error(image, truth) <= most
    return image


def camera_at(*eye: float, width: int = 70, height: int = 45) -> Camera:
    return look_at(eye, (0.0, 0.0, 0.0), width=width, height=height)


def pairs(renderer: TilesRenderer) -> int:
    return renderer._tiles.pairs.found.read_now()


@pytest.mark.parametrize("eye", [(0, 0.4, 3), (0.9, 0, 0.5), (0.1, 0.05, 0.1)], ids=["far", "near", "inside"])
def test_pictures_are_those_of_the_reference(any_renderer, random_gaussians: Make, eye):
    assert_true(any_renderer, random_gaussians(1500), camera_at(*eye))


@pytest.mark.parametrize("size", [(1, 1), (17, 9), (130, 3), (16, 16), (33, 31)])
def test_tiles_that_the_picture_does_not_fill(any_renderer, random_gaussians: Make, size):
    assert_true(any_renderer, random_gaussians(300), camera_at(0, 0, 2, width=size[0], height=size[1]))


@pytest.mark.parametrize("tile", [8, 32])
def test_tiles_of_other_sizes(ctx, random_gaussians: Make, tile):
    other = TilesRenderer(ctx, tuning=TileTuning(tile=tile, workgroup=32, batch=32))
    assert_true(other, random_gaussians(300), camera_at(0, 0.1, 1.5))
    other.close()


def test_off_centre_principal_point(any_renderer, random_gaussians: Make):
    camera = replace(camera_at(0, 0, 1.2), cx=-20.0, cy=80.0, fx=70.0, fy=45.0)
    assert_true(any_renderer, random_gaussians(800), camera)


@pytest.mark.parametrize("degree", [0, 2])
def test_harmonics_and_antialiased_opacity(renderer, random_gaussians: Make, degree):
    settings = replace(EXACT, sh_degree=degree, model=ImageModel(antialiased=True))
    assert_true(renderer, random_gaussians(500), camera_at(0, 0, 6), settings)


def test_bare_textbook_model(any_renderer, random_gaussians: Make):
    # No cut: every splat is in every tile.
    settings = replace(EXACT, model=TEXTBOOK)
    assert_true(any_renderer, random_gaussians(60), camera_at(0, 0, 2.5), settings)
    assert pairs(any_renderer) == 60 * 5 * 3


@pytest.mark.parametrize("count", [0, 1])
def test_an_empty_scene_and_a_single_splat(any_renderer, random_gaussians: Make, count):
    image = assert_true(any_renderer, random_gaussians(count), camera_at(0, 0, 2))
    assert any_renderer.stats(wait=True).visible == count
    if count == 0:
        assert np.allclose(image, (*BACKGROUND, 0.0), atol=1e-6)


def test_a_scene_after_an_empty_one(any_renderer, random_gaussians: Make):
    for count in (50, 0, 400):
        assert_true(any_renderer, random_gaussians(count), camera_at(0, 0, 2))


@pytest.mark.parametrize("attribute", ["means", "quats", "log_scales", "opacity_logits", "sh"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_ill_values_cull_their_splat_alone(renderer, random_gaussians: Make, attribute, bad):
    scene = random_gaussians(200)
    values = getattr(scene, attribute).copy()
    values[::4].reshape(50, -1)[:, -1] = bad
    assert_true(renderer, replace(scene, **{attribute: values}), camera_at(0, 0, 2.5))


@pytest.mark.parametrize(
    "log_scales", [(-30, -30, -30), (30, 30, 30), (-14, -14, 0), (0, 0, -14), (30, -30, -2), (4, 4, 4)]
)
@pytest.mark.parametrize("blur", [0.3, 0.0])
def test_extreme_shapes_stay_visible(renderer, random_gaussians: Make, log_scales, blur):
    scene = random_gaussians(12)
    scene = replace(scene, log_scales=np.tile(np.array(log_scales, np.float32), (12, 1)))
    settings = replace(EXACT, model=ImageModel(blur=blur))
    image = assert_true(renderer, scene, camera_at(0, 0, 2.5), settings, least=60, most=4 / 255)
    assert blur == 0 or image[..., 3].max() > 0.2


def test_needles_are_in_the_tiles_they_cross_and_in_few_others(renderer, random_gaussians: Make):
    scene = random_gaussians(40, seed=4)
    needles = np.tile(np.array([2.0, -9.0, -9.0], np.float32), (40, 1))
    camera = camera_at(0, 0, 2.5, width=320, height=240)
    assert_true(renderer, replace(scene, log_scales=needles), camera, least=70, most=4 / 255)
    # A line crosses at most columns + rows - 1 tiles; its box may have all 20 x 15.
    assert pairs(renderer) < 40 * 1.2 * (20 + 15 - 1)


def test_every_tile_with_a_pixel_of_the_ellipse_and_no_other(renderer, random_gaussians: Make):
    # By brute force: float64 alpha of each splat at each pixel.
    scene, camera = random_gaussians(60, seed=2), camera_at(0.3, 0.2, 1.5, width=100, height=76)
    needed = 0
    for index in range(60):
        alone = scene.take(np.array([index]))
        seen = np.zeros((80, 112), bool)
        seen[:76, :100] = render_reference(alone, camera, EXACT)[..., 3] > 0
        needed += int(seen.reshape(5, 16, 7, 16).any(axis=(1, 3)).sum())
    renderer.render(FrameRequest(scene, camera, EXACT))
    assert needed <= pairs(renderer) <= 1.1 * needed + 5


@pytest.mark.parametrize("count", [3000])
def test_coincident_splats_are_drawn_by_index(any_renderer, random_gaussians: Make, count):
    scene = random_gaussians(count)
    scene = replace(scene, means=np.zeros_like(scene.means), opacity_logits=np.full(count, -3, np.float32))
    assert_true(any_renderer, scene, camera_at(0, 0, 2.5, width=40, height=30))


def test_giant_splats_over_all_tiles(any_renderer, random_gaussians: Make):
    scene = random_gaussians(200)
    scene = replace(scene, log_scales=scene.log_scales + 6, opacity_logits=np.full(200, -3, np.float32))
    assert_true(any_renderer, scene, camera_at(0, 0, 3))
    assert pairs(any_renderer) > 0.9 * 200 * 5 * 3


def test_scenes_far_from_the_origin(renderer, random_gaussians: Make):
    scene = random_gaussians(300)
    shift = np.array([1e7, -2e7, 3e6])
    far = replace(scene, means=scene.means.astype(np.float64) + shift)
    camera = look_at(shift + np.array([0, 0, 2.5]), shift, width=70, height=45)
    assert_true(renderer, far, camera, least=75)


@pytest.mark.parametrize("rounds", [1, 3])
def test_what_finds_no_room_is_drawn_all_the_same_and_room_is_made(ctx, random_gaussians: Make, rounds):
    # Nothing is known of a picture but the count of one a few frames back, of fewer pairs.
    most = 4 * LEAST_PAIRS if rounds == 1 else LEAST_PAIRS
    tuning = replace(SOFTWARE, tile=8, pairs=replace(SOFTWARE.pairs, most_pairs=most, most_rounds=rounds))
    renderer = TilesRenderer(ctx, tuning=tuning)
    scene = random_gaussians(1200)
    scene = replace(scene, log_scales=scene.log_scales + 1, opacity_logits=np.full(1200, -3.5, np.float32))
    far = camera_at(0, 0, 60, width=160, height=120)
    assert_true(renderer, scene, far)
    made = renderer._tiles.pairs
    assert pairs(renderer) < made.capacity == LEAST_PAIRS
    truth = render_reference(scene, camera_at(0, 0, 0.9, width=160, height=120), EXACT)
    left_overs, plan = [], np.zeros(0)
    for frame in range(4):
        near = camera_at(0, 0, 0.9 + 1e-6 * frame, width=160, height=120)
        image = renderer.render(FrameRequest(scene, near, EXACT))
        assert psnr(image, truth) >= 80
        plan = np.frombuffer(made.plan.read(), np.uint32)
        left_overs.append(int(plan[4]) - int(plan[3]))
        assert frame > 0 or pairs(renderer) > made.capacity == LEAST_PAIRS
    assert left_overs[0] > 0
    assert left_overs[-1] == 0
    assert plan[5 : 5 + rounds].sum() == pairs(renderer)
    assert made.capacity > LEAST_PAIRS if rounds == 1 else made.capacity == LEAST_PAIRS
    renderer.close()


def test_cramped_pictures_are_those_with_room(made, ctx, random_gaussians: Make):
    scene, camera = random_gaussians(900), camera_at(0.2, 0, 0.8)
    pictures = [
        made[name].render(FrameRequest(scene, camera, EXACT)) for name in ("software", "cramped", "hardware")
    ]
    assert pairs(made["cramped"]) > 900
    assert largest_error(pictures[0], pictures[1]) < 1e-5
    assert largest_error(pictures[0], pictures[2]) < 1e-5


@pytest.mark.parametrize("stop", [1e-4, 1e-2])
def test_early_stop_costs_at_most_its_transmittance(any_renderer, random_gaussians: Make, stop):
    scene = random_gaussians(4000)
    scene = replace(scene, opacity_logits=scene.opacity_logits + 3)
    camera = camera_at(0, 0, 1.5)
    truth = render_reference(scene, camera, EXACT)
    image = any_renderer.render(FrameRequest(scene, camera, replace(EXACT, early_stop=stop)))
    assert largest_error(image, truth) <= stop * max(truth[..., :3].max(), 4.0) + 1e-4
    exact = any_renderer.render(FrameRequest(scene, camera, EXACT))
    assert largest_error(exact, truth) <= 1e-4
    if stop == 1e-2:
        assert largest_error(image, exact) > 0


def test_orders_that_tiles_have_and_others(renderer, random_gaussians: Make):
    scene, camera = random_gaussians(500), camera_at(0, 0, 2.2)
    assert_true(renderer, scene, camera, replace(EXACT, order="16-bit"), least=50, most=0.2)
    for order in ("weighted", "stochastic"):
        with pytest.raises(InputError, match=f"{order} order is not for tiles"):
            renderer.render(FrameRequest(scene, camera, replace(EXACT, order=order)))


@pytest.mark.parametrize("kind", ["hidden", "lit"])
def test_edits_and_tints(any_renderer, random_gaussians: Make, kind):
    scene, camera = random_gaussians(400), camera_at(0, 0, 2.2)
    flag = HIDDEN if kind == "hidden" else SELECTED
    marks = np.where(np.arange(400) % 3 == 0, flag, 0).astype(np.uint32)
    edits = SceneEdits(marks=marks, flags=HIDDEN | SELECTED | PREVIEW)
    image = any_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits, highlight=Highlight()))
    plain = any_renderer.render(FrameRequest(scene, camera, EXACT))
    if kind == "hidden":
        assert largest_error(image, render_reference(bake(scene, edits), camera, EXACT)) <= 0.5 / 255
    else:
        assert np.allclose(image[..., 3], plain[..., 3], atol=1e-6)
        quads = QuadsRenderer(any_renderer._ctx)
        wide = replace(EXACT, blend="float32")
        lit = quads.render(FrameRequest(scene, camera, wide, edits=edits, highlight=Highlight()))
        quads.close()
        assert largest_error(image, lit) <= 0.5 / 255
    assert largest_error(image, plain) > 0.1


def test_nothing_is_done_again_when_nothing_changed(renderer, random_gaussians: Make):
    scene, camera = random_gaussians(200), camera_at(0, 0, 2.5)
    renderer.render(FrameRequest(scene, camera, EXACT))
    before = renderer.stats()
    first = renderer.read()
    renderer.render(FrameRequest(scene, camera_at(0, 0, 2.5), replace(EXACT, blend="float16")))
    white = renderer.render(FrameRequest(scene, camera, replace(EXACT, background=(1, 1, 1))))
    after = renderer.stats()
    assert (after.projected, after.sorted, after.drawn) == (before.projected, before.sorted, before.drawn)
    assert largest_error(white, first) > 0.3
    renderer.draw(FrameRequest(None, camera, replace(EXACT, early_stop=0.5)))
    assert renderer.stats().drawn == before.drawn + 1
    assert renderer.stats().projected == before.projected
    assert set(renderer.stats(wait=True).ms) == {"project", "sort", "draw"}


@pytest.mark.parametrize("mode", ["points", "ellipsoids", "depth", "overdraw"])
def test_other_modes_are_those_of_quads(renderer, random_gaussians: Make, mode):
    scene, camera = random_gaussians(200), camera_at(0, 0, 2.5)
    image = renderer.render(FrameRequest(scene, camera, EXACT, mode=mode))
    quads = QuadsRenderer(renderer._ctx)
    assert np.array_equal(
        image, quads.render(FrameRequest(scene, camera, replace(EXACT, blend="float32"), mode=mode))
    )
    quads.close()
    assert_true(renderer, scene, camera)


def test_draw_leaves_the_callers_framebuffer_bound(ctx, renderer, random_gaussians: Make):
    before = ctx.detect_framebuffer()
    mine = ctx.simple_framebuffer((8, 8))
    mine.use()
    renderer.render(FrameRequest(random_gaussians(50), camera_at(0, 0, 3), EXACT))
    assert ctx.detect_framebuffer().glo == mine.glo
    before.use()
    mine.release()


def test_older_gl_is_refused_in_one_line(ctx: moderngl.Context):
    class Old:
        version_code = 330

    with pytest.raises(InputError, match=r"tiles needs OpenGL 4\.3, this is 3\.3"):
        make_renderer("tiles", Old())  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("cramped", [False, True])
def test_very_many_splats_in_one_tile(ctx, random_gaussians: Make, cramped):
    # More than llvmpipe has patience for in one shader: it ends its loops after 65,535 iterations in all.
    count, alpha = 70_000, 1e-5
    renderer = TilesRenderer(ctx, tuning=replace(CRAMPED, tile=8) if cramped else None)
    one = random_gaussians(1)
    zeros = np.zeros(count, np.intp)
    scene = replace(
        one.take(zeros),
        means=np.zeros((count, 3), np.float32),
        log_scales=np.full((count, 3), 3, np.float32),
        opacity_logits=np.full(count, np.log(alpha / (1 - alpha)), np.float32),
    )
    settings = replace(EXACT, model=ImageModel(alpha_cut=0))
    image = renderer.render(FrameRequest(scene, camera_at(0, 0, 3, width=8, height=8), settings))
    assert np.allclose(image[..., 3], 1 - (1 - alpha) ** count, atol=5e-3)
    renderer.close()


def test_pictures_too_large_for_software_are_refused(ctx, random_gaussians: Make):
    tuning = replace(SOFTWARE, pairs=replace(SOFTWARE.pairs, most_tiles=4))
    renderer = TilesRenderer(ctx, tuning=tuning)
    with pytest.raises(InputError, match="tiles draws at most 0 megapixels without a GPU, not 33x32"):
        renderer.render(FrameRequest(random_gaussians(5), camera_at(0, 0, 2, width=33, height=32), EXACT))
    assert_true(renderer, random_gaussians(5), camera_at(0, 0, 2, width=32, height=32))
    renderer.close()
