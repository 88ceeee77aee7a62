"""Renderers without a window."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from splatview.measure.knobs import Plan, has_all
from splatview.measure.metrics import enlarged
from splatview.renderers import MODES, VisualMode, automatic_choice, make_renderer, on_this_gl
from splatview.renderers.quality import reduced
from splatview.renderers.request import FrameRequest, FrameStats, Renderer
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.attribute_formats import Attributes

if TYPE_CHECKING:
    import moderngl

MOST_HELD = 1 << 30
"""Bytes of scenes that stay loaded besides the latest."""


def make_headless(
    name: str, *, mode: VisualMode = "splats", knobs: Mapping[str, str] = MappingProxyType({})
) -> Renderer:
    """The renderer called `name`; "auto" takes what `automatic_choice` says, but on a GPU `quads` for what
    `tiles` have not: `mode`, or the values of `knobs` by name.

    Raises:
        InputError: it does not work here, or cannot show `mode`.
    """
    if name == "auto":
        name = automatic_choice()[0]
        if name == "tiles" and not (name in MODES[mode].backends and has_all(knobs, name)):
            name = "quads"
    if name not in MODES[mode].backends:
        raise InputError(f"--mode {mode} needs --renderer {' or '.join(MODES[mode].backends)}")
    if name in ("cpu", "reference"):
        announce_compiling(name)
        return make_renderer(name)
    from splatview.renderers.gl import context

    return OffscreenRenderer(context.create_headless_context(), name)


def announce_compiling(name: str) -> None:
    """Tells on standard error that the renderer called `name` has to be compiled first, if so."""
    if name != "cpu":
        return
    from splatview import raster

    if raster.will_compile():
        print("splatview: compiling the CPU renderer, once, may take a minute", file=sys.stderr)


class OffscreenRenderer(Renderer):
    """A backend by OpenGL on a context of its own, current only while it draws.

    Forms of a scene stay loaded side by side, while they fit, so that they can be drawn in turns.
    """

    def __init__(self, ctx: moderngl.Context, name: str):
        self.name = name
        self._ctx = ctx
        self._backend = on_this_gl(name, ctx)
        self._largest: tuple[int, int] = ctx.info["GL_MAX_VIEWPORT_DIMS"]
        self._loaded: list[tuple[Gaussians, Renderer]] = []
        """Scenes and their renderers, the latest last."""
        with ctx:
            self._spare: Renderer | None = self._backend.make(ctx, None)
            self.capabilities = self._spare.capabilities

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        yield 0.0
        for place, (scene, _) in enumerate(self._loaded):
            if scene is gaussians:
                self._loaded.append(self._loaded.pop(place))
                return
        with self._ctx:
            renderer, self._spare = self._spare or self._backend.make(self._ctx, None), None
            renderer.load(gaussians, attributes)
        self._loaded.append((gaussians, renderer))
        while len(self._loaded) > 1 and sum(each.memory() for _, each in self._loaded) > MOST_HELD:
            with self._ctx:
                self._loaded.pop(0)[1].close()

    def draw(self, request: FrameRequest) -> None:
        view = request.view
        if not (view.width <= self._largest[0] and view.height <= self._largest[1]):
            raise InputError(
                f"OpenGL draws at most {self._largest[0]}x{self._largest[1]} here, "
                f"not {view.width}x{view.height}; use --renderer cpu or a smaller --size"
            )
        if request.gaussians is not None:
            self.load(request.gaussians, request.attributes)
        with self._ctx:  # another renderer's may be the current one
            self._latest.draw(request)

    @property
    def _latest(self) -> Renderer:
        if not self._loaded:
            raise RuntimeError("load() comes before draw()")
        return self._loaded[-1][1]

    def finish(self) -> None:
        with self._ctx:
            self._latest.finish()

    def read(self) -> np.ndarray:
        with self._ctx:
            return self._latest.read()

    def stats(self, *, wait: bool = False) -> FrameStats:
        with self._ctx:
            return self._latest.stats(wait=wait)

    def memory(self) -> int:
        return self._latest.memory()

    def forget_order(self) -> None:
        for _, renderer in self._loaded:
            renderer.forget_order()

    def close(self) -> None:
        with self._ctx:
            for renderer in [self._spare, *(each for _, each in self._loaded)]:
                if renderer is not None:
                    renderer.close()
        self._loaded, self._spare = [], None
        self._ctx.release()


class HeadlessScene:
    """One scene in one renderer, as `measure` draws it: a `measure.ladder.SceneRenderer`."""

    def __init__(
        self,
        renderer: Renderer,
        gaussians: Gaussians,
        turned: Callable[[Camera, float], Camera] = lambda camera, degrees: camera,
    ):
        """`turned`: a camera so many degrees farther on its way, for pictures that depend on those before."""
        self.name = renderer.name
        self._turned = turned
        self._renderer, self.gaussians = renderer, gaussians

    def turned(self, camera: Camera, degrees: float) -> Camera:
        return self._turned(camera, degrees)

    def supports(self, plan: Plan) -> bool:
        request = FrameRequest.by_plan(self.gaussians, ANY_CAMERA, plan)
        return self._renderer.capabilities.unsupported(request) is None

    def prepare(self, plan: Plan) -> None:
        form = reduced(FrameRequest.by_plan(self.gaussians, ANY_CAMERA, plan)).gaussians
        assert form is not None
        self._renderer.load(form, plan.attributes)

    def draw(self, camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
        """The time is up to finished pixels. A window neither reads them back from a GPU nor enlarges them
        without it: at 1920x1080 that took 14 and some 40 ms, drawing by `tiles` two (ladder_gpu.json)."""
        begun = time.perf_counter()
        if anew:
            self._renderer.forget_order()
        self._renderer.draw(reduced(FrameRequest.by_plan(self.gaussians, camera, plan)))
        self._renderer.finish()
        milliseconds = 1e3 * (time.perf_counter() - begun)
        return enlarged(self._renderer.read(), camera.width, camera.height), milliseconds

    def memory(self) -> int:
        return self._renderer.memory()


ANY_CAMERA = Camera(width=1, height=1, fx=1.0, fy=1.0, cx=0.5, cy=0.5, world_to_camera=np.eye(4))
"""Stands in where a request's camera does not matter."""
