"""The screen tools on the picture: what the mouse does with them, and how they are drawn over it."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from imgui_bundle import ImVec2, ImVec2Like, ImVec4, imgui

from splatview.edit.operations import Select
from splatview.edit.operations.transform import Ground
from splatview.edit.selectors import Flood, SimilarColour
from splatview.edit.selectors.attributes import base_colours
from splatview.edit.selectors.region_growing import picked
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.edits import SceneEdits, adjusted_means
from splatview.viewer import theme
from splatview.viewer.editing import face_handles, transform
from splatview.viewer.editing.gizmos import grabbed
from splatview.viewer.editing.session import (
    Editing,
    EditSession,
    at_rest,
    post_edit,
    session_of,
    with_session,
)
from splatview.viewer.editing.tool_state import (
    CLICKED,
    CROPPING,
    DRAGGED,
    TRANSFORMING,
    Measured,
    Mode,
    Place,
    Stroke,
    ToolName,
    mode_of,
)
from splatview.viewer.panels import crops
from splatview.viewer.theme import point_on_picture

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


class Hit(NamedTuple):
    """The splat that makes the surface at a pixel."""

    splat: int
    place: Place
    """Its mean as edited, world units."""


def hit(session: EditSession, camera: Camera, x: float, y: float) -> Hit | None:
    """The splat at pixel (x, y) of the view of `camera`; None: the background. Raises InputError."""
    document = session.document
    splat = picked(document.gaussians, document.edits, document.tools, camera, x, y)
    return None if splat is None else Hit(splat, place_of(document.gaussians, document.edits, splat))


def place_of(gaussians: Gaussians, edits: SceneEdits, splat: int) -> Place:
    """Where splat `splat` is after its adjustments."""
    one = np.array([splat])
    alone = SceneEdits(marks=edits.marks[one], palette=edits.palette)
    x, y, z = (float(value) for value in adjusted_means(gaussians.take(one), alone)[0])
    return x, y, z


def click(session: EditSession, tool: ToolName, mode: Mode, camera: Camera, x: float, y: float) -> None:
    """A click at (x, y) px of what `camera` sees, with a tool that picks a splat."""
    found = hit(session, camera, x, y)
    if found is None:
        session.news = "Nothing there: the pixel shows the background"
        return
    if tool == "flood":
        by = Flood(seed=found.splat, tolerance=session.tolerance)
        session.apply_slowly(Select(by=by, mode=mode), "Magic wand")
    elif tool == "colour":
        alone = SceneEdits(
            marks=session.document.edits.marks[[found.splat]], palette=session.document.edits.palette
        )
        red, green, blue = (
            float(v) for v in base_colours(session.gaussians.take(np.array([found.splat])), alone)[0]
        )
        by = SimilarColour(rgb=(red, green, blue), tolerance=session.tolerance)
        session.apply(Select(by=by, mode=mode))
    else:
        pick_point(session, tool, found.place)


def pick_point(session: EditSession, tool: ToolName, place: Place) -> None:
    """One more point for the tape measure (two) or the ground (three)."""
    session.picked.append(place)
    if tool == "measure" and len(session.picked) == 2:
        session.measured = Measured(start=session.picked[0], end=session.picked[1])
        session.news = f"Distance: {session.measured.length:.6g} units"
        session.picked.clear()
    elif tool == "ground" and len(session.picked) == 3:
        first, second, third = session.picked
        session.picked.clear()
        session.tool = "none"
        session.apply(Ground(points=(first, second, third)))
    else:
        session.news = f"Point {len(session.picked)} of {2 if tool == 'measure' else 3}"


_LEFT = imgui.MouseButton_.left

COLOURS: dict[Mode, tuple[float, float, float]] = {
    "set": theme.ACCENT,
    "add": (0.35, 0.8, 0.4),
    "remove": (0.9, 0.4, 0.35),
    "intersect": (0.85, 0.7, 0.3),
}
"""Colours of the outline by mode of selection."""


def use_tool(app: AppState, corner: ImVec2, width: int, height: int) -> bool:
    """Lets the tool in hand have the left button over the picture's item, which was submitted last. Returns
    whether navigation is to leave that button alone."""
    session = session_of(app)
    io = imgui.get_io()
    if session is None or session.tool in ("none", *TRANSFORMING, *CROPPING):
        return False  # handles are asked before
    if io.key_alt and session.stroke is None:
        return False
    x, y = io.mouse_pos.x - corner.x, io.mouse_pos.y - corner.y
    mode = effective_mode(session)
    if session.tool in DRAGGED:
        drag(app, session, mode, x, y, width, height)
    elif session.tool == "polygon":
        outline(app, session, mode, x, y, width, height)
    elif session.tool in CLICKED and imgui.is_item_hovered() and imgui.is_mouse_clicked(_LEFT):
        app.post(_click, session.tool, mode, app.view.camera(width, height), x, y)
    return True


def effective_mode(session: EditSession) -> Mode:
    """The mode by the held keys, else the one that was chosen."""
    io = imgui.get_io()
    held = mode_of(shift=io.key_shift, ctrl=io.key_ctrl)
    return session.mode if held == "set" else held


@with_session
def _click(
    app: AppState, session: EditSession, tool: ToolName, mode: Mode, camera: Camera, x: float, y: float
) -> None:
    try:
        click(session, tool, mode, camera, x, y)
    except InputError as error:
        app.complain(str(error))


def on_handles(app: AppState, camera: Camera, corner: ImVec2) -> bool:
    """Whether the left button is that of handles on the picture of `camera`, with its top left at `corner`.
    To be asked before the picture's item."""
    session = session_of(app)
    if session is None or session.handles == "" or camera.lens is not None:
        return False
    return face_handles.grabbed(session, camera, corner) or grabbed()


