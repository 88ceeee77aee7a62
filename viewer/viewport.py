"""The picture in the middle of the window: drawn at the visible area's size, steered by the mouse."""

from __future__ import annotations

import math
from dataclasses import replace

import moderngl
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.scene import InputError
from splatview.viewer.background import WindowBackground
from splatview.viewer.camera import focus_at
from splatview.viewer.commands import held_step
from splatview.viewer.depth_of_field import DepthOfField, focus_on
from splatview.viewer.editing.tools import draw_tool, on_handles, use_tool
from splatview.viewer.key_presets import Action, Button, action_of
from splatview.viewer.navigation import dolly, look, move, orbit, pan, trackball
from splatview.viewer.panels.split_view import drag_line, draw_split
from splatview.viewer.preferences import RANGES
from splatview.viewer.quality.state import Accuracy
from splatview.viewer.state import AppState
from splatview.viewer.view_aids import ViewAids

ORBIT_SPEED = math.pi
"""Radians for a drag across the picture's height."""

LOOK_SPEED = 1.5
"""Fields of view for a drag across the picture's height, when flying."""

WHEEL_STEP = 0.85
"""Factor on the distance for one notch towards the scene."""

ZOOM_SPEED = 3.0
"""Logarithm of the distance for a drag across the picture's height."""

WALK_SPEED = 2.0
"""Scene radii for a drag across the picture's height, at speed 1."""

SCROLL_PX = 24.0
"""Drag that a notch of two fingers counts for."""

FLY_SPEED = 0.4
"""Scene radii a second at speed 1."""

LONGEST_STEP = 0.1
"""Seconds that one frame's flight may count for: after a stall the eye must not leap."""

_LEFT, _RIGHT, _MIDDLE = imgui.MouseButton_.left, imgui.MouseButton_.right, imgui.MouseButton_.middle


def show(app: AppState) -> None:
    """The contents of the view's dock: the picture, and what the mouse and held keys do to it."""
    area = imgui.get_content_region_avail()
    width, height = max(1, int(area.x)), max(1, int(area.y))
    scale = imgui.get_io().display_framebuffer_scale
    app.picture_size = (max(1, round(width * scale.x)), max(1, round(height * scale.y)))
    corner = imgui.get_cursor_screen_pos()
    buttons = (
        imgui.ButtonFlags_.mouse_button_left
        | imgui.ButtonFlags_.mouse_button_right
        | imgui.ButtonFlags_.mouse_button_middle
    )
    tool_has_it = on_handles(app, app.view.camera(width, height), corner)
    if tool_has_it and not (imgui.is_mouse_clicked(_RIGHT) or imgui.is_mouse_clicked(_MIDDLE)):
        # ImGuizmo refuses a press while any item of ImGui's is hovered; one without an id does not count.
        imgui.dummy(ImVec2(width, height))
    else:
        if not tool_has_it:  # what may be overlapped takes no press in its first frame
            imgui.set_next_item_allow_overlap()
        imgui.invisible_button("picture", ImVec2(width, height), buttons)
    tool_has_it = tool_has_it or click_focus(app, corner, scale) or use_tool(app, corner, width, height)
    tool_has_it = drag_line(app, corner, width) or tool_has_it
    steer_by_mouse(app, corner, width, height, scale, left_is_free=not tool_has_it)
    steer_by_keys(app)
    turning = imgui.is_item_active() and not tool_has_it
    draw_picture(app, corner, width, height)
    draw_split(app, corner, width, height)
    draw_tool(app, corner, width, height)
    if turning and app.preferences.navigation != "fly":
        mark_target(app, corner, width, height)


def click_focus(app: AppState, corner: ImVec2, scale: ImVec2) -> bool:
    """Chooses what is in focus, where that is asked for. Whether the mouse is the lens's."""
    if not app.feature(DepthOfField).picking:
        return False
    if imgui.is_item_hovered():
        imgui.set_mouse_cursor(imgui.MouseCursor_.hand)
        if imgui.is_mouse_clicked(_LEFT):
            mouse = imgui.get_mouse_pos()
            app.post(focus_on, (mouse.x - corner.x) * scale.x, (mouse.y - corner.y) * scale.y)
    return True


