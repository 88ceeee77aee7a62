"""What `gathering` does, for OpenGL 3.3: draws the ordered splats, in each visual mode, from textures."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from .edit_textures import EditTextures
from .frame import VisualMode
from .gathering import FRONT_TO_BACK, mode_program, quad_indices
from .projection_pass import ProjectionPass
from .projector import QUADS_PER_INSTANCE
from .scene_textures import SceneTextures
from .targets import ColourTarget
from .variants import Variants
from .view_uniforms import Uniform, disc_flags, ray_flags, set_uniforms

NO_ORDERS = {"HAS_STOCHASTIC": 0, "HAS_WEIGHTED": 0}
"""Flags: splats are always sorted."""


class LegacyGathering:
    """Programs are compiled for a mode when it is first shown."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx = ctx
        self._variants = variants
        self._indices = ctx.buffer(quad_indices(QUADS_PER_INSTANCE))

    def draw_splats(
        self,
        mode: VisualMode,
        target: ColourTarget,
        projection: ProjectionPass,
        uniforms: Mapping[str, Uniform],
        edits: EditTextures,
        order: moderngl.Texture,
        ordered: int,
    ) -> None:
        """Fills `target` with the first `ordered` splats of `order`; all modes but ellipsoids."""
        flags = {**NO_ORDERS, **disc_flags(uniforms)}
        program, array = mode_program(self._variants, self._indices, "legacy", mode, edits, flags)
        target.framebuffer.use()
        target.framebuffer.clear(0.0, 0.0, 0.0, 1.0)
        if not ordered:
            return
        self._ctx.enable_only(moderngl.BLEND)
        self._ctx.blend_equation = moderngl.FUNC_ADD  # pyright: ignore[reportAttributeAccessIssue]
        self._ctx.blend_func = FRONT_TO_BACK  # pyright: ignore[reportAttributeAccessIssue]
        order.use(0)
        projection.use(program, 1)
        own = {"u_order": 0, "u_ordered": ordered, "u_brightest": target.brightest}
        set_uniforms(program, {**uniforms, **own})
        array.render(moderngl.TRIANGLES, instances=-(-ordered // QUADS_PER_INSTANCE))

    def draw_ellipsoids(
        self,
        target: ColourTarget,
        projection: ProjectionPass,
        uniforms: Mapping[str, Uniform],
        edits: EditTextures,
        scene: SceneTextures,
    ) -> None:
        """Fills `target` with surfaces; a depth test takes the place of the order."""
        program, array = mode_program(
            self._variants,
            self._indices,
            "legacy",
            "ellipsoids",
            edits,
            {**ray_flags(uniforms), "DISCS": False},
        )
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
        set_uniforms(program, {**uniforms, "u_splats": scene.splats, "u_depth_unit": edits.placement.radius})
        array.render(moderngl.TRIANGLES, instances=-(-scene.splats // QUADS_PER_INSTANCE))

    def release(self) -> None:
        self._indices.release()
