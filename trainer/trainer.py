"""The training loop, one step at a time: draw a photo's view, compare, differentiate, move, refine."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import torch

from splatview.raster import EARLY_STOP, Parameters, Workspace, available_threads
from splatview.raster.frame import StageClock
from splatview.scene import Gaussians, InputError, RenderSettings
from splatview.trainer.adam import SelectiveAdam
from splatview.trainer.backdrop import standing_in, surround_of_a_step
from splatview.trainer.counters import Counters, NothingSeen, StepReport
from splatview.trainer.distributed import Alone, BatchSum, Group
from splatview.trainer.editing import Editing
from splatview.trainer.exposure import Exposures
from splatview.trainer.free_space import (
    FEW_OF,
    LOOK_STEPS,
    MOST_CHANGED,
    clear,
    passing,
    past_free_space,
    shown_by_few,
    worth_keeping,
)
from splatview.trainer.functional import Visibility, dropout, expose, followed, photo_loss, rasterize, shade
from splatview.trainer.initialisation import comments_for
from splatview.trainer.outliers import Outliers
from splatview.trainer.plugin import LossPlugin, LossStep, SplatTensors
from splatview.trainer.progressive import ProgressiveResolution, mean_difference
from splatview.trainer.recipe import GROWTH_BATCH_FROM
from splatview.trainer.settings import TrainSettings
from splatview.trainer.shading import Shadings
from splatview.trainer.sky import Sky, hold, restore
from splatview.trainer.splats import Splats, copied
from splatview.trainer.strategies import STRATEGIES, Strategy
from splatview.trainer.strategies.mcmc import ease_of_faint, need_of_reg
from splatview.trainer.strategies.ops import State, raise_sh_degree
from splatview.trainer.transients import Transients, agreed, find_transients
from splatview.trainer.views import TrainView, TrainViews
from splatview.trainer.withheld import Withheld

LOSS_SHARE = 0.01
"""Of a step in the running mean of the photo loss."""

CLEAR_STEPS = 4
"""Steps of which one looks for splats before its photo's camera, and for wide ones: in each, 2 % of time."""


