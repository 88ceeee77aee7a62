"""Cleaning up as a person does it, in a real window, and the same by its recipe without one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.scene import Gaussians, concatenate
from splatview.scene.formats import load_scene, save_scene


@pytest.fixture
def scene(random_gaussians) -> Gaussians:
    """A ball of splats, and a few small ones beside it."""
    ball: Gaussians = random_gaussians(3000, seed=4)
    far = random_gaussians(6, seed=5)
    away = np.full((6, 3), (2.4, 0.1, 0.0), np.float32) + far.means * np.float32(0.01)
    floaters = Gaussians(
        means=away.astype(np.float32),
        quats=far.quats,
        log_scales=np.full((6, 3), -4, np.float32),
        opacity_logits=far.opacity_logits,
        sh=far.sh,
    )
    return concatenate([ball, floaters])


@pytest.fixture
def where(tmp_path) -> dict[str, str]:
    return {
        "out": str(tmp_path / "out.ply"),
        "recipe": str(tmp_path / "steps.json"),
        "journals": str(tmp_path / "config" / "journals"),
    }


def check(found: dict, path: Path, where: dict[str, str]) -> None:
    """What must hold of a clean-up of any scene; replays its recipe."""
    total = found["before"]["kept"]
    assert found["before"]["selected"] == 0
    assert 0 < found["box"]["selected"] < total
    assert found["brush"]["selected"] > found["box"]["selected"]
    assert found["brush_kept_the_box"]
    assert found["deleted"] == {
        "selected": 0,
        "deleted": found["brush"]["selected"],
        "kept": total - found["brush"]["selected"],
    }
    assert found["change_by_deleting"] > 0.05
    assert found["undone"] == found["brush"], "the selection is back too"
    assert found["change_after_undo"] == 0
    assert found["exported_after_crop"] <= found["deleted"]["kept"]
    assert found["floaters"] > 0 and found["lit_up"]
    mean, worst, _ = found["price"]
    assert 0 < worst <= mean
    assert found["pruned"]["deleted"] == found["deleted"]["deleted"] + found["floaters"]

    exported = load_scene(where["out"])
    assert found["reopened"]["kept"] == len(exported) < total
    replayed = Path(where["out"]).with_name("replayed.ply")
    assert main(["edit", str(path), "--recipe", where["recipe"], "-o", str(replayed)]) == 0
    assert replayed.read_bytes() == Path(where["out"]).read_bytes()


def test_a_scene_is_cleaned_up(drive, scene, tmp_path, where):
    path = tmp_path / "scene.ply"
    save_scene(scene, path)
    found = drive(
        "clean_up",
        path,
        script="editing_drives.py",
        half_extents=(3.0, 0.8, 1.2),
        threshold=100.0,
        **where,
    )
    check(found, path, where)
    np.testing.assert_allclose(found["crop"], (3.0, 0.8, 1.2), rtol=1e-6)
    assert found["floaters"] == 6
    assert not found["crop_moved"]
    assert not list(Path(where["journals"]).glob("*")), "exported, so nothing is left to restore"


@pytest.mark.slow
def test_playbot_is_cleaned_up(drive, data_file, where):
    path = data_file("scenes/playbot_lod0.ply")
    found = drive(
        "clean_up",
        path,
        script="editing_drives.py",
        half_extents=(0.9, 1.2, 0.9),
        threshold=3000.0,
        renderer="auto",
        **where,
    )
    check(found, path, where)


def test_edits_left_in_no_file_are_offered_at_the_next_start(drive, scene, tmp_path):
    path = tmp_path / "scene.ply"
    save_scene(scene, path)
    left = drive("leave_edits", path, script="editing_drives.py")
    back = drive("restore_edits", path, script="editing_drives.py")
    assert back["offered"] == "restore"
    assert back["restored"] == left["deleted"]
    assert left["deleted"]["deleted"] > 0
    assert "the next start offers to restore them" in left["output"]


def test_commands_are_found_by_words_and_sliders_preview(drive, scene, tmp_path):
    path = tmp_path / "scene.ply"
    save_scene(scene, path)
    found = drive("by_words", path, script="editing_drives.py")
    assert found["selected"] == len(scene)
    assert found["palette_shut"]
    assert found["previewed"]
    assert found["brighter"] > 0.01
    assert found["cancelled"] == 0
    assert found["colourfulness"] < 0.01
    assert found["opacity_row"][:2] == [0, 0.25]
    half = np.radians(15)
    np.testing.assert_allclose(found["turned"], (np.cos(half), 0, np.sin(half), 0), atol=1e-5)
    assert [title.split()[0] for title in found["history"]] == ["Select", "Grade", "Transform"]
    assert found["back"] == 0


def test_handles_on_the_picture_are_dragged(drive, scene, tmp_path):
    path = tmp_path / "scene.ply"
    save_scene(scene, path)
    found = drive("by_handles", path, script="editing_drives.py")
    titles = [title.split()[0] for title in found["history"]]
    assert titles == ["Select", "Transform", "Transform", "Transform", "Add", "Change"]
    assert np.abs(found["moved"]).max() > 0.05 and np.count_nonzero(np.round(found["moved"], 3)) == 1
    assert np.abs(found["turned"]).max() > 1
    assert abs(found["scaled"] - 1) > 0.05
    assert abs(found["crop_moved"][0]) > 0.05
    start, dragged, panned, zoomed, orbited = found["camera"]
    assert dragged == start, "the left button is the handles'"
    assert panned["target"] != start["target"], "the right button is not"
    assert zoomed["distance"] < panned["distance"]
    assert orbited["forward"] != zoomed["forward"], "a drag that begins beside the handles is not theirs"
    assert found["steps"] == len(titles)
