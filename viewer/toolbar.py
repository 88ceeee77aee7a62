"""The tool bar on the picture's left edge, and the strip above the picture for the tool in hand and the
selection. Both are drawn over the picture, so that it keeps its size whatever is in hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from imgui_bundle import ImVec2, ImVec2Like, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.edit.operations.crop import ChangeCrop, DeleteCropped, RemoveCrop
from splatview.viewer import theme
from splatview.viewer.commands import COMMANDS, keys_of
from splatview.viewer.editing import commands
from splatview.viewer.editing.edit_session import TRANSFORM, EditSession
from splatview.viewer.editing.gizmos import KINDS
from splatview.viewer.editing.session import can_edit, post_edit, session_of
from splatview.viewer.editing.tool_state import (
    CROPPING,
    SELECTING,
    TRANSFORMING,
    Depth,
    Mode,
    ToolName,
    mode_of,
)
from splatview.viewer.editing.transform import choose_subject, finish, subjects_of
from splatview.viewer.panels import widgets
from splatview.viewer.panels.crops import KIND_NAMES
from splatview.viewer.state import AppState


class Tool(NamedTuple):
    """A button of the tool bar."""

    name: ToolName
    label: str
    icon: str
    """A letter of the icon font, or "rectangle", "lasso" or "sphere", which it lacks."""


GROUPS: tuple[tuple[Tool, ...], ...] = (
    (Tool("none", "Navigate", icons.ICON_FA_ARROW_POINTER),),
    (
        Tool("rectangle", "Rectangle", "rectangle"),
        Tool("brush", "Brush", icons.ICON_FA_PAINTBRUSH),
        Tool("lasso", "Lasso", "lasso"),
        Tool("polygon", "Polygon", icons.ICON_FA_DRAW_POLYGON),
        Tool("flood", "Magic wand", icons.ICON_FA_WAND_MAGIC_SPARKLES),
        Tool("colour", "Eyedropper", icons.ICON_FA_EYE_DROPPER),
    ),
    (
        Tool("move", "Move", icons.ICON_FA_UP_DOWN_LEFT_RIGHT),
        Tool("rotate", "Rotate", icons.ICON_FA_ROTATE),
        Tool("scale", "Scale", icons.ICON_FA_UP_RIGHT_AND_DOWN_LEFT_FROM_CENTER),
    ),
    (
        Tool("crop_box", "Crop box", icons.ICON_FA_CUBE),
        Tool("crop_sphere", "Crop sphere", "sphere"),
    ),
    (Tool("measure", "Measure", icons.ICON_FA_RULER),),
)
"""Tools from top to bottom, with gaps between the groups."""

TOOLS = tuple(tool for group in GROUPS for tool in group)

SIDE_EM, MARGIN_EM, GAP_EM = 1.9, 0.5, 0.45
"""Side of a button, distance from the picture's edge, and gap between groups, in font heights."""

GROUND = theme.OVERLAY
"""Colour behind what is drawn over the picture."""


def over_picture(app: AppState) -> None:
    """To be called in the picture's window, after the picture."""
    if app.panels_hidden or not can_edit(app):
        return
    em = imgui.get_font_size()
    corner, size = imgui.get_window_pos(), imgui.get_window_size()
    low = ImVec2(corner.x + MARGIN_EM * em, corner.y + MARGIN_EM * em)
    right = bar(app, low, size.y - 2 * MARGIN_EM * em)
    session = session_of(app)
    if session is not None:
        end = corner.x + size.x - (CORNER_EM if leaves_corner(size.x, size.y) else MARGIN_EM) * em
        strip(app, session, ImVec2(right + MARGIN_EM * em, low.y), end)


CORNER_EM = 7.0
"""Width of the picture's upper right corner that belongs to the axes, in font heights."""

SHORT_EM, WHOLE_EM = 3.0, 12.0
"""Widths beside the tool bar, in font heights, from which on there is room for the strip's buttons alone, and
for what they open otherwise."""


def leaves_corner(width: float, height: float) -> bool:
    """Whether a picture of this size, px, has room for the axes beside tool bar and strip."""
    em = imgui.get_font_size()
    _, columns, _ = cells(height - 2 * MARGIN_EM * em)
    taken = columns * round(SIDE_EM * em) + (2 * MARGIN_EM + SHORT_EM + CORNER_EM) * em
    return taken <= width


