"""The differentiable picture: `torch.autograd.Function` over the CPU rasteriser, without copies."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from splatview.raster import Frame, Parameters, Workspace, draw_frame
from splatview.raster.gradients import differentiate
from splatview.raster.parameters import check_parameters
from splatview.raster.project import RX, RY
from splatview.scene import Camera, RenderSettings
from splatview.trainer.loss import SSIM_WEIGHT
from splatview.trainer.loss import photo_loss as compare

GRADIENT_EARLY_STOP = 1e-7
"""The light below which a pixel ends, in float32. Where gradients nearly cancel, what they leave out at
`raster.EARLY_STOP` shows in their fourth digit; at this, in their sixth, for a twentieth more time."""


@dataclass(eq=False)
class Visibility:
    """What density control asks of a picture: which splats show, how large, and how hard each is pulled."""

    indices: torch.Tensor
    """(V,) int64, ascending: splats that reach into the image."""
    radii: torch.Tensor
    """(V,) px: the larger half extent of the ellipse where alpha is at least the cut."""
    count: int
    """N, the splats of the scene."""
    means2d: torch.Tensor | None = field(default=None)
    """(N, 2) dL/d(mean in the image), px; None before backward."""
    abs_means2d: torch.Tensor | None = field(default=None)
    """(N, 2) the same, added up over pixels by absolute value (Ye et al. 2024, AbsGS)."""

    @property
    def visible(self) -> torch.Tensor:
        """(N,) bool."""
        mask = torch.zeros(self.count, dtype=torch.bool)
        mask[self.indices] = True
        return mask


def render(
    means: torch.Tensor,
    quats: torch.Tensor,
    log_scales: torch.Tensor,
    opacity_logits: torch.Tensor,
    sh: torch.Tensor,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    background: torch.Tensor | None = None,
    pose: torch.Tensor | None = None,
    early_stop: float | None = None,
    threads: int | None = None,
) -> tuple[torch.Tensor, Visibility]:
    """The picture (H, W, 4), RGB over the background and alpha, in the parameters' dtype; and who shows.

    Parameters have the shapes of `scene.Gaussians` and are all float32 or all float64, on the CPU.
    `background` (3,) stands for that of the settings and may need a gradient. `pose` (6,) must be zeros;
    its gradient is that of a small motion of the camera, (shift, turn) in camera axes: see
    `raster.gradients`. `early_stop` is the light below which a pixel ends; by default
    `GRADIENT_EARLY_STOP` in float32 and 0, never, in float64. Threads: None means all cores.

    The gradients by the means in the image are in the `Visibility` once the picture has been
    differentiated, which can be done once.

    Raises:
        ValueError: an argument has the wrong shape, dtype or device; the message names it.
    """
    settings = settings or RenderSettings()
    named = {
        "means": means,
        "quats": quats,
        "log_scales": log_scales,
        "opacity_logits": opacity_logits,
        "sh": sh,
    }
    if not isinstance(means, torch.Tensor):
        raise ValueError(f"means must be a tensor, got {type(means).__name__}")
    if means.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"means must be torch.float32 or torch.float64, got {means.dtype}")
    for name, tensor in named.items():
        _check(name, tensor, means.dtype)
    if background is None:
        background = torch.tensor(settings.background, dtype=means.dtype)
    if pose is None:
        pose = torch.zeros(6, dtype=means.dtype)
    for name, tensor, length in (("background", background, 3), ("pose", pose, 6)):
        _check(name, tensor, means.dtype)
        if tensor.shape != (length,):
            raise ValueError(f"{name} must have shape ({length},), got {tuple(tensor.shape)}")
    if not (pose.detach() == 0).all():
        raise ValueError("pose must be zeros: move the camera instead")
    if early_stop is None:
        early_stop = GRADIENT_EARLY_STOP if means.dtype == torch.float32 else 0.0
    visibility = Visibility(torch.empty(0, dtype=torch.int64), torch.empty(0, dtype=means.dtype), len(means))
    options = (camera, settings, early_stop, threads, visibility)
    image = _Render.apply(*named.values(), background, pose, options)
    assert isinstance(image, torch.Tensor)
    return image, visibility


def _check(name: str, tensor: Any, dtype: torch.dtype) -> None:
    if not isinstance(tensor, torch.Tensor):
        raise ValueError(f"{name} must be a tensor, got {type(tensor).__name__}")
    if tensor.device.type != "cpu":
        raise ValueError(f"{name} must be on the CPU, got {tensor.device}")
    if tensor.dtype != dtype:
        raise ValueError(f"{name} must be {dtype} like means, got {tensor.dtype}")


class _Workspaces:
    """Workspaces that no picture is using. A picture keeps its own from forward to backward."""

    def __init__(self) -> None:
        self._free: list[Workspace] = []
        self._lock = threading.Lock()

    def take(self) -> Workspace:
        with self._lock:
            return self._free.pop() if self._free else Workspace()

    def give_back(self, workspace: Workspace) -> None:
        with self._lock:
            self._free.append(workspace)


_workspaces = _Workspaces()


class _Held:
    """A frame and its workspace, which goes back when the frame is used up or nobody wants it any more."""

    def __init__(self, splats: Parameters, frame: Frame) -> None:
        self.splats = splats
        self.frame: Frame | None = frame

    def release(self) -> None:
        if self.frame is not None:
            _workspaces.give_back(self.frame.workspace)
            self.frame = None

    def __del__(self) -> None:
        self.release()


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> torch.Tensor:
        *tensors, background, _pose, (camera, settings, early_stop, threads, visibility) = args
        splats = check_parameters(*(tensor.detach().numpy() for tensor in tensors))
        frame = draw_frame(
            splats,
            camera,
            settings,
            _workspaces.take(),
            background=background.detach().numpy(),
            dtype=splats.quats.dtype.type,
            early_stop=early_stop,
            threads=threads,
        )
        indices = np.concatenate([frame.visible[start:stop] for start, stop in frame.runs])
        visibility.indices = torch.from_numpy(indices.astype(np.int64))
        visibility.radii = torch.from_numpy(frame.records[indices][:, [RX, RY]].max(axis=1, initial=0))
        image = torch.from_numpy(frame.image)
        ctx.held = _Held(splats, frame)
        ctx.visibility = visibility
        # Autograd notices through these if a parameter is changed in place before backward reads it.
        ctx.save_for_backward(*tensors)
        return image

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Any) -> Any:
        _ = ctx.saved_tensors
        held: _Held = ctx.held
        if held.frame is None:
            raise RuntimeError("a picture can be differentiated once; render it again")
        d_image = grad_outputs[0].detach().contiguous().numpy()
        gradients = differentiate(held.splats, held.frame, d_image)
        held.release()
        ctx.visibility.means2d = torch.from_numpy(gradients.means2d)
        ctx.visibility.abs_means2d = torch.from_numpy(gradients.abs_means2d)
        d_parameters = [torch.from_numpy(array) for array in gradients.parameters]
        d_pose = torch.from_numpy(gradients.pose.astype(d_image.dtype))
        return *d_parameters, torch.from_numpy(gradients.background), d_pose, None


def photo_loss(
    image: torch.Tensor,
    photo: torch.Tensor,
    *,
    mask: torch.Tensor | None = None,
    ssim_weight: float = SSIM_WEIGHT,
    threads: int | None = None,
) -> torch.Tensor:
    """(1 - w)·L1 + w·(1 - SSIM) of a picture (H, W, 4), float32 or float64, and a photo (H, W, 3) uint8.

    All on the CPU; mask (H, W) bool: pixels that are false count as equal. With w = 1 it is 1 - SSIM.

    Raises:
        ValueError: a tensor has the wrong shape or dtype; see `loss.photo_loss`.
    """
    loss = _PhotoLoss.apply(image, photo, mask, ssim_weight, threads)
    assert isinstance(loss, torch.Tensor)
    return loss


class _PhotoLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *args: Any) -> torch.Tensor:
        image, photo, mask, ssim_weight, threads = args
        result = compare(
            image.detach().contiguous().numpy(),
            photo.contiguous().numpy(),
            Workspace(),
            mask=None if mask is None else mask.contiguous().numpy(),
            ssim_weight=ssim_weight,
            threads=threads,
        )
        ctx.save_for_backward(torch.from_numpy(result.d_image))
        return torch.tensor(result.loss, dtype=image.dtype)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Any) -> Any:
        (d_image,) = ctx.saved_tensors
        return d_image * grad_outputs[0], None, None, None, None
