"""A second renderer for GL 4.3: splats are dealt out to tiles of the picture, and each tile blends its own.

What comes before, and every mode but the splats themselves, is what quads have. Sums are kept in float32
whatever the target's precision is to be, as a tile keeps them in registers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import moderngl

from splatview.renderers.gl.blend import BlendPass
from splatview.renderers.gl.context import describe, has_compute, reserve
from splatview.renderers.gl.edit_textures import EditTextures
from splatview.renderers.gl.programs import COMPUTE_VERSION, Variants, load_compute, run_groups
from splatview.renderers.gl.project import Projector, Records, VisibleCount
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
# tile, which takes a few bits. How many pairs there are is known to the GPU alone, and storage is limited, so
# pairs are made in rounds of as many as there is room for. Room and rounds follow the count of a frame a few
# back. Where that was too few, splats are left over, the farthest ones: `rest_first` on. Whoever blends must
# try those in every tile; that is slow and right, and the next frames have room.


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
            count = self._program("count", projector)
            set_uniforms(count, self._uniforms)
            run_groups(count, blocks)
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

    def _program(self, name: str, projector: Projector) -> moderngl.ComputeShader:
        flags = {**self._flags, "TEXTURED": projector.textured}
        return self._variants.compute(f"tiles/{name}.comp.glsl", flags)

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
        self.found.release()
        for thing in (self.plan, self._scan, self._make_plan):
            thing.release()


def records(projector: Projector) -> tuple[Records, ...]:
    """What shaders/tiles/outline.glsl reads, for bindings from 2 on."""
    return projector.shapes, projector.bounds, projector.colours


def bind(*buffers: Records) -> None:
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
    most_walked: int | None = None
    """Splats of one tile in a dispatch; None: all."""
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
    """By tiles for the splats; every other mode is drawn as quads."""

    def __init__(self, ctx: moderngl.Context, variants: Variants, tuning: TileTuning | None = None) -> None:
        super().__init__(ctx, variants)
        self.tuning = tuning or (SOFTWARE if describe(ctx).is_software else HARDWARE)
        self.pairs = TilePairs(ctx, variants, tile=self.tuning.tile, tuning=self.tuning.pairs)

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
        if mode != "splats" or stochastic or weights is not None:
            given = (mode, target, scene, projector, uniforms, edits)
            super().draw(*given, early_stop=early_stop, stochastic=stochastic, weights=weights)
            return
        rounds = self.pairs.count(projector, uniforms, target.size)
        values = {**uniforms, "u_tiles": self.pairs.tiles, "u_early_stop": early_stop}
        for index in range(rounds):
            tiles, splats = self.pairs.make(projector, index)
            program = self._ready(
                False, projector, target, edits, {**values, "u_round": index, "u_pixel": 0}, by_pixel
            )
            bind(tiles, splats, *records(projector))
            self._bind_more(projector, uniforms, by_pixel)
            for first in self._parts(program, projector):
                # Not cleared as a framebuffer: zink defers that beyond the dispatch.
                set_uniforms(program, {"u_starts": index == first == 0})
                program.run(*self.pairs.tiles, self._pixels if by_pixel else 1)
        program = self._ready(True, projector, target, edits, {**values, "u_starts": False}, by_pixel)
        bind(projector.order, projector.order, *records(projector))
        self._bind_more(projector, uniforms, by_pixel)
        for pixel in range(self._pixels if by_pixel else 1):
            set_uniforms(program, {"u_pixel": pixel})
            for _ in self._parts(program, projector):
                program.run_indirect(self.pairs.plan, REST_GROUPS_OFFSET)

    @property
    def _pixels(self) -> int:
        """Of an invocation."""
        return self.tuning.tile**2 // self.tuning.workgroup

    def _bind_more(self, projector: Projector, uniforms: Mapping[str, Uniform], by_pixel: bool) -> None:
        if by_pixel:
            projector.slope_buffer().bind_to_storage_buffer(8)
        for buffer in projector.disc_buffers(uniforms):
            buffer.bind_to_storage_buffer(7)

    def _parts(self, program: moderngl.ComputeShader, projector: Projector) -> Iterator[int]:
        """Sets `program` up for each part of a tile's splats, which are at most as many as the scene's."""
        self.pairs.plan.bind_to_storage_buffer(6)
        most = self.tuning.most_walked or max(projector.splats, 1)
        for first in range(0, max(projector.splats, 1), most):
            set_uniforms(program, {"u_first": first, "u_most": most})
            yield first
            self._ctx.memory_barrier()

    def _ready(
        self,
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
            **edits.now.flags(projects=False, shows="splats"),
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
        self.pairs.release()


class TilesRenderer(QuadsRenderer):
    """Renderer for OpenGL 4.3 that blends by tiles; other modes than splats are drawn as quads.

    Raises:
        InputError: the context is older than GL 4.3.
    """

    name = "tiles"
    capabilities = Capabilities(backend="tiles", orders=("32-bit", "16-bit", "per-pixel"))

    def __init__(
        self, ctx: moderngl.Context, *, tuning: TileTuning | None = None, variants: Variants | None = None
    ) -> None:
        if not has_compute(ctx):
            version = f"{ctx.version_code // 100}.{ctx.version_code // 10 % 10}"
            if ctx.version_code >= COMPUTE_VERSION:
                version += " with too few storage blocks"
            raise InputError(f"--renderer tiles needs OpenGL 4.3, this is {version}; use --renderer quads")
        variants = variants or Variants(ctx)
        self._tiles = TilesBlendPass(ctx, variants, tuning)
        super().__init__(ctx, blend_pass=self._tiles, variants=variants)

    def _use(self, scene: SceneBuffers, source: Gaussians) -> None:
        super()._use(scene, source)
        self._tiles.start_anew()

    def draw(self, request: FrameRequest) -> None:
        if request.mode == "splats":
            self._tiles.pairs.check((request.view.width, request.view.height))
        super().draw(replace(request, settings=replace(request.settings, blend="float32")))
