"""GL contexts for tests, where a GL error left behind fails its test; and every renderer behind one face."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
import pytest

from splatview.raster import Workspace, draw_frame, nonzero_bands, parameters_of
from splatview.renderers import VisualMode
from splatview.renderers.gl.context import create_headless_context
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.types import Highlight
from splatview.scene import Camera, Gaussians, InputError, RenderSettings, reference
from splatview.scene.edits import SceneEdits
from splatview.scene.projection import project

GL_VERSION = int(os.environ.get("SPLATVIEW_TEST_GL", "430"))
"""Oldest version to ask for. Mesa reads its version override once a process, so tests that want an old
OpenGL run themselves again in another process with this set (see gl/test_quads_gl33)."""

GL_RENDERERS = {"quads": QuadsRenderer, "quads_gl33": QuadsGL33Renderer, "tiles": TilesRenderer}


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


Draw = Callable[
    [Gaussians, Camera, RenderSettings, VisualMode, SceneEdits | None, Highlight | None], np.ndarray
]


@dataclass(frozen=True, kw_only=True)
class Backend:
    """One way to draw a scene, by the name that people choose it by."""

    name: str
    bound: float
    """Largest error of a channel in float32, where neither a cut nor a tie of depths decides."""
    most: float
    """The same where they do."""
    _draw: Draw
    visible: Callable[[], int]
    """Splats that reached the last picture."""
    gl: Any = None
    """The OpenGL renderer, if it is one."""

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
        return self._draw(gaussians, camera, settings, mode, edits, highlight)

    def __str__(self) -> str:
        return self.name


def gl_backend(name: str, ctx: moderngl.Context) -> Backend:
    if name != "quads_gl33" and ctx.version_code < 430:
        pytest.skip("needs OpenGL 4.3")
    renderer = GL_RENDERERS[name](ctx)

    def draw(gaussians, camera, settings, mode, edits, highlight) -> np.ndarray:
        return renderer.render(gaussians, camera, settings, mode=mode, edits=edits, highlight=highlight)

    def visible() -> int:
        return renderer.finished_stats().visible

    most = 4 / 255 if name == "quads" else 0.5 / 255
    return Backend(name=name, bound=0.5 / 255, most=most, _draw=draw, visible=visible, gl=renderer)


def cpu_backend() -> Backend:
    workspace, visible = Workspace(), [0]

    def draw(gaussians, camera, settings, mode, edits, highlight) -> np.ndarray:
        nonzero = nonzero_bands(gaussians)
        frame = draw_frame(
            parameters_of(gaussians), camera, settings, workspace, edits=edits, nonzero=nonzero
        )
        visible[0] = sum(stop - start for start, stop in frame.runs)
        return frame.image

    return Backend(name="cpu", bound=1e-4, most=4 / 255, _draw=draw, visible=lambda: visible[0])


def reference_backend() -> Backend:
    visible = [0]

    def draw(gaussians, camera, settings, mode, edits, highlight) -> np.ndarray:
        visible[0] = len(project(gaussians, camera, settings).indices)
        return reference.render(gaussians, camera, settings).astype(np.float32)

    return Backend(name="reference", bound=1e-6, most=1e-6, _draw=draw, visible=lambda: visible[0])


@pytest.fixture
def make_backend(request: pytest.FixtureRequest) -> Iterator[Callable[[str], Backend]]:
    """`make_backend("tiles")`: a renderer that has drawn nothing yet."""
    made: list[Backend] = []

    def make(name: str) -> Backend:
        if name in GL_RENDERERS:
            made.append(gl_backend(name, request.getfixturevalue("ctx")))
        else:
            made.append({"cpu": cpu_backend, "reference": reference_backend}[name]())
        return made[-1]

    yield make
    for backend in made:
        if backend.gl is not None:
            backend.gl.release()


@pytest.fixture(params=[*GL_RENDERERS, "cpu", "reference"])
def backend(request: pytest.FixtureRequest, make_backend: Callable[[str], Backend]) -> Backend:
    """Every renderer in turn, or those that a test names: `@pytest.mark.parametrize("backend", ...,
    indirect=True)`."""
    return make_backend(request.param)


@pytest.fixture(params=[*GL_RENDERERS])
def gl_renderer(request: pytest.FixtureRequest, make_backend: Callable[[str], Backend]) -> Any:
    """Every OpenGL renderer in turn, for what only they have."""
    return make_backend(request.param).gl
