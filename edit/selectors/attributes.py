"""Attributes, numbers per splat of the edited scene: their values, histograms, and selection by their ranges
or by colour."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from splatview.edit.kernels import attributes as kernels
from splatview.edit.kernels.attributes import (
    LINEAR,
    column,
    distances,
    fill_bins,
    oklab,
    value_span,
    within_colour,
    within_range,
)
from splatview.edit.kernels.compiling import in_pieces
from splatview.edit.kernels.marks import Places, places_of
from splatview.edit.selectors.base import Query, at_least, choice, finite, store, vector
from splatview.edit.tools import Tools
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import IDENTITY_COLOUR, PALETTE_SHIFT, SceneEdits, adjustment_rows
from splatview.scene.progress import NO_PROGRESS, Progress


def _entries(edits: SceneEdits) -> np.ndarray:
    return edits.marks >> np.uint32(PALETTE_SHIFT)


def log_scales(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N, 3) float32, natural logarithm of standard deviations in world units."""
    factors = adjustment_rows(edits.palette)[:, 32]
    if (factors == 1).all():
        return gaussians.log_scales
    return gaussians.log_scales + np.log(factors).astype(np.float32)[_entries(edits), None]


def opacities(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N,) float32 in [0, 1]; NaN where the logit is."""
    values = np.empty(len(gaussians), np.float32)
    maps = adjustment_rows(edits.palette)[:, 28:32].astype(np.float32)

    def work(start: int, stop: int) -> None:
        kernels.opacities(start, stop, gaussians.opacity_logits, edits.marks, maps, values)

    in_pieces(len(values), work)
    return values


def _colour_maps(edits: SceneEdits) -> np.ndarray:
    """(P, 3, 4) float32."""
    return adjustment_rows(edits.palette)[:, 16:28].reshape(-1, 3, 4).astype(np.float32)


def base_colours(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N, 3) float32 RGB of the constant band, 0.5 + C0·sh0: the mean colour over all directions."""
    rgb = np.empty((len(gaussians), 3), np.float32)
    maps = _colour_maps(edits)

    def work(start: int, stop: int) -> None:
        kernels.base_colours(start, stop, gaussians.sh, edits.marks, maps, rgb)

    in_pieces(len(rgb), work)
    return rgb


