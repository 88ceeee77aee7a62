"""Preferences survive, and nothing in their file can stop the program."""

from __future__ import annotations

import json
import os

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatview.scene import InputError
from splatview.scene.user_dirs import config_folder
from splatview.viewer.preferences import (
    FILE_NAME,
    MAX_RECENT,
    Preferences,
    load_preferences,
    save_preferences,
    with_recent,
    write_json,
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(tmp_path / "config"))
    return tmp_path / "config"


def test_what_is_saved_is_loaded(folder):
    kept = Preferences(
        navigation="fly", fly_speed=2.5, background=(0.1, 0.2, 0.3), recent=("/a/b.ply",), smooth=False
    )
    save_preferences(kept)
    assert load_preferences() == (kept, None)
    assert [path.name for path in folder.iterdir()] == [FILE_NAME], "no temporary file stays"


def test_without_a_file_there_are_defaults_and_nothing_to_say():
    assert load_preferences() == (Preferences(), None)


@pytest.mark.parametrize("text", ["", "{", "[1, 2]", "null", "\x00\x01", "[" * 100_000])
def test_a_broken_file_is_set_aside(folder, text):
    folder.mkdir()
    (folder / FILE_NAME).write_text(text)
    loaded, line = load_preferences()
    assert loaded == Preferences()
    assert line is not None
    assert FILE_NAME in line and "\n" not in line
    assert (folder / f"{FILE_NAME}.broken").read_text() == text
    assert load_preferences() == (Preferences(), None)


def test_bytes_that_are_no_text_are_set_aside(folder):
    folder.mkdir()
    (folder / FILE_NAME).write_bytes(b"\xff\xfe\x00 not utf-8 \x9f")
    loaded, line = load_preferences()
    assert loaded == Preferences()
    assert line is not None


def test_one_bad_value_costs_only_itself(folder):
    write_json(folder / FILE_NAME, {"navigation": "swim", "fly_speed": 3.0, "unknown": 1, "fov_y": 1e9})
    loaded, line = load_preferences()
    assert loaded == Preferences(fly_speed=3.0)
    assert line is not None
    assert "navigation" in line and "fov_y" in line and "fly_speed" not in line


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=6,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.sampled_from([*Preferences.__dataclass_fields__, "other"]), json_values))
def test_any_json_gives_valid_preferences(folder, data):
    folder.mkdir(exist_ok=True)
    (folder / FILE_NAME).write_text(json.dumps(data))
    loaded, _ = load_preferences()
    save_preferences(loaded)
    assert load_preferences() == (loaded, None), "what was made of it is valid itself"


def test_a_crash_while_writing_leaves_the_old_file(folder, monkeypatch):
    save_preferences(Preferences(fly_speed=2.0))

    def crash(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "fsync", crash)
    with pytest.raises(InputError, match="disk full"):
        save_preferences(Preferences(fly_speed=3.0))
    assert load_preferences()[0].fly_speed == 2.0
    assert [path.name for path in folder.iterdir()] == [FILE_NAME]


def test_recent_files_are_newest_first_once_and_not_too_many(tmp_path):
    preferences = Preferences()
    for number in range(MAX_RECENT + 5):
        preferences = with_recent(preferences, tmp_path / f"{number}.ply")
    preferences = with_recent(preferences, tmp_path / "9.ply")
    names = [os.path.basename(name) for name in preferences.recent]
    assert len(names) == MAX_RECENT == len(set(names))
    assert names[:2] == ["9.ply", "16.ply"]


def test_the_folder_is_the_platforms(monkeypatch):
    monkeypatch.delenv("SPLATVIEW_CONFIG_DIR")
    assert config_folder().name == "splatview"
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CONFIG_HOME", "/xdg")
    assert config_folder().as_posix() == "/xdg/splatview"
