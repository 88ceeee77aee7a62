"""The picture in the middle of the window: drawn at the visible area's size, steered by the mouse."""

from __future__ import annotations

import math

import moderngl
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.scene import InputError
from splatview.viewer.commands import focus_at, held_step
from splatview.viewer.depth_of_field import focus_on
from splatview.viewer.editing.tools import draw_tool, on_handles, use_tool
from splatview.viewer.navigation import dolly, look, move, orbit, pan, trackball
from splatview.viewer.panels.split_view import drag_line, draw_split
from splatview.viewer.preferences import RANGES
from splatview.viewer.state import Core

ORBIT_SPEED = math.pi
"""Radians for a drag across the picture's height."""

LOOK_SPEED = 1.5
"""Fields of view for a drag across the picture's height, when flying."""

WHEEL_STEP = 0.85
"""Factor on the distance for one notch towards the scene."""

FLY_SPEED = 0.4
"""Scene radii a second at speed 1."""

LONGEST_STEP = 0.1
"""Seconds that one frame's flight may count for: after a stall the eye must not leap."""

_LEFT, _RIGHT, _MIDDLE = imgui.MouseButton_.left, imgui.MouseButton_.right, imgui.MouseButton_.middle


def show(core: Core) -> None:
    """The contents of the view's dock: the picture, and what the mouse and held keys do to it."""
    area = imgui.get_content_region_avail()
    width, height = max(1, int(area.x)), max(1, int(area.y))
    scale = imgui.get_io().display_framebuffer_scale
    core.picture_size = (max(1, round(width * scale.x)), max(1, round(height * scale.y)))
    corner = imgui.get_cursor_screen_pos()
    buttons = (
        imgui.ButtonFlags_.mouse_button_left
        | imgui.ButtonFlags_.mouse_button_right
        | imgui.ButtonFlags_.mouse_button_middle
    )
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button("picture", ImVec2(width, height), buttons)
    tool_has_it = click_focus(core, corner, scale)
    tool_has_it = tool_has_it or use_tool(core, corner, width, height) or on_handles(core)
    tool_has_it = drag_line(core, corner, width) or tool_has_it
    steer_by_mouse(core, corner, width, height, scale, left_is_free=not tool_has_it)
    steer_by_keys(core)
    turning = imgui.is_item_active() and not tool_has_it
    draw_picture(core, corner, width, height)
    draw_split(core, corner, width, height)
    draw_tool(core, corner, width, height)
    if turning and core.preferences.navigation != "fly":
        mark_target(core, corner, width, height)


def click_focus(core: Core, corner: ImVec2, scale: ImVec2) -> bool:
    """Chooses what is in focus, where that is asked for. Whether the mouse is the lens's."""
    if not core.depth_of_field.picking:
        return False
    if imgui.is_item_hovered():
        imgui.set_mouse_cursor(imgui.MouseCursor_.hand)
        if imgui.is_mouse_clicked(_LEFT):
            mouse = imgui.get_mouse_pos()
            core.post(focus_on, (mouse.x - corner.x) * scale.x, (mouse.y - corner.y) * scale.y)
    return True


def mark_target(core: Core, corner: ImVec2, width: int, height: int) -> None:
    """A small ring about the turning point, while the user turns."""
    camera = core.view.camera(width, height)
    place = ImVec2(corner.x + camera.cx, corner.y + camera.cy)
    draw, radius = imgui.get_window_draw_list(), imgui.get_font_size() * 0.35
    draw.add_circle(place, radius, imgui.get_color_u32(ImVec4(0, 0, 0, 0.5)), 0, 3)
    draw.add_circle(place, radius, imgui.get_color_u32(ImVec4(1, 1, 1, 0.8)), 0, 1.5)


