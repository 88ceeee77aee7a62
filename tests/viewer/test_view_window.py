"""Aids of the view as a person uses them: a real window under Xvfb, by keys, mouse and palette."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.scene.formats import save_scene


@pytest.fixture(scope="module")
def found(drive_once, tmp_path_factory, random_gaussians) -> dict[str, Any]:
    path: Path = tmp_path_factory.mktemp("scene") / "scene.ply"
    save_scene(random_gaussians(600, seed=4), path)
    return drive_once("all_views", path, script="view_drives.py", drawn=True)


@pytest.mark.parametrize(
    ("name", "least"), [("grid", 0.01), ("axes", 3e-4), ("centres", 0.004), ("rings", 0.01)]
)
def test_each_is_drawn_over_the_picture_and_goes_again(found, name, least):
    on, off = found[name]
    assert on > least and off < 2e-4


def test_all_are_off_again(found):
    assert found["off"] == [False] * 4


def test_selected_centres_are_tinted(found):
    assert found["selected"] > 0.004


def test_depth_and_overdraw_have_a_legend(found):
    assert found["splats"] == ["splats", None] and found["normals"] == ["normals", None]
    mode, (title, ticks) = found["depth"]
    assert (mode, title) == ("depth", "Depth, units")
    depths = [float(tick) for tick in ticks]
    assert depths == sorted(depths) and depths[0] >= 0 and len(set(depths)) == 5
    mode, (title, ticks) = found["overdraw"]
    assert (mode, title) == ("overdraw", "Splats at a pixel") and ticks[0] == "0" and ticks[-1] == "512+"


def test_the_home_key_shows_the_front_again(found):
    assert found["moved"] and found["home"] < 1e-9


def test_the_palette_sets_the_up_axis(found):
    np.testing.assert_allclose(found["ups"], [[0, 0, 1], [0, -1, 0]])
