"""Projection without compute shaders: a pass of fragments, one a splat, into float textures."""

from __future__ import annotations

import moderngl

from ...scene import InputError
from .edit_textures import EditTextures
from .memory import check_room, no_room
from .scene_textures import SceneTextures
from .texel_array import TEXTURE_WIDTH
from .variants import Variants
from .view_uniforms import Uniform, ray_flags, set_uniforms

PLACES_UNIT = 4
"""The texture unit after those of the attributes."""


class ProjectionPass:
    """Keeps the footprints of one view of a scene in three RGBA textures, laid out as the scene's are.

    The draw could project by itself, but would do so for each of a quad's four vertices, and again for
    every new order of the same view: 1.02 times the frame of large splats, 1.10 of 500,000 small ones.
    """

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx = ctx
        self._variants = variants
        self._textures: tuple[moderngl.Texture, ...] = ()
        self._framebuffer: moderngl.Framebuffer | None = None
        self._passed = ctx.query(samples=True)
        self._counting = False
        self._visible = 0

    def resize(self, rows: int) -> None:
        """Makes room for a scene of `rows` rows of texels, and gives back that for the one before.

        Raises:
            InputError: there is not enough graphics memory; nothing has changed then.
        """
        what, size = f"{rows * TEXTURE_WIDTH:,} footprints", rows * TEXTURE_WIDTH * 48
        textures: list[moderngl.Texture] = []
        try:
            for _ in range(3):
                textures.append(self._ctx.texture((TEXTURE_WIDTH, rows), 4, dtype="f4"))
                check_room(self._ctx, what, size)
            framebuffer = self._ctx.framebuffer(textures)
        except (moderngl.Error, InputError) as error:
            for texture in textures:
                texture.release()
            raise no_room(what, size) from error
        self._release_sized()
        self._textures, self._framebuffer = tuple(textures), framebuffer

    def run(
        self,
        scene: SceneTextures,
        uniforms: dict[str, Uniform],
        edits: EditTextures,
        *,
        sh_degree: int,
        antialiased: bool,
        depth: bool = False,
    ) -> None:
        """Projects all splats for `use`; `depth`: with their depths, world units, in place of colours."""
        if self._framebuffer is None:
            raise RuntimeError("resize() comes before run()")
        flags = {
            "SH_DEGREE": min(sh_degree, scene.sh_degree),
            "ANTIALIASED": antialiased,
            **ray_flags(uniforms),
            "DEPTH": depth,
            **scene.flags(),
            **edits.now.flags(),
        }
        program, triangle = self._variants.drawing(
            "quads/fullscreen.vert.glsl", "legacy/project.frag.glsl", flags
        )
        set_uniforms(program, uniforms)
        edits.use(program)
        for unit, (name, texture) in enumerate(
            (
                ("positions", scene.positions),
                ("quats", scene.quats),
                ("scales", scene.scales),
                ("sh", scene.sh),
            )
        ):
            texture.use(unit)
            set_uniforms(program, {f"u_{name}": unit})
        if scene.places is not None:
            scene.places.use(PLACES_UNIT)
            set_uniforms(program, {"u_places": PLACES_UNIT, "u_sh_layer": scene.sh_layer})
        set_uniforms(program, {"u_splats": scene.splats})
        self._framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        self._framebuffer.clear()
        with self._passed:
            triangle.render(moderngl.TRIANGLES, vertices=3)
        self._counting = True

    def use(self, program: moderngl.Program, first_unit: int) -> None:
        """Binds the footprints for `program`: samplers u_shapes, u_bounds, u_colours."""
        for unit, (name, texture) in enumerate(
            zip(("u_shapes", "u_bounds", "u_colours"), self._textures, strict=True), start=first_unit
        ):
            texture.use(unit)
            set_uniforms(program, {name: unit})

    def read_visible(self) -> int:
        """Splats that the last `run` did not cull; waits for it."""
        if self._counting:
            self._visible = self._passed.samples
            self._counting = False
        return self._visible

    def _release_sized(self) -> None:
        if self._framebuffer is not None:
            self._framebuffer.release()
            self._framebuffer = None
        for texture in self._textures:
            texture.release()
        self._textures = ()

    def release(self) -> None:
        self._release_sized()
