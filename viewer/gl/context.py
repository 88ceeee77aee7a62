"""OpenGL contexts without a window, and what a context can do."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import moderngl

from ...scene import InputError

SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software", "gdi generic")
"""Parts of GL_RENDERER, lower case, that tell a rasteriser on the CPU."""

HOW_TO_GET_GL = "on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri"


@dataclass(frozen=True, kw_only=True)
class GLInfo:
    """What a context says of itself."""

    vendor: str
    renderer: str
    version: str
    version_code: int
    """430 for OpenGL 4.3."""
    has_compute: bool
    """Compute shaders and shader storage: the `quads` renderer's fast path."""
    is_software: bool
    """The "GPU" is this machine's processor: the `cpu` renderer is faster."""


def describe(ctx: moderngl.Context) -> GLInfo:
    """Reads vendor, version and abilities from `ctx`."""
    renderer = ctx.info["GL_RENDERER"]
    return GLInfo(
        vendor=ctx.info["GL_VENDOR"],
        renderer=renderer,
        version=ctx.info["GL_VERSION"],
        version_code=ctx.version_code,
        has_compute=ctx.version_code >= 430,
        is_software=any(word in renderer.lower() for word in SOFTWARE_RENDERERS),
    )


def create_headless_context(*, require: int | None = None) -> moderngl.Context:
    """A context that needs no window or display: EGL on Linux, the system's own elsewhere.

    `require` is the least version code accepted (430); None takes 330.

    Raises:
        InputError: no driver, or one that is too old; says what to install.
    """
    least = require or 330
    try:
        if sys.platform.startswith("linux"):
            # moderngl's stub types its keyword arguments wrongly.
            return moderngl.create_context(standalone=True, require=least, backend="egl")  # pyright: ignore
        return moderngl.create_context(standalone=True, require=least)
    except Exception as error:  # glcontext raises bare Exception, OSError or ImportError by platform
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"no OpenGL {least // 100}.{least // 10 % 10} without a window here ({reason}); {HOW_TO_GET_GL}"
        ) from error
