"""Camera and image model as the shaders take them; everything that cancels is formed in float64 here."""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl
import numpy as np

from ...scene import Camera, RenderSettings

Uniform = float | int | tuple[float, ...] | tuple[tuple[float, ...], ...]


def view_uniforms(camera: Camera, settings: RenderSettings, centre: np.ndarray) -> dict[str, Uniform]:
    """Uniforms of ``common/projection.glsl``; `centre` (3,) float64 is what positions are relative to."""
    model = settings.model
    eye = camera.eye - centre
    high = eye.astype(np.float32)
    low = (eye - high).astype(np.float32)
    size = np.array([camera.width, camera.height], dtype=np.float64)
    focal = np.array([camera.fx, camera.fy])
    principal = np.array([camera.cx, camera.cy])
    if model.jacobian_margin is None:
        limits = np.array([-np.inf, -np.inf, np.inf, np.inf])
    else:
        margin = model.jacobian_margin * size / (2 * focal)
        limits = np.concatenate([-principal / focal - margin, (size - principal) / focal + margin])
    limits = np.clip(limits, np.finfo(np.float32).min, np.finfo(np.float32).max)
    return {
        # moderngl takes matrices column by column
        "u_camera_from_world": tuple(camera.R_camera_world.T.ravel()),
        "u_eye_high": tuple(high.tolist()),
        "u_eye_low": tuple(low.tolist()),
        "u_focal": (camera.fx, camera.fy),
        "u_principal": (camera.cx, camera.cy),
        "u_size": (float(camera.width), float(camera.height)),
        "u_ray_limits": tuple(limits.tolist()),
        "u_near": model.near,
        "u_blur": model.blur,
        "u_alpha_cut": model.alpha_cut,
        "u_least_share": 0.0 if settings.sigma_cut is None else math.exp(-0.5 * settings.sigma_cut**2),
        "u_max_alpha": model.max_alpha,
    }


def set_uniforms(program: moderngl.Program | moderngl.ComputeShader, values: Mapping[str, Uniform]) -> None:
    """Sets those of `values` that `program` has: compilers drop uniforms a variant does not use."""
    for name, value in values.items():
        uniform = program.get(name, None)
        if isinstance(uniform, moderngl.Uniform):
            uniform.value = value