def mark_target(app: AppState, corner: ImVec2, width: int, height: int) -> None:
    """A small ring about the turning point, while the user turns."""
    camera = app.view.camera(width, height)
    place = ImVec2(corner.x + camera.cx, corner.y + camera.cy)
    draw, radius = imgui.get_window_draw_list(), imgui.get_font_size() * 0.35
    draw.add_circle(place, radius, imgui.get_color_u32(ImVec4(0, 0, 0, 0.5)), 0, 3)
    draw.add_circle(place, radius, imgui.get_color_u32(ImVec4(1, 1, 1, 0.8)), 0, 1.5)


def draw_picture(app: AppState, corner: ImVec2, width: int, height: int) -> None:
    accuracy, lens = app.feature(Accuracy), app.feature(DepthOfField)
    app.feature(WindowBackground).follow(app)
    request = accuracy.next_frame(app)
    try:
        camera = lens.next_camera(app, request.camera, request.settings)
        app.picture.draw(replace(request, camera=camera))
    except InputError as error:
        # A mode or a size that needs more of the GPU than it has; told of once, though each frame tries.
        if app.undrawn != str(error):
            app.complain(f"{app.mode}: {error}")
        app.mode, app.undrawn = "splats", str(error)
        return
    app.undrawn = None
    texture = lens.shown(app) or app.picture.texture
    # Alpha is what the scene covers; the background is already in the colours, so it must not blend twice.
    texture.swizzle = "RGB1"
    exact = texture.size == app.picture_size
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST) if exact else (moderngl.LINEAR, moderngl.LINEAR)
    imgui.get_window_draw_list().add_image(
        imgui.ImTextureRef(texture.glo), corner, ImVec2(corner.x + width, corner.y + height)
    )
    app.feature(ViewAids).draw(app, corner, width, height, texture)


def steer_by_mouse(
    app: AppState, corner: ImVec2, width: int, height: int, scale: ImVec2, *, left_is_free: bool = True
) -> None:
    """Drags that began on the picture, and the wheel and double clicks over it. Where the left button is
    not free a tool has it."""
    io = imgui.get_io()
    if imgui.is_item_active() and (io.mouse_delta.x or io.mouse_delta.y):
        action = drag_action(app, left_is_free=left_is_free)
        x, y = io.mouse_pos.x - corner.x, io.mouse_pos.y - corner.y
        drag(app, action, x, y, io.mouse_delta.x, io.mouse_delta.y, width, height)
    if not imgui.is_item_hovered():
        return
    if left_is_free and imgui.is_mouse_double_clicked(_LEFT):
        x = (io.mouse_pos.x - corner.x) * scale.x
        y = (io.mouse_pos.y - corner.y) * scale.y
        app.post(focus_at, x, y)
    if app.preferences.touchpad and not io.key_ctrl and (io.mouse_wheel or io.mouse_wheel_h):
        scroll(app, io.mouse_wheel_h, io.mouse_wheel, width, height)
    elif io.mouse_wheel:
        notches = -io.mouse_wheel if app.preferences.invert_wheel else io.mouse_wheel
        if app.preferences.navigation == "fly":
            low, high = RANGES["fly_speed"]
            app.prefer(fly_speed=min(max(app.preferences.fly_speed * 1.2**notches, low), high))
            app.tell(f"Flying speed {app.preferences.fly_speed:.2g}")
        else:
            app.steer(dolly(app.view, WHEEL_STEP**notches))


