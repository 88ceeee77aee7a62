"""Radix sort on the GPU: 32-bit keys that carry values, stable, its length known to the GPU alone.

Least significant digit first, and per digit three dispatches: `count` the keys of each digit value in
each block of keys, `scan` those counts over the blocks, `scatter` keys and values to their places.
Within a block every invocation owns a run of consecutive keys and counts it by itself, so the result
depends on no atomics, no subgroup size and no progress of one workgroup while another waits: it is
right on every driver that is right. (Satish, Harris and Garland 2009 count and scan alike; the "one
sweep" sorts are faster on large GPUs but need workgroups to wait for each other.)
"""

from __future__ import annotations

from dataclasses import dataclass

import moderngl

from splatview.renderers.gl.context import describe, reserve
from splatview.renderers.gl.programs import load_compute, most_groups
from splatview.renderers.gl.scene_buffers import storage_limit
from splatview.scene import InputError

KEY_BITS = 32

PLAN_BYTES = 32
BLOCK_GROUPS_OFFSET = 0
DIGIT_GROUPS_OFFSET = 16
"""Layout of `Plan` in shaders/sort/blocks.glsl: its size and where its dispatch sizes are, in bytes."""


@dataclass(frozen=True, kw_only=True)
class SortTuning:
    """How the work is dealt out; every choice gives the same order."""

    digit_bits: int
    workgroup: int
    """Invocations."""
    keys_per_invocation: int

    @property
    def block(self) -> int:
        """Keys that one workgroup handles."""
        return self.workgroup * self.keys_per_invocation


SOFTWARE = SortTuning(digit_bits=8, workgroup=8, keys_per_invocation=1024)
"""llvmpipe runs 8 invocations as one AVX vector, and switches coroutines at barriers for more.

Times of a sort of 500,000 keys on two cores relative to this one: 16 invocations of 256 keys 1.2, 4 of
4096 1.4, 256 of 16 with 4-bit digits 3.5; 4-bit digits 2.0, 6-bit 1.4, 9-bit 1.05; 256 keys an
invocation 1.2, 512 1.06, 2048 and 4096 0.99, but those leave small scenes to one core. Of a pass,
counting takes 30 %, the scan 2 % and the scatter, which counts again, 70 %: keeping the first counts
in memory would save a tenth on the CPU, but on GPUs costs a table as long as the keys."""

HARDWARE = SortTuning(digit_bits=4, workgroup=256, keys_per_invocation=16)
"""GPUs: enough invocations to hide memory latency, and counters for all of them (16 KiB) in local memory."""


def check_count(ctx: moderngl.Context, splats: int) -> None:
    """Raises InputError where there are more splats than a storage buffer of this driver has keys."""
    most = storage_limit(ctx) // 4
    if not splats <= most:
        raise InputError(
            f"{splats:,} splats are more than this OpenGL driver can sort ({most:,});"
            " use --renderer cpu or fewer splats"
        )


class RadixSort:
    """Sorts up to `capacity` keys; owns scratch memory of the same size.

    Raises:
        ValueError: a negative capacity.
        InputError: more keys than a storage buffer of this driver can hold, or than there is memory for.
    """

    def __init__(self, ctx: moderngl.Context, capacity: int, *, tuning: SortTuning | None = None) -> None:
        if not capacity >= 0:
            raise ValueError(f"sort capacity must not be negative, got {capacity}")
        check_count(ctx, capacity)
        self.capacity = capacity
        self.tuning = tuning or (SOFTWARE if describe(ctx).is_software else HARDWARE)
        self._ctx = ctx
        flags = {
            "DIGIT_BITS": self.tuning.digit_bits,
            "WORKGROUP": self.tuning.workgroup,
            "KEYS_PER_INVOCATION": self.tuning.keys_per_invocation,
            "MOST_GROUPS": most_groups(ctx),
        }
        self._make_plan, self._count, self._scan, self._scatter = (
            load_compute(ctx, f"sort/{name}.comp.glsl", flags)
            for name in ("plan", "count", "scan", "scatter")
        )
        radix = 1 << self.tuning.digit_bits
        room = max(capacity, 1)  # GL has no empty buffers
        table = 4 * radix * -(-room // self.tuning.block)
        try:
            buffers = reserve(ctx, (PLAN_BYTES, table, 4 * radix, 4 * room, 4 * room), f"{capacity:,} splats")
        except InputError:
            for program in (self._make_plan, self._count, self._scan, self._scatter):
                program.release()
            raise
        self._plan, self._table, self._totals = buffers[:3]
        self._scratch = (buffers[3], buffers[4])

    def sort(
        self,
        keys: moderngl.Buffer,
        values: moderngl.Buffer,
        count: moderngl.Buffer,
        count_offset: int = 0,
        *,
        key_bits: int = KEY_BITS,
    ) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """Sorts `keys` (uint32) ascending and moves `values` (uint32) along; ties keep their order.

        The number of keys is the uint32 in `count` at byte `count_offset`, as it is when the GPU gets
        there; above `capacity` it counts as `capacity`. What lies behind the keys is left alone.
        Storage buffer bindings 0 to 6 are changed.

        Returns sorted keys and values: the buffers given, of which 32 bits are sorted in place. With fewer
        `key_bits` that are ever set it may take an odd number of passes; these end in the scratch memory,
        which holds them until the next sort.

        Raises:
            ValueError: `keys` or `values` hold fewer than `capacity`, or `count_offset` is no multiple
                of 4.
        """
        for name, buffer in (("keys", keys), ("values", values)):
            if not buffer.size >= 4 * self.capacity:
                raise ValueError(f"{name} must hold {self.capacity} uint32, got {buffer.size} bytes")
        if not (count_offset >= 0 and count_offset % 4 == 0):
            raise ValueError(f"count_offset must be a multiple of 4 bytes, got {count_offset}")

        for binding, buffer in enumerate((self._plan, self._table, self._totals, count)):
            buffer.bind_to_storage_buffer(binding)
        self._make_plan["count_index"] = count_offset // 4
        self._make_plan["capacity"] = self.capacity
        self._ctx.memory_barrier()
        self._make_plan.run()

        source, target = (keys, values), self._scratch
        for shift in range(0, key_bits, self.tuning.digit_bits):
            for binding, buffer in enumerate((*source, *target), start=3):
                buffer.bind_to_storage_buffer(binding)
            self._count["shift"] = shift
            self._scatter["shift"] = shift
            self._ctx.memory_barrier()
            self._count.run_indirect(self._plan, BLOCK_GROUPS_OFFSET)
            self._ctx.memory_barrier()
            self._scan.run_indirect(self._plan, DIGIT_GROUPS_OFFSET)
            self._ctx.memory_barrier()
            self._scatter.run_indirect(self._plan, BLOCK_GROUPS_OFFSET)
            source, target = target, source
        self._ctx.memory_barrier()
        return source

    def release(self) -> None:
        """Gives its buffers and programs back to GL."""
        for thing in (
            *(self._plan, self._table, self._totals, *self._scratch),
            *(self._make_plan, self._count, self._scan, self._scatter),
        ):
            thing.release()
