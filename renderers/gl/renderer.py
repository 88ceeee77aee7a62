"""What the renderers by OpenGL have in common: loading, timers, and where their pictures lie."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl

from splatview.renderers.depth_colours import depth_range
from splatview.renderers.gl.context import describe, held_bytes
from splatview.renderers.gl.edit_textures import EditTextures
from splatview.renderers.gl.programs import Variants
from splatview.renderers.gl.resolve import Resolving, float16_blending_truncates
from splatview.renderers.gl.targets import PictureTargets
from splatview.renderers.request import FrameRequest, FrameStats, Renderer
from splatview.scene import Camera, Gaussians, InputError, RenderSettings

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


class GLRenderer(Renderer):
    """What all renderers by OpenGL share: programs, timers, edits, targets, and where the picture lies.

    Nothing is projected, sorted or drawn again while a request asks for what the one before did.
    """

    def __init__(self, ctx: moderngl.Context, variants: Variants | None = None) -> None:
        self._ctx = ctx
        self._variants = variants or Variants(ctx)
        self._timers = StageTimers(ctx)
        self._edits = EditTextures(ctx)
        self._resolving = Resolving(ctx, self._variants)
        self._targets = PictureTargets(ctx, truncates=float16_blending_truncates(ctx))
        self._source: Gaussians | None = None
        """Scene that is loaded."""
        self.every_band = False
        """Whether scenes are loaded with the bands of spherical harmonics that nobody can see, too. So it is
        once settings ask for one that is not there, which takes as long as loading the scene again."""
        self._counters = {"projected": 0, "sorted": 0, "drawn": 0}

    def _prepare(self, request: FrameRequest) -> None:
        """Loads the request's scene where it is another one. Raises InputError for what cannot be drawn."""
        if request.gaussians is not None and request.gaussians is not self._source:
            self.load(request.gaussians, request.attributes)
        if self._source is None:
            raise RuntimeError("load() comes before draw()")
        problem = self.capabilities.unsupported(request)
        if problem is not None:
            raise InputError(problem)

    def finish(self) -> None:
        self._ctx.finish()

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

    def stats(self, *, wait: bool = False) -> FrameStats:
        if wait:
            self._timers.finish()
        return FrameStats(
            splats=len(self._source) if self._source is not None else 0,
            visible=self._visible(wait),
            ms=dict(self._timers.latest),
            **self._counters,
        )

    @abstractmethod
    def _visible(self, wait: bool) -> int:
        """Splats that were visible in a recent frame, or in the last one."""

    def depth_range(self, camera: Camera) -> tuple[float, float]:
        """Depths, world units, of the ends of the colours of the mode "depth" from `camera`."""
        return depth_range(self._edits.placement.median, self._edits.placement.radius, camera)

    def memory(self) -> int:
        return held_bytes(self)

    def close(self) -> None:
        self._targets.release()
        self._edits.release()
        self._resolving.release()
        self._variants.release()


def view_key(camera: Camera) -> tuple:
    """Equal ones make the same picture of any scene."""
    return (
        *(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy),
        *(camera.world_to_camera.tobytes(), camera.lens, camera.orthographic),
    )


def degree_of(settings: RenderSettings) -> int:
    """Highest SH degree that the settings show."""
    return 3 if settings.sh_degree is None else settings.sh_degree
