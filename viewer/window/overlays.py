"""What lies over the picture, and the status bar under it."""

from __future__ import annotations

from imgui_bundle import ImVec2, ImVec4, imgui

from . import frusta, gizmo, theme
from .accuracy import on_picture
from .actions import NAVIGATION_MODES, VISUAL_MODES, set_mode
from .core import Core
from .panels import widgets
from .panels.camera import NAVIGATION_NAMES
from .panels.rendering import MODE_NAMES, MODE_TIP
from .shortcuts import keys_of
from .training import rules

HINTS = {
    "orbit": "Drag: orbit   Right drag: pan   Wheel: zoom   Double click: turn about   F1: keys",
    "fly": "Drag: look   W A S D E Q: move   Wheel: speed   Shift: fast   F1: keys",
    "trackball": "Drag: turn   Right drag: pan   Wheel: zoom   Double click: turn about   F1: keys",
}


def over_picture(core: Core) -> None:
    """The tools in the picture's corner, and a welcome where nothing is open."""
    corner = imgui.get_window_pos()
    if frusta.wanted(core):
        frusta.show(core, corner)
    margin = imgui.get_font_size() * 0.6
    imgui.set_cursor_screen_pos(ImVec2(corner.x + margin, corner.y + margin))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(2, 2))
    for i, mode in enumerate(NAVIGATION_MODES):
        if i:
            imgui.same_line()
        chosen = core.preferences.navigation == mode
        fill = ImVec4(*theme.ACCENT, 0.75) if chosen else ImVec4(0.1, 0.1, 0.11, 0.7)
        imgui.push_style_color(imgui.Col_.button, fill)
        widgets.action_button(core, NAVIGATION_NAMES[mode], f"navigate_{mode}")
        imgui.pop_style_color()
    imgui.pop_style_var()
    imgui.same_line()
    mode_chooser(core)
    width = imgui.get_window_width()
    gizmo.show(core, ImVec2(corner.x + width - margin, corner.y + margin))
    if core.picture is not None and core.picture.status:
        imgui.set_cursor_screen_pos(ImVec2(corner.x + margin, corner.y + 4 * margin + imgui.get_font_size()))
        imgui.begin_group()
        imgui.text_colored(theme.WARNING, core.picture.status)
        imgui.progress_bar(-imgui.get_time(), (imgui.calc_text_size(core.picture.status).x, margin), "")
        imgui.end_group()
    if core.picture is not None and core.picture.note:
        badge(core.picture.note, ImVec2(corner.x + margin, corner.y + imgui.get_window_height() - margin))
    lowest = corner.y + imgui.get_window_height() - margin
    moving = core.picture is not None and bool(core.picture.note)
    on_picture.badges(core, ImVec2(corner.x + margin, lowest - moving * 2 * imgui.get_font_size()))
    if text := core.depth_of_field.badge:
        size, line = imgui.calc_text_size(text), imgui.get_font_size()
        on_picture.caption(text, ImVec2(corner.x + width - margin - size.x - 0.6 * line, lowest - 1.9 * line))
    waiting = rules.waiting_note(core)
    if waiting:
        note_below(f"{waiting} {keys_of('cancel')} lets go.")
    if core.scene is None and core.loading is None:
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
    ground = imgui.get_color_u32(ImVec4(0.1, 0.1, 0.11, 0.8))
    draw.add_rect_filled(ImVec2(low.x - edge, low.y - edge), high, ground, edge)
    font, ink = imgui.get_font(), imgui.get_color_u32(theme.WARNING)
    draw.add_text(font, imgui.get_font_size(), low, ink, text, wrap_width=room)


def badge(note: str, at: ImVec2) -> None:
    """What the picture leaves out while it moves, over its lower left corner `at`."""
    text = f"moving: {note}"
    size, edge = imgui.calc_text_size(text), imgui.get_font_size() * 0.3
    draw = imgui.get_window_draw_list()
    low = ImVec2(at.x, at.y - size.y - 2 * edge)
    draw.add_rect_filled(
        low, ImVec2(at.x + size.x + 2 * edge, at.y), imgui.get_color_u32(ImVec4(0.1, 0.1, 0.11, 0.7)), edge
    )
    draw.add_text(ImVec2(low.x + edge, low.y + edge), imgui.get_color_u32(theme.QUIET), text)


def mode_chooser(core: Core) -> None:
    """What is shown, as one small list; bright where it is not the picture itself."""
    usual = core.mode == "splats"
    fill = ImVec4(0.1, 0.1, 0.11, 0.7) if usual else ImVec4(*theme.ACCENT, 0.75)
    imgui.push_style_color(imgui.Col_.frame_bg, fill)
    imgui.push_style_color(imgui.Col_.button, ImVec4(0, 0, 0, 0))
    imgui.set_next_item_width(imgui.get_font_size() * 7)
    names = [MODE_NAMES[mode] for mode in VISUAL_MODES]
    changed, index = imgui.combo("##mode", VISUAL_MODES.index(core.mode), names)
    imgui.pop_style_color(2)
    widgets.tooltip(MODE_TIP)
    if changed:
        core.post(set_mode, VISUAL_MODES[index])


def status_bar(core: Core) -> None:
    if core.messages:
        latest = core.messages[-1]
        if latest.error:
            imgui.text_colored(theme.ERROR, latest.text)
        else:
            imgui.text_unformatted(latest.text)
    imgui.same_line()
    hint = HINTS[core.preferences.navigation]
    start = imgui.get_window_width() - imgui.calc_text_size(hint).x - imgui.get_font_size()
    if start < imgui.get_cursor_pos_x():
        imgui.new_line()
        return
    imgui.same_line(start)
    imgui.text_colored(theme.QUIET, hint)
