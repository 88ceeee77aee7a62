"""GPU memory: asked for so that a driver without room says so, and counted from the objects themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import moderngl

from ...scene import InputError

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
