"""Controls as all panels have them: label on the left, control on the right, a tooltip on both."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.scene.errors import printable
from splatview.viewer import theme
from splatview.viewer.commands import COMMANDS, keys_of
from splatview.viewer.state import AppState

Choice = TypeVar("Choice", bound=str)

Triple = tuple[float, float, float]

LABEL_SHARE = 0.38
"""Share of a panel's width for labels."""

VALUE_EM = 3.6
"""Width of a slider's value, in font heights."""

DRAG_PX = 300
"""Pixels in which a drag on a slider's value goes through its range."""

VECTOR_LABEL_SHARE = 0.25
"""Share of a panel's width for labels beside three numbers."""


def item(text: str, id: object) -> str:
    """A label that shows `text`, whatever it holds, for selectables and menus; told from others by `id`."""
    return f"{printable(text).replace('##', '# #')}##{printable(str(id))}"


def label(text: str, tip: str, *, share: float = LABEL_SHARE) -> None:
    """Begins a row: `text` on the left, in its `share` of the width; the next control fills the rest."""
    width = imgui.get_content_region_avail().x
    start = imgui.get_cursor_pos_x()
    imgui.align_text_to_frame_padding()
    imgui.text(text)
    tooltip(tip)
    imgui.same_line(start + width * share)
    imgui.set_next_item_width(-1)


def tooltip(tip: str, *, hovered: bool | None = None) -> None:
    """Tooltip of the last item, after a short rest on it, or where the mouse is known to be."""
    if hovered is None:
        hovered = bool(tip) and imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip)
    if not tip or not hovered:
        return
    text, wide = printable(tip, keep="\n"), imgui.get_font_size() * 24
    keep_clear(text, wide)
    if imgui.begin_tooltip():
        imgui.push_text_wrap_pos(wide)
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        imgui.end_tooltip()


def keep_clear(text: str, wide: float) -> None:
    """Places the next tooltip, of this text, below or above the last item, so as not to cover it."""
    low, high, em = imgui.get_item_rect_min(), imgui.get_item_rect_max(), imgui.get_font_size()
    if high.y - low.y > 6 * em:
        return  # a picture or a plot: beside the mouse
    padding, screen = imgui.get_style().window_padding, imgui.get_main_viewport()
    size = imgui.calc_text_size(text, wrap_width=wide)
    size = ImVec2(size.x + 2 * padding.x, size.y + 2 * padding.y)
    bottom, right = screen.pos.y + screen.size.y, screen.pos.x + screen.size.x
    x = max(min(imgui.get_mouse_pos().x + 0.8 * em, right - size.x), screen.pos.x)
    gap = 0.3 * em
    y = high.y + gap if high.y + gap + size.y <= bottom else low.y - gap - size.y
    imgui.set_next_window_pos(ImVec2(x, max(y, screen.pos.y)))


def fitting(text: str, room: float) -> str:
    """`text` with an ellipsis where it is wider than `room`."""
    if imgui.calc_text_size(text).x <= room:
        return text
    low, high = 0, len(text)
    while low < high:
        middle = (low + high + 1) // 2
        if imgui.calc_text_size(f"{text[:middle].rstrip()}...").x <= room:
            low = middle
        else:
            high = middle - 1
    return f"{text[:low].rstrip()}..." if low else ""


def progress(share: float, text: str, *, beside_em: float) -> None:
    """A progress bar with as much of `text` as fits; so many font heights are left to what is beside it."""
    room = imgui.get_content_region_avail().x - beside_em * imgui.get_font_size()
    imgui.progress_bar(share, (room, 0), fitting(text, room - imgui.get_font_size()))


def slider(
    name: str,
    value: float,
    low: float,
    high: float,
    tip: str,
    *,
    form: str = "%.2f",
    logarithmic: bool = False,
) -> float | None:
    """A row with a slider, and beside it, where no grab hides it, the value to read or to type; the new one
    where the user changed it."""
    label(name, tip)
    room, spacing = imgui.get_content_region_avail().x, imgui.get_style().item_inner_spacing.x
    number = min(imgui.get_font_size() * VALUE_EM, room / 2)
    flags = imgui.SliderFlags_.always_clamp | (imgui.SliderFlags_.logarithmic if logarithmic else 0)
    imgui.set_next_item_width(room - number - spacing)
    slid, new = imgui.slider_float(f"##{name}", value, low, high, "", flags)
    tooltip(tip)
    imgui.same_line(0, spacing)
    imgui.set_next_item_width(number)
    typed, exact = imgui.drag_float(f"##{name} value", value, (high - low) / DRAG_PX, low, high, form, flags)
    tooltip(tip)
    if slid and (digits := re.match(r"%\.?\d*[fg]", form)):
        new = float(digits[0] % new)
    return exact if typed else new if slid else None


def stepped(name: str, value: float, low: float, high: float, tip: str) -> float | None:
    """A row with a whole number and steps down and up; the new one where the user changed it."""
    label(name, tip)
    changed, new = imgui.input_int(f"##{name}", round(value), 1, 4, imgui.InputTextFlags_.enter_returns_true)
    tooltip(tip)
    new = float(min(max(new, low), high))
    return new if changed and new != value else None


