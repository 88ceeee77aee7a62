"""The main renderer, GL 4.3: project and sort in compute shaders, then draw a quad a splat."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np

from ...scene import Camera, Gaussians, InputError, RenderSettings
from .frame import FrameStats, VisualMode
from .programs import load_render_program
from .projector import QUADS_PER_INSTANCE, RECORD_BYTES, Projector
from .scene_buffers import SceneBuffers, storage_limit, upload_steps
from .targets import ColourTarget
from .timers import StageTimers
from .view_uniforms import set_uniforms, view_uniforms


class QuadsRenderer:
    """Draws scenes by `image_model` into its own texture; needs GL 4.3.

    Nothing is projected, sorted or drawn again while scene, camera, settings and mode stay the same.
    """

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._projector = Projector(ctx)
        self._timers = StageTimers(ctx)
        self._scene: SceneBuffers | None = None
        self._source: Gaussians | None = None
        self._indices = ctx.buffer(quad_indices(QUADS_PER_INSTANCE))
        self._draw_splats = self._program("quads/draw.vert.glsl", "quads/draw.frag.glsl")
        self._draw_array = ctx.vertex_array(
            self._draw_splats, [], index_buffer=self._indices, index_element_size=4
        )
        self._resolve = self._program("quads/fullscreen.vert.glsl", "quads/resolve.frag.glsl")
        self._resolve_array = ctx.vertex_array(self._resolve, [])
        self._gathered: ColourTarget | None = None
        self._shown: ColourTarget | None = None
        self._projected_key: object = None
        self._drawn_key: object = None
        self._resolved_key: object = None
        self._counters = {"projected": 0, "sorted": 0, "drawn": 0}

    def _program(self, vertex: str, fragment: str) -> moderngl.Program:
        return load_render_program(self._ctx, vertex, fragment, {"QUADS_PER_INSTANCE": QUADS_PER_INSTANCE})

    def load(self, gaussians: Gaussians) -> None:
        """Replaces the scene, all at once.

        Raises:
            InputError: the scene does not fit into the GPU's memory or buffers.
        """
        for _ in self.load_steps(gaussians):
            pass

    def load_steps(self, gaussians: Gaussians) -> Iterator[float]:
        """Replaces the scene in steps of a few milliseconds: yields the share done after each.

        The scene shown so far stays until the last step; closing the generator early leaves it so.

        Raises:
            InputError: as `load`.
        """
        n = len(gaussians)
        limit = storage_limit(self._ctx)
        if n * RECORD_BYTES > limit:
            raise InputError(
                f"{n:,} splats need a storage buffer of {n * RECORD_BYTES >> 20} MiB, this OpenGL driver allows "
                f"{limit >> 20} MiB; use --renderer cpu or fewer splats"
            )
        try:
            for step in upload_steps(self._ctx, gaussians):
                if isinstance(step, SceneBuffers):
                    self._use(step, gaussians)
                else:
                    yield step
        except moderngl.Error as error:
            raise InputError(f"{n:,} splats do not fit into this GPU's memory ({error})") from error

    def _use(self, scene: SceneBuffers, source: Gaussians) -> None:
        if self._scene is not None:
            self._scene.release()
        self._projector.resize(scene.splats)
        self._scene, self._source = scene, source
        self._projected_key = None

    def draw(self, camera: Camera, settings: RenderSettings, *, mode: VisualMode = "splats") -> None:
        """Brings `framebuffer` up to date; does nothing where it is.

        Raises:
            RuntimeError: no scene was loaded.
        """
        if self._scene is None:
            raise RuntimeError("load() comes before draw()")
        scene = self._scene
        sh_degree = 3 if settings.sh_degree is None else settings.sh_degree
        projected_key = (*_view_key(camera), settings.model, sh_degree)
        drawn_key = (projected_key, mode, settings.blend)
        resolved_key = (drawn_key, settings.background)
        if self._projected_key is not None and resolved_key == self._resolved_key:
            return
        uniforms = view_uniforms(camera, settings.model, scene.centre)
        previous = self._ctx.detect_framebuffer()
        if projected_key != self._projected_key:
            with self._timers.stage("project"):
                self._projector.project(
                    scene, uniforms, sh_degree=sh_degree, antialiased=settings.model.antialiased
                )
            with self._timers.stage("sort"):
                self._projector.sort()
            self._counters["projected"] += 1
            self._counters["sorted"] += 1
            self._projected_key = projected_key
            self._drawn_key = None
        with self._timers.stage("draw"):
            if drawn_key != self._drawn_key:
                self._make_targets((camera.width, camera.height), settings)
                self._gather(uniforms)
                self._counters["drawn"] += 1
                self._drawn_key = drawn_key
            self._show(settings)
            self._resolved_key = resolved_key
        previous.use()

    def _make_targets(self, size: tuple[int, int], settings: RenderSettings) -> None:
        if self._gathered is not None and self._shown is not None:
            if (self._gathered.size, self._gathered.precision) == (size, settings.blend):
                return
            self._gathered.release()
            self._shown.release()
        self._gathered = ColourTarget(self._ctx, size, settings.blend)
        self._shown = ColourTarget(self._ctx, size, settings.blend)

    def _gather(self, uniforms: dict) -> None:
        ctx, projector = self._ctx, self._projector
        target = self._target(self._gathered)
        target.framebuffer.use()
        target.framebuffer.clear(0.0, 0.0, 0.0, 1.0)
        ctx.enable_only(moderngl.BLEND)
        ctx.blend_equation = moderngl.FUNC_ADD
        ctx.blend_func = (moderngl.DST_ALPHA, moderngl.ONE, moderngl.ZERO, moderngl.ONE_MINUS_SRC_ALPHA)
        buffers = (
            projector.order,
            projector.visible.buffer,
            projector.shapes,
            projector.bounds,
            projector.colours,
        )
        for slot, buffer in enumerate(buffers):
            buffer.bind_to_storage_buffer(slot)
        set_uniforms(self._draw_splats, uniforms)
        self._draw_array.render_indirect(projector.command, moderngl.TRIANGLES, count=1)

    def _show(self, settings: RenderSettings) -> None:
        self._target(self._shown).framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        self._target(self._gathered).texture.use(0)
        set_uniforms(self._resolve, {"u_gathered": 0, "u_background": settings.background})
        self._resolve_array.render(moderngl.TRIANGLES, vertices=3)

    @staticmethod
    def _target(target: ColourTarget | None) -> ColourTarget:
        if target is None:
            raise RuntimeError("draw() comes first")
        return target

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """The picture drawn last; its row 0 is the picture's top row."""
        return self._target(self._shown).framebuffer

    @property
    def texture(self) -> moderngl.Texture:
        """RGBA over the background, alpha = 1 - T, of the settings' `blend` precision."""
        return self._target(self._shown).texture

    def read(self) -> np.ndarray:
        """The picture drawn last: (H, W, 4) float32, row 0 on top. Waits for the GPU."""
        return self._target(self._shown).read()

    def render(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings | None = None
    ) -> np.ndarray:
        """Loads `gaussians` unless they are the ones loaded, draws and reads: (H, W, 4) float32."""
        if gaussians is not self._source:
            self.load(gaussians)
        self.draw(camera, settings or RenderSettings())
        return self.read()

    @property
    def stats(self) -> FrameStats:
        """Costs nothing and waits for nothing: times and count may be of a frame a few back."""
        return FrameStats(
            splats=self._scene.splats if self._scene else 0,
            visible=self._projector.visible.read(),
            ms=dict(self._timers.latest),
            **self._counters,
        )

    def finished_stats(self) -> FrameStats:
        """As `stats`, of the very last frame: waits for the GPU. For benchmarks and headless renders."""
        self._timers.finish()
        self._projector.visible.read_now()
        return FrameStats(
            splats=self._scene.splats if self._scene else 0,
            visible=self._projector.visible.read_now(),
            ms=dict(self._timers.latest),
            **self._counters,
        )

    def release(self) -> None:
        """Gives back all GPU memory; the renderer is of no use afterwards."""
        for target in (self._gathered, self._shown):
            if target is not None:
                target.release()
        if self._scene is not None:
            self._scene.release()
        self._projector.release()
        for thing in (
            self._draw_array,
            self._resolve_array,
            self._draw_splats,
            self._resolve,
            self._indices,
        ):
            thing.release()


def quad_indices(quads: int) -> np.ndarray:
    """Vertex numbers (6 * quads,) uint32 of two triangles a quad, four vertices each."""
    corners = np.array([0, 1, 2, 2, 1, 3], dtype=np.uint32)
    return (np.arange(quads, dtype=np.uint32)[:, None] * 4 + corners).ravel()


def _view_key(camera: Camera) -> tuple:
    return (
        camera.width,
        camera.height,
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.world_to_camera.tobytes(),
    )
