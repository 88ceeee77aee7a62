"""The Effects panel as a person uses it, in a real window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene.effects.report import effects_report
from splatview.scene.formats import save_scene


@pytest.fixture
def ball(random_gaussians):
    """Degree 3 is stored, degree 2 can be seen."""
    gaussians = random_gaussians(2500, seed=4)
    sh = gaussians.sh.copy()
    sh[:, 9:] *= np.float32(1e-5)
    return replace(gaussians, sh=sh)


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("quads", marks=pytest.mark.slow)])
def test_the_receipt_its_prices_and_its_switches(drive, ball, tmp_path, renderer):
    path = tmp_path / "ball.ply"
    save_scene(ball, path)
    shots = {name: str(tmp_path / f"{name}.png") for name in ("shot", "shot_prices")}
    found = drive(
        "receipt",
        path,
        script="effects_drives.py",
        environ={"SPLATVIEW_CACHE_DIR": str(tmp_path / "cache")},
        renderer=renderer,
        size=[520, 360],
        rounds=3,
        **shots,
    )
    shown = {name: (on, in_force, why) for name, on, in_force, why in found["receipt"]}
    for effect in effects_report(ball):
        if effect.can_override:
            assert shown[effect.name] == (effect.on, effect.on, effect.why), "as splatview info says"
    assert shown["SH band 2"][0] and not shown["SH band 3"][0]
    assert not shown["hidden splats"][0] and not shown["selection"][0]

    prices = found["prices"]
    on, ms, saved, psnr, error, text = prices["SH band 1"]
    assert (
        on
        and ms > 0
        and np.isfinite(saved)
        and psnr < 40
        and error > 0.01
        and "without it a pixel changes" in text
    )
    on, ms, saved, psnr, error, text = prices["SH band 3"]
    assert not on and error < 0.5 / 255, "what is off could not be seen"
    assert not prices["antialiased opacity"][0] and prices["antialiased opacity"][4] > 0

    assert found["without"] == ["SH band 2"] and found["degree"] == 1
    assert found["differs"] > 0.01, "the picture follows the switch"
    assert found["antialiased"] is True
    assert found["overridden"] is False and found["back"] < 2e-3, "as the scene calls for"
    assert found["hidden"] == "2,500 of 2,500 splats are hidden or deleted"
    assert set(prices) == {"SH band 1", "SH band 2", "SH band 3", "antialiased opacity", "flat 2D splats"}
