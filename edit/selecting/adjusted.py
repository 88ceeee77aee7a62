"""What splats look like after editing, value by value, without making a scene of it."""

from __future__ import annotations

import numpy as np

from ...scene import Gaussians
from ...scene.adjustment import IDENTITY_COLOUR, adjustment_rows
from ...scene.edits import PALETTE_SHIFT, SceneEdits
from ..loops import looks
from ..loops.pieces import in_pieces


def _entries(edits: SceneEdits) -> np.ndarray:
    return edits.marks >> np.uint32(PALETTE_SHIFT)


def log_scales(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N, 3) float32, natural logarithm of standard deviations in world units."""
    factors = adjustment_rows(edits.palette)[:, 32]
    if (factors == 1).all():
        return gaussians.log_scales
    return gaussians.log_scales + np.log(factors).astype(np.float32)[_entries(edits), None]


def opacities(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N,) float32 in [0, 1]; NaN where the logit is."""
    values = np.empty(len(gaussians), np.float32)
    maps = adjustment_rows(edits.palette)[:, 28:32].astype(np.float32)

    def work(start: int, stop: int) -> None:
        looks.opacities(start, stop, gaussians.opacity_logits, edits.marks, maps, values)

    in_pieces(len(values), work)
    return values


def _coloured(edits: SceneEdits) -> bool:
    return any(adjustment.colour != IDENTITY_COLOUR for adjustment in edits.palette)


def _colour_maps(edits: SceneEdits) -> np.ndarray:
    """(P, 3, 4) float32."""
    return adjustment_rows(edits.palette)[:, 16:28].reshape(-1, 3, 4).astype(np.float32)


def base_colours(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N, 3) float32 RGB of the constant band, 0.5 + C0·sh0: the mean of what it shows to all sides."""
    rgb = np.empty((len(gaussians), 3), np.float32)
    maps = _colour_maps(edits)

    def work(start: int, stop: int) -> None:
        looks.base_colours(start, stop, gaussians.sh, edits.marks, maps, rgb)

    in_pieces(len(rgb), work)
    return rgb


def sh_energies(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N,) float32: root of the summed squares of all coefficients above the constant band.

    Turning a splat leaves it as it is.
    """
    higher = gaussians.sh[:, 1:]
    with np.errstate(over="ignore", invalid="ignore"):
        if not _coloured(edits):
            flat = higher.reshape(len(higher), -1)
            return np.sqrt(np.einsum("nk,nk->n", flat, flat))
        maps, entries = _colour_maps(edits)[:, :, :3], _entries(edits)
        # The squared length of A·c is c·(AᵀA)·c: 3x3 numbers a splat, whatever the degree.
        moments = np.einsum("nki,nkj->nij", higher, higher)
        gram = np.einsum("pci,pcj->pij", maps, maps)
        return np.sqrt(np.maximum(np.einsum("nij,nij->n", moments, gram[entries]), 0))
