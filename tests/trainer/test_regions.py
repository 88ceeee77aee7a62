"""What is taken out of a scene in training stays findable, resumable, and out of regions without growth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.scene import InputError
from splatview.scene.edits import Crop
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.editing import CUT_STEPS
from splatview.trainer.strategies.ops import inside_any
from splatview.trainer.trainer import Trainer

LEFT = Crop(shape="box", centre=(-5.0, 0.0, 0.0), half_extents=(5.0, 10.0, 10.0))
"""x below 0."""

GROWING = {"refine_from": 0.0, "refine_until": 1.0, "least_refine_steps": 5, "max_splats": 150}


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_splats_chosen_on_a_snapshot_are_deleted_later(make_trainer, strategy: str) -> None:
    trainer = make_trainer(iterations=120, strategy=strategy, **GROWING)
    for _ in range(40):
        trainer.step()
    chosen = trainer.splats.ids[:7].copy()
    for _ in range(40):
        trainer.step()
    here = np.flatnonzero(np.isin(trainer.splats.ids, chosen))
    others = np.delete(trainer.splats.arrays.means, here, axis=0)
    assert trainer.delete(chosen) == len(here) > 0
    np.testing.assert_array_equal(trainer.splats.arrays.means, others)
    assert trainer.delete(chosen) == 0, "they are gone, and no other has their numbers"
    while not trainer.done:
        trainer.step()
    assert not np.isin(trainer.splats.ids, chosen).any()


def test_the_last_splats_are_not_deleted(make_trainer) -> None:
    trainer = make_trainer()
    before = trainer.splats.means
    with pytest.raises(InputError, match="no splat would be left"):
        trainer.delete(trainer.splats.ids)
    assert trainer.splats.means is before


def test_a_crop_takes_out_what_it_does_not_show(make_trainer) -> None:
    trainer = make_trainer()
    left = trainer.splats.arrays.means[:, 0] <= 0
    assert trainer.crop([LEFT]) == (~left).sum() > 0
    assert trainer.crop([LEFT]) == 0
    assert (trainer.splats.arrays.means[:, 0] <= 0).all()
    assert len(trainer.splats) == left.sum()


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_nothing_grows_in_a_region(make_trainer, strategy: str) -> None:
    trainer = make_trainer(strategy=strategy, max_splats=10_000)
    trainer.add_region(LEFT)
    splats, state = trainer.splats, trainer.state
    left = splats.arrays.means[:, 0] <= 0
    before, ids = splats.arrays.means[left].copy(), splats.ids[left]
    if strategy == "classic":
        state["gradient_sums"][:], state["view_counts"][:] = 1.0, 1
    else:
        splats.arrays.opacity_logits[~left] = -1.0
        splats.arrays.opacity_logits[left] = 5.0  # most of what is drawn, were it drawn
        splats.arrays.opacity_logits[np.flatnonzero(~left)[:3]] = -20.0
    trainer.strategy.refine(splats, trainer.optimizer, state, 0.3, np.random.default_rng(0))
    assert len(splats) > len(left) + 10, "others grew"
    here = np.isin(splats.ids, ids)
    np.testing.assert_array_equal(splats.arrays.means[here], before)
    if strategy == "mcmc":  # copies lie where their originals are; the classic halves spread a little
        assert inside_any([LEFT], splats.arrays.means).sum() == left.sum()


def test_regions_that_are_off_do_not_count() -> None:
    means = np.array([[-1.0, 0, 0], [1, 0, 0], [np.nan, 0, 0]])
    assert inside_any([LEFT], means).tolist() == [True, False, False]
    assert inside_any([replace(LEFT, keep="outside")], means).tolist() == [True, False, False]
    assert not inside_any([replace(LEFT, enabled=False)], means).any()


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_what_is_cut_away_stays_away(make_trainer, strategy: str) -> None:
    outside = replace(LEFT, centre=(-6.0, 0.0, 0.0), keep="outside")
    trainer = make_trainer(iterations=80, strategy=strategy, **GROWING)
    x = trainer.splats.arrays.means[:, 0]
    assert trainer.add_cut([LEFT]) == (x > 0).sum() > 0
    trainer.add_cut([outside])
    assert trainer.settings.cut == ((LEFT,), (outside,))
    while not trainer.done:
        trainer.step()
        if trainer.counters.iteration % CUT_STEPS == 0:
            x = trainer.splats.arrays.means[:, 0]
            assert len(x) and (x <= 0).all() and (x > -1).all()
    grown = trainer.splats.means
    with pytest.raises(InputError, match="no splat would be left"):
        trainer.add_cut([replace(LEFT, centre=(50.0, 0.0, 0.0))])
    assert len(trainer.settings.cut) == 2 and trainer.splats.means is grown, "nothing has happened"


def test_a_rule_that_would_leave_nothing_ends_no_run(make_trainer) -> None:
    trainer = make_trainer(iterations=3 * CUT_STEPS)
    count = len(trainer.splats)
    trainer.change(cut=((replace(LEFT, centre=(50.0, 0.0, 0.0)),), (LEFT,)))
    while not trainer.done:
        trainer.step()
    assert 0 < len(trainer.splats) < count, "the other rule is in force"
    assert (trainer.splats.arrays.means[:, 0] <= 0).all()


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_an_edited_run_resumes_bit_for_bit(make_trainer, tmp_path: Path, strategy: str) -> None:
    trainer = make_trainer(iterations=80, strategy=strategy, **GROWING)
    trainer.add_region(replace(LEFT, shape="sphere"))
    trainer.add_cut([LEFT, replace(LEFT, centre=(4.7, 0.0, 0.0))])
    for _ in range(30):
        trainer.step()
    trainer.delete(trainer.splats.ids[3:9])
    save_checkpoint(trainer, tmp_path / "run.safetensors")
    checkpoint = load_checkpoint(tmp_path / "run.safetensors")
    assert checkpoint.settings == trainer.settings
    resumed = Trainer(trainer.views, checkpoint.parameters, checkpoint.extent, checkpoint.settings, threads=2)
    restore(resumed, checkpoint)
    for _ in range(50):
        trainer.step()
        resumed.step()
    np.testing.assert_array_equal(resumed.splats.ids, trainer.splats.ids)
    assert resumed.splats.next_id == trainer.splats.next_id
    for ours, theirs in zip(resumed.splats.arrays, trainer.splats.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)
