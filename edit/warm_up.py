"""Warm-up of the kernels of the first edits, so that the first click does not wait for the compiler."""

from __future__ import annotations

from typing import Any

import numpy as np

from splatview.edit.document import Document
from splatview.edit.kernels.marks import positions_of
from splatview.edit.operations import operation_from_json
from splatview.edit.serialization import to_json
from splatview.scene import Gaussians, look_at

COUNT = 200
"""Splats: enough for both scattered sets and runs of them."""

CAMERA = to_json(look_at((0, 0, -4), (0, 0, 0), width=32, height=32))

STEPS: tuple[dict[str, Any], ...] = (
    {
        "op": "select",
        "by": {"kind": "polygon", "camera": CAMERA, "points": [[0, 0], [32, 0], [0, 32]]},
    },
    {
        "op": "select",
        "by": {"kind": "brush", "camera": CAMERA, "points": [[9, 9], [20, 20]], "radius": 5},
        "mode": "add",
    },
    {"op": "select", "by": {"kind": "rectangle", "camera": CAMERA, "x0": 8, "y0": 8, "x1": 24, "y1": 24}},
    {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 0.7}},
    {"op": "transform", "scale": 2},
    {"op": "transform", "scope": "scene", "scale": 2},
    {"op": "select_all"},
    {"op": "hide"},
    {"op": "show"},
    {"op": "add_crop", "crop": {"half_extents": [2, 2, 2]}},
    {"op": "lock_file", "file": 0, "locked": True},
    {"op": "lock_file", "file": 0, "locked": False},
    {"op": "place_file", "file": 0, "scale": 2},
    {"op": "select_all"},
    {"op": "delete"},
)


def warm_up() -> None:
    """Applies the quick edits once to a scene of its own: some seconds on a new installation, else a moment.
    For a thread beside the window's."""
    rng = np.random.default_rng(0)
    document = Document(
        Gaussians(
            means=rng.uniform(-1, 1, (COUNT, 3)).astype(np.float32),
            quats=rng.normal(size=(COUNT, 4)).astype(np.float32),
            log_scales=rng.normal(-3, 0.5, (COUNT, 3)).astype(np.float32),
            opacity_logits=rng.normal(size=COUNT).astype(np.float32),
            sh=np.zeros((COUNT, 1, 3), np.float32),
        )
    )
    for step in STEPS:
        document.apply(operation_from_json(step))
    document.jump(0)
    document.highlight(np.ones(COUNT, bool))
    document.file_counts  # noqa: B018, compiled by being read
    positions_of(document.gaussians, document.edits)
