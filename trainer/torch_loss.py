"""The photo loss as one differentiable torch operation, for training loops of one's own."""

from __future__ import annotations

from typing import Any

import torch

from ..raster import Workspace
from .loss import SSIM_WEIGHT
from .loss import photo_loss as compare


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