def cells(height: float) -> tuple[int, int, float]:
    """Rows and columns of the tools in `height` px, and the gap between groups."""
    em = imgui.get_font_size()
    side, gap, pad = round(SIDE_EM * em), round(GAP_EM * em), round(0.15 * em)
    if len(TOOLS) * side + (len(GROUPS) - 1) * gap + 2 * pad <= height:
        return len(TOOLS), 1, gap
    rows = max(int((height - 2 * pad) // side), 1)
    columns = math.ceil(len(TOOLS) / rows)
    return math.ceil(len(TOOLS) / columns), columns, 0


def bar(app: AppState, low: ImVec2, height: float) -> float:
    """The tools in one column, or in several where the picture is low; its right edge."""
    em, session = imgui.get_font_size(), session_of(app)
    side, pad = round(SIDE_EM * em), round(0.15 * em)
    rows, columns, gap = cells(height)
    bottom = rows * side + (len(GROUPS) - 1) * gap + 2 * pad
    draw = imgui.get_window_draw_list()
    high = ImVec2(low.x + columns * side + 2 * pad, low.y + bottom)
    draw.add_rect_filled(low, high, imgui.get_color_u32(GROUND), em * 0.3)
    row, column, y = 0, 0, low.y + pad
    for group in GROUPS:
        for tool in group:
            in_hand = session is not None and session.tool == tool.name
            chosen = in_hand or (session is None and tool.name == "none")
            place = ImVec2(low.x + pad + column * side, y)
            tool_button(app, tool, place, side, chosen=chosen)
            row, y = row + 1, y + side
            if row == rows and columns > 1:
                row, column, y = 0, column + 1, low.y + pad
        y += gap
    return high.x


def tool_button(app: AppState, tool: Tool, place: ImVec2, side: float, *, chosen: bool) -> None:
    command = COMMANDS[f"tool_{tool.name}"]
    lacks = command.lacks(app)
    imgui.set_cursor_screen_pos(place)
    imgui.begin_disabled(lacks != "")
    if imgui.invisible_button(f"tool {tool.label}", ImVec2(side, side)):
        app.post(command.run)
    hovered = imgui.is_item_hovered()
    imgui.end_disabled()
    widgets.command_tooltip(app, command.id, name=tool.label)
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    if chosen or hovered:
        fill = theme.CHOSEN if chosen else imgui.get_style_color_vec4(imgui.Col_.button_hovered)
        low, high = ImVec2(place.x + 1, place.y + 1), ImVec2(place.x + side - 1, place.y + side - 1)
        draw.add_rect_filled(low, high, imgui.get_color_u32(fill), em * 0.25)
    strength = 0.35 if lacks else 1.0 if chosen or hovered else 0.85
    ink = imgui.get_style_color_vec4(imgui.Col_.text)
    middle = ImVec2(place.x + side / 2, place.y + side / 2)
    draw_icon(tool.icon, middle, ImVec4(ink.x, ink.y, ink.z, strength))


def draw_icon(icon: str, middle: ImVec2, colour: ImVec4) -> None:
    draw, em = imgui.get_window_draw_list(), imgui.get_font_size()
    ink, thick = imgui.get_color_u32(colour), max(em * 0.11, 1.5)
    if icon == "lasso":
        radius = ImVec2(0.46 * em, 0.3 * em)
        loop = ImVec2(middle.x, middle.y - 0.12 * em)
        draw.add_ellipse(loop, radius, ink, 0, 0, thick)
        tail: list[ImVec2Like] = [
            ImVec2(middle.x - 0.22 * em, middle.y + 0.14 * em),
            ImVec2(middle.x - 0.3 * em, middle.y + 0.3 * em),
            ImVec2(middle.x - 0.12 * em, middle.y + 0.36 * em),
            ImVec2(middle.x - 0.2 * em, middle.y + 0.52 * em),
        ]
        draw.add_polyline(tail, ink, thick, 0)
    elif icon == "rectangle":
        x, y = 0.48 * em, 0.38 * em
        for start in (-1.0, -0.2, 0.6):
            for side in (-1, 1):
                a = ImVec2(middle.x + start * x, middle.y + side * y)
                draw.add_line(a, ImVec2(a.x + 0.4 * x, a.y), ink, thick)
        for start in (-1.0, -0.2, 0.6):
            for side in (-1, 1):
                a = ImVec2(middle.x + side * x, middle.y + start * y)
                draw.add_line(a, ImVec2(a.x, a.y + 0.4 * y), ink, thick)
    elif icon == "sphere":
        draw.add_circle(middle, 0.48 * em, ink, 0, thick)
        draw.add_ellipse(middle, ImVec2(0.48 * em, 0.17 * em), ink, 0, 0, thick * 0.8)
    else:
        size = imgui.calc_text_size(icon)
        draw.add_text(ImVec2(middle.x - size.x / 2, middle.y - size.y / 2), ink, icon)


def strip(app: AppState, session: EditSession, low: ImVec2, right: float) -> None:
    """Options of the tool in hand and what can be done with the selection, beside each other where there is
    room up to `right`, else below each other; where there is hardly any, buttons that open them."""
    em = imgui.get_font_size()
    viewport = imgui.get_main_viewport()
    short = right - low.x < WHOLE_EM * em
    end = viewport.work_pos.x + viewport.work_size.x if short else right
    groups: list[tuple[str, str, Callable[[], None]]] = []
    if session.tool != "none":
        options = partial(TOOL_OPTIONS[session.tool], app, session, end)
        groups.append(("tool", icons.ICON_FA_SLIDERS, options))
    if session.document.counts.selected:
        groups.append(("selection", icons.ICON_FA_SQUARE_CHECK, partial(selection, app, session, end)))
    if short:
        openers(groups, low)
        return
    place, bottom = ImVec2(low.x, low.y), low.y
    storage = imgui.get_state_storage()
    for name, _, contents in groups:
        key = imgui.get_id(f"{name} {session.tool} width")
        # Until it has been seen it gets a line of its own.
        width = storage.get_float(key, math.inf)
        if place.x > low.x and place.x + width > right:
            place = ImVec2(low.x, bottom + 0.4 * em)
        imgui.set_cursor_screen_pos(place)
        imgui.push_style_color(imgui.Col_.child_bg, GROUND)
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(0.5 * em, 0.2 * em))
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(0.4 * em, 0.2 * em))
        fit = imgui.ChildFlags_.auto_resize_x | imgui.ChildFlags_.auto_resize_y
        flags = imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.always_auto_resize
        still = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
        imgui.begin_child(f"##{name} strip", ImVec2(0, 0), fit | flags, still)
        contents()
        imgui.end_child()
        imgui.pop_style_var(2)
        imgui.pop_style_color()
        size = imgui.get_item_rect_size()
        storage.set_float(key, size.x)
        bottom = place.y + size.y
        place = ImVec2(place.x + size.x + 0.4 * em, place.y)