def drag_action(app: AppState, *, left_is_free: bool) -> Action | None:
    """What the drag under way does, by the preset of the mouse; None where a tool has it."""
    io, down = imgui.get_io(), imgui.is_mouse_down
    names = (("Shift", io.key_shift), ("Ctrl", io.key_ctrl), ("Alt", io.key_alt))
    held = frozenset(name for name, is_held in names if is_held)
    buttons: tuple[tuple[Button, imgui.MouseButton_], ...] = (
        ("right", _RIGHT),
        ("middle", _MIDDLE),
        ("left", _LEFT),
    )
    pressed: list[Button] = [name for name, number in buttons if down(number)]
    button = pressed[0] if pressed else None
    if button is None or (button == "left" and not left_is_free):
        return None
    action = action_of(app.preferences.mouse, button, held)
    # When flying, Shift is the fast gear of the keys.
    if app.preferences.navigation == "fly" and button == "left" and held == {"Shift"} and action == "pan":
        return "turn"
    return action


def drag(
    app: AppState, action: Action | None, x: float, y: float, dx: float, dy: float, width: int, height: int
) -> None:
    """A drag that came to (x, y) by (dx, dy), in ImGui's units from the picture's corner."""
    radians = app.preferences.mouse_speed * ORBIT_SPEED / height
    pixel = app.preferences.mouse_speed * math.radians(app.view.lens.fov_y) / height * LOOK_SPEED
    match action:
        case "turn":
            turn(app, x, y, dx, dy, width, height)
        case "orbit":
            app.steer(orbit(app.view, dx * radians, dy * radians))
        case "look":
            app.steer(look(app.view, dx * pixel, -dy * pixel))
        case "pan":
            app.steer(pan(app.view, dx, dy, height=height))
        case "zoom":
            app.steer(dolly(app.view, math.exp(ZOOM_SPEED * dy / height)))
        case "walk":
            radius = app.scene.radius if app.is_open else app.view.distance
            step = -dy / height * WALK_SPEED * radius * app.preferences.fly_speed
            app.steer(move(look(app.view, dx * pixel, 0.0), (0.0, 0.0, step)))
        case None:
            pass


def scroll(app: AppState, right: float, up: float, width: int, height: int) -> None:
    """Two fingers on a touchpad, by as much as a wheel would have turned: they turn the view, with Shift they
    slide it; with Ctrl they are a wheel. GLFW tells nothing of pinching."""
    dx, dy = right * SCROLL_PX, up * SCROLL_PX
    if app.preferences.invert_wheel:
        dx, dy = -dx, -dy
    if imgui.get_io().key_shift:
        app.steer(pan(app.view, dx, dy, height=height))
    else:
        turn(app, width / 2 + dx, height / 2 + dy, dx, dy, width, height)


def turn(app: AppState, x: float, y: float, dx: float, dy: float, width: int, height: int) -> None:
    """A left drag that came to (x, y) by (dx, dy), in ImGui's units from the picture's corner."""
    radians = app.preferences.mouse_speed * ORBIT_SPEED / height
    match app.preferences.navigation:
        case "orbit":
            app.steer(orbit(app.view, dx * radians, dy * radians))
        case "fly":
            # The eye turns towards where the mouse goes, more gently through a long lens.
            pixel = app.preferences.mouse_speed * math.radians(app.view.lens.fov_y) / height
            app.steer(look(app.view, dx * pixel * LOOK_SPEED, -dy * pixel * LOOK_SPEED))
        case "trackball":
            half = min(width, height) / 2
            end = ((x - width / 2) / half, (y - height / 2) / half)
            start = (end[0] - dx / half, end[1] - dy / half)
            app.steer(trackball(app.view, start, end))


def steer_by_keys(app: AppState) -> bool:
    """Flies while keys are held, in every mode; returns whether one is."""
    step = held_step()
    if step is None:
        return False
    radius = app.scene.radius if app.is_open else app.view.distance
    seconds = min(imgui.get_io().delta_time, LONGEST_STEP)
    length = app.preferences.fly_speed * FLY_SPEED * radius * seconds
    if app.view.lens.orthographic:
        # Along parallel rays nothing comes nearer: they are drawn together instead.
        right, up, forward = step
        step = (right, up, 0.0)
        app.steer(dolly(app.view, math.exp(-forward * length / radius)))
    app.steer(move(app.view, [part * length for part in step]))
    return True
