"""From what was gathered to the picture: background, or a mode's colour map."""

from __future__ import annotations

import moderngl
import numpy as np

from ...scene import Camera
from ...scene.background import Background
from .background import BackgroundSource
from .frame import VisualMode
from .placement import Placement
from .programs import load_render_program
from .targets import ColourTarget
from .variants import Variants
from .view_uniforms import set_uniforms

DEPTH_SPAN = 1.6
"""Depth colours span so many scene radii (half the splats lie within one) on either side of the median."""


def depth_range(placement: Placement, camera: Camera) -> tuple[float, float]:
    """Depths, world units, of the colour map's ends: from the scene's extent, so that they never jump."""
    middle = float(camera.forward @ (placement.median - camera.eye))
    nearest = max(middle - DEPTH_SPAN * placement.radius, 0.0)
    return nearest, max(middle + DEPTH_SPAN * placement.radius, nearest + placement.radius)


class Resolving:
    """A pass over the whole picture; cheap, so a new background costs only this."""

    def __init__(self, ctx: moderngl.Context, variants: Variants) -> None:
        self._ctx = ctx
        self._variants = variants
        self._background = BackgroundSource(ctx)

    def draw(
        self,
        mode: VisualMode,
        gathered: ColourTarget,
        shown: ColourTarget,
        *,
        background: Background,
        camera: Camera,
        depths: tuple[float, float] | None = None,
        weighted: bool = False,
    ) -> None:
        """Fills `shown`. `camera` sees the background; `depths` are those of the colour map's ends, for the
        mode that has one; `weighted`: what was gathered are sums, over those in `gathered.weights`.

        Raises:
            InputError: the background does not fit into this driver's textures.
        """
        weights = gathered.weights if weighted else None
        background_flags, background_values = self._background.use(background, camera)
        flags = {
            **background_flags,
            "DEPTH": mode == "depth",
            "OVERDRAW": mode == "overdraw",
            "WEIGHTED": weights is not None,
        }
        program, array = self._variants.drawing(
            "quads/fullscreen.vert.glsl", "quads/resolve.frag.glsl", flags
        )
        shown.framebuffer.use()
        self._ctx.enable_only(moderngl.NOTHING)
        gathered.texture.use(0)
        if weights is not None:
            weights.use(1)
        else:
            gathered.texture.use(1)  # a general program has the sampler all the same
        values = {
            "u_gathered": 0,
            "u_weights": 1,
            **background_values,
            "u_brightest": shown.brightest,
            "u_depth_range": depths or (0.0, 1.0),
        }
        set_uniforms(program, values)
        array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        self._background.release()


def float16_blending_truncates(ctx: moderngl.Context) -> bool:
    """Whether this driver cuts blended float16 values off instead of rounding them to the nearest.

    Mesa's llvmpipe does (at least to 22.3), and a picture of 80 layers then has 44 dB where rounding gives
    62 (see `gathering`). It also blends float32 a tenth faster than float16.
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
