"""From the shortcut table's key names to ImGui's key chords, and back to what was pressed."""

from __future__ import annotations

from functools import cache

from imgui_bundle import imgui

from .actions import ACTIONS
from .core import Core
from .shortcuts import FAST, HELD_DIRECTIONS, SHORTCUTS, SLOW

_NAMED = {
    "[": imgui.Key.left_bracket,
    "]": imgui.Key.right_bracket,
    "Up": imgui.Key.up_arrow,
    "Down": imgui.Key.down_arrow,
    "Left": imgui.Key.left_arrow,
    "Right": imgui.Key.right_arrow,
    "PageUp": imgui.Key.page_up,
    "PageDown": imgui.Key.page_down,
    "Home": imgui.Key.home,
    "Escape": imgui.Key.escape,
    "Delete": imgui.Key.delete,
    "Backspace": imgui.Key.backspace,
}
_MODIFIERS = {"Ctrl": imgui.Key.mod_ctrl, "Shift": imgui.Key.mod_shift, "Alt": imgui.Key.mod_alt}


@cache
def chord(text: str) -> int:
    """ImGui's key chord of "Ctrl+Shift+O"; on macOS ImGui itself takes Cmd for Ctrl."""
    *modifiers, name = text.split("+")
    value = int(_key(name))
    for modifier in modifiers:
        value |= int(_MODIFIERS[modifier])
    return value


def _key(name: str) -> imgui.Key:
    if name in _NAMED:
        return _NAMED[name]
    return getattr(imgui.Key, f"_{name}" if name.isdigit() else name.lower())


def post_pressed(core: Core) -> None:
    """Posts the action of every shortcut pressed in this frame.

    None while the user is typing, and only the way out while a menu or question is open.
    """
    if imgui.get_io().want_text_input:
        return
    asked = imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
    for shortcut in SHORTCUTS:
        if asked and shortcut.action != "cancel":
            continue
        if not shortcut.held and any(imgui.is_key_chord_pressed(chord(key)) for key in shortcut.keys):
            core.post(ACTIONS[shortcut.action])


def held_step() -> tuple[float, float, float] | None:
    """(right, up, forward) of the held keys, times 4 when fast and 1/4 when slow; None where none is."""
    io = imgui.get_io()
    if io.want_text_input or io.key_ctrl or imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        return None
    step = [0.0, 0.0, 0.0]
    any_down = False
    for shortcut in SHORTCUTS:
        if shortcut.held and any(imgui.is_key_down(_key(key)) for key in shortcut.keys):
            any_down = True
            for i, part in enumerate(HELD_DIRECTIONS[shortcut.action]):
                step[i] += part
    if not any_down:
        return None
    factor = 4.0 if _down(FAST) else 0.25 if _down(SLOW) else 1.0
    return step[0] * factor, step[1] * factor, step[2] * factor


def _down(modifier: str) -> bool:
    io = imgui.get_io()
    return {"Shift": io.key_shift, "Alt": io.key_alt, "Ctrl": io.key_ctrl}[modifier]
