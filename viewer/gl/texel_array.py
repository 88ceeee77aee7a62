"""Linear arrays in textures: what shaders read by index without storage buffers."""

from __future__ import annotations

import moderngl
import numpy as np

from ...scene import InputError
from .memory import COMPONENT_BYTES, check_room, no_room

TEXTURE_WIDTH = 2048
"""Texels a row: every driver of the last fifteen years has wider textures, and 16384 rows hold 33 million."""


def rows_for(ctx: moderngl.Context, texels: int, what: str) -> int:
    """Rows of TEXTURE_WIDTH that hold `texels`; `what` they are is said in the error.

    Raises:
        InputError: more than this driver's textures have.
    """
    rows, limit = -(-max(texels, 1) // TEXTURE_WIDTH), int(ctx.info["GL_MAX_TEXTURE_SIZE"])
    if not rows <= limit:
        raise InputError(
            f"{what} do not fit into this OpenGL driver's textures"
            f" ({limit * TEXTURE_WIDTH:,} do): use --renderer cpu or fewer splats"
        )
    return rows


class TexelArray:
    """Element i is texel (i % TEXTURE_WIDTH, i // TEXTURE_WIDTH); see ``common/texels.glsl``."""

    def __init__(self, ctx: moderngl.Context, components: int, dtype: str, what: str) -> None:
        self._ctx = ctx
        self._components = components
        self._dtype = dtype
        self._what = what
        self._rows = 0
        self._texture: moderngl.Texture | None = None

    @property
    def texture(self) -> moderngl.Texture:
        """Exists after `reserve`."""
        if self._texture is None:
            raise RuntimeError("reserve() comes first")
        return self._texture

    def reserve(self, texels: int) -> None:
        """Makes room for at least so many; where there was less before, the contents are lost.

        Raises:
            InputError: they are more than this driver's textures have, or than there is memory for.
        """
        rows = rows_for(self._ctx, texels, f"{texels:,} {self._what}")
        if rows <= self._rows:
            return
        self.release()
        size = TEXTURE_WIDTH * rows * self._components * COMPONENT_BYTES[self._dtype]
        what = f"{texels:,} {self._what}"
        try:
            self._texture = self._ctx.texture((TEXTURE_WIDTH, rows), self._components, dtype=self._dtype)
            check_room(self._ctx, what, size)
        except moderngl.Error as error:
            raise no_room(what, size) from error
        except InputError:
            self.release()
            raise
        self._rows = rows

    def write(self, values: np.ndarray, first: int = 0) -> None:
        """Writes `values`, (n,) or (n, components) of the texture's dtype, to elements from `first` on."""
        values = np.ascontiguousarray(values)
        at, end = first, first + len(values)
        while at < end:
            row, column = divmod(at, TEXTURE_WIDTH)
            rows = (end - at) // TEXTURE_WIDTH if column == 0 else 0
            # Whole rows at once, and what is left of a row before and after them.
            width = TEXTURE_WIDTH if rows else min(TEXTURE_WIDTH - column, end - at)
            size = width * max(rows, 1)
            part = values[at - first : at - first + size]
            self.texture.write(part, viewport=(column, row, width, max(rows, 1)))
            at += size

    def release(self) -> None:
        if self._texture is not None:
            self._texture.release()
        self._texture, self._rows = None, 0
