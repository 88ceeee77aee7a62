"""Sort and bins against plain numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview import raster
from splatview.raster.parameters import TILE
from splatview.raster.project import LOG2_OPACITY, X_REST, Y_REST, A, B, C, X, Y
from splatview.raster.sort import DepthKeys, keyed_values, radix_sort
from splatview.scene import Gaussians, RenderSettings, look_at


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("bits", [1, 8, 11, 12, 23, 32])
@pytest.mark.parametrize("count", [0, 1, 2, 100, 40_000])
def test_radix_sort_is_stable(count, bits, threads, monkeypatch):
    monkeypatch.setattr("splatview.raster.sort.PARALLEL_FROM", 1000)
    keys = np.random.default_rng(count).integers(0, 1 << bits, count).astype(np.uint32)
    values = np.arange(count, dtype=np.int32)
    expected = np.argsort(keys, kind="stable")
    order = radix_sort(keyed_values(keys, values), bits, threads, raster.Workspace())
    assert np.array_equal(order, expected)


@given(st.lists(st.floats(-1e30, 1e30), min_size=2, max_size=50))
@settings(max_examples=200, deadline=None)
def test_keys_keep_the_order_of_depths(depths):
    values = np.sort(np.array(depths) + 0.0)  # -0 becomes 0, which sorting takes for the same
    base, shift, bits = DepthKeys.spanning(values[0], values[-1])
    ordered = values.view(np.int64) ^ ((values.view(np.int64) >> 63) & 0x7FFFFFFFFFFFFFFF)
    keys = [(int(value) - base) >> shift for value in ordered]
    assert keys == sorted(keys)
    assert keys[0] >= 0
    assert keys[-1] < 1 << bits <= 1 << 32


def test_keys_tell_apart_what_float32_does_not():
    depths = np.array([3.0, 3.00000001, 7.0])
    assert np.float32(depths[0]) == np.float32(depths[1])
    base, shift, _ = DepthKeys.spanning(depths[0], depths[2])
    first, second, _ = ((int(bits) - base) >> shift for bits in depths.view(np.int64))
    assert first < second


def draw(scene, camera, threads=2):
    return raster.draw_frame(
        raster.parameters_of(scene), camera, RenderSettings(), raster.Workspace(), threads=threads
    )


def smallest_form(record, left, top, width, height) -> float:
    """The least value of the quadratic form over the pixel centres of a tile, by trying them all."""
    x, y = np.meshgrid(np.arange(left, min(left + TILE, width)), np.arange(top, min(top + TILE, height)))
    dx, dy = x + 0.5 - float(record[X]), y + 0.5 - float(record[Y])
    return float(((record[A] * dx + record[B] * dy) ** 2 + (record[C] * dy) ** 2).min())


@pytest.mark.parametrize("stretch", [0.0, 2.0])
def test_every_tile_that_shows_a_splat_lists_it(random_gaussians, stretch):
    """And few besides: by boxes alone, lists of needles would be several times as long."""
    scene = random_gaussians(300, seed=2)
    scene = replace(scene, log_scales=scene.log_scales + np.array([stretch, 0, 0], np.float32))
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=150, height=90)
    frame = draw(scene, camera)
    bins, view = frame.bins, frame.view
    listed = {
        (tile, int(splat))
        for tile in range(view.tiles_x * view.tiles_y)
        for splat in frame.lists[bins.offsets[tile] : bins.offsets[tile + 1]]
    }
    needed = set()
    for splat in bins.order:
        record = frame.records[splat, : LOG2_OPACITY + 1].astype(np.float64)
        for tile in range(view.tiles_x * view.tiles_y):
            left, top = tile % view.tiles_x * TILE, tile // view.tiles_x * TILE
            form = smallest_form(record, left, top, view.width, view.height)
            if record[LOG2_OPACITY] - form >= view.log2_cut:
                needed.add((tile, int(splat)))
    assert needed <= listed
    assert len(listed) <= 1.15 * len(needed)


@pytest.mark.parametrize("size", [(1280, 720), (8000, 160)])
def test_needles_far_from_the_corner_are_listed(size):
    """What spans round in float32 is within their margin: no tile that shows a splat is without it."""
    rng, count = np.random.default_rng(3), 300
    log_scales = np.column_stack([rng.uniform(0, 4, count), rng.uniform(-12, -5, (count, 2))])
    scene = Gaussians(
        means=rng.uniform(-3, 3, (count, 3)).astype(np.float32) * np.array([1, 1, 0.5], np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=log_scales.astype(np.float32),
        opacity_logits=rng.uniform(-4, 6, count).astype(np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )
    frame = draw(scene, look_at((0, 0, -6), (0, 0, 0), width=size[0], height=size[1]))
    offsets, view = frame.bins.offsets, frame.view
    tiles = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    listed, needed = set(zip(tiles.tolist(), frame.lists.tolist(), strict=True)), set()
    shown = np.sort(frame.bins.order)[:80]
    for splat in shown:
        record = frame.records[splat].astype(np.float64)
        dx = np.arange(size[0]) + 0.5 - (record[X] + record[X_REST])
        dy = (np.arange(size[1]) + 0.5 - (record[Y] + record[Y_REST]))[:, None]
        form = (record[A] * dx + record[B] * dy) ** 2 + (record[C] * dy) ** 2
        y, x = np.nonzero(record[LOG2_OPACITY] - form >= view.log2_cut)
        needed |= {(tile, int(splat)) for tile in (y // TILE * view.tiles_x + x // TILE).tolist()}
    assert needed <= listed
    assert len([tile for tile, splat in listed if splat in shown]) <= 1.02 * len(needed)


def test_lists_are_in_depth_order(random_gaussians):
    scene = random_gaussians(4000, sh_degree=0, seed=4)
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=150, height=90)
    frame = draw(scene, camera)
    depths = (scene.means - camera.eye) @ camera.forward
    assert np.array_equal(np.sort(frame.bins.order), np.flatnonzero(np.isin(np.arange(4000), frame.lists)))
    for start, end in zip(frame.bins.offsets[:-1], frame.bins.offsets[1:], strict=True):
        assert (np.diff(depths[frame.lists[start:end]]) >= 0).all()


def test_pieces_do_not_change_the_lists(random_gaussians):
    scene = random_gaussians(6000, sh_degree=0, seed=4)
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=150, height=90)
    one, many = draw(scene, camera, threads=1), draw(scene, camera, threads=6)
    assert len(many.bins.pieces) > len(one.bins.pieces)
    assert np.array_equal(one.lists, many.lists)
