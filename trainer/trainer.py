"""The training loop, one step at a time: draw a photo's view, compare, differentiate, move, refine.

Everything is numpy and the rasteriser's own backward pass; torch has no part in it.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from splatview.raster import Parameters, Workspace, available_threads, draw_frame
from splatview.raster.frame import StageClock
from splatview.raster.gradients import differentiate
from splatview.scene import Gaussians, InputError, RenderSettings
from splatview.scene.edits import Crop, cropped_in
from splatview.trainer.adam import adam_step
from splatview.trainer.distributed import Alone, BatchSum, Group
from splatview.trainer.exposure import Exposures
from splatview.trainer.loss import photo_loss
from splatview.trainer.settings import TrainSettings
from splatview.trainer.splats import Splats, comments_for, fresh
from splatview.trainer.strategies import STRATEGIES, Strategy
from splatview.trainer.strategies.ops import dropout
from splatview.trainer.views import TrainView, TrainViews

KEPT = ("seed", "strategy", "background", "model", "exposure")
"""Settings that a run keeps from its first step to its last."""

CUT_STEPS = 10
"""Steps after which what has moved to where the recipe cuts is taken out, if not refined sooner."""


class NothingSeen(InputError):
    """No photo shows any splat, so that nothing can be learnt."""


class StepReport(NamedTuple):
    """One step, as plots and progress bars want it."""

    iteration: int
    """Steps done, this one included."""
    loss: float
    gaussians: int
    progress: float
    """Share of the run that is over, 0 to 1."""


@dataclass
class Counters:
    """Where a run stands."""

    iteration: int = 0
    seconds: float = 0.0
    """Wall-clock time since the run began, pauses between resumed parts left out."""
    refined_at: int = 0
    """Step of the last refinement."""
    refined_progress: float = 0.0
    """Share of the run at the last refinement."""


class Trainer:
    """Trains splats on photos. `step` does all the work; the caller decides when, and in which thread.

    `threads` may be changed between steps.
    """

    def __init__(
        self,
        views: TrainViews,
        parameters: Parameters,
        extent: float,
        settings: TrainSettings,
        *,
        centre: np.ndarray | None = None,
        threads: int | None = None,
        group: Group | None = None,
    ) -> None:
        """`centre` (3,) float64: where the origin of views and parameters is in the world, see
        `Capture.centre`; snapshots, crops and regions are in the world.
        `group`: the processes that share each batch; every one of them has a trainer made alike."""
        if not 0 < extent < np.inf:
            raise ValueError(f"extent must be positive and finite, got {extent}")
        self.settings = settings
        self.views = views
        self.centre = np.zeros(3) if centre is None else centre
        self.extent = float(extent)
        self.threads = threads or available_threads()
        self.group: Group = group or Alone()
        self.splats: Splats = fresh(parameters)
        self.counters = Counters()
        self.clock = StageClock()
        """Milliseconds by stage since the start: those of the rasteriser, loss, adam, density."""
        _, strategy = STRATEGIES[settings.strategy]
        self.control: Strategy = strategy(self._local(settings), self.extent)
        self.control.begin(len(self.splats))
        self._unseen = 0.0
        """Photos that have shown no splat, as long as none has; NaN from the first that shows one on: later
        edits and rules may take out of sight what there is."""
        self.exposures = Exposures([view.camera.name for view in views.all], settings.exposure)
        self._workspace = Workspace()
        self.picture_dtype: type[np.floating] = np.float32
        """dtype of pictures and of what is differentiated through them; the scene itself is float32."""
        self.render_settings = RenderSettings(
            model=settings.model, background=settings.background, blend="float32"
        )

    @property
    def progress(self) -> float:
        """The share of the run that is over, 0 to 1."""
        return self.settings.progress(self.counters.iteration, self.counters.seconds)

    @property
    def done(self) -> bool:
        """Whether the run is over."""
        return self.progress >= 1

    def change(self, **settings: Any) -> None:
        """Changes fields of the recipe, between two steps.

        Raises:
            ValueError: a value makes no sense, or is one that a run keeps; nothing is changed.
        """
        for name in KEPT:
            if settings.get(name, getattr(self.settings, name)) != getattr(self.settings, name):
                raise ValueError(f"{name} cannot be changed in a run")
        self.settings = replace(self.settings, **settings)
        self.control.settings = self._local(self.settings)

    def _local(self, settings: TrainSettings) -> TrainSettings:
        """The settings with their regions relative to the centre."""
        return replace(settings, no_growth=self._about_centre(settings.no_growth))

    def _about_centre(self, crops: Sequence[Crop]) -> tuple[Crop, ...]:
        x, y, z = self.centre.tolist()
        return tuple(
            replace(crop, centre=(crop.centre[0] - x, crop.centre[1] - y, crop.centre[2] - z))
            for crop in crops
        )

    def delete(self, ids: np.ndarray) -> int:
        """Takes out the splats of these numbers, see `Splats.ids`; those that are gone already do not matter.

        Returns how many were taken out. Density control may fill the place again, and the number of splats
        up to its plan: see `add_region`. Of several processes each must be told the same.

        Raises:
            InputError: none would be left; nothing is changed.
        """
        return self._keep(~np.isin(self.splats.ids, ids))

    def crop(self, crops: Sequence[Crop]) -> int:
        """Takes out what the crops in force cut away, and returns how many that were. Raises as `delete`."""
        return self._keep(cropped_in(self._about_centre(crops), self.splats.parameters.means))

    def add_cut(self, crops: Sequence[Crop]) -> int:
        """As `crop`, and from now on what comes to where they cut is soon taken out too.

        The recipe's `cut` holds these rules, and `change` takes one out. They never take the last splats.
        """
        gone = self.crop(crops)
        self.change(cut=(*self.settings.cut, tuple(crops)))
        return gone

    def add_region(self, region: Crop) -> None:
        """From now on nothing grows inside the region; what is there is trained on, and may die or move away.

        The recipe's `no_growth` holds the regions, and `change` takes one out.
        """
        self.change(no_growth=(*self.settings.no_growth, region))

    def _keep(self, kept: np.ndarray) -> int:
        if not kept.any():
            raise InputError("no splat would be left to train; choose fewer")
        if not kept.all():
            self.splats = self.splats.take(kept)
            self.control.keep(kept)
        return int(len(kept) - kept.sum())

    def snapshot(self) -> Gaussians:
        """A copy of the scene as it stands, in the world, which later steps leave alone. Positions about a
        centre are float64."""
        comments = ("Trained by splatview", *comments_for(self.settings.model))
        scene = self.splats.snapshot(comments=comments)
        return replace(scene, means=scene.means + self.centre) if self.centre.any() else scene

    def step(self, seconds: float | None = None) -> StepReport:
        """One step of the recipe. `seconds`: wall-clock time of the run; None: the steps' own time.

        Raises:
            KeyboardInterrupt, PeerLost: see `Group.agreed`; the scene is as the last step left it.
            NothingSeen: all photos have been looked at, and the scene is in none of them.
        """
        begun = time.perf_counter()
        counters, settings = self.counters, self.settings
        counters.seconds = self.group.agreed(counters.seconds if seconds is None else seconds)
        progress = self.progress
        self.splats = self.splats.with_sh_degree(max(settings.sh_degree_at(progress), self.splats.sh_degree))
        splats = self.splats
        if self.exposures.is_due(progress):
            self.exposures.decide(
                splats.parameters,
                self.views.sized(settings.downscale_at(progress)),
                self.render_settings,
                self._workspace,
                self.threads,
            )
        gradients, visible, loss = self._batch_gradients(progress)
        self._unseen = math.nan if any(map(len, visible)) else self._unseen + settings.batch
        # Of so many in a row each photo is one: orders of the photos differ from round to round.
        if self._unseen >= 2 * len(self.views):
            raise NothingSeen(
                f"training has stopped, as none of its {len(self.views)} photos shows a splat; check that the"
                f" points of the capture lie before its cameras, {settings.model.near:g} units away at least"
            )

        counters.iteration += 1
        rates = settings.rates(progress, self.extent)
        with self.clock.stage("adam"):
            moved = visible if settings.visible_only else _everything(len(splats), len(visible))
            adam_step(
                splats,
                gradients,
                moved,
                rates,
                counters.iteration,
                regularisation=self.control.regularisation(progress, self.views.focal),
                max_aspect=settings.max_aspect,
                threads=self.threads,
            )
        if self.exposures.is_on:
            with self.clock.stage("exposure"):
                self.exposures.step(progress, settings.batch)
        with self.clock.stage("density"):
            self.control.after_step(splats, visible, rates.means, counters.iteration, self.threads)
            if progress < settings.refine_until and self._refinement_is_due(progress):
                rng = np.random.default_rng([settings.seed, counters.iteration, 1])
                self.splats = self.control.refine(splats, progress, rng)
                counters.refined_at, counters.refined_progress = counters.iteration, progress
            if counters.iteration % CUT_STEPS == 0 or counters.refined_at == counters.iteration:
                for crops in settings.cut:
                    # A run is not ended by the last splats' moving out: they stay until others are inside.
                    with contextlib.suppress(InputError):
                        self.crop(crops)
        if seconds is None:
            counters.seconds += time.perf_counter() - begun
        return StepReport(counters.iteration, loss, len(self.splats), self.progress)

    def _batch_gradients(self, progress: float) -> tuple[Parameters, list[np.ndarray], float]:
        """Mean gradients over the step's photos, the splats visible in them, and the mean loss."""
        settings, group = self.settings, self.group
        first, downscale = self.counters.iteration * settings.batch, settings.downscale_at(progress)
        mine = range(first + group.rank, first + settings.batch, group.size)
        observing = progress < settings.refine_until
        if settings.batch == 1:
            return self._render_and_backprop(self.views.at(first, downscale), observing, first)
        totals = self.control.totals() if observing and group.size > 1 else []
        before = [total.copy() for total in totals]
        batch = BatchSum(self.splats.parameters)
        for place in mine:
            looked = self._render_and_backprop(self.views.at(place, downscale), observing, place)
            with self.clock.stage("batch"):
                batch.add(*looked)
        with self.clock.stage("batch"):
            noted = [total - old for total, old in zip(totals, before, strict=True)]
            for total, old in zip(totals, before, strict=True):
                total[:] = old  # should another process be gone, this step has not happened
            group.add_up(noted)
            if self.exposures.is_on:
                group.add_up([self.exposures.gradients])
            result = batch.means(settings.batch, group, self.threads)
            for total, new in zip(totals, noted, strict=True):
                total += new
        return result

    def _render_and_backprop(
        self, view: TrainView, observing: bool, place: int = 0
    ) -> tuple[Parameters, list[np.ndarray], float]:
        """The gradients by one photo, the splats that reach into it, and its loss. `place`: how many photos
        have been looked at before."""
        parameters, share = self.splats.parameters, self.settings.dropout * self.progress
        if share > 0:
            with self.clock.stage("drop"):
                rng = np.random.default_rng([self.settings.seed, place, 2])
                parameters = dropout(parameters, share, rng)
        frame = draw_frame(
            parameters,
            view.camera,
            self.render_settings,
            self._workspace,
            dtype=self.picture_dtype,
            threads=self.threads,
        )
        image, exposures = frame.image, self.exposures
        with self.clock.stage("loss"):
            if exposures.is_on:
                image = exposures.applied(image, view, self._workspace)
            compared = photo_loss(
                image,
                view.pixels,
                self._workspace,
                mask=view.mask,
                ssim_weight=self.settings.ssim_weight,
                threads=self.threads,
            )
            if exposures.is_on:
                exposures.differentiate(frame.image, compared.d_image, view)
        gradients = differentiate(parameters, frame, compared.d_image)
        for name, milliseconds in (*frame.milliseconds.items(), *gradients.milliseconds.items()):
            self.clock.milliseconds[name] = self.clock.milliseconds.get(name, 0.0) + milliseconds
        visible = [frame.visible[start:stop] for start, stop in frame.runs]
        if observing:
            with self.clock.stage("density"):
                self.control.observe(frame, gradients, visible)
        found = gradients.parameters
        if self.picture_dtype is not np.float32:
            found = Parameters(*(array.astype(np.float32, copy=False) for array in found))
        return found, visible, compared.loss

    def _refinement_is_due(self, progress: float) -> bool:
        settings, counters = self.settings, self.counters
        return (
            progress >= settings.refine_from
            and progress - counters.refined_progress >= settings.refine_every
            and counters.iteration - counters.refined_at >= settings.least_refine_steps
        )


def _everything(count: int, pieces: int) -> list[np.ndarray]:
    return np.array_split(np.arange(count, dtype=np.int32), max(pieces, 1))