def sh_energies(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N,) float32: root of the summed squares of all coefficients above the constant band.

    Turning a splat leaves it as it is.
    """
    higher = gaussians.sh[:, 1:]
    with np.errstate(over="ignore", invalid="ignore"):
        if all(adjustment.colour == IDENTITY_COLOUR for adjustment in edits.palette):
            flat = higher.reshape(len(higher), -1)
            return np.sqrt(np.einsum("nk,nk->n", flat, flat))
        maps, entries = _colour_maps(edits)[:, :, :3], _entries(edits)
        # The squared length of A·c is c·(AᵀA)·c: 3x3 numbers per splat, whatever the degree.
        moments = np.einsum("nki,nkj->nij", higher, higher)
        gram = np.einsum("pci,pcj->pij", maps, maps)
        return np.sqrt(np.maximum(np.einsum("nij,nij->n", moments, gram[entries]), 0))


LUMINANCE = np.array((0.2126, 0.7152, 0.0722), np.float32)
"""Luminance of red, green and blue (ITU-R BT.709)."""


@dataclass(frozen=True)
class Attribute:
    """One number per splat, as histograms show it and ranges select by it."""

    label: str
    unit: str
    what: str
    """One sentence for a tooltip."""
    values: Callable[[Query], np.ndarray]
    """(N,) float32."""
    log: bool = False
    """Whether its axis is logarithmic, as its values are positive and span decades."""
    renders: bool = False
    """Whether it renders views, which takes seconds."""


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


def _places(query: Query) -> Places:
    return places_of(query.gaussians, query.edits)


def _log_scales(query: Query) -> np.ndarray:
    return log_scales(query.gaussians, query.edits).T


def _longest(axes: np.ndarray) -> np.ndarray:
    x, y, z = axes
    return np.maximum(np.maximum(x, y), z)


def _shortest(axes: np.ndarray) -> np.ndarray:
    x, y, z = axes
    return np.minimum(np.minimum(x, y), z)


def _volume(query: Query) -> np.ndarray:
    x, y, z = _log_scales(query)
    return np.float32(4 / 3 * np.pi) * np.exp(x + y + z)


def _anisotropy(query: Query) -> np.ndarray:
    axes = query.gaussians.log_scales.T  # adjustments scale all axes alike
    return np.exp(_longest(axes) - _shortest(axes))


def _elongation(query: Query) -> np.ndarray:
    x, y, z = axes = query.gaussians.log_scales.T
    middle = np.maximum(np.minimum(x, y), np.minimum(np.maximum(x, y), z))
    return np.exp(_longest(axes) - middle)


def _colours(query: Query) -> np.ndarray:
    return base_colours(query.gaussians, query.edits)


def _spread(query: Query) -> tuple[np.ndarray, ...]:
    """Red, green and blue clipped to [0, 1], their greatest, and greatest less least."""
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


def _contribution(query: Query) -> np.ndarray:
    from splatview.edit.sample_views import sample_cameras

    cameras = query.cameras or sample_cameras(query.gaussians, query.edits)
    return query.tools.contributions(query.gaussians, cameras, query.edits)


ATTRIBUTES: dict[str, Attribute] = {
    "x": Attribute("X", "world units", "Position of the centre.", lambda query: column(_places(query), 0)),
    "y": Attribute("Y", "world units", "Position of the centre.", lambda query: column(_places(query), 1)),
    "z": Attribute("Z", "world units", "Position of the centre.", lambda query: column(_places(query), 2)),
    "distance": Attribute(
        "Distance",
        "world units",
        "From the centre to a point.",
        lambda query: distances(_places(query), query.point),
    ),
    "largest scale": Attribute(
        "Largest scale",
        "world units",
        "Standard deviation along the longest axis.",
        lambda query: np.exp(_longest(_log_scales(query))),
        log=True,
    ),
    "smallest scale": Attribute(
        "Smallest scale",
        "world units",
        "Standard deviation along the shortest axis.",
        lambda query: np.exp(_shortest(_log_scales(query))),
        log=True,
    ),
    "volume": Attribute(
        "Volume", "cubic world units", "Of the ellipsoid of one standard deviation.", _volume, log=True
    ),
    "anisotropy": Attribute(
        "Anisotropy", "ratio", "Longest to shortest axis: high for discs and needles.", _anisotropy, log=True
    ),
    "elongation": Attribute(
        "Elongation",
        "ratio",
        "Longest to middle axis: high for needles, 1 for round discs.",
        _elongation,
        log=True,
    ),
    "opacity": Attribute(
        "Opacity", "0 to 1", "At the centre.", lambda query: opacities(query.gaussians, query.edits)
    ),
    "red": Attribute("Red", "0 to 1", "Of the colour from all sides.", lambda query: _colours(query)[:, 0]),
    "green": Attribute(
        "Green", "0 to 1", "Of the colour from all sides.", lambda query: _colours(query)[:, 1]
    ),
    "blue": Attribute("Blue", "0 to 1", "Of the colour from all sides.", lambda query: _colours(query)[:, 2]),
    "luminance": Attribute(
        "Luminance", "0 to 1", "How bright it looks.", lambda query: _colours(query) @ LUMINANCE
    ),
    "hue": Attribute("Hue", "degrees", "0 red, 120 green, 240 blue; greys 0.", _hue),
    "saturation": Attribute("Saturation", "0 to 1", "0 for greys, 1 for pure colours.", _saturation),
    "sh energy": Attribute(
        "SH energy",
        "colour",
        "How much the colour depends on where one looks from.",
        lambda query: sh_energies(query.gaussians, query.edits),
    ),
    "contribution": Attribute(
        "Contribution",
        "px",
        "Its share of the views: alpha times transmittance, summed over pixels.",
        _contribution,
        log=True,
        renders=True,
    ),
}
"""Attributes by their names in recipes."""


@dataclass(frozen=True, kw_only=True)
class AttributeRange:
    """Splats with low <= value <= high; a value of NaN is in no range."""

    attribute: str
    """A name in ATTRIBUTES."""
    low: float | None = None
    """None: no lower end."""
    high: float | None = None
    """None: no upper end."""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World units: origin of "distance"."""
    cameras: tuple[Camera, ...] = ()
    """Views that "contribution" is measured in; none: sample views."""

    def __post_init__(self) -> None:
        choice("attribute", self.attribute, ATTRIBUTES)
        low = None if self.low is None else finite("low", self.low)
        high = None if self.high is None else finite("high", self.high)
        if low is not None and high is not None and not low <= high:
            raise ValueError(f"low must not be above high, got {self.low} and {self.high}")
        store(self, low=low, high=high, point=vector("point", self.point))
        if not all(isinstance(camera, Camera) for camera in self.cameras):
            raise ValueError("cameras must be a list of cameras")
        store(self, cameras=tuple(self.cameras))

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        progress.step(0.0)
        values = attribute_values(
            self.attribute, gaussians, edits, tools, cameras=self.cameras, point=self.point
        )
        mask = self.of(values)
        progress.step(1.0)
        return mask

    def of(self, values: np.ndarray) -> np.ndarray:
        """`mask` for known `values` (N,) float32: while a range is being dragged."""
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        mask = np.empty(len(values), bool)
        in_pieces(len(values), lambda start, stop: within_range(start, stop, values, low, high, mask))
        return mask


