"""The command palette: every command, panel, section and setting, found by its name or by what else it is
called."""

from __future__ import annotations

import re
from collections.abc import Iterable

from imgui_bundle import ImVec2, imgui

from splatview.viewer import theme
from splatview.viewer.command import Command
from splatview.viewer.commands import COMMANDS
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState

ROWS = 14
"""Seen at once."""


def words_of(text: str) -> list[str]:
    """The words of `text` in small letters, axes with their sign."""
    return re.findall(r"(?:(?<!\S)[+-])?[^\W_]+", text.casefold())


def matching(query: str) -> list[Command]:
    """Commands in which every word of `query` begins a word of the title, group, keys, tip or of what else
    they are called, the likeliest first."""
    asked = " ".join(words_of(query))
    scored = []
    for place, command in enumerate(COMMANDS.values()):
        if (score := _score(query.casefold().strip(), asked, command)) is not None:
            scored.append((score, place, command))
    return [command for _, _, command in sorted(scored, key=lambda entry: entry[:2])]


def _score(query: str, asked: str, command: Command) -> int | None:
    """0 for its very name, more for less; None where it does not match."""
    if not query:
        return 0
    if query in (key.casefold() for key in command.keys):
        return 0
    names = [words_of(command.title.split(":")[0]), *map(words_of, command.words)]
    joined = [" ".join(name) for name in names]
    if asked and asked in joined:
        return 1 if asked != joined[0] else 0
    if asked and any(name.startswith(asked) for name in joined):
        return 3 if not joined[0].startswith(asked) else 2
    title, tip = words_of(command.title), words_of(f"{command.group} {command.tip}")
    others = [word for name in names[1:] for word in name]
    total = 4
    for word in asked.split() or [query]:
        if _begins(word, title):
            total += 1
        elif _begins(word, others):
            total += 2
        elif _begins(word, tip):
            total += 6
        else:
            return None
    return total


def _begins(start: str, words: Iterable[str]) -> bool:
    return any(word.startswith(start) for word in words)


def show(app: AppState) -> None:
    """The palette, while it is open."""
    palette = app.palette
    if app.dialog != "palette":
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
    down, up = (imgui.is_key_pressed(key) for key in (imgui.Key.down_arrow, imgui.Key.up_arrow))
    palette.chosen = min(max(palette.chosen + down - up, 0), max(len(found) - 1, 0))
    run = found[palette.chosen] if found and imgui.is_key_pressed(imgui.Key.enter) else None
    height = imgui.get_text_line_height_with_spacing() * ROWS
    imgui.begin_child("##found", ImVec2(0, height), imgui.ChildFlags_.always_use_window_padding)
    for number, command in enumerate(found):
        side = f"{command.group}   {', '.join(command.keys)}".strip()
        room = imgui.get_content_region_avail().x - imgui.calc_text_size(side).x - imgui.get_font_size()
        shown = widgets.fitting(command.title, room)
        clicked, _ = imgui.selectable(f"{shown}##{command.id}", number == palette.chosen)
        if clicked:
            run = command
        if shown != command.title:
            widgets.tooltip(command.title)
        if number == palette.chosen and not palette.fresh:
            imgui.set_scroll_here_y(0.5) if changed or down or up else None
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
        app.dialog = None
        app.post(run.shows or run.run)
    elif not opened:
        app.dialog = None
