"""The `quads` renderer for OpenGL 3.3 and 4.1 (macOS): no compute shaders, no storage buffers.

Projection is a pass that writes a texel a splat, once per view; the draw then fetches its vertices from
those. The depth order comes from a thread on the CPU: while the camera moves, a frame may be drawn in
the order of a moment ago, and `busy` says that a better one is on its way; `read` waits for it.

Tried and dropped: drawing in 4 or 8 parts with a pass between them that closes opaque pixels to the depth
test. On llvmpipe frames took 0.83 to 1.13 times as long, depending on the scene.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import moderngl
import numpy as np

from ...scene import Camera, Gaussians, InputError, RenderSettings
from .frame import FrameStats, VisualMode
from .legacy_gathering import LegacyGathering
from .projection_pass import ProjectionPass
from .resolving import Resolving, depth_range, float16_blending_truncates
from .scene_textures import TEXTURE_WIDTH, SceneTextures, upload_steps
from .sort_worker import DepthOrder, SortWorker, ViewLine
from .targets import ColourTarget, Precision
from .timers import StageTimers
from .view_uniforms import Uniform, view_uniforms

OLDEST = 330


@dataclass(frozen=True, eq=False)
class _Wish:
    """What a picture shows, the scene apart."""

    camera: Camera
    settings: RenderSettings
    mode: VisualMode

    def same_footprints(self, other: _Wish | None) -> bool:
        return (
            other is not None
            and self.camera.same_view(other.camera)
            and (self.settings.model, self.settings.sh_degree, self.mode == "depth")
            == (other.settings.model, other.settings.sh_degree, other.mode == "depth")
        )

    def same_picture(self, other: _Wish | None) -> bool:
        return (
            other is not None
            and self.camera.same_view(other.camera)
            and (self.settings, self.mode) == (other.settings, other.mode)
        )


class LegacyQuadsRenderer:
    """Draws scenes by `image_model` into its own texture; the interface of `QuadsRenderer`, and its pictures.

    Raises:
        InputError: the context is older than OpenGL 3.3.
    """

    name = "quads (OpenGL 3.3)"

    def __init__(self, ctx: moderngl.Context) -> None:
        if not ctx.version_code >= OLDEST:
            raise InputError(
                f"OpenGL {ctx.version_code / 100:.1f} is too old, 3.3 is needed: use --renderer cpu"
            )
        self._ctx = ctx
        self._truncates = float16_blending_truncates(ctx)
        self._timers = StageTimers(ctx)
        self._projection = ProjectionPass(ctx)
        self._scene: SceneTextures | None = None
        self._source: Gaussians | None = None
        self._sorter: SortWorker | None = None
        self._order_texture: moderngl.Texture | None = None
        self._order: DepthOrder | None = None
        """What `_order_texture` holds."""
        self._gathering = LegacyGathering(ctx)
        self._resolving = Resolving(ctx)
        self._gathered: ColourTarget | None = None
        self._shown: ColourTarget | None = None
        self._projected: _Wish | None = None
        self._drawn: _Wish | None = None
        self._wanted: _Wish | None = None
        self._counters = {"projected": 0, "sorted": 0, "drawn": 0}

    # ---- loading

    def load(self, gaussians: Gaussians) -> None:
        """Replaces the scene, all at once.

        Raises:
            InputError: the scene does not fit into the driver's textures or memory.
        """
        for _ in self.load_steps(gaussians):
            pass

    def load_steps(self, gaussians: Gaussians) -> Iterator[float]:
        """Replaces the scene in steps of a few milliseconds: yields the share done after each.

        The scene shown so far stays until the last step; closing the generator early leaves it so.

        Raises:
            InputError: as `load`.
        """
        for step in upload_steps(self._ctx, gaussians):
            if isinstance(step, SceneTextures):
                self._use(step, gaussians)
            else:
                yield step

    def _use(self, scene: SceneTextures, source: Gaussians) -> None:
        self._release_scene()
        self._projection.resize(scene.rows)
        self._order_texture = self._ctx.texture((TEXTURE_WIDTH, scene.rows), 1, dtype="u4")
        self._sorter = SortWorker(source.means)
        self._scene, self._source = scene, source

    # ---- drawing

    def draw(self, camera: Camera, settings: RenderSettings, *, mode: VisualMode = "splats") -> None:
        """Brings `framebuffer` up to date as far as the order is known; never waits for an order.

        Does nothing where scene, camera, settings, mode and order are those of the last call. Until the
        first order of a scene is there, the picture is the background.

        Raises:
            RuntimeError: no scene was loaded.
        """
        if self._scene is None or self._sorter is None:
            raise RuntimeError("load() comes before draw()")
        self._wanted = wish = _Wish(camera, settings, mode)
        self._sorter.request(ViewLine.of(camera))
        self._draw(wish, self._scene, self._sorter.newest())

    def _draw(self, wish: _Wish, scene: SceneTextures, order: DepthOrder | None) -> None:
        if order is self._order and wish.same_picture(self._drawn):
            return
        settings = wish.settings
        uniforms = view_uniforms(wish.camera, settings.model, scene.centre)
        previous = self._ctx.detect_framebuffer()
        if not wish.same_footprints(self._projected):
            with self._timers.stage("project"):
                self._projection.run(
                    scene,
                    uniforms,
                    sh_degree=3 if settings.sh_degree is None else settings.sh_degree,
                    antialiased=settings.model.antialiased,
                    depth=wish.mode == "depth",
                )
            self._projected = wish
            self._counters["projected"] += 1
        with self._timers.stage("draw"):
            if order is not None and order is not self._order:
                self._upload_order(order)
            self._make_targets(wish)
            self._gather(wish, uniforms, scene)
            self._resolving.draw(
                wish.mode,
                self._target(self._gathered),
                self._target(self._shown),
                background=settings.background,
                # it reads radius and median, which both kinds of scene have
                depths=depth_range(scene, wish.camera),  # pyright: ignore[reportArgumentType]
            )
        self._drawn = wish
        self._counters["drawn"] += 1
        previous.use()

    def _upload_order(self, order: DepthOrder) -> None:
        if self._order_texture is None:
            raise RuntimeError("load() comes before draw()")
        rows, rest = divmod(len(order.order), TEXTURE_WIDTH)
        whole = rows * TEXTURE_WIDTH
        if rows:
            self._order_texture.write(order.order[:whole], viewport=(0, 0, TEXTURE_WIDTH, rows))
        if rest:
            self._order_texture.write(order.order[whole:], viewport=(0, rows, rest, 1))
        self._order = order
        self._timers.latest["sort"] = order.milliseconds
        self._counters["sorted"] += 1

    def _gather(self, wish: _Wish, uniforms: dict[str, Uniform], scene: SceneTextures) -> None:
        target = self._target(self._gathered)
        if wish.mode == "ellipsoids":
            self._gathering.draw_ellipsoids(target, self._projection, uniforms, scene)
            return
        if self._order_texture is None:
            raise RuntimeError("load() comes before draw()")
        ordered = 0
        if self._order is not None:
            # Behind the eye no vertices are needed; but in the order of another view they may be before it.
            exact = self._order.view == ViewLine.of(wish.camera)
            ordered = self._order.before_eye if exact else len(self._order.order)
        self._gathering.draw_splats(
            wish.mode, target, self._projection, uniforms, self._order_texture, ordered
        )

    def _make_targets(self, wish: _Wish) -> None:
        size, blend = (wish.camera.width, wish.camera.height), wish.settings.blend
        # Sums of depths and counts of splats need float32's digits, and so does a driver that truncates.
        wide = blend == "float32" or wish.mode in ("depth", "overdraw") or self._truncates
        self._gathered = self._fitting(self._gathered, size, "float32" if wide else "float16")
        self._shown = self._fitting(self._shown, size, blend)

    def _fitting(
        self, target: ColourTarget | None, size: tuple[int, int], precision: Precision
    ) -> ColourTarget:
        if target is not None:
            if (target.size, target.precision) == (size, precision):
                return target
            target.release()
        return ColourTarget(self._ctx, size, precision)

    @staticmethod
    def _target(target: ColourTarget | None) -> ColourTarget:
        if target is None:
            raise RuntimeError("draw() comes first")
        return target

    # ---- results

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """The picture drawn last; its row 0 is the picture's top row."""
        return self._target(self._shown).framebuffer

    @property
    def texture(self) -> moderngl.Texture:
        """RGBA over the background, alpha = 1 - T, of the settings' `blend` precision."""
        return self._target(self._shown).texture

    @property
    def busy(self) -> bool:
        """Whether another `draw` of the same view can give a better picture, now or soon."""
        if self._sorter is None:
            return False
        return self._sorter.busy or self._sorter.newest() is not self._order

    def read(self) -> np.ndarray:
        """The picture asked for last, in its exact order: (H, W, 4) float32, row 0 on top. Waits for it."""
        if self._scene is None or self._sorter is None or self._wanted is None:
            raise RuntimeError("draw() comes first")
        self._draw(self._wanted, self._scene, self._sorter.wait())
        return self._target(self._shown).read()

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        settings: RenderSettings | None = None,
        *,
        mode: VisualMode = "splats",
    ) -> np.ndarray:
        """Loads `gaussians` unless they are the ones loaded, draws and reads: (H, W, 4) float32."""
        if gaussians is not self._source:
            self.load(gaussians)
        if self._sorter is None:
            raise RuntimeError("load() keeps a sorter")
        # Not by draw(): it would first draw a picture in the order of an earlier view.
        self._wanted = _Wish(camera, settings or RenderSettings(), mode)
        self._sorter.request(ViewLine.of(camera))
        return self.read()

    @property
    def stats(self) -> FrameStats:
        """Times are of a frame a few back; "sort" is the thread's. Counting visible splats waits for the
        projection of the last frame, which has long been drawn when the next one asks."""
        return FrameStats(
            splats=self._scene.splats if self._scene else 0,
            visible=self._projection.read_visible(),
            ms=dict(self._timers.latest),
            **self._counters,
        )

    def finished_stats(self) -> FrameStats:
        """As `stats`, of the very last frame: waits for the GPU. For benchmarks and headless renders."""
        self._timers.finish()
        return self.stats

    def release(self) -> None:
        """Ends the sort thread and gives back all GPU memory; the renderer is of no use afterwards."""
        self._release_scene()
        self._release_targets()
        self._projection.release()
        self._gathering.release()
        self._resolving.release()

    def _release_scene(self) -> None:
        if self._sorter is not None:
            self._sorter.release()
        if self._scene is not None:
            self._scene.release()
        if self._order_texture is not None:
            self._order_texture.release()
        self._sorter = self._scene = self._source = self._order_texture = self._order = None
        self._projected = self._drawn = self._wanted = None

    def _release_targets(self) -> None:
        for target in (self._gathered, self._shown):
            if target is not None:
                target.release()
        self._gathered = self._shown = None
