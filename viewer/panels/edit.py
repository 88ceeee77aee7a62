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
from splatview.scene.framing import robust_bounds
from splatview.viewer import theme
from splatview.viewer.editing import commands, gizmos
from splatview.viewer.editing.gizmos import angles_of, quat_from_matrix, quat_of
from splatview.viewer.editing.session import Desk, LookForm, MoveForm
from splatview.viewer.editing.tool_state import Place, ToolName
from splatview.viewer.open import bounds
from splatview.viewer.panels import clean, crops, select, widgets
from splatview.viewer.panels import recipe as rules

if TYPE_CHECKING:
    from splatview.viewer.state import Core


# ---- What a change is about, and the buttons that put a preview in force or take it back.


def choose_scope(desk: Desk) -> bool:
    """Selection or whole scene; returns whether it changed."""
    chosen = widgets.combo(
        "Of",
        desk.forms.scope,
        ("selection", "scene"),
        "What is changed: the selected splats, or all that are neither deleted nor locked.",
        ("The selection", "The whole scene"),
    )
    if chosen is None:
        return False
    desk.forms.scope = chosen
    return True


def nothing_to_change(desk: Desk) -> bool:
    """Says so where the scope is an empty selection."""
    if desk.forms.scope == "selection" and not desk.document.counts.selected:
        widgets.note("Nothing is selected: select splats, or choose the whole scene above.")
        return True
    return False


def keep_or_cancel(core: Core, desk: Desk, section: str) -> bool | None:
    """The buttons, while this section's preview is in force; True where it was kept, False where not."""
    if desk.forms.previewing != section:
        return None
    kept = imgui.button(f"Apply##{section}")
    widgets.tooltip("Keep the change as a step of the history.")
    imgui.same_line()
    cancelled = imgui.button(f"Cancel##{section}")
    widgets.tooltip("Take the preview back.")
    if kept:
        core.post(lambda core: core.desk.commit_preview() if core.desk else None)
        return True
    if cancelled:
        core.post(lambda core: core.desk.cancel_preview() if core.desk else None)
        return False
    return None


# ---- Opacity, size and colours: sliders that show at once what they do.


APPEARANCE_SECTION = "look"

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


