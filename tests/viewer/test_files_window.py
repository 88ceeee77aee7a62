"""The files of the Scene page, by mouse and keys, all found out in one window."""

from __future__ import annotations

from typing import Any

import pytest

from splatview.scene.formats import save_scene

A, B = 500, 300

ROUNDING = 2**-10
"""A step of float16 below 2, in which a window blends: a GPU's compiler contracts other sums in the program
that is compiled for what a picture calls for than in the one that stands in for it until then."""


def same(found: dict[str, Any]) -> Any:
    """No change of a picture, to the bit where OpenGL is software."""
    return pytest.approx(0) if found["software"] else pytest.approx(0, abs=ROUNDING)


@pytest.fixture(scope="module")
def found(drive_once, tmp_path_factory, random_gaussians) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("scenes")
    first, second = folder / "room.ply", folder / "table.ply"
    save_scene(random_gaussians(A, seed=4), first)
    save_scene(random_gaussians(B, seed=5), second)
    return drive_once("scene_page", first, script="files_drives.py", second=str(second), size=(1000, 700))


def test_an_imported_file_is_a_row_of_its_own(found):
    assert found["imported"] == {
        "files": ["room.ply", "table.ply"],
        "counts": [A, B],
        "active": 1,
        "subject": "file",
        "paths": 1,
    }
    assert found["alone"] > 0.1
    count, change = found["undone"]
    assert count == 1 and change == same(found), "undone, the scene is the first file again"


PARTS = ("eye", "lock", "numbers", "handles", "names", "removal", "saving")


@pytest.mark.parametrize("part", PARTS)
def test_undo_takes_everything_back(found, part):
    assert found[part]["back"] == same(found)


def test_the_eye_hides_a_file_from_picture_counts_and_exports(found):
    eye = found["eye"]
    hidden, change = eye["hidden"]
    assert hidden == B and change > 0.1
    assert (eye["visible"], eye["everything"]) == (A, A + B)
    assert eye["shown"] == [0, same(found)]
    assert eye["titles"] == ["Hide table.ply", "Show table.ply"]


def test_a_locked_file_is_neither_selected_nor_deleted_nor_moved(found):
    lock = found["lock"]
    assert lock["selected"] == [0, B]
    assert lock["left"] == [A, 0]
    assert lock["handles"] == ""


def test_numbers_place_the_active_file(found):
    numbers = found["numbers"]
    translation, rotation, scale = numbers["placement"]
    assert translation == [0.5, 0.0, 0.0] and scale == 2.0
    assert rotation == pytest.approx([0.5, 0.0, 3**0.5 / 2, 0.0])
    assert numbers["angles"] == [0.0, 120.0, 0.0], "as they were typed"
    assert numbers["titles"] == ["Transform table.ply"] * 3
    assert numbers["reset"] == [0.0, 0.0, 0.0]


def test_handles_move_the_active_file_alone(found):
    handles = found["handles"]
    assert (handles["tool"], handles["subject"]) == ("move", "file")
    first, second = handles["moved"]
    assert first == [0, 0, 0] and max(map(abs, second)) > 0.05
    assert handles["same_arrays"], "no copy of the scene"
    assert handles["titles"] == ["Hide room.ply", "Transform table.ply"]


def test_a_file_is_renamed_and_selected(found):
    names = found["names"]
    assert names["name"] == "chair"
    assert (names["selected"], names["subject"]) == (B, "selection")


def test_a_file_is_removed(found):
    assert found["removal"]["kept"] == A
    assert not found["removal"]["active"]


def test_saving_several_files_asks_for_a_name(found):
    assert "several files" in found["saving"]["asks"]
