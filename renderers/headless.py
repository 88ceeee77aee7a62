"""Renderers without a window, by name, behind one small face."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np

from splatview import raster
from splatview.measure.hard_cases.run import CaseRenderer, Draw, Precision
from splatview.measure.knobs import Plan, path_to_view
from splatview.measure.metrics import enlarged, reduced_size
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.attribute_formats import Attributes, stored
from splatview.scene.edits import HIDDEN, SceneEdits
from splatview.scene.effects import settings_for

if TYPE_CHECKING:
    import moderngl

    from splatview.renderers import VisualMode


RENDERERS = ("auto", "quads", "tiles", "cpu", "reference")

FOOTPRINT_BYTES = 8 * 16
"""What `scene.projection.Footprints` has of a splat."""


MOST_HELD = 1 << 30
"""Bytes of scenes that stay loaded besides the latest."""


class HeadlessRenderer(Protocol):
    """One scene, many pictures."""

    name: str

    def load(self, gaussians: Gaussians, attributes: Attributes) -> None:
        """Gets ready to draw `gaussians`, whose values fit into `attributes` (`scene.stored`); nothing where
        that was done before. `draw` does it too, in float32."""
        ...

    def draw(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, mode: VisualMode = "splats"
    ) -> np.ndarray:
        """The picture (H, W, 4) float32."""
        ...

    def forget_order(self) -> None:
        """The next picture is sorted anew, though the settings let an order serve several."""
        ...

    def stats(self) -> tuple[int, dict[str, float]]:
        """Of the last picture: splats that reached it, and milliseconds by stage."""
        ...

    def memory(self) -> int:
        """Bytes held for the scene and the last picture, the `Gaussians` themselves not counted."""
        ...


class Quads:
    """A GL renderer on a context without a window.

    Forms of a scene stay loaded side by side, while they fit, so that they can be drawn in turns.
    """

    name = "quads"

    def __init__(self, ctx: moderngl.Context):
        self._ctx = ctx
        self._largest: tuple[int, int] = ctx.info["GL_MAX_VIEWPORT_DIMS"]
        self._loaded: list[tuple[Gaussians, Any]] = []
        """Scenes and their renderers, the latest last."""

    def load(self, gaussians: Gaussians, attributes: Attributes) -> None:
        from splatview.renderers import make_renderer

        for place, (scene, _) in enumerate(self._loaded):
            if scene is gaussians:
                self._loaded.append(self._loaded.pop(place))
                return
        with self._ctx:
            renderer = make_renderer(self._ctx, self.name)
            renderer.load(gaussians, attributes)
        self._loaded.append((gaussians, renderer))
        while len(self._loaded) > 1 and sum(map(_bytes_of, self._loaded)) > MOST_HELD:
            with self._ctx:
                self._loaded.pop(0)[1].release()

    def draw(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, mode: VisualMode = "splats"
    ) -> np.ndarray:
        if not (camera.width <= self._largest[0] and camera.height <= self._largest[1]):
            raise InputError(
                f"OpenGL draws at most {self._largest[0]}x{self._largest[1]} here, "
                f"not {camera.width}x{camera.height}; use --renderer cpu or a smaller --size"
            )
        if not self._loaded or self._loaded[-1][0] is not gaussians:
            self.load(gaussians, "float32")
        with self._ctx:  # another renderer's may be the current one
            self._renderer.draw(camera, settings, mode=mode)
            return self._renderer.read()

    def can_draw(self, settings: RenderSettings, attributes: Attributes) -> bool:
        """Whether this OpenGL has what the settings and the attributes need."""
        from splatview.renderers.types import refusal

        return refusal(self._ctx.version_code, settings, attributes) is None

    def forget_order(self) -> None:
        for _, renderer in self._loaded:
            renderer.forget_order()

    @property
    def _renderer(self) -> Any:
        return self._loaded[-1][1]

    def stats(self) -> tuple[int, dict[str, float]]:
        with self._ctx:
            stats = self._renderer.finished_stats()
        return stats.visible, dict(stats.ms)

    def memory(self) -> int:
        return _bytes_of(self._loaded[-1])


def _bytes_of(loaded: tuple[Gaussians, Any]) -> int:
    from splatview.renderers.gl.context import held_bytes

    return held_bytes(loaded[1])


class Tiles(Quads):
    """The same by tiles."""

    name = "tiles"


class Cpu:
    """The numba rasteriser."""

    name = "cpu"

    def __init__(self) -> None:
        from splatview.raster import ReusableOrder, Workspace, will_compile

        if will_compile():
            print("splatview: compiling the CPU renderer, once, may take a minute", file=sys.stderr)
        self._workspace, self._depth_order = Workspace(), ReusableOrder()
        self._last: tuple[int, dict[str, float]] = (0, {})
        self._image_bytes = 0

    def load(self, gaussians: Gaussians, attributes: Attributes) -> None:
        """Scenes are drawn from where they are."""

    def draw(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, mode: VisualMode = "splats"
    ) -> np.ndarray:
        from splatview.raster import draw_frame, nonzero_bands, parameters_of

        frame = draw_frame(
            parameters_of(gaussians),
            camera,
            settings,
            self._workspace,
            depth_order=self._depth_order,
            nonzero=nonzero_bands(gaussians),
        )
        visible = sum(int(stop - start) for start, stop in frame.runs)
        self._last = visible, dict(frame.milliseconds)
        self._image_bytes = frame.image.nbytes
        return frame.image

    def forget_order(self) -> None:
        self._depth_order.resort_policy.forget()

    def stats(self) -> tuple[int, dict[str, float]]:
        return self._last

    def memory(self) -> int:
        return self._workspace.nbytes + self._image_bytes


class Reference:
    """The image model in float64: the truth, slowly."""

    name = "reference"

    def __init__(self) -> None:
        self._last: tuple[Gaussians, Camera, RenderSettings] | None = None
        self._milliseconds = 0.0

    def load(self, gaussians: Gaussians, attributes: Attributes) -> None:
        """Scenes are drawn from where they are."""

    def draw(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, mode: VisualMode = "splats"
    ) -> np.ndarray:
        from splatview.scene import reference

        self._last = gaussians, camera, settings
        start = time.perf_counter()
        image = reference.render(gaussians, camera, settings).astype(np.float32)
        self._milliseconds = 1e3 * (time.perf_counter() - start)
        return image

    def forget_order(self) -> None:
        """It keeps none."""

    def stats(self) -> tuple[int, dict[str, float]]:
        from splatview.scene.projection import project

        visible = len(project(*self._last).indices) if self._last else 0
        return visible, {"render": self._milliseconds}

    def memory(self) -> int:
        return 0 if self._last is None else FOOTPRINT_BYTES * len(self._last[0])


def make_headless(name: str, *, mode: VisualMode = "splats") -> HeadlessRenderer:
    """The renderer called `name`; "auto" takes `cpu` where GL is absent or only software, else `quads`.

    Raises:
        InputError: it does not work here, or cannot show `mode`.
    """
    if name == "auto":
        name = "quads" if mode != "splats" else automatic_choice()[0]
    if mode != "splats" and name != "quads":
        raise InputError(f"--mode {mode} needs --renderer quads")
    if name == "cpu":
        return Cpu()
    if name == "reference":
        return Reference()
    from splatview.renderers.gl.context import create_headless_context

    return (Tiles if name == "tiles" else Quads)(create_headless_context())


def automatic_choice() -> tuple[str, str]:
    """What "auto" takes here, and why."""
    from splatview.renderers.gl.context import create_headless_context, describe

    try:
        ctx = create_headless_context()
    except InputError as error:
        return "cpu", str(error)
    info = describe(ctx)
    ctx.release()
    if info.is_software and find_spec("numba") is not None:
        return "cpu", f"OpenGL is only software here ({info.renderer})"
    return "quads", f"OpenGL runs on {info.renderer}"


# ---- Scenes as shortcuts reduce them: fewer splats, attributes in fewer bits; made once a scene and kept.
#
# What is kept of a scene is decided by measured contribution: the share of the pictures' light that a splat
# makes in views from all around (`edit.sample_views`), whatever view is drawn in the end. Smaller shares are
# subsets of larger ones.


class Reduced:
    """The reduced forms of one scene, made when first asked for."""

    def __init__(self) -> None:
        self._ranking: np.ndarray | None = None
        self._being_ranked = threading.Lock()
        self._forms: dict[tuple[float, Attributes], Gaussians] = {}

    def form(self, gaussians: Gaussians, kept: float, attributes: Attributes) -> Gaussians:
        key = kept, attributes
        if key not in self._forms:
            fewer = gaussians if kept >= 1 else gaussians.take(self.most_seen(gaussians, kept))
            self._forms[key] = stored(fewer, attributes)
        return self._forms[key]

    def most_seen(self, gaussians: Gaussians, share: float) -> np.ndarray:
        return np.sort(self.ranking(gaussians)[: kept_count(len(gaussians), share)])

    def ranking(self, gaussians: Gaussians) -> np.ndarray:
        """(N,) indices. From any thread; who comes while it is made waits for it."""
        with self._being_ranked:
            if self._ranking is None:
                self._ranking = ranked_by_contribution(gaussians)
            return self._ranking

    @property
    def is_ranked(self) -> bool:
        return self._ranking is not None


_reduced: WeakKeyDictionary[Gaussians, Reduced] = WeakKeyDictionary()


def reduced(gaussians: Gaussians, plan: Plan) -> Gaussians:
    """The scene that `plan` draws: `gaussians` itself where nothing is reduced, else a form of it that is the
    same object whenever it is asked for again."""
    if plan.kept >= 1 and plan.attributes == "float32":
        return gaussians
    return _reduced.setdefault(gaussians, Reduced()).form(gaussians, plan.kept, plan.attributes)


def is_ranked(gaussians: Gaussians) -> bool:
    """Whether it is known what a share keeps: finding out takes a second for some 500,000 splats."""
    known = _reduced.get(gaussians)
    return known is not None and known.is_ranked


def rank(gaussians: Gaussians) -> None:
    """Finds it out. For a thread of its own."""
    _reduced.setdefault(gaussians, Reduced()).ranking(gaussians)


def with_rest_hidden(gaussians: Gaussians, kept: float, edits: SceneEdits | None) -> SceneEdits | None:
    """`edits` that hide what a share `kept` of the splats leaves out besides: what is loaded can stay."""
    if kept >= 1:
        return edits
    chosen = _reduced.setdefault(gaussians, Reduced()).most_seen(gaussians, kept)
    rest = np.ones(len(gaussians), bool)
    rest[chosen] = False
    made = edits or SceneEdits(marks=np.zeros(len(gaussians), np.uint32))
    marks = made.marks.copy()
    marks[rest] |= HIDDEN
    return replace(made, marks=marks, flags=made.flags | HIDDEN, changes=())


def kept_count(splats: int, share: float) -> int:
    """How many of `splats` a share is: one at least, if there are any."""
    return min(splats, max(1, round(splats * share)))


def ranked_by_contribution(gaussians: Gaussians) -> np.ndarray:
    """(N,) indices, the splats that make most of the pictures first; of equals the earlier one."""
    # Imported when needed: they compile.
    from splatview import raster
    from splatview.edit.sample_views import sample_cameras

    if not len(gaussians):
        return np.zeros(0, np.intp)
    cameras = sample_cameras(gaussians, SceneEdits(marks=np.zeros(len(gaussians), np.uint32)))
    worth = raster.contributions(gaussians, cameras, settings_for(gaussians))
    return np.argsort(-np.nan_to_num(worth, nan=0.0), kind="stable")


# ---- Drawing by a plan: the settings in the renderer, and the shortcuts that are taken around it.


def draw_plan(
    renderer: HeadlessRenderer, gaussians: Gaussians, camera: Camera, plan: Plan, mode: VisualMode = "splats"
) -> np.ndarray:
    """The picture (H, W, 4) float32 of `camera`'s size."""
    scene = prepared(renderer, gaussians, plan)
    size = reduced_size(camera.width, camera.height, plan.resolution)
    if size == (camera.width, camera.height):
        return renderer.draw(scene, camera, plan.settings, mode)
    small = renderer.draw(scene, camera.resized(*size), plan.settings, mode)
    return enlarged(small, camera.width, camera.height)


