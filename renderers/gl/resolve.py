"""From the accumulation target to the picture: background, or a mode's colour map."""

from __future__ import annotations

import moderngl
import numpy as np

from splatview.renderers.gl.programs import Variants, load_render_program
from splatview.renderers.gl.targets import ColourTarget
from splatview.renderers.gl.uniforms import Uniform, set_uniforms
from splatview.renderers.modes import VisualMode, mode_flags
from splatview.scene import Camera, InputError
from splatview.scene.background import Background, Gradient, Panorama, axes_of, background_colours, pixel_rays

UNIT = 2
"""The texture unit of `u_behind`."""


class BackgroundSource:
    """Keeps the texture of the latest picture; one colour or a gradient has none."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._texture: moderngl.Texture | None = None
        self._shown: object = None

    def use(self, background: Background, camera: Camera) -> tuple[dict[str, bool], dict[str, Uniform]]:
        """Flags and uniforms of ``common/background.glsl`` for what `camera` sees; binds the texture.

        Raises:
            InputError: a panorama is larger than textures can be here.
        """
        flags = {"GRADIENT": False, "PANORAMA": False, "BEHIND": False}
        if isinstance(background, tuple):
            self.release()
            return flags, {"u_background": background}
        rays = pixel_rays(camera)
        if rays is None:
            self._show_picture(background, camera)
            return flags | {"BEHIND": True}, {"u_behind": UNIT}
        # moderngl takes matrices column by column.
        values: dict[str, Uniform] = {"u_background_rays": tuple((axes_of(background) @ rays).T.ravel())}
        if isinstance(background, Gradient):
            self.release()
            values |= {"u_background": background.bottom, "u_top": background.top}
            return flags | {"GRADIENT": True}, values
        self._show_panorama(background)
        return flags | {"PANORAMA": True}, values | {"u_behind": UNIT}

    def _show_panorama(self, panorama: Panorama) -> None:
        if self._shown is not panorama.pixels:
            height, width = panorama.pixels.shape[:2]
            largest = int(self._ctx.info["GL_MAX_TEXTURE_SIZE"])
            if not max(width, height) <= largest:
                raise InputError(
                    f"{panorama.name}: is {width}x{height} pixels, and OpenGL holds {largest} a side here; "
                    "use a smaller picture"
                )
            self._replace(self._ctx.texture((width, height), 3, panorama.pixels.tobytes(), alignment=1))
            self._shown = panorama.pixels  # by another up axis it is the same texture
        self._bind()

    def _show_picture(self, background: Background, camera: Camera) -> None:
        kept = self._shown
        if not (isinstance(kept, tuple) and kept[0] is background and camera.same_view(kept[1])):
            data = np.ascontiguousarray(background_colours(background, camera, np.float32)).tobytes()
            self._replace(self._ctx.texture((camera.width, camera.height), 3, data, dtype="f4"))
            self._shown = background, camera
        self._bind()

    def _replace(self, texture: moderngl.Texture) -> None:
        self.release()
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._texture = texture

    def _bind(self) -> None:
        if self._texture is not None:
            self._texture.use(UNIT)

    def release(self) -> None:
        """Gives the texture back."""
        if self._texture is not None:
            self._texture.release()
        self._texture, self._shown = None, None


class Resolving:
    """A pass over the whole picture; cheap, so a new background costs only this."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx = ctx
        self._variants = variants
        self._background = BackgroundSource(ctx)

    def draw(
        self,
        mode: VisualMode,
        accumulation: ColourTarget,
        shown: ColourTarget,
        *,
        background: Background,
        camera: Camera,
        depths: tuple[float, float],
        weighted: bool = False,
    ) -> None:
        """Fills `shown`. `camera` sees the background; `depths` are those of the colour map's ends, for the
        mode that has one; `weighted`: the target holds sums, over those in `accumulation.weights`.

        Raises:
            InputError: the background does not fit into this driver's textures.
        """
        weights = accumulation.weights if weighted else None
        background_flags, background_values = self._background.use(background, camera)
        flags = {**background_flags, **mode_flags(mode, resolved=True), "WEIGHTED": weights is not None}
        program, array = self._variants.drawing(
            "quads/fullscreen.vert.glsl", "quads/resolve.frag.glsl", flags
        )
        shown.framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        accumulation.texture.use(0)
        if weights is not None:
            weights.use(1)
        else:
            accumulation.texture.use(1)  # a general program has the sampler all the same
        values = {
            "u_accumulation": 0,
            "u_weights": 1,
            **background_values,
            "u_brightest": shown.brightest,
            "u_depth_range": depths,
        }
        set_uniforms(program, values)
        array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        self._background.release()


def float16_blending_truncates(ctx: moderngl.Context) -> bool:
    """Whether this driver cuts blended float16 values off instead of rounding them to the nearest.

    Mesa's llvmpipe does (at least to 22.3), and a picture of 80 layers then has 44 dB where rounding gives
    62 (see `blend`). It also blends float32 a tenth faster than float16.
    """
    target = ColourTarget(ctx, (1, 1), "float16")
    program = load_render_program(ctx, "quads/fullscreen.vert.glsl", "quads/constant.frag.glsl")
    array = ctx.vertex_array(program, [])
    previous = ctx.detect_framebuffer()
    target.framebuffer.use()
    target.framebuffer.clear(0.5, 0.5, 0.5, 0.5)
    ctx.enable_only(moderngl.BLEND)
    ctx.blend_func = moderngl.ONE, moderngl.ONE
    # Three quarters of the step between 0.5 and float16's next number.
    set_uniforms(program, {"u_colour": (0.75 * 2.0**-11,) * 4})
    array.render(moderngl.TRIANGLES, vertices=3)
    ctx.enable_only(moderngl.NOTHING)
    value = float(target.read()[0, 0, 0])
    previous.use()
    array.release()
    program.release()
    target.release()
    return not value > np.float32(0.5)


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
