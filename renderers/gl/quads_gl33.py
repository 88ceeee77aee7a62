"""The `quads` renderer for OpenGL 3.3 and 4.1 (macOS): no compute shaders, no storage buffers.

Projection is a pass that writes one texel per splat, once per view; the draw then fetches its vertices from
those. The depth order comes from a thread on the CPU: while the camera moves, a frame may be drawn in
the order of a moment ago, and `busy` says that a better one is on its way; `read` waits for it.

Tried and dropped: drawing in 4 or 8 parts with a pass between them that closes opaque pixels to the depth
test. On llvmpipe frames took 0.83 to 1.13 times as long, depending on the scene.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping

import moderngl
import numpy as np

from splatview.measure.metrics import enlarged
from splatview.renderers.depth_colours import depth_range
from splatview.renderers.gl.blend import FRONT_TO_BACK, mode_program, quad_indices
from splatview.renderers.gl.context import check_room, no_room
from splatview.renderers.gl.edit_textures import Editing, EditTextures
from splatview.renderers.gl.programs import Variants
from splatview.renderers.gl.project import QUADS_PER_INSTANCE
from splatview.renderers.gl.renderer import GLRenderer, degree_of, view_key
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH, SceneTextures, TexelArray, upload_steps
from splatview.renderers.gl.sort_thread import DepthOrder, SortWorker, ViewLine
from splatview.renderers.gl.targets import ColourTarget
from splatview.renderers.gl.uniforms import Uniform, disc_flags, ray_flags, set_uniforms, view_uniforms
from splatview.renderers.modes import MODES, VisualMode
from splatview.renderers.request import Capabilities, FrameRequest
from splatview.scene import Gaussians, InputError
from splatview.scene.attribute_formats import Attributes

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
        normals: bool = False,
    ) -> None:
        """Projects all splats for `use`; `depth`: with their depths, world units, in place of colours;
        `normals`: in the colours of those."""
        if self._framebuffer is None:
            raise RuntimeError("resize() comes before run()")
        framebuffer = self._framebuffer
        flags = {
            "SH_DEGREE": min(sh_degree, scene.sh_degree),
            "ANTIALIASED": antialiased,
            **ray_flags(uniforms),
            "DEPTH": depth,
            "NORMALS": normals,
            **scene.flags(),
            **edits.now.flags(),
        }
        if flags["DISCS"]:
            flags["ANTIALIASED"] = False  # of no effect on discs
            framebuffer = self._disc_framebuffer()
        program, triangle = self._variants.drawing(
            "quads/fullscreen.vert.glsl", "quads_gl33/project.frag.glsl", flags
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


NO_ORDERS = {"HAS_STOCHASTIC": 0, "HAS_WEIGHTED": 0}
"""Flags: splats are always sorted."""


class BlendPassGL33:
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
        program, array = mode_program(self._variants, self._indices, "quads_gl33", mode, edits, flags)
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
            "quads_gl33",
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


OLDEST = 330


class QuadsGL33Renderer(GLRenderer):
    """Renderer for OpenGL 3.3, with the pictures of `QuadsRenderer`.

    `draw` never waits for an order: until the first one of a scene is there, it shows the background. `read`
    waits.

    Raises:
        InputError: the context is older than OpenGL 3.3.
    """

    name = "quads-gl33"
    capabilities = Capabilities(
        backend="quads",
        precisions=("float32", "float16", "unorm8"),
        attributes=("float32",),
        reuses_order=False,
        needs="OpenGL 4.3",
    )

    def __init__(self, ctx: moderngl.Context, variants: Variants | None = None) -> None:
        if not ctx.version_code >= OLDEST:
            raise InputError(
                f"OpenGL {ctx.version_code / 100:.1f} is too old, 3.3 is needed: use --renderer cpu"
            )
        super().__init__(ctx, variants)
        self._projection = ProjectionPass(ctx, self._variants)
        self._scene: SceneTextures | None = None
        self._sorter: SortWorker | None = None
        self._order_texels = TexelArray(ctx, 1, "u4", "splats")
        self._order: DepthOrder | None = None
        """What `_order_texels` holds."""
        self._blend_pass = BlendPassGL33(ctx, self._variants)
        self._projected: tuple | None = None
        self._drawn: tuple | None = None
        """Keys of what was projected and drawn last."""
        self._wanted: tuple[FrameRequest, Editing, ViewLine] | None = None
        """The latest request, its edits, and what the order of its splats depends on."""

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        if attributes not in self.capabilities.attributes:
            raise InputError(f"attributes in {attributes} need OpenGL 4.3; use float32 or --renderer cpu")
        for step in upload_steps(self._ctx, gaussians, every_band=self.every_band):
            if isinstance(step, SceneTextures):
                self._use(step, gaussians)
            else:
                yield step

    def _use(self, scene: SceneTextures, source: Gaussians) -> None:
        order_texels = TexelArray(self._ctx, 1, "u4", "splats")
        try:
            # The old scene stays as it is until there is room for the new one.
            order_texels.reserve(scene.splats)
            self._projection.resize(scene.rows)
        except BaseException:
            scene.release()
            order_texels.release()
            raise
        self._release_scene()
        self._order_texels = order_texels
        self._edits.load(scene.placement, source.means)
        self._sorter = SortWorker(source.means)
        self._scene, self._source = scene, source

    def forget_order(self) -> None:
        """It keeps none: the worker sorts every view."""

    def draw(self, request: FrameRequest) -> None:
        self._ask(request)
        self._draw(self._sort_thread().newest())

    def finish(self) -> None:
        self._draw(self._sort_thread().wait())
        super().finish()

    def render(self, request: FrameRequest) -> np.ndarray:
        # To draw first would be to draw in the order of an earlier view.
        self._ask(request)
        return enlarged(self.read(), request.camera.width, request.camera.height)

    def _sort_thread(self) -> SortWorker:
        if self._sorter is None:
            raise RuntimeError("load() comes before draw()")
        return self._sorter

    def _ask(self, request: FrameRequest) -> None:
        """Makes this the picture that `read` gives."""
        self._prepare(request)
        scene, source = self._scene, self._source
        if scene is not None and source is not None and scene.harmonics.lacks(degree_of(request.settings)):
            self.every_band = True
            self.load(source)
        editing = self._edits.update(request.edits, request.highlight)
        # Edits that leave every mean where it is leave the order, too.
        line = ViewLine.of(request.view, request.edits if editing.places else None, editing.places)
        self._wanted = request, editing, line
        self._sort_thread().request(line)

    def _draw(self, order: DepthOrder | None) -> None:
        """Brings the picture up to date, in `order`."""
        scene = self._scene
        if self._wanted is None or scene is None:
            return
        request, editing, line = self._wanted
        camera, settings, mode = request.view, request.settings, request.mode
        view, depths, normals = view_key(camera), MODES[mode].depths, MODES[mode].normals
        projected = (
            *(view, settings.model, settings.sigma_cut, settings.sh_degree),
            *(depths, normals, editing.footprints),
        )
        drawn = (view, settings, mode, editing.footprints, editing.tints_of(mode))
        if order is self._order and drawn == self._drawn:
            return
        uniforms = view_uniforms(camera, settings, scene.placement.centre)
        previous = self._ctx.detect_framebuffer()
        if projected != self._projected:
            with self._timers.stage("project"):
                self._projection.run(
                    scene,
                    uniforms,
                    self._edits,
                    sh_degree=degree_of(settings),
                    antialiased=settings.model.antialiased,
                    depth=depths,
                    normals=normals,
                )
            self._projected = projected
            self._counters["projected"] += 1
        with self._timers.stage("draw"):
            if order is not None and order is not self._order:
                self._order_texels.write(order.order)
                self._order = order
                self._timers.latest["sort"] = order.milliseconds
                self._counters["sorted"] += 1
            self._targets.fit((camera.width, camera.height), settings.blend, mode)
            self._gather(mode, line, uniforms, scene)
            self._resolving.draw(
                mode,
                self._targets.accumulation,
                self._targets.shown,
                background=settings.background,
                camera=camera,
                depths=depth_range(self._edits.placement.median, self._edits.placement.radius, camera),
            )
        self._drawn = drawn
        self._counters["drawn"] += 1
        previous.use()

    def _gather(
        self, mode: VisualMode, line: ViewLine, uniforms: dict[str, Uniform], scene: SceneTextures
    ) -> None:
        target = self._targets.accumulation
        if MODES[mode].surfaces:
            self._blend_pass.draw_ellipsoids(target, self._projection, uniforms, self._edits, scene)
            return
        ordered = 0
        if self._order is not None:
            # Behind the eye no vertices are needed; but in the order of another view they may be before it.
            exact = self._order.view == line
            ordered = self._order.before_eye if exact else len(self._order.order)
        self._blend_pass.draw_splats(
            mode, target, self._projection, uniforms, self._edits, self._order_texels.texture, ordered
        )

    @property
    def busy(self) -> bool:
        if self._sorter is None:
            return False
        return self._sorter.busy or self._sorter.newest() is not self._order

    def read(self) -> np.ndarray:
        if self._wanted is None:
            raise RuntimeError("draw() comes first")
        self._draw(self._sort_thread().wait())
        return self._targets.shown.read()

    def _visible(self, wait: bool) -> int:
        # Waits for the projection of the last frame, which has long been drawn when the next one asks.
        return self._projection.read_visible()

    def close(self) -> None:
        self._release_scene()  # ends the sort thread
        super().close()
        self._projection.release()
        self._blend_pass.release()

    def _release_scene(self) -> None:
        if self._sorter is not None:
            self._sorter.release()
        if self._scene is not None:
            self._scene.release()
        self._order_texels.release()
        self._sorter = self._scene = self._source = self._order = None
        self._projected = self._drawn = self._wanted = None
