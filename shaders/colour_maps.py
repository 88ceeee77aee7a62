"""The colour maps of ``common/colour_maps.glsl`` as numbers, for legends and for pictures by the CPU."""

from __future__ import annotations

import re
from functools import cache
from importlib import resources

import numpy as np

from splatview import shaders

MOST_OVERDRAW = 512
"""Splats at one pixel that show as the map's last colour, as ``quads/resolve.frag.glsl`` has it."""


@cache
def coefficients(name: str) -> np.ndarray:
    """(7, 3) float64: the polynomials of the map `name`, highest power first."""
    text = resources.files(shaders).joinpath("common/colour_maps.glsl").read_text(encoding="utf8")
    body = text.split(f"vec3 {name}(float t)")[1].split("}")[0]
    numbers = re.findall(r"vec3\(([^)]*)\)", body)
    return np.array([[float(number) for number in row.split(",")] for row in numbers])


def colour_map(name: str, steps: int) -> np.ndarray:
    """(steps, 3) float64: the map `name` from 0 to 1."""
    t = np.linspace(0, 1, steps)[:, None]
    value = np.zeros((steps, 3))
    for row in coefficients(name):
        value = value * t + row
    return np.clip(value, 0, 1)
