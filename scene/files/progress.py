"""How a long load reports where it is and learns that nobody waits for it any more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


class LoadCancelled(Exception):
    """The caller's `cancelled()` turned true; nothing was kept of the load."""


@dataclass(frozen=True, kw_only=True)
class Watch:
    """The caller's two callbacks; both are called from the thread that loads."""

    progress: Callable[[float], None] | None = None
    """Gets the share done, 0 to 1, never falling."""
    cancelled: Callable[[], bool] | None = None

    def check(self) -> None:
        """Call between pieces of work of a few milliseconds. Raises LoadCancelled."""
        if self.cancelled is not None and self.cancelled():
            raise LoadCancelled

    def step(self, share: float) -> None:
        """As `check`, and tells that `share` of the work is done."""
        self.check()
        if self.progress is not None:
            self.progress(min(share, 1.0))
