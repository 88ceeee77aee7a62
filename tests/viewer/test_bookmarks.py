"""Bookmarks lie beside the scene, or where they can, and come back as they were."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pyrr import matrix33

from splatview.scene import InputError
from splatview.viewer import preferences as module
from splatview.viewer.navigation import Lens, View
from splatview.viewer.preferences import Bookmark, beside, in_config, load_bookmarks, save_bookmarks


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(tmp_path / "config"))
    path = tmp_path / "scenes" / "room.ply"
    path.parent.mkdir()
    path.write_bytes(b"ply\n")
    return path


def some_view(angle: float = 0.7) -> View:
    return View(
        target=np.array([1e6 + 0.125, -2.0, 3.5]),
        distance=4.25,
        R_camera_world=matrix33.create_from_axis_rotation(np.array([1.0, 2.0, 3.0]), angle),
        up=np.array([0.0, -1.0, 0.0]),
        lens=Lens(fov_y=33.0, shift=(0.01, -0.02), squeeze=1.1),
    )


def test_they_come_back_exactly(scene):
    assert load_bookmarks(scene) == []
    assert save_bookmarks(scene, [Bookmark(name="Tür", view=some_view())]) == beside(scene)
    (found,) = load_bookmarks(scene)
    assert found.name == "Tür"
    np.testing.assert_array_equal(found.view.target, some_view().target)
    np.testing.assert_allclose(found.view.R_camera_world, some_view().R_camera_world, atol=1e-15)
    assert found.view.distance == 4.25
    assert found.view.lens == some_view().lens


def test_where_the_folder_refuses_they_go_to_the_configuration(scene, monkeypatch):
    real = module.write_json

    def refuse(path, data):
        if path.parent == scene.parent:
            raise InputError("read-only")
        real(path, data)

    monkeypatch.setattr(module, "write_json", refuse)
    kept = [Bookmark(name="View 1", view=some_view())]
    assert save_bookmarks(scene, kept) == in_config(scene)
    assert [b.name for b in load_bookmarks(scene)] == ["View 1"]

    monkeypatch.setattr(module, "write_json", real)
    assert save_bookmarks(scene, load_bookmarks(scene)) == beside(scene)
    assert [b.name for b in load_bookmarks(scene)] == ["View 1"], "once, not from both places"


def test_scenes_of_one_name_do_not_share_bookmarks(scene, tmp_path):
    assert in_config(scene) != in_config(tmp_path / "room.ply")


@pytest.mark.parametrize(
    "change",
    [
        {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]},
        {"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]},
        {"rotation": 3},
        {"target": [1, 2]},
        {"target": [1, 2, None]},
        {"distance": 0},
        {"distance": "near"},
        {"fov_y": 400},
        {"up": [0, 0, 0]},
        {"shift": [1]},
    ],
)
def test_a_damaged_file_is_named_in_one_line(scene, change):
    save_bookmarks(scene, [Bookmark(name="View 1", view=some_view())])
    data = json.loads(beside(scene).read_text())
    data["bookmarks"][0].update(change)
    beside(scene).write_text(json.dumps(data))
    with pytest.raises(InputError) as error:
        load_bookmarks(scene)
    assert str(beside(scene)) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"bookmarks": 3}', "nonsense"])
def test_a_file_that_is_none_is_named_too(scene, text):
    beside(scene).write_text(text)
    with pytest.raises(InputError, match=r"room\.ply\.bookmarks\.json"):
        load_bookmarks(scene)
