"""The table of scene formats: how a reader is chosen."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from splatview.scene import InputError
from splatview.scene.formats import FORMATS, Format, load_scene


@pytest.fixture
def asked(monkeypatch):
    """The names of the formats whose readers were called."""
    called = []

    def reader(name):
        def read(file, path, progress):
            called.append((name, file.read()))
            return SimpleNamespace()

        return read

    table = {
        "told": Format(suffix=".told", sniff=lambda start: start.startswith(b"TOLD"), read=reader("told")),
        "bare": Format(suffix=".bare", read=reader("bare")),
    }
    for name, entry in table.items():
        monkeypatch.setitem(FORMATS, name, entry)
    return called


def test_the_first_bytes_decide_before_the_suffix(asked, tmp_path):
    path = tmp_path / "scene.bare"
    path.write_bytes(b"TOLD and more")
    load_scene(path)
    assert asked == [("told", b"TOLD and more")]


def test_the_suffix_decides_where_no_bytes_tell(asked, tmp_path):
    path = tmp_path / "scene.BARE"
    path.write_bytes(b"\x01\x02")
    load_scene(path)
    assert asked == [("bare", b"\x01\x02")]


def test_a_suffix_whose_bytes_are_missing_is_refused(asked, tmp_path):
    path = tmp_path / "scene.told"
    path.write_bytes(b"something else")
    with pytest.raises(InputError, match="scene.told"):
        load_scene(path)
    assert asked == []
