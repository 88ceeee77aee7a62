"""Every tool says what it is for, and nothing else, when asked for help."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from harness import Timings, in_turn, make_parser, peak_bytes, spread

ROOT = Path(__file__).parents[2]
TOOLS = [
    path
    for path in sorted(ROOT.glob("tools/**/*.py"))
    if 'if __name__ == "__main__"' in path.read_text(encoding="utf8") and path.name != "session.py"
]
"""Without the part of the soak that `soak.py` starts itself, with modules of the tests in its path."""


@pytest.mark.parametrize("path", TOOLS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_help_of_every_tool(path: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "COLUMNS": "100", "SPLATVIEW_CONFIG_DIR": str(tmp_path)}
    for name in ("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    command = [sys.executable, str(path), "--help"]
    done = subprocess.run(
        command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage: ") and not done.stderr
    # The usage that a docstring states names the file where it is.
    assert f"tools/{path.name}" not in done.stdout or path.parent.name == "tools"
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
