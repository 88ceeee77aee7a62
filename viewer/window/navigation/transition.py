"""A short eased way from one view to another, so that a jump does not lose the user."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from .rotations import between
from .view import View

DURATION = 0.35
"""Seconds: long enough to follow with the eye, short enough not to wait for."""


@dataclass(frozen=True, kw_only=True)
class Transition:
    """From `start` to `end`, beginning at `began` seconds of the caller's clock."""

    start: View
    end: View
    began: float
    duration: float = DURATION

    def at(self, now: float) -> View:
        """The view at `now`; from `began + duration` on it is `end` itself."""
        share = (now - self.began) / self.duration if self.duration > 0 else 1.0
        if not share < 1:
            return self.end
        share = max(share, 0.0)
        share = share * share * (3 - 2 * share)
        start, end = self.start, self.end
        # By the logarithm, so that a zoom over many scales runs evenly.
        distance = math.exp((1 - share) * math.log(start.distance) + share * math.log(end.distance))
        fov_y = (1 - share) * start.lens.fov_y + share * end.lens.fov_y
        return replace(
            end,
            target=(1 - share) * start.target + share * end.target,
            distance=distance,
            R_camera_world=between(start.R_camera_world, end.R_camera_world, share),
            lens=replace(end.lens, fov_y=fov_y),
        )

    def done(self, now: float) -> bool:
        return now >= self.began + self.duration