class Trainer(Editing):
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
        loss: LossPlugin | None = None,
        sky: Sky | None = None,
    ) -> None:
        """`centre` (3,) float64: where the origin of views and parameters is in the world, see
        `Capture.centre`; snapshots, crops and regions are in the world.
        `group`: the processes that share each batch; every one of them has a trainer made alike.
        `sky`: what was decided about it; its splats are the last of `parameters`."""
        if not 0 < extent < np.inf:
            raise ValueError(f"extent must be positive and finite, got {extent}")
        self.settings = settings
        self.most_splats = math.inf
        """Splats that the run has memory for, see `memory`: `max_splats` cannot be raised above."""
        self.views = views
        self.centre = np.zeros(3) if centre is None else centre
        self.extent = float(extent)
        self.threads = threads or available_threads()
        self.group: Group = group or Alone()
        self.loss = loss
        """Loss of the user's, which takes the place of the photo loss."""
        self.splats = Splats(copied(parameters))
        self.optimizer = SelectiveAdam(self.splats, settings.rates(0.0, self.extent))
        self.counters = Counters()
        self.first, self.begun = 0, 0.0
        """Steps and seconds before the present scene: where a run trains several, see `ensemble`."""
        self.first_photo = 0
        """Photos that were looked at before it."""
        self.members: list[Parameters] = []
        """Scenes that are whole, where it trains several."""
        self.edited = False
        """Whether someone's edit has ended that."""
        self.taught: TrainViews | None = None
        """Pictures of these that the present scene learns from besides."""
        self.clock = StageClock()
        """Milliseconds by stage since the start: those of the rasteriser, loss, autograd, adam, density."""
        _, strategy = STRATEGIES[settings.strategy]
        self.strategy: Strategy = strategy(self._local(settings))
        self.state: State = self.strategy.initialize_state(self.splats, extent=self.extent, focal=views.focal)
        """What the strategy notes, and in "sky", where there is one, which splats are its: see `sky.hold`."""
        self.sky = sky
        """What was decided about a sky; None where nobody looked for one, as in a run that was resumed."""
        if sky is not None and sky.count:
            self.state["sky"] = sky.flags(len(self.splats))
        self._rows = {view.camera.name: row for row, view in enumerate(views.all)}
        self.nearest_depths = np.zeros(len(views))
        """(V,) depth at which what each photo shows begins, see `free_space`; 0 where it is not known."""
        self._differences: list[float] = []
        """Of this step's pictures to their photos, while these are small."""
        self._unseen = 0.0
        """Photos that have shown no splat, until one does; then NaN, for edits may take it out of sight."""
        self.exposures = Exposures([view.camera.name for view in views.all], settings.exposure)
        self.shadings = Shadings([view.camera.name for view in views.all], settings.shading)
        self.passed: int | None = None
        """Splats of one photo alone that went as the run ended, see `free_space`; None: nobody has looked."""
        self.outliers = Outliers([view.camera.name for view in views.all], settings.outliers)
        self.transients = Transients([view.camera.name for view in views.all], settings.transients)
        steps = settings.shorter[0] if settings.shorter else math.inf
        self.withheld = Withheld(len(views), settings.withheld, settings.seed, steps)
        """Photos that tell whether several scenes are trained, see `ensemble`."""
        self.mask()
        self.resolution = ProgressiveResolution(views)
        """Size of the photos, where the recipe leaves it to evidence."""
        self.picture_dtype: type[np.floating] = np.float32
        """dtype of pictures and of what is differentiated through them; the scene itself is float32."""
        self.render_settings = RenderSettings(
            model=settings.model, background=settings.surround or settings.background, blend="float32"
        )

    @property
    def scene_progress(self) -> float:
        """The share of the scene's training that is over, 0 to 1, by which the recipe goes."""
        steps, seconds = self.counters.iteration - self.first, self.counters.seconds
        return self.settings.progress(steps, seconds, self.begun or self.counters.prepared)

    @property
    def progress(self) -> float:
        """The share of the run that is over, 0 to 1."""
        return self.scene_progress

    @property
    def scene(self) -> Splats:
        """What the run has come to."""
        return self.splats

    @property
    def shown_settings(self) -> RenderSettings:
        """Those that other cameras than the photos' show the scene by, see `free_space`."""
        return past_free_space(self.render_settings, self.settings.free_space * self.nearest_depths)

    @property
    def downscale(self) -> int:
        """The factor by which photos are smaller in the next step."""
        progress, schedule = self.scene_progress, self.settings.resolution
        if schedule is None:
            return self.resolution.factor_at(progress)
        return next((factor for until, factor in schedule if progress < until), 1)

    @property
    def done(self) -> bool:
        """Whether the run is over."""
        return self.scene_progress >= 1

    def snapshot(self) -> Gaussians:
        """A copy of the scene as it stands, in the world, which later steps leave alone. Positions about a
        centre are float64."""
        comments = ("Trained by splatview", *comments_for(self.shown_settings.model))
        scene = self.scene.snapshot(comments=comments)
        return replace(scene, means=scene.means + self.centre) if self.centre.any() else scene

    def step(self, seconds: float | None = None) -> StepReport:
        """One step of the recipe. `seconds`: wall-clock time of the run; None: the steps' own time.

        Raises:
            KeyboardInterrupt, PeerLost: see `Group.agreed`; the scene is as the last step left it.
            NothingSeen: all photos have been looked at, and the scene is in none of them.
            PluginError: the user's loss failed; the scene is as the last step left it.
        """
        begun = time.perf_counter()
        counters, settings, clock = self.counters, self.settings, self.clock
        splats, optimizer = self.splats, self.optimizer
        counters.seconds = self.group.agreed(counters.seconds if seconds is None else seconds)
        if counters.iteration == 0:
            counters.prepared = counters.seconds
        progress = self.scene_progress
        raise_sh_degree(splats, optimizer, max(settings.sh_degree_at(progress), splats.sh_degree))
        self._decide_outliers(progress)
        self._decide_transients(progress)
        self._decide_exposures(progress)
        self._decide_batch(progress)

        optimizer.zero_grad()  # first, for a step that failed may have left some
        optimizer.threads, optimizer.rates = self.threads, settings.rates(progress, self.extent)
        optimizer.set_options("means", far_from=settings.far_from_at(progress))
        optimizer.set_options("log_scales", max_aspect=settings.max_aspect / self.need_of_reg)
        optimizer.set_options("sh", rest_divisor=settings.sh_divisor)
        places = range(counters.photos, counters.photos + self.batch)
        info, loss = self._backward(places, progress)
        self._check_seen(info, len(places))
        self._leave_frozen(info)
        counters.iteration, counters.photos = counters.iteration + 1, places.stop
        held = hold(splats.arrays, self.state)
        with clock.stage("adam"):
            optimizer.step(info.pieces if settings.visible_only else self._all_learning())
        if self.exposures.is_on:
            with clock.stage("exposure"):
                self.exposures.step(progress, len(places))
        with clock.stage("shading"):
            self.shadings.step(progress, self._rounds, exposed=self.exposures.is_on)
        with clock.stage("density"):
            self._clear_free_space(info, places)
            self.strategy.step_post_backward(
                splats, optimizer, self.state, counters.iteration, info, progress=progress
            )
            restore(splats.arrays, self.state, held)
            self._cut()
            self._drop_unseen(progress)
            self._drop_passing()
        self._note_loss(loss)
        self._end_step()
        if seconds is None:
            counters.seconds += time.perf_counter() - begun
        return StepReport(counters.iteration, loss, len(splats), self.progress)

    def _backward(self, places: range, progress: float) -> tuple[Visibility, float]:
        """Leaves the mean gradients over the step's photos in the parameters; what the photos show, and the
        mean loss. `places`: how many photos were looked at before each of them."""
        downscale = self.downscale
        sums, before = self.strategy.sums(self.state), []
        if self.group.size > 1 or self.loss is not None:
            before = [total.copy() for total in sums]
        try:
            if len(places) == 1:
                found = self._render_and_backprop(self._view_at(places.start, downscale), places.start)
            else:
                found = self._batch_backward(places, downscale, sums, before)
            self._note_differences()
            return found
        except BaseException:  # another process is gone, or the user's loss failed: nothing has been noted
            for total, old in zip(sums, before, strict=False):
                total[:] = old
            self.exposures.gradients[:] = self.shadings.gradients[:] = 0
            self._differences = []
            raise

    def _batch_backward(
        self, places: range, downscale: int, sums: list[np.ndarray], before: list[np.ndarray]
    ) -> tuple[Visibility, float]:
        """The same for a batch of photos, of which each process takes its share. `sums`: of the strategy, and
        what they were before, where there are several processes."""
        group, batch = self.group, BatchSum(self.splats.parameters())
        for place in places[group.rank :: group.size]:
            info, loss = self._render_and_backprop(self._view_at(place, downscale), place)
            with self.clock.stage("batch"):
                batch.add(info.pieces, loss)
        with self.clock.stage("batch"):
            if group.size > 1:
                noted = [total - old for total, old in zip(sums, before, strict=True)]
                group.add_up(noted)
                for total, old, new in zip(sums, before, noted, strict=True):
                    total[:] = old + new
            group.add_up([by.gradients for by in (self.exposures, self.shadings) if by.is_on])
            pieces, loss = batch.means(len(places), group, self.threads)
        return Visibility(pieces, len(self.splats)), loss

    def _view_at(self, place: int, factor: int = 1) -> TrainView:
        """What a step looks at, by how many were looked at before."""
        return self.views.at(place, factor)

    def _render_and_backprop(self, view: TrainView, place: int = 0) -> tuple[Visibility, float]:
        """Adds the gradients by one photo to the parameters'; what the photo shows, and its loss. `place`:
        how many photos have been looked at before."""
        splats, settings, clock = SplatTensors(*self.splats.parameters()), self.settings, self.clock
        progress, drawn_as = self.scene_progress, self.render_settings
        logits, share = splats.opacity_logits, settings.dropout * self.need_of_reg * progress
        if share > 0:
            with clock.stage("drop"):
                logits = dropout(logits, share, np.random.default_rng([settings.seed, place, 2]))
                if "sky" in self.state:
                    is_sky = torch.from_numpy(self.state["sky"] > 0)
                    logits = torch.where(is_sky, splats.opacity_logits, logits)
        behind, is_photo = None, view.camera.name in self._rows
        if settings.surround is not None:
            drawn = surround_of_a_step(settings.surround, (settings.seed, place, 3))
            behind = torch.from_numpy(drawn.astype(self.picture_dtype))
            view = view if is_photo else standing_in(view, settings.surround, drawn)
        image, info = rasterize(
            *splats._replace(opacity_logits=logits),
            view.camera,
            drawn_as,
            background=behind,
            early_stop=EARLY_STOP if drawn_as.early_stop is None else drawn_as.early_stop,
            dtype=torch.float32 if self.picture_dtype is np.float32 else torch.float64,
            by_view=self.strategy.by_view,
            threads=self.threads,
        )
        if self.shadings.begins(progress) and is_photo:
            with clock.stage("shading"):
                image = shade(image, followed(*self.shadings.row(view.camera.name)), self.threads)
        if self.exposures.is_on and is_photo:
            with clock.stage("exposure"):
                cut_out = None if view.alpha is None else settings.background
                image = expose(image, followed(*self.exposures.row(view.camera.name)), cut_out, self.threads)
        photo = torch.from_numpy(view.pixels)
        mask = None if view.mask is None else torch.from_numpy(view.mask)
        alpha = None if view.alpha is None else torch.from_numpy(view.alpha)

        def usual_loss() -> torch.Tensor:
            with clock.stage("loss"):
                return photo_loss(
                    image,
                    photo,
                    mask=mask,
                    alpha=alpha,
                    alpha_known=view.alpha_known,
                    ssim_weight=settings.ssim_weight,
                    alpha_weight=settings.alpha_weight,
                    threads=self.threads,
                )

        number = self.counters.iteration + 1
        self.strategy.step_pre_backward(
            self.splats, self.optimizer, self.state, number, info, progress=progress
        )
        if self.loss is None:
            loss = usual_loss()
            loss.backward()
        else:
            step = LossStep(
                image=image,
                photo=photo,
                mask=mask,
                camera=view.camera,
                splats=splats,
                iteration=number,
                progress=progress,
                settings=drawn_as,
                photo_loss=usual_loss,
                threads=self.threads,
                check=self.loss.hooks(number),
            )
            with clock.stage("plugin"):
                loss = self.loss(step)
            self.loss.backward(loss, number)
            if step.depth_visibility is not None:  # it shows splats that dropout takes out of the picture
                info.include(step.depth_visibility)
        if self.settings.resolution is None and self.downscale > 1:
            with clock.stage("resolution"):
                shown = image.detach().numpy()
                self._differences.append(mean_difference(shown, view.pixels, view.mask))
        for name, milliseconds in info.milliseconds.items():
            clock.milliseconds[name] = clock.milliseconds.get(name, 0.0) + milliseconds
        return info, loss.item()

    def _note_differences(self) -> None:
        """What the step's photos, those of all processes, say about the size to train in."""
        differences, self._differences = self._differences, []
        if self.settings.resolution is None and self.downscale > 1:
            total = np.array([math.fsum(differences), len(differences)])
            self.group.add_up([total])
            self.resolution.note(total[0] / total[1], int(total[1]))

    def _note_loss(self, loss: float) -> None:
        """Takes the photo loss of a step into its running mean, by which regularisers are eased."""
        if self.loss is None and 0 < loss < math.inf:
            mean = self.state.get("photo_loss", loss)
            self.state["photo_loss"] = mean + LOSS_SHARE * (loss - mean)

    @property
    def need_of_reg(self) -> float:
        """See `strategies.mcmc.need_of_reg`."""
        return need_of_reg(self.state.get("photo_loss", 0.0), self.settings.full_reg_loss)

    @property
    def ease_of_faint(self) -> float:
        """See `strategies.mcmc.ease_of_faint`."""
        return ease_of_faint(self.state.get("median_opacity", math.inf), self.settings.full_reg_opacity)

    @property
    def _rounds(self) -> float:
        """How often each photo has been looked at for the present scene."""
        return (self.counters.photos - self.first_photo) / len(self.views)

    @property
    def batch(self) -> int:
        """Photos that the next step looks at: more while splats grow, where that was decided."""
        grows = self.scene_progress < self.settings.refine_until
        return int(self.state.get("growth_batch", 0) if grows else 0) or self.settings.batch

    def _decide_batch(self, progress: float) -> None:
        """Whether steps look at `TrainSettings.growth_batch` photos, once."""
        settings, state = self.settings, self.state
        if settings.growth_batch <= settings.batch or "growth_batch" in state or self.loss is not None:
            return
        if progress >= GROWTH_BATCH_FROM:
            loss = state["growth_by"] = state.get("photo_loss", 0.0)
            state["growth_batch"] = settings.growth_batch if loss > settings.growth_loss else settings.batch

    def leave_out(self, rows: np.ndarray) -> None:
        """From now on these photos, (P,) bool, are not trained on, and all others are.

        Raises:
            InputError: none would be left; nothing is changed.
        """
        if rows.all():
            raise InputError("no photo would be left to train on")
        self.outliers.left_out = rows
        self._take_photos()

    def _take_photos(self) -> None:
        """Steps look at all photos but those that are left out."""
        self.views.take(~self.outliers.left_out)

    def _decide_outliers(self, progress: float) -> None:
        outliers = self.outliers
        if outliers.is_due(progress, self._rounds):
            with self.clock.stage("outliers"):
                arrays, workspace = self.splats.arrays, Workspace()
                wrong = outliers.measure(
                    arrays, self.views.all, self.render_settings, workspace, self.threads
                )
            self.group.add_up([wrong])  # processes must agree, to the last photo
            outliers.decide(wrong > self.group.size / 2)
            self.leave_out(outliers.left_out)
        elif outliers.is_missed(progress):
            outliers.is_decided = True

    def mask(self) -> None:
        """From now on steps take photos without what the others contradict."""
        self.views.withhold(self.transients.blocks(self.views.all))

    def _decide_transients(self, progress: float) -> None:
        if not self.transients.is_due(progress, self._rounds):
            return
        with self.clock.stage("transients"):
            scene = self.splats.arrays, self.views.all, ~self.outliers.left_out
            found = find_transients(*scene, self.render_settings, self.threads)
        self.transients.decide(agreed(found, self.group))
        self.mask()

    @property
    def places(self) -> np.ndarray:
        """(N, 3): means but those of a sky, which is not the same from all sides, nor behind each of its
        splats."""
        means = self.splats.arrays.means
        return means[self.state["sky"] == 0] if "sky" in self.state else means

    def _decide_exposures(self, progress: float) -> None:
        if self.exposures.is_due(progress, self._rounds):
            scene = self.splats.arrays, self.views.sized(self.downscale), self.render_settings
            self.exposures.decide(*scene, Workspace(), self.threads, self.places)

    def _check_seen(self, info: Visibility, photos: int) -> None:
        """Raises NothingSeen where a round of photos has shown nothing."""
        self._unseen = math.nan if len(info) else self._unseen + photos
        # Of so many in a row each photo is one: orders of the photos differ from round to round.
        if self._unseen >= 2 * len(self.views):
            raise NothingSeen(
                f"training has stopped, as none of its {len(self.views)} photos shows a splat; check that the"
                f" points of the capture lie before its cameras, {self.settings.model.near:g} units away at"
                " least"
            )

    def _leave_frozen(self, info: Visibility) -> None:
        """Takes those splats out of what a step moves that few photos can show, once they have learnt long
        enough. See `free_space`."""
        settings = self.settings
        if not settings.few_views or not self._rounds >= settings.few_views_rounds:
            return
        taken = self.views.taken
        if len(taken) <= FEW_OF * settings.few_views:
            return
        iteration = self.counters.iteration
        if "frozen" not in self.state or iteration % LOOK_STEPS == 0 or self.state["refined_at"] == iteration:
            cameras = [view.camera for view in taken]
            frozen = shown_by_few(self.splats.arrays.means, cameras, settings.few_views)
            self.state["frozen"] = frozen & (self.state["sky"] == 0) if "sky" in self.state else frozen
        info.pieces = [piece[~self.state["frozen"][piece]] for piece in info.pieces]

    @property
    def frozen(self) -> int | None:
        """Splats that learn no more; None: nobody has looked."""
        return int(self.state["frozen"].sum()) if "frozen" in self.state else None

    def _all_learning(self) -> list[np.ndarray] | None:
        """Indices of the splats that are not frozen, in a list; None: of all."""
        return [np.flatnonzero(~self.state["frozen"]).astype(np.int32)] if "frozen" in self.state else None

    def _clear_free_space(self, info: Visibility, places: range) -> None:
        """Makes invisible what stands before the cameras of the step's photos, nearer than what they show,
        and shortens what is too long to be told from a veil. See `free_space`."""
        settings = self.settings
        if self.counters.iteration % CLEAR_STEPS:
            return
        for view in map(self._view_at, places):
            depth = settings.free_space * self._nearest_depth(view)
            near = 0.0 if view.camera.name in self._rows else self.shown_settings.model.near
            scene = self.splats.arrays, info.pieces, view.camera
            clear(*scene, depth, settings.max_size, self.threads, near=near)

    def _nearest_depth(self, view: TrainView) -> float | np.ndarray:
        """At which what a view shows begins: one depth, or (h, w) by blocks; 0 where it is not known."""
        row = self._rows.get(view.camera.name)
        return 0.0 if row is None else float(self.nearest_depths[row])

    def _drop_unseen(self, progress: float) -> None:
        """Takes out what no photo shows when density control ends, and as the run does, but for the sky's."""
        settings = self.settings
        ended = progress >= settings.refine_until
        if self.scene_progress >= 1 or (ended and not self.state.get("unseen_dropped")):
            kept = worth_keeping(
                self.splats.snapshot(),
                self.views.taken + ([] if self.taught is None else self.taught.all),
                self.render_settings,
                least_shown=settings.least_shown,
                least_visibility=settings.least_visibility,
                # Half-way, what changes by it is learnt anew.
                most_changed=MOST_CHANGED if self.scene_progress >= 1 else math.inf,
                threads=self.threads,
            )
            if "sky" in self.state:
                kept |= self.state["sky"] > 0
            if kept.any():
                self._keep(kept)
        self.state["unseen_dropped"] = int(ended)

    def _drop_passing(self) -> None:
        """Takes out what one photo alone shows before what others do, at the end of the run; but for the sky.
        Until then it explains what no other splat should. See `free_space`."""
        settings = self.settings
        if self.scene_progress >= 1 and settings.most_of_one < 1 and self.need_of_reg == 1:
            wrong = passing(
                self.splats.snapshot(),
                self.views.taken,
                self.render_settings,
                most_of_one=settings.most_of_one,
                stays=self.state["sky"] > 0 if "sky" in self.state else None,
                threads=self.threads,
            )
            self.passed = int(wrong.sum())
            if self.passed:
                self._keep(~wrong)

    def _end_step(self) -> None:
        """What is due when a step is over."""

    def scenes_state(self) -> dict[str, np.ndarray]:
        """Arrays by name of scenes before this one, for checkpoints."""
        return {}
