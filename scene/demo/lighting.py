"""A late afternoon: one warm sun, a cool sky, and the film that turns radiance into display colour."""

from __future__ import annotations

import numpy as np

from splatview.scene.demo.primitives import mix, smoothstep, unit

SUN = unit(np.array([-0.80, 0.40, -0.34]))
"""Unit vector to the sun; y is up."""

SUN_COLOUR = np.array([4.3, 3.0, 1.75])
ZENITH = np.array([0.17, 0.36, 0.74])
HORIZON = np.array([0.98, 0.78, 0.62])
GLOW = np.array([2.0, 1.05, 0.42])
AMBIENT = np.array([0.42, 0.54, 0.78])
BOUNCE = np.array([0.22, 0.19, 0.11])


def sky(directions: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) from unit `directions` (N, 3): blue above, peach below, gold at the sun."""
    height = np.clip(directions[:, 1], 0, 1)
    towards_sun = directions @ SUN
    colour = mix(HORIZON, ZENITH, 1 - (1 - height) ** 3.2)
    warmth = smoothstep(-0.6, 1.0, towards_sun) * np.exp(-height * 4.5)
    colour = mix(colour * (0.72, 0.80, 0.98), colour, warmth)
    colour += GLOW * (0.55 * np.exp((towards_sun - 1) * 9) * np.exp(-height * 1.5))[:, None]
    return colour + SUN_COLOUR * (0.9 * np.exp((towards_sun - 1) * 160))[:, None]


def lit(
    albedo: np.ndarray,
    normals: np.ndarray,
    sunlight: np.ndarray | float,
    openness: np.ndarray | float,
    *,
    wrap: float = 0.0,
) -> np.ndarray:
    """Radiance (N, 3) of a matt surface: `albedo` (N, 3), unit `normals` (N, 3).

    `sunlight` and `openness` (N,) in [0, 1]: how much of the sun and of the sky it sees. `wrap` lets light
    reach round the terminator, as leaves let it through.
    """
    facing = np.clip((normals @ SUN + wrap) / (1 + wrap), 0, 1) * sunlight
    above = 0.5 + 0.5 * normals[:, 1]
    ambient = AMBIENT * above[:, None] + BOUNCE * (1 - above)[:, None]
    openness = np.broadcast_to(openness, facing.shape)
    return albedo * (SUN_COLOUR * facing[:, None] + ambient * openness[:, None])


def film(radiance: np.ndarray) -> np.ndarray:
    """Display colour in [0, 1] of `radiance` (..., 3): a filmic curve (Narkowicz 2015), then sRGB's."""
    x = np.clip(radiance, 0, None) * 0.72
    x = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-6) ** (1 / 2.4) - 0.055)
