"""The axis cross in the picture's corner: shows how the world lies, and turns to an axis on a click."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from .actions import ACTIONS
from .core import Core
from .navigation import AXIS_NAMES
from .navigation.framing import axis
from .panels import widgets
from .shortcuts import keys_of

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


def show(core: Core, corner: ImVec2) -> None:
    """Draws the cross with its top right corner at `corner`, screen coordinates."""
    em = imgui.get_font_size()
    arm, radius = ARM_EM * em, BALL_EM * em
    side = 2 * (arm + radius)
    imgui.set_cursor_screen_pos(ImVec2(corner.x - side, corner.y))
    clicked = imgui.invisible_button("axes", ImVec2(side, side))
    middle = ImVec2(corner.x - side / 2, corner.y + side / 2)
    ends = balls(core.view.R_camera_world, arm)
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
        core.post(ACTIONS[f"look_from_{hovered.name}"])


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
        draw.add_circle_filled(place, radius * 0.75, imgui.get_color_u32(ImVec4(0.1, 0.1, 0.11, 0.8)))
        draw.add_circle(place, radius * 0.75, colour, 0, radius * 0.18)
