"""What every renderer in this package can show, and what it tells about the frames it drew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from splatview.scene import RenderSettings
from splatview.scene.attribute_formats import Attributes
from splatview.scene.edits import LOCKED, PREVIEW, SELECTED, SceneEdits
from splatview.scene.order_reuse import keeps_order

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


# ---- How a viewer lights up splats that an editor has marked. A picture for keeping is drawn without.


TINT_COUNT = 2 * PREVIEW
"""Rows of a table of tints: one for each set of state flags."""

Tint = tuple[float, float, float, float]
"""RGB and strength: colour' = (1 - strength)·colour + strength·RGB."""


@dataclass(frozen=True, kw_only=True)
class Highlight:
    """Tints of marked splats; a strength of 0 leaves them as they are. Of several marks the first counts."""

    preview: Tint = (1.0, 0.08, 0.05, 0.7)
    selected: Tint = (1.0, 0.72, 0.05, 0.55)
    locked: Tint = (0.12, 0.2, 0.4, 0.6)

    @property
    def flags(self) -> int:
        """State flags that are lit up."""
        pairs = ((PREVIEW, self.preview), (SELECTED, self.selected), (LOCKED, self.locked))
        return sum(flag for flag, tint in pairs if tint[3] > 0)

    @property
    def table(self) -> np.ndarray:
        """(TINT_COUNT, 4) float32: the tint of a splat whose mark is m is row m % TINT_COUNT."""
        table = np.zeros((TINT_COUNT, 4), np.float32)
        marks = np.arange(TINT_COUNT)
        for flag, tint in ((LOCKED, self.locked), (SELECTED, self.selected), (PREVIEW, self.preview)):
            if tint[3] > 0:
                table[(marks & flag) != 0] = tint
        return table

    def transmittance(self, edits: SceneEdits) -> bool:
        """Whether some splats may be lit up."""
        return bool(self.flags & edits.flags)


# ---- What settings an OpenGL can draw by.


COMPUTE = 430
"""Version code from which there are compute shaders, with which splats are sorted on the GPU."""


def refusal(
    version_code: int, settings: RenderSettings | None = None, attributes: Attributes = "float32"
) -> str | None:
    """Why OpenGL of this version (430 for 4.3) cannot draw by `settings` what is stored as `attributes`; None
    where it can."""
    if version_code >= COMPUTE:
        return None
    if attributes != "float32":
        return f"attributes in {attributes} need OpenGL 4.3; use float32 or --renderer cpu"
    if settings is None:
        return None
    if settings.order != "32-bit":
        return f"{settings.order} order needs OpenGL 4.3; use 32-bit"
    if keeps_order(settings):
        return "an order that is kept for several frames needs OpenGL 4.3; use --resort 1"
    return None
