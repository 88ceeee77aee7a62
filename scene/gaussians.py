"""A splat scene in memory: six arrays and what its file said about itself."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from splatview.scene.image_model import NEAR

NOTE = "splatview: "
"""What comments begin with that say how a file was read, and are not the file's own."""

SH_COEFFICIENTS = (1, 4, 9, 16)
"""Coefficients per colour channel at SH degree 0, 1, 2, 3."""

ARRAYS = ("means", "quats", "log_scales", "opacity_logits", "sh")
"""Fields of `Gaussians` with a row per splat."""


NEAR_TAG = "near plane"
"""A tag of ours: what a comment begins with that says how far before a camera nothing is, in scene units."""

SAYS_NEAR = re.compile(rf"\s*{NEAR_TAG}\s*[:=]?\s*([0-9][0-9.eE+-]*)\s*$", re.IGNORECASE)


def near_plane(comments: tuple[str, ...]) -> float:
    """The near plane that the file asks for: of several, as of scenes that were put together, the least; the
    image model's where there is none that makes sense."""
    found = []
    for said in filter(None, map(SAYS_NEAR.match, comments)):
        with contextlib.suppress(ValueError):
            found.append(float(said[1]))
    return max(min((near for near in found if 0 < near < math.inf), default=NEAR), NEAR)


@dataclass(frozen=True, eq=False, kw_only=True)
class Gaussians:
    """N Gaussians, stored as training stores them: nothing is activated or normalised.

    Arrays are never written to after construction; editing makes new ones. Values are kept as
    the file had them, NaN included: culling is the renderers' business (see `image_model`).

    Raises:
        ValueError: an array has the wrong shape or dtype; the message names it.
    """

    means: np.ndarray
    """(N, 3) float32, or float64 where the file is (geo-referenced scenes). World units."""
    quats: np.ndarray
    """(N, 4) float32, wxyz, raw: normalised on use."""
    log_scales: np.ndarray
    """(N, 3) float32, natural logarithm of the standard deviations in world units."""
    opacity_logits: np.ndarray
    """(N,) float32, opacity = sigmoid(logit)."""
    sh: np.ndarray
    """(N, K, 3) float32, K in {1, 4, 9, 16}; coefficient 0 is the constant band."""
    comments: tuple[str, ...] = ()
    """The file's header comments, in order, without the word ``comment``."""
    extras: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Per-splat properties (N,) of the file that we do not interpret, by name; written back on save."""

    def __post_init__(self) -> None:
        n = len(self.means) if self.means.ndim else 0
        self._check("means", (n, 3), (np.float32, np.float64))
        self._check("quats", (n, 4))
        self._check("log_scales", (n, 3))
        self._check("opacity_logits", (n,))
        if self.sh.ndim != 3 or self.sh.shape[1] not in SH_COEFFICIENTS:
            raise ValueError(f"sh must be (N, K, 3) with K in {SH_COEFFICIENTS}, got {self.sh.shape}")
        self._check("sh", (n, self.sh.shape[1], 3))
        for name, values in self.extras.items():
            if values.shape != (n,):
                raise ValueError(f"extras[{name!r}] must be ({n},), got {values.shape}")

    def _check(self, name: str, shape: tuple[int, ...], dtypes: tuple[type, ...] = (np.float32,)) -> None:
        array = getattr(self, name)
        if array.shape != shape:
            raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
        if array.dtype.type not in dtypes:
            wanted = " or ".join(np.dtype(dtype).name for dtype in dtypes)
            raise ValueError(f"{name} must be {wanted}, got {array.dtype}")

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """The highest SH degree stored, 0 to 3."""
        return SH_COEFFICIENTS.index(self.sh.shape[1])

    @property
    def row_bytes(self) -> int:
        """Bytes of one splat in all arrays, extras included."""
        arrays = (*(getattr(self, name) for name in ARRAYS), *self.extras.values())
        return sum(array.itemsize * math.prod(array.shape[1:]) for array in arrays)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays, extras included."""
        return len(self) * self.row_bytes

    @property
    def notes(self) -> tuple[str, ...]:
        """How the file was read, where there was a choice: comments of ours, without NOTE."""
        return tuple(text.removeprefix(NOTE) for text in self.comments if text.startswith(NOTE))

    def take(self, indices: np.ndarray | slice) -> Gaussians:
        """The splats at `indices` (integer or boolean array, or a slice, whose arrays are views), in that
        order, with comments and extras."""
        arrays = {name: getattr(self, name)[indices] for name in ARRAYS}
        extras = {name: values[indices] for name, values in self.extras.items()}
        return replace(self, **arrays, extras=extras)


def concatenate(parts: list[Gaussians]) -> Gaussians:
    """One scene of all `parts` (at least one), in order.

    SH is padded with zeros to the highest degree; means become float64 if any part's are; comments
    are kept once each; extras survive only where every part has them.
    """
    sh = np.zeros((sum(map(len, parts)), max(part.sh.shape[1] for part in parts), 3), np.float32)
    start = 0
    for part in parts:
        sh[start : start + len(part), : part.sh.shape[1]] = part.sh
        start += len(part)
    shared = set.intersection(*(set(part.extras) for part in parts))
    return Gaussians(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS if name != "sh"},
        sh=sh,
        comments=tuple(dict.fromkeys(comment for part in parts for comment in part.comments)),
        extras={
            name: np.concatenate([part.extras[name] for part in parts])
            for name in parts[0].extras
            if name in shared
        },
    )
