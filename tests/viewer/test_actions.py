"""Actions change the view, the modes and the bookmarks, and say what they did."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from splatview.scene import look_at
from splatview.scene.formats import load_cameras, save_scene
from splatview.viewer import save as saving
from splatview.viewer.app import window_state
from splatview.viewer.camera import (
    UP_NAMES,
    add_bookmark,
    camera_from_text,
    camera_text,
    delete_bookmark,
    focus_at,
    go_to_bookmark,
    rename_bookmark,
    step_camera,
    up_name,
)
from splatview.viewer.commands import COMMANDS
from splatview.viewer.navigation import orbit
from splatview.viewer.open import open_paths
from splatview.viewer.preferences import load_bookmarks


@pytest.fixture
def opened(app, tmp_path, random_gaussians, wait_for_loading):
    path = tmp_path / "room.ply"
    save_scene(random_gaussians(400), path)
    open_paths(app, [path])
    wait_for_loading(app)
    return app


def test_every_command_runs_with_and_without_a_scene(app, opened, monkeypatch, random_gaussians):
    monkeypatch.setattr("splatview.viewer.loading.cached_demo", lambda **options: random_gaussians(10))
    opened.clipboard_read = lambda: "no camera"
    for app in (opened, window_state(opened.preferences)):
        for command in COMMANDS.values():
            assert command.checked(app) in (True, False)
            assert command.lacks(app) == "" or command.lacks(app)[0].isupper()
            command.run(app)
            app.run_posted()
    assert opened.quitting


def test_posted_commands_run_in_order_and_may_post_more(app):
    done: list[int] = []

    def first(app):
        done.append(1)
        app.post(lambda app: done.append(3))

    app.post(first)
    app.post(lambda app, value: done.append(value), 2)
    assert done == []
    assert app.run_posted() == 3
    assert done == [1, 2, 3]


def test_a_command_that_fails_is_told_and_the_rest_runs(app, capsys):
    done = []

    def fail(app):
        raise ZeroDivisionError("a bug")

    app.post(fail)
    app.post(lambda app: done.append(1))
    app.run_posted()
    assert done == [1]
    assert "a bug" in app.problem
    assert "Traceback" in capsys.readouterr().err


def test_a_jump_is_a_motion_unless_switched_off(opened):
    clock = [10.0]
    opened.now = lambda: clock[0]
    opened.prefer(smooth=True)
    start = opened.view
    COMMANDS["look_from_+X"].run(opened)
    opened.advance()
    np.testing.assert_allclose(opened.view.eye, start.eye)
    clock[0] += 0.1
    opened.advance()
    assert opened.transition is not None
    assert not np.allclose(opened.view.eye, start.eye)
    clock[0] += 10
    opened.advance()
    assert opened.transition is None
    np.testing.assert_allclose(opened.view.forward, (-1, 0, 0), atol=1e-9)

    COMMANDS["look_from_+Z"].run(opened)
    opened.steer(orbit(opened.view, 0.1, 0))
    assert opened.transition is None, "the user's hand ends a motion"


def test_the_up_axis_goes_round(opened):
    seen = []
    for _ in UP_NAMES:
        COMMANDS["next_up"].run(opened)
        seen.append(up_name(opened.view))
    assert sorted(name or "" for name in seen) == sorted(UP_NAMES)
    opened.steer(orbit(opened.view, 0.3, 0.4))
    COMMANDS["up_from_view"].run(opened)
    assert up_name(opened.view) is None
    COMMANDS["next_up"].run(opened)
    assert up_name(opened.view) == "+Y"


def test_focus_puts_the_surface_into_the_middle(opened):
    focus_at(opened, 160, 100)
    assert "Turning about splat" in opened.messages[-1].text
    focus_at(opened, 1, 1)
    assert "Nothing" in opened.messages[-1].text


def test_field_of_view_goes_both_ways(opened):
    before = opened.view.lens.fov_y
    COMMANDS["narrower"].run(opened)
    assert opened.view.lens.fov_y < before
    COMMANDS["wider"].run(opened)
    assert opened.view.lens.fov_y == pytest.approx(before)


def test_bookmarks_are_kept_renamed_and_deleted(opened):
    path = opened.scene_path
    COMMANDS["look_from_+X"].run(opened)
    add_bookmark(opened)
    COMMANDS["look_from_-Z"].run(opened)
    add_bookmark(opened)
    rename_bookmark(opened, 0, "  Door ")
    rename_bookmark(opened, 1, "   ")
    assert [b.name for b in load_bookmarks(path)] == ["Door", "View 2"]
    go_to_bookmark(opened, 0)
    np.testing.assert_allclose(opened.view.forward, (-1, 0, 0), atol=1e-9)
    COMMANDS["next_bookmark"].run(opened)
    np.testing.assert_allclose(opened.view.forward, (0, 0, 1), atol=1e-9)
    delete_bookmark(opened, 0)
    assert [b.name for b in load_bookmarks(path)] == ["View 2"]
    add_bookmark(opened)
    assert [b.name for b in opened.bookmarks] == ["View 2", "View 1"]


def test_cameras_are_stepped_through_round_the_list(opened):
    opened.cameras = [look_at((i + 1, 0, 0.5), (0, 0, 0), width=320, height=200) for i in range(3)]
    eyes = []
    for step in (1, 1, 1, 1, -1):
        step_camera(opened, step)
        eyes.append(round(float(opened.view.eye[0])))
    assert eyes == [1, 2, 3, 1, 3]
    opened.camera_index = -1
    step_camera(opened, -1)
    assert opened.camera_index == 2


def test_a_copied_camera_is_pasted_exactly(opened):
    COMMANDS["copy_camera"].run(opened)
    text = opened.clipboard_write
    camera = opened.camera
    COMMANDS["look_from_+X"].run(opened)
    opened.clipboard_read = lambda: text
    COMMANDS["paste_camera"].run(opened)
    np.testing.assert_allclose(opened.camera.world_to_camera, camera.world_to_camera, atol=1e-12)
    assert opened.camera.fy == pytest.approx(camera.fy)


@pytest.mark.parametrize("text", ["", "hello", "[]", "3", "{}", '{"width": "a"}', "null", "[" * 10_000])
def test_other_text_on_the_clipboard_changes_nothing(opened, text):
    before = opened.view
    opened.clipboard_read = lambda: text
    COMMANDS["paste_camera"].run(opened)
    assert opened.view is before
    assert "no camera on the clipboard" in opened.messages[-1].text
    assert "\n" not in opened.messages[-1].text


def test_the_clipboards_camera_is_cam_json(tmp_path):
    camera = look_at((1, 2, 3), (0, 0, 0), width=64, height=48)
    (tmp_path / "cam.json").write_text(camera_text(camera))
    (loaded,) = load_cameras(tmp_path / "cam.json")
    assert loaded.same_view(camera)
    assert camera_from_text(camera_text(camera)).same_view(camera)


def test_pictures_are_saved_beside_the_scene_and_never_over_one_another(opened, tmp_path):
    COMMANDS["screenshot"].run(opened)
    COMMANDS["screenshot"].run(opened)
    assert {path.name for path in tmp_path.glob("*.png")} == {"room.png", "room-2.png"}
    pixels = np.asarray(Image.open(tmp_path / "room.png"))
    assert pixels.shape == (200, 320, 3)
    assert pixels[0, 0, 0] == 0 and pixels[0, -1, 0] == 255, "clipped, not wrapped around"
    assert not list(tmp_path.glob("*.tmp"))


def test_a_picture_that_cannot_be_written_is_told(opened, tmp_path):
    saving.save_picture(opened, opened.camera, tmp_path / "no" / "such" / "folder.png")
    assert "folder.png" in opened.problem


def test_a_saved_camera_gives_the_view_back(opened, tmp_path):
    saving.save_current_camera(opened, tmp_path / "cam.json")
    (loaded,) = load_cameras(tmp_path / "cam.json")
    assert loaded.same_view(opened.camera)
    assert json.loads((tmp_path / "cam.json").read_text())["width"] == 320


@pytest.mark.parametrize("size", [(640, 400), (200, 200), (1000, 100)])
def test_a_picture_of_another_size_keeps_the_vertical_view(size):
    camera = look_at((1, 2, 3), (0, 0, 0), width=320, height=200)
    other = saving.resized(camera, *size)
    assert (other.width, other.height) == size
    assert other.height / other.fy == pytest.approx(camera.height / camera.fy)
    assert other.fx == other.fy
    assert (other.cx, other.cy) == (size[0] / 2, size[1] / 2)
