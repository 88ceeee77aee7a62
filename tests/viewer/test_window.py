"""The window as a person uses it: a real one, under Xvfb, by mouse and keys."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.measure.metrics import psnr
from splatview.renderers import FrameRequest, make_renderer
from splatview.renderers.gl.context import create_headless_context
from splatview.scene import Camera, Gaussians
from splatview.scene.formats import save_scene
from splatview.scene.framing import bulk
from splatview.viewer.layout import PAGES


@pytest.fixture
def scene(random_gaussians) -> Gaussians:
    return random_gaussians(1500, seed=4)


@pytest.fixture
def files(tmp_path, scene, random_gaussians) -> tuple[Path, Path]:
    """Two scenes on disk; the second is the one that matters."""
    first, second = tmp_path / "first.ply", tmp_path / "second.ply"
    save_scene(random_gaussians(50), first)
    save_scene(scene, second)
    return first, second


def test_a_tour_of_the_window(drive, files, scene, tmp_path):
    first, second = files
    found = drive("tour", first, drop=str(second), drawn=True)
    assert found["first"] == "first.ply"
    assert found["title"] == "second.ply", "opened by drop"

    start, orbited = found["start"], found["orbited"]
    np.testing.assert_allclose(orbited["target"], start["target"])
    assert orbited["distance"] == pytest.approx(start["distance"])
    assert not np.allclose(orbited["eye"], start["eye"], atol=1e-2)
    assert not np.allclose(found["panned"]["target"], orbited["target"], atol=1e-3)
    np.testing.assert_allclose(found["panned"]["forward"], orbited["forward"])
    assert found["zoomed"]["distance"] < found["panned"]["distance"]
    np.testing.assert_allclose(found["framed"]["target"], bulk(scene)[0], atol=1e-6)
    np.testing.assert_allclose(found["framed"]["forward"], orbited["forward"], atol=1e-9)
    assert "Turning about splat" in found["focus_said"]
    assert found["focused"]["target"] != found["framed"]["target"]

    assert found["navigation"] == "fly"
    before, after = found["flown"]
    went = np.subtract(after["eye"], before["eye"])
    assert np.linalg.norm(went) > 0
    np.testing.assert_allclose(went / np.linalg.norm(went), before["forward"], atol=1e-6)
    before, after = found["looked"]
    np.testing.assert_allclose(after["eye"], before["eye"], atol=1e-9)
    right = np.cross(before["forward"], (0, -1, 0))
    assert np.dot(after["forward"], right) > 0.01, "to the right, as the mouse went"
    before, after = found["rolled"]
    assert after["distance"] == pytest.approx(before["distance"])
    assert not np.allclose(after["forward"], before["forward"], atol=1e-3)
    np.testing.assert_allclose(found["from_z"]["forward"], (0, 0, -1), atol=1e-9)

    assert set(found["modes"]) == {"splats", "points", "ellipsoids", "depth", "overdraw"}
    for mode, seen in found["modes"].items():
        assert seen["asked"] == mode
        assert seen["finite"]
        assert seen["mean"] > 1e-4, f"{mode} shows something"
    assert len({round(seen["mean"], 6) for seen in found["modes"].values()}) == 5, "and each its own"

    assert found["help_open"] and found["help_window"] and found["help_closed"]
    assert found["bookmarks"] == ["View 1"]
    assert (tmp_path / "second.ply.bookmarks.json").exists()
    assert found["stats"]["splats"] == len(scene)
    assert found["stats"]["drawn_idle"] == 0, "nothing is drawn while nothing changes"
    assert found["stats"]["history"] > 2

    # The saved picture is the headless one.
    picture = np.asarray(Image.open(tmp_path / "second.png"), np.float32) / 255
    camera = Camera(**{**found["camera"], "world_to_camera": np.array(found["camera"]["world_to_camera"])})
    assert picture.shape == (camera.height, camera.width, 3)
    headless = headless_picture(scene, camera)
    assert psnr(picture, np.round(headless[..., :3].clip(0, 1) * 255) / 255) >= 50
    assert picture.std() > 0.05, "not an empty one"

    again = drive("second_run", second)
    assert again["background"] == [0.25, 0.5, 0.75]
    assert again["fly_speed"] == 3.0
    assert [Path(name).name for name in again["recent"]] == ["second.ply", "first.ply"]
    assert again["bookmarks"] == ["View 1"]
    config = tmp_path / "config"
    assert {path.name for path in config.iterdir()} == {"preferences.json", "layout.ini", "views.json"}
    assert not list(tmp_path.glob("*.ini")), "no layout file in the working directory"


def headless_picture(scene: Gaussians, camera: Camera) -> np.ndarray:
    ctx = create_headless_context()
    try:
        return make_renderer("quads", ctx).render(FrameRequest(scene, camera))
    finally:
        ctx.release()


def test_a_window_can_be_opened_after_contexts_without_one(display):
    script = (
        "from splatview.cli import doctor, ladder\n"
        "from splatview.renderers import precompile\n"
        "precompile.probe_cache = None  # it takes a second\n"
        "for look in (doctor.automatic_choice, doctor.gl_context, lambda: ladder.chosen_renderers(None)):\n"
        "    look()\n"
        "    print(doctor.no_window())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["None"] * 3, done.stderr


def test_old_opengl_shows_the_same_picture(drive, files, scene):
    old = {"MESA_GL_VERSION_OVERRIDE": "3.3", "MESA_GLSL_VERSION_OVERRIDE": "330"}
    found = drive("look", files[1], environ=old)
    if not found["software"]:
        pytest.skip("a GPU's driver does not obey Mesa's version override")
    assert found["renderer"] == "quads (OpenGL 3.3)"
    assert any("no compute shaders" in line for line in found["messages"])
    camera = Camera(**{**found["camera"], "world_to_camera": np.array(found["camera"]["world_to_camera"])})
    expected = float(headless_picture(scene, camera)[..., :3].sum())
    assert found["pixel_sum"] == pytest.approx(expected, rel=2e-3)


def test_tiles_show_the_same_picture(drive, files, scene):
    found = drive("look", files[1], renderer="tiles")
    assert found["renderer"] == "tiles (OpenGL 4.3)"
    camera = Camera(**{**found["camera"], "world_to_camera": np.array(found["camera"]["world_to_camera"])})
    expected = float(headless_picture(scene, camera)[..., :3].sum())
    assert found["pixel_sum"] == pytest.approx(expected, rel=2e-3)


def test_menus_and_panels(drive, files, tmp_path):
    first, second = files
    found = drive("menus", first, renderer="cpu", typed=str(second))
    assert found["opened"] == "second.ply"
    assert found["navigation"] == "trackball"
    assert found["up"] == [0, 0, 1]
    width, height = found["picture_size"]
    assert Image.open(tmp_path / "second.png").size == (2 * width, 2 * height)
    assert found["panels"] == ["History", "Film", "Log", *(page.name for page in PAGES)]
    assert found["antialiased"] and not found["antialiased_after"]
    hidden, shown = found["widths"]
    assert hidden > shown + 100

    again = drive("second_look", second, renderer="cpu")
    assert again["visible"] == ["View", "Log"]
    assert again["navigation"] == "trackball"


def test_trouble_is_told_and_survived(drive, files, tmp_path):
    first, second = files
    broken = tmp_path / "broken.ply"
    broken.write_bytes(second.read_bytes()[:5000])
    found = drive("trouble", first, renderer="cpu", broken=str(broken), slow=str(second))
    assert "broken.ply" in found["problem"]
    assert "\n" not in found["problem"]
    assert found["scene_stays"] and found["problem_closed"]
    assert found["frames_while_loading"] >= 10
    assert found["cancelled"] and found["overtaken_cancelled"]
    assert found["still_loading"], "the window was closed during a load"
    assert "Traceback" not in found["output"]


def test_the_cpu_renderer_is_coarse_when_moving_and_sharp_at_rest(drive, files):
    found = drive("turn", files[1], renderer="cpu")
    assert found["renderer"] == "cpu"
    assert found["rest_size"] == found["picture_size"]
    assert found["rest_size_again"] == found["picture_size"]
    assert found["largest_error"] == 0
    assert found["drawn_idle"] == 0


def test_broken_preferences_are_set_aside(drive, files, tmp_path):
    config = tmp_path / "config"
    config.mkdir()
    (config / "preferences.json").write_text("{ broken")
    found = drive("second_run", files[0], renderer="cpu")
    assert any("preferences.json.broken" in line for line in found["said"])
    assert json.loads((config / "preferences.json").read_text())["fly_speed"] == 1.0
