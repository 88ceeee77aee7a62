"""One table of keys: everything in it works, and nothing is in it twice."""

from __future__ import annotations

import pytest

from splatview.viewer.commands import ACTIONS, HELD_DIRECTIONS, SHORTCUTS, chord, keys_of, text_of
from splatview.viewer.dialogs import HELP_COLUMNS
from splatview.viewer.menus import matching


def test_every_shortcut_does_something():
    for shortcut in SHORTCUTS:
        assert shortcut.action in (HELD_DIRECTIONS if shortcut.held else ACTIONS), shortcut


def test_every_action_can_be_found_by_its_key_or_its_words():
    assert set(ACTIONS) == {shortcut.action for shortcut in SHORTCUTS if not shortcut.held}
    assert all(text_of(action) for action in ACTIONS)
    assert keys_of("undo") == "Ctrl+Z" and keys_of("find_needles") == ""
    assert [command.action for command in matching("needles")] == ["find_needles"]


def test_no_key_means_two_things():
    chords = [chord(key) for shortcut in SHORTCUTS for key in shortcut.keys]
    assert len(chords) == len(set(chords))


def test_every_group_is_on_the_help_page():
    on_page = {group for column in HELP_COLUMNS for group in column}
    assert {shortcut.group for shortcut in SHORTCUTS} <= on_page


def test_an_unknown_key_is_noticed():
    with pytest.raises(AttributeError):
        chord("Ctrl+Nonsense")
