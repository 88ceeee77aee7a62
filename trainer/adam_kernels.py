"""Kernels of Adam (Kingma and Ba 2015) over the splats that a picture has seen, all attributes in one pass.

A splat that no pixel saw has no gradient. Plain Adam moves it on by its average all the same, and reads
and writes every number of every splat to do so; here such a splat rests until it is seen again, as in
Kerbl's and Mallick's (Taming 3DGS, 2024) sparse variants. Bias is corrected by the number of steps.

All but SH is moved by blocks of LANES splats, as they are in memory: a number of a splat is a lane, and lanes
of splats that rest are left as they are. One number at a time took two thirds of the whole.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.exponentials import LOG2_E, exp2
from splatview.raster.simd import (
    LANES,
    absolute,
    aligned,
    divide,
    fill,
    fma,
    keep_if_at_least,
    keep_if_below,
    load,
    maximum,
    minimum,
    negate,
    sqrt,
    store,
)

BETA1, BETA2 = 0.9, 0.999
EPSILON = 1e-15
"""Kerbl et al. 2023: gradients of single splats are far below Adam's usual 1e-8. With 1e-6, which slows what
photos show less than a tenth of a pixel of: `beach` 17.48 in place of 17.26 dB, `kermit` 19.60, 19.56 and
12.56 in place of 19.15, 19.27 and 15.68, `toy` 17.98 in place of 18.02 (three minutes, held-out photos as
they are; one split or three)."""

LARGEST = np.float32(1e18)
"""A gradient above this, or NaN, counts as 0: its square would not fit, and one bad pixel ends no run."""

REST_DIVISOR = 20
"""The higher SH bands have the rate of the constant one over this (Kerbl et al. 2023)."""


FEWEST_FOR_FAST = 16
"""Photos that show something everywhere, of fewer of which neither far means nor scales move faster: see
`FAR_FROM` and `adam.FAST_SCALES`.

A minute of the bench, three splits each, by neither and by both (assets/benchmarks/fewest.json). Chosen, 16
photos to train on: `fox 24 near` 30.20 and 30.93 dB, `fox 24 far` 26.99 and 27.11, `mouse 24 far` 23.29 and
23.49, `building 24 near` 20.12 and 20.14; 13: `miku 20 near` 28.07 and 28.13, but `banana` 28.59 and 28.39,
SSIM 0.772 and 0.763. Judged, 16: `miku 24 far` 23.92 and 24.48, 24.34 and 24.43 after three minutes (two
splits), `guitar sky 24`, whose splits differ by up to 2 dB by chance, 31.85 and 31.52."""

FAR_FROM = 0.25
"""See `TrainSettings.far_from` and `recipe.automatic_far_from`. A rate in units of the scene's extent moves
what is ten times as far a tenth as many pixels: houses behind a monument hardly leave where they begin, and
splats in the air before single photos stand for them.

A minute of the bench, split 0 each, all alike and so (docs/training-recipe.md). Chosen: `statue` 20.11 and
21.41 dB, `demo lens 40` 32.19 and 33.70, `miku` 29.86 and 30.50, `fox` 29.49 and 29.61, but `biker front 24`,
before black, 42.92 and 42.70, and of fewer photos `banana` 26.95 and 26.91 (SSIM 0.718 and 0.707), `beach`
18.70 and 18.20, and `castle` 19.51 and 19.03: what is faster learns by heart faster, too.

Not for fewer photos than `FEWEST_FOR_FAST`: 13 of `banana`, every 8th held out, 375x249 px, a minute, have
28.13 and 27.22 dB, by the paper's rate of scales 28.49 and 26.14.

Dropped: 0.25 to the end of the run, 21.52, 34.10, 30.44 and 29.76 on the first four, but `banana` 26.65
and `biker front 24` 42.31; from 0.1 on, `statue` 21.36, `demo lens 40` 34.51, `fox` 29.15; from 1 on,
`statue` 21.30, `demo lens 40` 32.74; four times the rate for all, 20.41, 33.27 and 29.30. Dropped too:
to pull scales of far splats less, in proportion, 19.65 on `statue`."""

MEANS, QUATS, LOG_SCALES, OPACITY_LOGITS, SH = range(5)


class Rates(NamedTuple):
    """Learning rates by attribute."""

    means: float
    quats: float
    log_scales: float
    opacity_logits: float
    sh: float
    """Rate of the constant band; higher bands have a `REST_DIVISOR`-th."""


@inline
def moved(value, gradient, first, second, at, rate, epsilon):
    """One number's step; `first` and `second` (flat) are updated at `at`."""
    g = gradient if abs(gradient) <= LARGEST else np.float32(0)
    m = np.float32(BETA1) * first[at] + np.float32(1 - BETA1) * g
    v = np.float32(BETA2) * second[at] + np.float32(1 - BETA2) * g * g
    first[at] = m
    second[at] = v
    return value - rate * m / (np.sqrt(v) + epsilon)


