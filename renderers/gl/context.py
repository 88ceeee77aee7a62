"""OpenGL contexts without a window, and what a context can do."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import moderngl

from splatview.scene import InputError

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


# ---- GPU memory: asked for so that a driver without room says so, and counted from the objects themselves.


COMPONENT_BYTES = {"f1": 1, "f2": 2, "f4": 4, "u1": 1, "u2": 2, "u4": 4, "i1": 1, "i2": 2, "i4": 4}


OUT_OF_MEMORY = "GL_OUT_OF_MEMORY"


def reserve(ctx: moderngl.Context, sizes: Sequence[int], what: str) -> list[moderngl.Buffer]:
    """Buffers of so many bytes, all or none; `what` needs them is said where the driver has no room.

    moderngl does not look at GL's errors: without this a buffer without memory would be drawn from.

    Raises:
        InputError: there is not so much graphics memory.
    """
    made: list[moderngl.Buffer] = []
    try:
        for size in sizes:
            made.append(ctx.buffer(reserve=size))
            check_room(ctx, what, sum(sizes))
    except (moderngl.Error, InputError) as error:
        for buffer in made:
            buffer.release()
        if isinstance(error, InputError):
            raise
        raise no_room(what, sum(sizes)) from error
    return made


def check_room(ctx: moderngl.Context, what: str, size: int) -> None:
    """To be called after something of `size` bytes was made. Raises InputError as `reserve` does."""
    if ctx.error == OUT_OF_MEMORY:
        raise no_room(what, size)


def no_room(what: str, size: int) -> InputError:
    return InputError(
        f"{what} need {max(size >> 20, 1):,} MiB of graphics memory, more than is free:"
        " use --renderer cpu or fewer splats"
    )


def held_bytes(owner: object) -> int:
    """Bytes of all buffers and textures that `owner` reaches through its attributes, each counted once.

    What drivers add (alignment, mip levels, shadow copies) is not in it.
    """
    seen: set[int] = set()
    waiting, total = [owner], 0
    while waiting:
        thing = waiting.pop()
        if id(thing) in seen or isinstance(thing, (str, bytes, int, float, moderngl.Context, type)):
            continue
        seen.add(id(thing))
        if isinstance(thing, moderngl.Buffer):
            total += thing.size
        elif isinstance(thing, moderngl.Texture):
            width, height = thing.size
            total += width * height * thing.components * COMPONENT_BYTES[thing.dtype]
        elif isinstance(thing, moderngl.TextureArray):
            texels = thing.width * thing.height * thing.layers
            total += texels * thing.components * COMPONENT_BYTES[thing.dtype]
        elif isinstance(thing, (list, tuple, set)):
            waiting.extend(thing)
        elif isinstance(thing, Mapping):
            waiting.extend(thing.values())
        elif type(thing).__module__.startswith(__name__.split(".")[0]):
            names = getattr(type(thing), "__slots__", None) or getattr(thing, "__dict__", {})
            waiting.extend(getattr(thing, name) for name in names if hasattr(thing, name))
    return total
