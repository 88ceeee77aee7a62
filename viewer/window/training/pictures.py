"""The pictures of a comparison as textures."""

from __future__ import annotations

import moderngl
import numpy as np

from .comparison import Comparison


class Pictures:
    """The textures of the latest comparison. Only the GL thread may use them."""

    def __init__(self) -> None:
        self._shown: Comparison | None = None
        self._textures: list[moderngl.Texture] = []

    def of(self, comparison: Comparison) -> list[moderngl.Texture]:
        """Three textures that hold it."""
        if comparison is not self._shown:
            self.release()
            ctx = moderngl.get_context()
            for picture in (comparison.photo, comparison.render, comparison.difference):
                height, width = picture.shape[:2]
                data = np.ascontiguousarray(picture)
                self._textures.append(ctx.texture((width, height), 3, data, alignment=1))
            self._shown = comparison
        return self._textures

    def release(self) -> None:
        for texture in self._textures:
            texture.release()
        self._textures, self._shown = [], None
