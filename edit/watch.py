"""How work that may take seconds says where it is, and learns that nobody waits for it any more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


class Cancelled(Exception):
    """The caller's `cancelled()` turned true; nothing was changed."""


@dataclass(frozen=True, kw_only=True)
class Watch:
    """The caller's two callbacks; both are called from the thread that works, every few milliseconds."""

    progress: Callable[[float], None] | None = None
    """Gets the share done, 0 to 1, never falling."""
    cancelled: Callable[[], bool] | None = None

    def step(self, share: float) -> None:
        """Tells that `share` of the work is done. Raises Cancelled where nobody waits for the rest."""
        if self.cancelled is not None and self.cancelled():
            raise Cancelled
        if self.progress is not None:
            self.progress(min(max(share, 0.0), 1.0))

    def part(self, start: float, stop: float) -> Watch:
        """For a piece of the work: its 0 to 1 is `start` to `stop` of the whole."""
        progress = self.progress
        if progress is None:
            return self
        return Watch(
            progress=lambda share: progress(start + share * (stop - start)), cancelled=self.cancelled
        )


UNWATCHED = Watch()
"""Nobody asks."""
