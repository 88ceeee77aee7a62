"""Photos of different exposure: a gain and an offset for each photo and colour, learnt beside the scene.

The scene is drawn, gain·x + offset is compared to the photo, and both are trained by Adam; what is saved is
the scene at the photos' average exposure. Only captures whose photos differ need this, so it is decided by
evidence, at an early moment of the run while splats have one colour from all sides (later, higher SH bands
have learnt the differences as if surfaces shone): for each photo the gain that fits the scene best by least
squares, and how sure it is by its scatter over 16 parts of the photo. How far gains differ must be beyond
what surfaces do that look brighter from one side, and beyond that scatter.

A held-out photo has an exposure too, which nobody has trained. Where the correction is on it is measured
after a fit by least squares: the left half with the gain and offset of the right half, and the right half
with those of the left (after the practice of Martin-Brualla et al. 2021, NeRF in the Wild, who fit on the
left half and measure the right). No pixel is measured by a fit that has seen it. Where the correction is
off, pictures are measured as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import RenderSettings
from splatview.trainer.adam_kernels import BETA1, BETA2
from splatview.trainer.views import TrainView

Mode = Literal["auto", "on", "off"]

DECIDED_AT, DECIDED_BY = 1 / 30, 0.1
"""Shares of the run: the first, once photos were looked at `LEAST_ROUNDS` times; the second in any case."""

LEAST_ROUNDS = 4
"""Before, photos seem to differ as the scene is not there yet: those of `banana` at full size by 0.10, 0.07,
0.05 and 0.04 after 1, 2, 3 and 4 rounds, where those of one with drifting exposure do by 0.17 to 0.14."""

LEAST_SPREAD = 0.08
"""Standard deviation of log gains. Of captures that looked equally bright, `banana` has 0.02 (known to 0.007)
and `miku` 0.06 (known to 0.03), where views along the way differ by their shadows."""

LEAST_CERTAINTY = 3.0
"""Standard errors."""

PARTS = 4
"""A photo is cut into so many rows and columns of parts for the standard error."""

MOST_PHOTOS = 64
"""Photos looked at for the decision: spread over all."""

RATE, RATE_END = 1.5e-2, 1e-3
"""Of log gains and offsets at the start and the end of the run, exponentially in between."""

LARGEST_LOG_GAIN = 1.5
"""Fits beyond a factor of 4.5 are those of pictures that show nothing yet."""


class Evidence(NamedTuple):
    """What speaks for correcting exposures."""

    spread: float
    """Standard deviation of the photos' log gains, root mean square over colours."""
    error: float
    """Median standard error of one."""

    @property
    def calls_for_correction(self) -> bool:
        return self.spread > max(LEAST_SPREAD, LEAST_CERTAINTY * self.error)

    def __str__(self) -> str:
        return f"photos differ in exposure by {self.spread:.0%} (known to {self.error:.1%})"