MOST_BINS = 1 << 16


@dataclass(frozen=True, eq=False, kw_only=True)
class Histogram:
    """Numbers of splats by value."""

    edges: np.ndarray
    """(bins + 1,) float64, ascending; evenly spaced, or their logarithms are."""
    counts: np.ndarray
    """(bins,) int64."""
    outside: int
    """Number of splats in no bin: NaN, infinite, beyond the span, or not positive on a logarithmic axis."""
    log: bool


def histogram(
    values: np.ndarray,
    mask: np.ndarray | None = None,
    *,
    bins: int = 128,
    log: bool = False,
    span: tuple[float, float] | None = None,
) -> Histogram:
    """Histogram of `values` (N,) float32 of the splats in `mask` (N,) bool; None: all.

    `span` is the least and greatest value shown, above 0 with `log`; None: those of the values. The ends are
    the values themselves, to the bit.

    Raises:
        ValueError: `bins` or `span` make no sense; the message names them.
    """
    if not 1 <= bins <= MOST_BINS:
        raise ValueError(f"bins must be 1 to {MOST_BINS}, got {bins}")
    mask = np.ones(len(values), bool) if mask is None else mask
    if span is None:
        low, high = value_span(values, mask, log)
        if not low <= high:
            low, high = (1.0, 10.0) if log else (0.0, 1.0)
    else:
        low, high = float(span[0]), float(span[1])
        if not (np.isfinite(low) and np.isfinite(high) and low <= high and (low > 0 or not log)):
            raise ValueError(f"span must be two finite numbers, ascending, above 0 if log, got {span}")
    counts = np.zeros(bins, np.int64)
    outside = int(fill_bins(values, mask, low, high, log, counts))
    edges = np.geomspace(low, high, bins + 1) if log else np.linspace(low, high, bins + 1)
    edges[0], edges[-1] = low, high
    return Histogram(edges=edges, counts=counts, outside=outside, log=log)


def usual_span(
    values: np.ndarray, mask: np.ndarray | None = None, *, share: float = 0.999
) -> tuple[float, float]:
    """The span of the middle `share` of the finite values: the initial span of a plot, as a few splats are
    nearly always far off. (0, 1) where there are none."""
    sample = values if mask is None else values[mask]
    sample = sample[:: max(1, len(sample) // 200_000)]
    sample = sample[np.isfinite(sample)]
    if not len(sample):
        return 0.0, 1.0
    low, high = np.quantile(sample, [(1 - share) / 2, (1 + share) / 2])
    return float(low), float(high)


TOLERANCE = 0.08
"""Distance in Oklab of a just different shade, black to white being 1. Equal distances there look about
equally different whatever the hue and however dark; in plain RGB one tolerance takes all dark greens at once
and splits one bright wall."""


@dataclass(frozen=True, kw_only=True)
class SimilarColour:
    """Splats with a colour of the constant band, clipped to [0, 1], similar to `rgb`."""

    rgb: tuple[float, float, float]
    """Display colour, usually 0 to 1."""
    tolerance: float = TOLERANCE
    """At least 0: distance in Oklab, black to white being 1."""

    def __post_init__(self) -> None:
        store(self, rgb=vector("rgb", self.rgb), tolerance=at_least("tolerance", self.tolerance, 0))

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        return similar(base_colours(gaussians, edits), self.rgb, self.tolerance, progress)


def similar(
    colours: np.ndarray, rgb: tuple[float, float, float], tolerance: float, progress: Progress = NO_PROGRESS
) -> np.ndarray:
    """Whether each of `colours` (N, 3) float32 is within `tolerance` of `rgb`: (N,) bool; NaN is not."""
    seed = np.empty((1, 3), np.float32)
    oklab(0, 1, np.array([rgb], np.float32), LINEAR, seed)
    mask = np.empty(len(colours), bool)
    lab = np.empty((len(colours), 3), np.float32)

    def work(start: int, stop: int) -> None:
        oklab(start, stop, colours, LINEAR, lab)
        within_colour(start, stop, lab, seed[0], np.float32(tolerance), mask)

    in_pieces(len(colours), work, progress=progress)
    return mask
