"""Every tool says what it is for, and nothing else, when asked for help."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from harness import Timings, in_turn, make_parser, peak_bytes, spread

ROOT = Path(__file__).parents[2]
TOOLS = [
    path
    for path in sorted(ROOT.glob("tools/**/*.py"))
    if 'if __name__ == "__main__"' in path.read_text(encoding="utf8") and path.name != "session.py"
]
"""Without the part of the soak that `soak.py` starts itself, with modules of the tests in its path."""


FORKS = """
import json, os, runpy, sys, traceback
import torch
import splatview.trainer.run, splatview.viewer.app
for line in sys.stdin:
    job = json.loads(line)
    pid = os.fork()
    if not pid:
        for there, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(job[name], os.O_WRONLY | os.O_CREAT), there)
        os.chdir(job["folder"])
        os.environ["SPLATVIEW_CONFIG_DIR"] = job["folder"]
        sys.argv, sys.path[0] = [job["path"], "--help"], os.path.dirname(job["path"])
        code = 1
        try:
            runpy.run_path(job["path"], run_name="__main__")
            code = 0
        except SystemExit as end:
            code = end.code or 0
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        os._exit(code if isinstance(code, int) else 1)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""
"""Runs tools in processes that begin with the program imported, and end at once: to tidy it up again takes a
second, and a tool's own imports a tenth of one."""


@pytest.fixture(scope="module")
def ask_for_help(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Path, Path], list[Any]]]:
    """`ask_for_help(tool, folder)`: exit code, output and errors of a tool that is run in `folder`."""
    environment = {**os.environ, "COLUMNS": "100"}
    for name in ("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    printed = [tmp_path_factory.mktemp("help") / name for name in ("out", "err")]

    def run(path: Path, folder: Path) -> list[Any]:
        if sys.platform != "linux":  # elsewhere forks are not safe
            command = [sys.executable, str(path), "--help"]
            own = environment | {"SPLATVIEW_CONFIG_DIR": str(folder)}
            done = subprocess.run(command, env=own, cwd=folder, capture_output=True, text=True, check=False)
            return [done.returncode, done.stdout, done.stderr]
        assert server.stdin is not None and server.stdout is not None
        for file in printed:
            file.unlink(missing_ok=True)
        job = {"path": str(path), "folder": str(folder), "out": str(printed[0]), "err": str(printed[1])}
        server.stdin.write(json.dumps(job) + "\n")
        server.stdin.flush()
        return [int(server.stdout.readline()), *(file.read_text() for file in printed)]

    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", FORKS], env=environment, **pipes) as server:
        yield run


@pytest.mark.parametrize("path", TOOLS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_help_of_every_tool(path: Path, tmp_path: Path, ask_for_help) -> None:
    code, out, err = ask_for_help(path, tmp_path)
    assert code == 0, err
    assert out.startswith("usage: ") and not err
    # The usage that a docstring states names the file where it is.
    assert f"tools/{path.name}" not in out or path.parent.name == "tools"
    assert not list(tmp_path.iterdir()), "asked for help it wrote something"


def test_ways_take_turns_and_the_first_rounds_do_not_count():
    called: list[tuple[str, int]] = []
    ways = {name: (lambda number, name=name: called.append((name, number)) or number) for name in "abc"}
    rounds: list[int] = []
    timings = in_turn(ways, 3, warm_up=2, after_round=rounds.append)
    assert rounds == [0, 1, 2, 3, 4]
    assert [name for name, _ in called] == list("abcbcacababcbca")
    assert [number for _, number in called] == [n for n in range(5) for _ in range(3)]
    for timing in timings.values():
        assert timing.values == [2, 3, 4]
        assert len(timing.ms) == len(timing.cpu_ms) == 3
        assert timing.range[0] <= timing.median <= timing.range[1]
    called.clear()
    in_turn(ways, 2, warm_up=0, rotate=False)
    assert [name for name, _ in called] == list("abcabc")


def test_medians_and_their_spread():
    timing = Timings(ms=[3.0, 1.0, 11.0], values=[{"sort": 1.0}, {"sort": 5.0}, {"sort": 2.0}])
    assert timing.median == 3 and timing.range == [1, 11]
    assert timing.medians() == {"sort": 2}
    assert spread(timing.median, timing.range) == "3 (1 to 11)"
    assert peak_bytes(lambda: bytes(1 << 20)) >= 1 << 20


def test_options_of_benchmarks(capsys):
    options = make_parser("What it is.", "x.json", scenes=True, size="640x360", frames=3).parse_args([])
    assert (options.size, options.frames, options.scenes, options.output.name) == (
        (640, 360),
        3,
        [],
        "x.json",
    )
    with pytest.raises(SystemExit):
        make_parser("What it is.", "x.json", size="1x1").parse_args(["--size", "large"])
    assert "invalid" in capsys.readouterr().err
