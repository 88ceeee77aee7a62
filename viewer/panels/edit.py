"""The Edit page: one section for each kind of change, of which one at a time is open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from imgui_bundle import ImVec4, imgui

from splatview.edit.operations.appearance import ColourGrade, Grade, Opacity, Size
from splatview.edit.operations.transform import Orient
from splatview.viewer import theme
from splatview.viewer.camera import bounds
from splatview.viewer.editing import cleanup, commands, transform
from splatview.viewer.editing.edit_session import LOOK, TRANSFORM, EditSession
from splatview.viewer.editing.session import (
    at_rest,
    can_edit,
    post_edit,
    session_of,
)
from splatview.viewer.editing.tool_state import TRANSFORMING, LookForm, MoveForm, Place, ToolName
from splatview.viewer.panels import clean, crops, recipe, select, widgets
from splatview.viewer.training.live import LiveTraining

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


def choose_scope(session: EditSession) -> bool:
    """Selection or whole scene; returns whether it changed."""
    selected = session.document.counts.selected
    chosen = widgets.combo(
        "Applies to",
        session.scope,
        ("selection", "scene") if selected else ("scene",),
        "What is changed: the selected splats, or all that are neither deleted nor locked.",
        ("Selection", "Whole scene") if selected else ("Whole scene",),
    )
    if chosen is None or chosen == session.scope:
        return False
    session.forms.scope = chosen
    return True


def keep_or_cancel(app: AppState, session: EditSession, section: str) -> bool | None:
    """The buttons, while this section's preview is in force; True where it was kept, False where not."""
    if session.forms.previewing != section:
        return None
    kept = imgui.button(f"Apply##{section}")
    widgets.tooltip("Keep the change as a step of the history.")
    imgui.same_line()
    cancelled = imgui.button(f"Cancel##{section}")
    widgets.tooltip("Take the preview back.")
    if kept:
        post_edit(app, EditSession.commit_preview)
        return True
    if cancelled:
        post_edit(app, EditSession.cancel_preview)
        return False
    return None


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


def show_appearance(app: AppState, session: EditSession) -> None:
    changed_scope = choose_scope(session)
    opacity_and_size(app, session)
    form = session.forms.look
    grade = form.grade
    for field, (name, low, high, tip) in GRADES.items():
        value = widgets.slider(name, getattr(grade, field), low, high, tip)
        if value is not None:
            grade = _changed(grade, field, value)
    if grade != form.grade or (changed_scope and session.forms.previewing == LOOK and grade != Grade()):
        session.forms.look = LookForm(grade=grade)
        session.preview(LOOK, ColourGrade(grade=grade, scope=session.scope))
    if keep_or_cancel(app, session, LOOK) is not None or (
        session.forms.previewing != LOOK
        and session.forms.look != LookForm()
        and not imgui.is_any_item_active()
    ):
        session.forms.look = LookForm()


def opacity_and_size(app: AppState, session: EditSession) -> None:
    """By a factor, or the same value for all."""
    how = widgets.combo(
        "Opacity, size",
        session.forms.how,
        ("scale", "set"),
        "Multiplies what each splat has, or gives all of them one value.",
        ("times a factor", "set to a value"),
    )
    if how is not None:
        session.forms.how = how
        post_edit(app, EditSession.cancel_preview)
    form, factor = session.forms.look, session.forms.how == "scale"
    tip = "Factor on the opacity of each splat." if factor else "The opacity that all get, 0 to 1."
    name, high = ("Opacity x", 3.0) if factor else ("Opacity", 1.0)
    opacity = widgets.slider(name, form.opacity, 0.0, high, tip)
    if opacity is not None:
        session.forms.look = LookForm(opacity=opacity)
        session.preview(LOOK, Opacity(value=opacity, how=session.forms.how, scope=session.scope))
    radius = max(app.scene.radius, 1e-6)
    tip = "Factor on the size of each splat, about its centre." if factor else "Mean deviation, world units."
    name, low, high = ("Size x", 0.1, 10.0) if factor else ("Size", 1e-5 * radius, 0.1 * radius)
    size = widgets.slider(name, form.size, low, high, tip, form="%.3g", logarithmic=True)
    if size is not None:
        session.forms.look = LookForm(size=size)
        session.preview(LOOK, Size(value=size, how=session.forms.how, scope=session.scope))


def _changed(grade: Grade, field: str, value: float) -> Grade:
    """`grade` with one number changed; black and white keep a distance."""
    if field == "black":
        value = min(value, grade.white - 0.01)
    elif field == "white":
        value = max(value, grade.black + 0.01)
    return replace(grade, **{field: value})


UPS: tuple[tuple[str, Place], ...] = (
    ("+X", (1, 0, 0)),
    ("-X", (-1, 0, 0)),
    ("+Y", (0, 1, 0)),
    ("-Y", (0, -1, 0)),
    ("+Z", (0, 0, 1)),
    ("-Z", (0, 0, -1)),
)