@inline
def move_vector(values, gradients, first, second, at, rates, epsilon):
    """`moved` for LANES numbers of flat arrays from `at` on."""
    g = load(gradients, at)
    g = keep_if_below(g, absolute(g), fill(g, LARGEST))
    m = fma(fill(g, BETA1), load(first, at), fill(g, 1 - BETA1) * g)
    v = fma(fill(g, BETA2), load(second, at), fill(g, 1 - BETA2) * g * g)
    store(first, at, m)
    store(second, at, v)
    step = divide(rates * m, sqrt(v) + fill(g, epsilon))
    store(values, at, load(values, at) + negate(step))


@inline
def chosen(moves, new, old):
    """`new` in the lanes where `moves` is 1, `old` where it is 0."""
    half = fill(moves, 0.5)
    return keep_if_at_least(new, moves, half) + keep_if_below(old, moves, half)


@inline
def move_lanes(values, g, first, second, at, rates, epsilon, moves):
    """`move_vector` with gradients `g` at hand, for the lanes where `moves` is 1."""
    g = keep_if_below(g, absolute(g), fill(g, LARGEST))
    value, m, v = load(values, at), load(first, at), load(second, at)
    new_m = fma(fill(g, BETA1), m, fill(g, 1 - BETA1) * g)
    new_v = fma(fill(g, BETA2), v, fill(g, 1 - BETA2) * g * g)
    step = divide(rates * new_m, sqrt(new_v) + fill(g, epsilon))
    store(first, at, chosen(moves, new_m, m))
    store(second, at, chosen(moves, new_v, v))
    store(values, at, chosen(moves, value + negate(step), value))


@inline
def exp(x):
    """e^x in every lane of a float32 vector, between 2^-126 and 2^126, to some 1e-6 of it."""
    return exp2(minimum(maximum(x * fill(x, LOG2_E), fill(x, -126.0)), fill(x, 126.0)))


# What moves of a block, 1 or 0 for each number: of one, three and four numbers a splat.
OF_ONE, OF_THREE, OF_FOUR, MASKS = 0, LANES, 4 * LANES, 8 * LANES


@inline
def find_masks(indices, begin, masks):
    """Writes masks (MASKS,) of the splats at `indices`, within LANES from `begin` on."""
    masks[:] = 0
    one = masks.dtype.type(1)
    for i in indices:
        lane = np.int64(i) - begin
        masks[OF_ONE + lane] = one
        for k in range(3):
            masks[OF_THREE + 3 * lane + k] = one
        for k in range(4):
            masks[OF_FOUR + 4 * lane + k] = one


@inline
def reach(i, means, limits):
    """How many times as far as the radius in `limits` a splat is from the centre there; 1 within."""
    x, y, z = means[3 * i] - limits[4], means[3 * i + 1] - limits[5], means[3 * i + 2] - limits[6]
    squared = (x * x + y * y + z * z) * limits[7] * limits[7]
    return np.sqrt(squared) if 1 < squared < LARGEST else np.float32(1)


@inline
def move_one(i, values, gradients, first, second, factors, epsilon, limits):
    """A splat's step, one number at a time; all but SH.

    Written out: a loop over (attribute, width, rate) was rounded otherwise by the kernel just compiled than
    by the same one from the cache, so that two processes differed from one by the last bit.
    """
    one, nothing = np.float32(1), np.float32(0)
    means, d_means, rate = values[MEANS], gradients[MEANS], factors[MEANS] * reach(i, values[MEANS], limits)
    for k in range(3 * i, 3 * i + 3):
        means[k] = moved(means[k], d_means[k], first[MEANS], second[MEANS], k, rate, epsilon)
    quats, d_quats = values[QUATS], gradients[QUATS]
    for k in range(4 * i, 4 * i + 4):
        quats[k] = moved(quats[k], d_quats[k], first[QUATS], second[QUATS], k, factors[QUATS], epsilon)
    scales, d_scales = values[LOG_SCALES], gradients[LOG_SCALES]
    for k in range(3 * i, 3 * i + 3):
        scale = np.exp(scales[k])
        d_scale = d_scales[k] + (limits[1] * scale if scale > limits[2] else nothing)
        scales[k] = moved(
            scales[k], d_scale, first[LOG_SCALES], second[LOG_SCALES], k, factors[LOG_SCALES], epsilon
        )
    logits = values[OPACITY_LOGITS]
    opacity = one / (one + np.exp(-logits[i]))
    d_logit = gradients[OPACITY_LOGITS][i] + limits[0] * opacity * (one - opacity)
    logits[i] = moved(
        logits[i], d_logit, first[OPACITY_LOGITS], second[OPACITY_LOGITS], i, factors[OPACITY_LOGITS], epsilon
    )


