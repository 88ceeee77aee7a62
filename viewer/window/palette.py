"""The command palette: type a few letters of what you want, Enter does it and shows its key for next time."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from . import theme
from .actions import ACTIONS
from .core import Core
from .dialogs import DIALOG_FLAGS, centred
from .shortcuts import SHORTCUTS, Shortcut

ROWS = 14
"""Seen at once."""


def matching(query: str, commands: tuple[Shortcut, ...] = SHORTCUTS) -> list[Shortcut]:
    """Commands that have every word of `query` in text, group or keys, the likeliest first.

    A word that begins a word of the text counts more than one within; letters alone, in order, still find
    what no word does.
    """
    words = query.casefold().split()
    scored = []
    for place, command in enumerate(commands):
        if not command.held and (score := _score(words, command)) is not None:
            scored.append((score, place, command))
    return [command for _, _, command in sorted(scored, key=lambda entry: entry[:2])]


def _score(words: list[str], command: Shortcut) -> int | None:
    text = f"{command.text} {command.group}".casefold()
    parts = text.replace(":", " ").split()
    keys = [key.casefold() for key in command.keys]
    total = 0
    for word in words:
        if parts[0].startswith(word) or word in keys:
            continue
        if any(part.startswith(word) for part in parts):
            total += 1
        elif word in text:
            total += 3
        elif _letters_in_order(word, text):
            total += 9
        else:
            return None
    return total


def _letters_in_order(word: str, text: str) -> bool:
    letters = iter(text)
    return len(word) > 1 and all(letter in letters for letter in word)


def show(core: Core) -> None:
    """The palette, while it is open."""
    palette = core.palette
    if core.dialog != "palette":
        palette.query, palette.chosen, palette.fresh = "", 0, True
        return
    centred(34)
    opened = imgui.begin("Commands", True, DIALOG_FLAGS | imgui.WindowFlags_.no_resize)[1]
    if palette.fresh:
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    changed, palette.query = imgui.input_text_with_hint("##query", "What do you want to do?", palette.query)
    if changed:
        palette.chosen = 0
    found = matching(palette.query)
    if imgui.is_key_pressed(imgui.Key.down_arrow):
        palette.chosen += 1
    if imgui.is_key_pressed(imgui.Key.up_arrow):
        palette.chosen -= 1
    palette.chosen = min(max(palette.chosen, 0), max(len(found) - 1, 0))
    run = found[palette.chosen] if found and imgui.is_key_pressed(imgui.Key.enter) else None
    height = imgui.get_text_line_height_with_spacing() * ROWS
    imgui.begin_child("##found", ImVec2(0, height))
    for number, command in enumerate(found):
        clicked, _ = imgui.selectable(f"{command.text}##{command.action}", number == palette.chosen)
        if clicked:
            run = command
        if number == palette.chosen and not palette.fresh:
            imgui.set_scroll_here_y(0.5) if changed or _arrows() else None
        side = f"{command.group}   {', '.join(command.keys)}"
        imgui.same_line(imgui.get_content_region_avail().x - imgui.calc_text_size(side).x)
        imgui.text_colored(theme.QUIET, side)
    if not found:
        imgui.text_colored(theme.QUIET, "No command has these words")
    imgui.end_child()
    imgui.end()
    if not palette.fresh and imgui.is_key_pressed(imgui.Key.escape):
        opened = False
    palette.fresh = False
    if run is not None:
        core.dialog = None
        core.post(ACTIONS[run.action])
    elif not opened:
        core.dialog = None


def _arrows() -> bool:
    return imgui.is_key_pressed(imgui.Key.down_arrow) or imgui.is_key_pressed(imgui.Key.up_arrow)
