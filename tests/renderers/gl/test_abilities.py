"""What old OpenGL refuses is asked before, so that ladders and panels leave it out."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.request import FrameRequest
from splatview.scene import RenderSettings, look_at
from splatview.scene.formats import save_scene

PROGRAM = "import sys; from splatview.cli.main import main; sys.exit(main(sys.argv[1:]))"

LACKING = (
    {"order": "16-bit"},
    {"order": "weighted"},
    {"order": "stochastic"},
    {"resort_frames": 4},
    {"resort_degrees": 5.0},
)


NEW, OLD = QuadsRenderer.capabilities, QuadsGL33Renderer.capabilities
REQUEST = FrameRequest(None, look_at((0, 0, -3), (0, 0, 0), width=8, height=8))


@pytest.mark.parametrize("chosen", LACKING, ids=str)
def test_settings_that_need_compute_shaders(chosen) -> None:
    request = replace(REQUEST, settings=RenderSettings(**chosen))
    assert NEW.unsupported(request) is None
    assert "needs OpenGL 4.3" in (OLD.unsupported(request) or "")
    assert OLD.unsupported(REQUEST) is None


def test_stored_attributes_need_them_too() -> None:
    request = replace(REQUEST, attributes="float16")
    assert NEW.unsupported(request) is None
    assert "need OpenGL 4.3" in (OLD.unsupported(request) or "")


def test_a_ladder_on_old_opengl_leaves_them_out(ctx, random_gaussians, tmp_path: Path) -> None:
    save_scene(random_gaussians(200, sh_degree=1), tmp_path / "a.ply")
    command = [sys.executable, "-c", PROGRAM, "ladder", "a.ply", "--size", "48x32"]
    command += ["--renderers", "quads", "--rounds", "3"]
    old = {"MESA_GL_VERSION_OVERRIDE": "3.3", "MESA_GLSL_VERSION_OVERRIDE": "330"}
    done = subprocess.run(
        command, env=os.environ | old, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    if ctx.info["GL_RENDERER"].startswith("llvmpipe"):  # it obeys the override
        assert "keep 25" in done.stdout and "early-stop" in done.stdout
        assert not [word for word in ("16-bit", "stochastic", "resort", "attributes") if word in done.stdout]
