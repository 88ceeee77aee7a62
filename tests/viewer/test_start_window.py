"""Saving, the file browser, the start screen and the settings in real windows, by mouse and keys."""

from __future__ import annotations

import json
import shutil

import pytest
from PIL import Image

from splatview.scene.formats import load_scene, save_scene


@pytest.fixture
def scene_file(tmp_path, random_gaussians):
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(1500, seed=4), path)
    return path


def test_saving(drive, scene_file, tmp_path):
    other, rounded = tmp_path / "other.ply", tmp_path / "rounded.splat"
    found = drive(
        "saves",
        scene_file,
        script="start_drives.py",
        other=str(other),
        rounded=str(rounded),
    )
    plain, own = "scene.ply - splatview", "other.ply - splatview"
    assert found["titles"] == [plain, plain, f"• {plain}", plain, own, f"• {own}"], (
        "a selection alone is nothing to save, and a file that rounds no place to keep the scene in"
    )
    assert found["asked"] == "overwrite" and found["asked_again"] == "", "once for each file"
    assert found["after_escape"] == ["", True]
    assert found["asked_for_drop"] == found["asked_at_end"] == "leave"
    assert found["stays"]
    assert len(load_scene(scene_file)) > len(load_scene(other)) > len(load_scene(rounded))
    assert len(load_scene(rounded)) == 1500 - found["deleted"]
    assert not list((tmp_path / "config" / "journals").glob("*.jsonl")), "what was given up stays so"


