"""The CPU rasteriser's pictures in a texture: coarse while the camera moves, sharp when it rests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import moderngl
import numpy as np

from splatview import raster
from splatview.raster.frame import specialisation_key
from splatview.renderers import FrameStats
from splatview.renderers.edit_snapshot import EditSnapshot, edit_snapshot
from splatview.renderers.moving_quality import (
    MOVING_MS,
    UNPRICED_SCALE,
    Level,
    Pace,
    Plan,
    Shortcut,
    make_levels,
    price,
    scaled,
    time_of,
    work_of,
)
from splatview.renderers.precompile import ShaderPrecompiler, precompile_job
from splatview.renderers.types import Highlight
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import SceneEdits, bake

# ---- Kernels of the CPU rasteriser that are not compiled yet: compiled in the background, and done without.


class CpuAhead:
    """Says what to draw so that nothing is compiled in the window's process that takes long.

    The edited scene, baked, gives the picture that edits give, by kernels that know of none. For other
    effects there is no such way: their first picture waits, as the very first picture does. Without
    `precompiler` all is compiled when it is needed.
    """

    def __init__(self, precompiler: ShaderPrecompiler | None) -> None:
        self._precompiler = precompiler
        self._baked: tuple[Gaussians, SceneEdits, Gaussians] | None = None

    def must_wait(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, shown: EditSnapshot | None
    ) -> str | None:
        """Has compiled what this picture lacks. Returns what to `wait` for, if it can only be drawn then."""
        if self._precompiler is None:
            return None
        kind = specialisation_key(gaussians, camera, settings, edited=shown is not None)
        if self._precompiler.is_done([kind]):
            return None
        pinhole = camera.lens is None and not camera.orthographic and settings.model.footprint != "disc"
        if shown is None and pinhole and not raster.will_compile():
            return None  # compiled with all the others
        self._precompiler.ask(
            [kind],
            title_of(camera, settings, shown),
            lambda: precompile_job(
                "cpu",
                gaussians,
                camera,
                settings,
                edits=None if shown is None else shown.source,
                highlight=None if shown is None else shown.highlight,
            ),
        )
        return kind if shown is None or not pinhole or raster.will_compile() else None

    def wait(self, kind: str) -> bool:
        """False where nothing is to be drawn any more."""
        return self._precompiler is None or self._precompiler.wait([kind])

    def what_to_draw(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, shown: EditSnapshot | None
    ) -> tuple[Gaussians, SceneEdits | None]:
        """The scene and the edits to draw it by."""
        if shown is None:
            return gaussians, None
        if self._precompiler is None or self._precompiler.is_done(
            [specialisation_key(gaussians, camera, settings, edited=True)]
        ):
            self._baked = None
            return gaussians, shown.drawn
        if self._baked is None or self._baked[0] is not gaussians or self._baked[1] is not shown.drawn:
            self._baked = gaussians, shown.drawn, bake(gaussians, shown.drawn)
        return self._baked[2], None

    @property
    def title(self) -> str:
        """What is being compiled, or ""."""
        return "" if self._precompiler is None else self._precompiler.title


def title_of(camera: Camera, settings: RenderSettings, shown: EditSnapshot | None) -> str:
    effects = {
        "edits": shown is not None,
        "a lens": camera.lens is not None,
        "parallel rays": camera.orthographic,
        "discs": settings.model.footprint == "disc",
    }
    return ", ".join(name for name, on in effects.items() if on) or "the CPU renderer"


FRAME_SECONDS = 0.02
"""Of a core, that a frame of the window takes where this renderer is chosen: OpenGL is software there."""

REST_SECONDS = 0.25
"""A camera that has not changed for so long rests: the next picture may take its time."""


PATIENCE = 1.5
"""Seconds that a scene must have been looked at before it is made ready for turning."""


@dataclass(frozen=True, eq=False)
class _Wish:
    """What the window wants to see; the scene is part of it, so a new one makes all else stale."""

    gaussians: Gaussians
    camera: Camera
    settings: RenderSettings
    edits: EditSnapshot | None
    since: float

    def same_picture(self, other: _Wish) -> bool:
        same_scene = self.gaussians is other.gaussians and self.edits is other.edits
        return same_scene and self.same_view(other)

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
        precompiler: ShaderPrecompiler | None = None,
    ):
        self._ctx = ctx
        self._ahead = CpuAhead(precompiler)
        self.threads = threads
        """Cores to draw with; None: all. May be changed at any time."""
        self.cores: float | None = None
        """How many it may keep busy on average, the window's frames included; None: as many as it likes.
        May be changed at any time."""
        self.sharp = False
        """Whether a camera that changes is not one that moves: pictures are drawn in full. Likewise."""
        self.budget_ms: float | None = None
        """What a picture may take while the camera moves; None: MOVING_MS. May be changed at any time."""
        self._on_ready = on_ready
        self._depth_order = raster.ReusableOrder()
        self._change = threading.Condition()
        # Guarded by _change:
        self._wish: _Wish | None = None
        self._resting = False
        self._drawing = False
        self._finished: _Wish | None = None  # drawn at full resolution
        self._image: tuple[np.ndarray, str] | None = None  # not uploaded yet, and its note
        self._plan: Plan | None = None  # made, and not yet followed
        self._stats = FrameStats(splats=0, visible=0, ms={}, projected=0, sorted=0, drawn=0)
        self._ended = False
        self.status = ""
        """What the user should know while waiting, or ""."""
        self.problem: str | None = None
        """What went wrong in the worker, until the window takes it."""
        self._gaussians: Gaussians | None = None
        self.note = ""
        """How the picture in the texture was reduced, or ""."""
        # The worker's alone:
        self._pace = Pace()
        self._full_ms: float | None = None  # of the latest full picture of this scene, its memory being warm
        self._drawn_of: Gaussians | None = None
        self._planner: threading.Thread | None = None
        self.texture = ctx.texture((1, 1), 4, dtype="f4")
        self._thread = threading.Thread(target=self._work, name="splatview-cpu", daemon=True)
        self._thread.start()

    def load(self, gaussians: Gaussians) -> None:
        """Replaces the scene; pictures of the old one are no longer shown."""
        with self._change:
            self._gaussians = gaussians
            self._plan = None  # which would keep the old scene in memory

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> None:
        """Asks for a picture and shows the latest that is there. Never waits.

        `edits` of the scene that is loaded are shown; `highlight` lights up what they mark.
        """
        if self._gaussians is None:
            return
        shown = edit_snapshot(edits, highlight, self._wish.edits if self._wish else None)
        wish = _Wish(self._gaussians, camera, settings, shown, time.monotonic())
        with self._change:
            if self._wish is None or not self._wish.same_picture(wish):
                # A scene that changes before an eye at rest, as in training, is drawn sharp at once.
                still = self._wish is not None and self._wish.same_view(wish)
                self._resting = self.sharp or (self._resting and still)
                self._wish, self._drawing = wish, True
                self._change.notify_all()
            elif not self._resting and wish.since - self._wish.since >= self._rest_seconds:
                # Only a window that still asks for it says that it rests: a slow one may just be late.
                self._resting = self._drawing = True
                self._change.notify_all()
            image, self._image = self._image, None
        if image is not None:
            self._upload(image[0])
            self.note = image[1]

    def wait(self, seconds: float) -> None:
        """Returns when a new picture can be shown, or after `seconds`; at once where none is on its way."""
        with self._change:
            self._change.wait_for(lambda: self._image is not None or not self._drawing, seconds)

    def read(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> np.ndarray:
        """The full picture (H, W, 4) float32, rendered while the caller waits."""
        if self._gaussians is None:
            return np.zeros((camera.height, camera.width, 4), np.float32)
        shown = edit_snapshot(edits, highlight, None)
        gaussians, drawn = self._ahead.what_to_draw(self._gaussians, camera, settings, shown)
        return raster.render(gaussians, camera, settings, edits=drawn, threads=self.threads)

    @property
    def busy(self) -> bool:
        """Whether what is shown is not yet the full picture of the latest wish."""
        with self._change:
            return self._wish is not None and (self._finished is not self._wish or self._image is not None)

    @property
    def _allowed_ms(self) -> float:
        return MOVING_MS if self.budget_ms is None else self.budget_ms

    @property
    def _rest_seconds(self) -> float:
        """Two frames of the budget where the user has set one."""
        return REST_SECONDS if self.budget_ms is None else min(2e-3 * self.budget_ms, REST_SECONDS)

    @property
    def stats(self) -> FrameStats:
        with self._change:
            return self._stats

    def release(self) -> None:
        """Ends the worker, after the picture it is at."""
        with self._change:
            self._ended = True
            self._change.notify_all()
        self._thread.join()
        if self._planner is not None:
            self._planner.join()
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
        coarse: _Wish | None = None  # drawn, but reduced
        while True:
            with self._change:
                while not self._ended and not self._due(coarse):
                    self._drawing = False
                    self._change.notify_all()
                    self._change.wait()
                if self._ended:
                    return
                wish, plan = self._wish, self._plan
                assert wish is not None
                sharp = coarse is wish or self._resting
            self._pace.hold(self.budget_ms)
            if plan is not self._pace.plan:
                self._pace.follow(plan)
            begun = time.perf_counter()
            try:
                self._render(wish, None if sharp else self._shortcut(wish), workspace)
            except Exception as error:
                # The thread must live: the next scene may be a better one.
                with self._change:
                    self.problem = f"the CPU renderer failed: {type(error).__name__}: {error}"
                    self._finished = wish
            coarse = wish
            self._on_ready()
            self._rest(time.perf_counter() - begun)

    def _rest(self, took: float) -> None:
        """Leaves the cores to others after a picture that took so many seconds, as long as is due."""
        if self.cores is None:
            return
        busy = took * (self.threads or raster.available_threads()) + FRAME_SECONDS
        with self._change:
            self._change.wait_for(lambda: self._ended, max(busy / self.cores - took, 0.0))

    def _due(self, coarse: _Wish | None) -> bool:
        """Whether something is to be drawn now: a new wish, or the sharp picture of one that rests."""
        if self._wish is None or self._finished is self._wish:
            return False
        return coarse is not self._wish or self._resting

    def _shortcut(self, wish: _Wish) -> Shortcut | None:
        """How to draw a moving picture; None: in full. Merged splats know nothing of edits."""
        planned = self._pace.plan is not None and self._pace.plan.gaussians is wish.gaussians
        if planned and wish.edits is None:
            return self._pace.shortcut
        full_ms = self._full_ms if self._drawn_of is wish.gaussians else None
        if full_ms is not None and full_ms <= self._allowed_ms:
            return None
        return Shortcut(gaussians=wish.gaussians, share=1.0, scale=UNPRICED_SCALE, ms=0.0, error=0.0)

    def _render(self, wish: _Wish, shortcut: Shortcut | None, workspace: raster.Workspace) -> None:
        """Draws the wish, reduced by `shortcut`, and hands the picture over."""
        gaussians, camera = wish.gaussians, wish.camera
        full = shortcut is None or shortcut.exact
        if shortcut is not None:
            gaussians, camera = shortcut.scene, scaled(camera, shortcut.scale)
        if raster.will_compile():
            self.status = "Preparing the CPU renderer for this machine; this happens once"
            self._on_ready()
        kind = self._ahead.must_wait(gaussians, camera, wish.settings, wish.edits)
        if kind is not None and not self._ahead.wait(kind):
            return
        gaussians, edits = self._ahead.what_to_draw(gaussians, camera, wish.settings, wish.edits)
        frame = raster.draw_frame(
            raster.parameters_of(gaussians),
            camera,
            wish.settings,
            workspace,
            depth_order=self._depth_order,
            edits=edits,
            nonzero=raster.nonzero_bands(gaussians),
            threads=self.threads,
        )
        self.status = ""
        visible, _ = work_of(frame)
        with self._change:
            if self._gaussians is wish.gaussians:
                self._change.notify_all()
                self._image = frame.image, "" if full or shortcut is None else shortcut.note
            old = self._stats
            self._stats = FrameStats(
                splats=len(wish.gaussians),
                visible=visible,
                ms=dict(frame.milliseconds),
                projected=old.projected + 1,
                sorted=old.sorted + 1,
                drawn=old.drawn + 1,
            )
            if full:
                self._finished = wish
        # A scene's first picture also pays for memory that later ones find ready.
        if self._drawn_of is not wish.gaussians:
            self._drawn_of, self._full_ms = wish.gaussians, None
        elif shortcut is not None:
            self._pace.learn(shortcut, time_of(frame))
        else:
            self._full_ms = time_of(frame)
        if shortcut is None:
            self._look_for_shortcuts(wish, frame)

    def _look_for_shortcuts(self, wish: _Wish, frame: raster.Frame) -> None:
        """Has prices found out in another thread, where pictures are slow and no prices are known."""
        if not len(wish.gaussians) or wish.edits is not None or not time_of(frame) > self._allowed_ms:
            return
        if self._planner is not None and self._planner.is_alive():
            return
        plan = self._pace.plan
        if plan is not None and plan.gaussians is not wish.gaussians:
            plan = None
        if plan is not None and plan.holds_for(work_of(frame)):
            return
        self._planner = threading.Thread(
            target=self._make_plan,
            args=(wish, plan.levels if plan else None),
            name="splatview-cpu-plan",
            daemon=True,
        )
        self._planner.start()

    # ---- in the planner

    def _make_plan(self, wish: _Wish, levels: tuple[Level, ...] | None) -> None:
        def stop() -> bool:
            return self._ended or self._gaussians is not wish.gaussians

        # Where scenes follow one another, as in training, each would be merged for nobody to turn it.
        while levels is None and self._wish is wish and time.monotonic() - wish.since < PATIENCE:
            time.sleep(0.05)
            if stop():
                return
        try:
            levels = levels or make_levels(wish.gaussians, stop)
            plan = price(levels, wish.camera, wish.settings, stop, threads=self.threads)
        except Exception as error:
            # Pictures can be had without: the user turns a scene that is slower, and reads why.
            with self._change:
                self.problem = f"moving pictures stay slow: {type(error).__name__}: {error}"
            return
        with self._change:
            if plan is not None and not stop():
                self._plan = plan
