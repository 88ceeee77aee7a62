"""Opacity, size and colours: sliders that show at once what they do."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from imgui_bundle import imgui

from .....edit.grade import Grade
from .....edit.operations.looks import ColourGrade, Opacity, Size
from ...panels import widgets
from ..desk import Desk
from ..forms import LookForm
from . import scope

if TYPE_CHECKING:
    from ...core import Core

SECTION = "look"

GRADES = {
    "brightness": ("Brightness", -0.5, 0.5, "Added to every colour."),
    "contrast": ("Contrast", 0.0, 3.0, "About mid-grey."),
    "saturation": ("Saturation", 0.0, 3.0, "0 is grey."),
    "temperature": ("Temperature", -1.0, 1.0, "Colder (blue) to warmer (red)."),
    "tint": ("Tint", -1.0, 1.0, "Greener to more magenta."),
    "black": ("Black point", -0.5, 0.9, "The level that becomes black."),
    "white": ("White point", 0.1, 1.5, "The level that becomes white."),
}
"""Field of `Grade` -> name, range of the slider, tooltip."""


def show(core: Core, desk: Desk) -> None:
    changed_scope = scope.choose_scope(desk)
    if scope.nothing_to_change(desk):
        return
    form = desk.forms.look
    opacity_and_size(core, desk)
    form = desk.forms.look
    grade = form.grade
    for field, (name, low, high, tip) in GRADES.items():
        value = widgets.slider(name, getattr(grade, field), low, high, tip)
        if value is not None:
            grade = _changed(grade, field, value)
    if grade != form.grade or (changed_scope and desk.forms.previewing == SECTION and grade != Grade()):
        desk.forms.look = LookForm(grade=grade)
        desk.preview(SECTION, ColourGrade(grade=grade, scope=desk.forms.scope))
    if scope.keep_or_cancel(core, desk, SECTION) is not None or (
        desk.forms.previewing != SECTION and desk.forms.look != LookForm() and not imgui.is_any_item_active()
    ):
        desk.forms.look = LookForm()


def opacity_and_size(core: Core, desk: Desk) -> None:
    """By a factor, or the same value for all."""
    how = widgets.combo(
        "Opacity, size",
        desk.forms.how,
        ("scale", "set"),
        "Multiply what each splat has, or give all of them one value. A set size keeps each splat's shape.",
        ("times a factor", "set to a value"),
    )
    if how is not None:
        desk.forms.how = how
        core.post(lambda core: core.desk.cancel_preview() if core.desk else None)
    form, factor = desk.forms.look, desk.forms.how == "scale"
    tip = "Factor on the opacity of each splat." if factor else "The opacity that all get, 0 to 1."
    name, high = ("Opacity x", 3.0) if factor else ("Opacity", 1.0)
    opacity = widgets.slider(name, form.opacity, 0.0, high, tip)
    if opacity is not None:
        desk.forms.look = LookForm(opacity=opacity)
        desk.preview(SECTION, Opacity(value=opacity, how=desk.forms.how, scope=desk.forms.scope))
    radius = max(core.scene.radius if core.scene else 1.0, 1e-6)
    tip = "Factor on the size of each splat, about its centre." if factor else "Mean deviation, world units."
    name, low, high = ("Size x", 0.1, 10.0) if factor else ("Size", 1e-5 * radius, 0.1 * radius)
    size = widgets.slider(name, form.size, low, high, tip, form="%.3g", logarithmic=True)
    if size is not None:
        desk.forms.look = LookForm(size=size)
        desk.preview(SECTION, Size(value=size, how=desk.forms.how, scope=desk.forms.scope))


def _changed(grade: Grade, field: str, value: float) -> Grade:
    """`grade` with one number changed; black and white keep a distance."""
    if field == "black":
        value = min(value, grade.white - 0.01)
    elif field == "white":
        value = max(value, grade.black + 0.01)
    return replace(grade, **{field: value})
