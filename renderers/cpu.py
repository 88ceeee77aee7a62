"""Backends without OpenGL: the numba rasteriser, and the image model itself in float64."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Sequence
from typing import Any

import numpy as np

from splatview import raster
from splatview.raster.contributions import contributions, dominant_splats
from splatview.raster.modes import draw_mode
from splatview.renderers.depth_colours import DepthColours
from splatview.renderers.edit_snapshot import tinted
from splatview.renderers.modes import MODES
from splatview.renderers.request import Capabilities, FrameRequest, FrameStats, Highlight, Renderer
from splatview.scene import Camera, Gaussians, InputError, reference
from splatview.scene.attribute_formats import Attributes
from splatview.scene.edits import SceneEdits, bake
from splatview.scene.effects.overrides import all_in_sight, settings_for
from splatview.scene.normals import shaded_by_normals
from splatview.scene.projection import project

FOOTPRINT_BYTES = 8 * 16
"""Bytes that `scene.projection.Footprints` takes for one splat."""


def checked(renderer: Renderer, request: FrameRequest, loaded: Gaussians | None) -> Gaussians:
    """The request's scene, or the one loaded. Raises InputError for what the backend cannot draw."""
    problem = renderer.capabilities.unsupported(request)
    if problem is not None:
        raise InputError(problem)
    gaussians = loaded if request.gaussians is None else request.gaussians
    if gaussians is None:
        raise RuntimeError("load() comes before draw()")
    return gaussians


def with_normals(gaussians: Gaussians, request: FrameRequest) -> Gaussians:
    """The scene with its edits, in the colours of its normals."""
    shown = gaussians if request.edits is None else bake(gaussians, request.edits)
    return shaded_by_normals(shown, request.view, request.settings.model.footprint)


