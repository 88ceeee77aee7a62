"""Depth orders of the GL renderers: coarser keys, and no order at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.metrics import psnr
from splatview.renderers.gl.project import short_keys
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.scene_buffers import finite_box
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings, look_at

CAMERA = look_at((0.4, -0.6, -2.4), (0, 0, 0), up=(0, -1, 0), width=96, height=80)
EXACT = RenderSettings(blend="float32", early_stop=0.0)


@pytest.fixture
def quads(ctx):
    renderer = QuadsRenderer(ctx)
    yield renderer
    renderer.close()


def test_16_bit_keys_are_the_same_for_tiles(ctx, quads, random_gaussians):
    scene, tiles = random_gaussians(3000, seed=5), TilesRenderer(ctx)
    coarse = [
        renderer.render(FrameRequest(scene, CAMERA, replace(EXACT, order="16-bit")))
        for renderer in (quads, tiles)
    ]
    assert psnr(*coarse) > 60
    tiles.close()


@pytest.mark.parametrize("ends", [(0.01, 30.0), (1.0, 1.0), (2.0, 2.0000002), (1e-3, 1e30)])
def test_short_keys_keep_the_order_of_depths(ends):
    least, greatest = ends
    keys = short_keys(least, greatest, 16)
    depths = np.sort(np.random.default_rng(1).uniform(least, greatest, 1000).astype(np.float32))
    made = ((depths.view(np.uint32) | 0x80000000).astype(np.int64) - keys.base) >> keys.shift
    assert (np.diff(made) >= 0).all()
    assert made[0] >= 0
    assert made[-1] < 1 << 16


def test_pictures_by_chance_are_right_on_average_and_always_the_same(quads, random_gaussians):
    scene = random_gaussians(500, seed=2)
    exact = quads.render(FrameRequest(scene, CAMERA, EXACT))
    by_chance = replace(EXACT, order="stochastic")
    image = quads.render(FrameRequest(scene, CAMERA, by_chance))
    assert set(np.unique(image[..., 3])) == {0, 1}
    assert 3 < psnr(image, exact) < 30
    mean = image.reshape(10, 8, 12, 8, 4).mean(axis=(1, 3)) - exact.reshape(10, 8, 12, 8, 4).mean(axis=(1, 3))
    assert np.sqrt(np.mean(mean**2)) < 0.08, "blocks of 64 chances"
    assert np.abs(mean.mean(axis=(0, 1))).max() < 0.02
    quads.render(FrameRequest(scene, CAMERA, EXACT))
    np.testing.assert_array_equal(quads.render(FrameRequest(scene, CAMERA, by_chance)), image)


def test_a_background_shows_where_chance_leaves_nothing(quads, random_gaussians):
    settings = replace(EXACT, order="stochastic", background=(0.0, 0.5, 0.0))
    image = quads.render(FrameRequest(random_gaussians(50), CAMERA, settings))
    empty = image[..., 3] == 0
    assert empty.any()
    np.testing.assert_allclose(image[empty][:, :3], [[0, 0.5, 0]] * int(empty.sum()), atol=1e-6)


def test_weighted_sums_let_the_right_light_through(quads, random_gaussians):
    scene, weighted = random_gaussians(500, seed=2), replace(EXACT, order="weighted")
    exact, image = (
        quads.render(FrameRequest(scene, CAMERA, EXACT)),
        quads.render(FrameRequest(scene, CAMERA, weighted)),
    )
    np.testing.assert_allclose(image[..., 3], exact[..., 3], atol=1e-5)
    assert 15 < psnr(image, exact) < 50
    single = scene.take(np.flatnonzero(scene.opacity_logits > 1)[:1])
    np.testing.assert_allclose(
        quads.render(FrameRequest(single, CAMERA, weighted)),
        quads.render(FrameRequest(single, CAMERA, EXACT)),
        atol=1e-5,
    )


def test_weights_favour_what_is_nearer(quads):
    def sheets(near_red: bool) -> Gaussians:
        z = np.array([-0.5, 0.5], np.float32) if near_red else np.array([0.5, -0.5], np.float32)
        return Gaussians(
            means=np.stack([0 * z, 0 * z, z], axis=1),
            quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
            log_scales=np.tile(np.float32(np.log([0.8, 0.8, 0.01])), (2, 1)),
            opacity_logits=np.array([3, 3], np.float32),
            sh=np.array([[[1.5, -1.5, -1.5]], [[-1.5, 1.5, -1.5]]], np.float32),
        )

    camera = look_at((0, 0, -3), (0, 0, 0), up=(0, -1, 0), width=32, height=32)
    for near_red in (True, False):
        red, green, *_ = quads.render(
            FrameRequest(sheets(near_red), camera, replace(EXACT, order="weighted"))
        )[16, 16]
        assert (red > 0.8 and green < 0.1) if near_red else (green > 0.8 and red < 0.1)


@pytest.mark.parametrize("order", ["16-bit", "weighted", "stochastic"])
def test_other_modes_keep_the_exact_order(quads, random_gaussians, order):
    scene = random_gaussians(300)
    pictures = [
        quads.render(FrameRequest(scene, CAMERA, settings, mode="depth"))
        for settings in (EXACT, replace(EXACT, order=order))
    ]
    np.testing.assert_array_equal(*pictures)


def test_the_box_is_of_what_is_finite():
    means = np.array([[0, 1, 2], [np.nan, 9, 9], [-1, 3, 0], [np.inf, 0, 0]], np.float32)
    np.testing.assert_array_equal(finite_box(means), [[-1, 1, 0], [0, 3, 2]])
    np.testing.assert_array_equal(finite_box(means[1:2]), np.zeros((2, 3)))