def prepared(renderer: HeadlessRenderer, gaussians: Gaussians, plan: Plan) -> Gaussians:
    """The scene that `plan` draws, loaded into `renderer`; nothing where that was done before."""
    scene = reduced(gaussians, plan)
    renderer.load(scene, plan.attributes)
    return scene


class SceneArtist:
    """A renderer and the scene it draws, as the ladder wants them."""

    def __init__(
        self,
        renderer: HeadlessRenderer,
        gaussians: Gaussians,
        turned: Callable[[Camera, float], Camera] = lambda camera, degrees: camera,
    ):
        """`turned`: a camera so many degrees farther on its way, for pictures that depend on those before."""
        self.name = renderer.name
        self._renderer, self.scene, self._turned = renderer, gaussians, turned

    def can_draw(self, plan: Plan) -> bool:
        renderer = self._renderer
        return not isinstance(renderer, Quads) or renderer.can_draw(plan.settings, plan.attributes)

    def prepare(self, camera: Camera, plan: Plan) -> None:
        prepared(self._renderer, self.scene, plan)

    def draw(self, camera: Camera, plan: Plan) -> np.ndarray:
        path = [self._turned(camera, degrees) for degrees in path_to_view(plan.settings)]
        if len(path) > 1:
            self._renderer.forget_order()
        for each in path[:-1]:
            draw_plan(self._renderer, self.scene, each, plan)
        return draw_plan(self._renderer, self.scene, path[-1], plan)

    def follow(self, camera: Camera, plan: Plan) -> np.ndarray:
        """The picture of the next frame, sorted."""
        self._renderer.forget_order()
        return draw_plan(self._renderer, self.scene, camera, plan)

    def timed(self, camera: Camera, plan: Plan) -> float:
        """ms of a frame up to its pixels in memory: of a path, the mean."""
        begun = time.perf_counter()
        self.draw(camera, plan)
        return 1e3 * (time.perf_counter() - begun) / len(path_to_view(plan.settings))

    def memory(self, plan: Plan) -> int:
        """Bytes that the scene and the picture drawn last take in the renderer, beside the scene itself."""
        return self._renderer.memory()


