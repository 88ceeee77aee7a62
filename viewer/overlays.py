"""Overlays of the picture: axis cross, cameras, navigation and visual mode, badges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.renderers import MODES
from splatview.scene import Camera
from splatview.scene.errors import printable
from splatview.scene.image_model import NEAR
from splatview.viewer import theme, toolbar
from splatview.viewer.camera import go_to_camera
from splatview.viewer.commands import COMMANDS, NAVIGATION_MODES, keys_of, set_mode
from splatview.viewer.depth_of_field import DepthOfField
from splatview.viewer.editing.session import session_of
from splatview.viewer.navigation import AXIS_NAMES
from splatview.viewer.navigation.controllers import axis
from splatview.viewer.panels import recipe, split_view, widgets
from splatview.viewer.panels.camera import NAVIGATION_NAMES
from splatview.viewer.panels.rendering import MODE_TIP
from splatview.viewer.preferences import NavigationMode
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining
from splatview.viewer.view_aids import show_legend

ARM_EM, BALL_EM = 2.3, 0.62
"""Length of an arm and radius of the ball at its end, in font heights."""

COLOURS = {"X": (0.90, 0.38, 0.36), "Y": (0.48, 0.76, 0.36), "Z": (0.36, 0.58, 0.94)}


@dataclass(frozen=True)
class Ball:
    """The end of one half axis."""

    name: str
    x: float
    """Px to the right of the cross's middle."""
    y: float
    """Px below it."""
    depth: float
    """Away from the eye, -1 to 1."""


def balls(R_camera_world: np.ndarray, arm: float) -> list[Ball]:
    """The six ends for a view's rotation (3, 3), farthest first."""
    ends = []
    for name in AXIS_NAMES:
        x, y, depth = R_camera_world @ axis(name)
        ends.append(Ball(name, float(x * arm), float(y * arm), float(depth)))
    return sorted(ends, key=lambda ball: -ball.depth)


def ball_at(ends: list[Ball], x: float, y: float, radius: float) -> Ball | None:
    """The nearest ball that is under (x, y) px from the middle; the front one where two overlap."""
    under = [ball for ball in ends if (ball.x - x) ** 2 + (ball.y - y) ** 2 <= radius**2]
    return under[-1] if under else None


def show_axis_gizmo(app: AppState, corner: ImVec2) -> None:
    """Draws the cross with its top right corner at `corner`, screen coordinates."""
    em = imgui.get_font_size()
    arm, radius = ARM_EM * em, BALL_EM * em
    side = 2 * (arm + radius)
    imgui.set_cursor_screen_pos(ImVec2(corner.x - side, corner.y))
    clicked = imgui.invisible_button("axes", ImVec2(side, side))
    middle = ImVec2(corner.x - side / 2, corner.y + side / 2)
    ends = balls(app.view.R_camera_world, arm)
    hovered = None
    if imgui.is_item_hovered():
        mouse = imgui.get_mouse_pos()
        hovered = ball_at(ends, mouse.x - middle.x, mouse.y - middle.y, radius * 1.2)
        if hovered:
            widgets.tooltip(f"Look from {hovered.name} ({keys_of(f'look_from_{hovered.name}')})")
    draw = imgui.get_window_draw_list()
    for ball in ends:
        draw_ball(draw, middle, ball, radius, bright=ball is hovered)
    if clicked and hovered:
        app.post(COMMANDS[f"look_from_{hovered.name}"].run)


def draw_ball(draw: imgui.ImDrawList, middle: ImVec2, ball: Ball, radius: float, *, bright: bool) -> None:
    sign, letter = ball.name
    # What points away from the eye is dimmer, so that the cross reads as solid.
    light = 1.0 if bright else 0.85 - 0.3 * (ball.depth + 1) / 2
    r, g, b = COLOURS[letter]
    colour = imgui.get_color_u32(ImVec4(r * light, g * light, b * light, 1))
    place = ImVec2(middle.x + ball.x, middle.y + ball.y)
    if sign == "+":
        draw.add_line(middle, place, colour, radius * 0.22)
        draw.add_circle_filled(place, radius, colour)
        size = imgui.calc_text_size(letter)
        ink = imgui.get_color_u32(ImVec4(0.08, 0.08, 0.09, 1))
        draw.add_text(ImVec2(place.x - size.x / 2, place.y - size.y / 2), ink, letter)
    else:
        draw.add_circle_filled(place, radius * 0.75, imgui.get_color_u32(theme.OVERLAY))
        draw.add_circle(place, radius * 0.75, colour, 0, radius * 0.18)


