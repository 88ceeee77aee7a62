"""Camera and image model as the shaders take them; everything that cancels is formed in float64 here."""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl
import numpy as np

from splatview.scene import Camera, RenderSettings
from splatview.scene.surfels import check_surfels

Uniform = float | int | tuple[float, ...] | tuple[tuple[float, ...], ...]

ORTHOGRAPHIC = "u_orthographic"
"""No uniform of any program: a flag decides."""

LENS_REACH = "u_lens_reach"

SHARPNESS = "u_sharpness"

HALF_LOG2_E = 0.5 * math.log2(math.e)

MOST_SHARPNESS = 1e30
"""1/px²: of a blur of 0."""

LARGEST = float(np.finfo(np.float32).max)


def view_uniforms(camera: Camera, settings: RenderSettings, centre: np.ndarray) -> dict[str, Uniform]:
    """Uniforms of ``common/projection.glsl``; `centre` (3,) float64 is what positions are relative to."""
    model = settings.model
    eye = camera.eye - centre
    with np.errstate(over="ignore", invalid="ignore"):  # an eye beyond float32 sees nothing
        high = eye.astype(np.float32)
        low = (eye - high).astype(np.float32)
    check_surfels(camera, model)
    limits = np.clip(camera.slope_limits(model.jacobian_margin), -LARGEST, LARGEST)
    rays: dict[str, Uniform] = {ORTHOGRAPHIC: camera.orthographic}
    if camera.lens is not None:
        form = camera.lens.form
        rays |= {
            "u_lens_bend": (form.slope, form.unit),
            "u_lens_unified": (form.alpha, form.beta),
            "u_lens_stretch": (form.n1, form.n2, form.n3),
            "u_lens_higher": (form.n4, form.n5, form.n6),
            "u_lens_divide": (form.d1, form.d2, form.d3),
            "u_lens_skew": (form.p1, form.p2),
            "u_lens_prism": (form.s1, form.s2, form.s3, form.s4),
            "u_lens_skew_last": form.skew_last,
            LENS_REACH: min(form.valid_radius_squared, LARGEST),
        }
    if model.footprint == "disc":
        sharpness = HALF_LOG2_E / model.blur if model.blur > 0 else math.inf
        rays |= {SHARPNESS: min(sharpness, MOST_SHARPNESS), "u_perspective": float(not camera.orthographic)}
    return {
        **rays,
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


def ray_flags(uniforms: Mapping[str, Uniform]) -> dict[str, bool]:
    """The flags of ``common/projection.glsl`` for the camera that `view_uniforms` were made of."""
    return {
        "LENS": LENS_REACH in uniforms,
        "ORTHOGRAPHIC": bool(uniforms[ORTHOGRAPHIC]),
        **disc_flags(uniforms),
    }


def disc_flags(uniforms: Mapping[str, Uniform]) -> dict[str, bool]:
    """The flag of shaders that only draw: whether `view_uniforms` were made for flat splats."""
    return {"DISCS": SHARPNESS in uniforms}


def set_uniforms(program: moderngl.Program | moderngl.ComputeShader, values: Mapping[str, Uniform]) -> None:
    """Sets those of `values` that `program` has: compilers drop uniforms a variant does not use."""
    for name, value in values.items():
        uniform = program.get(name, None)
        if isinstance(uniform, moderngl.Uniform):
            uniform.value = value
