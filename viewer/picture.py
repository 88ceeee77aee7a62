"""Where the window's picture comes from: the GPU's splats or the CPU's, behind one interface."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Protocol

import moderngl
import numpy as np

from splatview import raster
from splatview.renderers import FrameStats, VisualMode, make_renderer
from splatview.renderers.cpu_async import CpuTexture
from splatview.renderers.gl.context import describe
from splatview.renderers.gl.shader_fallback import FallbackShaders, mode_key
from splatview.renderers.precompile import ShaderPrecompiler, precompile_job
from splatview.renderers.types import Highlight, refusal
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.attribute_formats import Attributes
from splatview.scene.edits import SceneEdits


class Picture(Protocol):
    """Draws a scene into a texture. Only the GL thread calls it."""

    name: str
    """What the statistics panel calls it."""
    modes: tuple[VisualMode, ...]
    """What it can show."""

    def refusal(self, settings: RenderSettings) -> str | None:
        """Why splats cannot be drawn by `settings` on this machine; None where they can."""
        ...

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

    @property
    def sharp(self) -> bool:
        """Whether a camera that changes is not one that moves: nothing is drawn coarse. Likewise."""
        ...

    @sharp.setter
    def sharp(self, sharp: bool) -> None: ...

    def load_steps(self, gaussians: Gaussians, attributes: Attributes = "float32") -> Generator[float]:
        """Replaces the scene in short steps, yielding the share done; the old one stays until the last.
        Its values fit into `attributes` (`scene.stored`), and a GPU stores them so.

        Raises InputError where it does not fit into memory. Closing the generator keeps the old scene.
        """
        ...

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> None:
        """Brings the texture up to date; costs nothing where nothing has changed.

        `edits` of the scene that is loaded are shown; `highlight` lights up what they mark.
        """
        ...

    def read(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
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
    sharp: bool = False

    def __init__(
        self, ctx: moderngl.Context, name: str = "quads", *, precompiler: ShaderPrecompiler | None = None
    ):
        """`precompiler` compile programs in the background; without, they are compiled when needed."""
        self._precompiler = precompiler
        self._fallback = None if precompiler is None else FallbackShaders(ctx, precompiler)
        self._renderer = make_renderer(ctx, name, self._fallback)
        self._renderer_name = name
        self.name = f"{name} (OpenGL {'4.3' if ctx.version_code >= 430 else '3.3'})"
        if self._fallback is not None:
            self._fallback.prepare(self._renderer)
        self._version_code = ctx.version_code
        self._gaussians = EMPTY
        self._renderer.load(EMPTY)

    def refusal(self, settings: RenderSettings) -> str | None:
        return refusal(self._version_code, settings)

    def load_steps(self, gaussians: Gaussians, attributes: Attributes = "float32") -> Generator[float]:
        if self._fallback is not None:
            for _ in self._fallback.while_loading():
                yield 0.0
        try:
            yield from self._renderer.load_steps(gaussians, attributes)
            self._gaussians = gaussians
        except MemoryError as error:
            raise InputError(f"{len(gaussians):,} splats: not enough memory to upload them") from error

    def load(self, gaussians: Gaussians) -> None:
        """As `load_steps`, all at once."""
        self._renderer.load(gaussians)
        self._gaussians = gaussians

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> None:
        self._renderer.draw(camera, settings, mode=mode, edits=edits, highlight=highlight)
        if self._fallback is not None:
            drawn = self._gaussians, camera, settings, mode, edits, highlight
            self._fallback.after_drawing(self._renderer_name, *drawn)

    def read(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> np.ndarray:
        self._renderer.draw(camera, settings, mode=mode, edits=edits, highlight=highlight)
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
        return compiling(self._precompiler)

    @property
    def note(self) -> str:
        return ""

    def wait(self, seconds: float) -> None:
        """Nothing is drawn behind the window's back."""

    def take_problem(self) -> str | None:
        return None if self._precompiler is None else self._precompiler.take_problem()

    def release(self) -> None:
        self._renderer.release()


