"""GPU time of named stages, read back when it is ready and never waited for while drawing."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl

FRAMES_IN_FLIGHT = 4
"""Results are read this many uses of a stage later: no driver queues more frames ahead by default."""


class StageTimers:
    """Timer queries (GL_TIME_ELAPSED) by stage name; stages do not nest (GL allows one at a time)."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._pending: dict[str, deque[moderngl.Query]] = {}
        self._spare: list[moderngl.Query] = []
        self.latest: dict[str, float] = {}
        """Milliseconds by stage: of a frame a few back, or of the last one after `finish`."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times the GL commands issued inside."""
        pending = self._pending.setdefault(name, deque())
        if len(pending) >= FRAMES_IN_FLIGHT:
            self._collect(name)
        query = self._spare.pop() if self._spare else self._ctx.query(time=True)
        with query:
            yield
        pending.append(query)

    def _collect(self, name: str) -> None:
        query = self._pending[name].popleft()
        self.latest[name] = query.elapsed / 1e6
        self._spare.append(query)

    def finish(self) -> dict[str, float]:
        """Waits for every result and returns `latest`: for benchmarks, not for drawing."""
        for name, pending in self._pending.items():
            while pending:
                self._collect(name)
        return self.latest