def vector(name: str, values: Triple, speed: float, tip: str, *, form: str = "%.4g") -> Triple | None:
    """A row with three finite numbers to type or to drag, by `speed` a pixel; where the user changed them
    the new ones. They keep all their digits, of which `form` shows some."""
    label(name, tip, share=VECTOR_LABEL_SHARE)
    flags = imgui.SliderFlags_.no_round_to_format
    changed, new = imgui.drag_float3(f"##{name}", list(values), speed, 0, 0, form, flags)
    if not changed or not all(math.isfinite(value) for value in new):
        return None
    x, y, z = (_as_meant(old, value) for old, value in zip(values, new, strict=True))
    return x, y, z


def _as_meant(old: float, new: float) -> float:
    """ImGui's numbers have 32 bits: the old one where it has not changed, else the shortest it may be."""
    return old if np.float32(old) == np.float32(new) else float(str(np.float32(new)))


def checkbox(name: str, value: bool, tip: str) -> bool | None:
    label(name, tip)
    changed, value = imgui.checkbox(f"##{name}", value)
    tooltip(tip)
    return value if changed else None


def combo(
    name: str, value: Choice, choices: Sequence[Choice], tip: str, names: Sequence[str] = ()
) -> Choice | None:
    """A row with a list to choose from; `names` are what the user reads, the choices themselves if empty."""
    label(name, tip)
    shown = list(names or choices)
    changed, index = imgui.combo(f"##{name}", choices.index(value), shown)
    tooltip(tip)
    return choices[index] if changed else None


def fact(name: str, value: str, tip: str = "") -> None:
    """A row that states something."""
    width = imgui.get_content_region_avail().x
    start = imgui.get_cursor_pos_x()
    imgui.text_colored(theme.QUIET, name)
    tooltip(tip)
    imgui.same_line(start + width * LABEL_SHARE)
    imgui.push_text_wrap_pos(0)
    imgui.text_unformatted(printable(value))
    imgui.pop_text_wrap_pos()
    tooltip(tip)


def note(text: str, colour: ImVec4 = theme.QUIET) -> None:
    """A wrapped line that explains."""
    imgui.push_text_wrap_pos(0)
    imgui.text_colored(colour, printable(text, keep="\n"))
    imgui.pop_text_wrap_pos()


def command_button(app: AppState, name: str, id: str, *, width: float = 0) -> None:
    """A button that runs a command; its tooltip names the key, and what the command lacks."""
    key, title = keys_of(id), COMMANDS[id].title
    tip = f"{title} ({key})" if key else title
    button(name, tip, partial(app.post, COMMANDS[id].run), width=width, lacks=COMMANDS[id].lacks(app))


def command_tooltip(app: AppState, id: str, *, name: str = "") -> None:
    """Tooltip of the last item: a command's title, key and explanation, and what it lacks."""
    if not imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled):
        return
    command = COMMANDS[id]
    key, lacks = keys_of(id), command.lacks(app)
    title, _, rest = command.title.partition(": ")
    head = f"{name or command.menu or title}{f' ({key})' if key else ''}".replace("...", "")
    explained = command.tip or rest or (title if head != title else "")
    explained = f"{explained[:1].upper()}{explained[1:].rstrip('.')}." if explained else ""
    tooltip("\n".join(filter(None, (head, explained, lacks))), hovered=True)


def button(name: str, tip: str, pressed: Callable[[], object], *, width: float = 0, lacks: str = "") -> None:
    """`lacks`: what must be there before it can be pressed, for the tooltip; "" where it can be."""
    imgui.begin_disabled(lacks != "")
    if imgui.button(name, (width, 0)):
        pressed()
    imgui.end_disabled()
    tooltip(f"{tip}\n{lacks}" if lacks else tip)


def beside(name: str) -> None:
    """Keeps a button of this name on the line of the last item, if it fits there."""
    style = imgui.get_style()
    width = imgui.calc_text_size(name, hide_text_after_double_hash=True).x + 2 * style.frame_padding.x
    right = imgui.get_cursor_screen_pos().x + imgui.get_content_region_avail().x
    if imgui.get_item_rect_max().x + style.item_spacing.x + width <= right:
        imgui.same_line()


def fold(app: AppState, title: str, *, opened: bool = False) -> bool:
    """A section that can be shut; whether it is open. A command that asks for it has it opened and shown."""
    revealed = app.reveal != "" and app.reveal == title.split("###")[-1]
    if revealed:
        imgui.set_next_item_open(True)
    shown = header(title, opened=opened)
    if revealed:
        imgui.set_scroll_here_y(0.0)
        app.reveal = ""
    return shown


def header(title: str, *, opened: bool = False) -> bool:
    """A collapsing header that is quieter than what is selected; whether it is open."""
    for colour, plain in HEADER.items():
        imgui.push_style_color(colour, imgui.get_style_color_vec4(plain))
    shown = imgui.collapsing_header(title, imgui.TreeNodeFlags_.default_open if opened else 0)
    imgui.pop_style_color(len(HEADER))
    return shown


HEADER = {
    imgui.Col_.header: imgui.Col_.frame_bg,
    imgui.Col_.header_hovered: imgui.Col_.frame_bg_hovered,
    imgui.Col_.header_active: imgui.Col_.frame_bg_active,
}
"""Colours of headers."""


def section(name: str) -> None:
    imgui.spacing()
    imgui.separator_text(name)
