"""Colour grading as one affine map of display colours, which spherical harmonics carry exactly.

In this order, on rgb with 0 black and 1 white:

- levels: (rgb - black) / (white - black)
- temperature t and tint m, each -1 to 1: channel gains 2^(t/2), 2^(-m/2), 2^(-t/2), divided by the
  luminance of their sum, so that greys keep their brightness; a warm t adds red, a positive m takes green
- saturation s: Y + s·(rgb - Y), Y the luminance
- contrast c: ½ + c·(rgb - ½)
- brightness b: rgb + b

Y = 0.2126 r + 0.7152 g + 0.0722 b (ITU-R BT.709), taken of display values, as editors do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

STOPS = 0.5
"""A temperature or tint of 1 makes a channel so many powers of two brighter or darker."""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """The neutral values change nothing.

    Raises:
        ValueError: a number is out of range; the message names it.
    """

    brightness: float = 0.0
    """-1 to 1, added."""
    contrast: float = 1.0
    """0 to 10."""
    saturation: float = 1.0
    """0 (grey) to 10."""
    temperature: float = 0.0
    """-1 (cold) to 1 (warm)."""
    tint: float = 0.0
    """-1 (green) to 1 (magenta)."""
    black: float = 0.0
    """The level that becomes 0, -1 to 2."""
    white: float = 1.0
    """The level that becomes 1, -1 to 2, at least 0.001 above black."""

    def __post_init__(self) -> None:
        ranges = {
            "brightness": (-1, 1),
            "contrast": (0, 10),
            "saturation": (0, 10),
            "temperature": (-1, 1),
            "tint": (-1, 1),
            "black": (-1, 2),
            "white": (-1, 2),
        }
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must be in {low} to {high}, got {getattr(self, name)}")
        if not self.white - self.black >= 0.001:
            raise ValueError(f"white must be at least 0.001 above black, got {self.white} and {self.black}")

    @property
    def matrix(self) -> np.ndarray:
        """(3, 4) float64: A beside b of rgb' = A·rgb + b."""
        span = self.white - self.black
        levels = _affine(np.eye(3) / span, np.full(3, -self.black / span))
        gains = np.exp2(np.array([self.temperature, -self.tint, -self.temperature]) * STOPS)
        balance = _affine(np.diag(gains / (LUMINANCE @ gains)), np.zeros(3))
        grey = np.tile(LUMINANCE, (3, 1))
        saturation = _affine(grey + self.saturation * (np.eye(3) - grey), np.zeros(3))
        contrast = _affine(np.eye(3) * self.contrast, np.full(3, 0.5 - 0.5 * self.contrast))
        brightness = _affine(np.eye(3), np.full(3, self.brightness))
        return (brightness @ contrast @ saturation @ balance @ levels)[:3]


def _affine(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = A, b
    return matrix
