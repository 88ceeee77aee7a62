"""What a renderer is asked for, and what every renderer offers."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Generator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from splatview.measure.knobs import Plan
from splatview.measure.metrics import enlarged, reduced_size
from splatview.renderers.modes import MODES, VisualMode
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.attribute_formats import FORMATS, Attributes
from splatview.scene.edits import LOCKED, PREVIEW, SELECTED, SceneEdits
from splatview.scene.image_model import Order
from splatview.scene.order_reuse import keeps_order

Precision = Literal["float16", "float32", "unorm8"]

TINT_COUNT = 2 * PREVIEW
"""Rows of a table of tints: one for each set of state flags."""

Tint = tuple[float, float, float, float]
"""RGB and strength: colour' = (1 - strength)·colour + strength·RGB."""


@dataclass(frozen=True, kw_only=True)
class Highlight:
    """Tints of marked splats; a strength of 0 leaves them as they are. Of several marks the first counts."""

    preview: Tint = (1.0, 0.08, 0.05, 0.7)
    selected: Tint = (1.0, 0.72, 0.05, 0.55)
    locked: Tint = (0.12, 0.2, 0.4, 0.6)

    @property
    def flags(self) -> int:
        """State flags that are lit up."""
        pairs = ((PREVIEW, self.preview), (SELECTED, self.selected), (LOCKED, self.locked))
        return sum(flag for flag, tint in pairs if tint[3] > 0)

    @property
    def table(self) -> np.ndarray:
        """(TINT_COUNT, 4) float32: the tint of a splat whose mark is m is row m % TINT_COUNT."""
        table = np.zeros((TINT_COUNT, 4), np.float32)
        marks = np.arange(TINT_COUNT)
        for flag, tint in ((LOCKED, self.locked), (SELECTED, self.selected), (PREVIEW, self.preview)):
            if tint[3] > 0:
                table[(marks & flag) != 0] = tint
        return table

    def applies_to(self, edits: SceneEdits) -> bool:
        """Whether some splats may be lit up."""
        return bool(self.flags & edits.flags)


@dataclass(frozen=True, eq=False)
class FrameRequest:
    """One picture that somebody wants."""

    gaussians: Gaussians | None
    """Scene to draw; None: the one that the renderer has loaded."""
    camera: Camera
    settings: RenderSettings = field(default_factory=RenderSettings)
    _: KW_ONLY
    mode: VisualMode = "splats"
    edits: SceneEdits | None = None
    """Edits in force, of this scene."""
    highlight: Highlight | None = None
    """Tints of splats that the edits mark; a picture for keeping has none."""
    resolution: float = 1.0
    """Share of the camera's width and height that is drawn."""
    kept: float = 1.0
    """Share of the splats that is drawn, those that contribute most (`quality.fewer_splats`)."""
    attributes: Attributes = "float32"
    """Format in which the renderer stores the scene."""

    @classmethod
    def by_plan(cls, gaussians: Gaussians | None, camera: Camera, plan: Plan, **options: Any) -> FrameRequest:
        """The request with the settings and shortcuts of `plan`."""
        shortcuts: dict[str, Any] = {
            "resolution": plan.resolution,
            "kept": plan.kept,
            "attributes": plan.attributes,
        }
        return cls(gaussians, camera, plan.settings, **shortcuts, **options)

    @property
    def plan(self) -> Plan:
        """The settings and shortcuts alone."""
        return Plan(
            settings=self.settings, resolution=self.resolution, kept=self.kept, attributes=self.attributes
        )

    @property
    def view(self) -> Camera:
        """The camera of the pixels that are drawn."""
        camera = self.camera
        size = reduced_size(camera.width, camera.height, self.resolution)
        return camera if size == (camera.width, camera.height) else camera.resized(*size)

    def same_picture(self, other: FrameRequest | None) -> bool:
        """Whether both ask for the same picture of the same objects: scene and edits are not read."""
        return other is not None and self.same_objects(other) and self.same_view(other)

    def same_objects(self, other: FrameRequest) -> bool:
        """Whether both show the same scene with the same edits, from wherever."""
        same_scene = self.gaussians is other.gaussians and self.edits is other.edits
        return same_scene and self.highlight == other.highlight

    def same_view(self, other: FrameRequest) -> bool:
        """Whether both show their scene, whichever it is, from the same place in the same way."""
        return self.camera.same_view(other.camera) and (
            (self.settings, self.mode, self.resolution, self.kept, self.attributes)
            == (other.settings, other.mode, other.resolution, other.kept, other.attributes)
        )


