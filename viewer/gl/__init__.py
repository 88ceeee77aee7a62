"""Drawing splats with OpenGL. Only the thread that owns the context may touch anything here."""

from __future__ import annotations

from typing import TYPE_CHECKING

import moderngl

from .frame import FrameStats, VisualMode

if TYPE_CHECKING:
    from .renderer import Renderer

__all__ = ["FrameStats", "VisualMode", "make_renderer"]


def make_renderer(ctx: moderngl.Context) -> Renderer:
    """The `quads` renderer for `ctx`: in compute shaders from GL 4.3 on, else its GL 3.3 twin.

    Raises:
        InputError: the context is older than GL 3.3.
    """
    # Imported late: both import this package, and only one of them is needed.
    if ctx.version_code >= 430:
        from .quads import QuadsRenderer

        return QuadsRenderer(ctx)
    from .quads_legacy import LegacyQuadsRenderer

    return LegacyQuadsRenderer(ctx)
