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
    opacity = widgets.slider("Opacity x", form.opacity, 0.0, 3.0, "Factor on the opacity of each splat.")
    if opacity is not None:
        desk.forms.look = LookForm(opacity=opacity)
        desk.preview(SECTION, Opacity(value=opacity, scope=desk.forms.scope))
    size = widgets.slider(
        "Size x",
        form.size,
        0.1,
        10.0,
        "Factor on the size of each splat, about its centre.",
        logarithmic=True,
    )
    if size is not None:
        desk.forms.look = LookForm(size=size)
        desk.preview(SECTION, Size(value=size, scope=desk.forms.scope))
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


def _changed(grade: Grade, field: str, value: float) -> Grade:
    """`grade` with one number changed; black and white keep a distance."""
    if field == "black":
        value = min(value, grade.white - 0.01)
    elif field == "white":
        value = max(value, grade.black + 0.01)
    return replace(grade, **{field: value})
