"""GL contexts for tests; a test that leaves a GL error behind fails."""

from __future__ import annotations

import os
from collections.abc import Iterator

import moderngl
import pytest

from splatview.renderers.gl.context import create_headless_context
from splatview.scene import InputError

GL_VERSION = int(os.environ.get("SPLATVIEW_TEST_GL", "430"))
"""Oldest version to ask for. Mesa reads its version override once a process, so tests that want an old
OpenGL run themselves again in another process with this set (see test_quads_legacy)."""


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
