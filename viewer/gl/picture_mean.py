"""The mean of pictures as they come, in one texture."""

from __future__ import annotations

import moderngl

from .programs import load_render_program
from .targets import ColourTarget
from .view_uniforms import set_uniforms


class PictureMean:
    """Of RGB, in float32; alpha has no meaning. The mean m of n pictures becomes m + (picture - m)/(n + 1),
    by blending, so that it can be shown at any time."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._program = load_render_program(ctx, "quads/fullscreen.vert.glsl", "quads/mean.frag.glsl")
        self._array = ctx.vertex_array(self._program, [])
        self._target: ColourTarget | None = None
        self.count = 0
        """Pictures so far."""

    def start(self) -> None:
        """The next picture is the first."""
        self.count = 0

    def add(self, picture: moderngl.Texture) -> None:
        """The first one decides the size; others must have it too."""
        if self._target is None or self._target.size != picture.size:
            if self._target is not None:
                self._target.release()
            self._target = ColourTarget(self._ctx, picture.size, "float32")
            self.count = 0
        self.count += 1
        previous = self._ctx.detect_framebuffer()
        self._target.framebuffer.use()
        self._ctx.enable_only(moderngl.BLEND)
        self._ctx.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        picture.use(0)
        set_uniforms(self._program, {"u_picture": 0, "u_share": 1 / self.count})
        self._array.render(moderngl.TRIANGLES, vertices=3)
        self._ctx.enable_only(moderngl.NOTHING)
        previous.use()

    @property
    def texture(self) -> moderngl.Texture | None:
        """The mean, row 0 on top; None before the first."""
        return self._target.texture if self._target is not None and self.count else None

    def release(self) -> None:
        if self._target is not None:
            self._target.release()
            self._target = None
        self._array.release()
        self._program.release()