OPENER_TIPS = {
    "tool": "Options of the tool in hand.",
    "selection": "What is selected, and what can be done with it.",
}


def openers(groups: Sequence[tuple[str, str, Callable[[], None]]], low: ImVec2) -> None:
    """A button below another for each of the strip's parts, which opens it over the window."""
    side = SIDE_EM * imgui.get_font_size()
    imgui.push_style_color(imgui.Col_.button, GROUND)
    for number, (name, icon, contents) in enumerate(groups):
        place = ImVec2(low.x, low.y + number * (side + 2))
        imgui.set_cursor_screen_pos(place)
        if imgui.button(f"{icon}###open {name}", ImVec2(side, side)):
            imgui.open_popup(f"##{name} strip")
        widgets.tooltip(OPENER_TIPS[name])
        imgui.set_next_window_pos(ImVec2(place.x, place.y + side))
        if imgui.begin_popup(f"##{name} strip"):
            contents()
            imgui.end_popup()
    imgui.pop_style_color()


def follow(right: float, width: float) -> None:
    """Keeps an item `width` px wide on the line of the last one, where it ends before `right`."""
    spacing = imgui.get_style().item_spacing.x
    if imgui.get_item_rect_max().x + spacing + width + 0.5 * imgui.get_font_size() <= right:
        imgui.same_line()


def width_of(*labels: str) -> float:
    """Width of buttons with these labels, side by side."""
    padding = 2 * imgui.get_style().frame_padding.x
    return sum(imgui.calc_text_size(label).x + padding + 1 for label in labels)


def button(right: float, text: str, id: str, tip: str, pressed: Callable[[], object]) -> None:
    follow(right, width_of(text))
    widgets.button(f"{text}###{id}", tip, pressed)


def name(text: str) -> None:
    imgui.align_text_to_frame_padding()
    imgui.text_unformatted(text)


