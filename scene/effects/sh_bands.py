"""Spherical harmonics: how far colours go, and which bands can be seen, over the whole scene and splat by
splat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from splatview.scene.edits import Adjustment, is_graded
from splatview.scene.effects.effect import VISIBLE, Effect, Saving, grey_levels, short
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians
from splatview.scene.health import sh_bound
from splatview.scene.projection import FLOAT32_MAX
from splatview.scene.sh import SH_C0

# Leaving out zeros changes no picture, not in its last bit, so nobody need be asked. What it saves depends on
# the scene. Trained ones have hardly a zero: in `playbot` (500,000 splats, degree 2) and `skull` (94,936,
# degree 3) every splat has its highest band, and so in scenes that this program has trained; in `train-1000`
# 96 % have it, and the rest the constant one alone. Bands that are not zero but together stay below half a
# grey level are as rare: 1 % of playbot's splats, 0.1 % of what we trained, none of the others'. So a
# threshold above zero, splat by splat, would save nothing there and cost exactness. What has many zeros is
# what was merged or padded: a scene of degree 0 among others of degree 3, a file that a tool filled up.


SLICE = 1 << 16
"""Splats looked at together, so that what is made of them stays in the caches."""

SAMPLE = 1 << 14
"""Splats by which it is decided whether to look at all of them."""

COEFFICIENT_BYTES = 12
"""Three colours in float32."""

PLACE_BYTES = 4
"""A splat, for where its coefficients begin and how many they are, where splats differ."""

LEAST_SAVING = 0.1
"""Of the bytes of harmonics, from which on each splat has its own degree: less would not repay the detour by
its place."""


def degree_in_use(sh: np.ndarray) -> int:
    """The lowest degree that shows `sh` (N, K, 3) unchanged: bands that are all zero do not count."""
    for degree in range(SH_COEFFICIENTS.index(sh.shape[1]), 0, -1):
        with np.errstate(invalid="ignore"):  # of NaN that signals
            used = sh[:, SH_COEFFICIENTS[degree - 1] :].any()
        if used:
            return degree
    return 0


def sh_degrees(sh: np.ndarray) -> np.ndarray:
    """(N, K, 3) -> (N,) uint8: the same, splat by splat. NaN is not zero."""
    degrees = np.zeros(len(sh), np.uint8)
    for start in range(0, len(sh), SLICE):
        part, found = sh[start : start + SLICE], degrees[start : start + SLICE]
        for degree in range(1, SH_COEFFICIENTS.index(sh.shape[1]) + 1):
            band = part[:, SH_COEFFICIENTS[degree - 1] : SH_COEFFICIENTS[degree]]
            found[(band != 0).any(axis=(1, 2))] = degree
    return degrees


def own_degrees(sh: np.ndarray) -> np.ndarray | None:
    """`sh_degrees` (N,) where it pays that each splat has its own; None where all, or nearly all, are alike.

    A sample decides whether to look further: of what pays too little anyway, a little may be missed.
    """
    sample = sh[:: max(1, len(sh) // SAMPLE)]
    if not pays(degree_counts(sh_degrees(sample))):
        return None
    degrees = sh_degrees(sh)
    return degrees if pays(degree_counts(degrees)) else None


def degree_counts(degrees: np.ndarray) -> np.ndarray:
    """(4,) int64: how many splats have each degree."""
    return np.bincount(degrees, minlength=len(SH_COEFFICIENTS))


def bytes_alike(counts: np.ndarray) -> int:
    """Of float32 coefficients where all splats have the highest degree of any."""
    highest = int(np.flatnonzero(counts).max(initial=0))
    return int(counts.sum()) * SH_COEFFICIENTS[highest] * COEFFICIENT_BYTES


def bytes_by_degree(counts: np.ndarray) -> int:
    """The same where each splat has its own, the places included."""
    coefficients = int((counts * np.array(SH_COEFFICIENTS)).sum())
    return coefficients * COEFFICIENT_BYTES + int(counts.sum()) * PLACE_BYTES


def pays(counts: np.ndarray) -> bool:
    """Whether splats should each have their own degree, counts (4,) having each."""
    return bytes_by_degree(counts) < (1 - LEAST_SAVING) * bytes_alike(counts)


BASIS_OPERATIONS = (0, 3, 17, 41)
"""Additions and multiplications of the basis functions up to each degree."""

OWN_DEGREES = "own SH degree a splat"


def band_name(band: int) -> str:
    return f"SH band {band}"


class ColourReach(NamedTuple):
    """How far the colours of a scene go, over all splats and directions."""

    bands: tuple[float, ...]
    """Per degree d: how far bands d and up together can move a colour.

    A coefficient that is not finite culls its splat, and leaving out its band would bring the splat back:
    that gives inf or NaN, unless a lower band culls the splat all the same.
    """
    brightest: float
    """An upper bound of every colour that is drawn, at least 1 for backgrounds."""
    largest: float
    """The same of magnitudes before colours are cut at 0."""
    gain: float = 1.0
    """Of the colour grade: how many times as far bands reach by it."""

    def graded(self, palette: Sequence[Adjustment]) -> ColourReach:
        """The reach where splats may have the colour maps of `palette`."""
        if not is_graded(palette):
            return self
        maps = np.abs([entry.colour for entry in palette])
        with np.errstate(over="ignore", invalid="ignore"):
            gains = maps[..., :3].sum(axis=2)
            colours = gains * self.largest + maps[..., 3]
            brightest = float(np.where(np.isnan(colours), np.inf, colours).max())  # 0·inf
        gain = max(1.0, float(gains.max()))
        bands = tuple(gain * band for band in self.bands)
        return ColourReach(bands, max(self.brightest, brightest), max(self.largest, brightest), gain)


_known: WeakKeyDictionary[Gaussians, ColourReach] = WeakKeyDictionary()


def colour_reach(gaussians: Gaussians) -> ColourReach:
    """The reach of a scene, found once, as its arrays never change; a second for a million splats."""
    if gaussians not in _known:
        _known[gaussians] = _reach(gaussians.sh)
    return _known[gaussians]


def used_sh_degree(gaussians: Gaussians, palette: Sequence[Adjustment] = ()) -> int:
    """The lowest SH degree that shows the scene, with the grades of `palette`, as the stored one does, to
    within VISIBLE in every pixel.

    All bands above it together cannot move the colour of any splat by more; blending is a weighted mean
    of colours, so no pixel moves by more either.
    """
    sample = gaussians.sh[:: max(1, len(gaussians) // SAMPLE)]
    if gaussians not in _known and _used_degree(_reach(sample).bands) == gaussians.sh_degree:
        return gaussians.sh_degree  # neither the others nor a grade can add to that
    return _used_degree(colour_reach(gaussians).graded(palette).bands)


def sh_operations(degree: int) -> int:
    """Additions and multiplications that the colour of one splat takes at an SH degree."""
    return BASIS_OPERATIONS[degree] + 2 * 3 * SH_COEFFICIENTS[degree]


def visible_degrees(sh: np.ndarray) -> np.ndarray:
    """(N, K, 3) -> (N,) uint8: the lowest degree that shows each splat as the stored one does, to VISIBLE.

    A coefficient that is not finite, and so culls its splat, is never left out.
    """
    degrees = np.zeros(len(sh), np.uint8)
    for start in range(0, len(sh), SLICE):
        dropped, found = _dropped(sh[start : start + SLICE]).max(axis=2), degrees[start : start + SLICE]
        for band in range(1, dropped.shape[1]):
            found[~_invisible(dropped[:, band])] = band
    return degrees


def band_effects(gaussians: Gaussians, colours: ColourReach) -> list[Effect]:
    """An effect a band, as far as the file has them; `colours` of the scene as it is graded."""
    reach = colours.bands
    used, stored, n = _used_degree(reach), len(reach) - 1, len(gaussians)
    effects = []
    for band in range(1, stored + 1):
        change = (
            f"the coefficients from this band up move a colour by at most {reach[band]:.2g} "
            f"({grey_levels(reach[band])})"
        )
        if colours.gain > 1:
            change += f", {short(colours.gain)} times as far as without the colour grade"
        if not math.isfinite(reach[band]):
            change = "a coefficient from this band up is infinite, NaN or nearly so"
        limit = "below half a grey level: not computed" if band > used else "above half a grey level"
        coefficients = SH_COEFFICIENTS[stored] - SH_COEFFICIENTS[band - 1]
        effects.append(
            Effect(
                name=band_name(band),
                on=band <= used,
                why=f"{change}, {limit}",
                # Without a band those above it are of no use.
                saving=Saving(
                    bytes=n * coefficients * COEFFICIENT_BYTES,
                    operations=n * (sh_operations(stored) - sh_operations(band - 1)),
                ),
                bound=reach[band] if math.isfinite(reach[band]) else math.inf,
                can_override=True,
            )
        )
    return effects


def own_degrees_effect(gaussians: Gaussians) -> Effect:
    """Whether splats differ so much in their bands that each has and pays for its own only."""
    counts = degree_counts(sh_degrees(gaussians.sh))
    visible = degree_counts(visible_degrees(gaussians.sh))
    on = pays(counts)
    alike, apart = bytes_alike(counts), bytes_by_degree(counts)
    why = f"highest band that is not all zero: {_listed(counts)}"
    if not np.array_equal(visible, counts):
        why += f"; that can be seen: {_listed(visible)}"
    why += (
        f": {apart:,} bytes in place of {alike:,}, at the price of one place per splat"
        if on
        else f": one layout for all takes {alike:,} bytes, each its own {apart:,}, no tenth less"
    )
    return Effect(
        name=OWN_DEGREES,
        on=on,
        why=why,
        saving=Saving(what="" if on else "a place to look up a splat"),
    )


def _listed(counts: np.ndarray) -> str:
    return ", ".join(f"{n:,} of degree {d}" for d, n in enumerate(counts) if n) or "none"


def _dropped(sh: np.ndarray) -> np.ndarray:
    """(n, K, 3) -> (n, degree + 1, 3): how far bands d and up together can move a splat's colour."""
    with np.errstate(over="ignore", invalid="ignore"):
        # From the highest band down: what dropping this band and all above it would cost.
        return np.cumsum(sh_bound(sh)[:, ::-1], axis=1)[:, ::-1]


