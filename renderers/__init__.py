"""Drawing splats with OpenGL. Only the thread that owns the context may touch anything here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import moderngl

from splatview.renderers.types import FrameStats, VisualMode

if TYPE_CHECKING:
    from splatview.renderers.gl.programs import Variants
    from splatview.renderers.gl.renderer import Renderer


__all__ = ["FrameStats", "VisualMode", "make_renderer"]


def make_renderer(ctx: moderngl.Context, name: str = "quads", variants: Variants | None = None) -> Renderer:
    """The renderer called `name`, "quads" or "tiles", for `ctx`; its programs come from `variants`.

    `quads` work in compute shaders from GL 4.3 on, else as their GL 3.3 twin.

    Raises:
        InputError: the context is older than GL 3.3 or, for `tiles`, GL 4.3.
    """
    # Imported late: all import this package, and only one of them is needed.
    if name == "tiles":
        from splatview.renderers.gl.tiles import TilesRenderer

        return TilesRenderer(ctx, variants=variants)
    if ctx.version_code >= 430:
        from splatview.renderers.gl.quads import QuadsRenderer

        return QuadsRenderer(ctx, variants=variants)
    from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer

    return QuadsGL33Renderer(ctx, variants)
