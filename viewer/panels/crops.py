"""The Crop section: a list of boxes and spheres, numbers for the chosen one, handles on the picture."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.edit.operations import Select
from splatview.edit.operations.crop import ChangeCrop, DeleteCropped, EnableCrop, RemoveCrop
from splatview.edit.selectors import Box, Sphere
from splatview.scene import Camera
from splatview.scene.edits import Adjustment, Crop
from splatview.scene.errors import printable
from splatview.viewer import theme
from splatview.viewer.editing import face_handles, gizmos
from splatview.viewer.editing.commands import Shape, add_crop
from splatview.viewer.editing.gizmos import KINDS, angles_of, quat_from_matrix, quat_of
from splatview.viewer.editing.session import EditSession, post_edit
from splatview.viewer.editing.tool_state import CROPPING, mode_of
from splatview.viewer.panels import widgets
from splatview.viewer.theme import point_on_picture
from splatview.viewer.training.live import LiveTraining

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


SECTION = "crop"

KIND_NAMES = ("Move", "Rotate", "Scale")

CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
EDGES = [(i, j) for i in range(8) for j in range(i) if bin(i ^ j).count("1") == 1]

CUTTING = ImVec4(1, 0.45, 0.4, 0.8)
"""Colour of crops that cut out what is inside."""

CIRCLE = np.linspace(0, 2 * np.pi, 49)


def show(app: AppState, session: EditSession) -> None:
    list_of(app, session)
    crops = session.document.crops
    if 0 <= session.forms.crop < len(crops):
        numbers(app, session, session.forms.crop)
    if not any(crop.enabled for crop in crops):
        return
    if not session.target.at_rest:
        widgets.button(
            "Cut away in training",
            "Deletes what the crops cut away from the training, and keeps it so: a rule that you can remove.",
            partial(app.post, app.feature(LiveTraining).editor.cut_away),
        )
    else:
        operation = DeleteCropped()
        widgets.button(
            "Delete what is cut away",
            operation.summary,
            partial(post_edit, app, EditSession.apply, operation),
        )


def list_of(app: AppState, session: EditSession) -> None:
    """The crops, with a switch each; a click chooses one, for its numbers and handles."""
    shapes: tuple[tuple[str, Shape], ...] = (("Add box", "box"), ("Add sphere", "sphere"))
    for number, (name, shape) in enumerate(shapes):
        if number:
            widgets.beside(name)
        widgets.button(
            name,
            "Shows only what is inside, or all but that; no splat is touched.",
            partial(app.post, partial(add_crop, shape=shape)),
        )
    crops = session.document.crops
    if not crops:
        session.forms.crop = -1
        widgets.note(
            "No crops. Export leaves out what they cut away."
            if session.target.at_rest
            else "No crops. They show what is left; then let them cut, or let nothing grow inside."
        )
        return
    session.forms.crop = min(session.forms.crop, len(crops) - 1)
    for index, crop in enumerate(crops):
        imgui.push_id(index)
        toggled, enabled = imgui.checkbox("##on", crop.enabled)
        widgets.tooltip("Switches this crop on or off.")
        if toggled:
            post_edit(app, EditSession.apply, EnableCrop(index=index, enabled=enabled))
        imgui.same_line()
        word = "keeps" if crop.keep == "inside" else "cuts out"
        clicked, _ = imgui.selectable(
            widgets.item(f"{crop.name}: {crop.shape}, {word} its inside", index), index == session.forms.crop
        )
        if clicked:
            session.forms.crop = -1 if index == session.forms.crop else index
        imgui.pop_id()


def numbers(app: AppState, session: EditSession, index: int) -> None:
    """Every number of a crop, to type or to drag; undo goes back over a whole drag."""
    crop = session.document.crops[index]
    speed = max(app.scene.radius, 1e-6) / 300
    new, settled = crop, False
    widgets.label("Name", "For you and the history.")
    changed, name = imgui.input_text("##name", printable(crop.name), imgui.InputTextFlags_.enter_returns_true)
    if changed and name.strip():
        new, settled = replace(new, name=name.strip()), True
    keep = widgets.combo(
        "Keeps", crop.keep, ("inside", "outside"), "What stays: the inside, or everything else."
    )
    if keep is not None:
        new, settled = replace(new, keep=keep), True
    for label, field, tip, step in (
        ("Centre", "centre", "x, y, z in world units.", speed),
        ("Half size", "half_extents", "Half of its extent along its own axes, world units.", speed),
    ):
        values = widgets.vector(label, getattr(crop, field), step, tip)
        if values is not None and field == "half_extents":
            x, y, z = (max(abs(value), 1e-9) for value in values)
            values = x, y, z
        if values is not None:
            new = replace(new, **{field: values})
        settled |= imgui.is_item_deactivated_after_edit()
    values = widgets.vector("Rotation", angles_of(crop.rotation), 0.25, "Degrees about x, y, z.", form="%.2f")
    if values is not None:
        new = replace(new, rotation=quat_of(values))
    settled |= imgui.is_item_deactivated_after_edit()
    handle = widgets.combo(
        "Handles",
        KINDS[session.forms.crop_handles],
        KINDS,
        "What the handles on the picture do.",
        KIND_NAMES,
    )
    if handle is not None:
        session.forms.crop_handles = KINDS.index(handle)
    change(app, session, index, new, settled=settled)
    by, io = volume(crop), imgui.get_io()
    mode = mode_of(shift=io.key_shift, ctrl=io.key_ctrl)
    widgets.button(
        "Select inside",
        "Selects the splats inside; Shift adds them, Ctrl removes them.",
        lambda: post_edit(app, EditSession.apply, Select(by=by, mode=mode)),
        lacks="" if by is not None else "A sphere that is stretched cannot: give its half sizes one value",
    )
    widgets.beside("Remove")
    widgets.button(
        "Remove",
        "Removes this crop; what it cut away is back.",
        partial(post_edit, app, EditSession.apply, RemoveCrop(index=index)),
    )
    if not session.target.at_rest:
        widgets.button(
            "No growth inside",
            "Lets no splat be born in it from now on; those that are there are trained on, and may die.",
            partial(app.post, app.feature(LiveTraining).editor.stop_growth, index),
        )


def volume(crop: Crop) -> Box | Sphere | None:
    """Selector of the inside of a crop; None for a sphere that was stretched to an ellipsoid."""
    if crop.shape == "box":
        return Box(centre=crop.centre, half_extents=crop.half_extents, rotation=crop.rotation)
    low, high = min(crop.half_extents), max(crop.half_extents)
    return Sphere(centre=crop.centre, radius=high) if high - low <= 1e-6 * high else None


def change(app: AppState, session: EditSession, index: int, new: Crop, *, settled: bool) -> None:
    """Previews a crop while it is dragged, and makes one step of the drag when it ends."""
    if new != session.document.crops[index]:
        operation = ChangeCrop(index=index, crop=new)
        post_edit(app, EditSession.preview, SECTION, operation)
    if settled:
        post_edit(app, EditSession.commit_preview)


def draw(app: AppState, session: EditSession, camera: Camera, corner: ImVec2) -> None:
    """The crops' outlines over the picture, and handles of the chosen one."""
    for index, crop in enumerate(session.document.crops):
        in_hand = session.tool in CROPPING or "Crop" in session.forms.sections
        chosen = index == session.forms.crop and in_hand
        if not (crop.enabled or chosen):
            continue
        colour = ImVec4(*theme.ACCENT, 1.0 if chosen else 0.6) if crop.keep == "inside" else CUTTING
        draw_outline(crop, camera, corner, colour, 2.0 if chosen else 1.0)
    if session.handles == "Crop":
        drag_handles(app, session, camera, corner)


