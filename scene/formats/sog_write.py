"""Scenes to .sog, version 2: pictures of splats along a Z-curve, and a palette of their SH."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatview.scene.effects.appearance import antialiasing, is_flat
from splatview.scene.formats.io import atomic_write
from splatview.scene.formats.packing import (
    in_slices,
    opacity_levels,
    slices,
    smallest_three,
    storable_in_z_order,
)
from splatview.scene.formats.palette import Rows, levels, vectors
from splatview.scene.formats.sog import META, PALETTE_COLUMNS
from splatview.scene.gaussians import Gaussians
from splatview.scene.progress import Progress
from splatview.scene.projection import sigmoid

LARGEST_PALETTE = 1 << 16
"""Entries of the SH palette that labels of 16 bits can name; fewer make a smaller file."""


@dataclass(frozen=True, kw_only=True)
class SogKnobs:
    """What makes a file smaller at the price of quality; the defaults are as fine as the format gets."""

    palette: int = LARGEST_PALETTE
    """Entries of the SH palette at most."""
    position_bits: int = 16
    """Bits of the positions that are kept, 1 to 16: the others are 0, which compresses to nothing."""
    rotation_bits: int = 8
    """The same of the quaternions' components, 1 to 8."""
    codes: int = 256
    """Entries in use of the codebooks of scales and colours, 2 to 256."""


FINEST = SogKnobs()


def save_sog(gaussians: Gaussians, path: Path, progress: Progress, **knobs: int) -> None:
    """Writes a zip; `knobs` are those of `SogKnobs`.

    Raises:
        InputError: the system refuses.
        Cancelled: nobody waits for it any more.
    """
    files = sog_files(gaussians, progress, SogKnobs(**knobs))
    with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, content in files.items():
            # A date of its own, so that equal scenes give equal files.
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content)


