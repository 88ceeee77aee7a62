"""Prices of effects: what is drawn for them, and what is claimed."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.effect_costs import EDITS, EffectPrice, price_effects
from splatview.measure.knobs import Plan
from splatview.scene import Camera, reference
from splatview.scene.camera import look_at
from splatview.scene.effects.overrides import settings_for
from splatview.scene.effects.report import scene_effects


class Clocked:
    """The reference, but a frame takes as long as it is told: a millisecond, and two for each SH band."""

    name = "cpu"

    def __init__(self, gaussians, hidden: float = 0.0):
        self.gaussians, self.hidden = gaussians, hidden

    def supports(self, plan: Plan) -> bool:
        return True

    def turned(self, camera: Camera, degrees: float) -> Camera:
        return camera

    def prepare(self, plan: Plan) -> None:
        """Nothing to do."""

    def draw(self, camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
        degree = plan.settings.sh_degree
        bands = self.gaussians.sh_degree if degree is None else degree
        milliseconds = 1.0 + 2.0 * bands + self.hidden + 1e-6 * (time.perf_counter() % 1)
        return reference.render(self.gaussians, camera, plan.settings), milliseconds

    def memory(self) -> int:
        return 0


@pytest.fixture
def priced(random_gaussians):
    gaussians = random_gaussians(60, seed=2)
    sh = gaussians.sh.copy()
    sh[:, 9:] = 0
    gaussians = replace(gaussians, sh=sh)
    camera = look_at((0, 0.5, 3), (0, 0, 0), width=32, height=24)
    prices = price_effects(
        Clocked(gaussians),
        Plan(settings=settings_for(gaussians)),
        gaussians,
        scene_effects(gaussians),
        camera,
        moved=lambda view, number: camera,
        seconds=10.0,
        rounds=4,
        unedited=Clocked(gaussians, hidden=-1.0),
    )
    assert prices is not None
    return prices


def test_every_effect_that_can_be_switched_has_a_price(priced) -> None:
    bands = {f"SH band {band}" for band in (1, 2, 3)}
    assert set(priced) == {*bands, "antialiased opacity", "flat 2D splats", EDITS}


def test_what_is_on_costs_and_what_is_off_would(priced) -> None:
    band = priced["SH band 2"]
    assert band.on and band.clear and band.saved_ms == pytest.approx(2, abs=1e-3)
    assert band.ms == pytest.approx(5, abs=1e-3) and band.max_error > 0.01
    assert str(band).startswith("costs 2 ms of 5; without it a pixel changes by up to")
    # The lowest takes those above it along.
    assert priced["SH band 1"].saved_ms == pytest.approx(4, abs=1e-3)
    off = priced["SH band 3"]
    assert not off.on and off.saved_ms == pytest.approx(2, abs=1e-3) and off.max_error == 0
    assert str(off) == "would cost 2 ms of 5; the same picture either way"
    assert priced[EDITS].on and priced[EDITS].saved_ms == pytest.approx(1, abs=1e-3)


def test_no_claim_is_made_within_the_noise(priced) -> None:
    same = priced["antialiased opacity"]
    assert not same.clear and "no difference in time beyond" in str(same)
    assert same.max_error > 0.05 and "with it a pixel changes" in str(same)


def test_words_of_what_is_faster_with_it() -> None:
    price = EffectPrice(
        name="x", on=True, ms=10.0, saved_ms=-2.0, noise_ms=0.1, clear=True, psnr=40.0, max_error=0.5
    )
    assert str(price).startswith("saves 2 ms of 10")
    assert str(replace(price, on=False)).startswith("would save 2 ms of 10")


def test_a_slow_renderer_still_has_prices(random_gaussians) -> None:
    gaussians = random_gaussians(5)
    camera = look_at((0, 0.5, 3), (0, 0, 0), width=16, height=12)
    prices = price_effects(
        Clocked(gaussians, hidden=1e6),
        Plan(),
        gaussians,
        scene_effects(gaussians),
        camera,
        moved=lambda view, number: camera,
        seconds=0.5,
    )
    assert prices is not None and "SH band 3" in prices


def test_a_cancelled_measurement_has_no_prices(random_gaussians) -> None:
    gaussians = random_gaussians(5)
    camera = look_at((0, 0.5, 3), (0, 0, 0), width=16, height=12)
    prices = price_effects(
        Clocked(gaussians),
        Plan(),
        gaussians,
        scene_effects(gaussians),
        camera,
        moved=lambda view, number: camera,
        seconds=10.0,
        cancelled=lambda: True,
    )
    assert prices is None
