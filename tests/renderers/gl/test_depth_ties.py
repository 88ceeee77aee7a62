"""Splats closer in depth than float32 tells apart: the CPU rasteriser keeps their order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatview import raster
from splatview.measure.hard_cases.run import ambiguity_at, unexplained_pixels
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.effects.report import sorting_effect
from splatview.scene.projection import project
from splatview.scene.reference import render as render_reference

SETTINGS = RenderSettings(blend="float32")
COLUMNS, ROWS = 8, 5


def tied_pairs() -> tuple[Gaussians, Camera]:
    """A red and a green splat at each of 40 places in a plane across an oblique view: what tells their
    depths apart is only how their coordinates were rounded."""
    camera = look_at((2.1, 1.3, -3.7), (0, 0, 0), width=120, height=80)
    right, down, _ = camera.world_to_camera[:3, :3]
    u, v = np.meshgrid(np.linspace(-1.6, 1.6, COLUMNS), np.linspace(-1, 1, ROWS))
    places = u.reshape(-1, 1) * right + v.reshape(-1, 1) * down
    nudges = np.random.default_rng(4).uniform(-0.02, 0.02, (2 * len(places), 2))
    means = np.repeat(places, 2, axis=0) + nudges[:, :1] * right + nudges[:, 1:] * down
    count = len(means)
    sh = np.zeros((count, 1, 3), np.float32)
    sh[0::2, 0], sh[1::2, 0] = (1.7, -1.7, -1.7), (-1.7, 1.7, -1.7)
    scene = Gaussians(
        means=means.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(0.05), np.float32),
        opacity_logits=np.full(count, 2.0, np.float32),
        sh=sh,
    )
    return scene, camera


def test_pairs_are_tied_in_float32_and_not_in_float64():
    scene, camera = tied_pairs()
    depths = project(scene, camera, SETTINGS).depths
    gaps = np.abs(depths[0::2] - depths[1::2]) / depths[0::2]
    assert (gaps > 0).mean() > 0.5
    assert (gaps < 3e-7).all()


def test_the_cpu_rasteriser_keeps_the_order_of_float64():
    scene, camera = tied_pairs()
    image = raster.render(scene, camera, SETTINGS)
    np.testing.assert_allclose(image, render_reference(scene, camera, SETTINGS), atol=1e-4)


def test_what_quads_draws_otherwise_is_explained_by_ties(ctx):
    scene, camera = tied_pairs()
    truth = render_reference(scene, camera, SETTINGS)
    renderer = QuadsRenderer(ctx)
    try:
        image = renderer.render(FrameRequest(scene, camera, SETTINGS))
    finally:
        renderer.close()
    unexplained, _ = unexplained_pixels(image, truth, scene, camera, SETTINGS, bound=1e-3)
    assert not unexplained
    footprints = project(scene, camera, SETTINGS)
    error = np.abs(image - truth)[..., :3].max(axis=2)
    for y, x in zip(*np.nonzero(error > 0.1), strict=True):
        assert ambiguity_at(footprints, int(x), int(y), SETTINGS, slack=1e-6).depth_ties == 1


def test_the_report_tells_of_pairs_that_only_float64_orders(ctx):
    scene, _ = tied_pairs()
    means = np.round(scene.means.astype(np.float64), 2)
    means[1::2] = means[0::2] - (0, 0, 1e-9)  # the later one of each pair is in front
    deep = replace(scene, means=means)
    camera = look_at((0, 0, -4), (0, 0, 0), width=120, height=80)
    truth = render_reference(deep, camera, SETTINGS)
    np.testing.assert_allclose(raster.render(deep, camera, SETTINGS), truth, atol=1e-4)
    renderer = QuadsRenderer(ctx)
    try:
        image = renderer.render(FrameRequest(deep, camera, SETTINGS))
    finally:
        renderer.close()
    assert np.abs(image - truth).max() > 0.3
    assert "; 40 overlapping pairs" in sorting_effect(deep).why
