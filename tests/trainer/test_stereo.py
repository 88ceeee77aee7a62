"""Points by stereo, of photos whose surfaces are known; kernels beside slow numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.raster.simd import LANES
from splatview.scene import Lens
from splatview.scene.camera import look_at
from splatview.scene.lens import undistort
from splatview.scene.progress import Cancelled, Progress
from splatview.trainer import stereo_kernels as kernels
from splatview.trainer.setup import settings_for, start_points
from splatview.trainer.stereo import (
    CELLS,
    _matched,
    _pieces,
    _through,
    contracted,
    stereo_points,
    thinned,
)
from splatview.trainer.views import TrainView, TrainViews

from .conftest import capture_of

SIZE = (72, 60)


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(..., 3) uint8 of places on a plane: many waves, so that no piece is like another."""
    rng = np.random.default_rng(2)
    value = np.zeros((*np.shape(x), 3))
    for _ in range(60):
        way, phase = rng.normal(0, 5, 2), rng.uniform(0, 6, 3)
        value += np.sin((way[0] * x + way[1] * y)[..., None] + phase)
    return np.clip(127 + 18 * value, 0, 255).astype(np.uint8)


def photo_of_plane(eye: tuple[float, float, float], lens: Lens | None = None) -> TrainView:
    """What is seen of the plane z = 0 from `eye`, each pixel at its centre."""
    camera = replace(look_at(eye, (0, 0, 0), width=SIZE[0], height=SIZE[1]), lens=lens)
    v, u = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    slopes = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1)
    if lens is not None:
        slopes = undistort(slopes, lens)
    rays = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
    ways = rays @ camera.world_to_camera[:3, :3]
    places = camera.eye - ways * (camera.eye[2] / ways[..., 2:])
    return TrainView(camera, texture(places[..., 0], places[..., 1]))


@pytest.fixture(scope="module")
def photos() -> list[TrainView]:
    return [photo_of_plane((0.5 * i - 1, 0.2 * (i % 2), -3)) for i in range(5)]


@pytest.fixture
def around(rng) -> np.ndarray:
    """Points in a ball about what is seen, as captures without points have them."""
    return rng.uniform(-1, 1, (500, 3))


def test_points_lie_on_the_surface_and_have_its_colours(photos, around):
    points, colours = stereo_points(photos, around)
    assert len(points) > 0.12 * len(photos) * SIZE[0] * SIZE[1], (
        "away from the rim, and where two others look"
    )
    # A hundredth of the distance: planes are 0.02 apart there, and parabolas find places between them.
    off = np.abs(points[:, 2])
    assert np.median(off) < 0.01 and np.quantile(off, 0.99) < 0.03
    expected = texture(points[:, 0], points[:, 1]).astype(int)
    assert np.median(np.abs(colours.astype(int) - expected)) < 12
    again = stereo_points(photos, around, threads=1)
    np.testing.assert_array_equal(again[0], points)
    np.testing.assert_array_equal(again[1], colours)


FAR = 27.0
"""z of what stands behind the plane z = 0 in some photos."""


def photo_of_two_planes(eye: tuple[float, float, float]) -> TrainView:
    """The plane z = 0 where x < 0, and z = FAR beside it, whose texture is as fine to the eye; looked at side
    by side."""
    camera = look_at(eye, (0.9 * eye[0], eye[1], 0), width=3 * SIZE[0], height=3 * SIZE[1])
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    slopes = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    ways = slopes @ camera.world_to_camera[:3, :3]
    front, back = (camera.eye + ways * ((z - camera.eye[2]) / ways[..., 2:]) for z in (0.0, FAR))
    near, far = texture(front[..., 0], front[..., 1]), texture(back[..., 0] / 10, back[..., 1] / 10)
    return TrainView(camera, np.where(front[..., :1] < 0, near, far))


