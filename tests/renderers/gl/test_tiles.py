"""Tiles: pairs of tile and splat, their room, and every tuning, which gives the same pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import moderngl
import numpy as np
import pytest

from splatview.measure.metrics import largest_error, psnr
from splatview.renderers import VisualMode, make_renderer, on_this_gl
from splatview.renderers.gl.tiles import (
    HARDWARE,
    LEAST_PAIRS,
    SOFTWARE,
    TilesBlendPass,
    TilesRenderer,
    TileTuning,
)
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import TEXTBOOK, Camera, Gaussians, ImageModel, InputError, RenderSettings, look_at
from splatview.scene.edits import HIDDEN, SELECTED, SceneEdits
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
    return renderer._tiles.pairs.found


@pytest.mark.parametrize("tuning", ["hardware", "cramped"])
def test_every_tuning_gives_the_same_pictures(made, ctx, random_gaussians: Make, tuning):
    def compare(scene: Gaussians, camera: Camera, **edits: Any) -> None:
        pictures = [
            made[name].render(FrameRequest(scene, camera, EXACT, **edits)) for name in ("software", tuning)
        ]
        assert largest_error(*pictures) < 1e-4
        visible = [made[name].stats(wait=True).visible for name in ("software", tuning)]
        assert visible[0] == visible[1]

    for eye in ((0, 0.4, 3), (0.9, 0, 0.5), (0.1, 0.05, 0.1)):
        compare(random_gaussians(1500), camera_at(*eye))
    for width, height in ((1, 1), (17, 9), (130, 3), (16, 16), (33, 31)):
        compare(random_gaussians(300), camera_at(0, 0, 2, width=width, height=height))
    compare(random_gaussians(800), replace(camera_at(0, 0, 1.2), cx=-20.0, cy=80.0, fx=70.0, fy=45.0))
    for count in (1, 50, 0, 400):
        compare(random_gaussians(count), camera_at(0, 0, 2))
    heap = random_gaussians(3000)
    heap = replace(heap, means=np.zeros_like(heap.means), opacity_logits=np.full(3000, -3, np.float32))
    compare(heap, camera_at(0, 0, 2.5, width=40, height=30))
    for flag in (HIDDEN, SELECTED):
        marks = np.where(np.arange(400) % 3 == 0, flag, 0).astype(np.uint32)
        edits = SceneEdits(marks=marks, flags=HIDDEN | SELECTED)
        compare(random_gaussians(400), camera_at(0, 0, 2.2), edits=edits, highlight=Highlight())


@pytest.mark.parametrize("stop", [1e-4, 1e-2])
def test_early_stop_costs_at_most_its_transmittance(any_renderer, random_gaussians: Make, stop):
    scene, camera = random_gaussians(4000), camera_at(0, 0, 1.5)
    scene = replace(scene, opacity_logits=scene.opacity_logits + 3)
    image = any_renderer.render(FrameRequest(scene, camera, replace(EXACT, early_stop=stop)))
    exact = any_renderer.render(FrameRequest(scene, camera, EXACT))
    assert largest_error(image, exact) <= stop * max(exact[..., :3].max(), 4.0) + 1e-4
    if stop == 1e-2:
        assert largest_error(image, exact) > 0


@pytest.mark.parametrize("order", ["32-bit", "per-pixel"])
def test_what_the_target_held_is_of_no_account(renderer, random_gaussians: Make, order, monkeypatch):
    # Nor is it cleared as a framebuffer: zink defers that beyond the dispatches, and the picture is blank.
    scene, settings = random_gaussians(300), replace(EXACT, order=order)
    for count in (300, 2, 0):  # tiles without splats, too
        few = scene.take(np.arange(count))
        views = [FrameRequest(few, camera_at(0, 0, eye), settings) for eye in (3, 2.5)]
        truth = renderer.render(views[0])
        renderer.render(views[1])
        renderer._targets.accumulation.texture.write(np.full((45, 70, 4), 0.7, np.float32))
        with monkeypatch.context() as patch:
            patch.setattr(moderngl.Framebuffer, "clear", lambda *values, **more: None)
            assert np.array_equal(renderer.render(views[0]), truth)


@pytest.mark.parametrize("tile", [8, 32])
def test_tiles_of_other_sizes(ctx, random_gaussians: Make, tile):
    other = TilesRenderer(ctx, tuning=TileTuning(tile=tile, workgroup=32, batch=32))
    assert_true(other, random_gaussians(300), camera_at(0, 0.1, 1.5))
    other.close()


def test_bare_textbook_model(any_renderer, random_gaussians: Make):
    # No cut: every splat is in every tile.
    settings = replace(EXACT, model=TEXTBOOK)
    assert_true(any_renderer, random_gaussians(60), camera_at(0, 0, 2.5), settings)
    assert pairs(any_renderer) == 60 * 5 * 3


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


def test_giant_splats_over_all_tiles(any_renderer, random_gaussians: Make):
    scene = random_gaussians(200)
    scene = replace(scene, log_scales=scene.log_scales + 6, opacity_logits=np.full(200, -3, np.float32))
    assert_true(any_renderer, scene, camera_at(0, 0, 3))
    assert pairs(any_renderer) > 0.9 * 200 * 5 * 3


@pytest.mark.parametrize("rounds", [1, 3])
def test_all_pairs_have_room_at_once_after_a_jump_of_the_camera(ctx, random_gaussians: Make, rounds):
    most = 4 * LEAST_PAIRS if rounds == 1 else LEAST_PAIRS
    tuning = replace(SOFTWARE, tile=8, pairs=replace(SOFTWARE.pairs, most_pairs=most, most_rounds=rounds))
    renderer = TilesRenderer(ctx, tuning=tuning)
    scene = random_gaussians(1200)
    scene = replace(scene, log_scales=scene.log_scales + 1, opacity_logits=np.full(1200, -3.5, np.float32))
    far, near = (camera_at(0, 0, eye, width=160, height=120) for eye in (60, 0.9))
    assert_true(renderer, scene, far)
    made = renderer._tiles.pairs
    assert pairs(renderer) < made.capacity == LEAST_PAIRS
    assert_true(renderer, scene, near)
    assert pairs(renderer) > LEAST_PAIRS
    assert not made.leaves_over
    rest_first, rest_end, *placed = np.frombuffer(made.plan.read(), np.uint32)
    assert rest_first == rest_end
    used = -(-pairs(renderer) // made.capacity)
    assert used <= rounds
    # What lies behind the rounds in use was never written.
    assert sum(placed[:used]) == pairs(renderer)
    assert made.capacity > LEAST_PAIRS if rounds == 1 else made.capacity == LEAST_PAIRS
    renderer.close()


@pytest.mark.parametrize("order", ["32-bit", "per-pixel"])
def test_no_dispatch_walks_or_tries_more_splats_than_it_may(ctx, random_gaussians: Make, order, monkeypatch):
    # Both after a jump of the camera, and where splats are left over.
    scene, settings = random_gaussians(900), replace(EXACT, order=order)
    far, near = camera_at(0, 0, 60), camera_at(0.2, 0, 0.8)
    dispatches: list[tuple[bool, int]] = []
    real = TilesBlendPass._ready

    def ready(self: TilesBlendPass, mode: VisualMode, rest: bool, *given: Any) -> Any:
        program = real(self, mode, rest, *given)

        def count(x: int, y: int, z: int) -> None:
            assert program["u_most"].value <= self.tuning.most_walked
            dispatches.append((rest, x * y * z * program["u_most"].value))
            program.run(x, y, z)

        def count_indirect(buffer: moderngl.Buffer, offset: int) -> None:
            x, y, z = np.frombuffer(buffer.read(12, offset=offset), np.uint32).tolist()
            if x:
                count(x, y, z)

        return SimpleNamespace(get=program.get, run=count, run_indirect=count_indirect)

    pictures = []
    for room in (SOFTWARE.pairs, CRAMPED.pairs):
        tuning = replace(SOFTWARE, most_walked=64, most_tried=40_000, pairs=room)
        renderer = TilesRenderer(ctx, tuning=tuning)
        image = np.zeros(0)
        with monkeypatch.context() as patch:
            patch.setattr(TilesBlendPass, "_ready", ready)
            for view in (far, near):
                dispatches.clear()
                image = renderer.render(FrameRequest(scene, view, settings))
        pictures.append(image)
        tried = [work for rest, work in dispatches if rest]
        assert bool(tried) is (room is CRAMPED.pairs)
        assert all(work <= 40_000 for work in tried)
        assert len(dispatches) > 2
        renderer.close()
    if order == "32-bit":  # in its own order, a pixel holds splats back to the end of a part only
        truth = render_reference(scene, near, EXACT)
        assert all(psnr(image, truth) >= 80 for image in pictures)


def test_cramped_pictures_are_those_with_room(made, ctx, random_gaussians: Make):
    scene, camera = random_gaussians(900), camera_at(0.2, 0, 0.8)
    pictures = [
        made[name].render(FrameRequest(scene, camera, EXACT)) for name in ("software", "cramped", "hardware")
    ]
    assert pairs(made["cramped"]) > 900
    assert largest_error(pictures[0], pictures[1]) < 1e-5
    assert largest_error(pictures[0], pictures[2]) < 1e-5


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


def test_older_gl_is_refused_in_one_line(ctx: moderngl.Context):
    class Old:
        version_code = 330

    with pytest.raises(InputError, match=r"tiles cannot draw here: OpenGL is 3\.3, 4\.3 is needed"):
        make_renderer("tiles", Old())  # pyright: ignore[reportArgumentType]

    class Few:
        version_code = 450
        info: ClassVar = {"GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS": 7, "GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS": 0}

    with pytest.raises(InputError, match="a compute shader has 7 storage blocks, 8 are needed; use"):
        make_renderer("tiles", Few())  # pyright: ignore[reportArgumentType]
    assert on_this_gl("quads", Few()).name == "quads-gl33"  # pyright: ignore[reportArgumentType]


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
