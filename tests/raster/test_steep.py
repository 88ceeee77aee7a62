"""Derivatives that are more than float32 holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatview.raster import Parameters, Workspace, draw_frame, parameters_of
from splatview.raster.gradients import differentiate
from splatview.scene import Camera, Gaussians, RenderSettings


def gradients_of(quat: tuple[float, float, float, float]) -> Parameters:
    """Of a steep random loss, for a bar far longer than the picture, turned by `quat`, in parallel rays."""
    splat = Gaussians(
        means=np.array([[-0.26, 0.68, 0.12]], np.float32),
        quats=np.array([quat], np.float32),
        log_scales=np.array([[-4.3, 44.0, -2.7]], np.float32),
        opacity_logits=np.array([-1.57], np.float32),
        sh=np.full((1, 1, 3), 0.5, np.float32),
    )
    camera = Camera(width=16, height=16, fx=4, fy=4, cx=8, cy=8, world_to_camera=np.eye(4))
    parameters = parameters_of(splat)
    frame = draw_frame(parameters, replace(camera, orthographic=True), RenderSettings(), Workspace())
    d_image = 1e12 * np.random.default_rng(0).normal(size=frame.image.shape).astype(np.float32)
    return differentiate(parameters, frame, d_image).parameters


def test_a_tiny_quaternions_gradient_is_large_but_finite() -> None:
    """By a quaternion 1e30 times as short the derivative is 1e30 times as steep."""
    usual = gradients_of((1.0, 1.0, 1.0, 1.0)).quats
    tiny = gradients_of((1e-30, 1e-30, 1e-30, 1e-30)).quats
    assert np.isfinite(usual).all()
    assert np.isfinite(tiny).all()
    steep = np.abs(usual).astype(np.float64) * 1e30 > np.finfo(np.float32).max
    assert steep.any(), "else this shows nothing"
    assert (np.abs(tiny[steep]) == np.finfo(np.float32).max).all()
    assert (np.sign(tiny) == np.sign(usual)).all()
