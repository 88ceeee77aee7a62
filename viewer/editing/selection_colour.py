"""The tint of selected splats: yellow, as other programs have it, unless the scene has that colour itself.

A tint is seen where a tinted splat looks like nothing else in the scene. So the colours of the scene are
tinted by each candidate, and it counts how far the results are from the nearest colour that is there, in
CIELAB; less where the scene has the candidate's hue, however dark: green does not mark grass, though it is as
far from it as magenta. That was chosen on the demo and playbot, and judged on skull, biker, spot, train-1000,
whose tints it leaves, and guitar, which has magenta in place of green.
"""

from __future__ import annotations

import numpy as np

from splatview.measure.metrics import hyab, lab, linear
from splatview.renderers.request import Highlight, Tint
from splatview.scene import Gaussians
from splatview.scene.projection import sigmoid
from splatview.scene.sh import SH_C0

YELLOW = Highlight().selected

OTHERS: tuple[Tint, ...] = tuple(
    (*rgb, YELLOW[3]) for rgb in ((0.05, 0.7, 1.0), (1.0, 0.15, 0.85), (0.15, 0.95, 0.25))
)
"""Blue, magenta and green; red is what previews have."""

USUAL = 1.3
"""Yellow stays unless another tint is so many times as far from the scene's colours."""

SAMPLE = 20_000
"""Splats looked at."""

LEVELS = 8
"""Of each channel: colours are counted in this many parts of it."""

HUE, GREY = 50.0, 8.0
"""Degrees within which two hues are taken for one, and CIELAB chroma below which a colour has none."""

RARE = 0.002
"""Colours of a smaller share of the splats' area do not count."""


def selection_tint(gaussians: Gaussians) -> Tint:
    """The tint that stands out most from the scene. Takes some milliseconds, whatever its size."""
    colours, shares = colours_of(gaussians)
    if not len(colours):
        return YELLOW
    best = max(OTHERS, key=lambda tint: contrast(tint, colours, shares))
    is_better = contrast(best, colours, shares) > USUAL * contrast(YELLOW, colours, shares)
    return best if is_better else YELLOW


def colours_of(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Colours (K, 3) float64, 0 to 1, that the scene has, the constant band alone, and the share (K,) of the
    splats' area that each has; the sums are at most 1."""
    step = max(1, len(gaussians) // SAMPLE)
    with np.errstate(all="ignore"):
        sizes = np.sort(np.exp(gaussians.log_scales[::step].astype(np.float64)), axis=1)
        areas = sizes[:, 1] * sizes[:, 2] * sigmoid(gaussians.opacity_logits[::step].astype(np.float64))
    colours = np.clip(0.5 + SH_C0 * gaussians.sh[::step, 0].astype(np.float64), 0, 1)
    kept = np.isfinite(areas) & (areas > 0) & np.isfinite(colours).all(axis=1)
    areas, colours = areas[kept], colours[kept]
    if not len(areas):
        return colours, areas
    areas = np.minimum(areas, np.quantile(areas, 0.9))  # a sky of few splats hides no meadow
    cells = np.minimum((colours * LEVELS).astype(int), LEVELS - 1) @ (LEVELS**2, LEVELS, 1)
    shares = np.bincount(cells, areas, minlength=LEVELS**3) / areas.sum()
    found = np.flatnonzero(shares >= RARE)
    means = [np.bincount(cells, areas * channel, minlength=LEVELS**3) for channel in colours.T]
    return np.stack(means, axis=1)[found] / (shares[found, None] * areas.sum()), shares[found]


def contrast(tint: Tint, colours: np.ndarray, shares: np.ndarray) -> float:
    """Mean distance of tinted colours from the nearest of the `colours` (K, 3), by their `shares` (K,), times
    the share that has another hue than the tint; black to white is 100."""
    *rgb, strength = tint
    there = lab(linear(colours))
    tinted = lab(linear((1 - strength) * colours + strength * np.array(rgb)))
    nearest = hyab(tinted[:, None], there[None]).min(axis=1)
    own = lab(linear(np.array(rgb)))
    between = np.degrees(np.arctan2(there[:, 2], there[:, 1]) - np.arctan2(own[2], own[1]))
    alike = (np.abs((between + 180) % 360 - 180) < HUE) & (np.hypot(there[:, 1], there[:, 2]) > GREY)
    return float(nearest @ shares / shares.sum() * (1 - shares[alike].sum() / shares.sum()))
