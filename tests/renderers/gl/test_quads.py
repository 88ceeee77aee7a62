"""Quads on GL 4.3: what is done again and what is not, and what its numbers say."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.measure.metrics import psnr
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.background import Gradient
from splatview.scene.reference import render as render_reference

Make = Callable[..., Gaussians]

BACKGROUND = (0.2, 0.5, 0.1)
EXACT = RenderSettings(blend="float32", background=BACKGROUND)


@pytest.fixture
def renderer(ctx: moderngl.Context) -> Iterator[QuadsRenderer]:
    made = QuadsRenderer(ctx)
    yield made
    made.close()


def camera_at(*eye: float, width: int = 96, height: int = 64) -> Camera:
    return look_at(eye, (0.0, 0.0, 0.0), width=width, height=height)


def test_a_target_that_blends_float16_itself(renderer, random_gaussians: Make):
    # What a GPU does; llvmpipe truncates where GPUs round, so its bound here is the looser one.
    renderer._targets.truncates = False
    image = renderer.render(
        FrameRequest(random_gaussians(1500), camera_at(0, 0.4, 3), replace(EXACT, blend="float16"))
    )
    truth = render_reference(random_gaussians(1500), camera_at(0, 0.4, 3), EXACT)
    assert psnr(image, truth) >= 40


def test_an_early_stop_is_a_transmittance(renderer):
    with pytest.raises(ValueError, match="early_stop"):
        renderer.early_stop = 1.0


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
    for background in (Gradient(top=(0, 0.2, 1), bottom=(1, 0.4, 0), up=(0, 0, 1)), (1.0, 1.0, 1.0)):
        image = renderer.render(FrameRequest(scene, camera, replace(EXACT, background=background)))
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
