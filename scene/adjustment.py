"""What editing does to the values of a splat: one similarity, one size, one opacity and one colour map.

Each of the four is closed under composition, so however often a splat is edited, one `Adjustment` says
what came of it: nothing accumulates rounding, and undoing one step leaves no trace.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .projection import rotation_matrices

IDENTITY_ROTATION = (1.0, 0.0, 0.0, 0.0)
IDENTITY_COLOUR = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
IDENTITY_OPACITY = (1.0, 0.0, 0.0, 1.0)

ROW = 36
"""Numbers in a row of `adjustment_rows`."""

Vector = tuple[float, float, float]
Four = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Adjustment:
    """How an edited splat differs from the one in the file. All numbers are finite.

    Raises:
        ValueError: a number makes no sense; the message names it.
    """

    rotation: Four = IDENTITY_ROTATION
    """wxyz, of length 1: R of mean' = scale·R·mean + translation. It turns quats and SH too."""
    scale: float = 1.0
    """Above 0; standard deviations grow by it too."""
    translation: Vector = (0.0, 0.0, 0.0)
    """World units."""
    size: float = 1.0
    """Above 0: factor on the standard deviations alone."""
    opacity: Four = IDENTITY_OPACITY
    """gain, offset, low, high: opacity' = min(max(gain·opacity + offset, low), high), gain at least 0."""
    colour: tuple[Four, Four, Four] = IDENTITY_COLOUR
    """A and b of rgb' = A·rgb + b, on display colours before they are cut at 0."""

    def __post_init__(self) -> None:
        numbers = np.array(
            [*self.rotation, self.scale, *self.translation, self.size, *self.opacity, *np.ravel(self.colour)]
        )
        if numbers.shape != (25,) or not np.isfinite(numbers).all():
            raise ValueError("an adjustment has 25 finite numbers")
        if not abs(float(np.linalg.norm(self.rotation)) - 1) <= 1e-6:
            raise ValueError(f"rotation must be a quaternion of length 1, got {self.rotation}")
        for name in ("scale", "size"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        gain, _, low, high = self.opacity
        if not (gain >= 0 and 0 <= low <= high <= 1):
            raise ValueError(f"opacity must have gain >= 0 and 0 <= low <= high <= 1, got {self.opacity}")

    @property
    def linear(self) -> np.ndarray:
        """scale·R, (3, 3) float64."""
        return self.scale * self.R

    @property
    def R(self) -> np.ndarray:
        """(3, 3) float64."""
        return rotation_matrices(np.array([self.rotation], np.float64))[0]

    def then(self, later: Adjustment) -> Adjustment:
        """This one first, `later` after it."""
        gain, offset, low, high = self.opacity
        gain2, offset2, low2, high2 = later.opacity
        low12, high12 = (min(max(gain2 * end + offset2, low2), high2) for end in (low, high))
        a = np.vstack([np.array(self.colour, np.float64), [0, 0, 0, 1]])
        b = np.vstack([np.array(later.colour, np.float64), [0, 0, 0, 1]])
        colour = (b @ a)[:3]
        translation = later.linear @ np.array(self.translation) + np.array(later.translation)
        rotation = quat_product(np.array(later.rotation), np.array(self.rotation))
        return Adjustment(
            rotation=_four(rotation / np.linalg.norm(rotation)),
            scale=self.scale * later.scale,
            translation=(float(translation[0]), float(translation[1]), float(translation[2])),
            size=self.size * later.size,
            opacity=(gain * gain2, gain2 * offset + offset2, low12, high12),
            colour=(_four(colour[0]), _four(colour[1]), _four(colour[2])),
        )

    @property
    def moves(self) -> bool:
        """Whether it places splats elsewhere."""
        return (self.rotation, self.scale, self.translation) != (IDENTITY_ROTATION, 1.0, (0.0, 0.0, 0.0))


IDENTITY = Adjustment()


def _four(values: np.ndarray) -> Four:
    w, x, y, z = (float(value) for value in values)
    return (w, x, y, z)


def quat_product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions wxyz, (..., 4) each: the rotation `second`, then `first`."""
    w1, x1, y1, z1 = np.moveaxis(first, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(second, -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def adjustment_rows(palette: tuple[Adjustment, ...], centre: np.ndarray | None = None) -> np.ndarray:
    """The palette as renderers read it: (P, ROW) float64, nine groups of four.

    Columns 0 to 11: scale·R beside the translation, 3x4 by rows; 12 to 15: R as wxyz; 16 to 27: the colour
    map, 3x4 by rows; 28 to 31: gain, offset, low, high of opacity; 32: scale·size, the factor on standard
    deviations; the rest is 0. Means are taken relative to `centre` (3,), before and after.
    """
    origin = np.zeros(3) if centre is None else np.asarray(centre, np.float64)
    rows = np.zeros((len(palette), ROW))
    for row, adjustment in zip(rows, palette, strict=True):
        linear = adjustment.linear
        shift = linear @ origin + np.array(adjustment.translation) - origin
        row[:12] = np.hstack([linear, shift[:, None]]).ravel()
        row[12:16] = adjustment.rotation
        row[16:28] = np.ravel(adjustment.colour)
        row[28:32] = adjustment.opacity
        row[32] = adjustment.scale * adjustment.size
    return rows
