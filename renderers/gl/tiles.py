"""A second renderer for GL 4.3: splats are dealt out to tiles of the picture, and each tile blends its own.

What comes before, and every mode but the splats themselves, is what quads have. Sums are kept in float32
whatever the target's precision is to be, as a tile keeps them in registers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import moderngl
import numpy as np

from splatview.renderers.gl.blend import BlendPass
from splatview.renderers.gl.context import describe, missing_compute, reserve
from splatview.renderers.gl.edit_textures import EditTextures
from splatview.renderers.gl.programs import Variants, load_compute, run_groups
from splatview.renderers.gl.project import Projector, Rows
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.scene_buffers import SceneBuffers, storage_limit
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH
from splatview.renderers.gl.sort import RadixSort
from splatview.renderers.gl.targets import ColourTarget
from splatview.renderers.gl.uniforms import Uniform, disc_flags, set_uniforms
from splatview.renderers.modes import VisualMode
from splatview.renderers.request import Capabilities, FrameRequest
from splatview.scene import Gaussians, InputError

# Which splats each tile of the picture has: pairs of tile and splat, by tile and then front to back.
#
# The visible splats come sorted by depth; their pairs, written in that order, need only a stable sort by
# tile, which takes a few bits. Storage is limited, so pairs are made in rounds of as many as there is room
# for. Their count is waited for in each frame: that of an older one is wrong after a jump of the camera, and
# what found no room then kept a weak GPU busy for seconds. Where even the most rounds have no room for all,
# splats are left over, the farthest ones: `rest_first` on. Whoever blends must try those in every tile.


BLOCK = 256
"""Visible splats whose pairs are counted together, and that are written by one work group."""

SCAN_SIZE = 256

LEAST_PAIRS = 1 << 16

HEADROOM = 1.5
"""Room made beyond what was counted: pairs change little from one frame to the next."""

ROUND_PAIRS_OFFSET = 8
"""Layout of `plan` in shaders/tiles/plan.glsl, in bytes."""


@dataclass(frozen=True, kw_only=True)
class PairTuning:
    """How counting is dealt out, and how many pairs there may be; every choice gives the same picture."""

    workgroup: int
    """Invocations that count the pairs of a block of visible splats."""
    most_pairs: int = 1 << 23
    """A round: 128 MiB with what sorts them, and by estimate 60 ms of blending on a GPU of 1 TFLOP/s, which
    Windows resets after two seconds."""
    most_rounds: int = 32
    most_tiles: int | None = None
    """Of a picture."""


class TilePairs:
    """Makes the pairs of one frame, round by round."""

    def __init__(self, ctx: moderngl.Context, variants: Variants, *, tile: int, tuning: PairTuning) -> None:
        self._ctx = ctx
        self._variants = variants
        self._tile = tile
        self._tuning = tuning
        flags = {
            "TILE": tile,
            "WORKGROUP": tuning.workgroup,
            "RUN": BLOCK // tuning.workgroup,
            "BLOCK": BLOCK,
            "ROUNDS": tuning.most_rounds,
        }
        self._flags = {**flags, "TEXTURE_WIDTH": TEXTURE_WIDTH}
        self._make_plan = load_compute(ctx, "tiles/plan.comp.glsl", flags)
        self._scan = load_compute(ctx, "tiles/scan.comp.glsl", {"WORKGROUP": SCAN_SIZE})
        self._most = min(tuning.most_pairs, storage_limit(ctx) // 4)
        self.plan = ctx.buffer(reserve=ROUND_PAIRS_OFFSET + 4 * tuning.most_rounds)
        self._found = ctx.buffer(reserve=4)
        self.found = 0
        """Pairs of the latest frame, or 2³² - 1 if they are more."""
        self._slots: tuple[moderngl.Buffer, moderngl.Buffer] | None = None
        self._pairs: tuple[moderngl.Buffer, moderngl.Buffer] | None = None
        self._sorter: RadixSort | None = None
        self.capacity = 0
        """Pairs a round."""

    def start_anew(self) -> None:
        """Another scene is loaded."""
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
        """Counts the pairs of the sorted splats in a picture of `size` px; returns the rounds they take."""
        self.tiles = self._tiles_of(size)
        blocks = -(-projector.splats // BLOCK)
        if not self._slots:
            self._slots = self._room_for(projector.splats, blocks)
        ends, starts = self._slots
        self._uniforms = {**uniforms, "u_tiles": self.tiles}
        if blocks:
            bind(projector.order, projector.visible.buffer, projector.records, ends, starts)
            count = self._program("count", projector)
            set_uniforms(count, self._uniforms)
            run_groups(count, blocks)
            self._ctx.memory_barrier()
        bind(starts, self._found)
        set_uniforms(self._scan, {"u_blocks": blocks})
        self._scan.run(1)
        self._ctx.memory_barrier()
        self.found = int(np.frombuffer(self._found.read(), np.uint32)[0])
        rounds = self._make_room()
        self._room = rounds * self.capacity
        bind(projector.visible.buffer, ends, starts)
        self.plan.bind_to_storage_buffer(3)
        set_uniforms(self._make_plan, {"u_capacity": self.capacity, "u_rounds": rounds})
        self._make_plan.run(1)
        self._ctx.memory_barrier()
        return rounds

    def _program(self, name: str, projector: Projector) -> moderngl.ComputeShader:
        flags = {**self._flags, "TEXTURED": projector.textured}
        return self._variants.compute(f"tiles/{name}.comp.glsl", flags)

    @property
    def leaves_over(self) -> bool:
        """Whether some splats of the frame have found no room."""
        return self.found > self._room

    def _make_room(self) -> int:
        """Room for the pairs found and some more, as far as driver and tuning allow; returns the rounds."""
        found = self.found
        if not self.capacity or (found > self.capacity and self.capacity < self._most):
            self._release_pairs()
            # Should there be no room, the next picture tries again.
            self.capacity = 0
            capacity = min(max(int(found * HEADROOM), LEAST_PAIRS), self._most)
            self._pairs = self._room_for(capacity, capacity)
            self._sorter = RadixSort(self._ctx, capacity)
            self.capacity = capacity
        return min(max(-(-found // self.capacity), 1), self._tuning.most_rounds)

    def _room_for(self, first: int, second: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """For so many numbers each."""
        a, b = reserve(self._ctx, [4 * max(numbers, 1) for numbers in (first, second)], "the tiles")
        return a, b

    def make(self, projector: Projector, index: int) -> tuple[moderngl.Buffer, moderngl.Buffer]:
        """The pairs of round `index`, tiles ascending, and their splats, front to back in each tile."""
        if self._sorter is None or self._pairs is None or self._slots is None:
            raise RuntimeError("count() comes before make()")
        blocks = -(-projector.splats // BLOCK)
        bind(projector.order, projector.visible.buffer, projector.records, *self._slots, *self._pairs)
        place: dict[str, Uniform] = {
            "u_round_first": index * self.capacity,
            "u_capacity": self.capacity,
            "u_room": self._room,
        }
        emit = self._program("emit", projector)
        set_uniforms(emit, {**self._uniforms, **place})
        run_groups(emit, blocks)
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
        for thing in (self.plan, self._found, self._scan, self._make_plan):
            thing.release()


def bind(*buffers: Rows) -> None:
    for slot, buffer in enumerate(buffers):
        buffer.bind_to_storage_buffer(slot)


NEAREST = 16
"""Splats that a pixel holds back in its own order, as in `raster.per_pixel`, which this package's pictures
are compared with."""


@dataclass(frozen=True, kw_only=True)
class TileTuning:
    """How the work is dealt out; every choice gives the same picture."""

    tile: int
    """Pixels that a tile is wide and high."""
    workgroup: int
    """Invocations a tile, a multiple or a divisor of `tile`; each has as many pixels."""
    batch: int
    """Splats that a work group keeps in local memory; a multiple of 32."""
    most_walked: int = 1 << 18
    """Splats of one tile in a dispatch."""
    most_tried: int = 1 << 23
    """Tiles times splats that were left over in a dispatch: no more than a round has pairs."""
    pairs: PairTuning = field(default_factory=lambda: PairTuning(workgroup=256))


HARDWARE = TileTuning(tile=16, workgroup=256, batch=256)
"""GPUs: a pixel an invocation; a batch takes 9 KiB of local memory."""

SOFTWARE = TileTuning(
    tile=16, workgroup=8, batch=64, most_walked=1 << 15, pairs=PairTuning(workgroup=8, most_tiles=60_000)
)
"""llvmpipe runs 8 invocations as one vector, and switches coroutines at barriers for more. Draw of 95,000
splats at 640x360 relative to this: 16 invocations 1.2, 64 2.3, 256 6.9; tiles of 8 px 1.0, batches of 32 or
128 1.0. It ends the loops of a shader after 65,535 iterations of all of them together, without a word, hence
the limits: a splat walked takes up to 1.6, a tile written takes one."""


class TilesBlendPass(BlendPass):
    """By tiles for splats and normals; every other mode is drawn as quads."""

    def __init__(self, ctx: moderngl.Context, variants: Variants, tuning: TileTuning | None = None) -> None:
        super().__init__(ctx, variants)
        self.tuning = tuning or (SOFTWARE if describe(ctx).is_software else HARDWARE)
        self.pairs = TilePairs(ctx, variants, tile=self.tuning.tile, tuning=self.tuning.pairs)
        self._next_parts = ctx.buffer(reserve=12)
        """Indirect dispatches, see ``tiles/batches.glsl``."""

    def start_anew(self) -> None:
        """Another scene is loaded."""
        self.pairs.start_anew()

    def draw(
        self,
        mode: VisualMode,
        target: ColourTarget,
        scene: SceneBuffers,
        projector: Projector,
        uniforms: Mapping[str, Uniform],
        edits: EditTextures,
        *,
        early_stop: float,
        stochastic: bool = False,
        weights: Mapping[str, Uniform] | None = None,
        by_pixel: bool = False,
    ) -> None:
        """As `BlendPass.draw`; splats need a float32 target. `by_pixel`: in each pixel's own order.

        Raises:
            InputError: that order was asked for flat splats.
        """
        if by_pixel and disc_flags(uniforms)["DISCS"]:
            raise InputError("--order per-pixel of flat splats is not for --renderer tiles: cpu can do it")
        if mode not in ("splats", "normals") or stochastic or weights is not None:
            given = (mode, target, scene, projector, uniforms, edits)
            super().draw(*given, early_stop=early_stop, stochastic=stochastic, weights=weights)
            return
        rounds = self.pairs.count(projector, uniforms, target.size)
        values = {**uniforms, "u_tiles": self.pairs.tiles, "u_early_stop": early_stop}
        layers = self.tuning.tile**2 // self.tuning.workgroup if by_pixel else 1
        groups = (*self.pairs.tiles, layers)

        def blend(
            rest: bool, *splats: moderngl.Buffer, most_walked: int, longest: int, **more: Uniform
        ) -> None:
            program = self._ready(mode, rest, projector, target, edits, {**values, **more}, by_pixel)
            bind(*splats, projector.records)
            if by_pixel:
                projector.slope_buffer().bind_to_storage_buffer(6)
            for buffer in projector.disc_buffers(uniforms):
                buffer.bind_to_storage_buffer(5)
            self._run_parts(program, groups, most_walked, longest)

        most, longest = self.tuning.most_walked, min(self.pairs.found, projector.splats)
        if longest > most:
            longest = min(longest, projector.visible.read_now())
        for index in range(rounds):
            # Not cleared as a framebuffer: zink defers that beyond the dispatch.
            place = {"u_round": index, "u_starts": index == 0}
            blend(False, *self.pairs.make(projector, index), most_walked=most, longest=longest, **place)
        if self.pairs.leaves_over:
            most = max(min(most, self.tuning.most_tried // math.prod(groups)), 1)
            order = projector.order
            blend(True, order, order, most_walked=most, longest=longest, u_starts=False)

    def _run_parts(
        self, program: moderngl.ComputeShader, groups: tuple[int, int, int], most: int, longest: int
    ) -> None:
        """Has every tile walk its splats, which are `longest` at most, in dispatches of `most` of them; one
        after the first is empty unless a tile has called for it."""
        parts = max(-(-longest // most), 1)
        if self._next_parts.size < 12 * parts:
            self._next_parts.orphan(12 * parts)
        self._next_parts.write(bytes(12 * parts))
        self._next_parts.bind_to_storage_buffer(4)
        self.pairs.plan.bind_to_storage_buffer(3)
        set_uniforms(program, {"u_most": most})
        for part in range(parts):
            set_uniforms(program, {"u_first": part * most})
            if part == 0:
                program.run(*groups)
            else:
                set_uniforms(program, {"u_starts": False})
                program.run_indirect(self._next_parts, 12 * (part - 1))
            self._ctx.memory_barrier()

    def _ready(
        self,
        mode: VisualMode,
        rest: bool,
        projector: Projector,
        target: ColourTarget,
        edits: EditTextures,
        values: dict[str, Uniform],
        by_pixel: bool,
    ) -> moderngl.ComputeShader:
        tuning = self.tuning
        flags = {
            "REST": rest,
            "TEXTURED": projector.textured,
            "TILE": tuning.tile,
            "WORKGROUP": tuning.workgroup,
            "BATCH": tuning.batch,
            "ROUNDS": tuning.pairs.most_rounds,
            **disc_flags(values),
            **edits.now.flags(projects=False, shows=mode),
        }
        name = "blend"
        if by_pixel:
            name, flags = "blend_by_pixel", {**flags, "SLOPES": True, "NEAREST": NEAREST}
        program = self._variants.compute(f"tiles/{name}.comp.glsl", flags)
        edits.use(program)
        set_uniforms(program, values)
        target.texture.bind_to_image(0, read=True, write=True)
        return program

    def release(self) -> None:
        super().release()
        self._next_parts.release()
        self.pairs.release()


class TilesRenderer(QuadsRenderer):
    """Renderer for OpenGL 4.3 that blends by tiles; other modes than splats and normals are drawn as quads.

    Raises:
        InputError: the context is older than GL 4.3.
    """

    name = "tiles"
    capabilities = Capabilities(backend="tiles", orders=("32-bit", "16-bit", "per-pixel"))

    def __init__(
        self, ctx: moderngl.Context, *, tuning: TileTuning | None = None, variants: Variants | None = None
    ) -> None:
        lacking = missing_compute(ctx)
        if lacking is not None:
            raise InputError(f"--renderer tiles cannot draw here: {lacking}; use --renderer quads")
        variants = variants or Variants(ctx)
        self._tiles = TilesBlendPass(ctx, variants, tuning)
        super().__init__(ctx, blend_pass=self._tiles, variants=variants)

    def _use(self, scene: SceneBuffers, source: Gaussians) -> None:
        super()._use(scene, source)
        self._tiles.start_anew()

    def draw(self, request: FrameRequest) -> None:
        if request.mode in ("splats", "normals"):
            self._tiles.pairs.check((request.view.width, request.view.height))
        super().draw(replace(request, settings=replace(request.settings, blend="float32")))
