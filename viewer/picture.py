"""The window's picture: drawn at once by a backend of OpenGL, or in its own time by the CPU."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace

import moderngl
import numpy as np

from splatview.renderers import choices, make_renderer, on_this_gl
from splatview.renderers.async_renderer import AsyncRenderer
from splatview.renderers.gl.context import describe
from splatview.renderers.gl.renderer import GLRenderer
from splatview.renderers.gl.shader_fallback import FallbackShaders
from splatview.renderers.precompile import ShaderPrecompiler
from splatview.renderers.request import FrameRequest, FrameStats
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.attribute_formats import Attributes

RENDERERS = ("auto", *choices("window"))


class Picture:
    """Draws a scene into a texture. Only the thread of the OpenGL context calls it, but for `read` where it
    `draws_anywhere`."""

    threads: int | None = None
    """Cores that drawing may take, where the processor draws; None: all. As all that follows it counts from
    the next `draw` on, and means nothing where a GPU draws."""
    cores: float | None = None
    """Cores to keep busy on average, the window included; None: no limit."""
    sharp: bool = False
    """Whether pictures of a camera that changes are drawn in full, too."""
    budget_ms: float | None = None
    """Milliseconds for a picture while the camera moves; None: as much as is smooth."""
    _precompiler: ShaderPrecompiler | None = None
    _fallback: FallbackShaders | None = None
    _gl: GLRenderer | None = None
    _async: AsyncRenderer | None = None

    def __init__(
        self,
        ctx: moderngl.Context,
        name: str = "quads",
        *,
        on_ready: Callable[[], object] = lambda: None,
        precompiler: ShaderPrecompiler | None = None,
    ):
        """`name`: a backend. `on_ready` is called, in any thread, when a picture has come that was
        waited for. `precompiler` compiles in the background what pictures need; without, it is compiled when
        it is needed."""
        backend = on_this_gl(name, ctx)
        self.backend = name
        """As `--renderer` takes it."""
        self.name = backend.label
        self._ctx = ctx
        self._precompiler = precompiler
        self._gaussians = EMPTY
        if backend.gl_version is not None:
            self._fallback = None if precompiler is None else FallbackShaders(ctx, precompiler)
            self._gl = gl_renderer(name, ctx, self._fallback)
            if self._fallback is not None:
                self._fallback.prepare(self._gl)
            self._gl.load(EMPTY)
        else:
            self._async = AsyncRenderer(make_renderer(name), on_ready=on_ready, precompiler=precompiler)
            self._async.load(EMPTY)
            self._texture = ctx.texture((1, 1), 4, dtype="f4")

    @property
    def draws_anywhere(self) -> bool:
        """Whether `read` may be called in any thread, beside pictures that are drawn."""
        return self._async is not None

    def unsupported(self, request: FrameRequest) -> str | None:
        """Why splats cannot be drawn so on this machine; None where they can."""
        renderer = self._async or self._gl
        assert renderer is not None
        return renderer.capabilities.unsupported(request)

    def load_steps(self, gaussians: Gaussians, attributes: Attributes = "float32") -> Generator[float]:
        """Replaces the scene in short steps, as `Renderer.load_steps`."""
        if self._async is not None:
            yield from self._async.load_steps(gaussians, attributes)
        elif self._gl is not None:
            for _ in self._fallback.while_loading() if self._fallback else ():
                yield 0.0
            try:
                yield from self._gl.load_steps(gaussians, attributes)
            except MemoryError as error:
                raise InputError(f"{len(gaussians):,} splats: not enough memory to upload them") from error
        self._gaussians = gaussians

    def draw(self, request: FrameRequest) -> None:
        """Brings the texture up to date with the loaded scene; costs nothing where nothing has changed.

        Raises:
            InputError: this backend or machine cannot draw it.
        """
        request = replace(request, gaussians=None)
        if self._gl is not None:
            self._gl.draw(request)
            if self._fallback is not None:
                self._fallback.after_drawing(self.backend, replace(request, gaussians=self._gaussians))
        elif self._async is not None:
            self._async.threads, self._async.cores = self.threads, self.cores
            self._async.sharp, self._async.budget_ms = self.sharp, self.budget_ms
            self._async.draw(request)
            image = self._async.take_picture()
            if image is not None:
                self._upload(image)

    def _upload(self, image: np.ndarray) -> None:
        height, width = image.shape[:2]
        if self._texture.size != (width, height):
            self._texture.release()
            self._texture = self._ctx.texture((width, height), 4, dtype="f4")
        self._texture.write(image)

    def read(self, request: FrameRequest) -> np.ndarray:
        """The finished picture (H, W, 4) float32 of the loaded scene, whatever the window shows meanwhile."""
        request = replace(request, gaussians=None)
        if self._async is not None:
            return self._async.render(request)
        assert self._gl is not None
        self._gl.draw(request)
        return self._gl.read()

    def forget_order(self) -> None:
        """Has the next picture that this thread reads sorted anew, whatever the settings say."""
        renderer = self._async or self._gl
        if renderer is not None:
            renderer.forget_order()

    def depth_range(self, camera: Camera) -> tuple[float, float] | None:
        """Depths, world units, of the colours of the visual mode "depth"; None before they are known."""
        renderer = self._async or self._gl
        return None if renderer is None else renderer.depth_range(camera)

    @property
    def texture(self) -> moderngl.Texture:
        """The latest picture, row 0 on top; of another size than asked for while a better one is made."""
        return self._gl.texture if self._gl is not None else self._texture

    @property
    def busy(self) -> bool:
        """Whether a better picture is on its way: the window then keeps asking."""
        renderer = self._gl or self._async
        return renderer is not None and renderer.busy

    @property
    def is_current(self) -> bool:
        """Whether a picture of the loaded scene has been shown, be it a coarse one."""
        return self._async is None or self._async.pictured is self._gaussians

    @property
    def stats(self) -> FrameStats:
        renderer = self._gl or self._async
        return renderer.stats() if renderer is not None else FrameStats()

    @property
    def status(self) -> str:
        """What the user should know while waiting, or ""."""
        own = self._async.status if self._async else ""
        title = "" if self._precompiler is None else self._precompiler.title
        return own or (f"Compiling for this machine: {title}" if title else "")

    @property
    def note(self) -> str:
        """By what the picture in the texture is reduced while the camera moves, or ""."""
        return self._async.note if self._async else ""

    def wait(self, seconds: float) -> None:
        """Returns when a picture that is being drawn has come, at once where none is, or after `seconds`."""
        if self._async is not None:
            self._async.wait(seconds)

    def take_problem(self) -> str | None:
        """What went wrong behind the scenes since the last call."""
        problem = None
        if self._async is not None:
            problem, self._async.problem = self._async.problem, None
        if problem is None and self._precompiler is not None:
            return self._precompiler.take_problem()
        return problem

    def close(self) -> None:
        if self._async is not None:
            self._async.close()
            self._texture.release()
        if self._gl is not None:
            self._gl.close()


class NullPicture(Picture):
    """The picture while there is no OpenGL context: takes every scene, and has no texture."""

    backend = name = "none"

    def __init__(self) -> None:
        pass

    def unsupported(self, request: FrameRequest) -> str | None:
        return "there is no OpenGL context"

    def load_steps(self, gaussians: Gaussians, attributes: Attributes = "float32") -> Generator[float]:
        yield from ()

    def read(self, request: FrameRequest) -> np.ndarray:
        raise InputError("Nothing can be drawn: there is no OpenGL context")


def gl_renderer(name: str, ctx: moderngl.Context, variants: FallbackShaders | None = None) -> GLRenderer:
    """One that draws into a texture of `ctx`."""
    made = make_renderer(name, ctx, variants)
    assert isinstance(made, GLRenderer)
    return made


def choose_picture(
    ctx: moderngl.Context,
    renderer: str,
    *,
    on_ready: Callable[[], object] = lambda: None,
    precompiler: ShaderPrecompiler | None = None,
) -> Picture:
    """The picture by `renderer`, one of RENDERERS; "auto" takes the CPU where OpenGL is only software, else
    the faster one of `quads` and `tiles`. Whoever made the `precompiler` ends it.

    Raises:
        InputError: the name is unknown, or the renderer does not work here.
    """
    if renderer not in RENDERERS:
        raise InputError(f"--renderer {renderer}: the window has {', '.join(RENDERERS)}")
    if renderer == "auto":
        renderer = "cpu" if describe(ctx).is_software else fastest_by_gl(ctx)
    return Picture(ctx, renderer, on_ready=on_ready, precompiler=precompiler)


def fastest_by_gl(ctx: moderngl.Context) -> str:
    """Name of the renderer by OpenGL that draws fastest here."""
    from splatview.renderers.gl.renderer_choice import faster  # with the modules of all of them

    return faster(ctx)[0]


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
