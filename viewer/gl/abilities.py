"""What settings an OpenGL can draw by."""

from __future__ import annotations

from ...scene import RenderSettings
from ...scene.resorting import keeps_order
from ...scene.stored import Attributes

COMPUTE = 430
"""Version code from which there are compute shaders, with which splats are sorted on the GPU."""


def refusal(
    version_code: int, settings: RenderSettings | None = None, attributes: Attributes = "float32"
) -> str | None:
    """Why OpenGL of this version (430 for 4.3) cannot draw by `settings` what is stored as `attributes`; None
    where it can."""
    if version_code >= COMPUTE:
        return None
    if attributes != "float32":
        return f"attributes in {attributes} need OpenGL 4.3; use float32 or --renderer cpu"
    if settings is None:
        return None
    if settings.order != "32-bit":
        return f"{settings.order} order needs OpenGL 4.3; use 32-bit"
    if keeps_order(settings):
        return "an order that is kept for several frames needs OpenGL 4.3; use --resort 1"
    return None
