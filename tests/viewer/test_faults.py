"""What goes wrong around a window ends as a user would want: nothing is lost, and one line says why."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from splatview.edit.journal import find_abandoned_journals
from splatview.raster import render
from splatview.scene.captures.demo import demo_capture
from splatview.scene.captures.nerfstudio import save_capture
from splatview.scene.formats import load_scene, save_scene
from splatview.trainer.checkpoint import load_checkpoint

SCRIPT = "fault_drives.py"

x11 = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="X11")


@pytest.fixture
def scene(tmp_path, random_gaussians) -> Path:
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(300, seed=4), path)
    return path


@pytest.fixture
def capture(tmp_path) -> Path:
    folder = tmp_path / "pond"
    save_capture(demo_capture(render, photos=4, width=48, height=36, splats=1000), folder)
    return folder


@pytest.fixture
def own_display(make_screen) -> Iterator[tuple[str, int]]:
    """A screen that may be killed: DISPLAY, and the server's process."""
    with make_screen() as made:
        yield made.display, made.pid


def begin(folder: Path, display: str, name: str, *paths: Path, **options: Any) -> subprocess.Popen[str]:
    """A function of `fault_drives` in a process that may end as it likes."""
    result = folder / f"{name}-{options.get('speed', '')}.json"
    command = [sys.executable, str(Path(__file__).with_name(SCRIPT)), name, str(result), json.dumps(options)]
    environment = dict(
        os.environ,
        DISPLAY=display,
        SPLATVIEW_CONFIG_DIR=str(folder / "config"),
        LIBGL_ALWAYS_SOFTWARE="1",
    )
    environment.pop("WAYLAND_DISPLAY", None)
    return subprocess.Popen(
        [*command, *map(str, paths)],
        env=environment,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def test_what_fails_in_a_frame_is_told_of_and_a_signal_closes_the_window(drive, scene, tmp_path):
    found = drive("broken_frames", scene, script=SCRIPT, renderer="cpu")
    assert "ValueError: a panel broke" in found["panel"]
    assert "ZeroDivisionError: between two frames" in found["part"]
    assert found["told"] == 2, "once each, though each frame failed"
    assert found["scene_stays"] and found["picture_mean"] > 0.01
    assert found["output"].count("Traceback") == 2
    # Closed by SIGTERM: edits are put away, preferences and layout kept.
    assert "the edits are in no file yet; the next start offers to restore them" in found["output"]
    (journal,) = find_abandoned_journals(tmp_path / "config" / "journals")
    assert journal.scene == scene
    assert {"preferences.json", "layout.ini"} <= {path.name for path in (tmp_path / "config").iterdir()}


@x11
def test_a_display_that_ends_costs_no_training(own_display, capture, tmp_path):
    display, server = own_display
    program = begin(tmp_path, display, "display_ends_in_training", capture, server=server)
    said, _ = program.communicate(timeout=200)
    assert program.returncode == 2, said
    assert "splatview: the connection to the display was lost" in said and "Traceback" not in said
    reached = load_checkpoint(tmp_path / "toy.checkpoint.safetensors").counters.iteration
    assert f"stopped at step {reached:,}: toy.ply is as far as it came; go on with --resume" in said
    assert reached > 10 and len(load_scene(tmp_path / "toy.ply")) > 0


REFUSED = """
import os, sys
from splatview.cli.main import main
from splatview.viewer import app
tried = app.best_gl_version
def refused_from_now_on():
    version = tried()
    os.environ["DISPLAY"] = ":54321"
    return version
app.best_gl_version = refused_from_now_on
sys.exit(main(sys.argv[1:]))
"""


@x11
def test_a_display_that_refuses_the_window_after_all_is_told_of_in_a_line(display, launcher, scene, tmp_path):
    script = tmp_path / "refused.py"
    script.write_text(REFUSED)
    environment = dict(os.environ, DISPLAY=display, SPLATVIEW_CONFIG_DIR=str(tmp_path / "config"))
    environment.pop("WAYLAND_DISPLAY", None)
    code, said = launcher.run([str(script), str(scene)], env=environment, cwd=tmp_path, seconds=100)
    assert code == 2 and "Traceback" not in said, said
    assert "splatview: no window can be opened: the display cannot be reached" in said.splitlines()


@x11
@pytest.mark.slow
def test_a_display_that_ends_costs_no_edits(own_display, scene, tmp_path):
    display, server = own_display
    program = begin(tmp_path, display, "display_ends", scene, server=server, renderer="cpu")
    said, _ = program.communicate(timeout=200)
    assert program.returncode == 2, said
    assert "splatview: the connection to the display was lost" in said and "Traceback" not in said
    assert "the next start offers to restore them" in said
    (journal,) = find_abandoned_journals(tmp_path / "config" / "journals")
    assert journal.scene == scene
    assert json.loads((tmp_path / "config" / "preferences.json").read_text())["fly_speed"] == 2.5


@pytest.mark.slow
def test_closing_waits_for_a_file_that_is_being_written(drive, scene, tmp_path):
    out = tmp_path / "out" / "edited.ply"
    out.parent.mkdir()
    found = drive("closes_while_saving", scene, script=SCRIPT, renderer="cpu", out=str(out))
    assert not found["there"]
    assert len(load_scene(out)) == len(load_scene(scene))
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.slow
def test_training_goes_on_when_its_photos_are_gone(drive, capture, tmp_path):
    """They are in memory."""
    found = drive("capture_goes", capture, script=SCRIPT, capture=str(capture))
    assert found["failure"] is None and found["scores"] > 0
    assert "Traceback" not in found["output"]
    assert len(load_scene(tmp_path / "toy.ply")) > 0
    assert list((tmp_path / "toy-held-out").glob("*.png"))


@pytest.mark.slow
def test_settings_that_cannot_be_kept_are_said_so_and_no_more(drive, scene):
    found = drive("look", scene, renderer="cpu", environ={"SPLATVIEW_CONFIG_DIR": "/proc/nowhere"})
    assert any("the layout will not be kept" in line for line in found["messages"])
    assert found["pixel_sum"] > 0
    assert "the preferences cannot be saved" in "\n".join(found["messages"]) + found["output"]
    assert "Traceback" not in found["output"]


@pytest.mark.slow
def test_two_windows_on_one_scene(display, scene, tmp_path):
    """One is killed in the middle of it; the other exports over the scene that both have open."""
    go, options = tmp_path / "go", {"renderer": "cpu", "export": None, "go": str(tmp_path / "never")}
    first = begin(
        tmp_path, display, "edits_until_killed", scene, speed=2.0, ready=str(tmp_path / "1"), **options
    )
    options |= {"export": str(scene), "go": str(go)}
    second = begin(
        tmp_path, display, "edits_until_killed", scene, speed=3.0, ready=str(tmp_path / "2"), **options
    )
    limit = time.monotonic() + 120
    while not ((tmp_path / "1").exists() and (tmp_path / "2").exists()):
        assert time.monotonic() < limit and first.poll() is None and second.poll() is None
        time.sleep(0.05)
    assert find_abandoned_journals(tmp_path / "config" / "journals") == [], "each holds its own"
    first.kill()
    first.communicate()
    (abandoned,) = find_abandoned_journals(tmp_path / "config" / "journals")
    assert abandoned.scene == scene and abandoned.recipe.steps
    # A third program has written the file meanwhile: it is not written over.
    text = scene.read_bytes()
    scene.write_bytes(text)
    go.touch()
    said, _ = second.communicate(timeout=120)
    assert second.returncode == 0, said
    found = json.loads((tmp_path / "edits_until_killed-3.0.json").read_text())
    assert any("another program has changed it since it was opened here" in line for line in found["said"])
    assert scene.read_bytes() == text
    config = tmp_path / "config"
    assert json.loads((config / "preferences.json").read_text())["fly_speed"] in (2.0, 3.0)
    assert json.loads((tmp_path / "scene.ply.bookmarks.json").read_text())["bookmarks"]
    assert not list(config.rglob("*.tmp"))
