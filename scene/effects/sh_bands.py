"""Spherical harmonics: which bands can be seen, over the whole scene and splat by splat."""

from __future__ import annotations

import math

import numpy as np

from ..gaussians import SH_COEFFICIENTS, Gaussians
from ..health import sh_reach
from ..projection import FLOAT32_MAX
from .effect import VISIBLE, Effect, Saving, grey_levels

SLICE = 1 << 16
"""Splats looked at together, so that what is made of them stays in the caches."""

BASIS_OPERATIONS = (0, 3, 17, 41)
"""Additions and multiplications of the basis functions up to each degree."""

BYTES_A_COEFFICIENT = 12
"""Three colours in float32."""

OWN_DEGREE_BYTES = 4
"""What it costs to know of each splat where its coefficients begin and how many they are."""


def used_sh_degree(gaussians: Gaussians) -> int:
    """The lowest SH degree that shows the scene as the stored one does, to within VISIBLE in every pixel.

    All bands above it together cannot move the colour of any splat by more; blending is a weighted mean
    of colours, so no pixel moves by more either.
    """
    return _used_degree(_largest_reach(gaussians))


def sh_degrees(sh: np.ndarray, threshold: float = 0.0) -> np.ndarray:
    """(N, K, 3) -> (N,) uint8: the lowest degree that shows each splat as the stored does, to `threshold`.

    All bands above it together cannot move the splat's colour by more. At the threshold 0 only coefficients
    that are zero are left out, and pictures stay the same to the bit. A coefficient that is not finite, which
    culls its splat, is never left out.
    """
    most = SH_COEFFICIENTS.index(sh.shape[1])
    degrees = np.zeros(len(sh), np.uint8)
    for start in range(0, len(sh), SLICE):
        part = sh[start : start + SLICE]
        of_part = degrees[start : start + SLICE]
        if threshold <= 0:
            for band in range(1, most + 1):
                # NaN is not 0 either.
                of_part[
                    (part[:, SH_COEFFICIENTS[band - 1] : SH_COEFFICIENTS[band]] != 0).any(axis=(1, 2))
                ] = band
            continue
        dropped = _dropped(part)
        for band in range(1, most + 1):
            # Negated, so that an overflow to inf or NaN counts as visible. 1e-5: float32 sums.
            of_part[~(dropped[:, band] * (1 + 1e-5) <= threshold)] = band
    return degrees


def sh_bytes_by_degree(counts: np.ndarray) -> int:
    """Bytes of float32 coefficients where each of counts[d] splats keeps those up to its own degree d."""
    coefficients = sum(int(count) * SH_COEFFICIENTS[degree] for degree, count in enumerate(counts))
    return coefficients * BYTES_A_COEFFICIENT + int(sum(counts)) * OWN_DEGREE_BYTES


def sh_operations(degree: int) -> int:
    """Additions and multiplications that the colour of one splat takes at an SH degree."""
    return BASIS_OPERATIONS[degree] + 2 * 3 * SH_COEFFICIENTS[degree]


def band_effects(gaussians: Gaussians) -> list[Effect]:
    """An effect a band, as far as the file has them."""
    reach = _largest_reach(gaussians)
    used = _used_degree(reach)
    effects = []
    for band in range(1, len(reach)):
        change = (
            f"the coefficients from this band up move a colour by at most {reach[band]:.2g} "
            f"({grey_levels(reach[band])})"
        )
        if not math.isfinite(reach[band]):
            change = "a coefficient from this band up is infinite, NaN or nearly so"
        limit = "below half a grey level: not computed" if band > used else "above half a grey level"
        effects.append(
            Effect(
                name=band_name(band),
                on=band <= used,
                why=f"{change}, {limit}",
                saving=_saved_bands(len(gaussians), band, len(reach) - 1),
                bound=reach[band] if math.isfinite(reach[band]) else math.inf,
                can_override=True,
            )
        )
    return effects


def band_name(band: int) -> str:
    return f"SH band {band}"


