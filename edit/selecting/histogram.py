"""How the values of an attribute are spread, for drawing and for dragging a range on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..loops.measures import fill_bins, value_span

MOST_BINS = 1 << 16


@dataclass(frozen=True, eq=False, kw_only=True)
class Histogram:
    """Counts by value."""

    edges: np.ndarray
    """(bins + 1,) float64, ascending; evenly spaced, or their logarithms are."""
    counts: np.ndarray
    """(bins,) int64."""
    outside: int
    """Of the splats asked for, those that are in no bin: NaN, infinite, beyond the span, not positive on a
    logarithmic axis."""
    log: bool


def histogram(
    values: np.ndarray,
    mask: np.ndarray | None = None,
    *,
    bins: int = 128,
    log: bool = False,
    span: tuple[float, float] | None = None,
) -> Histogram:
    """Of `values` (N,) float32, those in `mask` (N,) bool; None: all.

    `span` is the least and greatest value shown; None: those that there are. `log` wants it above 0.
    The ends are the values themselves, to the bit.

    Raises:
        ValueError: `bins` or `span` make no sense; the message names them.
    """
    if not 1 <= bins <= MOST_BINS:
        raise ValueError(f"bins must be 1 to {MOST_BINS}, got {bins}")
    chosen = np.ones(len(values), bool) if mask is None else mask
    if span is None:
        low, high = value_span(values, chosen, log)
        if not low <= high:
            low, high = (1.0, 10.0) if log else (0.0, 1.0)
    else:
        low, high = float(span[0]), float(span[1])
        if not (np.isfinite(low) and np.isfinite(high) and low <= high and (low > 0 or not log)):
            raise ValueError(f"span must be two finite numbers, ascending, above 0 if log, got {span}")
    counts = np.zeros(bins, np.int64)
    outside = int(fill_bins(values, chosen, low, high, log, counts))
    edges = np.geomspace(low, high, bins + 1) if log else np.linspace(low, high, bins + 1)
    edges[0], edges[-1] = low, high
    return Histogram(edges=edges, counts=counts, outside=outside, log=log)


def usual_span(
    values: np.ndarray, mask: np.ndarray | None = None, *, share: float = 0.999
) -> tuple[float, float]:
    """The span that holds the middle `share` of the finite values: what a plot opens at, as a few splats
    are nearly always far off. (0, 1) where there are none."""
    chosen = values if mask is None else values[mask]
    chosen = chosen[:: max(1, len(chosen) // 200_000)]
    chosen = chosen[np.isfinite(chosen)]
    if not len(chosen):
        return 0.0, 1.0
    low, high = np.quantile(chosen, [(1 - share) / 2, (1 + share) / 2])
    return float(low), float(high)
