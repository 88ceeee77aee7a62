"""The main renderer, GL 4.3: project and sort in compute shaders, then draw a quad a splat."""

from __future__ import annotations

from collections.abc import Generator

import moderngl
import numpy as np

from ...scene import Camera, Gaussians, InputError, RenderSettings
from ...scene.edits import SceneEdits
from .edit_textures import EditTextures
from .frame import FrameStats, VisualMode
from .gathering import Gathering
from .overlay import Overlay
from .projector import RECORD_BYTES, Projector
from .resolving import Resolving, depth_range, float16_blending_truncates
from .scene_buffers import SceneBuffers, storage_limit, upload_steps
from .targets import PictureTargets
from .timers import StageTimers
from .view_uniforms import view_uniforms

EARLY_STOP = 1.2e-4
"""Transmittance below which a pixel is closed."""


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
        self._gathering = Gathering(ctx)
        self._resolving = Resolving(ctx)
        self._edits = EditTextures(ctx)
        self._early_stop = EARLY_STOP
        self._targets = PictureTargets(ctx, truncates=float16_blending_truncates(ctx))
        self._projected_key: object = None
        self._drawn_key: object = None
        self._resolved_key: object = None
        self._counters = {"projected": 0, "sorted": 0, "drawn": 0}

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

    def load(self, gaussians: Gaussians) -> None:
        """Replaces the scene, all at once.

        Raises:
            InputError: the scene does not fit into the GPU's memory or buffers.
        """
        for _ in self.load_steps(gaussians):
            pass

    def load_steps(self, gaussians: Gaussians) -> Generator[float, None, None]:
        """Replaces the scene in steps of a few milliseconds: yields the share done after each.

        The scene shown so far stays until the last step; closing the generator early leaves it so.

        Raises:
            InputError: as `load`.
        """
        n = len(gaussians)
        limit = storage_limit(self._ctx)
        if n * RECORD_BYTES > limit:
            raise InputError(
                f"{n:,} splats need a storage buffer of {n * RECORD_BYTES >> 20} MiB, this driver allows "
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
        self._edits.load(scene.placement, source.means)
        self._scene, self._source = scene, source
        self._projected_key = None

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        mode: VisualMode = "splats",
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> None:
        """Brings `framebuffer` up to date; does nothing where it is. A new selection is only drawn anew.

        `edits` of the scene that is loaded are shown; `overlay` lights up what they mark.

        Raises:
            RuntimeError: no scene was loaded.
            ValueError: the edits are another scene's.
            InputError: they do not fit into the driver's textures.
        """
        if self._scene is None:
            raise RuntimeError("load() comes before draw()")
        scene = self._scene
        sh_degree = 3 if settings.sh_degree is None else settings.sh_degree
        editing = self._edits.update(edits, overlay)
        projected_key = (*_view_key(camera), settings.model, sh_degree, editing.footprints)
        early_stop = self._early_stop if settings.early_stop is None else settings.early_stop
        drawn_key = (projected_key, mode, settings.blend, early_stop, editing.tints_of(mode))
        resolved_key = (drawn_key, settings.background)
        if self._projected_key is not None and resolved_key == self._resolved_key:
            return
        uniforms = view_uniforms(camera, settings.model, scene.placement.centre)
        previous = self._ctx.detect_framebuffer()
        if projected_key != self._projected_key:
            with self._timers.stage("project"):
                self._projector.project(
                    scene,
                    uniforms,
                    self._edits,
                    sh_degree=sh_degree,
                    antialiased=settings.model.antialiased,
                )
            with self._timers.stage("sort"):
                self._projector.sort()
            self._counters["projected"] += 1
            self._counters["sorted"] += 1
            self._projected_key = projected_key
            self._drawn_key = None
        with self._timers.stage("draw"):
            if drawn_key != self._drawn_key:
                self._targets.fit((camera.width, camera.height), settings.blend, mode)
                self._gathering.draw(
                    mode,
                    self._targets.gathered,
                    scene,
                    self._projector,
                    uniforms,
                    self._edits,
                    early_stop=early_stop,
                )
                self._counters["drawn"] += 1
                self._drawn_key = drawn_key
            self._resolving.draw(
                mode,
                self._targets.gathered,
                self._targets.shown,
                background=settings.background,
                depths=depth_range(self._edits.placement, camera) if mode == "depth" else None,
            )
            self._resolved_key = resolved_key
        previous.use()

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """The picture drawn last; its row 0 is the picture's top row."""
        return self._targets.shown.framebuffer

    @property
    def texture(self) -> moderngl.Texture:
        """RGBA over the background, alpha = 1 - T, of the settings' `blend` precision."""
        return self._targets.shown.texture

    def read(self) -> np.ndarray:
        """The picture drawn last: (H, W, 4) float32, row 0 on top. Waits for the GPU."""
        return self._targets.shown.read()

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        settings: RenderSettings | None = None,
        *,
        mode: VisualMode = "splats",
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> np.ndarray:
        """Loads `gaussians` unless they are the ones loaded, draws and reads: (H, W, 4) float32."""
        if gaussians is not self._source:
            self.load(gaussians)
        self.draw(camera, settings or RenderSettings(), mode=mode, edits=edits, overlay=overlay)
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
        self._targets.release()
        self._edits.release()
        if self._scene is not None:
            self._scene.release()
        self._projector.release()
        self._gathering.release()
        self._resolving.release()


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