def choices(right: float, entries: Sequence[tuple[str, str, str]], chosen: str) -> str | None:
    """Buttons side by side, one of them bright: (value, label, tooltip) each. Which was clicked."""
    follow(right, width_of(*(label for _, label, _ in entries)))
    clicked = None
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(1, 0))
    for number, (value, label, tip) in enumerate(entries):
        if number:
            follow(right, width_of(label))
        bright = value == chosen
        if bright:
            imgui.push_style_color(imgui.Col_.button, theme.CHOSEN)
        if imgui.button(f"{label}###{value}"):
            clicked = value
        if bright:
            imgui.pop_style_color()
        widgets.tooltip(tip)
    imgui.pop_style_var()
    return clicked


MODES: tuple[tuple[Mode, str, str], ...] = (
    ("set", icons.ICON_FA_SQUARE, "Select these, and nothing else."),
    ("add", icons.ICON_FA_SQUARE_PLUS, "Add to the selection; so does Shift."),
    ("remove", icons.ICON_FA_SQUARE_MINUS, "Remove from the selection; so does Ctrl."),
    ("intersect", icons.ICON_FA_CLONE, "Keep what is common with the selection; so do Shift and Ctrl."),
)

DEPTHS: tuple[tuple[Depth, str, str], ...] = (
    ("through", "Through", "Take what lies behind the surface, too (T)."),
    ("front", "Front", "Take only the surface that is seen (T)."),
)


def selecting(app: AppState, session: EditSession, right: float) -> None:
    """Mode, radius or tolerance, and depth of a tool that selects."""
    name(next(tool.label for tool in TOOLS if tool.name == session.tool))
    io = imgui.get_io()
    held = mode_of(shift=io.key_shift, ctrl=io.key_ctrl)
    mode = choices(right, MODES, held if held != "set" else session.mode)
    if mode is not None:
        session.mode = next(entry[0] for entry in MODES if entry[0] == mode)
    em = imgui.get_font_size()
    if session.tool == "brush":
        follow(right, 7 * em)
        imgui.set_next_item_width(7 * em)
        log = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
        changed, radius = imgui.slider_float(
            "##radius", session.brush_radius, commands.LEAST_BRUSH, commands.MOST_BRUSH, "%.0f px", log
        )
        session.brush_radius = radius if changed else session.brush_radius
        keys = f"{keys_of('smaller_brush')} and {keys_of('larger_brush')}"
        widgets.tooltip(f"Radius of the brush in pixels ({keys}).")
    elif session.tool in ("flood", "colour"):
        follow(right, 7 * em)
        imgui.set_next_item_width(7 * em)
        log = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
        changed, tolerance = imgui.slider_float("##tolerance", session.tolerance, 0.005, 1.0, "%.3f", log)
        session.tolerance = tolerance if changed else session.tolerance
        widgets.tooltip("Tolerance: how far colours may be apart, as the eye sees it; black to white is 1.")
        return
    depth = choices(right, DEPTHS, session.depth)
    if depth is not None:
        session.depth = next(entry[0] for entry in DEPTHS if entry[0] == depth)


def transforming(app: AppState, session: EditSession, right: float) -> None:
    """What the handles move, and the way to keep or drop numbers that were typed."""
    name(next(tool.label for tool in TOOLS if tool.name == session.tool))
    subjects = subjects_of(session)
    if len(subjects) > 1:
        tips = {
            "file": "The handles are those of the file whose row on the Scene page is active.",
            "selection": "The handles are the selection's.",
            "scene": "The handles are those of all splats that are not locked.",
        }
        wide = 9 * imgui.get_font_size()
        entries = [(key, widgets.fitting(title, wide), tips[key]) for key, title in subjects]
        subject = choices(right, entries, session.subject)
        if subject is not None:
            post_edit(app, choose_subject, next(key for key, _ in subjects if key == subject))
        if (file := session.active_file) and session.subject == "file" and file.locked:
            follow(right, imgui.calc_text_size("locked").x)
            imgui.text_colored(theme.WARNING, "locked")
            widgets.tooltip("Unlock the file on the Scene page to transform it.")
    else:
        follow(right, imgui.calc_text_size("whole scene").x)
        imgui.text_colored(theme.QUIET, "whole scene")
        widgets.tooltip("Nothing is selected: select splats to transform them alone.")
    if session.forms.previewing == TRANSFORM and not session.forms.move.dragged:
        button(right, "Apply", "apply", "Keeps the numbers typed as a step.", partial(post_edit, app, finish))
        cancelled = partial(post_edit, app, EditSession.cancel_preview)
        button(right, "Cancel", "cancel", "Takes the preview back.", cancelled)


