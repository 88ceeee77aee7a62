"""Regularisers that stand for missing photos are eased where photos are met well."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.plugin import LossPlugin
from splatview.trainer.strategies.mcmc import LEAST_EASED, LEAST_REG, ease_of_faint, eased, need_of_reg
from splatview.trainer.views import TrainView, TrainViews


@pytest.mark.parametrize(
    ("loss", "full", "need"),
    [(0.01, 0.04, 0.25), (0.04, 0.04, 1), (0.3, 0.04, 1), (0.01, 0, 1), (0, 0.04, 1), (math.nan, 0.04, 1)],
)
def test_need_follows_the_loss(loss: float, full: float, need: float) -> None:
    assert need_of_reg(loss, full) == need


def test_weights_keep_a_floor() -> None:
    assert eased(0.1, 1.0) == 0.1
    assert eased(0.1, 0.5) == 0.05
    assert eased(0.1, 0.001) == LEAST_REG
    assert eased(LEAST_REG / 2, 0.001) == LEAST_REG / 2
    assert eased(0.0, 0.5) == 0


@pytest.mark.parametrize(
    ("median", "full", "factor"),
    [(0.03, 0.06, LEAST_EASED), (0.06, 0.06, 1), (0.2, 0.06, 1), (0, 0.06, LEAST_EASED), (0.03, 0, 1)],
)
def test_faint_splats_ease_the_weight_of_opacity(median: float, full: float, factor: float) -> None:
    assert ease_of_faint(median, full) == factor


def test_the_weight_of_opacity_falls_as_splats_become_fainter() -> None:
    medians = np.linspace(0.03, 0.07, 41)
    factors = np.array([ease_of_faint(median, 0.06) for median in medians])
    assert (np.diff(factors) >= 0).all() and factors[0] == LEAST_EASED and factors[-1] == 1
    assert LEAST_EASED < ease_of_faint(0.055, 0.06) < 0.6
    assert ease_of_faint(math.nan, 0.06) == 1


def regs(trainer) -> list[float]:
    """Weights of opacity and scale in the last step, as at its end, per unit of those in the recipe."""
    fade = trainer.settings.reg_end ** ((trainer.counters.iteration - 1) / trainer.settings.iterations)
    groups = {group["name"]: group["reg"] for group in trainer.optimizer.param_groups if "reg" in group}
    return [groups["opacity_logits"] / fade, groups["log_scales"] * trainer.extent / fade]


FEW = {"opacity_reg": 0.1, "scale_reg": 0.08, "dropout": 0.2, "max_aspect": 6.0}


def test_a_run_that_meets_its_photos_is_regularised_less(make_trainer) -> None:
    trainer = make_trainer(**FEW, full_reg_loss=10.0)
    trainer.step(0.0)
    assert regs(trainer) == pytest.approx([0.1, 0.08])
    losses = [trainer.state["photo_loss"]]
    losses += [trainer.step(0.0).loss for _ in range(20)]
    assert min(losses) < trainer.state["photo_loss"] < max(losses)
    assert regs(trainer) == pytest.approx([LEAST_REG, LEAST_REG])
    assert trainer.need_of_reg == trainer.state["photo_loss"] / 10
    full = make_trainer(**FEW)
    for _ in range(3):
        full.step(0.0)
    assert regs(full) == pytest.approx([0.1, 0.08]) and full.need_of_reg == 1


def test_only_opacity_is_eased_where_splats_are_faint(make_trainer) -> None:
    trainer = make_trainer(**FEW, full_reg_opacity=0.06)
    trainer.step(0.0)
    assert regs(trainer) == pytest.approx([0.1, 0.08])  # before a refinement nobody knows
    trainer.state["median_opacity"] = 0.055
    trainer.step(0.0)
    assert regs(trainer) == pytest.approx([0.1 * ease_of_faint(0.055, 0.06), 0.08])


def test_refinement_notes_the_median_opacity_of_the_living(make_trainer) -> None:
    trainer = make_trainer(**FEW, full_reg_opacity=0.06)
    logits = trainer.splats.arrays.opacity_logits
    logits[:] = np.log(0.3 / 0.7)
    logits[: len(logits) // 3] = -9  # the dead, which are moved
    rng = np.random.default_rng(0)
    trainer.strategy.refine(trainer.splats, trainer.optimizer, trainer.state, 0.3, rng)
    assert trainer.state["median_opacity"] == pytest.approx(0.3)


def test_few_splats_are_not_pressed_the_harder(make_trainer) -> None:
    """What is added to each splat's gradient: the weight of the mean over their number."""

    def on_each(most: int) -> float:
        trainer = make_trainer(**FEW, max_splats=most)
        trainer.step(0.0)
        return regs(trainer)[0] / len(trainer.splats)

    count = len(make_trainer(**FEW).splats)
    assert on_each(count) == on_each(10 * count) == pytest.approx(0.1 / count)
    assert on_each(40 * count) == pytest.approx(0.1 / (4 * count))


def test_a_loss_of_the_users_says_nothing_of_the_photos(make_trainer) -> None:
    trainer = make_trainer(**FEW, full_reg_loss=10.0)
    trainer.loss = LossPlugin(lambda step: 1e-3 * step.photo_loss)
    for _ in range(3):
        trainer.step(0.0)
    assert regs(trainer) == pytest.approx([0.1, 0.08])


def test_a_resumed_run_is_regularised_alike(make_trainer, tmp_path: Path) -> None:
    refined = {"refine_from": 0.0, "refine_every": 0.1, "least_refine_steps": 5, "full_reg_opacity": 0.9}
    settings = {**FEW, **refined, "full_reg_loss": 0.3, "iterations": 60}
    whole = make_trainer(**settings)
    for step in range(60):
        if step == 30:
            save_checkpoint(whole, tmp_path / "c.safetensors")
        whole.step(0.0)
    resumed = make_trainer(**settings)
    restore(resumed, load_checkpoint(tmp_path / "c.safetensors"))
    while not resumed.done:
        resumed.step(0.0)
    assert resumed.need_of_reg == whole.need_of_reg < 1
    assert resumed.state["median_opacity"] == whole.state["median_opacity"] < 0.9
    for ours, theirs in zip(resumed.splats.arrays, whole.splats.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_photos_cover_what_differs_from_the_background(views: list[TrainView]) -> None:
    (height, width), camera = (48, 64), replace(views[0].camera, width=64, height=48)
    pixels = np.full((height, width, 3), 100, np.uint8)
    pixels[:, : width // 4] = 108  # as compression and noise make of the same colour
    pixels[: height // 2, width // 2 :] = (100, 100, 120)
    grey, black = (100 / 255, 100 / 255, 100 / 255), (0.0, 0.0, 0.0)
    opaque = TrainView(camera, pixels)
    assert TrainViews([opaque], 0).covered(grey) == pytest.approx(1 / 4)
    assert TrainViews([opaque], 0).covered(black) == 1
    mask = np.ones((height, width), np.bool_)
    mask[height // 2 :] = False
    assert TrainViews([replace(opaque, mask=mask)], 0).covered(grey) == pytest.approx(1 / 2)
    assert TrainViews([replace(opaque, mask=mask & False)], 0).covered(grey) == 1
    alpha = np.zeros((height, width), np.uint8)
    alpha[:, : width // 2] = 1
    cut_out = replace(opaque, alpha=alpha)
    assert TrainViews([cut_out], 0).covered(black) == pytest.approx(1 / 2)
    assert TrainViews([cut_out, opaque], 0).covered(black) == pytest.approx(3 / 4)
