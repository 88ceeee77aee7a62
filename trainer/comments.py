"""What a trained scene's file says of how it was trained, so that viewers show it so."""

from __future__ import annotations

from ..scene import ImageModel
from ..scene.image_model import BLUR


def comments_for(model: ImageModel) -> tuple[str, ...]:
    """The tags that `scene.effects.antialiasing` and other viewers understand; none for the usual model."""
    if not model.antialiased:
        return ()
    return ("antialiased 1",) if model.blur == BLUR else ("SplatRenderMode: mip",)
