"""Drivers that lack something: a renderer that works is taken instead, and one line says so."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import moderngl
import pytest
from PIL import Image

from splatview.scene import Gaussians, InputError
from splatview.scene.formats import save_scene
from splatview.viewer import app as app_module
from splatview.viewer import platform as display
from splatview.viewer import viewport
from splatview.viewer.app import window_state
from splatview.viewer.preferences import Preferences
from splatview.viewer.state import AppState


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(tmp_path / "config"))


def said(app: AppState) -> list[str]:
    return [message.text for message in app.messages]


def test_a_display_without_opengl_is_one_line_that_says_what_to_do(monkeypatch) -> None:
    monkeypatch.setattr(display.glfw, "init", lambda: True)
    monkeypatch.setattr(display.glfw, "create_window", lambda *arguments: None)
    monkeypatch.setattr(display.glfw, "get_error", lambda: (65542, b"GLX: No GLXFBConfigs returned"))
    problem = display.display_problem()
    assert problem == (
        "no window with OpenGL 3.3 can be opened here (GLX: No GLXFBConfigs returned); update the graphics"
        " driver, or see what splatview doctor finds"
    )


def test_a_driver_that_cannot_draw_splats_leaves_it_to_the_processor(monkeypatch) -> None:
    made: list[str] = []

    def choose(ctx: Any, renderer: str, **options: Any) -> Any:
        made.append(renderer)
        if renderer != "cpu":
            raise moderngl.Error("GLSL Compiler failed\n\ncompute shader\n0:1: no")
        return SimpleNamespace(name="cpu")

    monkeypatch.setattr(app_module, "choose_picture", choose)
    window = app_module.Window([])
    assert window._picture(SimpleNamespace(version_code=450)).name == "cpu"  # pyright: ignore[reportArgumentType]
    (line,) = said(window.app)
    assert "the processor does" in line and "splatview doctor" in line and "\n" not in line
    assert made == ["auto", "cpu"]
    with pytest.raises(moderngl.Error):  # what was asked for by name is not replaced
        app_module.Window([], renderer="quads")._picture(SimpleNamespace())  # pyright: ignore[reportArgumentType]


def test_a_picture_that_cannot_be_drawn_is_told_of_once() -> None:
    app = window_state(preferences=Preferences(smooth=False))
    problems = ["800x600 px need 7 MiB of graphics memory"] * 3 + ["another"]

    def draw(*arguments: Any, **options: Any) -> None:
        raise InputError(problems.pop(0))

    app.picture = SimpleNamespace(draw=draw, name="quads", threads=None)  # pyright: ignore[reportAttributeAccessIssue]
    app.mode = "depth"
    for _ in range(4):
        viewport.draw_picture(app, SimpleNamespace(), 800, 600)  # pyright: ignore[reportArgumentType]
    assert said(app) == ["depth: 800x600 px need 7 MiB of graphics memory", "splats: another"]
    assert app.mode == "splats"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="xvfb-run is not installed")
def test_a_display_whose_opengl_is_too_old_gets_a_preview(
    tmp_path: Path, random_gaussians: Callable[..., Gaussians]
) -> None:
    scene, out = tmp_path / "scene.ply", tmp_path / "preview.png"
    save_scene(random_gaussians(100), scene)
    command = [sys.executable, "-c", "import sys; from splatview.cli.main import main; sys.exit(main())"]
    done = subprocess.run(
        ["xvfb-run", "-a", *command, str(scene), "-o", str(out)],
        env=dict(os.environ, MESA_GL_VERSION_OVERRIDE="2.1", LIBGL_ALWAYS_SOFTWARE="1"),
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("splatview:")]
    lines = [line for line in lines if "compiling" not in line]
    assert len(lines) == 2
    assert "no window with OpenGL 3.3 can be opened here" in lines[0] and "splatview doctor" in lines[0]
    assert lines[1].endswith("rendering on the CPU")
    assert Image.open(out).size == (1280, 720)
