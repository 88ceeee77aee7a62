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
    return drive_once("all_hands", path, script="hands_drives.py", size=(1000, 700))


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
    assert hints.pop("none").startswith("Drag: orbit")
    assert len(hints) == 8 == len(set(hints.values()))
    for tool, hint in hints.items():
        assert "orbit" not in hint and "Alt + drag: turn" in hint and "Esc: done" in hint
        assert ("Shift: add" in hint) == (tool not in ("measure", "ground"))
        assert hint.startswith("Drag") == (tool in ("rectangle", "lasso", "brush"))


def test_the_edit_panel_stands_still_when_a_tool_is_taken_or_a_job_runs(found):
    places = found["tools_and_jobs"]["places"]
    assert len(places) == 11 and len(set(places)) == 1


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


def test_putting_panels_back_opens_closed_ones(found):
    found = found["layout_reset"]
    assert "Views" in found["all"] and set(found["closed"]) == set(found["all"]) - {"Views"}
    assert found["hidden"] == ["View"]
    assert found["back"] == found["again"] == found["all"]


def test_highlight_and_handles_go_with_their_sections(found):
    found = found["sections"]
    seen = {name: tuple(found[name]) for name in found if name not in ("detected", "selected", "titles")}
    assert seen == {
        "moving": (False, "Move"),
        "other_tab": (False, ""),
        "crop": (False, "Move"),
        "crop_alone": (False, "Crop"),
        "shut": (False, ""),
        "looking": (True, ""),
        "looked": (False, ""),
        "looking_again": (True, ""),
    }


def test_what_a_detector_finds_is_selected_on_a_click(found):
    found = found["sections"]
    assert 0 < found["selected"] == found["detected"] < TOTAL
    assert found["titles"][-1] == f"Select by faint: {found['selected']} selected"
