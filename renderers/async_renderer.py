"""A backend without OpenGL in a thread of its own: pictures come when they are done, coarse while moving."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from dataclasses import replace

import numpy as np

from splatview import raster
from splatview.raster.frame import specialisation_key
from splatview.renderers import make_renderer
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.edit_snapshot import EditSnapshot, edit_snapshot
from splatview.renderers.modes import MODES
from splatview.renderers.precompile import ShaderPrecompiler, precompile_job
from splatview.renderers.quality import (
    MOVING_MS,
    UNPRICED_SCALE,
    Governor,
    Level,
    MovingPlan,
    Shortcut,
    make_levels,
    price,
)
from splatview.renderers.request import FrameRequest, FrameStats, Renderer
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.attribute_formats import Attributes

FRAME_SECONDS = 0.02
"""Core seconds of a frame of the window where the CPU draws: OpenGL is software there."""

REST_SECONDS = 0.25
"""A camera that has not changed for so long rests: the next picture may take its time."""

PATIENCE = 1.5
"""Seconds that a scene must have been shown before it is made ready for a camera that moves."""


class KernelPrecompiler:
    """Says what to draw so that nothing that takes long is compiled in the window's process.

    The edited scene, baked, gives the picture that edits give, by kernels that know of none. For other
    effects there is no such way: their first picture waits, as the very first picture does. Without
    `precompiler` all is compiled when it is needed.
    """

    def __init__(self, renderer: CpuRenderer, precompiler: ShaderPrecompiler | None) -> None:
        self._renderer = renderer
        self._precompiler = precompiler
        self._baked: tuple[FrameRequest, Gaussians] | None = None
        """A request, and its scene with its edits in it."""

    def must_wait(self, request: FrameRequest) -> str | None:
        """Has compiled what this picture lacks. Returns what to `wait` for, if it can only be drawn then."""
        if self._precompiler is None:
            return None
        camera, edited = request.camera, request.edits is not None
        kind = kind_in(request)
        if self._precompiler.is_done([kind]):
            return None
        usual = not (camera.lens or camera.orthographic or request.settings.model.footprint == "disc")
        usual = usual and request.mode == "splats" and not raster.will_compile()
        assert request.gaussians is not None
        usual = usual and raster.nonzero_bands(request.gaussians).own_degrees is None
        if not edited and usual:
            return None  # compiled with all the others
        self._precompiler.ask([kind], title_of(request), lambda: precompile_job("cpu", request))
        by_baking = edited and (usual or self._precompiler.is_done([kind_in(replace(request, edits=None))]))
        return None if by_baking else kind

    def wait(self, kind: str) -> bool:
        """False where nothing is to be drawn any more."""
        return self._precompiler is None or self._precompiler.wait([kind])

    def what_to_draw(self, request: FrameRequest) -> FrameRequest:
        """The request, or one for the baked scene while kernels with edits are being compiled."""
        if request.edits is None:
            return request
        if self._precompiler is None or self._precompiler.is_done([kind_in(request)]):
            self._baked = None
            return request
        known = self._baked
        if known is None or not request.same_objects(known[0]):
            known = self._baked = request, self._renderer.baked(request)
        return replace(request, gaussians=known[1], edits=None, highlight=None)


def with_edits_of(snapshot: EditSnapshot | None, request: FrameRequest) -> FrameRequest:
    """The request with what shows of its edits, as it stood when the snapshot was made."""
    if snapshot is None:
        return replace(request, edits=None, highlight=None)
    return replace(request, edits=snapshot.kept, highlight=snapshot.highlight)


def kind_in(request: FrameRequest) -> str:
    """Key of the kernels that the picture needs."""
    assert request.gaussians is not None
    key = specialisation_key(
        request.gaussians, request.camera, request.settings, edited=request.edits is not None
    )
    return key if request.mode == "splats" else f"{key} {request.mode}"


def title_of(request: FrameRequest) -> str:
    """The effects that make a picture's kernels special."""
    effects = {
        "edits": request.edits is not None,
        "a lens": request.camera.lens is not None,
        "parallel rays": request.camera.orthographic,
        "discs": request.settings.model.footprint == "disc",
        MODES[request.mode].label.lower(): request.mode != "splats",
    }
    return ", ".join(name for name, on in effects.items() if on) or "the CPU renderer"