@dataclass(frozen=True, kw_only=True)
class FrameStats:
    """One reading of a renderer."""

    splats: int = 0
    """Splats in the scene."""
    visible: int = 0
    """Splats of a recent frame that were not culled: read back when the GPU has it."""
    ms: Mapping[str, float] = field(default_factory=dict)
    """Milliseconds of that frame by stage ("project", "sort", "draw")."""
    projected: int = 0
    sorted: int = 0
    drawn: int = 0
    """Number of times each stage has run since the renderer was made."""
    pixel_splats: int = 0
    """Alphas computed over all pixels, where the backend counts them."""

    @property
    def milliseconds(self) -> float:
        """Milliseconds of all stages."""
        return sum(self.ms.values())


@dataclass(frozen=True, kw_only=True)
class Capabilities:
    """What a backend can draw."""

    backend: str
    """Name that messages give it."""
    orders: tuple[Order, ...] = ("32-bit",)
    modes: tuple[VisualMode, ...] = tuple(MODES)
    precisions: tuple[Precision, ...] = ("float32",)
    """Precisions of blending that differ in the picture."""
    attributes: tuple[Attributes, ...] = FORMATS
    """Formats in which it can store a scene."""
    reuses_order: bool = True
    """Whether one depth order can serve several frames."""
    needs: str = ""
    """What the orders and attributes that are missing would need."""

    def unsupported(self, request: FrameRequest) -> str | None:
        """Why there is no picture for `request`, in a line; None where there is one."""
        settings = request.settings
        if request.attributes not in self.attributes:
            return f"attributes in {request.attributes} need {self.needs}; use float32 or --renderer cpu"
        if settings.order not in self.orders and self.needs:
            return f"{settings.order} order needs {self.needs}; use 32-bit"
        if settings.order not in self.orders:
            return f"{settings.order} order is not for {self.backend}: {', '.join(self.orders)}"
        if keeps_order(settings) and not self.reuses_order:
            return f"an order that is kept for several frames needs {self.needs}; use --resort 1"
        if request.mode not in self.modes:
            return f"--mode {request.mode} needs --renderer {' or '.join(MODES[request.mode].backends)}"
        if MODES[request.mode].surfaces and request.camera.lens is not None:
            return f"{request.mode} cannot be drawn through a lens; take the lens off, or show splats"
        return None


class Renderer(Protocol):
    """One scene, many pictures. Those by OpenGL belong to the thread of their context."""

    name: str
    """Backend, as `--renderer` takes it."""
    capabilities: Capabilities
    threads: int | None = None
    """Cores to draw with, where the processor draws; None: all. May be changed at any time."""

    @abstractmethod
    def load_steps(
        self, gaussians: Gaussians, attributes: Attributes = "float32"
    ) -> Generator[float, None, None]:
        """Replaces the scene in steps of a few milliseconds: yields the share done after each. The values
        fit into `attributes` (`attribute_formats.stored`) and may be stored so.

        The scene shown so far stays until the last step; closing the generator early leaves it so.

        Raises:
            InputError: the scene does not fit into memory.
        """
        ...

    def load(self, gaussians: Gaussians, attributes: Attributes = "float32") -> None:
        """Replaces the scene, all at once; raises as `load_steps`."""
        for _ in self.load_steps(gaussians, attributes):
            pass

    @abstractmethod
    def draw(self, request: FrameRequest) -> None:
        """Draws the request's view; a scene other than the one loaded is loaded first.

        Raises:
            RuntimeError: no scene was loaded.
            ValueError: the edits are another scene's.
            InputError: this backend or machine cannot draw it.
        """
        ...

    @abstractmethod
    def read(self) -> np.ndarray:
        """Picture asked for last, (H, W, 4) float32, row 0 on top. Waits for it."""
        ...

    def finish(self) -> None:
        """Waits until the picture asked for last is drawn; on a GPU, it stays there."""
        return

    def render(self, request: FrameRequest) -> np.ndarray:
        """Picture of the request, (H, W, 4) float32 of its camera's size."""
        self.draw(request)
        return enlarged(self.read(), request.camera.width, request.camera.height)

    @abstractmethod
    def stats(self, *, wait: bool = False) -> FrameStats:
        """Reading of a recent frame, without waiting; `wait`: of the very last one."""
        ...

    @abstractmethod
    def memory(self) -> int:
        """Bytes held for the scene and the last picture, the `Gaussians` themselves apart."""
        ...

    @abstractmethod
    def forget_order(self) -> None:
        """Has the next picture sorted anew, whatever `RenderSettings.resort_frames` says."""
        ...

    @abstractmethod
    def close(self) -> None:
        """Gives back all memory and ends all threads; the renderer is of no use afterwards."""
        ...
