"""The main renderer, GL 4.3: project and sort in compute shaders, then draw one quad per splat."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import moderngl
import numpy as np

from splatview.renderers.depth_colours import depth_range
from splatview.renderers.gl.blend import BlendPass
from splatview.renderers.gl.programs import Variants
from splatview.renderers.gl.project import DepthKeys, KeptOrder, Projector, short_keys
from splatview.renderers.gl.renderer import GLRenderer, degree_of, view_key
from splatview.renderers.gl.scene_buffers import SceneBuffers, upload_plan, upload_steps
from splatview.renderers.gl.sort import check_count
from splatview.renderers.gl.uniforms import Uniform, view_uniforms
from splatview.renderers.modes import MODES
from splatview.renderers.request import Capabilities, FrameRequest
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.attribute_formats import Attributes
from splatview.scene.image_model import Order
from splatview.scene.order_reuse import keeps_order

EARLY_STOP = 1.2e-4
"""Transmittance below which a pixel is closed."""

UNSORTED = ("weighted", "stochastic")
"""Orders that take no sort."""

WEIGHT_FALL = 40.0
"""A weight falls by this power of e from the front of the scene to its back. Scenes differ in what suits
them: a skull of 95,000 needles has 25.9 dB with 0, 29.1 with 20, 32.1 with 40 and 32.7 with 80, a thin scene
of 1,000 splats 44.8, 43.0, 40.1 and 39.2."""


class QuadsRenderer(GLRenderer):
    """Renderer for OpenGL 4.3 that blends one quad per splat."""

    name = "quads"
    capabilities = Capabilities(
        backend="quads",
        orders=("32-bit", "16-bit", "weighted", "stochastic"),
        precisions=("float32", "float16", "unorm8"),
    )

    def __init__(
        self, ctx: moderngl.Context, *, blend_pass: BlendPass | None = None, variants: Variants | None = None
    ) -> None:
        super().__init__(ctx, variants)
        self._projector = Projector(ctx, self._variants)
        self._scene: SceneBuffers | None = None
        self._blend_pass = blend_pass or BlendPass(ctx, self._variants)
        self._kept = KeptOrder(ctx, self._variants)
        self._early_stop = EARLY_STOP
        self._projected_key: object = None
        self._keeps = False
        """Whether the latest picture may have an older view's order."""
        self._box = np.zeros((2, 3))
        """Within which the scene's splats are."""
        self._drawn_key: object = None
        self._resolved_key: object = None

    @property
    def early_stop(self) -> float:
        """Blocks of the picture whose transmittance is below this everywhere are finished; 0: never. Where
        the settings name one, that counts.

        A pixel's error is at most this times the brightest colour behind it."""
        return self._early_stop

    @early_stop.setter
    def early_stop(self, transmittance: float) -> None:
        if not 0 <= transmittance < 1:
            raise ValueError(f"early_stop must be in [0, 1), got {transmittance}")
        self._early_stop = transmittance

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        n = len(gaussians)
        check_count(self._ctx, n)
        try:
            for step in upload_steps(self._ctx, gaussians, attributes=attributes, every_band=self.every_band):
                if isinstance(step, SceneBuffers):
                    self._use(step, gaussians)
                else:
                    yield step
        except moderngl.Error as error:
            raise InputError(f"{n:,} splats do not fit into this GPU's memory ({error})") from error

    def _use(self, scene: SceneBuffers, source: Gaussians) -> None:
        try:
            # The old scene stays as it is until there is room for the new one.
            box = upload_plan(source).box
            self._projector.resize(scene.splats)
        except BaseException:
            scene.release()
            raise
        if self._scene is not None:
            self._scene.release()
        self._edits.load(scene.placement, source.means)
        self._scene, self._source = scene, source
        self._box = box
        self._kept.start_anew()
        self._projected_key = None

    def draw(self, request: FrameRequest) -> None:
        self._prepare(request)
        scene = self._scene
        assert scene is not None
        settings, mode, camera = request.settings, request.mode, request.view
        sh_degree = degree_of(settings)
        if self._source is not None and scene.harmonics.lacks(sh_degree):
            self.every_band = True
            self.load(self._source, scene.attributes)
            scene = self._scene
            assert scene is not None
        editing = self._edits.update(request.edits, request.highlight)
        # Other modes show what an order is, or need one that is exact.
        order = settings.order if mode == "splats" else "32-bit"
        self._keeps = keeps = mode == "splats" and order not in UNSORTED and keeps_order(settings)
        projected_key = (
            *view_key(camera),
            *(order, (settings.resort_frames, settings.resort_degrees) if keeps else None),
            *(settings.model, settings.sigma_cut, sh_degree),
            editing.footprints,
            MODES[mode].normals,
        )
        early_stop = self._early_stop if settings.early_stop is None else settings.early_stop
        drawn_key = (projected_key, mode, settings.blend, early_stop, editing.tints_of(mode))
        resolved_key = (drawn_key, settings.background)
        if keeps and self._kept.resort_policy.stale and projected_key == self._projected_key:
            self._projected_key = None  # the view rests: it gets its own order
        if self._projected_key is not None and resolved_key == self._resolved_key:
            return
        uniforms = view_uniforms(camera, settings, scene.placement.centre)
        previous = self._ctx.detect_framebuffer()
        if projected_key != self._projected_key:
            near = settings.model.near
            keys = short_keys(*self._depths(camera, near), 16) if order == "16-bit" else DepthKeys()
            if keeps:
                with self._timers.stage("sort"):
                    self._keep_order(camera, settings, scene, uniforms, keys, editing.footprints)
            with self._timers.stage("project"):
                self._projector.project(
                    scene,
                    uniforms,
                    self._edits,
                    sh_degree=sh_degree,
                    antialiased=settings.model.antialiased,
                    keys=keys,
                    kept=self._kept if keeps else None,
                    slopes=order == "per-pixel",
                    normals=MODES[mode].normals,
                )
            if order not in UNSORTED and not keeps:
                with self._timers.stage("sort"):
                    self._projector.sort(keys.bits)
                self._counters["sorted"] += 1
            self._counters["projected"] += 1
            self._projected_key = projected_key
            self._drawn_key = None
        with self._timers.stage("draw"):
            if drawn_key != self._drawn_key:
                self._targets.fit(
                    (camera.width, camera.height), settings.blend, mode, sums=order == "weighted"
                )
                self._blend_pass.draw(
                    mode,
                    self._targets.accumulation,
                    scene,
                    self._projector,
                    uniforms,
                    self._edits,
                    early_stop=early_stop,
                    **self._unsorted(order, camera, settings.model.near),
                )
                self._counters["drawn"] += 1
                self._drawn_key = drawn_key
            self._resolving.draw(
                mode,
                self._targets.accumulation,
                self._targets.shown,
                background=settings.background,
                camera=camera,
                depths=depth_range(self._edits.placement.median, self._edits.placement.radius, camera),
                weighted=order == "weighted",
            )
            self._resolved_key = resolved_key
        previous.use()

    def _keep_order(
        self,
        camera: Camera,
        settings: RenderSettings,
        scene: SceneBuffers,
        uniforms: dict[str, Uniform],
        keys: DepthKeys,
        footprints: object,
    ) -> None:
        """Makes the order that is kept anew, where that is due."""
        key = (settings.model.near, keys.bits, footprints)
        centre, radius = self._box.mean(axis=0), float(np.linalg.norm(np.diff(self._box, axis=0))) / 2
        if self._kept.resort_policy.due(camera, settings, key=key, centre=centre, radius=radius):
            self._kept.make(scene, uniforms, self._edits, keys)
            self._counters["sorted"] += 1

    def forget_order(self) -> None:
        self._kept.resort_policy.forget()
        self._projected_key = None

    @property
    def busy(self) -> bool:
        return self._keeps and self._kept.resort_policy.stale and self._projected_key is not None

    def _unsorted(self, order: Order, camera: Camera, near: float) -> dict[str, Any]:
        """What `BlendPass.draw` is told of an order that takes no sort."""
        if order == "stochastic":
            return {"stochastic": True}
        if order == "per-pixel":
            return {"by_pixel": True}
        if order != "weighted":
            return {}
        least, greatest = self._depths(camera, near)
        fall = WEIGHT_FALL / (greatest - least) if greatest > least else 0.0
        return {"weights": {"u_nearest": least, "u_weight_fall": fall}}

    def _depths(self, camera: Camera, near: float) -> tuple[float, float]:
        """Between which all splats that can be seen are, as the file has them."""
        centre, half = self._box.mean(axis=0), np.diff(self._box, axis=0)[0] / 2
        middle, reach = camera.forward @ (centre - camera.eye), np.abs(camera.forward) @ half
        least = max(float(middle - reach), near)
        return least, max(float(middle + reach), least)

    def read(self) -> np.ndarray:
        return self._targets.shown.read()

    def _visible(self, wait: bool) -> int:
        visible = self._projector.visible
        return visible.read_now() if wait else visible.read()

    def close(self) -> None:
        super().close()
        if self._scene is not None:
            self._scene.release()
        self._projector.release()
        self._kept.release()
        self._blend_pass.release()
