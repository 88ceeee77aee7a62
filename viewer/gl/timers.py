"""GPU time of named stages, read back when it is ready and never waited for while drawing."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl

from .context import describe

FRAMES_IN_FLIGHT = 4
"""Results are read this many uses of a stage later: no driver queues more frames ahead by default."""


class StageTimers:
    """Timer queries (GL_TIME_ELAPSED) by stage name; stages do not nest (GL allows one at a time).

    Where GL is a software rasteriser, stages are timed by the clock on the wall, between two waits for
    the queue to empty: the work is done by this process's own cores in any case, and llvmpipe's timer
    queries see none of the compute dispatches (it answers 0 or 2³² - 1 ns).
    """

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._by_wall_clock = describe(ctx).is_software
        self._pending: dict[str, deque[moderngl.Query]] = {}
        self._spare: list[moderngl.Query] = []
        self.latest: dict[str, float] = {}
        """Milliseconds by stage: of a frame a few back, or of the last one after `finish`."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times the GL commands issued inside."""
        if self._by_wall_clock:
            self._ctx.finish()
            began = time.perf_counter()
            yield
            self._ctx.finish()
            self.latest[name] = (time.perf_counter() - began) * 1000
            return
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
