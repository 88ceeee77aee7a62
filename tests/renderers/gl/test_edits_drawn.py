"""What the GL renderers make of edits, against the truth: the reference's picture of the baked scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.measure.metrics import largest_error, psnr
from splatview.raster import Workspace
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.sort_thread import ViewLine, depth_order
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Camera, Gaussians, RenderSettings, look_at, reference
from splatview.scene.edits import (
    DELETED,
    HIDDEN,
    IDENTITY,
    LOCKED,
    PALETTE_SHIFT,
    PREVIEW,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    bake,
)
from splatview.scene.sh import rgb_to_sh

Make = Callable[..., Gaussians]
Renderer = QuadsRenderer | QuadsGL33Renderer

EXACT = RenderSettings(blend="float32", background=(0.1, 0.3, 0.2))
HERE = np.zeros(3)
FAR = np.array([1e6, -2e6, 3e5])
TURNED = (0.8, 0.36, -0.48, 0.0)
GRADE = ((0.5, 0.2, 0.0, 0.1), (0.0, 0.9, 0.1, -0.05), (0.3, 0.0, 0.4, 0.2))


@pytest.fixture(params=[QuadsRenderer, QuadsGL33Renderer, TilesRenderer], ids=["quads", "legacy", "tiles"])
def renderer(ctx: moderngl.Context, request: pytest.FixtureRequest) -> Iterator[Renderer]:
    if request.param is not QuadsGL33Renderer and ctx.version_code < 430:
        pytest.skip("needs OpenGL 4.3")
    made = request.param(ctx)
    yield made
    made.close()


def camera_at(place: np.ndarray = HERE, size: tuple[int, int] = (64, 48)) -> Camera:
    return look_at(place + np.array([0.5, -0.4, -2.4]), place, width=size[0], height=size[1])


def placed(scene: Gaussians, place: np.ndarray) -> Gaussians:
    return replace(scene, means=scene.means.astype(np.float64) + place) if place.any() else scene


def about(place: np.ndarray, adjustment: Adjustment) -> Adjustment:
    """`adjustment` with its rotation and scale about `place` instead of the origin."""
    shift = place - adjustment.linear @ place + np.array(adjustment.translation)
    return replace(adjustment, translation=tuple(shift.tolist()))


def every_kind(place: np.ndarray) -> tuple[Adjustment, ...]:
    kinds = (
        Adjustment(rotation=TURNED, scale=1.3, translation=(0.2, 0.0, 0.1)),
        Adjustment(size=0.6, opacity=(1.5, -0.1, 0.05, 0.9)),
        Adjustment(colour=GRADE),
        Adjustment(rotation=TURNED, scale=0.7, size=1.4, opacity=(0.5, 0.3, 0.0, 1.0), colour=GRADE),
    )
    return (IDENTITY, *(about(place, kind) for kind in kinds))


def some_crops(place: np.ndarray) -> tuple[Crop, ...]:
    def at(*offset: float) -> tuple[float, float, float]:
        x, y, z = (place + np.array(offset)).tolist()
        return (x, y, z)

    return (
        Crop(centre=at(0, 0, 0), half_extents=(0.8, 0.5, 0.9), rotation=TURNED),
        Crop(shape="sphere", centre=at(0.9, 0.1, 0), half_extents=(0.5, 0.3, 0.7)),
        Crop(shape="sphere", centre=at(0.2, 0, -0.2), half_extents=(0.3, 0.3, 0.4), keep="outside"),
        Crop(centre=at(-0.5, 0, 0), half_extents=(0.1, 0.4, 0.4), keep="outside", rotation=TURNED),
        Crop(half_extents=(9.0, 9.0, 9.0), keep="outside", enabled=False),
    )


def some_marks(count: int, adjustments: int, flags: tuple[int, ...] = (), seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    entries = rng.integers(0, adjustments, count).astype(np.uint32) << PALETTE_SHIFT
    return entries | rng.choice(np.array((0, 0, *flags), np.uint32), count)


def edits_of(kind: str, count: int, place: np.ndarray = HERE) -> SceneEdits:
    """Edits of one kind, or of "all" at once."""
    flags = (SELECTED, HIDDEN, DELETED, LOCKED, HIDDEN | DELETED, PREVIEW)
    palette = every_kind(place) if kind in ("adjusted", "all") else (IDENTITY,)
    hides = kind in ("hidden", "all")
    return SceneEdits(
        marks=some_marks(count, len(palette), flags if hides else ()),
        palette=palette,
        crops=some_crops(place) if kind in ("cropped", "all") else (),
        flags=31 if hides else 0,
    )


def assert_true(
    renderer: Renderer,
    scene: Gaussians,
    edits: SceneEdits,
    camera: Camera,
    settings: RenderSettings = EXACT,
    *,
    least: float = 80.0,
) -> np.ndarray:
    """Draws and compares, and makes sure that the edits show."""
    image = renderer.render(FrameRequest(scene, camera, settings, edits=edits))
    truth = reference.render(bake(scene, edits), camera, settings)
    assert np.isfinite(image).all()
    assert psnr(image, truth) >= least
    assert largest_error(image, truth) <= 4 / 255  # an alpha on the edge of the cut
    assert largest_error(reference.render(scene, camera, settings), truth) > 0.1
    return image


@pytest.mark.parametrize("place", [HERE, FAR], ids=["here", "far"])
@pytest.mark.parametrize("kind", ["hidden", "adjusted", "cropped", "all"])
def test_pictures_are_those_of_the_baked_scene(renderer, random_gaussians: Make, kind, place):
    scene = placed(random_gaussians(300), place)
    assert_true(renderer, scene, edits_of(kind, 300, place), camera_at(place))


def test_float16_pictures_too(renderer, random_gaussians: Make):
    settings = replace(EXACT, blend="float16")
    scene, edits = random_gaussians(300), edits_of("all", 300)
    assert_true(renderer, scene, edits, camera_at(), settings, least=50)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_every_degree_turns(renderer, random_gaussians: Make, degree):
    scene = random_gaussians(200, sh_degree=degree)
    assert_true(renderer, scene, edits_of("adjusted", 200), camera_at())
    asked = replace(EXACT, sh_degree=degree)
    assert_true(renderer, random_gaussians(200), edits_of("adjusted", 200), camera_at(), asked)


def test_more_adjustments_than_a_row_of_texels_holds(renderer, random_gaussians: Make):
    rng = np.random.default_rng(4)
    moves = [Adjustment(translation=tuple(rng.normal(0, 0.5, 3).tolist())) for _ in range(700)]
    edits = SceneEdits(marks=np.arange(1, 701, dtype=np.uint32) << PALETTE_SHIFT, palette=(IDENTITY, *moves))
    assert_true(renderer, random_gaussians(700), edits, camera_at())


def test_a_scene_moved_far_away_keeps_its_digits(renderer, random_gaussians: Make):
    # The float32 scene is at the origin; only the adjustment takes it away, and the eye with it.
    near = random_gaussians(200)
    scene = replace(near, means=near.means.astype(np.float64))
    away = Adjustment(rotation=TURNED, translation=tuple(FAR.tolist()))
    edits = SceneEdits(marks=np.full(200, 1 << PALETTE_SHIFT, np.uint32), palette=(IDENTITY, away))
    image = assert_true(renderer, scene, edits, camera_at(FAR))
    assert image[..., 3].max() > 0.5


@pytest.mark.parametrize("attribute", ["means", "quats", "log_scales", "opacity_logits", "sh"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_ill_splats_stay_culled_whatever_is_done_to_them(renderer, random_gaussians: Make, attribute, bad):
    scene = random_gaussians(150)
    values = getattr(scene, attribute).copy()
    values[::4].reshape(38, -1)[:, -1] = bad
    ill = replace(scene, **{attribute: values})
    # This map would make a shown splat of one whose opacity is no number.
    palette = (*every_kind(HERE), Adjustment(opacity=(0.0, 0.6, 0.0, 1.0)))
    edits = SceneEdits(
        marks=some_marks(150, len(palette)), palette=palette, crops=some_crops(HERE)[2:], flags=0
    )
    assert_true(renderer, ill, edits, camera_at())


def test_opacity_zero_and_one(renderer, random_gaussians: Make):
    scene = random_gaussians(60)
    palette = (IDENTITY, Adjustment(opacity=(0, 0, 0, 1)), Adjustment(opacity=(0, 1, 0, 1)))
    edits = SceneEdits(marks=some_marks(60, 3), palette=palette)
    assert_true(renderer, scene, edits, camera_at())


def test_no_edits_cost_nothing(renderer, random_gaussians: Make):
    scene, camera = random_gaussians(200), camera_at()
    plain = renderer.render(FrameRequest(scene, camera, EXACT))
    none = SceneEdits(marks=np.zeros(200, np.uint32))
    same = renderer.render(FrameRequest(scene, camera, EXACT, edits=none, highlight=Highlight()))
    assert np.array_equal(plain, same)
    assert renderer.stats().drawn == 1
    assert renderer._edits.marks_uploaded == 0
    with pytest.raises(RuntimeError, match="reserve"):
        _ = renderer._edits._marks.texture


def counters(renderer: Renderer) -> tuple[int, int, int]:
    stats = renderer.stats()
    return stats.projected, stats.sorted, stats.drawn


def test_a_selection_is_only_drawn_anew(renderer, random_gaussians: Make):
    scene, camera, highlight = random_gaussians(200), camera_at(), Highlight()
    marks = np.zeros(200, np.uint32)
    marks[7] = DELETED
    edits = SceneEdits(marks=marks, flags=DELETED | SELECTED)
    first = renderer.render(FrameRequest(scene, camera, EXACT, edits=edits, highlight=highlight))
    assert counters(renderer) == (1, 1, 1)

    marks[10:60] = SELECTED
    edits = replace(edits, marks_version=1, changes=((1, 10, 60),))
    lit = renderer.render(FrameRequest(scene, camera, EXACT, edits=edits, highlight=highlight))
    assert counters(renderer) == (1, 1, 2)
    assert np.array_equal(lit[..., 3], first[..., 3])
    assert largest_error(lit, first) > 0.1
    # Without a tint there is nothing to draw it for.
    plain = renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert np.array_equal(plain, first)
    drawn = counters(renderer)
    marks[70:80] = LOCKED
    edits = replace(edits, marks_version=2, changes=((1, 10, 60), (2, 70, 80)))
    renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert counters(renderer) == drawn

    marks[20] |= HIDDEN
    edits = replace(edits, marks_version=3, changes=((3, 20, 21),), flags=31)
    renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert counters(renderer)[0] == 2


def test_a_change_of_colours_needs_no_new_order_where_the_order_is_a_thread_s(ctx, random_gaussians: Make):
    renderer = QuadsGL33Renderer(ctx)
    scene, camera = random_gaussians(100), camera_at()
    marks = np.full(100, 1 << PALETTE_SHIFT, np.uint32)
    try:
        for gain in (0.5, 0.7):
            grade = Adjustment(opacity=(gain, 0.0, 0.0, 1.0))
            edits = SceneEdits(marks=marks, palette=(IDENTITY, grade), crops=some_crops(HERE)[:1])
            assert_true(renderer, scene, edits, camera)
        assert (renderer.stats().projected, renderer.stats().sorted) == (2, 1)
        moved = SceneEdits(marks=marks, palette=(IDENTITY, Adjustment(rotation=(0.0, 1.0, 0.0, 0.0))))
        assert_true(renderer, scene, moved, camera)
        assert renderer.stats().sorted == 2
    finally:
        renderer.close()


def test_only_what_changed_is_uploaded(renderer, random_gaussians: Make):
    scene, camera = random_gaussians(9000, sh_degree=0), camera_at(size=(24, 16))
    marks = np.zeros(9000, np.uint32)
    edits = SceneEdits(marks=marks, flags=DELETED)

    def uploaded(version: int, changes: tuple, start: int, stop: int) -> int:
        nonlocal edits
        marks[start:stop] ^= DELETED
        edits = replace(edits, marks_version=version, changes=changes)
        before = renderer._edits.marks_uploaded
        image = renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
        left = scene.take(np.flatnonzero(marks == 0))
        assert largest_error(image, reference.render(left, camera, EXACT)) <= 2e-3
        return renderer._edits.marks_uploaded - before

    renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert uploaded(1, ((1, 5, 6),), 5, 6) == 1
    # From the middle of one row of texels over two whole ones into a fourth.
    assert uploaded(2, ((1, 5, 6), (2, 2000, 8500)), 2000, 8500) == 6500
    assert uploaded(3, ((3, 4000, 4096),), 4000, 4096) == 96
    assert uploaded(9, ((9, 0, 1),), 100, 3000) == 9000  # some changes are not told
    # The same marks in an array of their own need no upload; other marks do.
    edits, before = replace(edits, marks=marks.copy(), marks_version=0), renderer._edits.marks_uploaded
    renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert renderer._edits.marks_uploaded == before


def test_undoing_everything_gives_the_first_picture_back(renderer, random_gaussians: Make):
    scene, camera = random_gaussians(200), camera_at()
    plain = renderer.render(FrameRequest(scene, camera, EXACT))
    edits = edits_of("all", 200)
    edited = renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert np.array_equal(plain, renderer.render(FrameRequest(scene, camera, EXACT)))
    assert np.array_equal(edited, renderer.render(FrameRequest(scene, camera, EXACT, edits=edits)))
    edits.marks[:] = 0
    nothing = SceneEdits(marks=edits.marks, marks_version=1, flags=31)
    assert np.array_equal(plain, renderer.render(FrameRequest(scene, camera, EXACT, edits=nothing)))


def test_edits_of_another_scene_are_refused_and_forgotten_on_load(renderer, random_gaussians: Make):
    scene = random_gaussians(100)
    assert_true(renderer, scene, edits_of("hidden", 100), camera_at())
    with pytest.raises(ValueError, match="100 marks for a scene of 50 splats"):
        renderer.render(FrameRequest(random_gaussians(50), camera_at(), EXACT, edits=edits_of("hidden", 100)))
    assert_true(renderer, random_gaussians(120, seed=5), edits_of("all", 120), camera_at())


STRAIGHT = look_at((0, 0, -4), (0, 0, 0), width=65, height=49)


@pytest.mark.parametrize("mode", ["splats", "points", "ellipsoids"])
@pytest.mark.parametrize(
    ("mark", "expected"),
    [
        (0, (0, 1, 0)),
        (SELECTED, (0.5, 0.75, 0)),
        (SELECTED | LOCKED, (0.5, 0.75, 0)),
        (LOCKED | 1 << PALETTE_SHIFT, (0, 0, 1)),
        (PREVIEW | SELECTED, (0.25, 0.75, 0)),
    ],
)
def test_marked_splats_are_lit_up(renderer, mode, mark, expected):
    scene = Gaussians(
        means=np.zeros((2, 3), np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        log_scales=np.full((2, 3), np.log(0.3), np.float32),
        opacity_logits=np.array([9, -9], np.float32),
        sh=rgb_to_sh(np.array([[0, 1, 0], [0, 0, 0]], np.float32)).reshape(2, 1, 3),
    )
    highlight = Highlight(selected=(1.0, 0.5, 0.0, 0.5), locked=(0, 0, 1, 1), preview=(1, 0, 0, 0.25))
    marks = np.array([mark, SELECTED | LOCKED | PREVIEW], np.uint32)  # the second cannot be seen
    edits = SceneEdits(marks=marks, flags=SELECTED | LOCKED | PREVIEW)
    for shown, colour in ((highlight, expected), (None, (0, 1, 0))):
        image = renderer.render(
            FrameRequest(
                scene, STRAIGHT, RenderSettings(blend="float32"), mode=mode, edits=edits, highlight=shown
            )
        )
        np.testing.assert_allclose(image[24, 32, :3] / image[24, 32, 3], colour, atol=0.02)


def test_depth_and_overdraw_are_not_tinted(renderer, random_gaussians: Make):
    scene = random_gaussians(50)
    edits = SceneEdits(marks=np.full(50, SELECTED, np.uint32), flags=SELECTED)
    for mode in ("depth", "overdraw"):
        plain = renderer.render(FrameRequest(scene, camera_at(), EXACT, mode=mode))
        drawn = renderer.stats().drawn
        lit = renderer.render(
            FrameRequest(scene, camera_at(), EXACT, mode=mode, edits=edits, highlight=Highlight())
        )
        assert np.array_equal(plain, lit)
        assert renderer.stats().drawn == drawn


@pytest.mark.parametrize("mode", ["points", "ellipsoids", "depth", "overdraw"])
def test_every_mode_shows_edits(renderer, random_gaussians: Make, mode):
    # The colours of depths span all splats, shown or not.
    edits = edits_of("adjusted" if mode == "depth" else "all", 200)
    scene, camera = random_gaussians(200), camera_at()
    edited = renderer.render(FrameRequest(scene, camera, EXACT, mode=mode, edits=edits))
    baked = renderer.render(FrameRequest(bake(scene, edits), camera, EXACT, mode=mode))
    assert psnr(edited, baked) >= 45
    assert psnr(edited, renderer.render(FrameRequest(scene, camera, EXACT, mode=mode))) < 30


def test_the_first_of_several_marks_counts():
    highlight = Highlight(selected=(0, 1, 0, 0.5), preview=(1, 0, 0, 0.5), locked=(0, 0, 1, 0))
    table = highlight.table
    assert highlight.flags == PREVIEW | SELECTED
    assert table[SELECTED].tolist() == [0, 1, 0, 0.5]
    assert table[SELECTED | PREVIEW | HIDDEN].tolist() == [1, 0, 0, 0.5]
    assert not table[LOCKED].any()
    assert table[LOCKED | SELECTED].tolist() == [0, 1, 0, 0.5]
    assert not table[[0, HIDDEN, DELETED, HIDDEN | DELETED]].any()


def test_the_threads_order_is_that_of_the_baked_scene(random_gaussians: Make):
    scene = random_gaussians(5000)
    palette = every_kind(HERE)
    edits = SceneEdits(marks=some_marks(5000, len(palette)), palette=palette)
    line = ViewLine.of(camera_at(), edits, places="moved")
    baked = depth_order(bake(scene, edits).means.astype(np.float64), ViewLine.of(camera_at()), Workspace())
    found = depth_order(scene.means, line, Workspace())
    depths = (bake(scene, edits).means - camera_at().eye) @ camera_at().forward
    # Bake rounds means to float32: splats may only have changed places with their like.
    np.testing.assert_allclose(depths[found.order], depths[baked.order], atol=1e-6)
    assert abs(found.before_eye - baked.before_eye) <= 1
    assert line != ViewLine.of(camera_at())
    # Marks that are newer than the palette do no harm.
    edits.marks[0] = 99 << PALETTE_SHIFT
    assert sorted(depth_order(scene.means, line, Workspace()).order) == list(range(5000))
