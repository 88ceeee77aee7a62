"""Dots on the faces of a crop: each is dragged along its axis, and the face opposite stays."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.scene import Camera
from splatview.scene.background import pixel_rays
from splatview.scene.edits import Adjustment, Crop
from splatview.viewer import theme
from splatview.viewer.editing.tool_state import Face, FaceDrag
from splatview.viewer.theme import point_on_picture

if TYPE_CHECKING:
    from splatview.viewer.editing.session import EditSession

RADIUS_EM, REACH_EM = 0.36, 0.75
"""Of a dot as it is drawn, and of where the mouse takes it, in font heights."""

LEAST = 1e-3
"""Half size that a drag leaves at least, of the one before it."""

PARALLEL = 1e-3
"""Sine of the angle between the mouse's ray and a face's axis below which a drag says nothing."""


FACES = tuple(Face(axis, sign) for axis in range(3) for sign in (1, -1))


def place_of(crop: Crop, face: Face) -> np.ndarray:
    """Middle (3,) of the face, world units."""
    own = np.zeros(3)
    own[face.axis] = face.sign * crop.half_extents[face.axis]
    return crop.centre + Adjustment(rotation=crop.rotation).R @ own


def along(crop: Crop, face: Face, camera: Camera, x: float, y: float) -> float | None:
    """Where along the face's axis, outwards from the crop's centre, the ray of pixel (x, y) passes nearest,
    world units; None where they are all but parallel."""
    to_ray = pixel_rays(camera)
    if to_ray is None:
        return None
    axis = face.sign * Adjustment(rotation=crop.rotation).R[:, face.axis]
    ray = to_ray @ (x, y, 1.0)
    ray = ray / np.linalg.norm(ray)
    start = camera.eye
    if camera.orthographic:
        right, down = camera.R_camera_world[:2]
        start = camera.eye + (x - camera.cx) / camera.fx * right + (y - camera.cy) / camera.fy * down
    sine2 = 1 - float(axis @ ray) ** 2
    if not sine2 > PARALLEL**2:
        return None
    offset = start - np.asarray(crop.centre)
    return float((axis @ offset - (axis @ ray) * (ray @ offset)) / sine2)


def dragged(drag: FaceDrag, camera: Camera, x: float, y: float) -> Crop:
    """The crop with the mouse at pixel (x, y): a box with one face moved, a sphere with another radius."""
    crop, face = drag.crop, drag.face
    now = along(crop, face, camera, x, y)
    if now is None or not np.isfinite(now):
        return crop
    half = np.array(crop.half_extents)
    before, by = half[face.axis], now - drag.start
    if crop.shape == "sphere":
        hx, hy, hz = (half * max((before + by) / before, LEAST)).tolist()
        return replace(crop, half_extents=(hx, hy, hz))
    by = max(by / 2, (LEAST - 1) * before)
    half[face.axis] = before + by
    outwards = face.sign * Adjustment(rotation=crop.rotation).R[:, face.axis]
    cx, cy, cz = (crop.centre + by * outwards).tolist()
    hx, hy, hz = half.tolist()
    return replace(crop, centre=(cx, cy, cz), half_extents=(hx, hy, hz))


def face_at(crop: Crop, camera: Camera, x: float, y: float, reach: float) -> Face | None:
    """The face whose dot is nearest to pixel (x, y), and within `reach` of it."""
    best, found = reach, None
    for face in FACES:
        at = point_on_picture(camera, ImVec2(0, 0), place_of(crop, face).tolist())
        if at is not None and (away := float(np.hypot(at.x - x, at.y - y))) <= best:
            best, found = away, face
    return found


def grabbed(session: EditSession, camera: Camera, corner: ImVec2) -> bool:
    """Whether the left button is that of a dot of the chosen crop; begins and ends its drag. To be asked once
    a frame before the picture's item."""
    forms, mouse = session.forms, imgui.get_mouse_pos()
    x, y = mouse.x - corner.x, mouse.y - corner.y
    if forms.face_drag is not None:
        return True
    forms.face_under = None
    if session.handles != "Crop" or not imgui.is_window_hovered() or imgui.is_any_item_active():
        return False
    crop = session.document.crops[forms.crop]
    forms.face_under = face_at(crop, camera, x, y, REACH_EM * imgui.get_font_size())
    if forms.face_under is None:
        return False
    imgui.set_mouse_cursor(imgui.MouseCursor_.hand)
    if imgui.is_mouse_clicked(imgui.MouseButton_.left):
        start = along(crop, forms.face_under, camera, x, y)
        if start is not None:
            forms.face_drag = FaceDrag(face=forms.face_under, crop=crop, start=start)
    return True


def draw(crop: Crop, camera: Camera, corner: ImVec2, bright: Face | None) -> None:
    """The dots over the picture; those of faces that look away are pale."""
    draw_list, em = imgui.get_window_draw_list(), imgui.get_font_size()
    R_world_own = Adjustment(rotation=crop.rotation).R
    for face in FACES:
        place = place_of(crop, face)
        at = point_on_picture(camera, corner, place.tolist())
        if at is None:
            continue
        towards = camera.forward if camera.orthographic else place - camera.eye
        away = float(face.sign * R_world_own[:, face.axis] @ towards) > 0
        alpha = 1.0 if face == bright else 0.45 if away else 0.9
        ink = ImVec4(1, 1, 1, alpha) if face == bright else ImVec4(*theme.ACCENT, alpha)
        draw_list.add_circle_filled(at, RADIUS_EM * em, imgui.get_color_u32(ink))
        draw_list.add_circle(at, RADIUS_EM * em, imgui.get_color_u32(ImVec4(0, 0, 0, 0.6 * alpha)), 0, 1.5)