# ---- Every renderer of this program as the catalogue of hard cases takes them.


NAMES = ("quads", "quads-gl33", "tiles", "cpu", "reference")
"""As `--renderer` takes them."""

GL_NAMES = ("quads", "quads-gl33", "tiles")


@contextmanager
def case_renderers(names: tuple[str, ...] = NAMES) -> Iterator[list[CaseRenderer]]:
    """Those called `names`, each in every precision that it blends in; freed at the end.

    Raises:
        InputError: one of them needs OpenGL, and there is none.
    """
    made: list[CaseRenderer] = []
    opened: list[Any] = []
    try:
        if any(name in GL_NAMES for name in names):
            made += gl_renderers(names, opened)
        if "cpu" in names:
            made.append(CaseRenderer(name="cpu", blend="float32", draw=draw_by_cpu))
        if "reference" in names:
            made.append(CaseRenderer(name="reference float64", blend="float32", draw=draw_by_reference))
            made.append(
                CaseRenderer(name="reference float32", blend="float32", draw=draw_by_reference_float32)
            )
        yield made
    finally:
        for thing in reversed(opened):
            thing.release()


def gl_renderers(names: tuple[str, ...], opened: list[Any]) -> list[CaseRenderer]:
    """The renderers by OpenGL on a context of their own; what has to be released goes to `opened`."""
    from splatview.renderers.gl.context import create_headless_context
    from splatview.renderers.gl.quads import QuadsRenderer
    from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
    from splatview.renderers.gl.tiles import TilesRenderer

    context = create_headless_context()
    opened.append(context)
    kinds: list[tuple[str, Any]] = []
    if "quads" in names and context.version_code >= 430:
        kinds.append(("quads", QuadsRenderer))
    if "quads-gl33" in names or ("quads" in names and context.version_code < 430):
        kinds.append(("quads-gl33", QuadsGL33Renderer))
    if "tiles" in names and context.version_code >= 430:
        kinds.append(("tiles", TilesRenderer))
    made: list[CaseRenderer] = []
    for name, kind in kinds:
        renderer = kind(context)
        opened.append(renderer)
        # Tiles keep their sums in float32 whatever they are asked for.
        blends: tuple[Precision, ...] = ("float32",) if name == "tiles" else ("float32", "float16")
        made += [CaseRenderer(name=name, blend=blend, draw=drawn_by(renderer)) for blend in blends]
    return made


