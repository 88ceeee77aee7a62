"""What both renderers of quads have in common: their interface, and where their pictures lie."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import contextmanager

import moderngl
import numpy as np

from splatview.renderers.gl.context import describe
from splatview.renderers.gl.edit_textures import EditTextures
from splatview.renderers.gl.programs import Variants
from splatview.renderers.gl.resolve import Resolving, float16_blending_truncates
from splatview.renderers.gl.targets import PictureTargets
from splatview.renderers.types import FrameStats, Highlight, VisualMode
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.attribute_formats import Attributes
from splatview.scene.edits import SceneEdits

# ---- GPU time of named stages, read back when it is ready and never waited for while drawing.


FRAMES_IN_FLIGHT = 4
"""Results are read this many uses of a stage later: no driver queues more frames ahead by default."""


class StageTimers:
    """Timer queries (GL_TIME_ELAPSED) by stage name; stages do not nest (GL allows one at a time).

    Where GL is a software rasteriser, stages are timed by the clock on the wall, between two waits for
    the queue to empty: the work is done by this process's own cores in any case, and llvmpipe's timer
    queries see none of the compute dispatches (it answers 0 or 2³² - 1 ns).
    """

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._by_wall_clock = describe(ctx).is_software
        self._pending: dict[str, deque[moderngl.Query]] = {}
        self._spare: list[moderngl.Query] = []
        self.latest: dict[str, float] = {}
        """Milliseconds by stage: of a frame a few back, or of the last one after `finish`."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times the GL commands issued inside."""
        if self._by_wall_clock:
            self._ctx.finish()
            began = time.perf_counter()
            yield
            self._ctx.finish()
            self.latest[name] = (time.perf_counter() - began) * 1000
            return
        pending = self._pending.setdefault(name, deque())
        if len(pending) >= FRAMES_IN_FLIGHT:
            self._collect(name)
        query = self._spare.pop() if self._spare else self._ctx.query(time=True)
        with query:
            yield
        pending.append(query)

    def _collect(self, name: str) -> None:
        query = self._pending[name].popleft()
        self.latest[name] = query.elapsed / 1e6
        self._spare.append(query)

    def finish(self) -> dict[str, float]:
        """Waits for every result and returns `latest`: for benchmarks, not for drawing."""
        for name, pending in self._pending.items():
            while pending:
                self._collect(name)
        return self.latest


class Renderer(ABC):
    """Draws scenes by `image_model` into its own texture.

    Nothing is projected, sorted or drawn again while scene, camera, settings, mode and edits stay the same.
    """

    def __init__(self, ctx: moderngl.Context, variants: Variants | None = None) -> None:
        self._ctx = ctx
        self._variants = variants or Variants(ctx)
        self._timers = StageTimers(ctx)
        self._edits = EditTextures(ctx)
        self._resolving = Resolving(ctx, self._variants)
        self._targets = PictureTargets(ctx, truncates=float16_blending_truncates(ctx))
        self._source: Gaussians | None = None
        """The scene that is loaded."""
        self.every_band = False
        """Whether scenes are loaded with the bands of spherical harmonics that nobody can see, too. So it is
        once settings ask for one that is not there, which takes as long as loading the scene again."""
        self._counters = {"projected": 0, "sorted": 0, "drawn": 0}

    def load(self, gaussians: Gaussians, attributes: Attributes = "float32") -> None:
        """Replaces the scene, all at once; stored as `attributes` (`scene.stored`).

        Raises:
            InputError: the scene does not fit into the GPU's memory, buffers or textures.
        """
        for _ in self.load_steps(gaussians, attributes):
            pass

    @abstractmethod
    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        """Replaces the scene in steps of a few milliseconds: yields the share done after each.

        The scene shown so far stays until the last step; closing the generator early leaves it so.

        Raises:
            InputError: as `load`.
        """

    @abstractmethod
    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        mode: VisualMode = "splats",
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> None:
        """Brings `framebuffer` up to date; does nothing where it is.

        `edits` of the scene that is loaded are shown; `highlight` lights up what they mark. What is only lit
        up otherwise, as a new selection is, costs no projection and no sort.

        Raises:
            RuntimeError: no scene was loaded.
            ValueError: the edits are another scene's.
            InputError: they do not fit into the driver's textures.
        """

    @abstractmethod
    def read(self) -> np.ndarray:
        """The picture asked for last: (H, W, 4) float32, row 0 on top. Waits for it."""

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        settings: RenderSettings | None = None,
        *,
        mode: VisualMode = "splats",
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> np.ndarray:
        """Loads `gaussians` unless they are the ones loaded, draws and reads: (H, W, 4) float32."""
        if gaussians is not self._source:
            self.load(gaussians)
        self._ask(camera, settings or RenderSettings(), mode=mode, edits=edits, highlight=highlight)
        return self.read()

    def _ask(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        mode: VisualMode,
        edits: SceneEdits | None,
        highlight: Highlight | None,
    ) -> None:
        """Makes this the picture that `read` gives."""
        self.draw(camera, settings, mode=mode, edits=edits, highlight=highlight)

    @abstractmethod
    def forget_order(self) -> None:
        """The next picture is sorted anew, whatever `RenderSettings.resort_frames` says."""

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """The picture drawn last; its row 0 is the picture's top row."""
        return self._targets.shown.framebuffer

    @property
    def texture(self) -> moderngl.Texture:
        """RGBA over the background, alpha = 1 - T, of the settings' `blend` precision."""
        return self._targets.shown.texture

    @property
    def busy(self) -> bool:
        """Whether another `draw` of the same view can give a better picture, now or soon."""
        return False

    @property
    def stats(self) -> FrameStats:
        """Of a recent frame; for drawing, as it waits for nothing."""
        return FrameStats(
            splats=len(self._source) if self._source is not None else 0,
            visible=self._visible(),
            ms=dict(self._timers.latest),
            **self._counters,
        )

    @abstractmethod
    def _visible(self) -> int:
        """Splats that were visible in a recent frame."""

    def finished_stats(self) -> FrameStats:
        """As `stats`, of the very last frame: waits for the GPU. For benchmarks and headless renders."""
        self._timers.finish()
        return self.stats

    def release(self) -> None:
        """Gives back all GPU memory; the renderer is of no use afterwards."""
        self._targets.release()
        self._edits.release()
        self._resolving.release()
        self._variants.release()
