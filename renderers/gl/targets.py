"""The textures that a picture is accumulated in and shown from."""

from __future__ import annotations

import moderngl
import numpy as np

from splatview.renderers.gl.context import check_room, no_room
from splatview.renderers.modes import MODES, VisualMode
from splatview.renderers.request import Precision

DTYPES: dict[str, str] = {"float16": "f2", "float32": "f4", "unorm8": "f1"}
"""moderngl's names."""

BRIGHTEST: dict[str, float] = {
    "float16": 65504.0,
    "float32": float(np.finfo(np.float32).max),
    "unorm8": 65504.0,
}
"""Colours beyond this become infinite in a target; what 8 bits are given is clamped to 1 after alpha."""


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
        self.weights: moderngl.Texture | None = None
        """Sums of weights in r, where `with_weights` was called."""
        self._weighted: moderngl.Framebuffer | None = None

    @property
    def brightest(self) -> float:
        """The largest colour that it holds."""
        return BRIGHTEST[self.precision]

    def with_depth(self) -> moderngl.Framebuffer:
        """The same texture with a depth buffer, made when first asked for."""
        if self._deep is None:
            self._depth = self._ctx.depth_renderbuffer(self.size)
            self._deep = self._ctx.framebuffer([self.texture], self._depth)
        return self._deep

    def with_weights(self) -> moderngl.Framebuffer:
        """The same texture and a second one for sums of weights, made when first asked for."""
        if self._weighted is None:
            self.weights = self._ctx.texture(self.size, 4, dtype="f4")
            self.weights.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._weighted = self._ctx.framebuffer([self.texture, self.weights])
        return self._weighted

    def read(self) -> np.ndarray:
        """(H, W, 4) float32, row 0 on top; waits for the GPU."""
        width, height = self.size
        data = self.framebuffer.read(components=4, dtype="f4")
        return np.frombuffer(data, dtype=np.float32).reshape(height, width, 4)

    def release(self) -> None:
        for thing in (self._deep, self._depth, self._weighted, self.weights):
            if thing is not None:
                thing.release()
        self.framebuffer.release()
        self.texture.release()


class PictureTargets:
    """The accumulation target of a picture and the texture that it is shown from; made anew on a new size."""

    def __init__(self, ctx: moderngl.Context, *, truncates: bool) -> None:
        self._ctx = ctx
        self.truncates = truncates
        """The driver cuts float16 off when it blends, so float32 gathers."""
        self._accumulation: ColourTarget | None = None
        self._shown: ColourTarget | None = None

    def fit(self, size: tuple[int, int], blend: Precision, mode: VisualMode, *, sums: bool = False) -> None:
        """Makes both ready for a picture of `size` (width, height) px, of weighted `sums` or blended.

        Raises:
            InputError: there is not enough graphics memory.
        """
        # Sums of depths and counts of splats need float32's digits, and so does a driver that truncates.
        wide = sums or MODES[mode].sums or (blend == "float16" and self.truncates)
        # Should there be no room, the next picture tries again.
        accumulation, self._accumulation = self._accumulation, None
        self._accumulation = self._fitting(accumulation, size, "float32" if wide else blend)
        shown, self._shown = self._shown, None
        self._shown = self._fitting(shown, size, blend)

    def _fitting(
        self, target: ColourTarget | None, size: tuple[int, int], precision: Precision
    ) -> ColourTarget:
        if target is not None:
            if (target.size, target.precision) == (size, precision):
                return target
            target.release()
        width, height = size
        try:
            made = ColourTarget(self._ctx, size, precision)
        except moderngl.Error as error:
            raise no_room(f"{width}x{height} px", 16 * width * height) from error
        check_room(self._ctx, f"{width}x{height} px", 16 * width * height)
        return made

    @property
    def accumulation(self) -> ColourTarget:
        return _existing(self._accumulation)

    @property
    def shown(self) -> ColourTarget:
        return _existing(self._shown)

    def release(self) -> None:
        for target in (self._accumulation, self._shown):
            if target is not None:
                target.release()
        self._accumulation = self._shown = None


def _existing(target: ColourTarget | None) -> ColourTarget:
    if target is None:
        raise RuntimeError("draw() comes first")
    return target
