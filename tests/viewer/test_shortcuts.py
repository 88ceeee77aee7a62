"""One table of keys: everything in it works, and nothing is in it twice."""

from __future__ import annotations

import pytest

from splatview.viewer.commands import COMMANDS, HELD_KEYS, chord, keys_of
from splatview.viewer.dialogs import HELP_COLUMNS, help_rows
from splatview.viewer.menus import MENUS
from splatview.viewer.palette import matching


def test_every_command_has_a_title_and_is_found_by_it():
    assert all(command.title and command.id == id for id, command in COMMANDS.items())
    assert keys_of("undo") == "Ctrl+Z" and keys_of("find_needles") == ""
    assert matching("needles")[0].id == "find_needles"


def test_menus_name_commands_of_the_table():
    named = [entry for entries in MENUS.values() for entry in entries if isinstance(entry, str)]
    assert set(named) <= set(COMMANDS) and len(named) == len(set(named))


def test_no_key_means_two_things():
    chords = [chord(key) for entry in (*COMMANDS.values(), *HELD_KEYS) for key in entry.keys]
    assert len(chords) == len(set(chords))


def test_every_key_is_on_the_help_page():
    rows = [row for column in HELP_COLUMNS for group in column for row in help_rows(group)]
    for entry in (*COMMANDS.values(), *HELD_KEYS):
        assert not entry.keys or (", ".join(entry.keys), entry.title) in rows


def test_an_unknown_key_is_noticed():
    with pytest.raises(AttributeError):
        chord("Ctrl+Nonsense")
