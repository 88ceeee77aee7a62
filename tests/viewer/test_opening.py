"""Opening: in the background, merged, cancelled, refused; the old scene stays until the new one is here."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from splatview.scene import Camera, look_at
from splatview.scene.background import Panorama
from splatview.scene.demo import demo_scene
from splatview.scene.formats import cameras as cameras_module
from splatview.scene.formats import save_camera, save_scene
from splatview.scene.progress import NO_PROGRESS, Cancelled
from splatview.viewer import background, loading
from splatview.viewer import open as opening
from splatview.viewer.background import WindowBackground
from splatview.viewer.camera import CameraLists, camera_text, common_up, read_camera_list
from splatview.viewer.commands import COMMANDS
from splatview.viewer.first_views import nearest_axis
from splatview.viewer.navigation import orbit
from splatview.viewer.open import begin, cancel_loading, open_paths


@pytest.fixture
def ply(tmp_path, random_gaussians):
    """`ply("name", splats)`: a scene on disk."""

    def make(name: str, splats: int = 40, **options):
        path = tmp_path / f"{name}.ply"
        save_scene(random_gaussians(splats, **options), path)
        return path

    return make


def said(app) -> str:
    return "\n".join(message.text for message in app.messages)


def test_a_scene_is_loaded_framed_and_remembered(app, ply, wait_for_loading):
    open_paths(app, [ply("room")])
    assert not app.is_open, "opening does not wait"
    wait_for_loading(app)
    assert app.is_open
    assert app.scene.name == "room.ply"
    assert len(app.picture.loaded[-1]) == 40
    assert app.preferences.recent[0].endswith("room.ply")
    camera = app.camera
    t = camera.R_camera_world @ app.scene.centre + camera.t_camera_world
    assert t[2] > 0, "the scene is in front of the eye"
    assert abs(t[0] / t[2]) < 0.2 and abs(t[1] / t[2]) < 0.2, "and in the middle"
    assert "40 splats" in said(app)


def test_several_files_are_merged_in_order(app, ply, wait_for_loading, random_gaussians):
    open_paths(app, [ply("a", 10, sh_degree=0), ply("b", 20, sh_degree=2, seed=1)])
    wait_for_loading(app)
    assert len(app.scene.gaussians) == 30
    np.testing.assert_array_equal(
        app.scene.gaussians.means[10:], random_gaussians(20, sh_degree=2, seed=1).means
    )
    assert app.scene.name == "a.ply and 1 more"
    assert [name.rsplit("/")[-1] for name in app.preferences.recent] == ["a.ply", "b.ply"]


def test_reading_again_takes_what_is_new_and_keeps_the_view(app, ply, wait_for_loading):
    path = ply("a", 10)
    open_paths(app, [path])
    wait_for_loading(app)
    app.steer(orbit(app.view, 0.5, 0.1))
    view = app.view
    assert ply("a", 25) == path
    opening.reload(app)
    wait_for_loading(app)
    assert len(app.scene.gaussians) == 25
    assert app.view is view


def test_recent_files_that_are_gone_are_forgotten(app, ply, wait_for_loading):
    path, other = ply("a"), ply("b")
    for opened in (other, path):
        open_paths(app, [opened])
        wait_for_loading(app)
    path.unlink()
    open_paths(app, [path])
    wait_for_loading(app)
    assert app.preferences.recent == (str(other),)


def test_a_broken_file_is_told_once_and_the_old_scene_stays(app, ply, wait_for_loading, tmp_path):
    open_paths(app, [ply("good")])
    wait_for_loading(app)
    kept, uploads = app.scene, len(app.picture.loaded)
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    open_paths(app, [bad])
    wait_for_loading(app)
    assert app.scene is kept
    assert "bad.ply" in app.problem
    assert "\n" not in app.problem
    assert len(app.picture.loaded) == uploads


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("surprise"), RecursionError("deep")])
def test_whatever_a_reader_raises_becomes_one_line(app, ply, wait_for_loading, monkeypatch, error):
    def fail(path, **_):
        raise error

    monkeypatch.setattr(loading, "load_scene", fail)
    open_paths(app, [ply("odd")])
    wait_for_loading(app)
    assert "odd.ply" in app.problem
    assert not app.is_open


def test_a_scene_too_big_for_the_gpu_leaves_the_old_one_shown(app, ply, wait_for_loading):
    open_paths(app, [ply("small", 10)])
    wait_for_loading(app)
    kept = app.scene
    app.picture.too_big = 30
    open_paths(app, [ply("big", 30)])
    wait_for_loading(app)
    assert app.scene is kept
    assert app.picture.loaded[-1] is kept.gaussians
    assert "big.ply" in app.problem


@pytest.fixture
def slow_reader(monkeypatch):
    """Reading goes on until it is cancelled."""
    started = threading.Event()

    def read(path, *, progress):
        progress.step(0.25)
        started.set()
        while True:
            progress.check()
            time.sleep(0.001)

    monkeypatch.setattr(loading, "load_scene", read)
    return started


def test_cancelling_ends_the_thread_and_says_nothing_is_wrong(app, ply, slow_reader):
    open_paths(app, [ply("a")])
    running = app.loading
    assert slow_reader.wait(200)
    assert running.progress == pytest.approx(0.25)
    cancel_loading(app)
    running.join(200)
    assert running.done
    assert app.loading is None
    assert app.problem is None
    assert "Cancelled loading a.ply" in said(app)


def test_cancelling_an_upload_keeps_the_old_scene(app, ply, wait_for_loading, monkeypatch):
    open_paths(app, [ply("a", 10)])
    wait_for_loading(app)
    kept, closed = app.scene, []

    def endless(gaussians):
        try:
            while True:
                yield 0.1
        finally:
            closed.append(len(gaussians))

    monkeypatch.setattr(app.picture, "load_steps", endless)
    open_paths(app, [ply("b", 20)])
    app.loading.join(200)
    opening.continue_loading(app)
    assert app.loading.stage == "Uploading", "the window gets its turn although the upload goes on"
    cancel_loading(app)
    assert closed == [20]
    assert app.scene is kept
    opening.continue_loading(app)
    assert app.scene is kept


def test_a_second_file_cancels_the_first(app, ply, slow_reader, monkeypatch, wait_for_loading):
    open_paths(app, [ply("a")])
    first = app.loading
    assert slow_reader.wait(200)
    monkeypatch.undo()
    open_paths(app, [ply("b", 7)])
    assert first.cancelled
    wait_for_loading(app)
    assert app.scene.name == "b.ply"
    first.join(200)
    assert first.done


def test_progress_of_several_files_goes_by_their_sizes(app, ply, monkeypatch, wait_for_loading):
    seen: list[float] = []
    real = loading.load_scene

    begun = threading.Event()

    def read(path, *, progress):
        assert begun.wait(200)
        progress.step(1.0)
        assert app.loading is not None
        seen.append(app.loading.progress)
        return real(path)

    monkeypatch.setattr(loading, "load_scene", read)
    small, large = ply("small", 100), ply("large", 300)
    begin(app, [small, large])
    begun.set()
    wait_for_loading(app)
    assert app.is_open
    share = small.stat().st_size / (small.stat().st_size + large.stat().st_size)
    assert seen == pytest.approx([share, 1.0])


def read_cameras(app):
    """Frames until the cameras are there."""
    lists = app.feature(CameraLists)
    while lists.busy(app):
        lists.before_frame(app)
        if lists.reading is not None:
            lists.reading.join()


def test_cameras_stay_that_are_opened_with_their_scene(app, ply, wait_for_loading, tmp_path):
    save_camera(look_at((3, 2, 1), (0, 0, 0)), tmp_path / "cam.json")
    open_paths(app, [tmp_path / "cam.json", ply("a")])
    lists = app.feature(CameraLists)
    lists.before_frame(app)
    lists.reading.join()
    lists.before_frame(app)
    assert not app.cameras, "the scene that they come with is yet to be opened"
    wait_for_loading(app)
    read_cameras(app)
    assert len(app.cameras) == 1 and app.camera_index == 0


def test_a_camera_list_is_read_beside_the_frames_and_can_be_cancelled(app, tmp_path, monkeypatch):
    """The frame loop goes on while a list is read, sees how far that is, and Escape ends it."""
    many = json.dumps([json.loads(camera_text(look_at((3, 2, 1), (0, 0, 0))))] * 40)
    (tmp_path / "many.json").write_text(many)
    go_on, begun = threading.Event(), threading.Event()
    parse = cameras_module._own_camera

    def slow(entry, where):
        if "camera 10" in where:
            begun.set()
            go_on.wait(200)
        return parse(entry, where)

    monkeypatch.setattr(cameras_module, "_own_camera", slow)
    lists = app.feature(CameraLists)
    open_paths(app, [tmp_path / "many.json"])
    lists.before_frame(app)
    reading = lists.reading
    assert begun.wait(200)
    lists.before_frame(app)
    assert app.waiting and reading.progress == pytest.approx(0.2 + 0.8 / 4)
    COMMANDS["cancel"].run(app)
    assert not app.waiting
    go_on.set()
    reading.join()
    assert isinstance(reading.error, Cancelled)
    open_paths(app, [tmp_path / "many.json"])
    read_cameras(app)
    assert len(app.cameras) == 40


def test_a_background_picture_is_read_beside_the_frames_and_can_be_cancelled(app, tmp_path, monkeypatch):
    path, go_on = tmp_path / "sky.png", threading.Event()
    Image.new("RGB", (8, 4), "blue").save(path)
    load = background.load_panorama
    monkeypatch.setattr(background, "load_panorama", lambda path: go_on.wait(200) and load(path))
    behind = app.feature(WindowBackground)
    behind.choose(app, path)
    behind.before_frame(app)
    assert app.waiting and app.preferences.background_kind == "colour"
    COMMANDS["cancel"].run(app)
    assert not app.waiting
    go_on.set()
    behind.choose(app, path)
    behind.reading.join()
    behind.before_frame(app)
    behind.follow(app)
    assert isinstance(app.settings.background, Panorama) and not app.waiting
    assert app.preferences.panorama == str(path)


def test_a_dropped_camera_is_gone_to(app, ply, wait_for_loading, tmp_path):
    open_paths(app, [ply("a")])
    wait_for_loading(app)
    camera = look_at((3, 2, 1), (0, 0, 0), width=320, height=200, fov_y=35)
    save_camera(camera, tmp_path / "cam.json")
    open_paths(app, [tmp_path / "cam.json"])
    read_cameras(app)
    assert app.camera.same_view(camera) or np.allclose(
        app.camera.world_to_camera, camera.world_to_camera, atol=1e-12
    )
    assert app.camera.fy == pytest.approx(camera.fy)
    assert app.scene.name == "a.ply", "the scene stays"


def turned(camera: Camera) -> Camera:
    """A quarter turn about its axis: as portraits are stored."""
    quarter = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return replace(camera, world_to_camera=quarter @ camera.world_to_camera)


def test_a_camera_lists_common_up_becomes_the_up_axis(app, tmp_path, wait_for_loading):
    up = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    around = [look_at((3 * np.cos(a), 3 * np.sin(a), 1), (0, 0, 0.3), up=up) for a in np.arange(0, 6.28, 0.5)]
    found = common_up(around)
    assert found is not None
    assert float(found @ up) > 0.99
    assert common_up(around[:2]) is None, "too few to tell"
    portraits = [turned(camera) for camera in around]
    found = common_up(portraits)
    assert found is not None
    assert float(found @ up) > 0.99, "they stand on their sides, and look down"
    rolled = [look_at((0, 0, -3), (0, 0, 0), up=(np.cos(a), np.sin(a), 0)) for a in np.arange(0, 6.28, 0.5)]
    assert common_up(rolled) is None, "they do not agree"


def test_a_folder_without_cameras_is_refused_in_one_line(app, tmp_path):
    open_paths(app, [tmp_path])
    read_cameras(app)
    assert str(tmp_path) in app.problem
    assert "\n" not in app.problem


def test_a_missing_file_is_refused_in_one_line(app, tmp_path, wait_for_loading):
    open_paths(app, [tmp_path / "nowhere.ply"])
    wait_for_loading(app)
    assert "nowhere.ply" in app.problem


@pytest.mark.parametrize(
    ("direction", "expected"),
    [((0.1, -0.9, 0.3), (0, -1, 0)), ((0, 0, 2), (0, 0, 1)), ((-1, 0.9, 0), (-1, 0, 0))],
)
def test_the_up_axis_is_the_nearest_one(direction, expected):
    np.testing.assert_array_equal(nearest_axis(np.array(direction)), expected)


def test_the_demo_opens_without_a_file(app, wait_for_loading, monkeypatch):
    monkeypatch.setattr(loading, "cached_demo", lambda **_: demo_scene(splats=3000))
    opening.begin_demo(app)
    wait_for_loading(app)
    assert app.is_open
    assert len(app.scene.gaussians) > 1000
    assert app.scene_path is None
    assert app.preferences.recent == ()


def test_a_shown_scene_is_examined_and_ill_splats_are_told(app, tmp_path, random_gaussians, wait_for_loading):
    scene = random_gaussians(30)
    scene.means[:4] = np.nan
    save_scene(scene, tmp_path / "ill.ply")
    open_paths(app, [tmp_path / "ill.ply"])
    wait_for_loading(app)
    assert app.is_open
    app.examination.join(200)
    opening.report_examination(app)
    opening.report_examination(app)
    told = [message.text for message in app.messages if "left out" in message.text]
    assert len(told) == 1
    assert told[0].startswith("4 splats")
    assert any(effect.name.startswith("SH band") for effect in app.examination.effects)


def test_what_was_assumed_of_a_file_is_told(app, tmp_path, random_gaussians, wait_for_loading) -> None:
    save_scene(random_gaussians(20), tmp_path / "a.spz")
    open_paths(app, [tmp_path / "a.spz"])
    wait_for_loading(app)
    assert any("its frame is RUB" in message.text for message in app.messages)


def test_cameras_of_a_folder_of_photos_in_any_format(tmp_path):
    """What may be trained on may be flown along: LLFF's poses beside a part of a COLMAP model, the list of
    the 3DGS trainer, and a file of poses by its name."""
    cameras = [look_at((3 * np.sin(a), 0, 3 * np.cos(a)), (0, 0, 0), width=8, height=6) for a in range(4)]
    llff, listed = tmp_path / "llff", tmp_path / "listed"
    for folder in (llff, listed):
        (folder / "images").mkdir(parents=True)
        for i in range(4):
            Image.new("RGB", (8, 6)).save(folder / f"images/{i}.png")
    rows = []
    for camera in cameras:
        right, down, forward = camera.R_camera_world
        size = np.array([camera.height, camera.width, camera.fx])
        rows.append(np.r_[np.stack([down, right, -forward, camera.eye, size], axis=1).ravel(), 1, 9])
    np.save(llff / "poses_bounds.npy", rows)
    (llff / "sparse" / "0").mkdir(parents=True)
    (llff / "sparse" / "0" / "cameras.txt").write_text("1 PINHOLE 8 6 7 7 4 3\n")
    entries = [
        {"img_name": f"{i}.png", "width": 8, "height": 6, "fx": camera.fx, "fy": camera.fy, "id": i}
        | {"position": camera.eye.tolist(), "rotation": camera.R_camera_world.T.tolist()}
        for i, camera in enumerate(cameras)
    ]
    (listed / "cameras.json").write_text(json.dumps(entries))
    for path in (llff, llff / "poses_bounds.npy", listed):
        found = read_camera_list(path, NO_PROGRESS).cameras
        assert len(found) == 4
        for ours, theirs in zip(found, cameras, strict=True):
            np.testing.assert_allclose(ours.world_to_camera, theirs.world_to_camera, atol=1e-12)