def show_appearance(core: Core, desk: Desk) -> None:
    changed_scope = choose_scope(desk)
    if nothing_to_change(desk):
        return
    form = desk.forms.look
    opacity_and_size(core, desk)
    form = desk.forms.look
    grade = form.grade
    for field, (name, low, high, tip) in GRADES.items():
        value = widgets.slider(name, getattr(grade, field), low, high, tip)
        if value is not None:
            grade = _changed(grade, field, value)
    if grade != form.grade or (
        changed_scope and desk.forms.previewing == APPEARANCE_SECTION and grade != Grade()
    ):
        desk.forms.look = LookForm(grade=grade)
        desk.preview(APPEARANCE_SECTION, ColourGrade(grade=grade, scope=desk.forms.scope))
    if keep_or_cancel(core, desk, APPEARANCE_SECTION) is not None or (
        desk.forms.previewing != APPEARANCE_SECTION
        and desk.forms.look != LookForm()
        and not imgui.is_any_item_active()
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
        desk.preview(APPEARANCE_SECTION, Opacity(value=opacity, how=desk.forms.how, scope=desk.forms.scope))
    radius = max(core.scene.radius if core.scene else 1.0, 1e-6)
    tip = "Factor on the size of each splat, about its centre." if factor else "Mean deviation, world units."
    name, low, high = ("Size x", 0.1, 10.0) if factor else ("Size", 1e-5 * radius, 0.1 * radius)
    size = widgets.slider(name, form.size, low, high, tip, form="%.3g", logarithmic=True)
    if size is not None:
        desk.forms.look = LookForm(size=size)
        desk.preview(APPEARANCE_SECTION, Size(value=size, how=desk.forms.how, scope=desk.forms.scope))


def _changed(grade: Grade, field: str, value: float) -> Grade:
    """`grade` with one number changed; black and white keep a distance."""
    if field == "black":
        value = min(value, grade.white - 0.01)
    elif field == "white":
        value = max(value, grade.black + 0.01)
    return replace(grade, **{field: value})


# ---- Moving, turning and scaling by numbers or by handles on the picture; setting the scene upright.


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


def show_transform(core: Core, desk: Desk) -> None:
    if choose_scope(desk):
        desk.forms.move = MoveForm(gizmo=desk.forms.move.gizmo)
        core.post(lambda core: core.desk.cancel_preview() if core.desk else None)
    if not nothing_to_change(desk):
        by_numbers(core, desk)
    widgets.section("Upright")
    upright(core, desk)


def by_numbers(core: Core, desk: Desk) -> None:
    form = desk.forms.move
    speed = max(core.scene.radius if core.scene else 1.0, 1e-6) / 300
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
        preview(desk)
    if keep_or_cancel(core, desk, TRANSFORM_SECTION) is not None:
        desk.forms.move = MoveForm(gizmo=form.gizmo, turning=form.turning)


def preview(desk: Desk) -> None:
    form = desk.forms.move
    if any(not np.isfinite(v) for v in (*form.translation, *form.rotation)) or not form.scale > 0:
        return
    operation = Transform(
        scope=desk.forms.scope,
        translation=form.translation,
        rotation=quat_of(form.rotation),
        scale=form.scale,
        pivot=pivot(desk),
    )
    desk.preview(TRANSFORM_SECTION, operation)


def pivot(desk: Desk) -> Place:
    """The middle of what is to be moved, as it is without the preview; kept while one is in force."""
    key = (desk.forms.scope, desk.document.versions)
    if desk.pivot is None or (desk.forms.previewing != TRANSFORM_SECTION and desk.pivot[0] != key):
        document = desk.document
        splats = (
            document.selected.indices if desk.forms.scope == "selection" else np.arange(len(document.marks))
        )
        chosen = splats[:: max(1, len(splats) // SAMPLE)]
        places = positions_of(document.gaussians, document.edits)[chosen]
        x, y, z = (float(value) for value in robust_bounds(places)[0])
        desk.pivot = (key, (x, y, z))
    return desk.pivot[1]


def handles(core: Core, desk: Desk, camera: Camera, corner: ImVec2) -> None:
    """Over the picture; what they do is the same as typing the numbers."""
    form = desk.forms.move
    if not form.gizmo or (desk.forms.scope == "selection" and not desk.document.counts.selected):
        return
    centre = np.array(pivot(desk))
    matrix = np.eye(4)
    matrix[:3, 3] = centre + form.translation
    if form.turning:
        from splatview.scene.edits import Adjustment

        matrix[:3, :3] = Adjustment(rotation=quat_of(form.rotation)).R
    new = gizmos.handles("move", camera, corner, matrix, "turn" if form.turning else "move", local=False)
    if new is None:
        return
    if form.turning:
        form.rotation = angles_of(quat_from_matrix(new[:3, :3]))
    else:
        x, y, z = (new[:3, 3] - centre).tolist()
        form.translation = (x, y, z)
    core.post(lambda core: preview(core.desk) if core.desk else None)


def upright(core: Core, desk: Desk) -> None:
    """The whole scene turned so that it stands: by an axis, by the view, or by three points on the ground."""
    widgets.note("What points up in the scene now?")
    for number, (name, axis) in enumerate(UPS):
        if number:
            widgets.beside(name)
        tip = f"Turns the scene: its {name} becomes up (-Y)."
        widgets.button(f"{name}##up", tip, partial(core.post, orient, axis))
    if imgui.button("The view's up"):
        up = -core.view.R_camera_world[1]
        core.post(orient, (float(up[0]), float(up[1]), float(up[2])))
    widgets.tooltip("Turns the scene so that what is up in the picture now is up (-Y).")
    chosen = desk.tool == "ground"
    text = f"Pick {3 - len(desk.picked)} more..." if chosen else "Three points on the ground"
    widgets.beside(text)
    if imgui.button(f"{text}###ground"):
        core.post(commands.take_tool, "ground")
    widgets.tooltip("Click three points of the floor: it becomes level, at y = 0.")


def orient(core: Core, up: Place) -> None:
    """Turns what is shown about its middle until `up` points up."""
    found = bounds(core)
    if core.desk is not None and found is not None:
        x, y, z = found[0].tolist()
        core.desk.apply(Orient(up=up, pivot=(x, y, z)))


SECTIONS: tuple[tuple[str, bool, Callable[[Core, Desk], None]], ...] = (
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


def show(core: Core) -> None:
    desk = core.desk
    if not core.can_edit:
        widgets.note("Open a scene to edit it.")
        return
    toolbar(core, desk)
    training = None if core.at_rest else core.training
    if training is not None:
        rules.show_rules(core, training)
    if desk is not None:
        job(core, desk)
        for title, opened, contents in SECTIONS:
            if training is not None and contents not in IN_TRAINING:
                continue
            flags = imgui.TreeNodeFlags_.default_open if opened else 0
            if desk.forms.open_section == title:
                imgui.set_next_item_open(True)
                desk.forms.open_section = ""
            if imgui.collapsing_header(title, flags):
                imgui.push_id(title)
                contents(core, desk)
                imgui.pop_id()
    if training is not None and imgui.collapsing_header(RULES, imgui.TreeNodeFlags_.default_open):
        imgui.push_id(RULES)
        rules.in_force(core, training)
        imgui.pop_id()


def toolbar(core: Core, desk: Desk | None) -> None:
    """A button a tool; the one in hand is bright."""
    for number, (name, tool) in enumerate(TOOLS):
        if number:
            widgets.beside(name)
        chosen = desk is not None and desk.tool == tool
        if chosen:
            imgui.push_style_color(imgui.Col_.button, ImVec4(*theme.ACCENT, 0.75))
        widgets.action_button(core, name, f"tool_{tool}")
        if chosen:
            imgui.pop_style_color()
    if desk is not None and desk.tool != "none":
        widgets.note("Shift adds, Ctrl removes, both keep what is common. Alt + drag turns. Esc: done.")


def job(core: Core, desk: Desk) -> None:
    """Slow work under way, with a way to stop it."""
    if desk.job is None:
        return
    imgui.progress_bar(desk.job.progress, (-imgui.get_font_size() * 5, 0), desk.job.title)
    imgui.same_line()
    widgets.action_button(core, "Cancel", "cancel")
