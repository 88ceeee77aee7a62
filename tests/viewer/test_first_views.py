"""The first view in the window: where the scene was left, else its cameras, else its front."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import Camera, look_at
from splatview.scene.formats import save_camera, save_scene
from splatview.scene.user_dirs import config_folder
from splatview.viewer import first_views
from splatview.viewer.app import window_state
from splatview.viewer.commands import COMMANDS
from splatview.viewer.first_views import FirstViews, cameras_beside, key_of
from splatview.viewer.navigation import orbit
from splatview.viewer.open import open_paths


@pytest.fixture
def ply(tmp_path, random_gaussians):
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(60), path)
    return path


def said(app) -> str:
    return "\n".join(message.text for message in app.messages)


def opened(app, path, wait_for_loading):
    open_paths(app, [path])
    wait_for_loading(app)
    return app.view


def test_a_scene_opens_where_it_was_left(app, ply, wait_for_loading):
    front = opened(app, ply, wait_for_loading)
    moved = orbit(front, 0.7, 0.2)
    app.steer(moved)
    app.feature(FirstViews).close(app)
    again = window_state(preferences=app.preferences)
    again.picture, again.picture_size = app.picture, app.picture_size
    view = opened(again, ply, wait_for_loading)
    np.testing.assert_allclose(view.R_camera_world, moved.R_camera_world, atol=1e-12)
    assert view.distance == moved.distance and "where it was left" in said(again)
    COMMANDS["home_view"].run(again)
    np.testing.assert_allclose(again.view.R_camera_world, front.R_camera_world, atol=1e-12)
    assert again.view.distance == pytest.approx(front.distance)


def test_a_view_that_was_not_moved_is_not_kept(app, ply, wait_for_loading):
    opened(app, ply, wait_for_loading)
    app.feature(FirstViews).close(app)
    assert not (config_folder() / first_views.FILE_NAME).exists()


def test_opening_another_scene_keeps_the_view_of_the_one_before(app, ply, wait_for_loading, tmp_path):
    other = tmp_path / "other.ply"
    other.write_bytes(ply.read_bytes())
    moved = orbit(opened(app, ply, wait_for_loading), 1.0, 0.0)
    app.steer(moved)
    assert opened(app, other, wait_for_loading).R_camera_world.tolist() != moved.R_camera_world.tolist()
    np.testing.assert_allclose(
        opened(app, ply, wait_for_loading).R_camera_world, moved.R_camera_world, atol=1e-12
    )


def test_another_file_of_that_name_starts_anew(ply, random_gaussians):
    key = key_of([ply])
    save_scene(random_gaussians(61), ply)
    assert key_of([ply]) != key
    assert key_of([]) is None and key_of([ply.with_name("gone.ply")]) is None


@pytest.mark.parametrize("text", ["", "[1]", '{"views": 3}', '{"views": [{"scene": "KEY", "target": "x"}]}'])
def test_a_damaged_file_of_views_is_no_matter(app, ply, wait_for_loading, text):
    config_folder().mkdir(parents=True, exist_ok=True)
    (config_folder() / first_views.FILE_NAME).write_text(text.replace("KEY", str(key_of([ply]))))
    app.steer(orbit(opened(app, ply, wait_for_loading), 0.5, 0))
    assert app.is_open and not app.problem
    app.feature(FirstViews).close(app)
    data = json.loads((config_folder() / first_views.FILE_NAME).read_text())
    assert [entry["scene"] for entry in data["views"]] == [key_of([ply])]


def seeing(app, forward: float) -> Camera:
    """A camera at z = -7 that looks along +z for `forward` > 0, away from the scene otherwise."""
    centre = app.scene.centre
    return look_at(centre - np.array((0, 0, 7)), centre - np.array((0, 0, 7 - forward)), width=64, height=48)


def read_lists(app) -> None:
    lists = app.feature(first_views.CameraLists)
    for _ in range(500):
        lists.before_frame(app)
        if not lists.busy(app):
            return
        if lists.reading is not None:
            lists.reading.join()
    raise AssertionError("the cameras were never read")


@pytest.mark.parametrize("forward", [1.0, -1.0])
def test_cameras_beside_the_scene_come_first_if_they_see_it(app, ply, wait_for_loading, forward):
    opened(app, ply, wait_for_loading)
    camera = replace(seeing(app, forward), name="photo")
    save_camera(camera, ply.with_name("scene.cameras.json"))
    app.feature(FirstViews).key = None
    again = window_state(preferences=app.preferences)
    again.picture, again.picture_size = app.picture, (64, 48)
    front = opened(again, ply, wait_for_loading)
    read_lists(again)
    if forward > 0:
        np.testing.assert_allclose(again.view.eye, camera.eye, atol=1e-6)
        assert again.camera_index == 0
    else:
        assert again.view is front and not again.cameras
        assert "none of its cameras sees the scene" in said(again)


def test_where_the_cameras_of_a_scene_lie(tmp_path):
    scene = tmp_path / "model" / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    scene.parent.mkdir(parents=True)
    assert cameras_beside([scene]) is None and cameras_beside([]) is None
    trained = tmp_path / "model" / "cameras.json"
    trained.touch()
    assert cameras_beside([scene]) == trained
    beside = scene.with_name("cameras.json")
    beside.touch()
    assert cameras_beside([scene]) == beside
    own = scene.with_name("point_cloud.cameras.json")
    own.touch()
    assert cameras_beside([scene]) == own
