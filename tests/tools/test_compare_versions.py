"""The part of `tools/compare_versions.py` that finds what differs; nothing is drawn here."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[2] / "tools" / "compare_versions.py"

RECORDING: dict[str, Any] = {
    "about": {"machine": "one", "python": "3"},
    "left_out": {},
    "entries": {
        "render/front/cpu": {
            "command": "splatview render a.ply",
            "code": [0],
            "stdout": "",
            "stderr": "o.npy: 9x9, by cpu",
            "files": {"o.npy": "(9, 9, 4) <f4, sha256 aa", "p.npy": "(9, 9, 4) <f4, sha256 bb"},
        },
        "help": {"command": "splatview --help", "code": [0], "stdout": "one\ntwo", "stderr": "", "files": {}},
    },
}


def compare(tmp_path: Path, after: dict[str, Any], *options: str) -> tuple[int, str]:
    """Exit code and standard output of a comparison of RECORDING with `after`."""
    paths = (tmp_path / "before.json", tmp_path / "after.json")
    for path, recording in zip(paths, (RECORDING, after), strict=True):
        path.write_text(json.dumps(recording))
    command = [sys.executable, str(SCRIPT), "compare", *map(str, paths), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.returncode, done.stdout


@pytest.fixture
def after() -> dict[str, Any]:
    return copy.deepcopy(RECORDING)


def test_equal_recordings(tmp_path, after):
    after["entries"]["help"]["command"] = "another way to say it"
    assert compare(tmp_path, after) == (0, "2 entries, 8 outputs: 0 differ\n")


def test_a_changed_hash(tmp_path, after):
    after["entries"]["render/front/cpu"]["files"]["o.npy"] = "(9, 9, 4) <f4, sha256 cc"
    code, out = compare(tmp_path, after)
    assert code == 1
    assert out.splitlines() == [
        "render/front/cpu  o.npy",
        "    - (9, 9, 4) <f4, sha256 aa",
        "    + (9, 9, 4) <f4, sha256 cc",
        "2 entries, 8 outputs: 1 differ; render: 1",
    ]


@pytest.mark.parametrize(("lacking", "sign"), [("after", "-"), ("before", "+")])
def test_a_missing_key(tmp_path, after, lacking, sign):
    entries = after["entries"]
    if lacking == "after":
        del entries["help"]
        key = "help"
    else:
        key = "help/new"
        entries[key] = entries["help"]
    code, out = compare(tmp_path, after)
    assert code == 1
    assert out.startswith(f"{key}  entry\n") and f"    {sign} recorded\n" in out


def test_a_missing_file_and_another_exit_code(tmp_path, after):
    after["entries"]["render/front/cpu"]["code"] = [2]
    del after["entries"]["render/front/cpu"]["files"]["p.npy"]
    code, out = compare(tmp_path, after)
    assert code == 1
    assert "render/front/cpu  code\n    - [0]\n    + [2]\n" in out
    assert "p.npy\n    - (9, 9, 4) <f4, sha256 bb\n    + missing\n" in out
    assert "2 differ" in out


def test_a_changed_text_shows_its_lines(tmp_path, after):
    after["entries"]["help"]["stdout"] = "one\nthree"
    code, out = compare(tmp_path, after)
    assert code == 1
    assert "help  stdout\n    -two\n    +three\n" in out


def test_texts_changed_on_purpose_can_be_left_out(tmp_path, after):
    after["entries"]["help"]["stdout"] = "one\nthree"
    assert compare(tmp_path, after, "--ignore", "help* stdout")[0] == 0
    after["entries"]["help"]["code"] = [1]
    assert compare(tmp_path, after, "--ignore", "help* stdout")[0] == 1


def test_a_recording_that_is_absent(tmp_path):
    command = [sys.executable, str(SCRIPT), "compare", str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "a.json" in done.stderr and len(done.stderr.splitlines()) == 1


def test_another_machine_is_said(tmp_path, after):
    after["about"]["machine"] = "two"
    code, out = compare(tmp_path, after)
    assert code == 0 and "another machine: one, two" in out