def drag(
    app: AppState, session: EditSession, mode: Mode, x: float, y: float, width: int, height: int
) -> None:
    if (
        imgui.is_item_activated()
        and imgui.is_mouse_down(_LEFT)
        and session.tool in ("rectangle", "lasso", "brush")
    ):
        session.stroke = Stroke(tool=session.tool, mode=mode, radius=session.brush_radius)
    stroke = session.stroke
    if stroke is None:
        return
    if imgui.is_mouse_down(_LEFT):
        stroke.to(x, y)
    else:
        finish(app, session, stroke, width, height)


def outline(
    app: AppState, session: EditSession, mode: Mode, x: float, y: float, width: int, height: int
) -> None:
    """A polygon, corner by corner: a click on the first one, Enter or a double click closes it."""
    closed = imgui.is_key_pressed(imgui.Key.enter)
    if imgui.is_item_hovered() and imgui.is_mouse_clicked(_LEFT):
        if session.stroke is None:
            session.stroke = Stroke(tool="polygon", mode=mode, radius=0)
        if imgui.is_mouse_double_clicked(_LEFT) or session.stroke.corner(x, y):
            closed = True
    if closed and session.stroke is not None:
        finish(app, session, session.stroke, width, height)


def finish(app: AppState, session: EditSession, stroke: Stroke, width: int, height: int) -> None:
    """Selects what the stroke means; a click with nothing drawn selects nothing."""
    session.stroke = None
    operation = stroke.operation(app.view.camera(width, height), session.depth)
    if operation is not None:
        post_edit(app, EditSession.apply, operation)


def draw_tool(app: AppState, corner: ImVec2, width: int, height: int) -> None:
    """The outline under way, the brush's circle, picked points and the last measured distance."""
    session = session_of(app)
    draw = imgui.get_window_draw_list()
    draw.push_clip_rect(corner, ImVec2(corner.x + width, corner.y + height))
    editing = app.feature(Editing)
    for crop in () if at_rest(app) else editing.outlined:
        crops.draw_outline(crop, app.view.camera(width, height), corner, crops.CUTTING, 2.0)
    editing.outlined = ()  # until the panel, if it is seen, says so again
    if session is None:
        draw.pop_clip_rect()
        return
    if session.stroke is not None:
        draw_stroke(draw, session.stroke, corner)
    io = imgui.get_io()
    if session.tool == "brush" and imgui.is_item_hovered():
        mode = effective_mode(session)
        draw.add_circle(io.mouse_pos, session.brush_radius, colour(mode, 0.9), 0, 1.5)
    draw_points(app, draw, session, corner, width, height)
    camera = app.view.camera(width, height)
    crops.draw(app, session, camera, corner)
    transform.handles(app, session, camera, corner)
    draw.pop_clip_rect()


def colour(mode: Mode, alpha: float) -> int:
    return imgui.get_color_u32(ImVec4(*COLOURS[mode], alpha))


def draw_stroke(draw: imgui.ImDrawList, stroke: Stroke, corner: ImVec2) -> None:
    points: list[ImVec2Like] = [ImVec2(corner.x + x, corner.y + y) for x, y in stroke.points]
    line, fill = colour(stroke.mode, 0.95), colour(stroke.mode, 0.18)
    if stroke.tool == "rectangle" and len(points) > 1:
        (x0, y0), (x1, y1) = stroke.points
        low = ImVec2(corner.x + min(x0, x1), corner.y + min(y0, y1))
        high = ImVec2(corner.x + max(x0, x1), corner.y + max(y0, y1))
        draw.add_rect_filled(low, high, fill)
        draw.add_rect(low, high, line)
    elif stroke.tool == "brush":
        draw.add_polyline(points, fill, 2 * stroke.radius, 0)
        for point in (points[0], points[-1]):
            draw.add_circle_filled(point, stroke.radius, fill)
    elif stroke.tool in ("lasso", "polygon"):
        if stroke.tool == "polygon":
            points = [*points, imgui.get_io().mouse_pos]
        if len(points) > 2:
            draw.add_concave_poly_filled(points, fill)
        draw.add_polyline(points, line, 1.5, imgui.ImDrawFlags_.closed)
        for point in points[:-1] if stroke.tool == "polygon" else ():
            draw.add_circle_filled(point, 3, line)


def draw_points(
    app: AppState, draw: imgui.ImDrawList, session: EditSession, corner: ImVec2, width: int, height: int
) -> None:
    """Picked points in the scene, and the tape between the two of the last measurement."""
    camera = app.view.camera(width, height)
    place = partial(point_on_picture, camera, corner)
    ink = imgui.get_color_u32(ImVec4(1, 0.9, 0.3, 1))
    for point in session.picked:
        if (at := place(point)) is not None:
            draw.add_circle(at, 6, ink, 0, 2)
    measured = session.measured
    if measured is None or session.tool != "measure":
        return
    start, end = place(measured.start), place(measured.end)
    if start is None or end is None:
        return
    draw.add_line(start, end, ink, 2)
    for at in (start, end):
        draw.add_circle_filled(at, 4, ink)
    text = f"{measured.length:.4g}"
    middle = ImVec2((start.x + end.x) / 2, (start.y + end.y) / 2 - imgui.get_font_size() * 1.4)
    if math.isfinite(middle.x + middle.y):
        size = imgui.calc_text_size(text)
        draw.add_rect_filled(
            ImVec2(middle.x - size.x / 2 - 5, middle.y - 3),
            ImVec2(middle.x + size.x / 2 + 5, middle.y + size.y + 3),
            imgui.get_color_u32(ImVec4(0, 0, 0, 0.7)),
            4,
        )
        draw.add_text(ImVec2(middle.x - size.x / 2, middle.y), ink, text)
