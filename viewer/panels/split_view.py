"""Exact beside chosen over the picture, with the line to drag, and the badge of what is left out."""

from __future__ import annotations

import moderngl
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.viewer import theme
from splatview.viewer.quality.state import Accuracy
from splatview.viewer.state import AppState

REACH = 0.5
"""Distance in font heights within which the mouse takes hold of the line."""

LEFT_NAME = "exact"
RIGHT_NAMES = {"chosen": "by the shortcuts", "signed": "difference", "perceptual": "FLIP"}


def drag_line(app: AppState, corner: ImVec2, width: int) -> bool:
    """Moves the line; to be called after the picture's button. Whether the mouse is the line's."""
    comparing = app.feature(Accuracy).comparing
    if comparing.right == "off":
        return False
    mouse, place = imgui.get_mouse_pos(), corner.x + comparing.line * width
    near = imgui.is_item_hovered() and abs(mouse.x - place) <= REACH * imgui.get_font_size()
    if near and imgui.is_mouse_clicked(imgui.MouseButton_.left):
        comparing.dragging = True
    comparing.dragging = comparing.dragging and imgui.is_item_active()
    if comparing.dragging:
        comparing.line = min(max((mouse.x - corner.x) / max(width, 1), 0.02), 0.98)
    if near or comparing.dragging:
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    return comparing.dragging


def draw_split(app: AppState, corner: ImVec2, width: int, height: int) -> None:
    """Over the picture just drawn: both sides where this view has been compared, and the line."""
    accuracy = app.feature(Accuracy)
    comparing = accuracy.comparing
    if comparing.right == "off":
        return
    compared = comparing.want(app, accuracy.plan(app), accuracy.wake)
    draw, place = imgui.get_window_draw_list(), comparing.line
    middle, low = corner.x + place * width, corner.y + height
    if compared is not None:
        left, right = comparing.textures(app.picture.texture.ctx, compared)
        for texture in (left, right):
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        draw.add_image(
            imgui.ImTextureRef(left.glo), corner, ImVec2(middle, low), ImVec2(0, 0), ImVec2(place, 1)
        )
        draw.add_image(
            imgui.ImTextureRef(right.glo),
            ImVec2(middle, corner.y),
            ImVec2(corner.x + width, low),
            ImVec2(place, 0),
            ImVec2(1, 1),
        )
    white, dark = imgui.get_color_u32(ImVec4(1, 1, 1, 0.9)), imgui.get_color_u32(ImVec4(0, 0, 0, 0.5))
    draw.add_line(ImVec2(middle, corner.y), ImVec2(middle, low), dark, 3)
    draw.add_line(ImVec2(middle, corner.y), ImVec2(middle, low), white, 1)
    edge = imgui.get_font_size() * 0.5
    half = ImVec2(middle, corner.y + height / 2)
    draw.add_circle_filled(half, edge, white)
    # Above the badges, which may be as wide as the picture.
    low -= len(badge_lines(app)) * BADGE_EM * imgui.get_font_size()
    if compared is None:
        caption("comparing when the view rests", ImVec2(middle + edge, low - 4 * edge))
        return
    size = imgui.calc_text_size(LEFT_NAME)
    caption(LEFT_NAME, ImVec2(middle - size.x - 3 * edge, low - 4 * edge))
    caption(
        f"{RIGHT_NAMES[comparing.right]}, largest error {compared.largest:.2g}",
        ImVec2(middle + edge, low - 4 * edge),
    )


def caption(text: str, low: ImVec2, colour: ImVec4 | None = None) -> None:
    """On a dark ground, its upper left corner at `low`."""
    edge, size = imgui.get_font_size() * 0.3, imgui.calc_text_size(text)
    draw = imgui.get_window_draw_list()
    high = ImVec2(low.x + size.x + 2 * edge, low.y + size.y + 2 * edge)
    draw.add_rect_filled(low, high, imgui.get_color_u32(theme.OVERLAY), edge)
    ink = imgui.get_color_u32(colour or theme.QUIET)
    draw.add_text(ImVec2(low.x + edge, low.y + edge), ink, text)


BADGE_EM = 1.9
"""Height of a badge with the gap below it, in font heights."""


def badge_lines(app: AppState) -> list[tuple[str, ImVec4]]:
    """Badges of the reductions and shortcuts in force, chosen or by the budget, from the lowest up."""
    accuracy = app.feature(Accuracy)
    lines = []
    if app.picture.note:
        lines.append((f"moving: {app.picture.note}", theme.QUIET))
    if accuracy.note:
        lines.append((f"moving: {accuracy.note}", theme.QUIET))
    if accuracy.choices:
        taken = ", ".join(f"{name} {value}" for name, value in accuracy.choices.items())
        lines.append((f"shortcut: {taken}{present_error(app)}", theme.WARNING))
    return lines


def badges(app: AppState, at: ImVec2) -> None:
    """Those badges, upwards from `at`."""
    height = BADGE_EM * imgui.get_font_size()
    for number, (text, colour) in enumerate(badge_lines(app), 1):
        caption(text, ImVec2(at.x, at.y - number * height), colour)


def present_error(app: AppState) -> str:
    """Error of the shortcut taken, where it is the only one and was measured."""
    accuracy = app.feature(Accuracy)
    if accuracy.ladder is None or len(accuracy.choices) != 1:
        return ""
    ((name, value),) = accuracy.choices.items()
    for one in accuracy.ladder.rungs:
        if (one.rung.knob, one.rung.value) == (name, value):
            if one.elsewhere:
                worst, views = min([one.psnr, *one.elsewhere]), 1 + len(one.elsewhere)
                return f", {worst:.1f} dB at worst in {views} views"
            return f", {one.psnr:.1f} dB, largest error {one.max_error:.2g} in the view measured"
    return ""