class CpuPicture:
    """Splats by the CPU rasteriser; what it cannot show (points, depth, ...) by the GL renderer.

    The GL renderer is made and loaded only when such a mode is first asked for.
    """

    modes: tuple[VisualMode, ...] = GpuPicture.modes
    name = "cpu"

    def __init__(
        self,
        ctx: moderngl.Context,
        *,
        on_ready: Callable[[], object] = lambda: None,
        precompiler: ShaderPrecompiler | None = None,
    ):
        """`precompiler` compile kernels and programs in the background; without, when they are needed."""
        self._ctx = ctx
        self._precompiler = precompiler
        self._cpu = CpuTexture(ctx, on_ready=on_ready, precompiler=precompiler)
        self._cpu.load(EMPTY)
        self._gpu: GpuPicture | None = None
        self._gaussians = EMPTY
        self._gpu_holds: Gaussians | None = None
        self._by_gpu = False
        self._mode_to_come = False

    def refusal(self, settings: RenderSettings) -> str | None:
        return None

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

    @property
    def sharp(self) -> bool:
        return self._cpu.sharp

    @sharp.setter
    def sharp(self, sharp: bool) -> None:
        self._cpu.sharp = sharp

    def hold_budget(self, milliseconds: float | None) -> None:
        """What a picture may take while the camera moves; None: as much as is smooth."""
        self._cpu.budget_ms = milliseconds

    def load_steps(self, gaussians: Gaussians, attributes: Attributes = "float32") -> Generator[float]:
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
        highlight: Highlight | None = None,
    ) -> None:
        self._by_gpu = mode != "splats" and self._mode_compiled(camera, settings, mode)
        self._mode_to_come = mode != "splats" and not self._by_gpu
        if self._by_gpu:
            self._loaded_gpu().draw(camera, settings, mode, edits, highlight)
        else:
            self._cpu.draw(camera, settings, edits=edits, highlight=highlight)

    def read(
        self,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> np.ndarray:
        if mode != "splats":
            return self._loaded_gpu().read(camera, settings, mode, edits, highlight)
        return self._cpu.read(camera, settings, edits=edits, highlight=highlight)

    def _mode_compiled(self, camera: Camera, settings: RenderSettings, mode: VisualMode) -> bool:
        """Whether the GL renderer can show `mode` without stopping the window for its programs; until then
        splats are shown."""
        if self._precompiler is None or not len(self._gaussians):
            return True
        key = mode_key(self._ctx, mode)
        self._precompiler.ask(
            [key],
            mode,
            lambda: precompile_job(
                "quads",
                self._gaussians,
                camera,
                settings,
                mode=mode,
                gl_version=self._precompiler.gl_version if self._precompiler else None,
            ),
        )
        return self._precompiler.is_done([key])

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
        return self._mode_to_come or (not self._by_gpu and self._cpu.busy)

    @property
    def stats(self) -> FrameStats:
        return self._gpu.stats if self._by_gpu and self._gpu else self._cpu.stats

    @property
    def status(self) -> str:
        own = "" if self._by_gpu else self._cpu.status
        return own or compiling(self._precompiler)

    @property
    def note(self) -> str:
        return "" if self._by_gpu else self._cpu.note

    def wait(self, seconds: float) -> None:
        if not self._by_gpu:
            self._cpu.wait(seconds)

    def take_problem(self) -> str | None:
        problem, self._cpu.problem = self._cpu.problem, None
        if problem is None and self._precompiler is not None:
            return self._precompiler.take_problem()
        return problem

    def release(self) -> None:
        self._cpu.release()
        if self._gpu is not None:
            self._gpu.release()


def choose_picture(
    ctx: moderngl.Context,
    renderer: str,
    *,
    on_ready: Callable[[], object] = lambda: None,
    precompiler: ShaderPrecompiler | None = None,
) -> Picture:
    """What draws: `renderer` is of RENDERERS; "auto" takes the CPU where GL is only software, else `quads`.
    `on_ready` is called, in any thread, when a picture has come that was waited for. `precompiler` compile in
    the background what pictures need; whoever made them ends them.

    Raises:
        InputError: the name is unknown, or the renderer does not work here.
    """
    if renderer not in RENDERERS:
        raise InputError(f"--renderer {renderer}: the window has {', '.join(RENDERERS)}")
    if renderer == "cpu" or (renderer == "auto" and describe(ctx).is_software):
        return CpuPicture(ctx, on_ready=on_ready, precompiler=precompiler)
    return GpuPicture(ctx, "tiles" if renderer == "tiles" else "quads", precompiler=precompiler)


def compiling(precompiler: ShaderPrecompiler | None) -> str:
    """What the user is told meanwhile."""
    title = "" if precompiler is None else precompiler.title
    return f"Compiling for this machine: {title}" if title else ""


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
