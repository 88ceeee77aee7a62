"""OpenGL contexts without a window, and what a context can do."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from glob import glob
from typing import Any

import moderngl

from splatview.scene import InputError

SOFTWARE_RENDERERS = (
    "llvmpipe",
    "softpipe",
    "swrast",
    "swiftshader",
    "software",
    "gdi generic",
    "microsoft basic render",
)
"""Parts of GL_RENDERER, lower case, that tell a rasteriser on the CPU."""

GL_VERSIONS = (450, 430, 410, 330)
"""Version codes that are asked for, with and without a window, the newest first."""

MOST_DEVICES = 16
"""EGL devices that are tried."""

COMPUTE_STORAGE_BLOCKS, VERTEX_STORAGE_BLOCKS = 8, 5
"""Most storage blocks of a compute and of a vertex shader of ours. OpenGL 4.3 promises 8 and none."""

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
    """Compute shaders, and as many storage blocks as ours have: the `quads` renderer's fast path."""
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
        has_compute=has_compute(ctx),
        is_software=any(word in renderer.lower() for word in SOFTWARE_RENDERERS),
    )


def has_compute(ctx: moderngl.Context) -> bool:
    """Whether the compute shaders of `quads` and `tiles` link here: OpenGL 4.3 alone does not say so."""
    return missing_compute(ctx) is None


def create_headless_context(*, require: int = 330) -> moderngl.Context:
    """A context that needs no window or display: EGL on Linux, the system's own elsewhere.

    The newest version of `GL_VERSIONS` that the driver gives, `require` (330, 430 ...) at least: drivers that
    are asked for an old one may give exactly that. Of several EGL devices the first that is no software
    rasteriser, unless the environment's GLCONTEXT_DEVICE_INDEX names one.

    Raises:
        InputError: no driver, or one that is too old; says what to install.
    """
    asked = [code for code in GL_VERSIONS if code >= require] or [require]
    if not sys.platform.startswith("linux"):
        made, problems = _newest(asked)
    elif "GLCONTEXT_DEVICE_INDEX" in os.environ:
        made, problems = _newest(asked, backend="egl")
    else:
        made, problems = _best_device(asked)
    if made is None:
        # The first says why there is nothing, the others that there is no more than that.
        raise InputError(
            f"no OpenGL {require // 100}.{require // 10 % 10} without a window here ({problems[0]}); "
            + (unused_gpu() or HOW_TO_GET_GL)
        )
    return made


def _newest(versions: Sequence[int], **options: Any) -> tuple[moderngl.Context | None, list[str]]:
    """A context of the first of `versions` that the driver gives; without one, why, the last try's first."""
    problems: list[str] = []
    for version in versions:
        try:
            return moderngl.create_context(standalone=True, require=version, **options), []
        except Exception as error:  # glcontext raises bare Exception, OSError or ImportError by platform
            problems.insert(0, " ".join(str(error).split()) or type(error).__name__)
    return None, problems


def _best_device(versions: Sequence[int]) -> tuple[moderngl.Context | None, list[str]]:
    """As `_newest` on the first EGL device with a GPU, or else on the first that works: that of index 0 may
    be a card that this process may not use, or software beside a GPU."""
    software: moderngl.Context | None = None
    problems: list[str] = []
    for index in range(MOST_DEVICES):
        made, why = _newest(versions, backend="egl", device_index=index)
        problems += why
        if made is not None:
            if not describe(made).is_software:
                if software is not None:
                    software.release()
                return made, []
            if software is None:
                software = made
            else:
                made.release()
        elif any("requested device index" in reason for reason in why):
            break
    if software is not None:
        software.__enter__()  # the latest context made is the current one
    return software, problems


def discard(ctx: moderngl.Context) -> None:
    """Releases a context of `create_headless_context`, the current one, and leaves none current: GLX refuses
    windows theirs in a thread that has one of EGL's."""
    ctx.release()
    if sys.platform.startswith("linux"):
        with suppress(OSError):
            ctypes.CDLL("libEGL.so.1").eglReleaseThread()


def unused_gpu() -> str | None:
    """What to do where Linux has a GPU that OpenGL cannot reach, as in containers by default; None elsewhere.
    To be asked where OpenGL is absent, or software."""
    if os.path.exists("/dev/nvidiactl"):
        try:
            ctypes.CDLL("libEGL_nvidia.so.0")
        except OSError:
            return (
                "an NVIDIA GPU is here without its OpenGL driver (libEGL_nvidia.so.0): in a container set "
                "NVIDIA_DRIVER_CAPABILITIES=all (or graphics), else install libnvidia-gl"
            )
    nodes = sorted(glob("/dev/dri/renderD*"))
    if nodes and not any(os.access(node, os.R_OK | os.W_OK) for node in nodes):
        return f"this user may not use the GPU at {nodes[0]}: usermod -aG render USER, then log in anew"
    return None


def missing_compute(ctx: moderngl.Context) -> str | None:
    """What the compute shaders of `quads` and `tiles` lack here; None if nothing."""
    if not ctx.version_code >= 430:
        return f"OpenGL is {ctx.version_code // 100}.{ctx.version_code // 10 % 10}, 4.3 is needed"
    for stage, needed in (("COMPUTE", COMPUTE_STORAGE_BLOCKS), ("VERTEX", VERTEX_STORAGE_BLOCKS)):
        found = ctx.info.get(f"GL_MAX_{stage}_SHADER_STORAGE_BLOCKS", 0)
        if not found >= needed:
            return f"a {stage.lower()} shader has {found} storage blocks, {needed} are needed"
    return None


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