def draw_outline(crop: Crop, camera: Camera, corner: ImVec2, colour: ImVec4, thickness: float) -> None:
    """One crop over the picture of `camera` with its top left at `corner`."""
    ink, packed = imgui.get_window_draw_list(), imgui.get_color_u32(colour)
    for line in outline(crop):
        for start, end in pairwise(line.tolist()):
            a = point_on_picture(camera, corner, start)
            b = point_on_picture(camera, corner, end)
            if a is not None and b is not None:
                ink.add_line(a, b, packed, thickness)


def drag_handles(app: AppState, session: EditSession, camera: Camera, corner: ImVec2) -> None:
    index = session.forms.crop
    crop = session.document.crops[index]
    if drag_face(app, session, camera, corner):
        return
    matrix = gizmos.placed(crop.centre, Adjustment(rotation=crop.rotation).R, crop.half_extents)
    kind = KINDS[session.forms.crop_handles]
    moved = gizmos.handles("crop", camera, corner, matrix, kind, local=kind != "move")
    if moved is not None:
        session.forms.crop_dragged = True
        lengths = np.maximum(np.linalg.norm(moved[:3, :3], axis=0), 1e-9)
        x, y, z = moved[:3, 3].tolist()
        if kind == "move":
            new = replace(crop, centre=(x, y, z))
        elif kind == "scale":
            ex, ey, ez = lengths.tolist()
            new = replace(crop, half_extents=(ex, ey, ez))
        else:
            new = replace(crop, rotation=quat_from_matrix(moved[:3, :3] / lengths))
        change(app, session, index, new, settled=False)
    elif session.forms.crop_dragged and not gizmos.dragging():
        session.forms.crop_dragged = False
        post_edit(app, EditSession.commit_preview)


def drag_face(app: AppState, session: EditSession, camera: Camera, corner: ImVec2) -> bool:
    """The dots of the chosen crop, and the drag of one; whether there is one under way."""
    forms = session.forms
    crop, drag = session.document.crops[forms.crop], forms.face_drag
    if camera.lens is None:
        face_handles.draw(crop, camera, corner, forms.face_under)
    if drag is None:
        return False
    mouse = imgui.get_mouse_pos()
    if imgui.is_mouse_down(imgui.MouseButton_.left):
        new = face_handles.dragged(drag, camera, mouse.x - corner.x, mouse.y - corner.y)
        change(app, session, forms.crop, new, settled=False)
    else:
        forms.face_drag = None
        post_edit(app, EditSession.commit_preview)
    return True


def outline(crop: Crop) -> list[np.ndarray]:
    """Lines (P, 3) float64 in the world: edges of the box, or three circles of the sphere."""
    R_world_own = Adjustment(rotation=crop.rotation).R
    place = lambda own: (own * crop.half_extents) @ R_world_own.T + crop.centre  # noqa: E731
    if crop.shape == "box":
        return [place(CORNERS[[i, j]]) for i, j in EDGES]
    circles = []
    for axis in range(3):
        own = np.zeros((len(CIRCLE), 3))
        own[:, (axis + 1) % 3], own[:, (axis + 2) % 3] = np.cos(CIRCLE), np.sin(CIRCLE)
        circles.append(place(own))
    return circles
