"""A user at random, for some seconds; `make soak` takes an hour."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[2] / "tools" / "soak" / "soak.py"

needs_xvfb = pytest.mark.skipif(shutil.which("Xvfb") is None, reason="Xvfb is not installed")


def soak(folder: Path, *options: str, timeout: float) -> list[dict[str, Any]]:
    """What the parts have found."""
    report = folder / "soak.json"
    command = [
        sys.executable,
        str(SCRIPT),
        "--size",
        "small",
        "--logs",
        str(folder),
        "-o",
        str(report),
        *options,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    assert report.exists(), done.stdout + done.stderr
    parts = json.loads(report.read_text())["parts"]
    assert done.returncode == 0, done.stdout
    return parts


@needs_xvfb
@pytest.mark.timeout(600)
def test_some_seconds(tmp_path: Path) -> None:
    (part,) = soak(tmp_path, "--minutes", "0.08", "--renderers", "cpu", "--seed", "7", timeout=560)
    assert part["problems"] == []
    assert part["actions"] >= 1 and part["pictures"] >= 1 and part["steps"] >= 1
    # The log is enough to do the same again.
    log = [json.loads(line) for line in (tmp_path / "cpu" / "log.jsonl").read_text().splitlines()]
    done = [entry["action"] for entry in log if "action" in entry]
    assert [entry["n"] for entry in log if "action" in entry] == list(range(len(done)))


@needs_xvfb
@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_five_minutes_with_every_renderer_and_again_by_the_log(tmp_path: Path) -> None:
    parts = soak(tmp_path, "--minutes", "5", "--seed", "8", timeout=1300)
    assert [part["renderer"] for part in parts] == ["cpu", "quads", "tiles", "old"]
    assert all(part["problems"] == [] for part in parts)
    short = tmp_path / "short.jsonl"
    short.write_text("\n".join((tmp_path / "cpu" / "log.jsonl").read_text().splitlines()[:20]) + "\n")
    command = [sys.executable, str(SCRIPT), "--replay", str(short), "--renderers", "cpu", "--seed", "8"]
    command += ["--size", "small", "--logs", str(tmp_path / "again")]
    assert subprocess.run(command, timeout=280, check=False).returncode == 0
    first = [line for line in short.read_text().splitlines() if '"action"' in line]
    again = [
        line
        for line in (tmp_path / "again" / "cpu" / "log.jsonl").read_text().splitlines()
        if '"action"' in line
    ]
    assert [json.loads(line)["action"] for line in first] == [json.loads(line)["action"] for line in again]


@needs_xvfb
@pytest.mark.slow
def test_harm_is_seen(tmp_path: Path) -> None:
    """An action that does harm on purpose: a picture that is wrong, a thread that dies, a GL error."""
    for harm, words in {"picture": "differ by more", "thread": "died", "gl": "OpenGL says"}.items():
        folder = tmp_path / harm
        log = tmp_path / f"{harm}.jsonl"
        log.write_text(f'{{"n": 0, "action": "harm_{harm}"}}\n')
        command = [sys.executable, str(SCRIPT), "--replay", str(log), "--renderers", "cpu", "--size", "small"]
        done = subprocess.run(
            [*command, "--logs", str(folder)], capture_output=True, text=True, timeout=280, check=False
        )
        assert done.returncode == 1 and words in done.stdout, done.stdout
        assert (folder / "cpu" / "wrong-picture.png").exists() == (harm == "picture")
