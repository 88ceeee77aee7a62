"""The Export dialog in a real window: what is written is what was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.scene.formats import load_scene, save_scene

TOTAL = 120


@pytest.fixture(scope="module")
def folder(tmp_path_factory, random_gaussians) -> Path:
    folder: Path = tmp_path_factory.mktemp("export")
    scene = random_gaussians(TOTAL, sh_degree=1, seed=4)
    save_scene(replace(scene, log_scales=scene.log_scales - np.float32(1.5)), folder / "scene.sog")
    (folder / "foreign").mkdir()
    (folder / "foreign" / "letter.txt").write_text("dear")
    return folder


@pytest.fixture(scope="module")
def found(drive_once, folder) -> dict[str, Any]:
    options = {"folder": str(folder)}
    return drive_once("exports", folder / "scene.sog", script="export_drives.py", **options)


def test_the_menu_opens_the_dialog_and_nothing_is_measured_yet(found, folder):
    assert found["opened"] == "export"
    assert found["first"] == [str(folder / "scene-edited.ply"), True]


def test_measuring_writes_nothing_of_the_users(found):
    assert found["format"] == ["spz", "scene-edited.spz"]
    assert found["measured"] == [True, ["foreign", "scene.sog"]]


def test_what_is_written_is_what_was_measured(found, folder):
    assert found["plain"] == found["said"][0] and found["said"][1] > 20
    assert found["closed"] is None and len(load_scene(folder / "plain.spz")) == TOTAL


def test_another_setting_asks_for_another_measurement(found):
    assert found["stale"] is False


def test_a_search_is_cancelled_and_a_target_met(found):
    assert found["searching"] and found["cancelled"][0] and "cancelled" in found["cancelled"][1]
    assert found["target"][1] >= 40 or found["target"][1] == found["said"][1]
    assert found["small"] == found["target"][0]


def test_only_the_selection_is_exported_where_that_is_asked_for(found, folder):
    assert "no splats are selected" in found["none_selected"][0] and found["none_selected"][1] == "export"
    assert len(load_scene(folder / "sogs")) == found["selected"] == TOTAL
    assert "meta.json" in found["folder"]


def test_a_folder_of_something_else_is_refused(found, folder):
    assert not found["foreign"] and (folder / "foreign" / "letter.txt").read_text() == "dear"


def test_a_scene_is_turned_over_and_back(found):
    x, y, z = found["upright"]
    assert found["turned"] == pytest.approx([x, -y, -z], abs=1e-5)
    assert found["undone"] == [x, y, z]
    assert found["step"]["op"] == "transform" and found["step"]["scope"] == "scene"
