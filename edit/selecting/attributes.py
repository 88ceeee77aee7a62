"""Numbers that tell splats apart: what histograms show and ranges select by. All of the edited scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits
from ..loops.measures import column, distances
from ..loops.places import places_of
from ..tools import Tools
from . import adjusted

LUMINANCE = np.array((0.2126, 0.7152, 0.0722), np.float32)
"""Weights of red, green and blue in what looks bright (ITU-R BT.709)."""


@dataclass(frozen=True, kw_only=True)
class Query:
    """What an attribute is computed from."""

    gaussians: Gaussians
    edits: SceneEdits
    tools: Tools
    cameras: Sequence[Camera]
    """For contributions; none: sample views are made."""
    point: tuple[float, float, float]
    """For distances, world units."""


@dataclass(frozen=True, kw_only=True)
class Attribute:
    """One number a splat."""

    label: str
    unit: str
    what: str
    """One sentence for a tooltip."""
    values: Callable[[Query], np.ndarray]
    """(N,) float32."""
    log: bool = False
    """Whether a logarithmic axis suits it: it spans decades and is positive."""
    renders: bool = False
    """Whether it takes pictures, and thus seconds."""


def attribute_values(
    name: str,
    gaussians: Gaussians,
    edits: SceneEdits,
    tools: Tools,
    *,
    cameras: Sequence[Camera] = (),
    point: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """Values (N,) float32 of the attribute `name` for all splats, hidden and deleted ones included.

    NaN where a splat's own numbers are. `cameras` serve "contribution", `point` serves "distance".

    Raises:
        ValueError: no attribute has that name.
    """
    if name not in ATTRIBUTES:
        raise ValueError(f"attribute must be one of {', '.join(ATTRIBUTES)}, got {name!r}")
    query = Query(gaussians=gaussians, edits=edits, tools=tools, cameras=cameras, point=point)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return np.ascontiguousarray(ATTRIBUTES[name].values(query), np.float32)


def _position(axis: int) -> Callable[[Query], np.ndarray]:
    return lambda query: column(places_of(query.gaussians, query.edits), axis)


def _distance(query: Query) -> np.ndarray:
    return distances(places_of(query.gaussians, query.edits), query.point)


def _scales(query: Query) -> np.ndarray:
    return adjusted.log_scales(query.gaussians, query.edits)


def _middle_of(values: np.ndarray) -> np.ndarray:
    """(N, 3) -> (N,): neither the greatest nor the least."""
    x, y, z = values.T
    return np.maximum(np.minimum(x, y), np.minimum(np.maximum(x, y), z))


def _largest(query: Query) -> np.ndarray:
    x, y, z = _scales(query).T
    return np.exp(np.maximum(np.maximum(x, y), z))


def _smallest(query: Query) -> np.ndarray:
    x, y, z = _scales(query).T
    return np.exp(np.minimum(np.minimum(x, y), z))


def _volume(query: Query) -> np.ndarray:
    x, y, z = _scales(query).T
    return np.float32(4 / 3 * np.pi) * np.exp(x + y + z)


def _anisotropy(query: Query) -> np.ndarray:
    x, y, z = query.gaussians.log_scales.T
    return np.exp(np.maximum(np.maximum(x, y), z) - np.minimum(np.minimum(x, y), z))


def _elongation(query: Query) -> np.ndarray:
    x, y, z = query.gaussians.log_scales.T
    return np.exp(np.maximum(np.maximum(x, y), z) - _middle_of(query.gaussians.log_scales))


def _opacity(query: Query) -> np.ndarray:
    return adjusted.opacities(query.gaussians, query.edits)


def _colours(query: Query) -> np.ndarray:
    return adjusted.base_colours(query.gaussians, query.edits)


def _channel(channel: int) -> Callable[[Query], np.ndarray]:
    return lambda query: _colours(query)[:, channel]


def _luminance(query: Query) -> np.ndarray:
    return _colours(query) @ LUMINANCE


def _spread(query: Query) -> tuple[np.ndarray, ...]:
    """Red, green and blue as a display cuts them, their greatest, and greatest less least."""
    r, g, b = np.clip(_colours(query), 0, 1).T
    greatest = np.maximum(np.maximum(r, g), b)
    return r, g, b, greatest, greatest - np.minimum(np.minimum(r, g), b)


def _hue(query: Query) -> np.ndarray:
    r, g, b, greatest, spread = _spread(query)
    sector = np.where(
        greatest == r,
        (g - b) / spread % 6,
        np.where(greatest == g, (b - r) / spread + 2, (r - g) / spread + 4),
    )
    return np.where(spread > 0, sector * 60, np.where(spread == 0, 0, np.nan))


def _saturation(query: Query) -> np.ndarray:
    _, _, _, greatest, spread = _spread(query)
    return np.where(greatest == 0, 0, spread / greatest)


def _energy(query: Query) -> np.ndarray:
    return adjusted.sh_energies(query.gaussians, query.edits)


def _contribution(query: Query) -> np.ndarray:
    from ..sample_views import sample_cameras

    cameras = query.cameras or sample_cameras(query.gaussians, query.edits)
    return query.tools.contributions(query.gaussians, cameras, query.edits)


ATTRIBUTES: dict[str, Attribute] = {
    "x": Attribute(label="X", unit="world units", what="Position of the centre.", values=_position(0)),
    "y": Attribute(label="Y", unit="world units", what="Position of the centre.", values=_position(1)),
    "z": Attribute(label="Z", unit="world units", what="Position of the centre.", values=_position(2)),
    "distance": Attribute(
        label="Distance", unit="world units", what="From the centre to a point.", values=_distance
    ),
    "largest scale": Attribute(
        label="Largest scale",
        unit="world units",
        what="Standard deviation along the longest axis.",
        values=_largest,
        log=True,
    ),
    "smallest scale": Attribute(
        label="Smallest scale",
        unit="world units",
        what="Standard deviation along the shortest axis.",
        values=_smallest,
        log=True,
    ),
    "volume": Attribute(
        label="Volume",
        unit="cubic world units",
        what="Of the ellipsoid of one standard deviation.",
        values=_volume,
        log=True,
    ),
    "anisotropy": Attribute(
        label="Anisotropy",
        unit="ratio",
        what="Longest to shortest axis: high for discs and needles.",
        values=_anisotropy,
        log=True,
    ),
    "elongation": Attribute(
        label="Elongation",
        unit="ratio",
        what="Longest to middle axis: high for needles, 1 for round discs.",
        values=_elongation,
        log=True,
    ),
    "opacity": Attribute(label="Opacity", unit="0 to 1", what="At the centre.", values=_opacity),
    "red": Attribute(label="Red", unit="0 to 1", what="Of the colour from all sides.", values=_channel(0)),
    "green": Attribute(
        label="Green", unit="0 to 1", what="Of the colour from all sides.", values=_channel(1)
    ),
    "blue": Attribute(label="Blue", unit="0 to 1", what="Of the colour from all sides.", values=_channel(2)),
    "luminance": Attribute(label="Luminance", unit="0 to 1", what="How bright it looks.", values=_luminance),
    "hue": Attribute(label="Hue", unit="degrees", what="0 red, 120 green, 240 blue; greys 0.", values=_hue),
    "saturation": Attribute(
        label="Saturation", unit="0 to 1", what="0 for greys, 1 for pure colours.", values=_saturation
    ),
    "sh energy": Attribute(
        label="SH energy",
        unit="colour",
        what="How much the colour depends on where one looks from.",
        values=_energy,
    ),
    "contribution": Attribute(
        label="Contribution",
        unit="px",
        what="How much of the views it makes: alpha times the light that reaches it, summed over pixels.",
        values=_contribution,
        log=True,
        renders=True,
    ),
}
"""By the name that a recipe has."""