def cropping(app: AppState, session: EditSession, right: float) -> None:
    """What the handles of the crop do, what it keeps, and deleting what it cuts away."""
    crops = session.document.crops
    name(next(tool.label for tool in TOOLS if tool.name == session.tool))
    if not 0 <= session.forms.crop < len(crops):
        added = partial(app.post, commands.take_crop, session.tool)
        button(right, "Add", "add", "Adds one that fits the scene.", added)
        return
    tips = ("Handles that move the crop.", "Handles that rotate the crop.", "Handles that size the crop.")
    entries = [(kind, label, tip) for kind, label, tip in zip(KINDS, KIND_NAMES, tips, strict=True)]
    kind = choices(right, entries, KINDS[session.forms.crop_handles])
    if kind is not None:
        session.forms.crop_handles = KINDS.index(kind)
    crop = crops[session.forms.crop]
    keeps = (
        ("inside", "Inside", "Keep what is inside; the rest is cut away."),
        ("outside", "Outside", "Keep what is outside; the rest is cut away."),
    )
    keep = choices(right, keeps, crop.keep)
    if keep is not None and keep != crop.keep:
        changed = replace(crop, keep="inside" if keep == "inside" else "outside")
        post_edit(app, EditSession.apply, ChangeCrop(index=session.forms.crop, crop=changed))
    if session.target.at_rest:
        button(
            right,
            f"{icons.ICON_FA_CHECK}  Apply",
            "delete cropped",
            "Deletes what the crops cut away; undo brings it back.",
            partial(post_edit, app, EditSession.apply, DeleteCropped()),
        )
    button(
        right,
        icons.ICON_FA_XMARK,
        "remove crop",
        "Removes this crop; what it cut away is back.",
        partial(post_edit, app, EditSession.apply, RemoveCrop(index=session.forms.crop)),
    )


def measuring(app: AppState, session: EditSession, right: float) -> None:
    """The last distance, and the scene scaled so that it is a known one."""
    name("Measure")
    measured = session.measured
    if measured is None or session.picked:
        text = "click two points" if not session.picked else "click the second point"
        follow(right, imgui.calc_text_size(text).x)
        imgui.text_colored(theme.QUIET, text)
        return
    text = f"{measured.length:.5g} units"
    follow(right, imgui.calc_text_size(text).x)
    imgui.text_unformatted(text)
    if not session.target.at_rest:
        return
    width = 5 * imgui.get_font_size()
    follow(right, imgui.calc_text_size("is really").x + width)
    imgui.text_colored(theme.QUIET, "is really")
    imgui.same_line()
    imgui.set_next_item_width(width)
    entered, value = imgui.input_double(
        "##known length", measured.length, 0.0, 0.0, "%.5g", imgui.InputTextFlags_.enter_returns_true
    )
    widgets.tooltip("Type the true length and press Enter: the whole scene is scaled to it.")
    if entered and 0 < value < math.inf:
        app.post(commands.scale_to_length, value)


def ground(app: AppState, session: EditSession, right: float) -> None:
    name("Ground")
    text = f"click point {len(session.picked) + 1} of 3"
    follow(right, imgui.calc_text_size(text).x)
    imgui.text_colored(theme.QUIET, text)


TOOL_OPTIONS: dict[ToolName, Callable[[AppState, EditSession, float], None]] = {
    **dict.fromkeys(SELECTING, selecting),
    **dict.fromkeys(TRANSFORMING, transforming),
    **dict.fromkeys(CROPPING, cropping),
    "measure": measuring,
    "ground": ground,
}

ACTIONS = (
    ("delete", icons.ICON_FA_TRASH),
    ("hide", icons.ICON_FA_EYE_SLASH),
    ("isolate", icons.ICON_FA_EXPAND),
    ("select_inverse", icons.ICON_FA_CIRCLE_HALF_STROKE),
    ("duplicate", icons.ICON_FA_COPY),
    ("split", icons.ICON_FA_FILE_EXPORT),
)
"""Commands on the selection."""


def selection(app: AppState, session: EditSession, right: float) -> None:
    name(f"{session.document.counts.selected:,} selected")
    for number, (id, icon) in enumerate(ACTIONS):
        if number == 1:
            imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(1, imgui.get_style().item_spacing.y))
        follow(right, width_of(icon))
        command = COMMANDS[id]
        lacks = command.lacks(app)
        imgui.begin_disabled(lacks != "")
        if imgui.button(f"{icon}###{id}"):
            app.post(command.run)
        imgui.end_disabled()
        widgets.command_tooltip(app, id)
    imgui.pop_style_var()