SIZE = 0.06
"""Depth of a pyramid in scene radii."""

PHOTO_SIZE = 0.03
"""The same of photos in training, which are mostly many and near."""

EDGES = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)])
"""Between the eye (0) and the picture's corners (1 to 4, going round)."""

MOST = 1000
"""Pyramids drawn at most: a video's every frame would be a carpet, and slow."""

WIDEST = 2.0
"""Slope of a pyramid's sides at most where the camera has a lens: a fisheye's pyramid would be flat."""

GRAB = 0.4
"""Font heights from a line within which the mouse is on its camera."""


def shown_training(app: AppState) -> LiveTraining | None:
    """The training whose photos' cameras are the loaded ones."""
    training = app.find(LiveTraining)
    return training if training is not None and app.cameras is training.cameras else None


def shows_cameras(app: AppState) -> bool:
    """Whether the loaded cameras, or those of the photos in training, are to be drawn."""
    if shown_training(app) is not None:
        return app.preferences.show_photos
    return app.preferences.show_cameras and bool(app.cameras)


def show_frusta(app: AppState, corner: ImVec2) -> None:
    """Draws the pyramids over the picture whose top left is at `corner`, screen coordinates; a click on
    one goes to its camera."""
    scale = imgui.get_io().display_framebuffer_scale
    radius = app.scene.radius if app.is_open else app.view.distance
    step = -(-len(app.cameras) // MOST)
    training = shown_training(app)
    size = radius * (SIZE if training is None else PHOTO_SIZE)
    drawn = pyramids(app.cameras[::step], app.camera, size)
    lines = [pixels / (scale.x, scale.y) + (corner.x, corner.y) for _, pixels in drawn]
    mouse = imgui.get_mouse_pos()
    under = nearest(lines, (mouse.x, mouse.y), GRAB * imgui.get_font_size()) if may_point(app) else None
    draw = imgui.get_window_draw_list()
    for place, (index, _) in enumerate(drawn):
        index *= step
        if index == app.camera_index or place == under:
            colour = ImVec4(*theme.ACCENT, 1)
        elif training is not None and training.photos[index].held_out:
            colour = ImVec4(*theme.HELD_OUT, 0.75)
        else:
            colour = ImVec4(1, 1, 1, 0.55)
        ink, weight = imgui.get_color_u32(colour), 2.0 if place == under else 1.0
        for (x0, y0), (x1, y1) in lines[place].tolist():
            draw.add_line(ImVec2(x0, y0), ImVec2(x1, y1), ink, weight)
    if under is None:
        return
    index = drawn[under][0] * step
    held_out = " (held out)" if training is not None and training.photos[index].held_out else ""
    imgui.set_tooltip(printable(f"{app.cameras[index].name or f'Camera {index + 1}'}{held_out}"))
    dragged = imgui.get_mouse_drag_delta(imgui.MouseButton_.left)
    if imgui.is_mouse_released(imgui.MouseButton_.left) and not (dragged.x or dragged.y):
        app.post(go_to_camera, index)


def may_point(app: AppState) -> bool:
    """Whether the mouse is over the picture itself, turns nothing and holds no tool."""
    session = session_of(app)
    if session is not None and session.tool != "none":
        return False
    dragged = imgui.get_mouse_drag_delta(imgui.MouseButton_.left)
    return imgui.is_window_hovered() and not (dragged.x or dragged.y)


def nearest(lines: Sequence[np.ndarray], place: tuple[float, float], reach: float) -> int | None:
    """Which of the bundles of lines, each (L, 2, 2) px, comes nearest to `place`; None beyond `reach` px."""
    if not lines:
        return None
    ends = np.stack(lines)  # (B, L, 2, 2)
    start, along = ends[:, :, 0], ends[:, :, 1] - ends[:, :, 0]
    length = np.maximum((along**2).sum(axis=-1), 1e-12)
    share = np.clip(((place - start) * along).sum(axis=-1) / length, 0, 1)
    apart = np.linalg.norm(start + share[..., None] * along - place, axis=-1).min(axis=1)
    best = int(np.argmin(apart))
    return best if apart[best] <= reach else None


def pyramids(cameras: Sequence[Camera], seen_by: Camera, size: float) -> list[tuple[int, np.ndarray]]:
    """(index, lines (8, 2, 2) px in `seen_by`'s picture) of every camera that is wholly before the eye.

    `size` is the depth of a pyramid, world units.
    """
    found = []
    for index, camera in enumerate(cameras):
        own = np.concatenate([np.zeros((1, 3)), size * picture_corners(camera, size)])
        # By way of the difference of the eyes, so that scenes far from the origin do not jitter.
        points = own @ camera.R_world_camera.T + (camera.eye - seen_by.eye)
        t = points @ seen_by.R_camera_world.T
        if not (t[:, 2] >= NEAR).all():
            continue
        pixels = seen_by.image_points(t)
        if np.isfinite(pixels).all():
            found.append((index, pixels[EDGES]))
    return found


def picture_corners(camera: Camera, size: float) -> np.ndarray:
    """(4, 3): where the picture's corners are `size` ahead, in camera axes and units of `size`."""
    if camera.orthographic:
        w, h = camera.width, camera.height
        return camera.points_at([(0, 0), (w, 0), (w, h), (0, h)], size) / size
    left, top, right, bottom = camera.visible_slopes
    if camera.lens is not None:
        left, top, right, bottom = np.clip((left, top, right, bottom), -WIDEST, WIDEST)
    return np.array([(left, top, 1), (right, top, 1), (right, bottom, 1), (left, bottom, 1)])


def over_picture(app: AppState) -> None:
    """The tools in the picture's corner, where it is wide enough, and a welcome where nothing is open."""
    corner = imgui.get_window_pos()
    if shows_cameras(app):
        show_frusta(app, corner)
    margin = imgui.get_font_size() * 0.6
    width = imgui.get_window_width()
    right = corner.x + width - margin
    if app.panels_hidden or toolbar.leaves_corner(width, imgui.get_window_height()):
        show_axis_gizmo(app, ImVec2(right, corner.y + margin))
        below_axes = corner.y + 2 * margin + 2 * (ARM_EM + BALL_EM) * imgui.get_font_size()
        view_buttons(app, ImVec2(right, below_axes), corner.y + imgui.get_window_height())
    left = corner.x + margin + TOOLS_EM * imgui.get_font_size()
    if app.picture.status:
        imgui.set_cursor_screen_pos(ImVec2(left, corner.y + 5 * margin + imgui.get_font_size()))
        imgui.begin_group()
        imgui.text_colored(theme.WARNING, app.picture.status)
        imgui.progress_bar(-imgui.get_time(), (imgui.calc_text_size(app.picture.status).x, margin), "")
        imgui.end_group()
    lowest = corner.y + imgui.get_window_height() - margin
    split_view.badges(app, ImVec2(left, lowest))
    if text := app.feature(DepthOfField).badge:
        size, line = imgui.calc_text_size(text), imgui.get_font_size()
        split_view.caption(text, ImVec2(corner.x + width - margin - size.x - 0.6 * line, lowest - 1.9 * line))
    show_legend(
        app, corner.x + width - margin, lowest - 2.5 * margin, imgui.get_window_height() - 10 * margin
    )
    waiting = recipe.waiting_note(app)
    if waiting:
        note_below(f"{waiting} {keys_of('cancel')} lets go.")
    if not app.is_open and app.loading is None:
        text = f"Drop a scene here, or press {keys_of('open')}"
        size, area = imgui.calc_text_size(text), imgui.get_window_size()
        place = ImVec2(corner.x + (area.x - size.x) / 2, corner.y + (area.y - size.y) / 2)
        imgui.set_cursor_screen_pos(place)
        imgui.text_colored(theme.QUIET, text)


def note_below(text: str) -> None:
    """In the middle of the picture's lower edge, wrapped where it is narrow."""
    corner, area = imgui.get_window_pos(), imgui.get_window_size()
    edge = imgui.get_font_size() * 0.4
    room = max(area.x - 6 * edge, 1.0)
    size = imgui.calc_text_size(text, wrap_width=room)
    low = ImVec2(corner.x + (area.x - size.x) / 2, corner.y + area.y - size.y - 5 * edge)
    high = ImVec2(low.x + size.x + edge, low.y + size.y + edge)
    draw = imgui.get_window_draw_list()
    ground = imgui.get_color_u32(theme.OVERLAY)
    draw.add_rect_filled(ImVec2(low.x - edge, low.y - edge), high, ground, edge)
    font, ink = imgui.get_font(), imgui.get_color_u32(theme.WARNING)
    draw.add_text(font, imgui.get_font_size(), low, ink, text, wrap_width=room)


NAVIGATION_ICONS: dict[NavigationMode, str] = {
    "orbit": icons.ICON_FA_ARROWS_SPIN,
    "fly": icons.ICON_FA_PAPER_PLANE,
    "trackball": icons.ICON_FA_GLOBE,
}

TOOLS_EM = 2.7
"""Width that the tool bar takes at the left edge, in font heights."""


def view_buttons(app: AppState, corner: ImVec2, bottom: float) -> None:
    """The navigation mode and the visual mode, as wide as the axes above them; top right at `corner`.

    What does not end above `bottom` is left to the View page and the keys.
    """
    em = imgui.get_font_size()
    wide = 2 * (ARM_EM + BALL_EM) * em
    if corner.y + 1.6 * em > bottom:
        return
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(1, 2))
    imgui.set_cursor_screen_pos(ImVec2(corner.x - wide, corner.y))
    side = (wide - len(NAVIGATION_MODES) + 1) / len(NAVIGATION_MODES)
    for i, mode in enumerate(NAVIGATION_MODES):
        if i:
            imgui.same_line()
        chosen = app.preferences.navigation == mode
        fill = theme.CHOSEN if chosen else theme.OVERLAY
        imgui.push_style_color(imgui.Col_.button, fill)
        if imgui.button(f"{NAVIGATION_ICONS[mode]}###{NAVIGATION_NAMES[mode]}", ImVec2(side, 1.6 * em)):
            app.post(COMMANDS[f"navigate_{mode}"].run)
        imgui.pop_style_color()
        widgets.command_tooltip(app, f"navigate_{mode}")
    if corner.y + 1.8 * em + imgui.get_frame_height() <= bottom:
        imgui.set_cursor_screen_pos(ImVec2(corner.x - wide, corner.y + 1.8 * em))
        mode_chooser(app, wide)
    imgui.pop_style_var()


def mode_chooser(app: AppState, width: float) -> None:
    """A small list of the visual modes; bright where it is not the picture itself."""
    usual = app.mode == "splats"
    fill = theme.OVERLAY if usual else theme.CHOSEN
    imgui.push_style_color(imgui.Col_.frame_bg, fill)
    imgui.push_style_color(imgui.Col_.button, fill)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(0.35 * imgui.get_font_size(), 3))
    imgui.set_next_item_width(width)
    modes = list(MODES.values())
    changed, index = imgui.combo("##mode", list(MODES).index(app.mode), [mode.label for mode in modes])
    imgui.pop_style_var()
    imgui.pop_style_color(2)
    widgets.tooltip(MODE_TIP)
    if changed:
        app.post(set_mode, modes[index].name)
