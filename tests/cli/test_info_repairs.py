"""`splatview info --repairs`: what each repair would do, and what it changes in pictures."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from splatview.cli.main import main
from splatview.edit.operations.cleanup import REPAIRS
from splatview.scene.formats import save_scene


def test_repairs_and_their_prices(tmp_path, random_gaussians, capsys):
    scene = random_gaussians(50, sh_degree=0)
    scales, quats = scene.log_scales.copy(), scene.quats.copy()
    scales[:5] = (-1, -7, -7)
    quats[7] = 0
    path = tmp_path / "ill.ply"
    save_scene(replace(scene, log_scales=scales, quats=quats), path)
    assert main(["info", str(path), "--repairs", "--json"]) == 0
    health = {entry["name"]: entry for entry in json.loads(capsys.readouterr().out)["health"]}
    for name, count in (("needles", 5), ("rods", 5), ("zero quaternions", 1)):
        entry = health[name]
        assert (entry["count"], entry["repair"]) == (count, REPAIRS[name])
        assert 0 < entry["price"]["worst"] <= entry["price"]["mean"] < 100
        assert entry["price"]["views"] == 8
    assert all("price" not in entry for entry in health.values() if not entry["count"])

    assert main(["info", str(path), "--repairs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("repairs")
    assert any(
        line.startswith("  rods: the longest axis shrinks") and "dB at worst" in line for line in lines[at:]
    )
    assert main(["info", str(path)]) == 0
    assert "repairs" not in capsys.readouterr().out.splitlines()
    assert np.isfinite([entry["count"] for entry in health.values()]).all()
