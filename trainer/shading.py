"""Shading of photos: a coarse map of gains for each, for light that falls on what it alone shows.

Whoever takes photos stands in the light of some of them, clouds pass, and a camera's shutter or lens makes
one side darker. What a photo shows darker than all others do, a scene cannot be: it is told by splats before
that photo's camera, or by colours that depend on direction, and both are wrong from elsewhere. So the picture
of the scene is multiplied by the exponential of a smooth map before it is compared with its photo. Maps are
pulled to 0, as a scene that is right needs none, and their mean over photos and places is 0; that of each
photo is an exposure, and 0 where these are learnt beside maps.

Chosen by a minute of `miku 12 near`, three splits: 27.27 dB without, 27.78 with them; docs/training-recipe.md
has what judged that, and what was tried. Where many photos show each place others outvote a shadow: `miku`
(51 of 64) 30.77 and 30.65. Dropped: for objects that are cut out, too. `milk`, turned in the light of a
window, has 23.99 and 23.64 dB after one and three minutes, 24.16 and 23.81 with maps, and loses as much with
time.

Source: the idea is that of bilateral grids (Wang et al. 2024), by place alone and of one gain for all
colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from splatview.trainer.adam_kernels import PhotoAdam
from splatview.trainer.backdrop import ENOUGH_PHOTOS
from splatview.trainer.exposure import Evidence

CELLS = 6
"""Nodes of a map along each side of its photo."""

REACH, SETTLES = 1.0, 0.1
"""Of log gains: by how much all looks at a photo of a scene's training could move its map at the rate of the
start, and to what share of it the rate falls, exponentially. So maps of few looks move as far as those of
many."""

FEWEST_LOOKS = 20
"""At each photo, of which maps move as far as that; those of runs with fewer move less."""

BEGINS = 0.05
"""Share of a scene's training from which on maps are learnt: before, there is nothing to compare with."""

LEAST_DIFFERENCE = 0.013
"""Standard deviation of the photos' log gains, see `exposure.Evidence`, below which their light is the same.
A minute of `demo lens 40`, whose photos were rendered in one light (0.009), has 35.98 dB without maps and
35.78 with them, three splits (chosen); judged by `fern` (0.010), 25.06 both. A split of `miku 8 near` (0.009)
would gain: 27.82 and 28.30."""

PULL, SMOOTH = 1.0, 0.3
"""Weights of half the mean square of a map, and of half the sum of squares of the differences of its
neighbours over their number, beside the photo's loss."""


Mode = Literal["auto", "on", "off"]


def automatic_shading(everywhere: bool, shown: float) -> Mode:
    """Whether maps may be learnt, by whether photos show something everywhere, before no plain colour, and
    how many of them show a place, see `TrainViews.photos_of_a_place`."""
    return "auto" if everywhere and shown < ENOUGH_PHOTOS else "off"


class Shadings:
    """The maps of a run's photos. Nothing is computed where they are off."""

    def __init__(self, names: Sequence[str], mode: Mode) -> None:
        self.mode: Mode = mode
        self.is_on = mode == "on"
        self.maps = np.zeros((len(names), CELLS, CELLS))
        """(P, CELLS, CELLS): log gains of each photo at the nodes of its map, from its top left."""
        self.gradients = np.zeros_like(self.maps)
        """Of the photos' losses by the maps in this step, 0 for photos that are not part of it."""
        self._adam = PhotoAdam(self.maps.shape)
        self._rows = {name: row for row, name in enumerate(names)}

    def decide(self, evidence: Evidence | None) -> None:
        """Decides, where that goes by the photos, by how far they differ; None: nobody knows, and maps are
        learnt."""
        if self.mode == "auto":
            self.is_on = evidence is None or not evidence.spread < LEAST_DIFFERENCE

    def begins(self, progress: float) -> bool:
        """Whether maps are learnt at this share of a scene's training."""
        return self.is_on and progress >= BEGINS

    def row(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """A photo's rows (CELLS, CELLS) of `maps` and `gradients`, not copies."""
        return self.maps[self._rows[name]], self.gradients[self._rows[name]]

    def step(self, progress: float, rounds: float, *, exposed: bool = False) -> None:
        """One step of Adam for the photos that `gradients` names, at this share of a scene's training, in
        which each photo was looked at so often. `exposed`: whether exposures are learnt as well.

        A minute of `castle`, where they are, three splits, with maps of any mean, of means of 0, and without:
        16.78, 17.25 and 17.01 dB. Dropped: means of 0, too, where photos differ by less than four times what
        gains leave unexplained. Chosen on three minutes of `bust`, +0.74 dB (two splits); judged by a minute
        of `queen` -0.71 (three), `bust` -0.64, `miku 12 far` +0.40, `kermit` +0.20 (two each), `miku 20 far`
        -0.09 (three; shading_levels.json).
        """
        rows = np.flatnonzero((self.gradients != 0).any(axis=(1, 2)))
        if not len(rows):
            return
        maps = self.maps[rows]
        pulled = self.gradients[rows] + (PULL * maps + SMOOTH * laplacian(maps)) / CELLS**2
        rate = SETTLES**progress * REACH / max(rounds / progress, FEWEST_LOOKS)
        self.maps[rows] += self._adam.moves(rows, pulled, rate)
        # Brighter splats and lower gains look the same: the scene keeps the average light.
        self.maps -= self.maps.mean(axis=(1, 2) if exposed else None, keepdims=True)
        self.gradients[:] = 0

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes; none where maps are off."""
        return {"maps": self.maps, **self._adam.state()} if self.is_on else {}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where another's `state` was taken, of the same photos; where it has none, as in files from
        before there were maps, they are off. Raises KeyError, ValueError: it is damaged."""
        self.is_on = bool(state)
        if state:
            self._adam.restore(state)
            self.maps[:] = state["maps"]


def laplacian(maps: np.ndarray) -> np.ndarray:
    """(P, H, W): derivative of half the sum of squares of the differences of neighbours in each map."""
    out = np.zeros_like(maps)
    for axis in (1, 2):
        differences = np.diff(maps, axis=axis)
        none = np.zeros_like(np.take(maps, [0], axis=axis))
        out += np.concatenate([none, differences], axis) - np.concatenate([differences, none], axis)
    return out
