"""One effect in the report: whether it is on, the evidence, what leaving it out saves and costs."""

from __future__ import annotations

import math
from dataclasses import dataclass

GREY_LEVEL = 1 / 255

VISIBLE = GREY_LEVEL / 2
"""Colour changes up to half a level of an 8-bit picture are not computed."""


@dataclass(frozen=True, kw_only=True)
class Saving:
    """What a scene is spared where an effect is left out: counted, not timed, so that one can check it."""

    bytes: int = 0
    """Bytes of memory in a renderer that stores float32."""
    splats: int = 0
    """Splats of the scene that are not worked on."""
    operations: int = 0
    """Additions and multiplications a picture, were every splat in view."""
    what: str = ""
    """What is not a number: "the sort"."""

    def __str__(self) -> str:
        parts = []
        if self.bytes:
            parts.append(
                f"{self.bytes:,} bytes" if self.bytes < 1 << 20 else f"{self.bytes / 2**20:,.1f} MiB"
            )
        if self.splats:
            parts.append(f"{self.splats:,} splats")
        if self.operations:
            parts.append(f"{self.operations:,} operations a picture")
        if self.what:
            parts.append(self.what)
        return ", ".join(parts) or "nothing"


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Part of the image model, and whether this scene needs it."""

    name: str
    on: bool
    """What the analysis decides: whether leaving it out could change a picture visibly."""
    why: str
    """The evidence, with numbers, and what it means."""
    saving: Saving = Saving()
    """What leaving it out saves: what is saved where it is off, what could be where it is on."""
    bound: float = 0.0
    """The largest change of a pixel's colour that leaving it out can cause, 0 to 1 being black to white: 0
    where nothing can change, inf where nothing bounds it. Off only where this is at most VISIBLE."""
    can_override: bool = False
    """Whether `settings_for` takes the user's word for it."""
    forced: bool | None = None
    """What the user has asked for; None: as the analysis decides."""

    @property
    def in_force(self) -> bool:
        """Whether it is computed, the user's word counting more than the analysis."""
        return self.on if self.forced is None else self.forced

    @property
    def leaving_out(self) -> str:
        """What that saves and what it can change, a sentence without its end; nothing where it is neither."""
        if self.bound == 0 and self.saving == Saving():
            return ""
        if self.bound == 0:
            change = "changes nothing"
        elif math.isfinite(self.bound):
            change = f"changes a pixel by at most {grey_levels(self.bound)}"
        else:
            change = "can change a pixel by any amount"
        return f"leaving it out saves {self.saving} and {change}"

    @property
    def error(self) -> float:
        """The largest error that pictures can have because of it, as it is in force."""
        return 0.0 if self.in_force else self.bound


def grey_levels(value: float) -> str:
    """A change of a colour, for people: "0.4 grey levels"; those of an 8-bit picture."""
    return f"{short(value / GREY_LEVEL)} grey levels"


def short(value: float) -> str:
    """Two digits of a small number, all of a large one: 0.031, 2.4, 748."""
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"
