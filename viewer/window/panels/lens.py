"""Depth of field: how wide the lens is, and what is sharp."""

from __future__ import annotations

from imgui_bundle import imgui

from ..core import Core
from ..depth_of_field import focus_by_click, is_pinhole
from . import widgets

APERTURES = (0.001, 0.5)
"""Of the distance to the turning point."""

FOCUS_RANGE = (0.02, 50.0)
"""Likewise."""


def show(core: Core) -> None:
    lens = core.depth_of_field
    on = widgets.checkbox(
        "Depth of field",
        lens.on,
        "Blurs what is not in focus, as a lens does: pictures from all over it are averaged while the view "
        "rests. While it moves, and where this is off, it costs nothing.",
    )
    if on is not None:
        lens.on = on
    if not lens.on:
        return
    share = widgets.slider(
        "Aperture",
        lens.share,
        *APERTURES,
        "The lens's diameter over the distance to the point that the view turns about. Wider blurs more.",
        form="%.3f",
        logarithmic=True,
    )
    if share is not None:
        lens.share = share
    focus = widgets.slider(
        "Focus",
        lens.focus or core.view.distance,
        FOCUS_RANGE[0] * core.view.distance,
        FOCUS_RANGE[1] * core.view.distance,
        "The distance that is sharp, world units.",
        form="%.4g",
        logarithmic=True,
    )
    if focus is not None:
        lens.focus = focus
    widgets.button(
        "Focus by click",
        "What you click on in the picture next becomes sharp.",
        lambda: core.post(focus_by_click),
    )
    widgets.beside("On turning point")
    widgets.button(
        "On turning point",
        "Keeps sharp what the view turns about.",
        lambda: setattr(lens, "focus", None),
    )
    if lens.picking:
        widgets.note("Click what shall be sharp.")
    elif not is_pinhole(core.camera):
        widgets.note("Only pinhole cameras have one: not through a lens that distorts, nor orthographic.")
    elif lens.badge:
        widgets.note(lens.badge)
    imgui.spacing()
