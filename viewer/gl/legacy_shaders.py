"""The programs that draw one visual mode on OpenGL 3.3."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl

from .frame import VisualMode
from .programs import load_render_program
from .projector import QUADS_PER_INSTANCE
from .scene_textures import TEXTURE_WIDTH


@dataclass(frozen=True, eq=False, kw_only=True)
class ModeShaders:
    """One program draws the quads, the other shows what they gathered."""

    draw: moderngl.Program
    quads: moderngl.VertexArray
    """QUADS_PER_INSTANCE quads an instance, of `draw`."""
    resolve: moderngl.Program
    triangle: moderngl.VertexArray
    """Three vertices over the whole target, of `resolve`."""

    @classmethod
    def load(cls, ctx: moderngl.Context, mode: VisualMode, indices: moderngl.Buffer) -> ModeShaders:
        """Compiles the variant for `mode`; `indices` are `quad_indices(QUADS_PER_INSTANCE)`."""
        flags = {
            "TEXTURE_WIDTH": TEXTURE_WIDTH,
            "QUADS_PER_INSTANCE": QUADS_PER_INSTANCE,
            "POINTS": mode == "points",
            "ELLIPSOIDS": mode == "ellipsoids",
            "DEPTH": mode == "depth",
            "OVERDRAW": mode == "overdraw",
        }
        draw = load_render_program(ctx, "legacy/draw.vert.glsl", "legacy/draw.frag.glsl", flags)
        resolve = load_render_program(ctx, "legacy/fullscreen.vert.glsl", "legacy/resolve.frag.glsl", flags)
        return cls(
            draw=draw,
            quads=ctx.vertex_array(draw, [], index_buffer=indices, index_element_size=4),
            resolve=resolve,
            triangle=ctx.vertex_array(resolve, []),
        )

    def release(self) -> None:
        for thing in (self.quads, self.triangle, self.draw, self.resolve):
            thing.release()
