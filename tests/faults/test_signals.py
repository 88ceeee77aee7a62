"""Signals at any moment: the command ends as it should, with nothing said and nothing left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from splatview.scene import Gaussians
from splatview.scene.formats import load_scene, save_scene

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")

START = """
import os, signal, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.{name})

sys.meta_path.insert(0, Finder())
from splatview.cli import start
sys.exit(start())
"""
"""The command, which gets a signal when a module is imported."""


@pytest.fixture
def scene(tmp_path: Path, random_gaussians) -> Path:
    gaussians: Gaussians = random_gaussians(30, sh_degree=0)
    save_scene(gaussians, tmp_path / "scene.ply")
    return tmp_path / "scene.ply"


def heed_ctrl_c() -> None:
    """Not everybody does: what a shell starts in the background ignores it, tests too."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def run(code: str, *arguments: object, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    options = {"preexec_fn": heed_ctrl_c, **options}
    return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False, **options)


@pytest.mark.parametrize(
    "module", ["importlib.metadata", "numpy", "splatview.cli.info", "splatview.scene.formats.ply_body"]
)
def test_ctrl_c_while_loading_says_nothing(scene: Path, module: str) -> None:
    done = run(START.format(module=module, name="SIGINT"), "info", scene)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_ctrl_c_is_ignored_where_it_was(scene: Path) -> None:
    """In the background of a shell."""
    code = START.format(module="splatview.cli.info", name="SIGINT")
    done = run(code, "info", scene, "--json", preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    assert done.returncode == 0 and json.loads(done.stdout)["count"] == 30


WRITING = """
import os, signal, sys
from splatview.cli import start
from splatview.scene.formats import io

def fsync(descriptor):
    os.kill(os.getpid(), signal.{name})

io.os.fsync = fsync
sys.exit(start())
"""
"""The command, which gets a signal before what it has written takes its name."""


def test_a_request_to_end_leaves_nothing_half_written(scene: Path) -> None:
    before = sorted(scene.parent.iterdir())
    done = run(WRITING.format(name="SIGTERM"), "convert", scene, scene.parent / "out.ply")
    assert (done.returncode, done.stdout, done.stderr) == (143, "", "")
    assert sorted(scene.parent.iterdir()) == before


def leftovers(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob(".*.tmp"))


def test_what_a_kill_leaves_is_removed_by_the_next_write(scene: Path) -> None:
    out = scene.parent / "[out].ply"
    done = run(WRITING.format(name="SIGKILL"), "convert", scene, out)
    (left,) = leftovers(scene.parent)
    assert done.returncode == -signal.SIGKILL and not out.exists()
    (scene.parent / ".other.ply.0123abcd.tmp").touch()
    before = time.time() - 60
    for name in (left, ".other.ply.0123abcd.tmp"):
        os.utime(scene.parent / name, (before, before))
    save_scene(load_scene(scene), out)
    assert len(load_scene(out)) == 30
    assert leftovers(scene.parent) == [".other.ply.0123abcd.tmp"], "it belongs to another file"


def test_what_a_living_process_writes_is_left_alone(scene: Path) -> None:
    out = scene.parent / "out.ply"
    waiting = "print('here', flush=True); sys.stdin.readline(); return real(descriptor)"
    code = WRITING.format(name="SIGTERM").replace("os.kill(os.getpid(), signal.SIGTERM)", waiting)
    code = code.replace("def fsync", "real = os.fsync\n\ndef fsync")
    command = [sys.executable, "-c", code, "convert", str(scene), str(out)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdin is not None and writer.stdout is not None
        assert writer.stdout.readline() == "here\n"
        (left,) = leftovers(scene.parent)
        os.utime(scene.parent / left, (0, 0))
        save_scene(load_scene(scene).take(np.arange(7)), out)
        assert leftovers(scene.parent) == [left]
        writer.stdin.write("\n\n\n")
        writer.stdin.flush()
        assert writer.wait(200) == 0
    assert len(load_scene(out)) == 30 and not leftovers(scene.parent)
