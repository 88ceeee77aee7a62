"""Saving, the file browser, the start screen and the settings in real windows, by mouse and keys."""

from __future__ import annotations

import pytest

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
        size=(1000, 700),
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
    found = drive("browses", scene_file, script="start_drives.py", folder=str(tmp_path), size=(1000, 700))
    assert found["completed"] == "ga", "two folders begin with it, and differ then"
    assert found["listed"] == str(tmp_path) and found["narrowed"] == []
