"""The Health report in a real window: what repairs cost, a repair and its undo, selecting by a click."""

from __future__ import annotations

from dataclasses import replace

import pytest

from splatview.scene.formats import save_scene


def test_repairs_are_priced_done_and_undone(drive, random_gaussians, tmp_path):
    scene = random_gaussians(400, seed=3)
    scales, quats = scene.log_scales.copy(), scene.quats.copy()
    scales[:30] = (-0.5, -7, -7)
    quats[40:60] = 0
    path = tmp_path / "ill.ply"
    save_scene(replace(scene, log_scales=scales, quats=quats), path)
    found = drive("health", path, script="editing_drives.py", panel=str(tmp_path / "health.png"))
    prices = found["prices"]
    assert {"rods", "needles", "zero quaternions"} <= set(prices)
    for mean, worst in prices.values():
        assert 0 < worst <= mean
    assert prices["rods"][1] < 60
    assert found["untouched"]
    assert found["titles"] == ["Repair rods: 30 splats"]
    assert found["changed"] > 0.01
    assert found["left"]["rods"] == 0 and found["left"]["zero quaternions"] == 20
    assert found["undone"] == pytest.approx(0)
    assert found["selected"] == 30
