"""The window that trains, as a person uses it: a real one, under Xvfb, by mouse and keys."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.cli.main import main
from splatview.raster import render
from splatview.raster.compiling import niceness
from splatview.scene.captures.demo import demo_capture
from splatview.scene.captures.nerfstudio import save_capture
from splatview.scene.formats import load_scene, save_scene
from splatview.trainer.checkpoint import load_checkpoint
from splatview.viewer.app import ACTIVE_SECONDS
from splatview.viewer.platform import NICENESS

SCRIPT = "training_drives.py"


def test_watch_pause_change_step_export_and_stop(drive, capture, tmp_path):
    long = ["--iterations", "1000000", "--max-splats", "3000"]
    found = drive("all_of_it", capture, script=SCRIPT, train=long)
    assert found["scene"] == "pond (training)"
    assert 0 <= found["shown"][0] < found["shown"][1], "the scene is seen to grow"
    assert found["splats_shown"] > 0
    before, after = found["paused_at"]
    assert before == after, "nothing moves in a pause"
    assert found["drawn_in_pause"] == 0, "and nothing is drawn"
    assert len(set(found["heights"])) == 1, "nothing slides away under the mouse"
    assert found["picture_mean"] > 0.05
    assert found["max_splats"] == [3000, 2234]
    assert found["stepped_to"] == before + 1
    if sys.platform == "linux":
        window, trainer = found["niceness"]
        assert trainer == niceness() and window == max(trainer, NICENESS), (
            "the window waits for the training, not the other way round"
        )
    assert found["attended"] == ACTIVE_SECONDS, "nobody is told to wait while training stands"
    if found["software"]:
        assert found["unattended_fps"] <= 1, "a window left alone leaves the cores alone"
    photo, shown, psnr = found["compared"]
    assert photo == shown == [72, 96, 3] and psnr > 10
    assert found["by_seconds"]
    np.testing.assert_allclose(*found["at_photo"], atol=1e-6)
    assert found["flown"] != found["at_photo"][0]
    assert found["scores"] and all(np.isfinite(value) for value in found["scores"].values())
    assert found["mode"] == "points"
    saved_at, iteration, state = found["saved"]
    assert saved_at == iteration and state == "paused"
    assert {"toy.ply", "toy.png", "exported.ply", "toy.checkpoint.safetensors"} <= set(found["files"])
    exported, saved = load_scene(tmp_path / "exported.ply"), load_scene(tmp_path / "toy.ply")
    assert len(exported) > 0 and np.isfinite(exported.means).all()
    checkpoint = load_checkpoint(tmp_path / "toy.checkpoint.safetensors")
    assert checkpoint.counters.iteration == saved_at
    assert checkpoint.settings.max_splats == 2234
    np.testing.assert_array_equal(checkpoint.parameters.means, saved.means)
    assert np.asarray(Image.open(tmp_path / "toy.png")).std() > 10
    assert "Traceback" not in found["output"]
    assert "stopped at step" in found["output"] and "toy.ply" in found["output"]


def test_a_failing_trainer_is_told_and_its_scene_stays(drive, capture, tmp_path):
    found = drive("breaks", capture, script=SCRIPT)
    assert "a step went wrong" in found["problem"] and "\n" not in found["problem"]
    assert found["state"] == "failed"
    assert found["scene_stays"]
    assert found["picture_mean"] > 0.05
    assert found["went_on"] == "training"
    assert len(load_scene(tmp_path / "toy.ply")) > 0


def test_a_plugin_that_fails_is_told_and_can_be_resumed(drive, capture, tmp_path):
    path = tmp_path / "my_loss.py"
    path.write_text(
        "def loss(step):\n    if step.iteration == 9:\n        raise ValueError('mine')\n"
        "    return step.photo_loss + 0 * step.depth().mean()\n"
    )
    found = drive("plugin_fails", capture, script=SCRIPT, train=["--plugin", str(path)])
    assert f"{path}:3: loss failed at step 9: ValueError: mine" in found["problem"]
    assert (found["state"], found["iteration"]) == ("failed", 8)
    assert found["scene_stays"] and found["problem_after"] is None
    assert "Traceback" not in found["output"]
    checkpoint, output = tmp_path / "toy.checkpoint.safetensors", tmp_path / "toy.ply"
    assert load_checkpoint(checkpoint).counters.iteration == 8 and len(load_scene(output)) > 0
    resumed = ["--headless", "-o", str(output), "--resume", str(checkpoint), "--plugin", "none"]
    assert main(["train", str(capture), *resumed, "--iterations", "12"]) == 0
    assert load_checkpoint(checkpoint).counters.iteration == 12


@pytest.mark.parametrize("by_signal", [False, True])
def test_closing_in_the_middle_saves(drive, capture, tmp_path, by_signal):
    found = drive("closes", capture, script=SCRIPT, signal=by_signal)
    assert found["state"] == "training"
    reached = load_checkpoint(tmp_path / "toy.checkpoint.safetensors").counters.iteration
    assert reached >= found["iteration"] > 5
    assert len(load_scene(tmp_path / "toy.ply")) > 0
    assert f"stopped at step {reached:,}" in found["output"]
    assert "--resume" in found["output"]
    assert "Traceback" not in found["output"]


def test_other_scenes_can_be_opened_meanwhile_and_the_run_ends(drive, capture, tmp_path, random_gaussians):
    save_scene(random_gaussians(200), tmp_path / "other.ply")
    found = drive(
        "elsewhere",
        capture,
        script=SCRIPT,
        other=str(tmp_path / "other.ply"),
        train=["--iterations", "1000000", "--max-splats", "3000"],
    )
    assert found["other_stays"] == "other.ply"
    assert found["back"][1] == "pond (training)"
    wanted, came_to = found["clicked"]
    assert wanted == came_to
    assert found["progress"] == 1
    assert found["shown_is_trained"]
    assert "view_000.png" in found["output"], "the table of held-out photos"
    assert list((tmp_path / "toy-held-out").glob("*.png"))


def test_edits_reach_the_trainer_while_it_trains(drive, capture, tmp_path):
    found = drive(
        "edits",
        capture,
        script=SCRIPT,
        # More splats than such a window lets grow: births are waited for, on any machine.
        train=["--iterations", "100000", "--max-splats", "20000"],
        growth=12.0,
        cut=12.0,
    )
    assert found["held"], "the view waits while splats are selected"
    assert found["deleted"] > 0 and found["still_there"] == 0
    assert found["in_rectangle"] < 0.6 * found["deleted"], "but for some that have moved in since"
    assert found["tool"] == "rectangle"
    # Without the rule there would be as many of those born since as there are of the others.
    assert found["share_inside"] > 0.1 and found["born"] >= 50, found
    assert found["born_inside"] < 0.2 * found["share_inside"] * found["born"], "but for some that moved in"
    assert found["left"] > 200, found
    assert found["outside"] == 0, "what moves out is taken out at the next look"
    assert found["pointed"] == 1 and found["panels_hidden"] == 0
    assert found["failure"] is None
    settings = load_checkpoint(tmp_path / "rules.safetensors").settings
    assert [len(settings.cut), len(settings.no_growth)] == [1, 1], "checkpoints keep the rules"


def test_an_edit_while_a_later_scene_is_trained_is_of_the_one_shown(drive, capture, tmp_path):
    """Of several shorter scenes the first is whole and shown meanwhile: who edits it wants it, as it is."""
    found = drive(
        "edits_a_later_scene",
        capture,
        script=SCRIPT,
        steps=100,
        train=["--minutes", "5", "--max-splats", "3000"],
    )
    steps, (scene, iteration) = found["steps"], found["paused_in"]
    assert scene == 2 and steps <= iteration < 2 * steps
    assert found["shown_at"] == steps, "the step at which it ended"
    assert 0 < found["selected"] < found["before"]
    assert found["after"] == found["before"] - found["selected"] and found["still_there"] == 0
    assert found["ended_at"] == [1, iteration, 1.0], "the scene was whole: no step moves it"
    assert found["at_the_end"] == [found["after"], 0]
    assert found["reports"] == "no other follows: the one that was edited stays"
    saved, checkpoint = (
        load_scene(tmp_path / "toy.ply"),
        load_checkpoint(tmp_path / "toy.checkpoint.safetensors"),
    )
    assert len(saved) == found["after"]
    assert checkpoint.counters.iteration == iteration
    assert "Traceback" not in found["output"]


def test_a_photo_of_a_wrong_pose_is_left_out_and_marked(drive, tmp_path):
    photos = demo_capture(render, photos=16, width=96, height=72, splats=4000)
    save_capture(photos, tmp_path / "pond")
    path = tmp_path / "pond" / "transforms.json"
    content = json.loads(path.read_text(encoding="utf8"))
    wrong, other = (content["frames"][place] for place in (5, 12))
    wrong["transform_matrix"] = other["transform_matrix"]
    path.write_text(json.dumps(content), encoding="utf8")
    found = drive(
        "leaves_out",
        tmp_path / "pond",
        script=SCRIPT,
        train=["--iterations", "6000", "--max-splats", "3000"],
    )
    assert found["left_out"] == [wrong["file_path"]]
    (line,) = found["told"]
    assert line.startswith("photos left out: 1 of 14 photos disagree with the others")
    assert "--outliers off" in line


def test_what_passes_before_a_photo_is_masked_and_dark(drive, tmp_path):
    photos = demo_capture(render, photos=16, width=96, height=72, splats=4000)
    save_capture(photos, tmp_path / "pond")
    content = json.loads((tmp_path / "pond" / "transforms.json").read_text(encoding="utf8"))
    name = content["frames"][5]["file_path"]
    with Image.open(tmp_path / "pond" / name) as image:
        pixels = np.array(image.convert("RGB"))
    pixels[24:50, 30:56] = (250, 20, 220)
    Image.fromarray(pixels).save(tmp_path / "pond" / name)
    found = drive(
        "masks",
        tmp_path / "pond",
        script=SCRIPT,
        train=["--iterations", "6000", "--max-splats", "3000"],
        shot=str(Path(shots) / "transients.png") if (shots := os.environ.get("SPLATVIEW_SHOTS")) else None,
    )
    assert found["in_part"] == [name]
    (line,) = found["told"]
    assert line.startswith("transients masked: 1 of 14 photos show something that others do not")
    assert "--passing stay" in line
    dark = np.array(found["photo"])
    rows, columns = (side * dark.shape[axis] // pixels.shape[axis] for axis, side in ((0, 37), (1, 43)))
    assert dark[rows, columns].max() < 100 < pixels[37, 43].max()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere there is always a display")
def test_without_a_display_it_is_one_line(capture, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["train", str(capture)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "no display" in line and "--headless" in line


def test_several_processes_have_no_window(capture, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name, value in {
        "RANK": "0",
        "WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": "1",
    }.items():
        monkeypatch.setenv(name, value)
    assert main(["train", str(capture)]) == 2
    assert "several processes" in capsys.readouterr().err
