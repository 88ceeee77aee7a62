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

PLACES_UNIT, RESTS_UNIT = 4, 5
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
        self._rows = 0
        self._disc_textures: tuple[moderngl.Texture, ...] = ()
        """Two more, once flat splats have been drawn..."""
        self._with_discs: moderngl.Framebuffer | None = None
        """... and what renders into all five."""
        self._passed = ctx.query(samples=True)
        self._counting = False
        self._visible = 0

    def resize(self, rows: int) -> None:
        """Makes room for a scene of `rows` rows of texels, and gives back that for the one before.

        Raises:
            InputError: there is not enough graphics memory; nothing has changed then.
        """
        textures, framebuffer = self._make_textures(3, rows, "footprints", ())
        self._release_sized()
        self._textures, self._framebuffer, self._rows = textures, framebuffer, rows

    def _make_textures(
        self, count: int, rows: int, name: str, others: tuple[moderngl.Texture, ...]
    ) -> tuple[tuple[moderngl.Texture, ...], moderngl.Framebuffer]:
        """`count` textures, and what renders into `others` and these. Raises InputError, all or none."""
        what, size = f"{rows * TEXTURE_WIDTH:,} {name}", rows * TEXTURE_WIDTH * 16 * count
        textures: list[moderngl.Texture] = []
        try:
            for _ in range(count):
                textures.append(self._ctx.texture((TEXTURE_WIDTH, rows), 4, dtype="f4"))
                check_room(self._ctx, what, size)
            return tuple(textures), self._ctx.framebuffer((*others, *textures))
        except (moderngl.Error, InputError) as error:
            for texture in textures:
                texture.release()
            raise no_room(what, size) from error

    def _disc_framebuffer(self) -> moderngl.Framebuffer:
        """That of all textures; made when discs are first drawn."""
        if self._with_discs is None:
            made = self._make_textures(2, self._rows, "discs", self._textures)
            self._disc_textures, self._with_discs = made
        return self._with_discs

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
        framebuffer = self._framebuffer
        flags = {
            "SH_DEGREE": min(sh_degree, scene.sh_degree),
            "ANTIALIASED": antialiased,
            **ray_flags(uniforms),
            "DEPTH": depth,
            **scene.flags(),
            **edits.now.flags(),
        }
        if flags["DISCS"]:
            flags["ANTIALIASED"] = False  # of no effect on discs
            framebuffer = self._disc_framebuffer()
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
        if scene.rests is not None:
            scene.rests.use(RESTS_UNIT)
            set_uniforms(program, {"u_rests": RESTS_UNIT})
        set_uniforms(program, {"u_splats": scene.splats})
        framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        framebuffer.clear()
        with self._passed:
            triangle.render(moderngl.TRIANGLES, vertices=3)
        self._counting = True

    def use(self, program: moderngl.Program, first_unit: int) -> None:
        """Binds the footprints for `program`: samplers u_shapes, u_bounds, u_colours; of discs, if there are,
        also u_rows and u_planes."""
        names = ("u_shapes", "u_bounds", "u_colours", "u_rows", "u_planes")
        textures = (*self._textures, *self._disc_textures)
        for unit, (name, texture) in enumerate(zip(names, textures, strict=False), start=first_unit):
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
        if self._with_discs is not None:
            self._with_discs.release()
            self._with_discs = None
        for texture in (*self._textures, *self._disc_textures):
            texture.release()
        self._textures = self._disc_textures = ()

    def release(self) -> None:
        self._release_sized()
