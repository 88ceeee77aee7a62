"""The image model in plain torch, dense and slow: what autograd makes of it is the truth for gradients.

Every splat is evaluated at every pixel. Culled splats and the order of depths are decided once, without
gradient, by `scene.projection`; all else is differentiable.
"""

from __future__ import annotations

import numpy as np
import torch

from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.lens_formula import (
    LEAST_RADIUS_SQUARED,
    LEAST_RHO_SQUARED,
    LensForm,
    lens_jacobian,
    lens_point,
)
from splatview.scene.projection import project
from splatview.scene.sh import SH_C0, SH_C1, SH_C2, SH_C3


def render(
    means: torch.Tensor,
    quats: torch.Tensor,
    log_scales: torch.Tensor,
    opacity_logits: torch.Tensor,
    sh: torch.Tensor,
    camera: Camera,
    settings: RenderSettings,
    background: torch.Tensor,
    pose: torch.Tensor | None = None,
) -> torch.Tensor:
    """The picture (H, W, 4) in the dtype of the parameters, shapes as in `Gaussians`; background (3,).

    `pose` (6,), zeros, lets gradients by a small motion of the camera be taken: see `raster.gradients`.
    """
    dtype = means.dtype
    model = settings.model
    order = torch.from_numpy(_visible(means, quats, log_scales, opacity_logits, sh, camera, settings))
    means, quats, log_scales = means[order], quats[order], log_scales[order]
    opacity_logits, sh = opacity_logits[order], sh[order]

    W = torch.tensor(camera.R_camera_world, dtype=dtype)
    eye = torch.tensor(camera.eye, dtype=dtype)
    if pose is not None:
        shift, turn = pose[:3], pose[3:]
        eye = eye - W.T @ shift
        W = W + torch.linalg.cross(turn.expand(3, 3), W.T, dim=1).T
    offsets = means - eye
    t = offsets @ W.T
    J = _jacobians(t, camera, model.jacobian_margin)
    M = J @ W @ rotation_matrices(quats) * log_scales.exp()[:, None, :]
    m0, m1 = M.unbind(1)
    xy, xx, yy = (m0 * m1).sum(1), (m0 * m0).sum(1), (m1 * m1).sum(1)
    unblurred = torch.linalg.cross(m0, m1).square().sum(1)
    det = unblurred + model.blur * (xx + yy) + model.blur**2
    yy = yy + model.blur
    a = (yy / det).sqrt()
    b, c = -xy / yy * a, yy.rsqrt()
    opacities = opacity_logits.sigmoid()
    if model.antialiased:
        opacities = opacities * (unblurred / det).sqrt()
    directions = (
        W[2].expand(len(t), 3) if camera.orthographic else offsets / offsets.norm(dim=1, keepdim=True)
    )
    colours = (0.5 + sh_sum(sh, directions, settings)).clamp_min(0)

    px, py = torch.meshgrid(
        torch.arange(camera.width, dtype=dtype) + 0.5,
        torch.arange(camera.height, dtype=dtype) + 0.5,
        indexing="xy",
    )
    mean_x, mean_y = _image_points(t, camera)
    dx, dy = px.reshape(1, -1) - mean_x[:, None], py.reshape(1, -1) - mean_y[:, None]
    q = (a[:, None] * dx + b[:, None] * dy) ** 2 + (c[:, None] * dy) ** 2
    alpha = (opacities[:, None] * (-q / 2).exp()).clamp_max(model.max_alpha)
    alpha = torch.where(alpha >= model.alpha_cut, alpha, 0)
    light = torch.cat([torch.ones_like(px.reshape(1, -1)), (1 - alpha).cumprod(0)])
    colour = (alpha * light[:-1]).T @ colours + light[-1][:, None] * background
    picture = torch.cat([colour, 1 - light[-1][:, None]], dim=1)
    return picture.reshape(camera.height, camera.width, 4)


