"""Kernels of Adam (Kingma and Ba 2015) over the splats that a picture has seen, all attributes in one pass.

A splat that no pixel saw has no gradient. Plain Adam moves it on by its average all the same, and reads
and writes every number of every splat to do so; here such a splat rests until it is seen again, as in
Kerbl's and Mallick's (Taming 3DGS, 2024) sparse variants. Bias is corrected by the number of steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.simd import LANES, absolute, divide, fill, fma, keep_if_below, load, negate, sqrt, store

BETA1, BETA2 = 0.9, 0.999
EPSILON = 1e-15
"""Kerbl et al. 2023: gradients of single splats are far below Adam's usual 1e-8."""

LARGEST = np.float32(1e18)
"""A gradient above this, or NaN, counts as 0: its square would not fit, and one bad pixel ends no run."""

REST_DIVISOR = 20
"""The higher SH bands have the rate of the constant one over this (Kerbl et al. 2023)."""


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


@kernel(allocates=True)
def move(
    indices,
    means,
    quats,
    log_scales,
    opacity_logits,
    sh,
    means1,
    quats1,
    log_scales1,
    opacity_logits1,
    sh1,
    means2,
    quats2,
    log_scales2,
    opacity_logits2,
    sh2,
    d_means,
    d_quats,
    d_log_scales,
    d_opacity_logits,
    d_sh,
    factors,
    epsilon,
    limits,
):
    """Adam over the splats at `indices`; factors (6,), limits (4,) and every parameter float32."""
    one = np.float32(1)
    numbers = sh.shape[1] * 3
    whole = numbers // LANES * LANES
    colour_rates = np.full(numbers, factors[5])
    colour_rates[:3] = factors[4]
    flat_sh, flat_d, flat1, flat2 = sh.reshape(-1), d_sh.reshape(-1), sh1.reshape(-1), sh2.reshape(-1)
    for i in indices:
        for k in range(3):
            means[i, k] = moved(means[i, k], d_means[i, k], means1[i], means2[i], k, factors[0], epsilon)
            scale = np.exp(log_scales[i, k])
            d_scale = d_log_scales[i, k] + (limits[1] * scale if scale > limits[2] else np.float32(0))
            log_scales[i, k] = moved(
                log_scales[i, k], d_scale, log_scales1[i], log_scales2[i], k, factors[2], epsilon
            )
        a, b, c = log_scales[i, 0], log_scales[i, 1], log_scales[i, 2]
        most = max(min(a, b), min(max(a, b), c)) + limits[3]
        for k in range(3):
            log_scales[i, k] = min(log_scales[i, k], most)
        for k in range(4):
            quats[i, k] = moved(quats[i, k], d_quats[i, k], quats1[i], quats2[i], k, factors[1], epsilon)
        opacity = one / (one + np.exp(-opacity_logits[i]))
        d_opacity = d_opacity_logits[i] + limits[0] * opacity * (one - opacity)
        opacity_logits[i] = moved(
            opacity_logits[i], d_opacity, opacity_logits1, opacity_logits2, i, factors[3], epsilon
        )
        at = i * numbers
        for k in range(0, whole, LANES):
            move_vector(flat_sh, flat_d, flat1, flat2, at + k, load(colour_rates, k), epsilon)
        for k in range(at + whole, at + numbers):
            flat_sh[k] = moved(flat_sh[k], flat_d[k], flat1, flat2, k, colour_rates[k - at], epsilon)