@inline
def move_block(begin, masks, values, gradients, first, second, factors, epsilon, limits, rates):
    """As `move_one` for the LANES splats from `begin` on, as far as masks (MASKS,) say. `rates` (3 LANES,):
    room for those of means."""
    for lane in range(LANES):
        rates[3 * lane : 3 * lane + 3] = factors[MEANS] * reach(begin + lane, values[MEANS], limits)
    for k in range(0, 3 * LANES, LANES):
        at, moves = 3 * begin + k, load(masks, OF_THREE + k)
        d_mean = load(gradients[MEANS], at)
        means = values[MEANS], d_mean, first[MEANS], second[MEANS]
        move_lanes(*means, at, load(rates, k), epsilon, moves)
        scale = exp(load(values[LOG_SCALES], at))
        pull = keep_if_below(fill(scale, limits[1]) * scale, fill(scale, limits[2]), scale)
        d_scale = load(gradients[LOG_SCALES], at) + pull
        scales = values[LOG_SCALES], d_scale, first[LOG_SCALES], second[LOG_SCALES]
        move_lanes(*scales, at, fill(scale, factors[LOG_SCALES]), epsilon, moves)
    for k in range(0, 4 * LANES, LANES):
        at, moves = 4 * begin + k, load(masks, OF_FOUR + k)
        d_quat = load(gradients[QUATS], at)
        quats = values[QUATS], d_quat, first[QUATS], second[QUATS]
        move_lanes(*quats, at, fill(d_quat, factors[QUATS]), epsilon, moves)
    logit, moves = load(values[OPACITY_LOGITS], begin), load(masks, OF_ONE)
    one = fill(logit, 1.0)
    opacity = divide(one, one + exp(negate(logit)))
    d_logit = load(gradients[OPACITY_LOGITS], begin) + fill(logit, limits[0]) * opacity * (one - opacity)
    logits = values[OPACITY_LOGITS], d_logit, first[OPACITY_LOGITS], second[OPACITY_LOGITS]
    move_lanes(*logits, begin, fill(logit, factors[OPACITY_LOGITS]), epsilon, moves)


@kernel(allocates=True)
def move(indices, values, gradients, first, second, sh_numbers, factors, epsilon, limits):
    """Adam over the splats at `indices`, ascending, while no other thread moves any of the same LANES splats.

    values, gradients, first and second: five flat float32 arrays each, in the order of `Parameters`;
    sh_numbers: how many of SH a splat has; factors (6,), limits (8,) float32.
    """
    count, whole = len(values[OPACITY_LOGITS]), sh_numbers // LANES * LANES
    colour_rates = np.full(sh_numbers, factors[SH + 1])
    colour_rates[:3] = factors[SH]
    some, every = aligned(MASKS, np.float32), aligned(MASKS, np.float32)
    every[:] = 1
    rates = aligned(3 * LANES, np.float32)
    scales, place = values[LOG_SCALES], 0
    while place < len(indices):
        begin, end = np.int64(indices[place]) // LANES * LANES, place
        while end < len(indices) and indices[end] < begin + LANES:
            end += 1
        if begin + LANES > count:  # at the end, where there is no whole block
            for i in indices[place:end]:
                move_one(np.int64(i), values, gradients, first, second, factors, epsilon, limits)
        else:
            masks = every
            if end - place < LANES:
                masks = some
                find_masks(indices[place:end], begin, masks)
            move_block(begin, masks, values, gradients, first, second, factors, epsilon, limits, rates)
        if limits[3] < np.inf:
            for i in indices[place:end]:
                a, b, c = scales[3 * i], scales[3 * i + 1], scales[3 * i + 2]
                most = max(min(a, b), min(max(a, b), c)) + limits[3]
                for k in range(3 * i, 3 * i + 3):
                    scales[k] = min(scales[k], most)
        place = end
    sh, d_sh, sh1, sh2 = values[SH], gradients[SH], first[SH], second[SH]
    for i in indices:
        at = np.int64(i) * sh_numbers
        for k in range(0, whole, LANES):
            move_vector(sh, d_sh, sh1, sh2, at + k, load(colour_rates, k), epsilon)
        for k in range(at + whole, at + sh_numbers):
            sh[k] = moved(sh[k], d_sh[k], sh1, sh2, k, colour_rates[k - at], epsilon)


TINY = 1e-15
"""Keeps a first step of `PhotoAdam` along a gradient of 0 at 0."""


class PhotoAdam:
    """Adam's averages for an array of shape (P, ...), a row for each photo, bias corrected by how often each
    was looked at (Kingma and Ba 2015)."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.first, self.second = np.zeros(shape), np.zeros(shape)
        self.visits = np.zeros(shape[0], np.int64)

    def moves(self, rows: np.ndarray, gradients: np.ndarray, rate: float) -> np.ndarray:
        """What to add to these rows (K,), by their gradients (K, ...)."""
        self.visits[rows] += 1
        visits = self.visits[rows].reshape(-1, *[1] * (gradients.ndim - 1))
        m = self.first[rows] = BETA1 * self.first[rows] + (1 - BETA1) * gradients
        v = self.second[rows] = BETA2 * self.second[rows] + (1 - BETA2) * gradients * gradients
        m, v = m / (1 - BETA1**visits), v / (1 - BETA2**visits)
        return -rate * m / (np.sqrt(v) + TINY)

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes."""
        return {"first": self.first, "second": self.second, "visits": self.visits}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where another's `state` was taken. Raises KeyError, ValueError: its shape is another."""
        for name, ours in self.state().items():
            if state[name].shape != ours.shape:
                raise ValueError(f"{name} has the shape {state[name].shape}, not {ours.shape}")
            ours[:] = state[name]
