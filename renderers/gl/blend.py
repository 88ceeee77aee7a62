"""Draws the sorted splats, in each visual mode, into the target that gathers colour and transmittance.

Front to back, rgb += T·colour·alpha and T *= 1 - alpha with T in the target's alpha, because opaque blocks
of the picture can then be closed early. At 80 layers per pixel, against float32: a float16 target that rounds
gives 62 dB and errors to 1.4/255 this way, 72 dB and 0.4/255 back to front; one that truncates, as llvmpipe
does, 44 dB and 10/255 this way, 55 dB and 2.9/255 back to front, so there float32 gathers (`resolving`).
Without early stop both ways take the same time (1.00).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import moderngl
import numpy as np

from splatview.renderers.gl.context import reserve
from splatview.renderers.gl.edit_textures import EditTextures
from splatview.renderers.gl.programs import Variants, load_compute, run_groups
from splatview.renderers.gl.project import QUADS_PER_INSTANCE, SLABS, Projector, Rows
from splatview.renderers.gl.scene_buffers import SceneBuffers
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH
from splatview.renderers.gl.targets import ColourTarget
from splatview.renderers.gl.uniforms import Uniform, disc_flags, ray_flags, set_uniforms
from splatview.renderers.modes import MODES, VisualMode, mode_flags

BLOCK = 8
"""Pixels a block is wide and high."""

HIDE_GROUP = 64
"""Invocations of a work group of ``quads/cull_occluded.comp.glsl``."""


class OcclusionPass:
    """Which blocks of the picture are opaque so far, and which splats that hides."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx = ctx
        self._variants = variants
        self._close = load_compute(ctx, "quads/opaque_blocks.comp.glsl", {"BLOCK": BLOCK})
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
        self, projector: Projector, accumulation: moderngl.Texture, slab: int, early_stop: float
    ) -> moderngl.Buffer:
        """Closes blocks by the transmittance so far; returns the slab's order without hidden splats."""
        if self._closed is None:
            raise RuntimeError("start() comes before hide()")
        accumulation.use(0)
        self._closed.bind_to_storage_buffer(0)
        grid = {"u_columns": self._columns, "u_blocks": self._blocks, "u_accumulation": 0}
        set_uniforms(self._close, {**grid, "u_early_stop": early_stop})
        run_groups(self._close, -(-self._blocks // 8))
        self._ctx.memory_barrier()
        _bind(projector.order, projector.slab_starts, projector.records, self._closed, projector.drawn)
        size = {"u_size": (float(self._size[0]), float(self._size[1]))}
        flags = {
            "BLOCK": BLOCK,
            "SLABS": SLABS,
            "TEXTURED": projector.textured,
            "TEXTURE_WIDTH": TEXTURE_WIDTH,
        }
        program = self._variants.compute("quads/cull_occluded.comp.glsl", flags)
        set_uniforms(program, {**grid, **size, "u_slab": slab})
        run_groups(program, -(-projector.most_in_slab // HIDE_GROUP))
        self._ctx.memory_barrier()
        return projector.drawn

    def release(self) -> None:
        for thing in (self._close, self._closed):
            if thing is not None:
                thing.release()


FRONT_TO_BACK = (moderngl.DST_ALPHA, moderngl.ONE, moderngl.ZERO, moderngl.ONE_MINUS_SRC_ALPHA)
"""Blend factors: source and destination of RGB, then of alpha."""

SUMS = (moderngl.ONE, moderngl.ONE, moderngl.ZERO, moderngl.ONE_MINUS_SRC_ALPHA)
"""Of weighted colours, and T."""


def quad_indices(quads: int) -> np.ndarray:
    """Vertex numbers (6 * quads,) uint32 of two triangles a quad, four vertices each."""
    corners = np.array([0, 1, 2, 2, 1, 3], dtype=np.uint32)
    return (np.arange(quads, dtype=np.uint32)[:, None] * 4 + corners).ravel()


def mode_program(
    variants: Variants,
    indices: moderngl.Buffer,
    folder: str,
    mode: VisualMode,
    edits: EditTextures,
    more: Mapping[str, float | bool] = MappingProxyType({}),
) -> tuple[moderngl.Program, moderngl.VertexArray]:
    """What draws a mode: a vertex shader from `folder` of ``shaders/``, a fragment shader from quads."""
    surfaces = MODES[mode].surfaces
    stage = "ellipsoids" if surfaces else "draw"
    own = {"ANTIALIASED": False} if surfaces else mode_flags(mode)
    edited = edits.now.flags(projects=surfaces, shows=mode)
    flags = {"QUADS_PER_INSTANCE": QUADS_PER_INSTANCE, **own, **edited, **more}
    files = f"{folder}/{stage}.vert.glsl", f"quads/{stage}.frag.glsl"
    program, array = variants.drawing(*files, flags, indices)
    edits.use(program)
    return program, array


class BlendPass:
    """Programs are compiled for a mode when it is first shown."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx = ctx
        self._variants = variants
        self._indices = ctx.buffer(quad_indices(QUADS_PER_INSTANCE))
        self._closing = OcclusionPass(ctx, variants)

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
    ) -> None:
        """Fills `target` with colour and T, or what ``quads/resolve.frag.glsl`` makes of the mode.

        `stochastic`: splats need no order, and each pixel shows one of them, chosen by chance.
        `weights`: nor do they where each counts by its depth; the uniforms of that.
        """
        stored: dict[str, float | bool] = (
            {**scene.flags(), **ray_flags(uniforms), "DISCS": False}
            if MODES[mode].surfaces
            else {"STOCHASTIC": stochastic, "WEIGHTED": weights is not None, **disc_flags(uniforms)}
        )
        stored["TEXTURED"] = projector.textured
        program, array = mode_program(self._variants, self._indices, "quads", mode, edits, stored)
        set_uniforms(program, uniforms)
        if MODES[mode].surfaces:
            self._draw_ellipsoids(target, scene, projector, program, array, edits)
            return
        framebuffer = target.with_depth() if stochastic else target.framebuffer
        if weights is not None:
            framebuffer = target.with_weights()
            set_uniforms(program, weights)
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 1.0, depth=1.0)
        self._ctx.enable_only(moderngl.DEPTH_TEST if stochastic else moderngl.BLEND)
        self._ctx.depth_func = "<"
        # moderngl's stub knows two factors, moderngl itself takes four
        factors = FRONT_TO_BACK if weights is None else SUMS
        self._ctx.blend_func = factors  # pyright: ignore[reportAttributeAccessIssue]
        stops = early_stop > 0 and MODES[mode].stops_early and not stochastic and weights is None
        if stops:
            self._closing.start(target.size)
        for slab in range(SLABS):
            order = projector.order
            if stops and slab:
                order = self._closing.hide(projector, target.texture, slab, early_stop)
            _bind(
                *(order, projector.slab_starts, projector.records, projector.depth_keys),
                *projector.disc_buffers(uniforms),
            )
            own = {"u_brightest": target.brightest, "u_depth_unit": edits.placement.radius}
            set_uniforms(program, {"u_slab": slab, **own})
            array.render_indirect(projector.commands, moderngl.TRIANGLES, count=1, first=slab)

    def _draw_ellipsoids(
        self,
        target: ColourTarget,
        scene: SceneBuffers,
        projector: Projector,
        program: moderngl.Program,
        array: moderngl.VertexArray,
        edits: EditTextures,
    ) -> None:
        framebuffer = target.with_depth()
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 1.0, depth=1.0)
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        self._ctx.depth_func = "<"
        for page in scene.pages:
            own = (page.positions, page.quats, page.scales_opacity)
            _bind(*own, projector.records, projector.depth_keys)
            place = {
                "u_page_first": page.first,
                "u_page_count": page.count,
                "u_depth_unit": edits.placement.radius,
            }
            set_uniforms(program, place)
            array.render(moderngl.TRIANGLES, instances=-(-page.count // QUADS_PER_INSTANCE))

    def release(self) -> None:
        self._closing.release()
        self._indices.release()


def _bind(*buffers: Rows) -> None:
    for slot, buffer in enumerate(buffers):
        buffer.bind_to_storage_buffer(slot)