def show_transform(app: AppState, session: EditSession) -> None:
    subjects = transform.subjects_of(session)
    chosen = widgets.combo(
        "Applies to",
        session.subject,
        [key for key, _ in subjects],
        "What is moved: the active file of the Scene page, the selected splats, or all that are neither "
        "deleted nor locked.",
        [title for _, title in subjects],
    )
    if chosen is not None:
        post_edit(app, transform.choose_subject, chosen)
    if session.subject == "file" and (file := session.active_file) and file.locked:
        widgets.note(f"{file.name} is locked: unlock it on the Scene page to move it.")
    else:
        by_numbers(app, session)
    for number, tool in enumerate(TRANSFORMING):
        if number:
            imgui.same_line()
        tool_button(app, session, tool, tool.capitalize())
    widgets.section("Upright")
    upright(app, session)


def by_numbers(app: AppState, session: EditSession) -> None:
    form = session.forms.move
    speed = max(app.scene.radius, 1e-6) / 300
    changed = False
    moved = widgets.vector("Position", form.translation, speed, "Shift along x, y, z in world units.")
    if moved is not None:
        form.translation, changed = moved, True
    tip = "Degrees about x, y, z through the middle; colours that depend on the view turn too."
    turned = widgets.vector("Rotation", form.rotation, 0.25, tip, form="%.2f")
    if turned is not None:
        form.rotation, changed = turned, True
    scale = widgets.slider(
        "Scale", form.scale, 0.05, 20.0, "Factor about the middle.", form="%.3f", logarithmic=True
    )
    if scale is not None:
        form.scale, changed = scale, True
    if changed:
        transform.preview(session)
    if keep_or_cancel(app, session, TRANSFORM) is not None:
        session.forms.move = MoveForm()


def tool_button(app: AppState, session: EditSession, tool: ToolName, name: str) -> None:
    """A button that takes a tool, bright while it is in hand."""
    chosen = session.tool == tool
    if chosen:
        imgui.push_style_color(imgui.Col_.button, ImVec4(*theme.ACCENT, 0.75))
    widgets.command_button(app, name, f"tool_{tool}")
    if chosen:
        imgui.pop_style_color()


def upright(app: AppState, session: EditSession) -> None:
    """The whole scene turned so that it stands: by an axis, by the view, or by three points on the ground."""
    widgets.note("What points up in the scene now?")
    for number, (name, axis) in enumerate(UPS):
        if number:
            widgets.beside(name)
        tip = f"Turns the scene: its {name} becomes up (-Y)."
        widgets.button(f"{name}##up", tip, partial(app.post, orient, axis))
    if imgui.button("The view's up"):
        up = -app.view.R_camera_world[1]
        app.post(orient, (float(up[0]), float(up[1]), float(up[2])))
    widgets.tooltip("Turns the scene so that what is up in the picture now is up (-Y).")
    chosen = session.tool == "ground"
    text = f"Pick {3 - len(session.picked)} more..." if chosen else "Three points on the ground"
    widgets.beside(text)
    if imgui.button(f"{text}###ground"):
        app.post(commands.take_tool, "ground")
    widgets.tooltip("Click three points of the floor: it becomes level, at y = 0.")


def orient(app: AppState, up: Place) -> None:
    """Turns what is shown about its middle until `up` points up."""
    found = bounds(app)
    session = session_of(app)
    if session is not None and found is not None:
        x, y, z = found[0].tolist()
        session.apply(Orient(up=up, pivot=(x, y, z)))


SECTIONS: tuple[tuple[str, Callable[[AppState, EditSession], None]], ...] = (
    ("Select", select.show),
    (cleanup.SECTION, clean.show),
    ("Crop", crops.show),
    (TRANSFORM, show_transform),
    ("Colour & opacity", show_appearance),
)
"""Title and contents."""

IN_TRAINING = (select.show, clean.show, crops.show)
"""Contents of the sections whose changes a trainer can be told of."""

RULES = "Rules of the training"


def show(app: AppState) -> None:
    session = session_of(app)
    if not can_edit(app):
        widgets.note("Open a scene to edit it.")
        return
    training = None if at_rest(app) else app.find(LiveTraining)
    if training is not None:
        recipe.show_rules(app, training)
    if session is not None:
        sections(app, session, SECTIONS if training is None else SECTIONS_IN_TRAINING)
    if training is not None and widgets.header(RULES, opened=True):
        imgui.push_id(RULES)
        recipe.in_force(app, training)
        imgui.pop_id()


def sections(
    app: AppState,
    session: EditSession,
    entries: tuple[tuple[str, Callable[[AppState, EditSession], None]], ...],
) -> None:
    """One is open at a time, so that none is far below the others."""
    forms = session.forms
    asked = forms.open_section
    if asked:
        forms.section, forms.open_section = asked, ""
    for title, contents in entries:
        is_open = forms.section == title
        imgui.set_next_item_open(is_open)
        shown = widgets.header(title)
        if shown != is_open:
            forms.section = title if shown else ""
        if asked == title:
            imgui.set_scroll_here_y(0.0)
        if shown and forms.section == title:
            forms.drawn.add(title)
            imgui.push_id(title)
            contents(app, session)
            imgui.pop_id()


SECTIONS_IN_TRAINING = tuple(entry for entry in SECTIONS if entry[1] in IN_TRAINING)