@dataclass(eq=False)
class Exposures:
    """The exposures of a run's photos. Nothing is computed where it is off."""

    names: Sequence[str]
    """Names of the photos, by camera."""
    mode: Mode = "auto"
    is_decided: bool = False
    is_on: bool = False
    evidence: Evidence | None = None
    """Evidence of the decision, where it was made by that in this process."""

    def __post_init__(self) -> None:
        shape = (len(self.names), 3, 2)
        self.table = np.zeros(shape)
        """(P, 3, 2): log gain and offset of each photo and colour; their means over photos are 0."""
        self.gradients = np.zeros(shape)
        """Of the loss by the table in this step, 0 for photos that are not part of it."""
        self._first, self._second = np.zeros(shape), np.zeros(shape)
        self._visits = np.zeros(len(self.names), np.int64)
        self._rows = {name: row for row, name in enumerate(self.names)}

    def is_due(self, progress: float, rounds: float) -> bool:
        """Whether it is to be decided now, at this share of the run and after so many looks at each photo."""
        if self.mode == "off" or self.is_decided:
            return False
        return progress >= (DECIDED_AT if rounds >= LEAST_ROUNDS else DECIDED_BY)

    def decide(
        self,
        parameters: Parameters,
        views: Sequence[TrainView],
        settings: RenderSettings,
        workspace: Workspace,
        threads: int,
    ) -> None:
        """Compares photos, one for each name and in any size, to the scene as it stands."""

        def picture(view: TrainView) -> np.ndarray:
            return draw_frame(parameters, view.camera, settings, workspace, threads=threads).image[..., :3]

        self.is_decided, self.is_on = True, self.mode == "on"
        if self.mode == "auto":
            some = views[:: -(-len(views) // MOST_PHOTOS)]
            self.evidence = measured_evidence([log_gain(picture(view), view) for view in some])
            self.is_on = self.evidence.calls_for_correction
        if self.is_on:
            for row, view in enumerate(views):
                self.table[row, :, 0] = np.nan_to_num(log_gain(picture(view), view)[0])
            self.table -= self.table.mean(axis=0)

    def of(self, name: str) -> np.ndarray:
        """(3, 2): log gain and offset of a photo's colours, see `functional.expose`."""
        return self.table[self._rows[name]]

    def add_gradient(self, name: str, gradient: np.ndarray) -> None:
        """Adds the gradient (3, 2) of a photo's row to `gradients`."""
        self.gradients[self._rows[name]] += gradient

    def step(self, progress: float, batch: int) -> None:
        """One step of Adam for the photos that `gradients`, sums over a batch of so many, name."""
        rows = np.flatnonzero((self.gradients != 0).any(axis=(1, 2)))
        rate = RATE * (RATE_END / RATE) ** progress
        g = self.gradients[rows] / batch
        self._visits[rows] += 1
        visits = self._visits[rows, None, None]
        m = self._first[rows] = BETA1 * self._first[rows] + (1 - BETA1) * g
        v = self._second[rows] = BETA2 * self._second[rows] + (1 - BETA2) * g * g
        m, v = m / (1 - BETA1**visits), v / (1 - BETA2**visits)
        self.table[rows] -= rate * m / (np.sqrt(v) + 1e-15)
        # Brighter splats and lower gains look the same: the scene keeps the average exposure.
        self.table -= self.table.mean(axis=0)
        self.gradients[:] = 0

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes."""
        return {
            "decision": np.array([self.is_decided, self.is_on]),
            "table": self.table,
            "first": self._first,
            "second": self._second,
            "visits": self._visits,
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where another's `state` was taken, of the same photos."""
        self.is_decided, self.is_on = (bool(value) for value in state["decision"])
        for ours, name in zip(
            (self.table, self._first, self._second, self._visits),
            ("table", "first", "second", "visits"),
            strict=True,
        ):
            ours[:] = state[name]


def log_gain(picture: np.ndarray, view: TrainView) -> np.ndarray:
    """Of the gain that takes a picture (H, W, 3) nearest to its photo: (1 + PARTS², 3), first that of the
    whole, then those of its parts; NaN where a part shows nothing."""
    pictures = picture.astype(np.float64)
    photo = view.pixels / 255.0
    if view.mask is not None:
        pictures[~view.mask] = photo[~view.mask] = 0
    over, under = pictures * photo, pictures * pictures
    rows, columns = (np.arange(PARTS) * size // PARTS for size in picture.shape[:2])
    parts = [
        np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1).reshape(-1, 3)
        for values in (over, under)
    ]
    sums = [np.concatenate([values.sum(axis=0, keepdims=True), values]) for values in parts]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(sums[0] / sums[1])
    return np.where(np.abs(logs) < LARGEST_LOG_GAIN, logs, np.nan)


def measured_evidence(gains: Sequence[np.ndarray]) -> Evidence:
    """Of some photos' `log_gain`; photos that show nothing are left out."""
    usable = [logs for logs in gains if np.isfinite(logs[0]).all() and np.isfinite(logs[1:]).sum() >= 6 * 3]
    if len(usable) < 2:
        return Evidence(0.0, np.inf)
    spread = np.std([logs[0] for logs in usable], axis=0)
    parts = np.array([logs[1:] for logs in usable])
    error = np.nanstd(parts, axis=1) / np.sqrt(np.isfinite(parts).sum(axis=1))
    return Evidence(float(np.sqrt((spread**2).mean())), float(np.median(error)))


def fitted(
    picture: np.ndarray, photo: np.ndarray, mask: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Gain (3,) and offset (3,) that take a picture (H, W, 3) nearest to a photo (H, W, 3) uint8, by least
    squares over the pixels of the mask (H, W); 1 and 0 for a colour that is the same all over."""
    use = np.ones(photo.shape[:2], np.bool_) if mask is None else mask
    x, y = picture[use].astype(np.float64), photo[use] / 255.0
    if len(x) == 0:
        return np.ones(3), np.zeros(3)
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    variance = ((x - mean_x) ** 2).mean(axis=0)
    covariance = ((x - mean_x) * (y - mean_y)).mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.clip(covariance / variance, np.exp(-LARGEST_LOG_GAIN), np.exp(LARGEST_LOG_GAIN))
    flat = ~(variance > 1e-12)
    gain = np.where(flat, 1.0, gain)
    return gain, np.where(flat, 0.0, mean_y - gain * mean_x)


def fitted_by_halves(picture: np.ndarray, view: TrainView) -> np.ndarray:
    """The picture (H, W, 3) with each half at the exposure that fits the other half best."""
    middle = picture.shape[1] // 2
    halves = slice(None, middle), slice(middle, None)
    out = np.empty_like(picture)
    for here, there in (halves, halves[::-1]):
        mask = None if view.mask is None else view.mask[:, there]
        gain, offset = fitted(picture[:, there], view.pixels[:, there], mask)
        out[:, here] = picture[:, here] * gain.astype(picture.dtype) + offset.astype(picture.dtype)
    return out