def test_depths_that_no_point_tells(photos):
    points, _ = stereo_points(photos, None)
    assert len(points) > 0.12 * len(photos) * SIZE[0] * SIZE[1]
    off = np.abs(points[:, 2])
    assert np.median(off) < 0.01 and np.quantile(off, 0.98) < 0.03


def test_near_and_far_surfaces_where_no_point_tells(rng):
    views = [photo_of_two_planes((0.5 * i - 1.5, 0.2 * (i % 2), -3)) for i in range(7)]
    points, colours = stereo_points(views, None)
    near, far = np.abs(points[:, 2]) < 0.05, np.abs(points[:, 2] - FAR) < 3
    assert near.sum() > 1000 and far.sum() > 1000
    assert (near | far).mean() > 0.9
    again = stereo_points(views, None, threads=1)
    np.testing.assert_array_equal(again[0], points)
    np.testing.assert_array_equal(again[1], colours)
    # By points of the near plane alone the far one has no depth.
    known = np.c_[rng.uniform(-1, 1, (500, 2)), rng.uniform(-0.1, 0.1, 500)]
    assert not (np.abs(stereo_points(views, known)[0][:, 2] - FAR) < 3).any()


def test_depths_are_looked_for_about_where_they_were_seen(rng):
    edges, shape = np.array([1.0, 4.0, 16.0, 64.0]), (60, 90)
    places = np.c_[rng.uniform(0, 90, 400), rng.uniform(0, 60, 400)]
    depths = np.where(places[:, 0] < 30, 2.0, 30.0)
    found = _pieces(np.c_[depths, places], edges, shape)
    assert found.shape == (3, CELLS, CELLS) and found.any(axis=0).all(), "something everywhere"
    for z, (u, v) in zip(depths, places, strict=True):
        row, column = int(v * CELLS / 60), int(u * CELLS / 90)
        about = found[:, max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        assert about[0 if z == 2 else 2].all()
    assert found[0, :, 0].all() and not found[0, :, -1].any() and not found[2, :, 0].any()
    assert not found[1].any() and not _pieces(np.empty((0, 3)), edges, shape).any()
    near_the_edge = _pieces(np.array([[3.9, 45.0, 30.0]]), edges, shape)
    assert near_the_edge[0].all() and near_the_edge[1].all() and not near_the_edge[2].any()


def test_cameras_in_one_place_find_no_depths(photos):
    here = [replace(view, camera=photos[0].camera) for view in photos]
    assert len(stereo_points(here, None)[0]) == 0


@given(st.floats(0.01, 1e3), st.floats(0, 1e6), st.floats(0, 1e6))
def test_far_places_are_drawn_in_by_their_order(unit, one, other):
    way = np.array([0.6, 0.0, -0.8])
    places = contracted(np.array([one, other])[:, None] * way + (5, 6, 7), np.array([5.0, 6.0, 7.0]), unit)
    found = places @ way
    np.testing.assert_allclose(places, found[:, None] * way, atol=1e-6 * (1 + unit))
    assert (found <= 2 * unit * (1 + 1e-9)).all()
    assert (found[0] - found[1]) * (one - other) >= -1e-9 * (1 + unit)
    for distance, now in zip((one, other), found, strict=True):
        if distance <= unit:
            assert now == pytest.approx(distance, abs=1e-6 * (1 + unit))


def test_what_is_masked_or_transparent_gives_no_points(photos, around):
    left = np.arange(SIZE[0]) < SIZE[0] // 2
    mask = np.broadcast_to(~left, SIZE[::-1]).copy()
    masked = [TrainView(view.camera, view.pixels, mask=mask) for view in photos]
    clear = [
        TrainView(view.camera, view.pixels, alpha=np.where(mask, 255, 40).astype(np.uint8)) for view in photos
    ]
    whole = len(stereo_points(photos, around)[0])
    for views in (masked, clear):
        points, _ = stereo_points(views, around)
        assert 0.1 * whole < len(points) < 0.8 * whole
    nothing = [TrainView(view.camera, view.pixels, mask=np.zeros(SIZE[::-1], bool)) for view in photos]
    assert len(stereo_points(nothing, around)[0]) == 0


def test_photos_that_show_nothing_alike_give_next_to_none(photos, around, rng):
    noise = [
        TrainView(view.camera, rng.integers(0, 256, view.pixels.shape).astype(np.uint8)) for view in photos
    ]
    flat = [TrainView(view.camera, np.full_like(view.pixels, 90)) for view in photos]
    assert len(stereo_points(noise, around)[0]) < 0.002 * len(photos) * SIZE[0] * SIZE[1]
    assert len(stereo_points(flat, around)[0]) == 0


def test_too_few_photos_or_none_that_fit_give_none(photos, around):
    for views in ([], photos[:1], photos[:2]):
        points, colours = stereo_points(views, around)
        assert points.shape == colours.shape == (0, 3)
    behind = around - (0, 0, 50)
    assert len(stereo_points(photos, behind)[0]) == 0


def test_it_can_be_cancelled(photos, around):
    shares: list[float] = []
    progress = Progress(report=shares.append, cancelled=lambda: len(shares) >= 2)
    with pytest.raises(Cancelled):
        stereo_points(photos, around, threads=1, progress=progress)
    assert len(shares) < len(photos) and shares == sorted(shares)


def test_scores_are_correlations_of_windows(photos, rng):
    """Beside float64, at places drawn by chance; one source, so that nothing is averaged."""
    first, second = photos[1], photos[2]
    grey, other = (np.rint(view.pixels.mean(axis=2)).astype(np.float32) for view in (first, second))
    own = _matched(replace(first, pixels=np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)), grey.size)
    rotations, offsets = _through(first.camera, [second.camera])
    flat, width = np.empty_like(own.grey), grey.shape[1]
    work = flat, flat.copy(), np.empty((3, width + LANES), np.float32), np.empty((len(grey), 2), np.int32)
    kernels.plane_scores(
        *(own.grey, own.sums, own.deviation, width, own.spans, kernels.pieces_of(other)[None]),
        *(rotations, offsets, 1 / 3.1, *work, scores := flat.copy()),
    )
    scores = scores[:-LANES].reshape(grey.shape)
    compared = 0
    for y, x in zip(rng.integers(3, SIZE[1] - 3, 60), rng.integers(3, SIZE[0] - 3, 60), strict=True):
        rows, columns = np.mgrid[y - 3 : y + 4, x - 3 : x + 4]
        at = (
            np.stack([columns + 0.5, rows + 0.5, np.ones(rows.shape)], axis=-1) @ rotations[0].T
            + offsets[0] / 3.1
        )
        u, v = at[..., 0] / at[..., 2] - 0.5, at[..., 1] / at[..., 2] - 0.5
        if not (u.min() >= 0 and v.min() >= 0 and u.max() < SIZE[0] - 1 and v.max() < SIZE[1] - 1):
            assert scores[y, x] == -1
            continue
        left, top = np.floor(u).astype(int), np.floor(v).astype(int)
        s, t = u - left, v - top
        above = (1 - s) * other[top, left] + s * other[top, left + 1]
        below = (1 - s) * other[top + 1, left] + s * other[top + 1, left + 1]
        seen = (1 - t) * above + t * below
        expected = np.corrcoef(seen.ravel(), grey[rows, columns].ravel())[0, 1]
        # Places in float32 are known to 4e-6 px, grey levels to 1e-5 of their range.
        assert scores[y, x] == pytest.approx(expected, abs=2e-4)
        compared += 1
    assert compared > 20


