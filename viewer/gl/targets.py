"""The textures that a picture is gathered in and shown from."""

from __future__ import annotations

from typing import Literal

import moderngl
import numpy as np

Precision = Literal["float16", "float32"]

DTYPES: dict[str, str] = {"float16": "f2", "float32": "f4"}
"""moderngl's names."""


class ColourTarget:
    """One RGBA texture with a framebuffer around it."""

    def __init__(self, ctx: moderngl.Context, size: tuple[int, int], precision: Precision) -> None:
        self.size = size
        self.precision = precision
        self.texture = ctx.texture(size, 4, dtype=DTYPES[precision])
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.framebuffer = ctx.framebuffer([self.texture])
        self._ctx = ctx
        self._depth: moderngl.Renderbuffer | None = None
        self._deep: moderngl.Framebuffer | None = None

    def with_depth(self) -> moderngl.Framebuffer:
        """The same texture with a depth buffer, made when first asked for."""
        if self._deep is None:
            self._depth = self._ctx.depth_renderbuffer(self.size)
            self._deep = self._ctx.framebuffer([self.texture], self._depth)
        return self._deep

    def read(self) -> np.ndarray:
        """(H, W, 4) float32, row 0 on top; waits for the GPU."""
        width, height = self.size
        data = self.framebuffer.read(components=4, dtype="f4")
        return np.frombuffer(data, dtype=np.float32).reshape(height, width, 4)

    def release(self) -> None:
        for thing in (self._deep, self._depth):
            if thing is not None:
                thing.release()
        self.framebuffer.release()
        self.texture.release()