class AsyncRenderer(Renderer):
    """Draws in a thread of its own, the latest request first; requests overtaken meanwhile are dropped.

    `on_ready` is called in that thread when a picture has come, which `take_picture` then gives. `read` and
    `render` draw in the caller's thread.
    """

    def __init__(
        self,
        renderer: Renderer,
        *,
        on_ready: Callable[[], object] = lambda: None,
        precompiler: ShaderPrecompiler | None = None,
    ):
        self._renderer = renderer
        self.name, self.capabilities = renderer.name, renderer.capabilities
        self._kernels = (
            KernelPrecompiler(renderer, precompiler) if isinstance(renderer, CpuRenderer) else None
        )
        self.cores: float | None = None
        """Cores to keep busy on average, the window's frames included; None: no limit. May be changed at any
        time, as all that follows."""
        self.sharp = False
        """Whether pictures of a camera that changes are drawn in full, too."""
        self.budget_ms: float | None = None
        """Milliseconds for a picture while the camera moves; None: MOVING_MS."""
        self._on_ready = on_ready
        self._change = threading.Condition()
        # Guarded by _change:
        self._request: FrameRequest | None = None
        self._since = 0.0
        self._snapshot: EditSnapshot | None = None
        self._resting = False
        self._drawing = False
        self._finished: FrameRequest | None = None  # drawn at full resolution
        self._image: tuple[np.ndarray, str, Gaussians] | None = None  # not taken yet, its note and its scene
        self._plan: MovingPlan | None = None  # the latest made
        self._stats = FrameStats()
        self._ended = False
        self.status = ""
        """What the user should know while waiting, or ""."""
        self.problem: str | None = None
        """What went wrong in the worker, until the window takes it."""
        self._gaussians: Gaussians | None = None
        self.note = ""
        """How the picture taken last was reduced, or ""."""
        self.pictured: Gaussians | None = None
        """Scene of the picture taken last."""
        # The worker's alone:
        self._governor = Governor()
        self._followed: MovingPlan | None = None
        self._full_ms: float | None = None  # of the latest full picture of this scene, its memory being warm
        self._drawn_of: Gaussians | None = None
        self._planner: threading.Thread | None = None
        self._thread = threading.Thread(target=self._work, name=f"splatview-{self.name}", daemon=True)
        self._thread.start()

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        yield 0.0
        with self._change:
            self._gaussians = gaussians
            self._plan = None  # which would keep the old scene in memory

    def draw(self, request: FrameRequest) -> None:
        """Asks for a picture. Never waits.

        Raises:
            InputError: the backend cannot draw it.
        """
        problem = self.capabilities.unsupported(request)
        if problem is not None:
            raise InputError(problem)
        complete = self._with_scene(request)
        if complete is None:
            return
        now = time.monotonic()
        self._renderer.threads = self.threads
        self._snapshot = edit_snapshot(request.edits, request.highlight, self._snapshot)
        request = with_edits_of(self._snapshot, complete)
        with self._change:
            before = self._request
            if before is None or not before.same_picture(request):
                # A scene that changes before an eye at rest, as in training, is drawn sharp at once.
                still = before is not None and before.same_view(request)
                self._resting = self.sharp or (self._resting and still)
                self._request, self._since, self._drawing = request, now, True
                self._change.notify_all()
            elif not self._resting and now - self._since >= self._rest_seconds:
                # Only a window that still asks for it says that it rests: a slow one may just be late.
                self._resting = self._drawing = True
                self._change.notify_all()

    def _with_scene(self, request: FrameRequest) -> FrameRequest | None:
        """The request for the scene that is loaded; None where none is."""
        if request.gaussians is not None:
            return request
        return None if self._gaussians is None else replace(request, gaussians=self._gaussians)

    def take_picture(self) -> np.ndarray | None:
        """A picture that has come since the last call, (H, W, 4) float32; None where none has."""
        with self._change:
            image, self._image = self._image, None
        if image is None:
            return None
        self.note, self.pictured = image[1:]
        return image[0]

    def wait(self, seconds: float) -> None:
        """Returns when a new picture can be shown, or after `seconds`; at once where none is on its way."""
        with self._change:
            self._change.wait_for(lambda: self._image is not None or not self._drawing, seconds)

    def read(self) -> np.ndarray:
        """Full picture of the latest request, (H, W, 4) float32."""
        if self._request is None:
            raise RuntimeError("draw() comes first")
        return self.render(self._request)

    def render(self, request: FrameRequest) -> np.ndarray:
        """The full picture, drawn in the caller's thread while it waits."""
        complete = self._with_scene(request)
        if complete is None:
            return np.zeros((request.camera.height, request.camera.width, 4), np.float32)
        self._renderer.threads = self.threads
        complete = with_edits_of(edit_snapshot(request.edits, request.highlight, None), complete)
        return self._renderer.render(self._kernels.what_to_draw(complete) if self._kernels else complete)

    @property
    def busy(self) -> bool:
        """Whether what was taken is not yet the full picture of the latest request."""
        with self._change:
            return self._request is not None and (
                self._finished is not self._request or self._image is not None
            )

    @property
    def _allowed_ms(self) -> float:
        return MOVING_MS if self.budget_ms is None else self.budget_ms

    @property
    def _rest_seconds(self) -> float:
        """Two frames of the budget where the user has set one."""
        return REST_SECONDS if self.budget_ms is None else min(2e-3 * self.budget_ms, REST_SECONDS)

    def stats(self, *, wait: bool = False) -> FrameStats:
        with self._change:
            return self._stats

    def depth_range(self, camera: Camera) -> tuple[float, float] | None:
        """Depths, world units, of the ends of the colours of the mode "depth" from `camera`; None before the
        first such picture."""
        renderer = self._renderer
        return renderer.depth_range(camera) if isinstance(renderer, CpuRenderer) else None

    def memory(self) -> int:
        return self._renderer.memory()

    def forget_order(self) -> None:
        """Has the next picture that this thread renders sorted anew."""
        self._renderer.forget_order()

    def close(self) -> None:
        """Ends the worker, after the picture it is at."""
        with self._change:
            self._ended = True
            self._change.notify_all()
        self._thread.join()
        if self._planner is not None:
            self._planner.join()
        self._renderer.close()

    # ---- in the worker

    def _work(self) -> None:
        coarse: FrameRequest | None = None  # drawn, but reduced
        while True:
            with self._change:
                while not self._ended and not self._due(coarse):
                    self._drawing = False
                    self._change.notify_all()
                    self._change.wait()
                if self._ended:
                    return
                request, plan = self._request, self._plan
                assert request is not None
                sharp = coarse is request or self._resting
            if plan is not self._followed or self.budget_ms != self._governor.budget_ms:
                self._follow(plan)
            begun = time.perf_counter()
            try:
                self._render(request, None if sharp else self._shortcut(request))
            except Exception as error:
                # The thread must live: the next scene may be a better one.
                with self._change:
                    self.problem = f"the {self.name.upper()} renderer failed: {type(error).__name__}: {error}"
                    self._finished = request
            coarse = request
            self._on_ready()
            self._rest(time.perf_counter() - begun)

    def _follow(self, plan: MovingPlan | None) -> None:
        """Chooses from now on from the plan's shortcuts, finer ones where a budget is to be filled."""
        self._followed = plan
        self._governor.set_budget(self.budget_ms)
        if plan is not None:
            self._governor.follow(plan.fine if plan.fine and self.budget_ms is not None else plan.shortcuts)
        else:
            self._governor.follow(())

    def _rest(self, took: float) -> None:
        """Leaves the cores to others after a picture that took so many seconds, as long as is due."""
        if self.cores is None:
            return
        busy = took * (self.threads or raster.available_threads()) + FRAME_SECONDS
        with self._change:
            self._change.wait_for(lambda: self._ended, max(busy / self.cores - took, 0.0))

    def _due(self, coarse: FrameRequest | None) -> bool:
        """Whether something is to be drawn now: a new request, or the sharp picture of one that rests."""
        if self._request is None or self._finished is self._request:
            return False
        return coarse is not self._request or self._resting

    def _shortcut(self, request: FrameRequest) -> Shortcut | None:
        """How to draw a moving picture; None: in full. Merged splats know nothing of edits, and other modes
        show the splats themselves."""
        plan, as_it_is = self._followed, request.edits is None and request.mode == "splats"
        if plan is not None and plan.gaussians is request.gaussians and as_it_is:
            return self._governor.step
        full_ms = self._full_ms if self._drawn_of is request.gaussians else None
        if full_ms is not None and full_ms <= self._allowed_ms:
            return None
        return Shortcut(scale=UNPRICED_SCALE, ms=0.0, error=None)

    def _render(self, request: FrameRequest, shortcut: Shortcut | None) -> None:
        """Draws the request, reduced by `shortcut`, and hands the picture over."""
        full = shortcut is None or shortcut.is_exact
        drawn = request
        if shortcut is not None:
            scene, resolution = shortcut.scene, request.resolution * shortcut.scale
            drawn = replace(request, resolution=resolution)
            if scene is not None:
                drawn = replace(drawn, gaussians=scene)
        if self._kernels is not None:
            if raster.will_compile():
                self.status = "Preparing the CPU renderer for this machine; this happens once"
                self._on_ready()
            kind = self._kernels.must_wait(drawn)
            if kind is not None and not self._kernels.wait(kind):
                return
            drawn = self._kernels.what_to_draw(drawn)
        self._renderer.draw(drawn)
        image, stats = self._renderer.read(), self._renderer.stats(wait=True)
        self.status = ""
        gaussians = request.gaussians
        assert gaussians is not None
        with self._change:
            if self._gaussians is gaussians:
                self._change.notify_all()
                self._image = image, "" if full or shortcut is None else shortcut.note, gaussians
            count = self._stats.drawn + 1
            self._stats = replace(stats, splats=len(gaussians), projected=count, sorted=count, drawn=count)
            if full:
                self._finished = request
        # A scene's first picture also pays for memory that later ones find ready.
        if self._drawn_of is not gaussians:
            self._drawn_of, self._full_ms = gaussians, None
        elif shortcut is not None:
            self._governor.learn(shortcut, stats.milliseconds)
        else:
            self._full_ms = stats.milliseconds
        if shortcut is None:
            self._look_for_shortcuts(request, stats)

    def _look_for_shortcuts(self, request: FrameRequest, stats: FrameStats) -> None:
        """Has prices found out in another thread, where pictures are slow and no prices are known."""
        gaussians = request.gaussians
        unmerged = gaussians is None or not len(gaussians) or request.edits is not None
        unmerged = unmerged or request.mode != "splats"
        if unmerged or not stats.milliseconds > self._allowed_ms:
            return
        if self._planner is not None and self._planner.is_alive():
            return
        plan = self._followed
        if plan is not None and plan.gaussians is not gaussians:
            plan = None
        if plan is not None and plan.holds_for((stats.visible, stats.pixel_splats)):
            return
        self._planner = threading.Thread(
            target=self._make_plan,
            args=(request, plan.levels if plan else None),
            name=f"{self._thread.name}-plan",
            daemon=True,
        )
        self._planner.start()

    # ---- in the planner

    def _make_plan(self, request: FrameRequest, levels: tuple[Level, ...] | None) -> None:
        gaussians, since = request.gaussians, self._since
        assert gaussians is not None

        def stop() -> bool:
            return self._ended or self._gaussians is not gaussians

        # Where scenes follow one another, as in training, each would be merged for nobody to turn it.
        while levels is None and self._request is request and time.monotonic() - since < PATIENCE:
            time.sleep(0.05)
            if stop():
                return
        try:
            levels = levels or make_levels(gaussians, stop)
            renderer = make_renderer(self.name)
            renderer.threads = self.threads
            plan = price(levels, request, renderer, stop)
        except Exception as error:
            # Pictures can be had without: the user turns a scene that is slower, and reads why.
            with self._change:
                self.problem = f"moving pictures stay slow: {type(error).__name__}: {error}"
            return
        with self._change:
            if plan is not None and not stop():
                self._plan = plan
