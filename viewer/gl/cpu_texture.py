"""The CPU rasteriser's pictures in a texture: coarse while the camera moves, sharp when it rests."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
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

PIXEL_STAGES = ("bin", "forward")
"""Stages whose time grows with the pixels; the others cost the same at any size."""


@dataclass(frozen=True, eq=False)
class _Wish:
    """What the window wants to see; the scene is part of it, so a new one makes all else stale."""

    gaussians: Gaussians
    camera: Camera
    settings: RenderSettings
    since: float

    def same_picture(self, other: _Wish) -> bool:
        return (
            self.gaussians is other.gaussians
            and self.settings == other.settings
            and self.camera.same_view(other.camera)
        )


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
        self._threads = threads
        self._on_ready = on_ready
        self._change = threading.Condition()
        # Guarded by _change:
        self._wish: _Wish | None = None
        self._finished: _Wish | None = None  # drawn at full resolution
        self._image: np.ndarray | None = None  # not uploaded yet
        self._stats = FrameStats(splats=0, visible=0, ms={}, projected=0, sorted=0, drawn=0)
        self._ended = False
        self.status = ""
        """What the user should know while waiting, or ""."""
        self.problem: str | None = None
        """What went wrong in the worker, until the window takes it."""
        self._gaussians: Gaussians | None = None
        self._moving_scale = 0.5
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
                self._wish = wish
                self._change.notify()
            image, self._image = self._image, None
        if image is not None:
            self._upload(image)

    def read(self, camera: Camera, settings: RenderSettings) -> np.ndarray:
        """The full picture (H, W, 4) float32, rendered while the caller waits."""
        if self._gaussians is None:
            return np.zeros((camera.height, camera.width, 4), np.float32)
        return raster.render(self._gaussians, camera, settings, threads=self._threads)

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
                    self._change.wait(self._rest_left(coarse))
                if self._ended:
                    return
                wish = self._wish
                assert wish is not None
                moving = coarse is not wish and self._moving_scale < 1
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
        return coarse is not self._wish or self._rest_left(coarse) == 0

    def _rest_left(self, coarse: _Wish | None) -> float | None:
        """Seconds until the sharp picture is due; None where it is not a matter of time."""
        if self._wish is None or self._finished is self._wish or coarse is not self._wish:
            return None
        return max(0.0, self._wish.since + REST_SECONDS - time.monotonic())

    def _render(self, wish: _Wish, moving: bool, workspace: raster.Workspace) -> None:
        camera = wish.camera
        if moving:
            scale = self._moving_scale
            camera = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        if raster.will_compile():
            self.status = "Preparing the CPU renderer for this machine; this happens once"
            self._on_ready()
        frame = raster.draw_frame(
            raster.parameters_of(wish.gaussians), camera, wish.settings, workspace, threads=self._threads
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
            self._moving_scale = affordable_scale(frame.milliseconds, camera.width / wish.camera.width)


def affordable_scale(milliseconds: Mapping[str, float], scale: float) -> float:
    """The scale of the next moving picture, from the stages' times of one drawn at `scale`.

    Pixels get what is left of MOVING_MS, but at least as much as the stages that do not depend on them
    take: where those are slow already, fewer pixels would hardly be quicker.
    """
    of_pixels = sum(milliseconds.get(stage, 0.0) for stage in PIXEL_STAGES)
    fixed = sum(milliseconds.values()) - of_pixels
    whole = of_pixels / scale**2
    allowed = max(MOVING_MS - fixed, fixed, MOVING_MS / 4)
    affordable = math.sqrt(allowed / whole) if whole > 0 else 1.0
    # In eighths: a size that trembled with every measurement would be seen.
    return min(1.0, max(LEAST_SCALE, math.floor(affordable * 8) / 8))
