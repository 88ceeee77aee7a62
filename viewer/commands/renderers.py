"""Renderers without a window, by name, behind one small face."""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ...scene import Camera, Gaussians, InputError, RenderSettings
from ...scene.stored import Attributes

if TYPE_CHECKING:
    import moderngl

    from ..gl import VisualMode

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
        from ..gl import make_renderer

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
        from ..gl.abilities import refusal

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
    from ..gl.memory import held_bytes

    return held_bytes(loaded[1])


class Tiles(Quads):
    """The same by tiles."""

    name = "tiles"


class Cpu:
    """The numba rasteriser."""

    name = "cpu"

    def __init__(self) -> None:
        from ...raster import Workspace, will_compile

        if will_compile():
            print("splatview: compiling the CPU renderer, once, may take a minute", file=sys.stderr)
        self._workspace = Workspace()
        self._last: tuple[int, dict[str, float]] = (0, {})
        self._image_bytes = 0

    def load(self, gaussians: Gaussians, attributes: Attributes) -> None:
        """Scenes are drawn from where they are."""

    def draw(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, mode: VisualMode = "splats"
    ) -> np.ndarray:
        from ...raster import draw_frame, nonzero_bands, parameters_of

        nonzero = nonzero_bands(gaussians)
        frame = draw_frame(parameters_of(gaussians), camera, settings, self._workspace, nonzero=nonzero)
        visible = sum(int(stop - start) for start, stop in frame.runs)
        self._last = visible, dict(frame.milliseconds)
        self._image_bytes = frame.image.nbytes
        return frame.image

    def forget_order(self) -> None:
        if self._workspace.kept_order is not None:
            self._workspace.kept_order.resorting.forget()

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
        from ...scene import reference

        self._last = gaussians, camera, settings
        start = time.perf_counter()
        image = reference.render(gaussians, camera, settings).astype(np.float32)
        self._milliseconds = 1e3 * (time.perf_counter() - start)
        return image

    def forget_order(self) -> None:
        """It keeps none."""

    def stats(self) -> tuple[int, dict[str, float]]:
        from ...scene.projection import project

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
    from ..gl.context import create_headless_context

    return (Tiles if name == "tiles" else Quads)(create_headless_context())


def automatic_choice() -> tuple[str, str]:
    """What "auto" takes here, and why."""
    from ..gl.context import create_headless_context, describe

    try:
        ctx = create_headless_context()
    except InputError as error:
        return "cpu", str(error)
    info = describe(ctx)
    ctx.release()
    if info.is_software and find_spec("numba") is not None:
        return "cpu", f"OpenGL is only software here ({info.renderer})"
    return "quads", f"OpenGL runs on {info.renderer}"
