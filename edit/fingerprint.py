"""A short name for the values of a scene, by which a recipe knows the scene that it was made for."""

from __future__ import annotations

import hashlib

import numpy as np

from ..scene import Gaussians

ROWS = 1 << 14
"""Splats looked at, evenly spread: enough to tell scenes apart, and done in milliseconds for any."""


def fingerprint(gaussians: Gaussians) -> str:
    """32 hexadecimal digits of the values of ROWS splats, their number and SH degree; comments, extras and
    the byte order of the machine do not matter."""
    n = len(gaussians)
    rows = np.unique(np.linspace(0, n - 1, min(n, ROWS)).astype(np.int64)) if n else np.zeros(0, np.int64)
    digest = hashlib.blake2b(f"{n} {gaussians.sh_degree}".encode(), digest_size=16)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        values = getattr(gaussians, name)[rows]
        digest.update(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()
