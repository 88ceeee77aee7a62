"""On the GPU: orders that serve several frames, and that of the view itself at rest."""

from __future__ import annotations

import numpy as np
import pytest

from splatview import raster
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, RenderSettings, look_at
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits

ANEW = RenderSettings(blend="float32")


def at(degrees: float) -> Camera:
    angle = np.radians(degrees)
    eye = (3 * np.sin(angle), -0.3, -3 * np.cos(angle))
    return look_at(eye, (0, 0, 0), up=(0, -1, 0), width=48, height=32)


@pytest.fixture(params=[QuadsRenderer, TilesRenderer], ids=["quads", "tiles"])
def renderer(request, ctx, random_gaussians):
    made = request.param(ctx)
    made.load(random_gaussians(300, seed=6))
    yield made
    made.close()


def drawn(renderer, camera: Camera, settings: RenderSettings, edits: SceneEdits | None = None) -> np.ndarray:
    renderer.draw(FrameRequest(None, camera, settings, edits=edits))
    return renderer.read()


@pytest.mark.parametrize("order", ["32-bit", "16-bit"])
def test_frames_of_a_path_are_those_that_the_cpu_draws(renderer, random_gaussians, order):
    settings = RenderSettings(resort_frames=3, order=order, blend="float32")
    splats, workspace = raster.parameters_of(random_gaussians(300, seed=6)), raster.Workspace()
    depth_order = raster.ReusableOrder()
    picture, own = np.zeros(0), None
    for number in range(5):
        camera = at(10 * number)
        picture = drawn(renderer, camera, settings)
        assert renderer.busy == (number % 3 != 0)
        own = drawn(renderer, camera, RenderSettings(order=order, blend="float32")) if number == 4 else None
        cpu = raster.draw_frame(splats, camera, settings, workspace, depth_order=depth_order).image
        # The two round 16-bit keys differently, and cut alphas to the last digit.
        assert np.mean(np.abs(picture - cpu).max(axis=2) > 2e-3) < (0.01 if order == "32-bit" else 0.1)
    assert own is not None and np.abs(picture - own).max() > 1e-2, "another order is another picture"


def test_a_view_at_rest_has_its_own_order_and_is_drawn_no_more(renderer):
    settings = RenderSettings(resort_frames=100, blend="float32")
    drawn(renderer, at(0), settings)
    stale = drawn(renderer, at(20), settings)
    assert renderer.busy
    rested = drawn(renderer, at(20), settings)
    assert not renderer.busy
    count = renderer.stats().drawn
    drawn(renderer, at(20), settings)
    assert renderer.stats().drawn == count
    exact = drawn(renderer, at(20), ANEW)
    np.testing.assert_array_equal(rested, exact)
    assert np.abs(stale - exact).max() > 1e-2


def test_nothing_is_to_come_once_orders_are_kept_no_more(renderer):
    """Else a window would draw the same picture for ever."""
    settings = RenderSettings(resort_frames=100, blend="float32")
    for other in (ANEW, RenderSettings(blend="float32", order="16-bit")):
        drawn(renderer, at(0), settings)
        drawn(renderer, at(20), settings)
        assert renderer.busy
        drawn(renderer, at(20), other)
        assert not renderer.busy
    renderer.draw(FrameRequest(None, at(0), settings))
    renderer.draw(FrameRequest(None, at(20), settings))
    assert renderer.busy
    renderer.draw(FrameRequest(None, at(20), settings, mode="points"))
    assert not renderer.busy


def test_asked_to_forget_the_next_frame_is_sorted(renderer):
    settings = RenderSettings(resort_frames=100, blend="float32")
    drawn(renderer, at(0), settings)
    renderer.forget_order()
    picture = drawn(renderer, at(20), settings)
    np.testing.assert_array_equal(picture, drawn(renderer, at(20), ANEW))


def test_edits_move_splats_in_the_order_too(renderer, random_gaussians):
    marks = np.zeros(300, np.uint32)
    marks[:150] = 1 << PALETTE_SHIFT
    palette = (IDENTITY, Adjustment(translation=(0.0, 0.0, 0.7)))
    edits = SceneEdits(marks=marks, palette=palette, palette_version=1, marks_version=1)
    settings = RenderSettings(resort_frames=9, blend="float32")
    drawn(renderer, at(0), settings)
    picture = drawn(renderer, at(1), settings, edits)
    assert not renderer.busy
    np.testing.assert_array_equal(picture, drawn(renderer, at(1), ANEW, edits))


def test_orders_that_keep_nothing_hold_no_memory(renderer):
    drawn(renderer, at(0), ANEW)
    assert renderer._kept.order is None and not renderer._kept._buffers
