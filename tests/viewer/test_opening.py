"""Opening: in the background, merged, cancelled, refused; the old scene stays until the new one is here."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from splatview.scene import look_at
from splatview.scene.demo import demo_scene
from splatview.scene.formats import LoadCancelled, save_camera, save_scene
from splatview.viewer import loading
from splatview.viewer import open as opening
from splatview.viewer.navigation import orbit
from splatview.viewer.open import begin, cancel_loading, common_up, nearest_axis, open_paths


@pytest.fixture
def ply(tmp_path, random_gaussians):
    """`ply("name", splats)`: a scene on disk."""

    def make(name: str, splats: int = 40, **options):
        path = tmp_path / f"{name}.ply"
        save_scene(random_gaussians(splats, **options), path)
        return path

    return make


def said(core) -> str:
    return "\n".join(message.text for message in core.messages)


def test_a_scene_is_loaded_framed_and_remembered(core, ply, wait_for_loading):
    open_paths(core, [ply("room")])
    assert core.scene is None, "opening does not wait"
    wait_for_loading(core)
    assert core.scene is not None
    assert core.scene.name == "room.ply"
    assert len(core.picture.loaded[-1]) == 40
    assert core.preferences.recent[0].endswith("room.ply")
    camera = core.camera
    t = camera.R_camera_world @ core.scene.centre + camera.t_camera_world
    assert t[2] > 0, "the scene is in front of the eye"
    assert abs(t[0] / t[2]) < 0.2 and abs(t[1] / t[2]) < 0.2, "and in the middle"
    assert "40 splats" in said(core)


def test_several_files_are_merged_in_order(core, ply, wait_for_loading, random_gaussians):
    open_paths(core, [ply("a", 10, sh_degree=0), ply("b", 20, sh_degree=2, seed=1)])
    wait_for_loading(core)
    assert len(core.scene.gaussians) == 30
    np.testing.assert_array_equal(
        core.scene.gaussians.means[10:], random_gaussians(20, sh_degree=2, seed=1).means
    )
    assert core.scene.name == "a.ply and 1 more"
    assert [name.rsplit("/")[-1] for name in core.preferences.recent] == ["a.ply", "b.ply"]


def test_adding_keeps_what_is_there_and_the_view(core, ply, wait_for_loading):
    open_paths(core, [ply("a", 10)])
    wait_for_loading(core)
    view = core.view
    begin(core, [ply("b", 5)], add=True)
    wait_for_loading(core)
    assert len(core.scene.gaussians) == 15
    assert core.view is view


def test_reading_again_takes_what_is_new_and_keeps_the_view(core, ply, wait_for_loading):
    path = ply("a", 10)
    open_paths(core, [path])
    wait_for_loading(core)
    core.steer(orbit(core.view, 0.5, 0.1))
    view = core.view
    assert ply("a", 25) == path
    opening.reload(core)
    wait_for_loading(core)
    assert len(core.scene.gaussians) == 25
    assert core.view is view


def test_recent_files_that_are_gone_are_forgotten(core, ply, wait_for_loading):
    path, other = ply("a"), ply("b")
    for opened in (other, path):
        open_paths(core, [opened])
        wait_for_loading(core)
    path.unlink()
    open_paths(core, [path])
    wait_for_loading(core)
    assert core.preferences.recent == (str(other),)


def test_a_broken_file_is_told_once_and_the_old_scene_stays(core, ply, wait_for_loading, tmp_path):
    open_paths(core, [ply("good")])
    wait_for_loading(core)
    kept, uploads = core.scene, len(core.picture.loaded)
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    open_paths(core, [bad])
    wait_for_loading(core)
    assert core.scene is kept
    assert "bad.ply" in core.problem
    assert "\n" not in core.problem
    assert len(core.picture.loaded) == uploads


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("surprise"), RecursionError("deep")])
def test_whatever_a_reader_raises_becomes_one_line(core, ply, wait_for_loading, monkeypatch, error):
    def fail(path, **_):
        raise error

    monkeypatch.setattr(loading, "load_scene", fail)
    open_paths(core, [ply("odd")])
    wait_for_loading(core)
    assert "odd.ply" in core.problem
    assert core.scene is None


def test_a_scene_too_big_for_the_gpu_leaves_the_old_one_shown(core, ply, wait_for_loading):
    open_paths(core, [ply("small", 10)])
    wait_for_loading(core)
    kept = core.scene
    core.picture.too_big = 30
    open_paths(core, [ply("big", 30)])
    wait_for_loading(core)
    assert core.scene is kept
    assert core.picture.loaded[-1] is kept.gaussians
    assert "big.ply" in core.problem


@pytest.fixture
def slow_reader(monkeypatch):
    """Reading goes on until it is cancelled."""
    started = threading.Event()

    def read(path, *, progress, cancelled):
        progress(0.25)
        started.set()
        while not cancelled():
            time.sleep(0.001)
        raise LoadCancelled

    monkeypatch.setattr(loading, "load_scene", read)
    return started


def test_cancelling_ends_the_thread_and_says_nothing_is_wrong(core, ply, slow_reader):
    open_paths(core, [ply("a")])
    running = core.loading
    assert slow_reader.wait(10)
    assert running.progress == pytest.approx(0.25)
    cancel_loading(core)
    running.join(10)
    assert running.done
    assert core.loading is None
    assert core.problem is None
    assert "Cancelled loading a.ply" in said(core)


def test_cancelling_an_upload_keeps_the_old_scene(core, ply, wait_for_loading, monkeypatch):
    open_paths(core, [ply("a", 10)])
    wait_for_loading(core)
    kept, closed = core.scene, []

    def endless(gaussians):
        try:
            while True:
                yield 0.1
        finally:
            closed.append(len(gaussians))

    monkeypatch.setattr(core.picture, "load_steps", endless)
    open_paths(core, [ply("b", 20)])
    core.loading.join(10)
    opening.continue_loading(core)
    assert core.loading.stage == "Uploading", "the window gets its turn although the upload goes on"
    cancel_loading(core)
    assert closed == [20]
    assert core.scene is kept
    opening.continue_loading(core)
    assert core.scene is kept


def test_a_second_file_cancels_the_first(core, ply, slow_reader, monkeypatch, wait_for_loading):
    open_paths(core, [ply("a")])
    first = core.loading
    assert slow_reader.wait(10)
    monkeypatch.undo()
    open_paths(core, [ply("b", 7)])
    assert first.cancelled
    wait_for_loading(core)
    assert core.scene.name == "b.ply"
    first.join(10)
    assert first.done


def test_progress_of_several_files_goes_by_their_sizes(core, ply, monkeypatch, wait_for_loading):
    seen: list[float] = []
    real = loading.load_scene

    begun = threading.Event()

    def read(path, *, progress, cancelled):
        assert begun.wait(10)
        progress(1.0)
        assert core.loading is not None
        seen.append(core.loading.progress)
        return real(path)

    monkeypatch.setattr(loading, "load_scene", read)
    small, large = ply("small", 100), ply("large", 300)
    begin(core, [small, large])
    begun.set()
    wait_for_loading(core)
    assert core.scene is not None
    share = small.stat().st_size / (small.stat().st_size + large.stat().st_size)
    assert seen == pytest.approx([share, 1.0])


def test_a_dropped_camera_is_gone_to(core, ply, wait_for_loading, tmp_path):
    open_paths(core, [ply("a")])
    wait_for_loading(core)
    camera = look_at((3, 2, 1), (0, 0, 0), width=320, height=200, fov_y=35)
    save_camera(camera, tmp_path / "cam.json")
    open_paths(core, [tmp_path / "cam.json"])
    assert core.camera.same_view(camera) or np.allclose(
        core.camera.world_to_camera, camera.world_to_camera, atol=1e-12
    )
    assert core.camera.fy == pytest.approx(camera.fy)
    assert core.scene.name == "a.ply", "the scene stays"


def test_a_camera_lists_common_up_becomes_the_up_axis(core, tmp_path, wait_for_loading):
    up = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    around = [look_at((3 * np.cos(a), 3 * np.sin(a), 1), (0, 0, 0.3), up=up) for a in np.arange(0, 6.28, 0.5)]
    found = common_up(around)
    assert found is not None
    assert float(found @ up) > 0.99
    assert common_up(around[:2]) is None, "too few to tell"
    rolled = [look_at((0, 0, -3), (0, 0, 0), up=(np.cos(a), np.sin(a), 0)) for a in np.arange(0, 6.28, 0.5)]
    assert common_up(rolled) is None, "they do not agree"


def test_a_folder_without_cameras_is_refused_in_one_line(core, tmp_path):
    open_paths(core, [tmp_path])
    assert str(tmp_path) in core.problem
    assert "\n" not in core.problem


def test_a_missing_file_is_refused_in_one_line(core, tmp_path, wait_for_loading):
    open_paths(core, [tmp_path / "nowhere.ply"])
    wait_for_loading(core)
    assert "nowhere.ply" in core.problem


@pytest.mark.parametrize(
    ("direction", "expected"),
    [((0.1, -0.9, 0.3), (0, -1, 0)), ((0, 0, 2), (0, 0, 1)), ((-1, 0.9, 0), (-1, 0, 0))],
)
def test_the_up_axis_is_the_nearest_one(direction, expected):
    np.testing.assert_array_equal(nearest_axis(np.array(direction)), expected)


def test_the_demo_opens_without_a_file(core, wait_for_loading, monkeypatch):
    monkeypatch.setattr(loading, "cached_demo", lambda **_: demo_scene(splats=3000))
    opening.begin_demo(core)
    wait_for_loading(core)
    assert core.scene is not None
    assert len(core.scene.gaussians) > 1000
    assert core.scene_path is None
    assert core.preferences.recent == ()


def test_a_shown_scene_is_examined_and_ill_splats_are_told(
    core, tmp_path, random_gaussians, wait_for_loading
):
    scene = random_gaussians(30)
    scene.means[:4] = np.nan
    save_scene(scene, tmp_path / "ill.ply")
    open_paths(core, [tmp_path / "ill.ply"])
    wait_for_loading(core)
    assert core.scene is not None
    core.examination.join(30)
    opening.report_examination(core)
    opening.report_examination(core)
    told = [message.text for message in core.messages if "left out" in message.text]
    assert len(told) == 1
    assert told[0].startswith("4 splats")
    assert any(effect.name.startswith("SH band") for effect in core.examination.effects)