def draw_picture(core: Core, corner: ImVec2, width: int, height: int) -> None:
    picture = core.picture
    if picture is None:
        return
    core.backdrop.follow(core)
    camera, settings = core.accuracy.next_frame(core)
    try:
        drawn = core.depth_of_field.next_camera(core, camera, settings)
        picture.draw(drawn, settings, core.mode, edits=core.accuracy.edits(core), overlay=core.overlay)
    except InputError as error:
        # A mode or a size that needs more of the GPU than it has; told of once, though each frame tries.
        if core.undrawn != str(error):
            core.complain(f"{core.mode}: {error}")
        core.mode, core.undrawn = "splats", str(error)
        return
    core.undrawn = None
    texture = core.depth_of_field.shown(core) or picture.texture
    # Alpha is what the scene covers; the background is already in the colours, so it must not blend twice.
    texture.swizzle = "RGB1"
    exact = texture.size == core.picture_size
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST) if exact else (moderngl.LINEAR, moderngl.LINEAR)
    imgui.get_window_draw_list().add_image(
        imgui.ImTextureRef(texture.glo), corner, ImVec2(corner.x + width, corner.y + height)
    )


def steer_by_mouse(
    core: Core, corner: ImVec2, width: int, height: int, scale: ImVec2, *, left_is_free: bool = True
) -> None:
    """Drags that began on the picture, and the wheel and double clicks over it. Where the left button is
    not free a tool has it."""
    io = imgui.get_io()
    if imgui.is_item_active() and (io.mouse_delta.x or io.mouse_delta.y):
        dx, dy = io.mouse_delta.x, io.mouse_delta.y
        panning = imgui.is_mouse_down(_RIGHT) or imgui.is_mouse_down(_MIDDLE)
        # When flying, Shift is the fast gear of the keys.
        panning = panning or (left_is_free and io.key_shift and core.preferences.navigation != "fly")
        if panning:
            core.steer(pan(core.view, dx, dy, height=height))
        elif left_is_free and imgui.is_mouse_down(_LEFT):
            turn(core, io.mouse_pos.x - corner.x, io.mouse_pos.y - corner.y, dx, dy, width, height)
    if not imgui.is_item_hovered():
        return
    if left_is_free and imgui.is_mouse_double_clicked(_LEFT):
        x = (io.mouse_pos.x - corner.x) * scale.x
        y = (io.mouse_pos.y - corner.y) * scale.y
        core.post(focus_at, x, y)
    if io.mouse_wheel:
        notches = -io.mouse_wheel if core.preferences.invert_wheel else io.mouse_wheel
        if core.preferences.navigation == "fly":
            low, high = RANGES["fly_speed"]
            core.prefer(fly_speed=min(max(core.preferences.fly_speed * 1.2**notches, low), high))
            core.tell(f"Flying speed {core.preferences.fly_speed:.2g}")
        else:
            core.steer(dolly(core.view, WHEEL_STEP**notches))


def turn(core: Core, x: float, y: float, dx: float, dy: float, width: int, height: int) -> None:
    """A left drag that came to (x, y) by (dx, dy), in ImGui's units from the picture's corner."""
    radians = core.preferences.mouse_speed * ORBIT_SPEED / height
    match core.preferences.navigation:
        case "orbit":
            core.steer(orbit(core.view, dx * radians, dy * radians))
        case "fly":
            # The eye turns towards where the mouse goes, more gently through a long lens.
            pixel = core.preferences.mouse_speed * math.radians(core.view.lens.fov_y) / height
            core.steer(look(core.view, dx * pixel * LOOK_SPEED, -dy * pixel * LOOK_SPEED))
        case "trackball":
            half = min(width, height) / 2
            end = ((x - width / 2) / half, (y - height / 2) / half)
            start = (end[0] - dx / half, end[1] - dy / half)
            core.steer(trackball(core.view, start, end))


def steer_by_keys(core: Core) -> bool:
    """Flies while keys are held, in every mode; returns whether one is."""
    step = held_step()
    if step is None:
        return False
    radius = core.scene.radius if core.scene else core.view.distance
    seconds = min(imgui.get_io().delta_time, LONGEST_STEP)
    length = core.preferences.fly_speed * FLY_SPEED * radius * seconds
    if core.view.lens.orthographic:
        # Along parallel rays nothing comes nearer: they are drawn together instead.
        right, up, forward = step
        step = (right, up, 0.0)
        core.steer(dolly(core.view, math.exp(-forward * length / radius)))
    core.steer(move(core.view, [part * length for part in step]))
    return True
