"""Where the window's picture comes from: the GPU's splats or the CPU's, behind one interface."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Protocol

import moderngl
import numpy as np

from ... import raster
from ...scene import Camera, Gaussians, InputError, RenderSettings
from ...scene.edits import SceneEdits
from ..gl import FrameStats, VisualMode, make_renderer
from ..gl.context import describe
from ..gl.cpu_texture import CpuTexture
from ..gl.overlay import Overlay


class Picture(Protocol):
    """Draws a scene into a texture. Only the GL thread calls it."""

    name: str
    """What the statistics panel calls it."""
    modes: tuple[VisualMode, ...]
    """What it can show."""

    @property
    def threads(self) -> int | None:
        """Cores that drawing may take, where the processor draws; None: all. May be set at any time."""
        ...

    @threads.setter
    def threads(self, threads: int | None) -> None: ...

    @property
    def cores(self) -> float | None:
        """How many it may keep busy on average, the window included; None: as many as it likes. Likewise."""
        ...

    @cores.setter
    def cores(self, cores: float | None) -> None: ...

    def load_steps(self, gaussians: Gaussians) -> Generator[float]:
        """Replaces the scene in short steps, yielding the share done; the old one stays until the last.

        Raises InputError where it does not fit into memory. Closing the generator keeps the old scene.
        """
        ...

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> None:
        """Brings the texture up to date; costs nothing where nothing has changed.

        `edits` of the scene that is loaded are shown; `overlay` lights up what they mark.
        """
        ...

    def read(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> np.ndarray:
        """The finished picture (H, W, 4) float32, whatever the window shows meanwhile."""
        ...

    def forget_order(self) -> None:
        """The next picture that this thread reads is sorted anew, whatever `RenderSettings.resort_frames`
        says."""
        ...

    @property
    def texture(self) -> moderngl.Texture:
        """The latest picture, row 0 on top; of another size than asked for while a better one is made."""
        ...

    @property
    def busy(self) -> bool:
        """Whether a better picture is on its way: the window then keeps asking."""
        ...

    @property
    def stats(self) -> FrameStats: ...

    @property
    def status(self) -> str:
        """What the user should know while waiting, or ""."""
        ...

    @property
    def note(self) -> str:
        """By what the picture in the texture is reduced while the camera moves, or ""."""
        ...

    def wait(self, seconds: float) -> None:
        """Returns when a picture that is being drawn has come, at once where none is, or after `seconds`."""
        ...

    def take_problem(self) -> str | None:
        """What went wrong behind the scenes since the last call."""
        ...

    def release(self) -> None: ...


class GpuPicture:
    """A GL renderer, drawing straight into the window's context."""

    modes: tuple[VisualMode, ...] = ("splats", "points", "ellipsoids", "depth", "overdraw")
    threads: int | None = None
    cores: float | None = None

    def __init__(self, ctx: moderngl.Context, name: str = "quads"):
        self._renderer = make_renderer(ctx, name)
        self.name = f"{name} (OpenGL {'4.3' if ctx.version_code >= 430 else '3.3'})"
        self._renderer.load(EMPTY)

    def load_steps(self, gaussians: Gaussians) -> Generator[float]:
        try:
            yield from self._renderer.load_steps(gaussians)
        except MemoryError as error:
            raise InputError(f"{len(gaussians):,} splats: not enough memory to upload them") from error

    def load(self, gaussians: Gaussians) -> None:
        """As `load_steps`, all at once."""
        self._renderer.load(gaussians)

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> None:
        self._renderer.draw(camera, settings, mode=mode, edits=edits, overlay=overlay)

    def read(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> np.ndarray:
        self._renderer.draw(camera, settings, mode=mode, edits=edits, overlay=overlay)
        return self._renderer.read()

    def forget_order(self) -> None:
        self._renderer.forget_order()

    @property
    def texture(self) -> moderngl.Texture:
        return self._renderer.texture

    @property
    def busy(self) -> bool:
        return self._renderer.busy

    @property
    def stats(self) -> FrameStats:
        return self._renderer.stats

    @property
    def status(self) -> str:
        return ""

    @property
    def note(self) -> str:
        return ""

    def wait(self, seconds: float) -> None:
        """Nothing is drawn behind the window's back."""

    def take_problem(self) -> str | None:
        return None

    def release(self) -> None:
        self._renderer.release()


class CpuPicture:
    """Splats by the CPU rasteriser; what it cannot show (points, depth, ...) by the GL renderer.

    The GL renderer is made and loaded only when such a mode is first asked for.
    """

    modes: tuple[VisualMode, ...] = GpuPicture.modes
    name = "cpu"

    def __init__(self, ctx: moderngl.Context, *, on_ready: Callable[[], object] = lambda: None):
        self._ctx = ctx
        self._cpu = CpuTexture(ctx, on_ready=on_ready)
        self._cpu.load(EMPTY)
        self._gpu: GpuPicture | None = None
        self._gaussians = EMPTY
        self._gpu_holds: Gaussians | None = None
        self._by_gpu = False

    @property
    def threads(self) -> int | None:
        return self._cpu.threads

    @threads.setter
    def threads(self, threads: int | None) -> None:
        self._cpu.threads = threads

    @property
    def cores(self) -> float | None:
        return self._cpu.cores

    @cores.setter
    def cores(self, cores: float | None) -> None:
        self._cpu.cores = cores

    def hold_budget(self, milliseconds: float | None) -> None:
        """What a picture may take while the camera moves; None: as much as is smooth."""
        self._cpu.budget_ms = milliseconds

    def load_steps(self, gaussians: Gaussians) -> Generator[float]:
        yield 0.0
        self._gaussians = gaussians
        self._cpu.load(gaussians)
        if self._gpu is not None:
            # Not kept twice: loaded again when a mode needs it.
            self._gpu.load(EMPTY)
            self._gpu_holds = EMPTY

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> None:
        self._by_gpu = mode != "splats"
        if self._by_gpu:
            self._loaded_gpu().draw(camera, settings, mode, edits, overlay)
        else:
            self._cpu.draw(camera, settings, edits=edits, overlay=overlay)

    def read(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> np.ndarray:
        if mode != "splats":
            return self._loaded_gpu().read(camera, settings, mode, edits, overlay)
        return self._cpu.read(camera, settings, edits=edits, overlay=overlay)

    def _loaded_gpu(self) -> GpuPicture:
        if self._gpu is None:
            self._gpu = GpuPicture(self._ctx)
        if self._gpu_holds is not self._gaussians:
            self._gpu.load(self._gaussians)
            self._gpu_holds = self._gaussians
        return self._gpu

    def forget_order(self) -> None:
        raster.forget_order()

    @property
    def texture(self) -> moderngl.Texture:
        return self._gpu.texture if self._by_gpu and self._gpu else self._cpu.texture

    @property
    def busy(self) -> bool:
        return not self._by_gpu and self._cpu.busy

    @property
    def stats(self) -> FrameStats:
        return self._gpu.stats if self._by_gpu and self._gpu else self._cpu.stats

    @property
    def status(self) -> str:
        return "" if self._by_gpu else self._cpu.status

    @property
    def note(self) -> str:
        return "" if self._by_gpu else self._cpu.note

    def wait(self, seconds: float) -> None:
        if not self._by_gpu:
            self._cpu.wait(seconds)

    def take_problem(self) -> str | None:
        problem, self._cpu.problem = self._cpu.problem, None
        return problem

    def release(self) -> None:
        self._cpu.release()
        if self._gpu is not None:
            self._gpu.release()


def choose_picture(
    ctx: moderngl.Context, renderer: str, *, on_ready: Callable[[], object] = lambda: None
) -> Picture:
    """What draws: `renderer` is of RENDERERS; "auto" takes the CPU where GL is only software, else `quads`.
    `on_ready` is called, in any thread, when a picture has come that was waited for.

    Raises:
        InputError: the name is unknown, or the renderer does not work here.
    """
    if renderer not in RENDERERS:
        raise InputError(f"--renderer {renderer}: the window has {', '.join(RENDERERS)}")
    if renderer == "cpu" or (renderer == "auto" and describe(ctx).is_software):
        return CpuPicture(ctx, on_ready=on_ready)
    return GpuPicture(ctx, "tiles" if renderer == "tiles" else "quads")


RENDERERS = ("auto", "quads", "tiles", "cpu")


EMPTY = Gaussians(
    means=np.zeros((0, 3), np.float32),
    quats=np.zeros((0, 4), np.float32),
    log_scales=np.zeros((0, 3), np.float32),
    opacity_logits=np.zeros(0, np.float32),
    sh=np.zeros((0, 1, 3), np.float32),
)
"""What is shown before anything is open."""


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """`camera` on `scale` times the pixels, at least 1x1."""
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
