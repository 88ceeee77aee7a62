"""Folders as the file browser lists them, typed paths, and keys of presets: without a window."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from splatview.viewer import file_listing
from splatview.viewer.commands import DEFAULTS
from splatview.viewer.key_presets import KEYS, PRESETS, action_of, with_preset


@pytest.fixture
def folder(tmp_path) -> Path:
    for name in ("b.ply", "a.PLY", ".hidden.ply", "notes.txt", "gate/x", "garden/x"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
    os.symlink(tmp_path / "nowhere", tmp_path / "broken.ply")
    return tmp_path


def test_rows(folder):
    entries = file_listing.listed(folder)
    assert [entry.name for entry in entries][:2] == ["garden", "gate"], "folders first"

    def names(typed: str = "", **options) -> list[str]:
        return [entry.name for entry in file_listing.matching(entries, ["*.ply"], typed, **options)]

    assert names() == ["garden", "gate", "a.PLY", "b.ply", "broken.ply"]
    assert names("a") == ["a.PLY", "garden", "gate"], "what begins so comes first"
    assert names(".h") == [".hidden.ply"]
    assert names(folders_only=True) == ["garden", "gate"]


def test_completion(folder):
    entries = file_listing.listed(folder)

    def completed(text: str) -> str:
        return file_listing.completed(text, folder, entries)

    assert completed("g") == "ga" and completed("gar") == f"garden{os.sep}"
    assert completed(f"{folder}{os.sep}gat") == f"{folder}{os.sep}gate{os.sep}"
    assert completed("zz") == "zz" and completed("") == ""


def test_typed_paths(folder):
    semicolon = folder / "a; b.ply"
    semicolon.write_text("")
    assert file_listing.typed_paths(str(semicolon), folder) == [semicolon], "a name may hold one"
    assert file_listing.typed_paths("'b.ply'; gate/x", folder) == [folder / "b.ply", folder / "gate/x"]
    assert file_listing.typed_paths("  ", folder) == []


@pytest.mark.parametrize("preset", PRESETS)
def test_no_key_of_a_preset_runs_two_commands(preset):
    table = with_preset(DEFAULTS, preset)
    assert set(KEYS[preset]) - set(DEFAULTS) <= {"toggle_grid"}, "commands that do not exist"
    ours = [key for command in DEFAULTS.values() for key in command.keys]
    twice = {key for key in ours if ours.count(key) > 1}  # where one is there only at times
    keys = [key for command in table.values() for key in command.keys if key not in twice]
    assert len(keys) == len(set(keys))


def test_drags():
    assert action_of("blender", "middle", frozenset({"Shift"})) == "pan"
    assert action_of("blender", "middle", frozenset({"Alt"})) == "turn", "as without, where it says nothing"
    assert action_of("blender", "right", frozenset()) is None