def test_the_best_of_the_planes(rng):
    """Beside a loop over pixels, in rows that vectors do not divide; what is outside of spans stays."""
    depths = np.linspace(0.2, 0.5, 9).astype(np.float32)
    height, width = 6, 37
    scores = rng.uniform(-1, 1, (len(depths), height, width)).astype(np.float32)
    scores[rng.uniform(size=scores.shape) < 0.2] = -1
    spans = np.zeros((2, height, 2), np.int32)
    spans[0] = [(0, 37), (3, 4), (5, 21), (0, 0), (20, 37), (7, 36)]
    flat = np.append(scores.ravel(), np.full(LANES, 5, np.float32))
    found, confidence = (np.full(height * width + LANES, 9, np.float32) for _ in range(2))
    kernels.best_planes(flat, depths, width, spans, found, confidence)
    found, confidence = (out[:-LANES].reshape(height, width) for out in (found, confidence))
    clear = 0
    for y, x in np.ndindex(height, width):
        if not spans[0, y, 0] <= x < spans[0, y, 1]:
            assert found[y, x] == confidence[y, x] == 9
            continue
        column = scores[:, y, x].astype(np.float64)
        best = int(column.argmax())
        rivals = column[np.abs(np.arange(len(column)) - best) > kernels.AWAY]
        inner = 0 < best < len(column) - 1
        is_clear = inner and column[best] - rivals.max() > kernels.CLEAR
        assert confidence[y, x] == (scores[best, y, x] if is_clear else -1)
        place = 0.0
        if inner and min(column[best - 1], column[best + 1]) > -1:
            low, high = column[best - 1], column[best + 1]
            place = np.clip(0.5 * (low - high) / (low - 2 * column[best] + high), -0.5, 0.5)
        # A parabola of scores in float32, whose differences may be small.
        expected = np.interp(best, range(len(depths)), depths) + place * (depths[1] - depths[0])
        assert found[y, x] == pytest.approx(expected, abs=1e-5)
        clear += is_clear
    assert clear > 20


