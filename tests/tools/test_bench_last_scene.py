"""The bench of last scenes: ways end with their last scene, and gains are of the same scenes before."""

from __future__ import annotations

from typing import Any

import pytest
from bench_last_scene import NOW, WAYS, WITHOUT, changed, table

from splatview.trainer import ensemble


def run(split: int, way: str, psnr: float, seed: int = 0) -> dict[str, Any]:
    return {
        "capture": "bust",
        "split": split,
        "seed": seed,
        "way": way,
        "psnr_fitted": psnr,
        "ssim": 0.7,
        "teachers": [18.0, 19.0],
        "their_mean": 19.5,
    }


@pytest.mark.parametrize("way", WAYS)
def test_a_way_names_constants_and_ends_with_its_last_scene(way: str) -> None:
    before = [getattr(module, name) for module, name, _ in WAYS[way]]
    with pytest.raises(ZeroDivisionError), changed(WAYS[way]):
        assert all(getattr(module, name) == value for module, name, value in WAYS[way])
        assert [value for _, _, value in WAYS[way]] != before or not before
        _ = 1 / 0
    assert [getattr(module, name) for module, name, _ in WAYS[way]] == before
    assert ensemble.FOG_OF_ONE_IN == 4 and ensemble.TAUGHT_SHARE == 0.8


def test_gains_are_over_the_same_scenes_before() -> None:
    """The mean and its standard error; one without its pair has none."""
    runs = [
        run(0, WITHOUT, 18.0),
        run(1, WITHOUT, 20.0),
        run(0, NOW, 18.5),
        run(1, NOW, 21.5),
        run(2, NOW, 99.0),
    ]
    found = table(runs)
    assert found["columns"] == ["capture", "last scenes", "without", "those before", "their mean", NOW]
    (row,) = found["rows"]
    assert row == ["bust", 2, "19.00, 0.700", "18.50", "19.50", "+1.00 ± 0.50"]
    (row,) = table(runs[:3])["rows"]
    assert row[-1] == "+0.50 (1)"
