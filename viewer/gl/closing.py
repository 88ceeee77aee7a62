"""Early stop for blended quads: splats behind opaque blocks of the picture are not drawn."""

from __future__ import annotations

import moderngl
import numpy as np

from .memory import reserve
from .programs import load_compute
from .projector import SLABS, Projector
from .view_uniforms import set_uniforms

BLOCK = 8
"""Pixels a block is wide and high."""

HIDE_GROUP = 64
"""Invocations of a work group of ``quads/hide.comp.glsl``."""


class Closing:
    """Which blocks of the picture are opaque so far, and which splats that hides."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        flags = {"BLOCK": BLOCK, "SLABS": SLABS}
        self._close = load_compute(ctx, "quads/close.comp.glsl", flags)
        self._hide = load_compute(ctx, "quads/hide.comp.glsl", flags)
        self._closed: moderngl.Buffer | None = None
        self._size = (0, 0)

    def start(self, size: tuple[int, int]) -> None:
        """Opens all blocks of a picture of `size` (width, height) px."""
        if size != self._size or self._closed is None:
            if self._closed is not None:
                self._closed.release()
                self._closed = None
            self._size = size
            self._columns, rows = -(-size[0] // BLOCK), -(-size[1] // BLOCK)
            self._blocks = self._columns * rows
            (self._closed,) = reserve(self._ctx, [4 * self._blocks], f"{size[0]}x{size[1]} px")
        self._closed.write(np.zeros(self._blocks, dtype=np.uint32))

    def hide(
        self, projector: Projector, gathered: moderngl.Texture, slab: int, early_stop: float
    ) -> moderngl.Buffer:
        """Closes blocks by the transmittance of `gathered`; returns the slab's order less those hidden."""
        if self._closed is None:
            raise RuntimeError("start() comes before hide()")
        gathered.use(0)
        self._closed.bind_to_storage_buffer(0)
        grid = {"u_columns": self._columns, "u_blocks": self._blocks, "u_gathered": 0}
        set_uniforms(self._close, {**grid, "u_early_stop": early_stop})
        self._close.run(-(-self._blocks // 8))
        self._ctx.memory_barrier()
        buffers = (
            *(projector.order, projector.slab_starts, projector.shapes, projector.bounds),
            *(self._closed, projector.drawn),
        )
        for slot, buffer in enumerate(buffers):
            buffer.bind_to_storage_buffer(slot)
        size = {"u_size": (float(self._size[0]), float(self._size[1]))}
        set_uniforms(self._hide, {**grid, **size, "u_slab": slab})
        self._hide.run(projector.most_in_slab(slab) // HIDE_GROUP + 1)
        self._ctx.memory_barrier()
        return projector.drawn

    def release(self) -> None:
        for thing in (self._close, self._hide, self._closed):
            if thing is not None:
                thing.release()