def describe_gl() -> dict[str, str]:
    """Vendor, renderer and version of the OpenGL that is tested. Raises InputError where there is none."""
    from splatview.renderers.gl.context import create_headless_context, describe

    context = create_headless_context()
    try:
        info = describe(context)
    finally:
        context.release()
    return {"vendor": info.vendor, "renderer": info.renderer, "version": info.version}


def drawn_by(renderer: Any) -> Draw:
    def draw(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
        return renderer.render(gaussians, camera, settings)

    return draw


def draw_by_cpu(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
    from splatview.raster import render

    return render(gaussians, camera, settings)


def draw_by_reference(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
    from splatview.scene import reference

    return reference.render(gaussians, camera, settings)


def draw_by_reference_float32(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
    """The reference's formulas in single precision: what no renderer can be blamed for losing."""
    from splatview.scene import reference

    return reference.render(gaussians, camera, settings, dtype=np.float32)


# ---- What editing needs of a renderer, done by the CPU rasteriser: the same on every machine with any GPU.


class RasterTools:
    """`edit.tools.Tools`; recipes give the same file in the window and without one because both use it."""

    def dominant_splats(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        return raster.dominant_splats(gaussians, camera, settings_for(gaussians), edits=edits)

    def contributions(self, gaussians: Gaussians, cameras: Sequence[Camera], edits: SceneEdits) -> np.ndarray:
        return raster.contributions(gaussians, cameras, settings_for(gaussians), edits=edits)

    def render(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        return raster.render(gaussians, camera, settings_for(gaussians), edits=edits)
