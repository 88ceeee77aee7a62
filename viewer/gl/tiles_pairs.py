"""Which splats each tile of the picture has: pairs of tile and splat, by tile and then front to back.

The visible splats come sorted by depth; their pairs, written in that order, need only a stable sort by
tile, which takes a few bits. How many pairs there are is known to the GPU alone, and storage is limited, so
pairs are made in rounds of as many as there is room for. Room and rounds follow the count of a frame a few
back. Where that was too few, splats are left over, the farthest ones: `rest_first` on. Whoever blends must
try those in every tile; that is slow and right, and the next frames have room.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import moderngl

from ...scene import InputError
from .memory import reserve
from .programs import load_compute
from .projector import Projector
from .scene_buffers import storage_limit
from .sort import RadixSort
from .view_uniforms import Uniform, set_uniforms
from .visible_count import VisibleCount

BLOCK = 256
"""Visible splats whose pairs are counted together, and that are written by one work group."""

SCAN_SIZE = 256

LEAST_PAIRS = 1 << 16

HEADROOM = 1.5
"""Room made beyond what was counted: pairs change little from one frame to the next."""

SPARE = 1.1
"""Counted pairs that need more than the room over this make it grow."""

REST_GROUPS_OFFSET = 0
ROUND_PAIRS_OFFSET = 20
"""Layout of `plan` in shaders/tiles/plan.glsl, in bytes."""


@dataclass(frozen=True, kw_only=True)
class PairTuning:
    """How counting is dealt out, and how many pairs there may be; every choice gives the same picture."""

    workgroup: int
    """Invocations that count the pairs of a block of visible splats."""
    most_pairs: int = 1 << 24
    """A round: 256 MiB with what sorts them."""
    most_rounds: int = 16
    most_tiles: int | None = None
    """Of a picture."""


class TilePairs:
    """Makes the pairs of one frame, round by round."""

    def __init__(self, ctx: moderngl.Context, *, tile: int, tuning: PairTuning) -> None:
        self._ctx = ctx
        self._tile = tile
        self._tuning = tuning
        flags = {
            "TILE": tile,
            "WORKGROUP": tuning.workgroup,
            "RUN": BLOCK // tuning.workgroup,
            "BLOCK": BLOCK,
            "ROUNDS": tuning.most_rounds,
        }
        self._count, self._make_plan, self._emit = (
            load_compute(ctx, f"tiles/{name}.comp.glsl", flags) for name in ("count", "plan", "emit")
        )
        self._scan = load_compute(ctx, "tiles/scan.comp.glsl", {"WORKGROUP": SCAN_SIZE})
        self._most = min(tuning.most_pairs, storage_limit(ctx) // 4)
        self.plan = ctx.buffer(reserve=ROUND_PAIRS_OFFSET + 4 * tuning.most_rounds)
        self.found = VisibleCount(ctx)
        """Pairs in all, or 2³² - 1 if they are more."""
        self._slots: tuple[moderngl.Buffer, moderngl.Buffer] | None = None
        self._pairs: tuple[moderngl.Buffer, moderngl.Buffer] | None = None
        self._sorter: RadixSort | None = None
        self.capacity = 0
        """Pairs a round."""
        self._fresh = True

    def start_anew(self) -> None:
        """Forgets what was counted: another scene is loaded."""
        self._fresh = True
        self.found.forget()
        for buffer in self._slots or ():
            buffer.release()
        self._slots = None

    def check(self, size: tuple[int, int]) -> None:
        """Raises InputError for a picture of `size` px that has more tiles than this driver can do."""
        columns, rows = self._tiles_of(size)
        most = self._tuning.most_tiles
        if most is not None and not columns * rows <= most:
            raise InputError(
                f"--renderer tiles draws at most {most * self._tile**2 / 1e6:.0f} megapixels without a GPU, "
                f"not {size[0]}x{size[1]}; use --renderer cpu or a smaller --size"
            )

    def _tiles_of(self, size: tuple[int, int]) -> tuple[int, int]:
        """Columns and rows."""
        return -(-size[0] // self._tile), -(-size[1] // self._tile)

    def count(self, projector: Projector, uniforms: Mapping[str, Uniform], size: tuple[int, int]) -> int:
        """Counts the pairs of the sorted splats in a picture of `size` px; returns the rounds they take.

        Waits for the GPU in the first frame of a scene only, when no older count tells.
        """
        self.tiles = self._tiles_of(size)
        blocks = -(-projector.splats // BLOCK)
        if not self._slots:
            self._slots = self._room_for(projector.splats, blocks)
        ends, starts = self._slots
        self._uniforms = {**uniforms, "u_tiles": self.tiles}
        if blocks:
            bind(projector.order, projector.visible.buffer, *records(projector), ends, starts)
            set_uniforms(self._count, self._uniforms)
            self._count.run(blocks)
            self._ctx.memory_barrier()
        bind(starts, self.found.buffer)
        set_uniforms(self._scan, {"u_blocks": blocks})
        self._scan.run(1)
        self._ctx.memory_barrier()
        self.found.frame_done()
        rounds = self._make_room(self.found.read_now() if self._fresh else self.found.read())
        self._fresh = False
        self._room = rounds * self.capacity
        bind(projector.visible.buffer, ends, starts)
        self.plan.bind_to_storage_buffer(6)
        plan: dict[str, Uniform] = {"u_capacity": self.capacity, "u_rounds": rounds, "u_tiles": self.tiles}
        set_uniforms(self._make_plan, plan)
        self._make_plan.run(1)
        self._ctx.memory_barrier()
        return rounds

    def _make_room(self, found: int) -> int:
        """Room for `found` pairs and some more, as far as the driver and the tuning allow."""
        wanted = int(found * SPARE)
        if not self.capacity or (wanted > self.capacity and self.capacity < self._most):
            self._release_pairs()
            # Should there be no room, the next picture tries again.
            self.capacity = 0
            capacity = min(max(int(found * HEADROOM), LEAST_PAIRS), self._most)
            self._pairs = self._room_for(capacity, capacity)
            self._sorter = RadixSort(self._ctx, capacity)
            self.capacity = capacity
        return min(max(-(-wanted // self.capacity), 1), self._tuning.most_rounds)

    def _room_for(self, first: int, second: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """For so many numbers each."""
        a, b = reserve(self._ctx, [4 * max(numbers, 1) for numbers in (first, second)], "the tiles")
        return a, b

    def make(self, projector: Projector, index: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """The pairs of round `index`, tiles ascending, and their splats, front to back in each tile."""
        if self._sorter is None or self._pairs is None or self._slots is None:
            raise RuntimeError("count() comes before make()")
        blocks = -(-projector.splats // BLOCK)
        bind(projector.order, projector.visible.buffer, *records(projector), *self._slots, *self._pairs)
        place: dict[str, Uniform] = {
            "u_round_first": index * self.capacity,
            "u_capacity": self.capacity,
            "u_room": self._room,
        }
        set_uniforms(self._emit, {**self._uniforms, **place})
        if blocks:
            self._emit.run(blocks)
        nowhere = self.tiles[0] * self.tiles[1]
        return self._sorter.sort(
            *self._pairs, self.plan, ROUND_PAIRS_OFFSET + 4 * index, key_bits=nowhere.bit_length()
        )

    def _release_pairs(self) -> None:
        for buffer in self._pairs or ():
            buffer.release()
        self._pairs = None
        if self._sorter is not None:
            self._sorter.release()
            self._sorter = None

    def release(self) -> None:
        self.start_anew()
        self._release_pairs()
        self.found.release()
        for thing in (self.plan, self._count, self._scan, self._make_plan, self._emit):
            thing.release()


def records(projector: Projector) -> tuple[moderngl.Buffer, ...]:
    """What shaders/tiles/outline.glsl reads, for bindings from 2 on."""
    return projector.shapes, projector.bounds, projector.colours


def bind(*buffers: moderngl.Buffer) -> None:
    for slot, buffer in enumerate(buffers):
        buffer.bind_to_storage_buffer(slot)
