"""What becomes of a command whose terminal, pipe or log goes away, or cannot hold what is printed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from splatview.scene import Gaussians
from splatview.scene.formats import save_scene

START = "import sys; from splatview.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def scene(tmp_path: Path, random_gaussians) -> Path:
    gaussians: Gaussians = random_gaussians(30, sh_degree=0)
    save_scene(gaussians, tmp_path / "scene.ply")
    return tmp_path / "scene.ply"


def shell(line: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs a line of sh in which $SPLATVIEW is the command."""
    command = f"{sys.executable} -P -c '{START}'"
    return subprocess.run(
        ["sh", "-c", line.replace("$SPLATVIEW", command)],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


def test_a_closed_output_is_no_failure(scene):
    done = shell(f"$SPLATVIEW info {scene} >&-")
    assert (done.returncode, done.stderr) == (0, "")
    done = shell(f"$SPLATVIEW info {scene.with_name('none.ply')} 2>&-")
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_under_the_output_is_one_line(scene):
    done = shell(f"$SPLATVIEW info {scene} > /dev/full")
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "splatview: standard output: cannot be written: No space left on device"
    ]


def test_characters_that_the_terminal_lacks_are_escaped(scene):
    other = scene.rename(scene.with_name("größe ✓.ply"))
    done = shell(f"$SPLATVIEW info '{other}'", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert "gr\\xf6\\xdfe \\u2713.ply" in done.stdout
    done = shell(f"$SPLATVIEW info '{other}' --json", PYTHONIOENCODING="ascii")
    assert json.loads(done.stdout)["count"] == 30


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("log", ["2>&1 | head -c 1 >/dev/null", "> /dev/full 2>&1", "2> /dev/full"])
def test_training_goes_on_without_its_terminal(tmp_path, log):
    line = f"$SPLATVIEW train --demo --headless --iterations 12 --downscale 4 -o {tmp_path / 'out.ply'} {log}"
    done = shell(line)
    assert (tmp_path / "out.ply").exists(), done.stderr
    assert (tmp_path / "out.checkpoint.safetensors").exists()
