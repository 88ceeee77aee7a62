"""A sequence in a real window: opened, played, stepped, dragged, edited and left, found out in one window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from splatview.scene.formats import save_scene

FRAMES, DAMAGED = 12, 3


@pytest.fixture(scope="module")
def found(drive_once, tmp_path_factory, random_gaussians) -> dict[str, Any]:
    folder: Path = tmp_path_factory.mktemp("frames")
    scene = random_gaussians(400, seed=8)
    for i in range(FRAMES):
        moved = replace(scene, means=scene.means + scene.means.dtype.type(0.02 * i))
        save_scene(moved.take(slice(0, 300 + 5 * i)), folder / f"frame_{i + 1}.ply")
    damaged = folder / f"frame_{DAMAGED + 1}.ply"
    damaged.write_bytes(damaged.read_bytes()[:2000])
    other = tmp_path_factory.mktemp("other") / "other.ply"
    save_scene(random_gaussians(50, seed=9), other)
    return drive_once(
        "whole",
        other,
        script="sequence_drives.py",
        size=(1000, 650),
        folder=str(folder),
        other=str(other),
    )


def file(index: int) -> dict[str, Any]:
    """What is seen at rest on a frame."""
    return {
        "frame": index,
        "shown": index,
        "file": f"frame_{index + 1}.ply",
        "splats": 300 + 5 * index,
        "playing": False,
    }


def test_the_strip_is_there_with_a_sequence_and_gone_with_another_scene(found):
    assert not found["strip_before"] and found["closed"] == [True, True]
    assert 40 < found["picture_shrinks"] < 100
    assert found["menu"] and not found["menu_after"]
    said = found["opened"].pop("said")
    assert found["opened"] == file(0)
    assert said[0].endswith("12 frames from frame_1.ply to frame_12.ply")


def test_a_damaged_frame_is_told_once_and_skipped(found):
    assert list(found["failed"]) == [str(DAMAGED)]
    assert len(found["told"]) == 1 and "frame_4.ply" in found["told"][0]
    assert DAMAGED not in found["played"]["shown"]
    on_it = found["on_damaged"]
    assert on_it["frame"] == DAMAGED and on_it["shown"] != DAMAGED


def test_keys_step_and_go_to_the_ends(found):
    steps = {name: found[name] for name in ("next", "over", "back", "last", "round")}
    assert steps == {"next": file(1), "over": file(2), "back": file(1), "last": file(11), "round": file(0)}


def test_it_plays_while_view_and_mode_stay(found):
    assert len(found["played"]["shown"]) >= 5 and found["played"]["reached"] > 0
    assert not found["session_while_playing"]
    assert found["paused"] == file(found["paused"]["frame"])
    assert found["view"] == found["view_after"]
    assert found["mode"] == "ellipsoids"


def test_the_slider_follows_the_mouse(found):
    assert found["pressed"] == 0 < found["dragged"]
    assert found["released"] == file(found["dragged"])


def test_rate_repeat_and_number_are_set_in_the_strip(found):
    assert found["rate"] == 12.5
    assert found["mode_chosen"] == "bounce"
    assert found["typed"] == file(8)


def test_the_palette_finds_it(found):
    first = {word: ids[0] for word, ids in found["palette"].items()}
    wanted = {
        "play": "play",
        "next frame": "next_frame",
        "previous frame": "previous_frame",
        "frame rate": "rate_24",
        "loop": "play_loop",
    }
    assert {word: first[word] for word in wanted} == wanted
    assert "play" in found["palette"]["pause"] and "play" in found["palette"]["timeline"]


def test_edits_hold_the_frame_until_they_are_kept_or_given_up(found):
    assert found["selection_is_left"] == file(9), "a selection is no loss"
    held = found["held"]
    assert "is edited" in held.pop("said") and held.pop("steps")
    assert held == file(9)
    assert found["undone"] == file(10)
    assert found["discarded"] == file(10) | {"deleted": 0}


def test_an_edit_pauses_a_sequence_that_plays(found):
    edited = found["edited_in_play"]
    assert edited.pop("selected") == edited["splats"]
    assert edited == file(edited["frame"])


def test_the_folder_is_among_the_recent(found):
    assert any(name.startswith("frames") for name in found["recent"])
    assert "frame_1.ply" not in found["recent"]
