"""GL contexts for tests; a test that leaves a GL error behind fails."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import pytest

from splatview.scene import InputError
from splatview.viewer.gl.context import create_headless_context


@pytest.fixture(scope="session")
def session_context() -> moderngl.Context:
    """One headless GL 4.3 context for the whole run; use `ctx` in tests."""
    try:
        return create_headless_context(require=430)
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture
def ctx(session_context: moderngl.Context) -> Iterator[moderngl.Context]:
    """The headless context, clean before the test and checked after it."""
    assert session_context.error == "GL_NO_ERROR", "an earlier test left a GL error"
    yield session_context
    session_context.finish()
    assert session_context.error == "GL_NO_ERROR"