def test_spans_hold_all_windows_with_texture(rng):
    """Beside every window one by one; two pieces, so that a gap is within a span, and rows with nothing."""
    textured = np.zeros((40, 50), bool)
    textured[5:9, 10:13] = textured[7:20, 30:41] = True
    textured &= rng.random(textured.shape) < 0.7
    middles, covered = kernels.spans_of(textured)
    for y, row in enumerate(textured):
        assert textured[y, slice(*middles[y])].sum() == row.sum() and (row.any() or not middles[y].any())
        near = np.argwhere(textured[max(y - kernels.RADIUS, 0) : y + kernels.RADIUS + 1])[:, 1]
        expected = (near.min() - kernels.RADIUS, near.max() + kernels.RADIUS + 1) if len(near) else (0, 0)
        assert tuple(covered[y]) == expected
    assert not kernels.spans_of(np.zeros((9, 9), bool)).any()


def test_surfaces_of_an_object_before_nothing_are_those_of_the_whole_picture(photos, around):
    """What is transparent is not looked at, and changes nothing of what is."""
    opaque = [replace(view, alpha=np.full(view.pixels.shape[:2], 255, np.uint8)) for view in photos]
    half = np.full(photos[0].pixels.shape[:2], 255, np.uint8)
    half[:, : SIZE[0] // 2] = 0
    cut = [replace(view, alpha=half) for view in photos]
    whole, part = (stereo_points(views, around)[0] for views in (opaque, cut))
    kept = {tuple(point) for point in part.round(9)} & {tuple(point) for point in whole.round(9)}
    assert 0 < len(part) < len(whole) and len(kept) > 0.95 * len(part)


def test_a_pixel_is_where_the_other_camera_sees_its_place(rng):
    first = look_at((1, 0.2, -3), (0, 0, 0), width=80, height=60)
    second = look_at((-0.5, 0.4, -2.5), (0, 0.1, 0), width=70, height=50)
    (rotation,), (offset,) = _through(first, [second])
    for _ in range(20):
        u, v, depth = rng.uniform(0, 80), rng.uniform(0, 60), rng.uniform(1, 6)
        local = depth * np.array([(u - first.cx) / first.fx, (v - first.cy) / first.fy, 1, 1 / depth])
        there = second.world_to_camera @ np.linalg.inv(first.world_to_camera) @ local
        expected = (second.fx * there[0] / there[2] + second.cx, second.fy * there[1] / there[2] + second.cy)
        found = rotation @ (u, v, 1) + offset / depth
        np.testing.assert_allclose(found[:2] / found[2], expected, rtol=1e-9)
        np.testing.assert_allclose(found[2] * depth, there[2], rtol=1e-9)


@settings(max_examples=30, deadline=None)
@given(count=st.integers(1, 3000), limit=st.integers(1, 500), seed=st.integers(0, 99))
def test_thinned_points_are_some_of_the_points_and_no_more_than_asked_for(count, limit, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    colours = rng.integers(0, 256, (count, 3)).astype(np.uint8)
    kept, theirs = thinned(points, colours, limit, seed)
    assert len(kept) <= limit and len(np.unique(kept, axis=0)) == len(kept)
    known = {point.tobytes(): colour.tobytes() for point, colour in zip(points, colours, strict=True)}
    assert all(known[p.tobytes()] == c.tobytes() for p, c in zip(kept, theirs, strict=True))


def test_lone_points_are_left_out(rng):
    surface = rng.uniform(-1, 1, (4000, 3)) * (1, 1, 0)
    stray = rng.uniform(-1, 1, (60, 3))
    points = np.concatenate([surface, stray])
    kept, _ = thinned(points, np.zeros((len(points), 3), np.uint8), 600)
    assert len(kept) > 300 and np.mean(np.abs(kept[:, 2]) > 1e-9) < 0.01


def test_photos_through_a_lens_give_points_on_the_surface(around):
    lens = Lens(model="OPENCV", parameters=(-0.15, 0.02, 0.002, -0.001))
    bent = [photo_of_plane((0.5 * i - 1, 0.2 * (i % 2), -3), lens) for i in range(5)]
    points, _ = stereo_points(bent, around)
    assert len(points) > 1500
    off = np.abs(points[:, 2])
    assert np.median(off) < 0.012 and np.quantile(off, 0.99) < 0.04


def test_where_splats_begin_is_what_the_setting_says(photos, rng):
    own = rng.uniform(-1, 1, (300, 3)), rng.integers(0, 256, (300, 3)).astype(np.uint8)
    views = TrainViews(photos, 0)

    def begun(start: str, *, guessed: bool, used: TrainViews = views) -> tuple[np.ndarray, list[str]]:
        capture = capture_of(photos, *own, guessed=guessed)
        notes: list[str] = []
        recipe = settings_for(capture, views, iterations=10, start=start)
        points, colours = start_points(capture, used, recipe, on_note=notes.append)
        assert len(points) == len(colours) <= recipe.max_splats + len(own[0])
        return points, notes

    for start, guessed in (("points", True), ("points", False), ("auto", False)):
        points, notes = begun(start, guessed=guessed)
        assert points is own[0] and not notes
    points, notes = begun("auto", guessed=True)
    assert np.median(np.abs(points[:, 2])) < 0.01 and "by stereo" in notes[0]
    both, notes = begun("stereo", guessed=False)
    assert len(both) > 5 * len(own[0]) and np.array_equal(both[: len(own[0])], own[0])
    assert np.median(np.abs(both[len(own[0]) :, 2])) < 0.01
    flat = TrainViews([TrainView(view.camera, np.full_like(view.pixels, 90)) for view in photos], 0)
    points, notes = begun("auto", guessed=True, used=flat)
    assert points is own[0] and "too few" in notes[0] and "300 random points" in notes[0]
    with pytest.raises(ValueError, match="start must be"):
        begun("sfm", guessed=True)
