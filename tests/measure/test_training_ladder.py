"""Runs at equal seconds: gains seed by seed, and when a run was as good as the baseline in the end."""

from __future__ import annotations

import json
import math
from dataclasses import fields

import numpy as np
import pytest

from splatview.measure.training_ladder import (
    BASELINE,
    TRAINING_COLUMNS,
    TRAINING_RUNGS,
    Curve,
    Trained,
    mean_and_half_width,
    training_as_json,
    training_cells,
)
from splatview.trainer.settings import TrainSettings


def curve(*psnr: float) -> Curve:
    return Curve(seconds=np.arange(1.0, len(psnr) + 1), psnr=np.array(psnr), steps=100, gaussians=1000)


def test_every_rung_changes_what_the_recipe_has():
    names = {field.name for field in fields(TrainSettings)} | {"splats", "early_stop", "precision"}
    assert TRAINING_RUNGS[0] is BASELINE
    for rung in TRAINING_RUNGS:
        assert set(rung.changes) <= names
    assert len({(rung.knob, rung.value) for rung in TRAINING_RUNGS}) == len(TRAINING_RUNGS)


@pytest.mark.parametrize(("target", "seconds"), [(5, 1), (15, 1.5), (20, 2), (30, 3), (31, math.inf)])
def test_seconds_to_a_mark_lie_between_evaluations(target, seconds):
    assert curve(10, 20, 30).seconds_to(target) == seconds


def test_a_run_that_was_once_good_enough_counts_from_then():
    assert curve(10, 30, 20).seconds_to(25) == 1.75


def test_intervals_are_students():
    assert mean_and_half_width([1.0]) == (1.0, math.inf)
    mean, width = mean_and_half_width([1.0, 2.0, 3.0])
    assert mean == 2
    assert width == pytest.approx(4.30 / math.sqrt(3), rel=1e-3)
    assert math.isnan(mean_and_half_width([])[0])


def test_gains_are_taken_seed_by_seed():
    baseline = Trained(rung=BASELINE, curves=[curve(20.0), curve(30.0), curve(25.0)])
    better = Trained(rung=TRAINING_RUNGS[1], curves=[curve(21.0), curve(31.0), curve(26.0)])
    gain, width = better.gain(baseline)
    assert (gain, width) == (pytest.approx(1), pytest.approx(0, abs=1e-9))
    assert better.psnr[1] > 5, "seeds differ far more than the rungs do"
    assert training_cells(better, baseline)[2] == "+1.00 ±0.00"
    assert (
        len(training_cells(better, baseline))
        == len(training_cells(baseline, baseline))
        == len(TRAINING_COLUMNS)
    )


def test_a_gain_within_its_interval_is_no_claim():
    baseline = Trained(rung=BASELINE, curves=[curve(20.0), curve(21.0)])
    other = Trained(rung=TRAINING_RUNGS[1], curves=[curve(20.5), curve(20.9)])
    assert training_cells(other, baseline)[2].startswith("same")
    lone = Trained(rung=TRAINING_RUNGS[1], curves=[curve(29.0)])
    assert training_cells(lone, baseline)[2].startswith("same"), "one seed proves nothing"


def test_json_has_no_infinities():
    baseline = Trained(rung=BASELINE, curves=[curve(20.0)])
    never = Trained(rung=TRAINING_RUNGS[1], curves=[curve(10.0)])
    data = json.loads(json.dumps(training_as_json([baseline, never]), allow_nan=False))
    assert data[1]["seconds_to_equal"] is None
    assert data[1]["gain"] == -10