def _magnifications(form: LensForm, u: torch.Tensor, v: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """r, g and g_r of `scene.lens_formula`."""
    r = (u * u + v * v).clamp_min(LEAST_RADIUS_SQUARED).sqrt()
    if form.alpha:
        rho = (1 + form.beta * r * r).clamp_min(LEAST_RHO_SQUARED).sqrt()
        g = 1 / (1 - form.alpha + form.alpha * rho)
        return r, g, g * g * (1 - form.alpha + form.alpha / rho)
    if not form.slope:
        return r, torch.ones_like(r), torch.ones_like(r)
    return (
        r,
        (form.slope * r).atan() / (form.unit * r),
        form.slope / (form.unit * (1 + (form.slope * r) ** 2)),
    )


def _image_points(t: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """px, of camera points (V, 3)."""
    x, y, z = t.unbind(1)
    u, v = (x, y) if camera.orthographic else (x / z, y / z)
    if camera.lens is not None:
        _, g, _ = _magnifications(camera.lens.form, u, v)
        u, v = lens_point(camera.lens.form, u, v, g)
    return camera.fx * u + camera.cx, camera.fy * v + camera.cy


def _jacobians(t: torch.Tensor, camera: Camera, margin: float | None) -> torch.Tensor:
    """J (V, 2, 3) of the projection at camera points (V, 3)."""
    x, y, z = t.unbind(1)
    zero, one = torch.zeros_like(z), torch.ones_like(z)
    focal = torch.tensor([camera.fx, camera.fy], dtype=t.dtype)[:, None]
    if camera.orthographic:
        return focal * torch.eye(3, dtype=t.dtype)[:2].expand(len(t), 2, 3)
    u_min, v_min, u_max, v_max = camera.slope_limits(margin)
    u, v = (x / z).clamp(u_min, u_max), (y / z).clamp(v_min, v_max)
    rows = torch.stack([one, zero, -u, zero, one, -v], dim=1).reshape(-1, 2, 3) / z[:, None, None]
    if camera.lens is not None:
        form = camera.lens.form
        bent = torch.stack(lens_jacobian(form, u, v, *_magnifications(form, u, v)), dim=1)
        rows = bent.reshape(-1, 2, 2) @ rows
    return focal * rows


def _visible(means, quats, log_scales, opacity_logits, sh, camera, settings) -> np.ndarray:
    """(V,) int64: the splats that are not culled, front to back."""
    arrays = (means, quats, log_scales, opacity_logits, sh)
    means, quats, log_scales, opacity_logits, sh = (array.detach().numpy() for array in arrays)
    scene = Gaussians(
        means=means,
        quats=quats.astype(np.float32),
        log_scales=log_scales.astype(np.float32),
        opacity_logits=opacity_logits.astype(np.float32),
        sh=sh.astype(np.float32),
    )
    return project(scene, camera, settings).indices


def rotation_matrices(quats: torch.Tensor) -> torch.Tensor:
    """(N, 4) wxyz of any length but zero -> (N, 3, 3)."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def sh_sum(sh: torch.Tensor, directions: torch.Tensor, settings: RenderSettings) -> torch.Tensor:
    """SH (N, K, 3) at unit directions (N, 3) -> (N, 3); see `scene.sh`."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [SH_C0 * torch.ones_like(x), -SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    basis += [
        SH_C2[0] * x * y,
        SH_C2[1] * y * z,
        SH_C2[2] * (2 * zz - xx - yy),
        SH_C2[3] * x * z,
        SH_C2[4] * (xx - yy),
        SH_C3[0] * y * (3 * xx - yy),
        SH_C3[1] * x * y * z,
        SH_C3[2] * y * (4 * zz - xx - yy),
        SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
        SH_C3[4] * x * (4 * zz - xx - yy),
        SH_C3[5] * z * (xx - yy),
        SH_C3[6] * x * (xx - 3 * yy),
    ]
    degree = 3 if settings.sh_degree is None else settings.sh_degree
    count = min(sh.shape[1], (degree + 1) ** 2)
    return torch.einsum("nk,nkc->nc", torch.stack(basis[:count], dim=1), sh[:, :count])
