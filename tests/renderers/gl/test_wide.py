"""Far out and far apart: positions keep float64's digits in every renderer, and cost nothing where they need
not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview import raster
from splatview.measure.metrics import psnr
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.scene_buffers import SceneBuffers, placement_of, upload_steps
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings, concatenate, look_at
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.reference import render as render_reference

Render = Callable[[Gaussians, Camera, RenderSettings], np.ndarray]

FAR = (1e7, -2e7, 3e6)
"""World units; float32 has steps of 1 and 2 there."""

SAME_AT_ORIGIN = 45.0
"""dB, at least. Found are over 100 in float32: what is left is the rounding of the same formulas."""

FLOAT16, FLOAT32 = RenderSettings(), RenderSettings(blend="float32")


def eye(shift: Any = (0, 0, 0)) -> Camera:
    shift = np.array(shift, np.float64)
    return look_at(shift + np.array((0.5, -0.4, 2.5)), shift, width=64, height=48)


def moved(scene: Gaussians, shift: Any) -> Gaussians:
    return replace(scene, means=scene.means.astype(np.float64) + shift)


def apart(scene: Gaussians, distance: float) -> Gaussians:
    """The scene twice."""
    return concatenate([moved(scene, (0, 0, 0)), moved(scene, (distance, 0, 0))])


@pytest.fixture(params=["quads", "tiles", "legacy", "cpu", "reference"])
def render(request: pytest.FixtureRequest) -> Iterator[Render]:
    if request.param in ("cpu", "reference"):
        yield {"cpu": raster.render, "reference": render_reference}[request.param]
        return
    made = {"quads": QuadsRenderer, "tiles": TilesRenderer, "legacy": QuadsGL33Renderer}
    renderer = made[request.param](request.getfixturevalue("ctx"))
    yield lambda *picture: renderer.render(FrameRequest(*picture))
    renderer.close()


@pytest.mark.parametrize("settings", [FLOAT16, FLOAT32], ids=["float16", "float32"])
def test_ten_thousand_kilometres_away_it_is_the_same_picture(
    render: Render, settings: RenderSettings, random_gaussians, tmp_path: Path
):
    scene = random_gaussians(600)
    here = render(scene, eye(), settings)
    there = moved(scene, FAR)
    path = tmp_path / "far.ply"
    save_scene(there, path)
    loaded = load_scene(path)
    assert loaded.means.dtype == np.float64  # the file has doubles
    assert np.array_equal(loaded.means, there.means)
    for far in (there, loaded):
        assert psnr(render(far, eye(FAR), settings), here) >= SAME_AT_ORIGIN


@pytest.mark.parametrize("distance", [2e4, 3e5])
def test_halves_far_apart_are_both_sharp(render: Render, distance: float, random_gaussians):
    scene = apart(random_gaussians(300), distance)
    for shift in ((0, 0, 0), (distance, 0, 0)):
        camera = eye(shift)
        error = np.abs(render(scene, camera, FLOAT32) - render_reference(scene, camera, FLOAT32))
        assert error.max() <= 2e-3


def test_wide_is_what_float32_would_blur(random_gaussians):
    scene = random_gaussians(1000)

    def wide(scene: Gaussians) -> bool:
        return placement_of(scene.means, scene.log_scales).wide

    assert not wide(scene)
    assert not wide(moved(scene, (0, 0, 0)))
    assert not wide(moved(scene, FAR))  # near its centre all digits are there
    assert not wide(apart(scene, 100))
    assert wide(apart(scene, 2e4))
    assert not wide(replace(apart(scene, 2e4), log_scales=np.full((2000, 3), 3, np.float32)))
    lost = replace(scene, means=scene.means.astype(np.float64))
    lost.means[:3] = 1e15 + 0.3
    assert not wide(lost)
    nothing = np.full((5, 3), np.nan)
    assert not placement_of(nothing, nothing).wide
    # What float32 can hold is no reason, however far it reaches.
    assert not wide(replace(apart(scene, 2e4), means=apart(scene, 2e4).means.astype(np.float32)))


def test_other_scenes_pay_nothing(ctx, random_gaussians):
    for scene, row in ((random_gaussians(300), 12), (apart(random_gaussians(150), 2e4), 24)):
        *_, buffers = upload_steps(ctx, scene)
        assert isinstance(buffers, SceneBuffers)
        assert buffers.pages[0].positions.size == 300 * row
        assert buffers.flags()["WIDE"] is (row == 24)
        buffers.release()
    renderer = QuadsGL33Renderer(ctx)
    renderer.load(random_gaussians(300))
    assert renderer._scene is not None and renderer._scene.rests is None
    renderer.close()


def test_what_is_not_finite_stays_so(random_gaussians):
    means = apart(random_gaussians(4), 2e4).means
    means[0, 0], means[1, 1], means[2, 2] = np.nan, np.inf, 1e300
    high, rest = placement_of(means).split(means)
    assert np.isnan(high[0, 0]) and np.isinf(high[1, 1]) and np.isinf(high[2, 2])
    assert np.isfinite(rest).all()
