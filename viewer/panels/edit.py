"""The Edit panel: tools on top, one section for each kind of change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.edit.kernels.marks import positions_of
from splatview.edit.operations.appearance import ColourGrade, Grade, Opacity, Size
from splatview.edit.operations.transform import Orient, Transform
from splatview.scene import Camera
from splatview.scene.edits import IDENTITY, Adjustment
from splatview.scene.framing import robust_bounds
from splatview.viewer import theme
from splatview.viewer.camera import bounds
from splatview.viewer.editing import commands, gizmos
from splatview.viewer.editing.gizmos import angles_of, quat_from_matrix, quat_of
from splatview.viewer.editing.session import LOOK, EditSession, at_rest, can_edit, post_edit, session_of
from splatview.viewer.editing.tool_state import LookForm, MoveForm, Place, ToolName
from splatview.viewer.panels import clean, crops, recipe, select, widgets
from splatview.viewer.training.live import LiveTraining

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


def choose_scope(session: EditSession) -> bool:
    """Selection or whole scene; returns whether it changed."""
    chosen = widgets.combo(
        "Of",
        session.forms.scope,
        ("selection", "scene"),
        "What is changed: the selected splats, or all that are neither deleted nor locked.",
        ("The selection", "The whole scene"),
    )
    if chosen is None:
        return False
    session.forms.scope = chosen
    return True


def nothing_to_change(session: EditSession) -> bool:
    """Says so where the scope is an empty selection."""
    if session.forms.scope == "selection" and not session.document.counts.selected:
        widgets.note("Nothing is selected: select splats, or choose the whole scene above.")
        return True
    return False


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
    if nothing_to_change(session):
        return
    form = session.forms.look
    opacity_and_size(app, session)
    form = session.forms.look
    grade = form.grade
    for field, (name, low, high, tip) in GRADES.items():
        value = widgets.slider(name, getattr(grade, field), low, high, tip)
        if value is not None:
            grade = _changed(grade, field, value)
    if grade != form.grade or (changed_scope and session.forms.previewing == LOOK and grade != Grade()):
        session.forms.look = LookForm(grade=grade)
        session.preview(LOOK, ColourGrade(grade=grade, scope=session.forms.scope))
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
        "Multiply what each splat has, or give all of them one value. A set size keeps each splat's shape.",
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
        session.preview(LOOK, Opacity(value=opacity, how=session.forms.how, scope=session.forms.scope))
    radius = max(app.scene.radius, 1e-6)
    tip = "Factor on the size of each splat, about its centre." if factor else "Mean deviation, world units."
    name, low, high = ("Size x", 0.1, 10.0) if factor else ("Size", 1e-5 * radius, 0.1 * radius)
    size = widgets.slider(name, form.size, low, high, tip, form="%.3g", logarithmic=True)
    if size is not None:
        session.forms.look = LookForm(size=size)
        session.preview(LOOK, Size(value=size, how=session.forms.how, scope=session.forms.scope))


def _changed(grade: Grade, field: str, value: float) -> Grade:
    """`grade` with one number changed; black and white keep a distance."""
    if field == "black":
        value = min(value, grade.white - 0.01)
    elif field == "white":
        value = max(value, grade.black + 0.01)
    return replace(grade, **{field: value})


TRANSFORM_SECTION = "move"

SAMPLE = 200_000
"""Splats that the pivot is the middle of."""

UPS: tuple[tuple[str, Place], ...] = (
    ("+X", (1, 0, 0)),
    ("-X", (-1, 0, 0)),
    ("+Y", (0, 1, 0)),
    ("-Y", (0, -1, 0)),
    ("+Z", (0, 0, 1)),
    ("-Z", (0, 0, -1)),
)


def show_transform(app: AppState, session: EditSession) -> None:
    if choose_scope(session):
        session.forms.move = MoveForm(gizmo=session.forms.move.gizmo)
        post_edit(app, EditSession.cancel_preview)
    if not nothing_to_change(session):
        by_numbers(app, session)
    widgets.section("Upright")
    upright(app, session)


def by_numbers(app: AppState, session: EditSession) -> None:
    form = session.forms.move
    speed = max(app.scene.radius, 1e-6) / 300
    changed = False
    moved = widgets.vector("Move", form.translation, speed, "World units along x, y, z.")
    if moved is not None:
        form.translation, changed = moved, True
    tip = "Degrees about x, y, z through the middle; colours that depend on the view turn too."
    turned = widgets.vector("Turn", form.rotation, 0.25, tip, form="%.2f")
    if turned is not None:
        form.rotation, changed = turned, True
    scale = widgets.slider(
        "Scale", form.scale, 0.05, 20.0, "About the middle.", form="%.3f", logarithmic=True
    )
    if scale is not None:
        form.scale, changed = scale, True
    shown = widgets.checkbox("Handles", form.gizmo, "Handles on the picture to move and turn by.")
    form.gizmo = form.gizmo if shown is None else shown
    if form.gizmo:
        turning = widgets.checkbox("Turn by them", form.turning, "The handles turn rather than move.")
        form.turning = form.turning if turning is None else turning
    if changed:
        preview(session)
    if keep_or_cancel(app, session, TRANSFORM_SECTION) is not None:
        session.forms.move = MoveForm(gizmo=form.gizmo, turning=form.turning)


def preview(session: EditSession) -> None:
    form = session.forms.move
    if any(not np.isfinite(v) for v in (*form.translation, *form.rotation)) or not form.scale > 0:
        return
    operation = Transform(
        scope=session.forms.scope,
        translation=form.translation,
        rotation=quat_of(form.rotation),
        scale=form.scale,
        pivot=pivot(session),
    )
    session.preview(TRANSFORM_SECTION, operation)


def pivot(session: EditSession) -> Place:
    """The middle of what is to be moved, as it is without the preview; kept while one is in force."""
    key = (session.forms.scope, session.document.versions)
    if session.pivot is None or (session.forms.previewing != TRANSFORM_SECTION and session.pivot[0] != key):
        document = session.document
        splats = (
            document.selected.indices
            if session.forms.scope == "selection"
            else np.arange(len(document.marks))
        )
        chosen = splats[:: max(1, len(splats) // SAMPLE)]
        places = positions_of(document.gaussians, document.edits)[chosen]
        x, y, z = (float(value) for value in robust_bounds(places)[0])
        session.pivot = (key, (x, y, z))
    return session.pivot[1]


def handles(app: AppState, session: EditSession, camera: Camera, corner: ImVec2) -> None:
    """Over the picture; what they do is the same as typing the numbers."""
    form = session.forms.move
    if session.handles != "Move":
        return
    centre = np.array(pivot(session))
    turned = Adjustment(rotation=quat_of(form.rotation)) if form.turning else IDENTITY
    matrix = gizmos.placed(centre + form.translation, turned.R)
    new = gizmos.handles("move", camera, corner, matrix, "turn" if form.turning else "move", local=False)
    if new is None:
        return
    if form.turning:
        form.rotation = angles_of(quat_from_matrix(new[:3, :3]))
    else:
        x, y, z = (new[:3, 3] - centre).tolist()
        form.translation = (x, y, z)
    post_edit(app, preview)


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


SECTIONS: tuple[tuple[str, bool, Callable[[AppState, EditSession], None]], ...] = (
    ("Select", True, select.show),
    ("Clean up", False, clean.show),
    ("Crop", False, crops.show),
    ("Move", False, show_transform),
    ("Look", False, show_appearance),
)
"""Title, whether it is open at first, contents."""

IN_TRAINING = (select.show, clean.show, crops.show)
"""Contents of the sections whose changes a trainer can be told of."""

RULES = "Rules of the training"

TOOLS: tuple[tuple[str, ToolName], ...] = (
    ("Rectangle", "rectangle"),
    ("Brush", "brush"),
    ("Lasso", "lasso"),
    ("Polygon", "polygon"),
    ("Wand", "flood"),
    ("Colour", "colour"),
    ("Measure", "measure"),
)


def show(app: AppState) -> None:
    session = session_of(app)
    if not can_edit(app):
        widgets.note("Open a scene to edit it.")
        return
    toolbar(app, session)
    training = None if at_rest(app) else app.find(LiveTraining)
    if training is not None:
        recipe.show_rules(app, training)
    if session is not None:
        job(app, session)
        for title, opened, contents in SECTIONS:
            if training is not None and contents not in IN_TRAINING:
                continue
            flags = imgui.TreeNodeFlags_.default_open if opened else 0
            if session.forms.open_section == title:
                imgui.set_next_item_open(True)
            if imgui.collapsing_header(title, flags):
                session.forms.drawn.add(title)
                imgui.push_id(title)
                contents(app, session)
                imgui.pop_id()
        session.forms.open_section = ""
    if training is not None and imgui.collapsing_header(RULES, imgui.TreeNodeFlags_.default_open):
        imgui.push_id(RULES)
        recipe.in_force(app, training)
        imgui.pop_id()


def toolbar(app: AppState, session: EditSession | None) -> None:
    """A button a tool; the one in hand is bright."""
    for number, (name, tool) in enumerate(TOOLS):
        if number:
            widgets.beside(name)
        chosen = session is not None and session.tool == tool
        if chosen:
            imgui.push_style_color(imgui.Col_.button, ImVec4(*theme.ACCENT, 0.75))
        widgets.command_button(app, name, f"tool_{tool}")
        if chosen:
            imgui.pop_style_color()


def job(app: AppState, session: EditSession) -> None:
    """Slow work under way, with a way to stop it, in a row that is kept free for it."""
    if session.job is None:
        imgui.dummy((0, imgui.get_frame_height()))
        return
    imgui.progress_bar(session.job.progress, (-imgui.get_font_size() * 5, 0), session.job.title)
    imgui.same_line()
    widgets.command_button(app, "Cancel", "cancel")
