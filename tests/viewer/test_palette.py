"""The palette: what people type, and what they mean by it."""

from __future__ import annotations

import pytest

from splatview.viewer.commands import COMMANDS
from splatview.viewer.palette import matching

MEANT = {
    "accuracy": "page_accuracy",
    "split view": "section_compare",
    "compare": "section_compare",
    "colour grade": "section_colour",
    "brightness": "section_colour",
    "exposure": "section_colour",
    "rotate": "tool_rotate",
    "transform": "section_transform",
    "gizmo": "tool_move",
    "scale": "tool_scale",
    "histogram": "section_select",
    "opacity": "section_colour",
    "decimate": "section_decimate",
    "prune": "section_clean",
    "floaters": "find_clusters",
    "statistics": "section_statistics",
    "sh degree": "section_sh_degree",
    "fps": "section_statistics",
    "demo": "demo",
    "screenshot": "screenshot",
    "recent": "recent",
    "theme": "theme",
    "film": "strip_film",
    "keyframe": "add_keyframe",
    "camera path": "strip_film",
    "animation": "strip_film",
    "fly through": "strip_film",
    "video": "export_film",
    "turntable": "turntable",
    "font": "font",
    "train": "page_train",
    "photos": "page_train",
    "export": "export",
    "save": "save",
    "undo": "undo",
    "crop": "tool_crop_box",
    "sphere": "tool_crop_sphere",
    "measure": "tool_measure",
    "depth": "mode_depth",
    "background": "section_background",
    "lens": "section_lens",
    "fisheye": "section_lens",
    "aperture": "section_aperture",
    "focus": "focus_by_click",
    "up": "up_+Y",
    "grid": "toggle_grid",
    "axes": "toggle_axes",
    "normals": "mode_normals",
    "reset": "reset_panels",
    "layout": "reset_panels",
    "help": "toggle_help",
    "keys": "toggle_help",
    "hide": "hide",
    "import": "import",
    "merge": "import",
    "scene manager": "section_files",
    "file list": "section_files",
    "hide file": "file_eye",
    "visibility": "file_eye",
    "lock file": "file_lock",
    "move file": "file_move",
    "reset transform": "file_reset",
    "select file": "file_select",
    "remove file": "file_remove",
}
"""What is typed -> the command that comes first."""


@pytest.mark.parametrize(("typed", "id"), MEANT.items())
def test_what_people_type_finds_what_they_mean(typed, id):
    found = [command.id for command in matching(typed)]
    assert found[:1] == [id]
    if len(typed) > 4:
        assert id in [command.id for command in matching(typed[:-1])[:5]], "near the top while it is typed"


def test_axes_keep_their_sign():
    assert [matching(f"up: {sign}z")[0].id for sign in "+-"] == ["up_+Z", "up_-Z"]


def test_words_are_matched_at_their_beginnings_only():
    assert "tool_rotate" not in [command.id for command in matching("otate")]
    assert not matching("urthermost nonsense")


def test_no_name_belongs_to_two_commands():
    names = [word.casefold() for command in COMMANDS.values() for word in command.words]
    assert sorted(name for name in set(names) if names.count(name) > 1) == []
