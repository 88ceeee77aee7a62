"""Withheld blocks: a part of every photo that a run does without at first, to see whether it still learns
what photos agree on, or only each photo by heart.

Squares of each photo, drawn by the run's seed, are masked. Other photos show most of these places, so that
the scene there is what it has learnt from them: while it learns the scene its error falls, and when it learns
leaves that wind has moved, it rises, however well all else is met. It is measured over all photos and at the
same places again and again, which tells more than a photo or two that are withheld as a whole. A coarse stage
ends when the error rises; and when it is higher in full size than it was, the run settles: photos agree about
no more than it has learnt. From `GIVEN_BACK` of the run on photos are whole.

Nothing is withheld unless that is asked for. Three minutes of the bench with 0.06, three splits each (two
of `castle`; withheld.json): `wood wind 18`, whose leaves move from photo to photo, gains 1.0 dB; captures
of 6 to 12 far photos lose more often than they gain, `castle` 0.0, `toy` 0.1, `bust` and `beach` 0.15 and
`kermit` 1.6 (0.7 without a split in which chance makes 4 dB). One split each of more photos (20 to 37):
`statue` +0.34, `train front 30` -0.07, `fox` -0.08, `demo hard 40` -0.16, `mouse` -0.32, `demo lens 40`
-0.41, `miku 40 far` -0.51. The factors and `SETTLED` were chosen on
`beach`, `kermit` and `bust`, one split each. Whole photos that are withheld tell less: see
`recipe.automatic_steps`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import RenderSettings
from splatview.trainer.views import TrainView

BLOCK = 32
"""px, side of a square."""

CHECK_ROUNDS = 20
"""Photos are looked at so often between two measurements, each of which takes a third of a step per photo."""

GIVEN_BACK = 0.45
"""Share of the run from which on photos are whole."""

COARSE_RISE, FULL_RISE = 10 ** (0.05 / 10), 10 ** (0.2 / 10)
"""Factors by which the mean squared error must be above its least for a coarse stage to end, and for a run to
settle."""

SETTLED = 0.75
"""Share of the run that is over as it begins to settle."""


class Withheld:
    """The blocks of a run's photos, and what they have told."""

    def __init__(self, views: Sequence[TrainView], share: float, seed: int) -> None:
        rng = np.random.default_rng([seed, len(views), 5])
        self.blocks: list[np.ndarray] = []
        """(H, W) bool for each photo, true where it is withheld."""
        for view in views if share > 0 else ():
            rows, columns = (math.ceil(side / BLOCK) for side in view.pixels.shape[:2])
            chosen = np.zeros(rows * columns, np.bool_)
            chosen[rng.permutation(rows * columns)[: max(round(share * rows * columns), 1)]] = True
            blocks = chosen.reshape(rows, columns).repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)
            self.blocks.append(blocks[: view.pixels.shape[0], : view.pixels.shape[1]])
        self.given_back = not self.blocks
        self.least = math.inf
        """The least error so far."""
        self.coarse_is_over = False
        """Whether photos are trained in full size from here on, whatever the recipe's share."""
        self.checks_in_full = -1
        """Measurements in full size, but for the first; -1 before."""
        self.settled_at = 0
        """Step at which the run began to settle; 0: it did not."""

    def is_due(self, looked: int, batch: int) -> bool:
        """Whether it is time to measure, after steps of `batch` photos each have looked at so many."""
        every = CHECK_ROUNDS * max(len(self.blocks), 1)
        return not self.given_back and looked >= every and looked % every < batch

    def error(
        self,
        parameters: Parameters,
        views: Sequence[TrainView],
        settings: RenderSettings,
        exposure_of: Callable[[str], np.ndarray] | None,
        threads: int,
    ) -> float:
        """Mean squared difference, 0 to 1, of the scene to the photos where they are withheld, in full size;
        NaN where masks leave nothing. `exposure_of`: see `Exposures.of`; None: as the scene is."""
        workspace, total, count = Workspace(), 0.0, 0
        for view, blocks in zip(views, self.blocks, strict=True):
            shown = blocks if view.mask is None else blocks & view.mask
            drawn = draw_frame(parameters, view.camera, settings, workspace, threads=threads).image[shown, :3]
            if exposure_of is not None:
                log_gain, offset = exposure_of(view.camera.name).T
                drawn = drawn * np.exp(log_gain) + offset
            difference = np.clip(drawn, 0, 1) - view.pixels[shown] / 255
            total += float((difference * difference).sum())
            count += difference.size
        return total / count if count else math.nan

    def teaches(self, error: float, factor: int) -> bool:
        """Whether photos, smaller by a factor, still teach what they agree on, by the error now. In full size
        the first measurement says nothing: the scene has hardly been trained in it."""
        least, self.least = self.least, min(self.least, error)
        if factor == 1:
            self.checks_in_full += 1
            return self.checks_in_full < 1 or not error > FULL_RISE * least
        return not error > COARSE_RISE * least

    def look(
        self, progress: float, step: int, looked: tuple[int, int], factor: int, error: Callable[[], float]
    ) -> Literal["whole", "settle"] | None:
        """Before a step, at a share of the run and with photos smaller by a factor: whether photos are whole
        from here on, and whether the run is to settle besides, as full size teaches no more. Measures the
        `error` now and then, and ends the coarse stage when it becomes worse. `looked`: photos that were
        looked at before, and those of a step."""
        if self.given_back:
            return None
        if progress >= GIVEN_BACK:
            self.given_back = True
            return "whole"
        if not self.is_due(*looked) or self.teaches(error(), factor):
            return None
        if factor > 1:
            self.coarse_is_over = True
            return None
        self.settled_at, self.given_back = step, True
        return "settle"

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes."""
        flags = self.given_back, self.coarse_is_over, self.checks_in_full, self.settled_at, self.least
        return {"withheld": np.array(flags, np.float64)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from the `state` of another run of the same photos. Raises ValueError: it is none."""
        values = state["withheld"]
        if values.shape != (5,) or np.isnan(values).any():
            raise ValueError("what it has learnt from withheld blocks is damaged")
        self.given_back, self.coarse_is_over = bool(values[0]), bool(values[1])
        self.checks_in_full, self.settled_at, self.least = int(values[2]), int(values[3]), float(values[4])
