"""What every renderer in this package can show, and what it tells about the frames it drew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

VisualMode = Literal["splats", "points", "ellipsoids", "depth", "overdraw"]


@dataclass(frozen=True, kw_only=True)
class FrameStats:
    """One reading of a renderer."""

    splats: int
    """In the scene."""
    visible: int
    """Of a recent frame: read back when the GPU has it, never waited for."""
    ms: Mapping[str, float]
    """Milliseconds by stage ("project", "sort", "draw"), likewise of a recent frame."""
    projected: int
    sorted: int
    drawn: int
    """How often each stage has run since the renderer was made."""
