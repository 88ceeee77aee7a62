"""What keys, menus, buttons and notes of the window do, all found out in one window."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from splatview.scene.formats import save_scene

TOTAL = 900


@pytest.fixture(scope="module")
def found(drive_once, tmp_path_factory, random_gaussians) -> dict[str, Any]:
    path: Path = tmp_path_factory.mktemp("scene") / "scene.ply"
    save_scene(random_gaussians(TOTAL, seed=4), path)
    return drive_once("all_hands", path, script="hands_drives.py")


def test_escape_closes_a_menu_and_other_keys_work_under_it(found):
    found = found["menus_and_keys"]
    assert found["opened"]
    assert found["after_escape"] == [False, "rectangle"], "the tool stays in hand"
    assert found["after_key"] == [False, TOTAL]
    assert found["tool"] == "none"


def test_buttons_that_lack_a_selection_are_disabled(found):
    needy = ["None", "Grow", "Delete", "Hide", "Isolate", "Lock"]
    assert found["buttons"] == {"nothing": needy, "everything": []}


def test_the_status_bar_says_what_a_drag_does_with_a_tool(found):
    hints = found["tools_and_jobs"]["hints"]
    assert hints.pop("none")[0] == "Drag: orbit"
    assert len(hints) == 13
    for tool, hint in hints.items():
        assert "Esc: done" in hint
        assert ("Alt + drag: turn" in hint) != ("Drag beside: orbit" in hint)
        assert ("Shift: add" in hint) == (
            tool in ("rectangle", "lasso", "brush", "polygon", "flood", "colour")
        )
        assert hint[0].startswith("Drag") == (tool not in ("polygon", "flood", "colour", "measure", "ground"))


def test_nothing_moves_when_a_tool_is_taken_or_a_job_runs(found):
    found = found["tools_and_jobs"]
    assert len(found["places"]) == 16 and len(set(found["places"])) == 1
    assert len({tuple(size) for size in found["sizes"]}) == 1, "the picture keeps its size"


def test_values_of_sliders_lie_beside_them(found):
    found = found["sliders"]
    assert found["apart"]
    assert found["dragged"] > 0.08 and found["dragged"] == round(found["dragged"], 3)
    assert found["typed"] == pytest.approx(0.1234, abs=1e-6)
    assert found["typed_on_it"] == 0.25


def test_grading_a_selection_shows_its_colours(found):
    found = found["grading"]
    assert found["before"] > 0.1 and found["after"] > 0.1, "tinted"
    assert found["preview"] < 0.01


def test_the_layout_is_changed_and_reset(found):
    found = found["layout_reset"]
    page, strip, hidden, width = found["new"]
    assert (page, strip, hidden) == ("Scene", "", False)
    assert found["changed"] == ["View", "History", False, width + 80]
    assert found["shut"] == ["", "History", False, width + 80]
    assert found["hidden"][2]
    assert found["back"] == found["new"]


def test_highlight_and_handles_go_with_their_tools_and_sections(found):
    found = found["sections"]
    assert found.pop("page") == "Edit", "what is added by name is shown"
    seen = {name: tuple(found[name]) for name in found if name not in ("detected", "selected", "titles")}
    assert seen == {
        "moving": (False, "Transform"),
        "put_back": (False, ""),
        "crop": (False, "Crop"),
        "shut": (False, ""),
        "crop_tool": (False, "Crop", 1),
        "sphere_tool": (False, "Crop", 2),
        "looking": (True, ""),
        "looked": (False, ""),
        "looking_again": (True, ""),
    }


def test_what_a_detector_finds_is_selected_on_a_click(found):
    found = found["sections"]
    assert 0 < found["selected"] == found["detected"] < TOTAL
    assert found["titles"][-1] == f"Select by faint: {found['selected']} selected"
