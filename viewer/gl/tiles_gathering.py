"""Draws the sorted splats tile by tile, with sums in registers, into the target that gathers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import moderngl

from ...scene import InputError
from .context import describe
from .edit_textures import EditTextures
from .frame import VisualMode
from .gathering import Gathering
from .projector import Projector
from .scene_buffers import SceneBuffers
from .targets import ColourTarget
from .tiles_pairs import REST_GROUPS_OFFSET, PairTuning, TilePairs, bind, records
from .variants import Variants
from .view_uniforms import Uniform, disc_flags, set_uniforms

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
    tile=16,
    workgroup=8,
    batch=64,
    most_walked=1 << 15,
    pairs=PairTuning(workgroup=8, most_tiles=60_000),
)
"""llvmpipe runs 8 invocations as one vector, and switches coroutines at barriers for more. Draw of 95,000
splats at 640x360 relative to this: 16 invocations 1.2, 64 2.3, 256 6.9; tiles of 8 px 1.0, batches of 32 or
128 1.0. It ends the loops of a shader after 65,535 iterations of all of them together, without a word, hence
the limits: a splat walked takes up to 1.6, a tile written takes one."""


class TilesGathering(Gathering):
    """By tiles for the splats; every other mode is drawn as quads."""

    def __init__(self, ctx: moderngl.Context, variants: Variants, tuning: TileTuning | None = None) -> None:
        super().__init__(ctx, variants)
        self.tuning = tuning or (SOFTWARE if describe(ctx).is_software else HARDWARE)
        self.pairs = TilePairs(ctx, tile=self.tuning.tile, tuning=self.tuning.pairs)

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
        """As `Gathering.draw`; splats need a float32 target. `by_pixel`: in each pixel's own order.

        Raises:
            InputError: that order was asked for flat splats.
        """
        if by_pixel and disc_flags(uniforms)["DISCS"]:
            raise InputError("--order per-pixel of flat splats is not for --renderer tiles: cpu can do it")
        if mode != "splats" or stochastic or weights is not None:
            given = (mode, target, scene, projector, uniforms, edits)
            super().draw(*given, early_stop=early_stop, stochastic=stochastic, weights=weights)
            return
        target.framebuffer.use()
        target.framebuffer.clear(0.0, 0.0, 0.0, 1.0)
        rounds = self.pairs.count(projector, uniforms, target.size)
        values = {**uniforms, "u_tiles": self.pairs.tiles, "u_early_stop": early_stop}
        for index in range(rounds):
            tiles, splats = self.pairs.make(projector, index)
            program = self._ready(False, target, edits, {**values, "u_round": index, "u_pixel": 0}, by_pixel)
            bind(tiles, splats, *records(projector))
            self._bind_more(projector, uniforms, by_pixel)
            for _ in self._parts(program, projector):
                program.run(*self.pairs.tiles, self._pixels if by_pixel else 1)
        program = self._ready(True, target, edits, values, by_pixel)
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
        for first in range(0, projector.splats, most):
            set_uniforms(program, {"u_first": first, "u_most": most})
            yield first
            self._ctx.memory_barrier()

    def _ready(
        self,
        rest: bool,
        target: ColourTarget,
        edits: EditTextures,
        values: dict[str, Uniform],
        by_pixel: bool,
    ) -> moderngl.ComputeShader:
        tuning = self.tuning
        flags = {
            "REST": rest,
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
