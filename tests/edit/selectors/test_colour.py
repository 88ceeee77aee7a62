"""Colours in Oklab by published values, and what counts as similar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatview.edit.kernels.attributes import LINEAR, oklab
from splatview.edit.selectors import SimilarColour
from splatview.edit.tools import NoTools
from splatview.scene.sh import rgb_to_sh


def lab_of(*rgb) -> np.ndarray:
    values = np.array(rgb, np.float32)
    lab = np.empty_like(values)
    oklab(0, len(values), values, LINEAR, lab)
    return lab


def test_published_values():
    """The corners of sRGB, as the author of Oklab and CSS Color 4's examples give them."""
    lab = lab_of((1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))
    expected = [
        (1.0, 0.0, 0.0),
        (0.62796, 0.22486, 0.12585),
        (0.86644, -0.23389, 0.17950),
        (0.45201, -0.03246, -0.31153),
        (0.0, 0.0, 0.0),
    ]
    np.testing.assert_allclose(lab, expected, atol=2e-5)


def test_the_formula_all_over(rng):
    rgb = rng.uniform(-0.5, 1.5, (20_000, 3)).astype(np.float32)
    shown = np.clip(rgb.astype(np.float64), 0, 1)
    light = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    cones = np.array(
        [
            [0.4122214708, 0.5363325363, 0.0514459929],
            [0.2119034982, 0.6806995451, 0.1073969566],
            [0.0883024619, 0.2817188376, 0.6299787005],
        ]
    )
    opponents = np.array(
        [
            [0.2104542553, 0.7936177850, -0.0040720468],
            [1.9779984951, -2.4285922050, 0.4505937099],
            [0.0259040371, 0.7827717662, -0.8086757660],
        ]
    )
    np.testing.assert_allclose(lab_of(*rgb), np.cbrt(light @ cones.T) @ opponents.T, atol=3e-6)


def test_nan_is_like_nothing():
    assert np.isnan(lab_of((np.nan, 0, 0), (0, np.nan, 1), (1, 1, np.nan))).all()


def test_shades_are_similar_and_hues_are_not(edit_helpers, edited):
    scene, edits = edit_helpers.make_scene(6), edited.none(6)
    colours = [
        (0.2, 0.5, 0.2),
        (0.24, 0.55, 0.22),
        (0.5, 0.2, 0.2),
        (0.9, 0.9, 0.9),
        (1.2, 1.5, 9),
        (np.nan, 0, 0),
    ]
    sh = scene.sh.copy()
    sh[:, 0] = rgb_to_sh(np.array(colours))
    scene = replace(scene, sh=sh)

    def like(*rgb, **options):
        return SimilarColour(rgb=rgb, **options).mask(scene, edits, NoTools()).tolist()

    assert like(0.2, 0.5, 0.2) == [True, True, False, False, False, False]
    assert like(0.2, 0.5, 0.2, tolerance=0.001) == [True, False, False, False, False, False]
    assert like(0.2, 0.5, 0.2, tolerance=2.0) == [True, True, True, True, True, False]
    # Beyond what a display shows all is white.
    assert like(1.0, 1.0, 1.0, tolerance=0.01) == [False, False, False, False, True, False]