def test_the_file_browser(drive, scene_file, tmp_path, random_gaussians):
    for place in ("garden/deep.ply", "gallery/other.ply", "notes.txt"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        save_scene(random_gaussians(60), tmp_path / place) if place.endswith("ply") else (
            tmp_path / place
        ).write_text("")
    found = drive("browses", scene_file, script="start_drives.py", folder=str(tmp_path))
    assert found["completed"] == [f"{tmp_path}/ga", f"{tmp_path}/garden/"], "as far as both folders agree"
    assert found["listed"] == str(tmp_path / "garden") and found["narrowed"] == ["deep.ply"]
    assert found["starts_in"] == str(tmp_path / "garden"), "where the last file was"
    assert found["above"] == ["config", "gallery", "garden", "scene.ply"], "notes.txt is no scene"
    assert found["clicked"] == "deep.ply" and found["recent"] == ["deep.ply", "scene.ply"]
    assert found["closed"]
    assert found["missing"].endswith("none.ply: there is no such file")
    assert found["replace"] == "deep.ply exists; Replace writes over it"


def test_the_start_screen_and_a_training_from_it(drive, capture, tmp_path):
    output = tmp_path / "trained.ply"
    capture = shutil.copytree(capture, tmp_path / capture.name)  # others have it without masks
    photos = sorted(capture.rglob("*.png"))
    (capture / "masks").mkdir()
    for photo in photos:
        with Image.open(photo) as image:
            mask = Image.new("L", image.size, 255)
        mask.paste(0, (0, 0, 8, mask.height))
        mask.save(capture / "masks" / f"{photo.name}.png")
    found = drive(
        "starts",
        script="start_drives.py",
        capture=str(capture),
        output=str(output),
        steps=5,
    )
    assert found["open"] == found["again"] == "start" and found["demo_behind"] == "Demo"
    assert found["after_escape"] is None and found["after_click"] is None
    assert found["photos"] == 10 and found["proposed"] == str(capture.parent / "pond.ply")
    assert found["scene"] == "pond (training)" and found["steps"] >= 5
    assert found["memory"] == ["2 GB", False, 2 * 10**9]
    assert found["masks"] == [len(photos), "ignore", "cut-out"] and found["transparent"]
    by_itself, whole, halved, half, again = found["size"]
    assert by_itself is None and again is None and halved == 2
    assert half == [side // 2 for side in whole]
    assert found["bound"] == 2 * 10**9 > found["peak"] and found["told"]
    assert found["chosen"] == ["off", "on", "off", "stay", "on", "white"]
    assert found["backgrounds"] == ["black", "auto", "white"]
    assert found["trained"] == ["off", "on", "off", 1, "on", [1, 1, 1]]
    assert len(load_scene(output)), "saved when the window closed"


def test_captures_that_are_dropped(drive, scene_file, capture, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    found = drive(
        "asks_about_captures", scene_file, script="start_drives.py", capture=str(capture), empty=str(empty)
    )
    assert found["asked"] == "capture" and found["cameras"] == 10
    assert "pip install" in found["lacks"] and found["closed"] is None
    assert found["problem"].startswith(f"{empty}: holds no capture")


def test_a_capture_of_smaller_copies(drive, scene_file, capture, tmp_path):
    folder = shutil.copytree(capture, tmp_path / capture.name)
    (folder / "images").rename(folder / "images_2")
    for photo in (folder / "images_2").iterdir():
        with Image.open(photo) as image:
            image.reduce(2).save(photo)
    output, shots = tmp_path / "trained.ply", "copies"
    options = {"capture": str(folder), "output": str(output), "shots": shots}
    found = drive("trains_on_dropped", scene_file, script="start_drives.py", **options)
    assert found["photos"] == 10 and found["size"] == [48, 36] == found["trained"]
    assert any("10 photos are copies in another size" in text for text in found["messages"])
    assert len(load_scene(output)), "saved when the window closed"


def test_a_capture_that_holds_out_what_it_trains_on(drive, scene_file, capture, tmp_path):
    """Duplicates of its photos, which have the rim of what a lens has seen."""
    folder = shutil.copytree(capture, tmp_path / capture.name)
    for photo in (folder / "images").iterdir():
        with Image.open(photo) as image:
            rim = Image.new("L", image.size)
            rim.paste(255, (6, 6, image.width - 6, image.height - 6))
            image.putalpha(rim)
            image.save(photo)
    shutil.copytree(folder / "images", folder / "test")
    content = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").unlink()
    named = {key: value for key, value in content.items() if not key.endswith("_filenames")}
    (folder / "transforms_train.json").write_text(json.dumps(named))
    for frame in named["frames"]:
        frame["file_path"] = frame["file_path"].replace("images/", "test/")
    (folder / "transforms_test.json").write_text(json.dumps(named))
    options = {"capture": str(folder), "output": str(tmp_path / "trained.ply"), "shots": "rim"}
    found = drive("trains_on_dropped", scene_file, script="start_drives.py", **options)
    messages = "\n".join(found["messages"])
    assert "10 photos are duplicates of others, with their pose, and are left out: test/" in messages
    assert "10 photos are transparent, which does not count as empty" in messages
    assert found["photos"] == 10 and found["trained"] == [96, 72]
    assert len(load_scene(tmp_path / "trained.ply"))


def test_settings(drive, scene_file, tmp_path):
    found = drive("settings", scene_file, script="start_drives.py")
    assert found["open"] == "settings"
    assert (found["light"], found["contrast"]) == ("light", "contrast")
    assert found["heights"] == [1.0, 1.5]
    nothing, orbit, pan, look = [False, False], [True, False], [True, True], [False, True]
    assert found["drags"] == {
        "splatview": [orbit, pan, pan],
        "supersplat": [orbit, pan, orbit],
        "blender": [orbit, nothing, orbit],
        "unreal": [pan, look, pan],
    }, "of the left, right and middle button: whether the eye and its target move"
    assert found["two_fingers"] == orbit and found["wheel"] == orbit
    assert found["blender_b"] == "rectangle" and found["own_b"] == 1
    assert found["blender_a"] == [1500, nothing], "A selects, and flies no more"
    assert found["reset"] == ["splatview", "dark"]
    kept = json.loads((tmp_path / "config" / "preferences.json").read_text())
    assert (kept["theme"], kept["font_size"], kept["keys"]) == ("light", 18.0, "unreal")
