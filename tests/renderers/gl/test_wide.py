"""Far out and far apart: where positions need float64's digits, and that they cost nothing elsewhere."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.scene_buffers import SceneBuffers, placement_of, upload_steps
from splatview.scene import Gaussians, concatenate

FAR = (1e7, -2e7, 3e6)
"""World units; float32 has steps of 1 and 2 there."""


def moved(scene: Gaussians, shift: Any) -> Gaussians:
    return replace(scene, means=scene.means.astype(np.float64) + shift)


def apart(scene: Gaussians, distance: float) -> Gaussians:
    """The scene twice."""
    return concatenate([moved(scene, (0, 0, 0)), moved(scene, (distance, 0, 0))])


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
