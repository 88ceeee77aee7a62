"""A colour grade makes more of what a scene has: no renderer leaves out more of a graded scene than half a
grey level, and the window's picture is the export's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.edit.operations.appearance import Grade
from splatview.scene import Gaussians, look_at
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits, _four, bake
from splatview.scene.effects.effect import GREY_LEVEL, VISIBLE
from splatview.scene.effects.overrides import settings_for
from splatview.scene.effects.sh_bands import colour_reach

CAMERA = look_at((0, 0, -3), (0, 0, 0), up=(0, -1, 0), width=32, height=24)

FLOAT32 = 2e-4
"""Of sums of colours up to some 30."""


def graded(count: int, **numbers: float) -> SceneEdits:
    red, green, blue = (_four(row) for row in Grade(**numbers).matrix)
    adjustment = Adjustment(colour=(red, green, blue))
    marks = np.full(count, 1 << PALETTE_SHIFT, np.uint32)
    return SceneEdits(marks=marks, palette=(IDENTITY, adjustment))


def faint_bands(scene: Gaussians) -> Gaussians:
    """Bands that nobody sees before they are graded, but only just."""
    sh = scene.sh.copy()
    sh[:, 1:] *= np.float32(0.99 * VISIBLE / colour_reach(scene).bands[1])
    return replace(scene, sh=sh)


def bright_behind(scene: Gaussians) -> Gaussians:
    """Walls that let through a little less light than any renderer goes on with, and behind them something as
    bright as that allows."""
    means, sh = np.zeros((8, 3), np.float32), np.zeros((8, 1, 3), np.float32)
    means[:, 2] = np.linspace(0, 1, 8)
    sh[7] = 8.5 / 0.2820948
    return replace(
        scene.take(np.arange(8)),
        means=means,
        sh=sh,
        log_scales=np.full((8, 3), 4, np.float32),
        opacity_logits=np.array([1] * 7 + [9], np.float32),
    )


@pytest.mark.parametrize(
    ("make", "numbers"),
    [
        (faint_bands, {"contrast": 10.0}),
        (faint_bands, {"contrast": 4.0, "saturation": 6.0}),
        (bright_behind, {"contrast": 10.0}),
    ],
)
def test_what_is_left_out_of_a_graded_scene_stays_below_half_a_grey_level(
    backend, random_gaussians, make, numbers
):
    scene = make(random_gaussians(60, seed=3))
    edits = graded(len(scene), **numbers)
    exported = bake(scene, edits)

    def drawn(shown: Gaussians, edits: SceneEdits | None, asked) -> np.ndarray:
        return backend.draw(shown, CAMERA, replace(asked, blend="float32"), edits=edits)

    window = settings_for(scene, palette=edits.palette)
    exact = drawn(scene, edits, replace(window, sh_degree=None, early_stop=0.0))
    for asked in (window, settings_for(exported)):
        assert np.abs(drawn(scene, edits, asked) - exact).max() <= VISIBLE + FLOAT32
    assert np.abs(drawn(exported, None, settings_for(exported)) - exact).max() <= VISIBLE + 2 * FLOAT32
    # The scenes are hard enough: ungraded settings would not do. Others than quads go on for longer here.
    if make is faint_bands or backend.name == "quads":
        assert np.abs(drawn(scene, edits, settings_for(scene)) - exact).max() > GREY_LEVEL