def sog_files(
    gaussians: Gaussians, progress: Progress, knobs: SogKnobs = FINEST, order: np.ndarray | None = None
) -> dict[str, bytes]:
    """Contents by name of file, meta.json last, of the splats `order` (M,); None: of all that a renderer
    draws, along a Z-curve. One attribute after another, so that there is never a second scene."""
    if order is None:
        order = storable_in_z_order(gaussians)
    n = len(order)
    width = max(4, math.ceil(math.sqrt(n) / 4) * 4)
    height = max(4, math.ceil(n / width / 4) * 4)
    files: dict[str, bytes] = {}

    def add(name: str, texels: np.ndarray, shape: tuple[int, int] = (height, width)) -> str:
        picture = np.zeros((shape[0] * shape[1], 4), np.uint8)
        picture[:, 3] = 255
        picture[: len(texels), : texels.shape[1]] = texels
        files[f"{name}.webp"] = _webp(picture.reshape(*shape, 4))
        return f"{name}.webp"

    def texels(columns: int, encode: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """(M, columns) uint8 of what `encode` makes of the indices of some splats at a time."""
        rows = np.empty((n, columns), np.uint8)
        for part in slices(n):
            rows[part] = encode(order[part])
        return rows

    weights = importance(gaussians, order)
    low, high = _log_bounds(gaussians.means, order)
    spare = 16 - knobs.position_bits
    steps = 2**knobs.position_bits - 1

    def positions(at: np.ndarray) -> np.ndarray:
        shares = (_logarithmic(gaussians.means[at]) - low) / np.where(high > low, high - low, 1)
        whole = np.rint(shares * steps).astype(np.uint16) << spare
        return np.column_stack([whole & 255, whole >> 8])

    meta: dict[str, object] = {"version": 2, "asset": {"generator": "splatview"}, "count": n}
    if is_flat(gaussians):
        meta["model"] = "2dgs"
    elif antialiasing(gaussians.comments)[0]:
        meta["model"] = "antialiased"
    found = texels(6, positions)
    meta["means"] = {
        "mins": low.tolist(),
        "maxs": (low + (high - low) * (65535 / (steps << spare))).tolist(),
        "files": [add("means_l", found[:, :3]), add("means_u", found[:, 3:])],
    }
    progress.step(0.1)
    book, found = levels(gaussians.log_scales[order], weights, knobs.codes)
    meta["scales"] = {"codebook": _whole(book), "files": [add("scales", found)]}
    progress.step(0.2)
    step = 1 << (8 - knobs.rotation_bits)

    def rotations(at: np.ndarray) -> np.ndarray:
        largest, rest = smallest_three(gaussians.quats[at])
        rest = np.minimum(np.rint((rest + 1) * (127.5 / step)) * step, 256 - step)
        return np.column_stack([np.minimum(rest, 255), 252 + largest])

    meta["quats"] = {"files": [add("quats", texels(4, rotations))]}
    progress.step(0.3)
    book, found = levels(gaussians.sh[order, 0], weights, knobs.codes)
    opacities = texels(1, lambda at: opacity_levels(gaussians.opacity_logits[at])[:, None])
    meta["sh0"] = {"codebook": _whole(book), "files": [add("sh0", np.column_stack([found, opacities]))]}
    del found, opacities
    progress.step(0.4)
    if gaussians.sh_degree and n:
        entries = min(knobs.palette, LARGEST_PALETTE)
        rows = Rows(gaussians.sh[:, 1:], order)
        centroids, labels = vectors(rows, weights, entries, progress=progress.part(0.4, 0.9))
        similar = _similar_order(centroids)
        centroids, places = centroids[similar], np.empty(len(similar), np.uint16)
        places[similar] = np.arange(len(similar))
        labels = places[labels]
        book, found = levels(centroids, np.bincount(labels, weights, len(centroids)))
        count, per_channel = len(centroids), gaussians.sh.shape[1] - 1
        del centroids, weights
        picture = -(-count // PALETTE_COLUMNS), PALETTE_COLUMNS * per_channel
        meta["shN"] = {
            "count": count,
            "bands": gaussians.sh_degree,
            "codebook": book.tolist(),
            "files": [
                add("shN_centroids", found.reshape(-1, 3), picture),
                add("shN_labels", np.column_stack([labels & 255, labels >> 8])),
            ],
        }
    files[META] = json.dumps(meta, separators=(",", ":")).encode()
    progress.step(1.0)
    return files


def _logarithmic(means: np.ndarray) -> np.ndarray:
    """(M, 3) float64: positions as they are stored, with steps that grow with the distance."""
    wide = means.astype(np.float64)
    return np.sign(wide) * np.log1p(np.abs(wide))


def _log_bounds(means: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest (3,) of `_logarithmic` of the splats `order`, which rises with positions;
    zeros where there are none."""
    if not len(order):
        return np.zeros(3), np.zeros(3)
    ends = [(rows.min(axis=0), rows.max(axis=0)) for rows in (means[at] for at in in_slices(order))]
    low, high = np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)
    return _logarithmic(low), _logarithmic(high)


def _whole(book: np.ndarray) -> list[float]:
    """All 256 entries of a codebook of fewer."""
    return np.pad(book, (0, 256 - len(book)), mode="edge").tolist()


def importance(gaussians: Gaussians, order: np.ndarray) -> np.ndarray:
    """(M,) float64 of the splats `order` (M,): opacity times the area of the two longest axes, about what a
    splat adds to pictures; at most 10,000 times the median, so that no backdrop takes the whole palette."""
    weights = np.empty(len(order))
    for part in slices(len(order)):
        at = order[part]
        longest = np.sort(gaussians.log_scales[at].astype(np.float64), axis=1)[:, 1:].sum(axis=1)
        area = np.exp(np.clip(longest, -300, 300))
        weights[part] = sigmoid(gaussians.opacity_logits[at].astype(np.float64)) * area
    return np.minimum(weights, 1e4 * np.median(weights)) if len(weights) else weights


def _similar_order(centroids: np.ndarray) -> np.ndarray:
    """Centroids in an order in which neighbours are alike, which WebP makes smaller: along the direction in
    which they differ most."""
    mean = centroids.mean(axis=0, dtype=np.float64)
    spread = np.zeros((len(mean), len(mean)))
    for part in slices(len(centroids)):
        centred = centroids[part] - mean
        spread += centred.T @ centred
    _, directions = np.linalg.eigh(spread)
    return np.argsort(centroids @ directions[:, -1].astype(np.float32), kind="stable")


def _webp(picture: np.ndarray) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    # exact: colours under an alpha of 0 are values, too. The library that reads cannot write so.
    Image.fromarray(picture, "RGBA").save(out, "WEBP", lossless=True, exact=True, quality=75, method=4)
    return out.getvalue()
