"""What `gathering` does, for OpenGL 3.3: draws the ordered splats, in each visual mode, from textures."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from .frame import VisualMode
from .gathering import FRONT_TO_BACK, MODE_FLAGS, quad_indices
from .programs import load_render_program
from .projection_pass import ProjectionPass
from .projector import QUADS_PER_INSTANCE
from .scene_textures import TEXTURE_WIDTH, SceneTextures
from .targets import ColourTarget
from .view_uniforms import Uniform, set_uniforms


class LegacyGathering:
    """Programs are compiled for a mode when it is first shown."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._indices = ctx.buffer(quad_indices(QUADS_PER_INSTANCE))
        self._programs: dict[str, tuple[moderngl.Program, moderngl.VertexArray]] = {}

    def _program(self, mode: VisualMode) -> tuple[moderngl.Program, moderngl.VertexArray]:
        if mode not in self._programs:
            flags = {
                "TEXTURE_WIDTH": TEXTURE_WIDTH,
                "QUADS_PER_INSTANCE": QUADS_PER_INSTANCE,
                **MODE_FLAGS.get(mode, {"ANTIALIASED": False}),
            }
            stage = "ellipsoids" if mode == "ellipsoids" else "draw"
            program = load_render_program(
                self._ctx, f"legacy/{stage}.vert.glsl", f"quads/{stage}.frag.glsl", flags
            )
            array = self._ctx.vertex_array(program, [], index_buffer=self._indices, index_element_size=4)
            self._programs[mode] = program, array
        return self._programs[mode]

    def draw_splats(
        self,
        mode: VisualMode,
        target: ColourTarget,
        projection: ProjectionPass,
        uniforms: Mapping[str, Uniform],
        order: moderngl.Texture,
        ordered: int,
    ) -> None:
        """Fills `target` with the first `ordered` splats of `order`; all modes but ellipsoids."""
        program, array = self._program(mode)
        target.framebuffer.use()
        target.framebuffer.clear(0.0, 0.0, 0.0, 1.0)
        if not ordered:
            return
        self._ctx.enable_only(moderngl.BLEND)
        self._ctx.blend_equation = moderngl.FUNC_ADD  # pyright: ignore[reportAttributeAccessIssue]
        self._ctx.blend_func = FRONT_TO_BACK  # pyright: ignore[reportAttributeAccessIssue]
        order.use(0)
        projection.use(program, 1)
        set_uniforms(program, {**uniforms, "u_order": 0, "u_ordered": ordered})
        array.render(moderngl.TRIANGLES, instances=-(-ordered // QUADS_PER_INSTANCE))

    def draw_ellipsoids(
        self,
        target: ColourTarget,
        projection: ProjectionPass,
        uniforms: Mapping[str, Uniform],
        scene: SceneTextures,
    ) -> None:
        """Fills `target` with surfaces; a depth test takes the place of the order."""
        program, array = self._program("ellipsoids")
        framebuffer = target.with_depth()
        framebuffer.use()
        framebuffer.clear(0.0, 0.0, 0.0, 1.0, depth=1.0)
        if not scene.splats:
            return
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        self._ctx.depth_func = "<"
        samplers = {"u_positions": scene.positions, "u_quats": scene.quats, "u_scales": scene.scales}
        for unit, (name, texture) in enumerate(samplers.items()):
            texture.use(unit)
            set_uniforms(program, {name: unit})
        projection.use(program, len(samplers))
        set_uniforms(program, {**uniforms, "u_splats": scene.splats, "u_depth_unit": scene.radius})
        array.render(moderngl.TRIANGLES, instances=-(-scene.splats // QUADS_PER_INSTANCE))

    def release(self) -> None:
        for program, array in self._programs.values():
            array.release()
            program.release()
        self._indices.release()
