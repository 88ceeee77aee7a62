"""The CPU rasteriser's pictures in a texture: coarse while the camera moves, sharp when it rests."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import moderngl
import numpy as np

from ... import raster
from ...scene import Camera, Gaussians, RenderSettings
from . import FrameStats

REST_SECONDS = 0.25
"""A camera that has not changed for so long rests: the next picture may take its time."""

MOVING_MS = 50.0
"""What a picture may take while the camera moves: 20 a second."""

LEAST_SCALE = 1 / 4
"""Of the picture's sides; below this nothing can be recognised."""

STEP = 1 / 8
"""Between the scales that are used."""

FIXED_SHARE = 1.25
"""Where even the fewest pixels take longer than MOVING_MS: what a picture may take, in units of that."""


@dataclass(frozen=True, eq=False)
class _Wish:
    """What the window wants to see; the scene is part of it, so a new one makes all else stale."""

    gaussians: Gaussians
    camera: Camera
    settings: RenderSettings
    since: float

    def same_picture(self, other: _Wish) -> bool:
        return self.gaussians is other.gaussians and self.same_view(other)

    def same_view(self, other: _Wish) -> bool:
        """Of whatever scene."""
        return self.settings == other.settings and self.camera.same_view(other.camera)


class CpuTexture:
    """Renders in a thread of its own, the latest wish first; wishes overtaken meanwhile are dropped.

    All methods are for the GL thread. `on_ready` is called in the worker when a picture has come.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        *,
        threads: int | None = None,
        on_ready: Callable[[], object] = lambda: None,
    ):
        self._ctx = ctx
        self.threads = threads
        """Cores to draw with; None: all. May be changed at any time."""
        self._on_ready = on_ready
        self._change = threading.Condition()
        # Guarded by _change:
        self._wish: _Wish | None = None
        self._resting = False
        self._finished: _Wish | None = None  # drawn at full resolution
        self._image: np.ndarray | None = None  # not uploaded yet
        self._stats = FrameStats(splats=0, visible=0, ms={}, projected=0, sorted=0, drawn=0)
        self._ended = False
        self.status = ""
        """What the user should know while waiting, or ""."""
        self.problem: str | None = None
        """What went wrong in the worker, until the window takes it."""
        self._gaussians: Gaussians | None = None
        self._motion = MotionScale()
        self._warm: Gaussians | None = None
        self.texture = ctx.texture((1, 1), 4, dtype="f4")
        self._thread = threading.Thread(target=self._work, name="splatview-cpu", daemon=True)
        self._thread.start()

    def load(self, gaussians: Gaussians) -> None:
        """Replaces the scene; pictures of the old one are no longer shown."""
        self._gaussians = gaussians

    def draw(self, camera: Camera, settings: RenderSettings) -> None:
        """Asks for a picture and shows the latest that is there. Never waits."""
        if self._gaussians is None:
            return
        wish = _Wish(self._gaussians, camera, settings, time.monotonic())
        with self._change:
            if self._wish is None or not self._wish.same_picture(wish):
                # A scene that changes before an eye at rest, as in training, is drawn sharp at once.
                self._resting = self._resting and self._wish is not None and self._wish.same_view(wish)
                self._wish = wish
                self._change.notify()
            elif not self._resting and wish.since - self._wish.since >= REST_SECONDS:
                # Only a window that still asks for it says that it rests: a slow one may just be late.
                self._resting = True
                self._change.notify()
            image, self._image = self._image, None
        if image is not None:
            self._upload(image)

    def read(self, camera: Camera, settings: RenderSettings) -> np.ndarray:
        """The full picture (H, W, 4) float32, rendered while the caller waits."""
        if self._gaussians is None:
            return np.zeros((camera.height, camera.width, 4), np.float32)
        return raster.render(self._gaussians, camera, settings, threads=self.threads)

    @property
    def busy(self) -> bool:
        """Whether what is shown is not yet the full picture of the latest wish."""
        with self._change:
            return self._wish is not None and (self._finished is not self._wish or self._image is not None)

    @property
    def stats(self) -> FrameStats:
        with self._change:
            return self._stats

    def release(self) -> None:
        """Ends the worker, after the picture it is at."""
        with self._change:
            self._ended = True
            self._change.notify()
        self._thread.join()
        self.texture.release()

    def _upload(self, image: np.ndarray) -> None:
        height, width = image.shape[:2]
        if self.texture.size != (width, height):
            self.texture.release()
            self.texture = self._ctx.texture((width, height), 4, dtype="f4")
        self.texture.write(image)

    # ---- in the worker

    def _work(self) -> None:
        workspace = raster.Workspace()
        coarse: _Wish | None = None  # drawn, but only at the moving resolution
        while True:
            with self._change:
                while not self._ended and not self._due(coarse):
                    self._change.wait()
                if self._ended:
                    return
                wish = self._wish
                assert wish is not None
                moving = coarse is not wish and not self._resting and self._motion.scale < 1
            try:
                self._render(wish, moving, workspace)
            except Exception as error:
                # The thread must live: the next scene may be a better one.
                with self._change:
                    self.problem = f"the CPU renderer failed: {type(error).__name__}: {error}"
                    self._finished = wish
            coarse = wish
            self._on_ready()

    def _due(self, coarse: _Wish | None) -> bool:
        """Whether something is to be drawn now: a new wish, or the sharp picture of one that rests."""
        if self._wish is None or self._finished is self._wish:
            return False
        return coarse is not self._wish or self._resting

    def _render(self, wish: _Wish, moving: bool, workspace: raster.Workspace) -> None:
        camera, scale = wish.camera, self._motion.scale if moving else 1.0
        if moving:
            camera = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        if raster.will_compile():
            self.status = "Preparing the CPU renderer for this machine; this happens once"
            self._on_ready()
        frame = raster.draw_frame(
            raster.parameters_of(wish.gaussians), camera, wish.settings, workspace, threads=self.threads
        )
        self.status = ""
        visible = sum(stop - start for start, stop in frame.runs)
        with self._change:
            if self._gaussians is wish.gaussians:
                self._image = frame.image
            old = self._stats
            self._stats = FrameStats(
                splats=len(wish.gaussians),
                visible=visible,
                ms=dict(frame.milliseconds),
                projected=old.projected + 1,
                sorted=old.sorted + 1,
                drawn=old.drawn + 1,
            )
            if not moving:
                self._finished = wish
            # A scene's first picture also pays for memory that later ones find ready.
            if self._warm is wish.gaussians:
                self._motion.learn(sum(frame.milliseconds.values()), scale)
            self._warm = wish.gaussians


class MotionScale:
    """Which share of the sides moving pictures get, learnt from the time that pictures take.

    Time is taken as fixed + of_pixels·scale²: many small splats cost much whatever the pixels, and then
    fewer of those would only blur the picture. A full and a reduced picture tell the two parts.
    """

    def __init__(self) -> None:
        self.scale = 0.5
        self._full_ms: float | None = None
        self._fixed_ms = 0.0

    def learn(self, milliseconds: float, scale: float) -> None:
        """A picture at `scale` took so long."""
        if scale >= 1:
            self._full_ms = milliseconds
        elif self._full_ms is not None:
            of_pixels = max(self._full_ms - milliseconds, 0.0) / (1 - scale * scale)
            self._fixed_ms = max(self._full_ms - of_pixels, 0.0)
        if self._full_ms is None:
            return
        of_pixels = self._full_ms - min(self._fixed_ms, self._full_ms)
        allowed = max(MOVING_MS, FIXED_SHARE * self._fixed_ms) - self._fixed_ms
        affordable = math.sqrt(allowed / of_pixels) if of_pixels > allowed else 1.0
        # In steps: a size that trembled with every measurement would be seen.
        self.scale = max(LEAST_SCALE, math.floor(affordable / STEP) * STEP)
