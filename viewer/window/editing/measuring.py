"""The tape measure's answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .tool_names import Place


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A distance between two picked points."""

    start: Place
    end: Place

    @property
    def length(self) -> float:
        """World units."""
        return math.dist(self.start, self.end)