def own_degrees_effect(gaussians: Gaussians) -> Effect:
    """Whether splats differ in the bands they have, so that each should have and pay for its own only."""
    n, stored = len(gaussians), gaussians.sh_degree
    exact = np.bincount(sh_degrees(gaussians.sh), minlength=stored + 1)
    nearly = np.bincount(sh_degrees(gaussians.sh, VISIBLE), minlength=stored + 1)
    highest = int(np.flatnonzero(exact).max(initial=0))
    plain = n * SH_COEFFICIENTS[highest] * BYTES_A_COEFFICIENT
    on = own_degrees_pay(exact)
    listed = ", ".join(f"{count:,} of degree {degree}" for degree, count in enumerate(exact) if count)
    within = ", ".join(f"{count:,} of degree {degree}" for degree, count in enumerate(nearly) if count)
    why = f"by the coefficients that are not zero {listed or 'there is no splat'}"
    if within != listed:
        why += f"; to within half a grey level {within}"
    why += (
        ": each has its own bands only"
        if on
        else ": one layout for all takes no more than a degree for each splat"
    )
    return Effect(
        name="own SH degree a splat",
        on=on,
        why=why,
        saving=Saving(
            what=f"nothing; having it saves {plain - sh_bytes_by_degree(exact):,} bytes"
            if on
            else f"{n * OWN_DEGREE_BYTES:,} bytes of degrees"
        ),
    )


LEAST_SAVING = 0.1
"""Of the bytes of harmonics, from which on splats are stored by their own degrees: below it the detour by a
table of degrees takes as much time as the coefficients that it spares."""


def own_degrees_pay(counts: np.ndarray) -> bool:
    """Whether storing each splat's own bands saves LEAST_SAVING; counts (degrees,): splats of each degree."""
    highest = int(np.flatnonzero(counts).max(initial=0))
    plain = int(sum(counts)) * SH_COEFFICIENTS[highest] * BYTES_A_COEFFICIENT
    return sh_bytes_by_degree(counts) < (1 - LEAST_SAVING) * plain


def _saved_bands(splats: int, band: int, stored: int) -> Saving:
    """Of all bands from `band` up to the stored degree."""
    coefficients = SH_COEFFICIENTS[stored] - SH_COEFFICIENTS[band - 1]
    return Saving(
        bytes=splats * coefficients * BYTES_A_COEFFICIENT,
        operations=splats * (sh_operations(stored) - sh_operations(band - 1)),
    )


def _dropped(sh: np.ndarray) -> np.ndarray:
    """(n, K, 3) -> (n, degree + 1): how far bands d and up together can move a splat's colour."""
    with np.errstate(over="ignore", invalid="ignore"):
        reach = sh_reach(sh)
        return np.cumsum(reach[:, ::-1], axis=1)[:, ::-1].max(axis=2)


def _largest_reach(gaussians: Gaussians) -> list[float]:
    """Per degree d: how far bands d and up together can move the colour of any splat.

    A coefficient that is not finite culls its splat, and leaving out its band would bring the splat back:
    that gives inf or NaN, unless a lower band culls the splat all the same.
    """
    largest = np.zeros(gaussians.sh_degree + 1, np.float32)
    for start in range(0, len(gaussians), SLICE):
        sh = gaussians.sh[start : start + SLICE]
        dropped = _dropped(sh)
        with np.errstate(invalid="ignore"):
            finite = np.abs(sh) <= FLOAT32_MAX
        culled = np.zeros(len(sh), dtype=bool)
        for band in range(len(largest)):
            dropped[culled, band] = 0
            culled |= ~finite[:, band * band : (band + 1) ** 2].all(axis=(1, 2))
        largest = np.maximum(largest, dropped.max(axis=0, initial=0.0))
    return [float(value) for value in largest]


def _used_degree(reach: list[float]) -> int:
    for degree in range(len(reach) - 1, 0, -1):
        # Negated, so that an overflow to inf or NaN counts as visible. 1e-5: float32 sums.
        if not reach[degree] * (1 + 1e-5) <= VISIBLE:
            return degree
    return 0
