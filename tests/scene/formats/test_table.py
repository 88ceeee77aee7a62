"""The table of scene formats: how a reader is chosen."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from splatview.scene import Gaussians, InputError
from splatview.scene.formats import FORMATS, Format, load_scene
from splatview.scene.progress import Progress

NOTHING = Gaussians(
    means=np.zeros((0, 3), np.float32),
    quats=np.zeros((0, 4), np.float32),
    log_scales=np.zeros((0, 3), np.float32),
    opacity_logits=np.zeros(0, np.float32),
    sh=np.zeros((0, 1, 3), np.float32),
)


@pytest.fixture
def asked(monkeypatch):
    """The names of the formats whose readers were called."""
    called = []

    def reader(name: str) -> Callable[[io.BufferedReader, Path, Progress, float], Gaussians]:
        def read(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
            called.append((name, file.read()))
            return NOTHING

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
    with pytest.raises(InputError, match=r"scene\.told"):
        load_scene(path)
    assert asked == []
