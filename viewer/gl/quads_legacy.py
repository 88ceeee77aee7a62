"""The `quads` renderer for OpenGL 3.3 and 4.1 (macOS): no compute shaders, no storage buffers.

Projection is a pass that writes a texel a splat, once per view; the draw then fetches its vertices from
those. The depth order comes from a thread on the CPU: while the camera moves, a frame may be drawn in
the order of a moment ago, and `busy` says that a better one is on its way; `read` waits for it.

Tried and dropped: drawing in 4 or 8 parts with a pass between them that closes opaque pixels to the depth
test. On llvmpipe frames took 0.83 to 1.13 times as long, depending on the scene.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import moderngl
import numpy as np

from ...scene import Camera, Gaussians, InputError, RenderSettings
from ...scene.edits import SceneEdits
from ...scene.stored import Attributes
from .abilities import COMPUTE, refusal
from .edit_textures import Editing
from .frame import VisualMode
from .legacy_gathering import LegacyGathering
from .overlay import Overlay
from .projection_pass import ProjectionPass
from .renderer import Renderer
from .resolving import depth_range
from .scene_textures import SceneTextures, upload_steps
from .sort_worker import DepthOrder, SortWorker, ViewLine
from .texel_array import TexelArray
from .variants import Variants
from .view_uniforms import Uniform, check_rays, view_uniforms

OLDEST = 330


@dataclass(frozen=True, eq=False)
class _Wish:
    """What a picture shows, the scene apart."""

    camera: Camera
    settings: RenderSettings
    mode: VisualMode
    editing: Editing
    line: ViewLine
    """What the order of the splats depends on."""

    @property
    def _footprints(self) -> tuple:
        settings = self.settings
        return (
            settings.model,
            settings.sigma_cut,
            settings.sh_degree,
            self.mode == "depth",
            self.editing.footprints,
        )

    @property
    def _picture(self) -> tuple:
        return (self.settings, self.mode, self.editing.footprints, self.editing.tints_of(self.mode))

    def same_footprints(self, other: _Wish | None) -> bool:
        return (
            other is not None
            and self.camera.same_view(other.camera)
            and self._footprints == other._footprints
        )

    def same_picture(self, other: _Wish | None) -> bool:
        return other is not None and self.camera.same_view(other.camera) and self._picture == other._picture


class LegacyQuadsRenderer(Renderer):
    """The `Renderer` for OpenGL 3.3, with the pictures of `QuadsRenderer`.

    `draw` never waits for an order: until the first one of a scene is there, it shows the background. `read`
    waits.

    Raises:
        InputError: the context is older than OpenGL 3.3.
    """

    name = "quads (OpenGL 3.3)"

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
        self._gathering = LegacyGathering(ctx, self._variants)
        self._projected: _Wish | None = None
        self._drawn: _Wish | None = None
        self._wanted: _Wish | None = None

    # ---- loading

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        problem = refusal(COMPUTE - 1, attributes=attributes)
        if problem is not None:
            raise InputError(problem)
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

    # ---- drawing

    def forget_order(self) -> None:
        """It keeps none: the worker sorts every view."""

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        mode: VisualMode = "splats",
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> None:
        self._ask(camera, settings, mode=mode, edits=edits, overlay=overlay)
        scene, sorter = self._loaded()
        if self._wanted is not None:
            self._draw(self._wanted, scene, sorter.newest())

    def _loaded(self) -> tuple[SceneTextures, SortWorker]:
        if self._scene is None or self._sorter is None:
            raise RuntimeError("load() comes before draw()")
        return self._scene, self._sorter

    def _ask(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        mode: VisualMode,
        edits: SceneEdits | None,
        overlay: Overlay | None,
    ) -> None:
        # For `render` this is all: to draw would be to draw in the order of an earlier view first.
        scene, sorter = self._loaded()
        if self._source is not None and scene.harmonics.lacks(
            3 if settings.sh_degree is None else settings.sh_degree
        ):
            self.every_band = True
            self.load(self._source)
            _, sorter = self._loaded()
        check_rays(camera, mode)
        editing = self._edits.update(edits, overlay)
        problem = refusal(COMPUTE - 1, settings)
        if problem is not None:
            raise InputError(problem)
        self._wanted = _Wish(camera, settings, mode, editing, _line(camera, editing, edits))
        sorter.request(self._wanted.line)

    def _draw(self, wish: _Wish, scene: SceneTextures, order: DepthOrder | None) -> None:
        if order is self._order and wish.same_picture(self._drawn):
            return
        settings = wish.settings
        uniforms = view_uniforms(wish.camera, settings, scene.placement.centre)
        previous = self._ctx.detect_framebuffer()
        if not wish.same_footprints(self._projected):
            with self._timers.stage("project"):
                self._projection.run(
                    scene,
                    uniforms,
                    self._edits,
                    sh_degree=3 if settings.sh_degree is None else settings.sh_degree,
                    antialiased=settings.model.antialiased,
                    depth=wish.mode == "depth",
                )
            self._projected = wish
            self._counters["projected"] += 1
        with self._timers.stage("draw"):
            if order is not None and order is not self._order:
                self._upload_order(order)
            self._targets.fit((wish.camera.width, wish.camera.height), settings.blend, wish.mode)
            self._gather(wish, uniforms, scene)
            self._resolving.draw(
                wish.mode,
                self._targets.gathered,
                self._targets.shown,
                background=settings.background,
                camera=wish.camera,
                depths=depth_range(self._edits.placement, wish.camera) if wish.mode == "depth" else None,
            )
        self._drawn = wish
        self._counters["drawn"] += 1
        previous.use()

    def _upload_order(self, order: DepthOrder) -> None:
        self._order_texels.write(order.order)
        self._order = order
        self._timers.latest["sort"] = order.milliseconds
        self._counters["sorted"] += 1

    def _gather(self, wish: _Wish, uniforms: dict[str, Uniform], scene: SceneTextures) -> None:
        target = self._targets.gathered
        if wish.mode == "ellipsoids":
            self._gathering.draw_ellipsoids(target, self._projection, uniforms, self._edits, scene)
            return
        ordered = 0
        if self._order is not None:
            # Behind the eye no vertices are needed; but in the order of another view they may be before it.
            exact = self._order.view == wish.line
            ordered = self._order.before_eye if exact else len(self._order.order)
        self._gathering.draw_splats(
            wish.mode,
            target,
            self._projection,
            uniforms,
            self._edits,
            self._order_texels.texture,
            ordered,
        )

    # ---- results

    @property
    def busy(self) -> bool:
        if self._sorter is None:
            return False
        return self._sorter.busy or self._sorter.newest() is not self._order

    def read(self) -> np.ndarray:
        if self._wanted is None:
            raise RuntimeError("draw() comes first")
        scene, sorter = self._loaded()
        self._draw(self._wanted, scene, sorter.wait())
        return self._targets.shown.read()

    def _visible(self) -> int:
        # Waits for the projection of the last frame, which has long been drawn when the next one asks.
        return self._projection.read_visible()

    def release(self) -> None:
        self._release_scene()  # ends the sort thread
        super().release()
        self._projection.release()
        self._gathering.release()

    def _release_scene(self) -> None:
        if self._sorter is not None:
            self._sorter.release()
        if self._scene is not None:
            self._scene.release()
        self._order_texels.release()
        self._sorter = self._scene = self._source = self._order = None
        self._projected = self._drawn = self._wanted = None


def _line(camera: Camera, editing: Editing, edits: SceneEdits | None) -> ViewLine:
    """Edits that leave every mean where it is leave the order, too."""
    return ViewLine.of(camera, edits if editing.places else None, editing.places)
