"""The image model in plain torch, dense and slow: what autograd makes of it is the truth for gradients.

Every splat is evaluated at every pixel. Culled splats and the order of depths are decided once, without
gradient, by `scene.projection`; all else is differentiable.
"""

from __future__ import annotations

import numpy as np
import torch

from ..scene import Camera, Gaussians, RenderSettings
from ..scene.projection import project
from ..scene.sh import SH_C0, SH_C1, SH_C2, SH_C3


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
    x, y, z = t.unbind(1)

    u, v = x / z, y / z
    if model.jacobian_margin is not None:
        tan_x, tan_y = camera.width / (2 * camera.fx), camera.height / (2 * camera.fy)
        margin_x, margin_y = model.jacobian_margin * tan_x, model.jacobian_margin * tan_y
        u = u.clamp(-camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
        v = v.clamp(-camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)
    zero = torch.zeros_like(z)
    J = torch.stack(
        [
            torch.stack([camera.fx / z, zero, -camera.fx * u / z], dim=1),
            torch.stack([zero, camera.fy / z, -camera.fy * v / z], dim=1),
        ],
        dim=1,
    )
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
    colours = (0.5 + sh_sum(sh, offsets / offsets.norm(dim=1, keepdim=True), settings)).clamp_min(0)

    px, py = torch.meshgrid(
        torch.arange(camera.width, dtype=dtype) + 0.5,
        torch.arange(camera.height, dtype=dtype) + 0.5,
        indexing="xy",
    )
    dx = px.reshape(1, -1) - (camera.fx * x / z + camera.cx)[:, None]
    dy = py.reshape(1, -1) - (camera.fy * y / z + camera.cy)[:, None]
    q = (a[:, None] * dx + b[:, None] * dy) ** 2 + (c[:, None] * dy) ** 2
    alpha = (opacities[:, None] * (-q / 2).exp()).clamp_max(model.max_alpha)
    alpha = torch.where(alpha >= model.alpha_cut, alpha, 0)
    light = torch.cat([torch.ones_like(px.reshape(1, -1)), (1 - alpha).cumprod(0)])
    colour = (alpha * light[:-1]).T @ colours + light[-1][:, None] * background
    picture = torch.cat([colour, 1 - light[-1][:, None]], dim=1)
    return picture.reshape(camera.height, camera.width, 4)


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
