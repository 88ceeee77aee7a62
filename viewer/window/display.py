"""Whether a window can be opened here, and with which OpenGL."""

from __future__ import annotations

import os
import sys
import warnings

import imgui_bundle  # noqa: F401 - isort: skip  (sets which libglfw is used)
import glfw

from ...scene import InputError

GL_VERSIONS = ((4, 5), (4, 3), (4, 1), (3, 3))
"""Tried in this order: 4.3 brings compute shaders, 4.1 is what macOS has, 3.3 is the least we can use."""


def display_problem() -> str | None:
    """One line on why no window can be opened here, or None where one can."""
    try:
        best_gl_version()
    except InputError as error:
        return str(error)
    return None


def best_gl_version() -> tuple[int, int]:
    """The newest version of `GL_VERSIONS` that a window here gets.

    A window is tried for each, unseen, since asking for more than the driver has is fatal later.

    Raises:
        InputError: there is no display, or its OpenGL is older than 3.3.
    """
    reasons: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not glfw.init():
            raise InputError(f"no window can be opened: {no_display_reason()}")
        try:
            for major, minor in GL_VERSIONS:
                glfw.default_window_hints()
                glfw.window_hint(glfw.VISIBLE, False)
                glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, major)
                glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, minor)
                glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
                glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
                window = glfw.create_window(16, 16, "", None, None)
                if window:
                    glfw.destroy_window(window)
                    return major, minor
                reason = glfw.get_error()[1] or b"no reason given"
                reasons.append(reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason))
        finally:
            glfw.terminate()
    raise InputError(
        f"no window with OpenGL 3.3 can be opened here ({reasons[-1]}); update the graphics driver, or see"
        " what splatview doctor finds"
    )


def no_display_reason() -> str:
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return "there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set)"
    return "the display cannot be reached"
