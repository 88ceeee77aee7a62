"""GL contexts for tests, where a GL error left behind fails its test; and every renderer behind one face."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
import pytest

from splatview.renderers import BACKENDS, Renderer
from splatview.renderers.gl.context import create_headless_context
from splatview.renderers.request import FrameRequest, Highlight, VisualMode
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.edits import SceneEdits

GL_VERSION = int(os.environ.get("SPLATVIEW_TEST_GL", "430"))
"""Oldest version to ask for. Mesa reads its version override once a process, so tests that want an old
OpenGL run themselves again in another process with this set (see gl/test_quads_gl33)."""

GL_BACKENDS = tuple(name for name, backend in BACKENDS.items() if backend.gl_version is not None)


@pytest.fixture(scope="session")
def only_context() -> moderngl.Context:
    """One headless GL 4.3 context for the whole run, which a window's test may have put aside."""
    try:
        return create_headless_context(require=GL_VERSION)
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def session_context(only_context: moderngl.Context) -> moderngl.Context:
    """The context, current, for what a module's tests share; use `ctx` in tests."""
    return only_context.__enter__()  # never left: contexts of glcontext do not nest


@pytest.fixture
def ctx(session_context: moderngl.Context) -> Iterator[moderngl.Context]:
    """The headless context, clean before the test and checked after it."""
    session_context.__enter__()
    assert session_context.error == "GL_NO_ERROR", "an earlier test left a GL error"
    yield session_context
    session_context.finish()
    assert session_context.error == "GL_NO_ERROR"


LEAST_LIMITS: dict[str, Any] = {
    "GL_MAX_COMPUTE_WORK_GROUP_COUNT": (65_535, 65_535, 65_535),
    "GL_MAX_COMPUTE_WORK_GROUP_INVOCATIONS": 1024,
    "GL_MAX_COMPUTE_WORK_GROUP_SIZE": (1024, 1024, 64),
    "GL_MAX_SHADER_STORAGE_BLOCK_SIZE": 1 << 24,
    "GL_MAX_TEXTURE_SIZE": 16_384,
}
"""What OpenGL 4.3 promises, but for storage blocks, of which `has_compute` asks for more."""


@pytest.fixture
def limited(ctx: moderngl.Context, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """`limited(GL_MAX_...=...)`: the driver says that it can do no more than `LEAST_LIMITS` and what is
    given, and does no more: what goes beyond fails its test."""
    real = dict(ctx.info)
    limits = {**LEAST_LIMITS}
    run, run_indirect = moderngl.ComputeShader.run, moderngl.ComputeShader.run_indirect
    bind = moderngl.Buffer.bind_to_storage_buffer

    def checked(groups: tuple[int, ...]) -> None:
        most = limits["GL_MAX_COMPUTE_WORK_GROUP_COUNT"]
        assert all(count <= limit for count, limit in zip(groups, most, strict=True)), groups

    def checked_run(self: Any, x: int = 1, y: int = 1, z: int = 1) -> None:
        checked((x, y, z))
        assert x and y and z
        run(self, x, y, z)

    def checked_indirect(self: Any, buffer: moderngl.Buffer, offset: int = 0) -> None:
        checked(tuple(np.frombuffer(buffer.read(12, offset=offset), np.uint32).tolist()))
        run_indirect(self, buffer, offset)

    def checked_bind(self: Any, binding: int = 0, offset: int = 0, size: int = -1) -> None:
        assert (self.size if size < 0 else size) <= limits["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]
        bind(self, binding, offset, size)

    def limit(**more: Any) -> None:
        limits.update(more)
        monkeypatch.setattr(ctx, "_info", {**real, **limits})

    monkeypatch.setattr(moderngl.ComputeShader, "run", checked_run)
    monkeypatch.setattr(moderngl.ComputeShader, "run_indirect", checked_indirect)
    monkeypatch.setattr(moderngl.Buffer, "bind_to_storage_buffer", checked_bind)
    limit()
    assert ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"] == 1 << 24
    return limit


@dataclass(frozen=True, kw_only=True)
class Backend:
    """One way to draw a scene, by the name that people choose it by."""

    name: str
    bound: float
    """Largest error of a channel in float32, where neither a cut nor a tie of depths decides."""
    most: float
    """The same where they do."""
    renderer: Renderer

    @property
    def gl(self) -> Any:
        """The OpenGL renderer, if it is one."""
        return self.renderer if self.name in GL_BACKENDS else None

    def visible(self) -> int:
        """Splats that reached the last picture."""
        return self.renderer.stats(wait=True).visible

    def draw(
        self,
        gaussians: Gaussians,
        camera: Camera,
        settings: RenderSettings,
        mode: VisualMode = "splats",
        *,
        edits: SceneEdits | None = None,
        highlight: Highlight | None = None,
    ) -> np.ndarray:
        """The picture (H, W, 4) float32."""
        request = FrameRequest(gaussians, camera, settings, mode=mode, edits=edits, highlight=highlight)
        # The reference draws in float64.
        return self.renderer.render(request).astype(np.float32, copy=False)

    def __str__(self) -> str:
        return self.name


BOUNDS = {
    "quads": (0.5 / 255, 4 / 255),
    "quads-gl33": (0.5 / 255, 0.5 / 255),
    "tiles": (0.5 / 255, 0.5 / 255),
    "cpu": (1e-4, 4 / 255),
    "reference": (1e-6, 1e-6),
}
"""Name -> `Backend.bound` and `Backend.most`."""


@pytest.fixture
def make_backend(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Backend]]:
    """`make_backend("tiles")`: a renderer that has drawn nothing yet."""
    made: list[Backend] = []

    def make(name: str) -> Backend:
        ctx: moderngl.Context | None = None
        needed = BACKENDS[name].gl_version
        if needed is not None:
            ctx = request.getfixturevalue("ctx")
            if ctx is None or ctx.version_code < needed:
                pytest.skip(f"needs OpenGL {needed}")
        renderer = BACKENDS[name].make(ctx, None)
        made.append(Backend(name=name, bound=BOUNDS[name][0], most=BOUNDS[name][1], renderer=renderer))
        return made[-1]

    yield make
    for backend in made:
        backend.renderer.close()


@pytest.fixture(params=[*BACKENDS])
def backend(request: pytest.FixtureRequest, make_backend: Callable[[str], Backend]) -> Backend:
    """Every renderer in turn, or those that a test names: `@pytest.mark.parametrize("backend", ...,
    indirect=True)`."""
    return make_backend(request.param)


@pytest.fixture(params=[*GL_BACKENDS])
def gl_renderer(request: pytest.FixtureRequest, make_backend: Callable[[str], Backend]) -> Any:
    """Every OpenGL renderer in turn, for what only they have."""
    return make_backend(request.param).gl
