"""What becomes of a command whose terminal, pipe or log goes away, or cannot hold what is printed."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rich.table import Table

from splatview.cli.main import TolerantStream, main, make_console
from splatview.raster import render
from splatview.scene import Gaussians
from splatview.scene.captures.demo import demo_capture
from splatview.scene.captures.nerfstudio import save_capture
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
    capture = tmp_path / "capture"
    save_capture(demo_capture(render, photos=4, width=48, height=36, splats=1000), capture)
    done = shell(f"$SPLATVIEW train {capture} --headless --iterations 12 -o {tmp_path / 'out.ply'} {log}")
    assert (tmp_path / "out.ply").exists(), done.stderr
    assert (tmp_path / "out.checkpoint.safetensors").exists()


HOSTILE = "[bold]a[/] [/x] \x1b[31m\x07\x9b2J\u202e"
"""Markup, a colour, a bell, a screen cleared by one character, and writing turned round."""

SHOWN = "[bold]a[/] [/x] \\x1b[31m\\x07\\x9b2J\\u202e"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_what_others_wrote_is_shown_and_not_obeyed(tmp_path, random_gaussians, monkeypatch, capsys):
    """Comments, properties, file names, names in recipes: by every command that shows them."""
    monkeypatch.chdir(tmp_path)
    name = f"{HOSTILE.replace('/', '')}.ply"
    scene = replace(random_gaussians(30, sh_degree=0), comments=(HOSTILE,))
    save_scene(scene, "plain.ply")
    data = Path("plain.ply").read_bytes()
    Path(name).write_bytes(data.replace(b"float nx\n", b"float [/x]\x1b[1m\n"))
    crop = {"op": "add_crop", "crop": {"name": f"{HOSTILE}\nsplatview: done"}}
    steps = [
        crop,
        {"op": "remove_crop", "index": 0},
        {"op": "select_all"},
        {"op": "split", "path": f"x{name}"},
    ]
    Path("r.json").write_text(json.dumps({"splatview_recipe": 1, "steps": steps}))
    shown_name = SHOWN.replace("/", "")
    for argv, word in (
        (["info", name], SHOWN),
        (["info", f"no{name}"], shown_name),
        (["info", HOSTILE, HOSTILE], SHOWN),
        (["convert", "plain.ply", f"c{name}"], shown_name),
        (["edit", "plain.ply", "--recipe", "r.json", "--dry-run"], f"Remove {SHOWN}\\nsplatview: done"),
        (["edit", name, "--recipe", "r.json", "-o", f"e{name}"], "everything is deleted"),
        (["render", "plain.ply", "--camera", HOSTILE, "-o", f"p{name}"], shown_name),
        (["bill", name, "--size", "16x16", "--eye", "0,0,-3", "--target", "0,0,0"], shown_name),
        (["train", HOSTILE, "--headless"], SHOWN),
    ):
        main(argv)
        out, err = capsys.readouterr()
        said = (out + err).replace("\n", "")
        assert said.isprintable(), (argv, ascii(said))
        assert word in said, (argv, said)
    assert json.loads(run_json(capsys, ["info", name, "--json"]))["comments"][0] == HOSTILE


def run_json(capsys, argv: list[str]) -> str:
    main(argv)
    out = capsys.readouterr().out
    assert out.isascii()
    return out


def test_tables_and_bars_show_texts_as_they_are(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", TolerantStream(terminal))
    monkeypatch.setenv("TERM", "xterm-256color")
    console = make_console()
    table = Table("column", title=HOSTILE)
    table.add_row(HOSTILE, style="bold")
    console.print(table)
    console.print(HOSTILE, style="yellow")
    print(HOSTILE, file=sys.stderr)
    written = terminal.getvalue()
    # Colours are those of the program alone.
    assert "\x1b[33m" in written and "\x1b[1m" in written
    assert not any(obeyed in written for obeyed in ("\x1b[31m", "\x07", "\x9b", "\u202e"))
    assert written.count(SHOWN) == 4
