"""Which splats of a scene are invalid or extreme: named findings with the splats they concern."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from splatview.scene.framing import in_sky, robust_bounds
from splatview.scene.gaussians import Gaussians
from splatview.scene.image_model import ALPHA_CUT, MIN_QUAT_COMPONENT
from splatview.scene.projection import FLOAT32_MAX, sigmoid
from splatview.scene.sh import SH_C0

NEEDLE_RATIO = 100.0
"""Standard deviations further apart than this make a splat of which rounding shows first."""

EXTREME_LOG_SCALE = 20.0
"""Natural logarithm: sizes below 2e-9 or above 5e8 world units are no scene's own."""

GIANT_RADII = 1.0
"""A splat whose standard deviation exceeds so many radii of the scene covers all of it."""

FAR_SPACING = 0.1
"""Positions stored more coarsely than this share of the median splat's size visibly jump."""

BRIGHT = 4.0
"""Colours that SH can drive further than this from mid-grey; pictures are in 0 to 1."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Finding:
    """One kind of trouble and the splats that have it."""

    name: str
    indices: np.ndarray
    """(count,) int64, ascending: the splats concerned."""
    what: str
    """What it means for the picture, one sentence."""
    culled: bool
    """Whether renderers leave such splats out."""

    @property
    def count(self) -> int:
        return len(self.indices)


def check(gaussians: Gaussians) -> list[Finding]:
    """All findings in a fixed order, those that concern no splat (count 0) included."""
    n = len(gaussians)
    sh = gaussians.sh.reshape(n, math.prod(gaussians.sh.shape[1:]))
    ordered = np.sort(gaussians.log_scales, axis=1)
    smallest, middle, largest = ordered.T
    with np.errstate(over="ignore", invalid="ignore"):
        scales_finite = _rows_finite(np.exp(gaussians.log_scales))
        quat_largest = np.abs(gaussians.quats).max(axis=1)
        opacities = sigmoid(gaussians.opacity_logits)
        # A difference of two infinite logarithms is no ratio, and is found as extreme.
        needles = largest - smallest > math.log(NEEDLE_RATIO)
        rods = largest - middle > math.log(NEEDLE_RATIO)
        extreme = (np.abs(gaussians.log_scales) > EXTREME_LOG_SCALE).any(axis=1)
        _, radius = robust_bounds(gaussians.means)
        # A sky is as large as it has to be.
        giants = (largest > math.log(GIANT_RADII * radius)) & ~in_sky(gaussians.means)
        bright = sh_bound(gaussians.sh).sum(axis=1).max(axis=1) > BRIGHT
        no_scale_nan = ~np.isnan(gaussians.log_scales).any(axis=1)
    drawn_shape = scales_finite & no_scale_nan
    ratio = f"{NEEDLE_RATIO:g}:1"
    found = (
        ("non-finite means", ~_rows_finite(gaussians.means), True, "The position is NaN or infinite."),
        ("non-finite quaternions", ~_rows_finite(gaussians.quats), True, "The rotation is NaN or infinite."),
        ("non-finite scales", ~scales_finite, True, "exp(log-scale) is NaN or infinite."),
        ("NaN opacities", np.isnan(gaussians.opacity_logits), True, "The opacity is not a number."),
        ("non-finite SH", ~_rows_finite(sh), True, "A colour coefficient is NaN or infinite."),
        (
            "zero quaternions",
            quat_largest < MIN_QUAT_COMPONENT,
            True,
            "A rotation of all zeros has no direction.",
        ),
        (
            "invisible",
            opacities < ALPHA_CUT,
            True,
            "The opacity is below 1/255 everywhere: the splat costs memory and shows nothing.",
        ),
        (
            "opacity at its limit",
            opacities == 1,
            False,
            "The logit is so large that float32 gives an opacity of exactly 1; training cannot move it.",
        ),
        (
            "extreme scales",
            extreme & scales_finite,
            False,
            f"A log-scale is beyond ±{EXTREME_LOG_SCALE:g}.",
        ),
        ("needles", needles & drawn_shape, False, f"Over {ratio}, longest to shortest axis; discs too."),
        ("rods", rods & drawn_shape, False, f"Over {ratio}, longest to middle axis."),
        (
            "giants",
            giants & drawn_shape,
            False,
            f"The standard deviation is over the scene's radius ({radius:.4g} world units).",
        ),
        (
            "coarse positions",
            _coarse(gaussians, largest),
            False,
            f"So far from the origin that {gaussians.means.dtype.name} moves in steps of more than "
            f"{FAR_SPACING:g} of the median splat.",
        ),
        (
            "SH out of range",
            bright & _rows_finite(sh),
            False,
            f"The coefficients can drive a colour further than {BRIGHT:g} from mid-grey.",
        ),
        (
            "duplicates",
            _duplicates(gaussians),
            False,
            "Equal to an earlier splat in every value; only the copies count.",
        ),
    )
    return [
        Finding(name=name, indices=np.flatnonzero(mask), what=what, culled=culled)
        for name, mask, culled, what in found
    ]


def sh_bound(sh: np.ndarray) -> np.ndarray:
    """How far each SH band can move a colour, (N, K, 3) -> (N, degree + 1, 3) float32.

    Over all directions the basis functions of band l have the constant sum of squares (2l + 1) / 4π (the
    addition theorem), so by Cauchy and Schwarz |band| <= |coefficients| · sqrt((2l + 1) / 4π).
    """
    degree = math.isqrt(sh.shape[1]) - 1
    reach = np.empty((len(sh), degree + 1, 3), dtype=np.float32)
    for band in range(degree + 1):
        coefficients = sh[:, band * band : (band + 1) ** 2]
        squares = np.einsum("nkc,nkc->nc", coefficients, coefficients)
        reach[:, band] = np.sqrt(squares) * np.float32(SH_C0 * math.sqrt(2 * band + 1))
    return reach


def _rows_finite(values: np.ndarray) -> np.ndarray:
    """(N, k) -> (N,) bool: finite in float32."""
    return np.all(np.abs(values) <= FLOAT32_MAX, axis=1)


def _coarse(gaussians: Gaussians, largest: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(largest)
        sizes = sizes[sizes <= FLOAT32_MAX]
        size = float(np.median(sizes)) if len(sizes) else np.inf
        furthest = np.abs(gaussians.means).max(axis=1)
        return _rows_finite(gaussians.means) & (np.spacing(furthest) > FAR_SPACING * size)


def _duplicates(gaussians: Gaussians) -> np.ndarray:
    """(N,) bool: splats that equal an earlier one bit by bit, extras apart."""
    n = len(gaussians)
    duplicates = np.zeros(n, dtype=bool)
    if n < 2:
        return duplicates
    # Few splats share a position: only those are compared in full.
    words = gaussians.means.view(np.uint32).astype(np.uint64)
    keys = np.zeros(n, dtype=np.uint64)
    for column in words.T:
        # A step of a multiplicative hash: 2**64 / golden ratio, odd.
        keys = (keys ^ column) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    order = np.argsort(keys, kind="stable")
    same = keys[order][1:] == keys[order][:-1]
    candidates = np.sort(order[np.concatenate([same, [False]]) | np.concatenate([[False], same])])
    if not len(candidates):
        return duplicates
    some = gaussians.take(candidates)
    arrays = (some.means, some.quats, some.log_scales, some.opacity_logits, some.sh)
    rows = np.concatenate(
        [np.ascontiguousarray(values).reshape(len(candidates), -1).view(np.uint8) for values in arrays],
        axis=1,
    )
    _, first = np.unique(rows.view(f"V{rows.shape[1]}").ravel(), return_index=True)
    duplicates[candidates] = True
    duplicates[candidates[first]] = False
    return duplicates
