"""The points of captures that keep them in a .ply file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..files import load_scene
from ..files.excerpt import excerpt
from ..sh import SH_C0


def first_points(
    folder: Path, named: Sequence[str], usual: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(P, 3) float64, (P, 3) uint8 and warnings, of the first file in `folder` that there is.

    `named` are names that the capture gives, and that are missed where they are not there; `usual` are
    tried then. No points where there is no file. Raises InputError where it is damaged.
    """
    warnings = [
        f"the points {excerpt(name)} are not on disk" for name in named if not (folder / name).is_file()
    ]
    for name in (*named, *usual):
        path = folder / name
        if path.is_file():
            cloud = load_scene(path)
            colours = np.clip(cloud.sh[:, 0] * SH_C0 + 0.5, 0, 1)
            colours = (np.nan_to_num(colours, nan=0.5) * 255 + 0.5).astype(np.uint8)
            return cloud.means.astype(np.float64), colours, warnings
    return np.empty((0, 3)), np.empty((0, 3), dtype=np.uint8), warnings
