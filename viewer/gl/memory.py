"""How much GPU memory a renderer holds, counted from the objects themselves."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

COMPONENT_BYTES = {"f1": 1, "f2": 2, "f4": 4, "u1": 1, "u2": 2, "u4": 4, "i1": 1, "i2": 2, "i4": 4}


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
        elif isinstance(thing, (list, tuple, set)):
            waiting.extend(thing)
        elif isinstance(thing, Mapping):
            waiting.extend(thing.values())
        elif type(thing).__module__.startswith(__name__.split(".")[0]):
            names = getattr(type(thing), "__slots__", None) or getattr(thing, "__dict__", {})
            waiting.extend(getattr(thing, name) for name in names if hasattr(thing, name))
    return total
