"""A film in a real window: keyframes by keys and mouse, played, changed, saved, opened and exported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from splatview.cli.main import main
from splatview.scene.camera_path_files import load_camera_path
from splatview.scene.formats import save_scene


@pytest.fixture(scope="module")
def found(drive_once, tmp_path_factory, random_gaussians) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("films")
    scene = folder / "scene.ply"
    save_scene(random_gaussians(300, seed=4), scene)
    options = {
        "path": str(folder / "way.json"),
        "folder": str(folder / "frames"),
        "stopped": str(folder / "stopped"),
    }
    told = drive_once("whole", scene, script="film_drives.py", size=(1000, 650), renderer="cpu", **options)
    left = sorted(entry.name for entry in folder.iterdir())
    return options | told | {"scene": scene, "left": left}


def test_keyframes_are_added_where_the_camera_is(found):
    added = found["added"]
    assert added["times"] == [0, 2, 4] and added["length"] == 4 and added["chosen"] == 2
    assert len({tuple(np.round(eye, 6)) for eye in added["views"]}) == 3


def test_a_click_on_a_keyframe_goes_there_and_keys_step(found):
    views = found["added"]["views"]
    assert found["clicked"]["chosen"] == 1 and found["clicked"]["time"] == 2
    np.testing.assert_allclose(found["clicked"]["eye"], views[1], atol=1e-9)
    assert found["next"]["chosen"] == 2
    np.testing.assert_allclose(found["next"]["eye"], views[2], atol=1e-9)


def test_a_drag_moves_a_keyframe_in_time(found):
    times = found["dragged"]["times"]
    assert times[:2] == [0, 2] and times[2] == pytest.approx(3.0, abs=0.05)
    assert found["dragged"]["length"] == pytest.approx(times[2], abs=1e-3)


def test_the_playhead_follows_the_mouse_and_the_camera_the_playhead(found):
    scrubbed, views = found["scrubbed"], found["added"]["views"]
    assert scrubbed["time"] == pytest.approx(1.0, abs=0.05) and not scrubbed["playing"]
    apart = [np.linalg.norm(np.subtract(scrubbed["eye"], view)) for view in views[:2]]
    assert min(apart) > 0.05, "between two keyframes"


def test_it_plays_until_the_user_moves_the_view(found):
    assert found["played"]["playing"] and found["played"]["time"] > 1.3
    assert not found["stopped"]["playing"]
    assert not found["paused"]["playing"]


def test_deleting_is_undone_and_a_loop_takes_time_for_the_way_back(found):
    assert len(found["deleted"]["times"]) == 2
    assert found["undone"]["times"] == found["dragged"]["times"]
    last = found["undone"]["times"][-1]
    assert found["looped"]["loop"] and found["looped"]["length"] == pytest.approx(1.5 * last, abs=1e-3)


def test_a_turntable_goes_round_and_a_saved_path_comes_back(found):
    assert found["turntable"]["loop"] and len(found["turntable"]["times"]) == 4
    assert not found["turntable"]["playing"], "Escape stops it"
    assert found["opened"]["times"] == found["looped"]["times"]
    path = load_camera_path(Path(found["path"])).path
    assert [round(key.time, 3) for key in path.keyframes] == found["looped"]["times"] and path.loop


def test_the_exported_film_is_that_of_the_command_line(found, tmp_path, capsys):
    frames = found["frames"]
    count = round(4 * found["opened"]["length"])
    assert frames == [f"frame_{i + 1:05}.png" for i in range(count)]
    argv = ["film", found["scene"], "--path", found["path"], "-o", tmp_path / "own", "--size", "64x48"]
    argv += ["--fps", 4, "--renderer", "cpu", "--background", "0,0,0"]
    assert main([str(argument) for argument in argv]) == 0, capsys.readouterr().err
    for name in frames:
        pictures = [
            np.asarray(Image.open(f"{folder}/{name}")) for folder in (Path(found["folder"]), tmp_path / "own")
        ]
        assert abs(pictures[0].astype(int) - pictures[1]).max() <= 1


def test_a_film_that_is_stopped_leaves_nothing(found):
    assert found["ended"][:2] == [True, False] and "nothing is written" in found["ended"][2]
    assert found["left"] == ["frames", "scene.ply", "way.json"]
