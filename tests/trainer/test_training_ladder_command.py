"""`splatview ladder --train` as it is typed: the recipe of `train`, and its parts one by one."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from splatview.cli.main import main
from splatview.cli.training_ladder import changed, make_trainer, rungs_with_effect, training_knobs
from splatview.measure.training_ladder import BASELINE, TRAINING_RUNGS
from splatview.scene.captures import load_capture
from splatview.trainer.setup import settings_for
from splatview.trainer.views import TrainViews, train_views

SHORT = ("--minutes", "0.02", "--seeds", "1")


def test_the_baseline_is_what_train_takes(capture_folder):
    capture = load_capture(capture_folder)
    capture = capture.about(capture.centre)
    views = TrainViews(train_views(capture.train), 3)
    assert make_trainer(capture, BASELINE, 1.5, 3).settings == settings_for(
        capture, views, minutes=1.5, seed=3
    )


def test_knobs_are_measured_beside_the_baseline(capture_folder, capsys):
    knobs = ("--knobs", "unseen-splats,sky")
    assert main(["ladder", "--train", str(capture_folder), *SHORT, *knobs, "--json"]) == 0
    out, err = capsys.readouterr()
    made = json.loads(out)
    assert [rung["knob"] for rung in made["rungs"]] == ["recipe", "unseen splats"]
    assert made["without_effect"] == ["sky: off is left out: the capture has not a sky"]
    assert made["without_effect"][0] in " ".join(err.split())
    for rung in made["rungs"]:
        (run,) = rung["runs"]
        assert run["steps"] > 0 and run["psnr"] and 0 < run["seconds"][-1] < 60


def test_rungs_that_change_nothing_are_left_out(capture_folder):
    capture = load_capture(capture_folder)
    capture = capture.about(capture.centre)
    kept, without = rungs_with_effect(TRAINING_RUNGS, capture, 1.0)
    settings = make_trainer(capture, BASELINE, 1.0, 0).settings
    assert kept[0] is BASELINE and len(kept) + len(without) == len(TRAINING_RUNGS)
    for rung in kept[1:]:
        assert changed(settings, rung) != (settings, None, None)
    assert any(text.startswith("opacity of photos: not taught") for text in without)
    again, _ = rungs_with_effect(TRAINING_RUNGS, replace(capture, guessed=True), 1.0)
    assert "start" in {rung.knob for rung in kept} and "start" not in {rung.knob for rung in again}


@pytest.mark.parametrize("knob", ["speed", "SH degree", ""])
def test_an_unknown_knob_is_told_with_those_there_are(knob, capsys):
    assert main(["ladder", "--train", "nowhere", "--knobs", knob]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1
    assert f"--knobs {knob}: with --train, choose from {', '.join(training_knobs())}" in err
