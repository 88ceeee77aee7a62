"""One token for long work: how far it is, and whether anybody still waits for its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


class Cancelled(Exception):
    """Nobody waits for the result any more; nothing was changed and nothing kept."""


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Two callbacks of the caller, both called from the thread that works, every few milliseconds."""

    report: Callable[[float], None] | None = None
    """Receiver of the share done, 0 to 1, which never falls."""
    cancelled: Callable[[], bool] | None = None
    """Whether the caller has given up."""

    def check(self) -> None:
        """Raises Cancelled where nobody waits for the rest."""
        if self.cancelled is not None and self.cancelled():
            raise Cancelled

    def step(self, share: float) -> None:
        """Reports that `share` of the work is done. Raises Cancelled, see `check`."""
        self.check()
        if self.report is not None:
            self.report(min(max(share, 0.0), 1.0))

    def part(self, start: float, stop: float) -> Progress:
        """The progress of a piece of the work, whose 0 to 1 is `start` to `stop` of the whole."""
        report = self.report
        if report is None:
            return self
        return Progress(report=lambda share: report(start + share * (stop - start)), cancelled=self.cancelled)


NO_PROGRESS = Progress()
"""Progress that nobody follows and nobody cancels."""
