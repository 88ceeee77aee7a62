"""Project, cull, compact and sort on the GPU: from a scene and a camera to draw order, without read-back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import moderngl
import numpy as np

from splatview.renderers.gl.context import reserve
from splatview.renderers.gl.edit_textures import EditTextures
from splatview.renderers.gl.programs import Variants, load_compute, run_groups
from splatview.renderers.gl.scene_buffers import GROUP_SIZE, SceneBuffers, storage_limit
from splatview.renderers.gl.scene_textures import TexelArray
from splatview.renderers.gl.sort import KEY_BITS, RadixSort
from splatview.renderers.gl.uniforms import Uniform, disc_flags, ray_flags, set_uniforms
from splatview.scene.order_reuse import ResortPolicy

# An order by depth that serves more frames than the one it was made for, on the GPU.
#
# It is one of all splats, seen or not, so that those that come into view have their place. A frame's visible
# splats are taken from it in place of from the indices, and need no sort then.


class KeptOrder:
    """Has no memory until it is first used."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx, self._variants = ctx, variants
        self.resort_policy = ResortPolicy()
        self._count_kept: moderngl.ComputeShader | None = None
        self._buffers: list[moderngl.Buffer] = []
        """Keys, splats, and their number."""
        self._sorter: RadixSort | None = None
        self._splats = 0
        self.order: moderngl.Buffer | None = None
        """All splats, front to back."""

    def start_anew(self) -> None:
        """Another scene is loaded."""
        self.resort_policy.forget()
        self._release_buffers()

    def make(
        self, scene: SceneBuffers, uniforms: dict[str, Uniform], edits: EditTextures, keys: DepthKeys
    ) -> None:
        """Sorts all splats of the scene."""
        if self._sorter is None:
            self._splats = scene.splats
            room = 4 * max(1, scene.splats)
            self._buffers = reserve(
                self._ctx, (room, room, 4), f"{scene.splats:,} splats in an order that is kept"
            )
            self._buffers[2].write(np.uint32(scene.splats).tobytes())
            self._sorter = RadixSort(self._ctx, scene.splats)
        flags = {
            "GROUP_SIZE": GROUP_SIZE,
            **dict.fromkeys(("ANTIALIASED", "LENS", "ORTHOGRAPHIC"), False),
            "ATTRIBUTES": scene.flags()["ATTRIBUTES"],
            **edits.now.flags(),
        }
        program = self._variants.compute("quads/depths.comp.glsl", flags)
        set_uniforms(program, uniforms)
        edits.use(program)
        shortened = {"u_key_base": keys.base, "u_key_shift": keys.shift, "u_key_most": (1 << keys.bits) - 1}
        for slot, buffer in enumerate(self._buffers[:2], start=4):
            buffer.bind_to_storage_buffer(slot)
        for page in scene.pages:
            page.positions.bind_to_storage_buffer(0)
            set_uniforms(program, {"u_page_first": page.first, "u_page_count": page.count, **shortened})
            run_groups(program, -(-page.count // GROUP_SIZE))
        self._ctx.memory_barrier()
        sort_keys, splats, count = self._buffers
        self.order = self._sorter.sort(sort_keys, splats, count, key_bits=keys.bits)[1]
        self._ctx.memory_barrier()

    def count(self, depth_keys: moderngl.Buffer, group_counts: moderngl.Buffer) -> None:
        """Fills `group_counts` with how many are seen of each GROUP_SIZE of the order."""
        if self.order is None:
            raise RuntimeError("make() comes before count()")
        if self._count_kept is None:
            self._count_kept = load_compute(
                self._ctx, "quads/count_reused.comp.glsl", {"GROUP_SIZE": GROUP_SIZE}
            )
        for slot, buffer in enumerate((depth_keys, self.order, group_counts)):
            buffer.bind_to_storage_buffer(slot)
        set_uniforms(self._count_kept, {"u_splats": self._splats})
        run_groups(self._count_kept, -(-self._splats // GROUP_SIZE))
        self._ctx.memory_barrier()

    def _release_buffers(self) -> None:
        for buffer in self._buffers:
            buffer.release()
        if self._sorter is not None:
            self._sorter.release()
        self._buffers, self._sorter, self.order = [], None, None

    def release(self) -> None:
        self._release_buffers()
        if self._count_kept is not None:
            self._count_kept.release()


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


QUADS_PER_INSTANCE = 512
"""Splats drawn as one instance: software and hardware GL alike pay for each instance."""

SCAN_SIZE = 256

SLABS = 16
"""The sorted splats are drawn in so many equal parts, nearest first, and between two of them opaque blocks of
the picture are closed. On llvmpipe, 500,000 splats, time of the draw
relative to no early stop: 16 parts 0.77, 8 parts 0.83, 32 parts 0.80, 64 parts 0.83; closing single pixels
by a depth test instead of blocks 0.93, because llvmpipe blends masked pixels all the same."""

ROW_BYTES = 16
"""Four numbers."""

RECORD_ROWS = 3
"""Of a projected splat, see ``common/records.glsl``. Together, not in an array each: most of what tiles do
with millions of splats is to fetch their records from anywhere in memory. On an H200 `tiles` took 15.1 ms to
draw 6 million with an array each and takes 8.4; with a million, which its cache holds, 2.1 and 2.1
(records_gpu.json)."""

FIRST_RECORD_UNIT = 3
"""Texture units from here on are those of records, in textures, then of discs and slopes."""


class RowTextures:
    """Rows in textures, for drivers whose storage buffers are too small: see ``common/records.glsl``."""

    def __init__(self, ctx: moderngl.Context, unit: int, textures: int, rows: int, what: str) -> None:
        """So many `textures` of as many `rows` each, from `unit` on.

        Raises:
            InputError: there is no room for them.
        """
        self._unit = unit
        self.arrays = [TexelArray(ctx, 4, "f4", what) for _ in range(textures)]
        try:
            for array in self.arrays:
                array.reserve(rows)
        except BaseException:
            self.release()
            raise

    def bind_to_storage_buffer(self, slot: int) -> None:
        """Binds them to their units: a buffer would be bound to `slot`."""
        for unit, array in enumerate(self.arrays, start=self._unit):
            array.texture.use(unit)
            array.texture.bind_to_image(unit, read=False, write=True)

    def release(self) -> None:
        for array in self.arrays:
            array.release()


Rows = moderngl.Buffer | RowTextures


@dataclass(frozen=True, kw_only=True)
class DepthKeys:
    """How depths are made keys: the bits of a float32 with the sign's turned over, counted from `base`,
    shifted right by `shift`, and at most 2^bits - 1. With the defaults, all of the bits."""

    base: int = 0
    shift: int = 0
    bits: int = KEY_BITS


def short_keys(least: float, greatest: float, bits: int) -> DepthKeys:
    """Keys of so many bits for depths in [least, greatest]; those beyond share the last."""
    low, high = (int(np.float32(depth).view(np.uint32)) | 0x80000000 for depth in (least, greatest))
    return DepthKeys(base=low, shift=max((high - low).bit_length() - bits, 0), bits=bits)


class Projector:
    """Holds what a frame computes before drawing; buffers are sized by the scene."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx = ctx
        self._variants = variants
        self._scan = load_compute(
            ctx,
            "quads/scan.comp.glsl",
            {"SCAN_SIZE": SCAN_SIZE, "QUADS_PER_INSTANCE": QUADS_PER_INSTANCE, "SLABS": SLABS},
        )
        flags = {"GROUP_SIZE": GROUP_SIZE, "KEPT": False}
        self._compact = load_compute(ctx, "quads/compact.comp.glsl", flags)
        self._compact_kept: moderngl.ComputeShader | None = None
        self.visible = VisibleCount(ctx)
        self.commands = ctx.buffer(reserve=20 * SLABS)
        """DrawElementsIndirectCommand a slab."""
        self.slab_starts = ctx.buffer(reserve=4 * (SLABS + 1))
        self.textured = False
        """Whether records are in textures."""
        self.slopes: Rows | None = None
        """A row a splat, once pictures in per-pixel order have been drawn."""
        self.discs: Rows | None = None
        """Two rows a splat, once flat splats have been drawn."""
        self._sized: list[Rows] = []
        self._sorter: RadixSort | None = None

    def resize(self, splats: int) -> None:
        """Makes room for a scene of `splats`, and gives back that for the one before.

        Raises:
            InputError: there is not enough graphics memory; nothing has changed then.
        """
        room, groups = max(1, splats), -(-splats // GROUP_SIZE)
        sizes = (*[room * 4] * 4, *[max(1, groups) * 4] * 2)
        textured = room * RECORD_ROWS * ROW_BYTES > storage_limit(self._ctx)
        made: list[Rows] = []
        try:
            buffers = reserve(self._ctx, sizes, f"{splats:,} splats")
            made += buffers
            records: Rows
            if textured:
                records = RowTextures(self._ctx, FIRST_RECORD_UNIT, RECORD_ROWS, room, "splats")
            else:
                (records,) = reserve(self._ctx, [room * RECORD_ROWS * ROW_BYTES], f"{splats:,} splats")
            made.append(records)
            sorter = RadixSort(self._ctx, room)
        except BaseException:
            for thing in made:
                thing.release()
            raise
        self._release_sized()
        self._sized, self._sorter = made, sorter
        self.splats, self._groups, self.textured = splats, groups, textured
        self.records = records
        self.depth_keys, self.keys, self.order, self.drawn = buffers[:4]
        self._counts, self._starts = buffers[4:]
        self._counts.write(np.zeros(max(1, groups), dtype=np.uint32))

    def _make_rows(self, count: int, what: str, unit: int) -> Rows:
        """Raises InputError where there is no room for so many of `what`."""
        if self.textured:
            return RowTextures(self._ctx, unit, 1, count, what)
        return reserve(self._ctx, [count * ROW_BYTES], f"{count:,} {what}")[0]

    def project(
        self,
        scene: SceneBuffers,
        uniforms: dict[str, Uniform],
        edits: EditTextures,
        *,
        sh_degree: int,
        antialiased: bool,
        keys: DepthKeys = DepthKeys(),
        kept: KeptOrder | None = None,
        slopes: bool = False,
        normals: bool = False,
    ) -> None:
        """Fills records and keys of all splats, then keys and order of the visible ones, by index; or their
        order alone, which is final, by `kept`. With `slopes` also how depth goes with the pixel; with
        `normals` in their colours."""
        flags = {
            "GROUP_SIZE": GROUP_SIZE,
            "SH_DEGREE": min(sh_degree, scene.sh_degree),
            **scene.flags(),
            "ANTIALIASED": antialiased,
            "NORMALS": normals,
            **ray_flags(uniforms),
            **edits.now.flags(),
        }
        if flags["DISCS"]:
            flags["ANTIALIASED"] = False  # of no effect on discs
            self._disc_buffer().bind_to_storage_buffer(7)
        flags["TEXTURED"] = self.textured
        if slopes and not flags["DISCS"]:  # which have none; 8 storage blocks are what OpenGL promises
            flags["SLOPES"] = True
            self.slope_buffer().bind_to_storage_buffer(8)
        program = self._variants.compute("quads/project.comp.glsl", flags)
        set_uniforms(program, uniforms)
        edits.use(program)
        for slot, buffer in enumerate((self.records, self.depth_keys, self._counts), start=4):
            buffer.bind_to_storage_buffer(slot)
        for page in scene.pages:
            for slot, buffer in enumerate((page.positions, page.quats, page.scales_opacity, page.sh)):
                buffer.bind_to_storage_buffer(slot)
            set_uniforms(program, {"u_page_first": page.first, "u_page_count": page.count})
            run_groups(program, -(-page.count // GROUP_SIZE))
        self._ctx.memory_barrier()
        if kept is not None:
            kept.count(self.depth_keys, self._counts)
        for slot, buffer in enumerate(
            (self._counts, self._starts, self.visible.buffer, self.commands, self.slab_starts)
        ):
            buffer.bind_to_storage_buffer(slot)
        set_uniforms(self._scan, {"u_groups": self._groups})
        self._scan.run(1)
        self._ctx.memory_barrier()
        for slot, buffer in enumerate((self.depth_keys, self._starts, self.keys, self.order)):
            buffer.bind_to_storage_buffer(slot)
        shortened = {"u_key_base": keys.base, "u_key_shift": keys.shift, "u_key_most": (1 << keys.bits) - 1}
        compact = self._compact
        if kept is not None and kept.order is not None:
            kept.order.bind_to_storage_buffer(4)
            compact = self._compacting_kept()
        set_uniforms(compact, {"u_splats": scene.splats, **shortened})
        run_groups(compact, self._groups)
        self._ctx.memory_barrier()
        self.visible.frame_done()

    def slope_buffer(self) -> Rows:
        """Slopes of depth, (x, y), and depth, a splat. Raises InputError where there is no room for it."""
        if self.slopes is None:
            unit = FIRST_RECORD_UNIT + RECORD_ROWS + 1
            self.slopes = self._make_rows(max(1, self.splats), "depths along rays", unit)
            self._sized.append(self.slopes)
        return self.slopes

    def disc_buffers(self, uniforms: Mapping[str, Uniform]) -> tuple[Rows, ...]:
        """What drawing needs besides, where the splats of `view_uniforms` are flat."""
        return (self._disc_buffer(),) if disc_flags(uniforms)["DISCS"] else ()

    def _disc_buffer(self) -> Rows:
        """Raises InputError where there is no room for it."""
        if self.discs is None:
            # Fewer rows than records have: where those are in a buffer, these have room in one.
            unit = FIRST_RECORD_UNIT + RECORD_ROWS
            self.discs = self._make_rows(2 * max(1, self.splats), "halves of discs", unit)
            self._sized.append(self.discs)
        return self.discs

    def _compacting_kept(self) -> moderngl.ComputeShader:
        if self._compact_kept is None:
            flags = {"GROUP_SIZE": GROUP_SIZE, "KEPT": True}
            self._compact_kept = load_compute(self._ctx, "quads/compact.comp.glsl", flags)
        return self._compact_kept

    def sort(self, key_bits: int = KEY_BITS) -> None:
        """Orders the visible splats front to back, ties by index."""
        if self._sorter is None:
            raise RuntimeError("resize() comes before sort()")
        self._sorter.sort(self.keys, self.order, self.visible.buffer, key_bits=key_bits)
        self._ctx.memory_barrier()

    @property
    def most_in_slab(self) -> int:
        """An upper bound that needs no read-back: as if every splat were visible."""
        return -(-self.splats // SLABS)

    def _release_sized(self) -> None:
        if self._sorter is not None:
            self._sorter.release()
            self._sorter = None
        while self._sized:
            self._sized.pop().release()
        self.discs = self.slopes = None

    def release(self) -> None:
        self._release_sized()
        self.visible.release()
        self.commands.release()
        self.slab_starts.release()
        for program in (self._scan, self._compact, self._compact_kept):
            if program is not None:
                program.release()
