"""`splatview info --measure`: the receipt with prices."""

from __future__ import annotations

import json

import pytest

from splatview.cli.main import main
from splatview.scene.formats import save_scene


@pytest.fixture
def scene(tmp_path, random_gaussians):
    path = tmp_path / "ball.ply"
    save_scene(random_gaussians(200), path)
    return path


def test_prices_are_in_the_receipt(scene, capsys) -> None:
    options = ["--measure", "--seconds", "2", "--size", "64x48", "--renderer", "cpu"]
    assert main(["info", str(scene), "--json", *options]) == 0
    receipt = json.loads(capsys.readouterr().out)
    assert receipt["measured"] == {"renderer": "cpu", "size": [64, 48]}
    priced = {effect["name"]: effect["price"] for effect in receipt["effects"] if "price" in effect}
    assert "SH band 1" in priced
    switches = {effect["name"] for effect in receipt["effects"] if effect["can_override"]}
    assert set(priced) <= switches
    band = priced["SH band 1"]
    assert band["frame_ms"] > 0 and band["noise_ms"] > 0 and band["max_change"] > 0.01
    assert isinstance(band["clear"], bool)


@pytest.mark.parametrize("options", [["--seconds", "3"], ["--size", "8x8"], ["--renderer", "cpu"]])
def test_options_of_measuring_need_it(scene, options, capsys) -> None:
    assert main(["info", str(scene), *options]) == 2
    assert f"{options[0]} goes with --measure" in capsys.readouterr().err
