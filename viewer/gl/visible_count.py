"""The count of visible splats, read back without waiting for it."""

from __future__ import annotations

import moderngl
import numpy as np

FRAMES_IN_FLIGHT = 3
"""A count is read this many frames after it was written: by then the GPU is done with it."""


class VisibleCount:
    """The number of visible splats, kept on the GPU and read back late."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self.buffer = ctx.buffer(np.zeros(1, dtype=np.uint32))
        """One uint32, written by the scan."""
        self._ring = [ctx.buffer(reserve=4) for _ in range(FRAMES_IN_FLIGHT)]
        self._written = 0
        self._read = 0
        self._latest = 0

    def forget(self) -> None:
        """What was counted so far is of another scene."""
        self._written = self._read = self._latest = 0

    def frame_done(self) -> None:
        """Keeps this frame's count for a later `read`; call after the scan."""
        self._ctx.copy_buffer(self._ring[self._written % FRAMES_IN_FLIGHT], self.buffer)
        self._written += 1

    def read(self) -> int:
        """The newest count that costs no wait. With no new frame since the last call: the last frame's."""
        resting = self._written == self._read
        self._read = self._written
        age = 0 if resting else FRAMES_IN_FLIGHT - 1
        frame = self._written - 1 - age
        if frame >= 0:
            self._latest = int(np.frombuffer(self._ring[frame % FRAMES_IN_FLIGHT].read(), np.uint32)[0])
        return self._latest

    def read_now(self) -> int:
        """This frame's count; waits for the GPU."""
        self._latest = int(np.frombuffer(self.buffer.read(), np.uint32)[0])
        return self._latest

    def release(self) -> None:
        for buffer in (self.buffer, *self._ring):
            buffer.release()