class CpuRenderer(Renderer):
    """The numba rasteriser. Any thread may use it: each has a picture and working memory of its own.

    It also is `edit.progress.Tools`: what editing needs of a renderer is always done here, so that a recipe
    gives the same file on every machine.
    """

    name = "cpu"
    capabilities = Capabilities(
        backend="cpu",
        orders=("32-bit", "16-bit", "per-pixel"),
        precisions=("float32",),
    )

    def __init__(self) -> None:
        self._depth_colours = DepthColours()
        self._gaussians: Gaussians | None = None
        self._own = threading.local()
        self._drawn = 0
        self._tinted: tuple[tuple[SceneEdits, int, Highlight], SceneEdits] | None = None

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        yield 0.0
        self._gaussians = gaussians  # drawn from where it is

    def draw(self, request: FrameRequest) -> None:
        gaussians, edits = checked(self, request, self._gaussians), self.edits_of(request)
        picture = raster.parameters_of(gaussians), request.view, request.settings, self._workspace
        options: dict[str, Any] = {
            "depth_order": self._depth_order,
            "edits": edits,
            "nonzero": raster.nonzero_bands(gaussians),
            "threads": self.threads,
        }
        if request.mode == "splats":
            frame = raster.draw_frame(*picture, **options)
        else:
            if MODES[request.mode].depths:
                options["depth_range"] = self._depth_colours.range(gaussians, edits, request.view)
            frame = draw_mode(request.mode, *picture, **options)
        self._drawn += 1
        self._own.image = frame.image
        self._own.stats = FrameStats(
            splats=len(gaussians),
            visible=sum(int(stop - start) for start, stop in frame.runs),
            ms=dict(frame.milliseconds),
            projected=self._drawn,
            sorted=self._drawn,
            drawn=self._drawn,
            pixel_splats=frame.pixel_splats,
        )

    def depth_range(self, camera: Camera) -> tuple[float, float] | None:
        """Depths, world units, of the ends of the colours of the mode "depth" from `camera`; None before the
        first such picture."""
        return self._depth_colours.latest_range(camera)

    def edits_of(self, request: FrameRequest) -> SceneEdits | None:
        """The edits, with the highlight as further adjustments of colours; the same object while they are."""
        edits, highlight = request.edits, request.highlight
        if edits is None or highlight is None or not highlight.applies_to(edits):
            return edits
        made = self._tinted
        key = edits, edits.marks_version, highlight
        if made is None or made[0][0] is not edits or made[0][1:] != key[1:]:
            made = self._tinted = key, tinted(edits, highlight)
        return made[1]

    def baked(self, request: FrameRequest) -> Gaussians:
        """The request's scene with its edits in it: the same picture by kernels that know no edits."""
        assert request.gaussians is not None
        edits = self.edits_of(request)
        return request.gaussians if edits is None else bake(request.gaussians, edits)

    def read(self) -> np.ndarray:
        return self._own.image

    @property
    def _workspace(self) -> raster.Workspace:
        if not hasattr(self._own, "workspace"):
            self._own.workspace = raster.Workspace()
        return self._own.workspace

    @property
    def _depth_order(self) -> raster.ReusableOrder:
        if not hasattr(self._own, "depth_order"):
            self._own.depth_order = raster.ReusableOrder()
        return self._own.depth_order

    def stats(self, *, wait: bool = False) -> FrameStats:
        return getattr(self._own, "stats", FrameStats())

    def memory(self) -> int:
        image = getattr(self._own, "image", None)
        return self._workspace.nbytes + (0 if image is None else image.nbytes)

    def forget_order(self) -> None:
        self._depth_order.resort_policy.forget()

    def close(self) -> None:
        self._gaussians = self._tinted = None
        self._own = threading.local()

    # ---- edit.tools.Tools

    def dominant_splats(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        return dominant_splats(gaussians, camera, settings_for(gaussians), edits=edits)

    def contributions(self, gaussians: Gaussians, cameras: Sequence[Camera], edits: SceneEdits) -> np.ndarray:
        return contributions(gaussians, cameras, all_in_sight(gaussians), edits=edits)

    def picture(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        settings = settings_for(gaussians, palette=edits.palette)
        return self.render(FrameRequest(gaussians, camera, settings, edits=edits))


class ReferenceRenderer(Renderer):
    """The image model, slowly: in float64 the truth, in float32 what no renderer can be blamed for losing."""

    name = "reference"
    capabilities = Capabilities(backend="reference", modes=("splats", "normals"))

    def __init__(self, dtype: type[np.floating] = np.float64) -> None:
        self._dtype = dtype
        self._gaussians: Gaussians | None = None
        self._latest: tuple[Gaussians, FrameRequest] | None = None
        self._image = np.zeros((0, 0, 4))
        self._milliseconds = 0.0

    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        yield 0.0
        self._gaussians = gaussians

    def draw(self, request: FrameRequest) -> None:
        gaussians = checked(self, request, self._gaussians)
        self._latest = gaussians, request
        begun = time.perf_counter()
        edits = request.edits
        if edits is not None and request.highlight is not None:
            edits = tinted(edits, request.highlight)
        if request.mode == "normals":
            shown = with_normals(gaussians, request)
        else:
            shown = gaussians if edits is None else bake(gaussians, edits)
        self._image = reference.render(shown, request.view, request.settings, dtype=self._dtype)
        self._milliseconds = 1e3 * (time.perf_counter() - begun)

    def read(self) -> np.ndarray:
        return self._image

    def stats(self, *, wait: bool = False) -> FrameStats:
        if self._latest is None:
            return FrameStats()
        gaussians, request = self._latest
        visible = len(project(gaussians, request.view, request.settings).indices)
        return FrameStats(splats=len(gaussians), visible=visible, ms={"render": self._milliseconds})

    def memory(self) -> int:
        return 0 if self._latest is None else FOOTPRINT_BYTES * len(self._latest[0])

    def forget_order(self) -> None:
        """It keeps none."""

    def close(self) -> None:
        self._gaussians = self._latest = None