def _reach(all_sh: np.ndarray) -> ColourReach:
    """Of the colours of (N, K, 3)."""
    bands = np.zeros(SH_COEFFICIENTS.index(all_sh.shape[1]) + 1, np.float32)
    brightest = largest = 1.0
    for start in range(0, len(all_sh), SLICE):
        sh = all_sh[start : start + SLICE]
        dropped = _dropped(sh)
        with np.errstate(over="ignore", invalid="ignore"):
            finite = np.abs(sh) <= FLOAT32_MAX
            constant = 0.5 + SH_C0 * sh[:, 0]
            rest = dropped[:, 1] if len(bands) > 1 else 0
            drawn = finite.all(axis=(1, 2))
            brightest = max(brightest, float((constant + rest)[drawn].max(initial=0.0)))
            largest = max(largest, float((np.abs(constant) + rest)[drawn].max(initial=0.0)))
        moved = dropped.max(axis=2)
        culled = np.zeros(len(sh), dtype=bool)
        for band in range(len(bands)):
            moved[culled, band] = 0
            culled |= ~finite[:, band * band : (band + 1) ** 2].all(axis=(1, 2))
        bands = np.maximum(bands, moved.max(axis=0, initial=0.0))
    return ColourReach(bands=tuple(map(float, bands)), brightest=brightest, largest=largest)


def _used_degree(reach: Sequence[float]) -> int:
    return max((band for band in range(1, len(reach)) if not _invisible(reach[band])), default=0)


def _invisible(reach):
    """Of changes of a colour; an overflow to inf or NaN counts as visible. 1e-5: float32 sums."""
    with np.errstate(over="ignore", invalid="ignore"):
        return reach * (1 + 1e-5) <= VISIBLE
