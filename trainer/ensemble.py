"""Several scenes of the same few photos, and a last one that learns from what they have in common.

Few photos leave much to chance: equal runs in another order of the photos differ by 0.2 to 0.6 dB in
held-out photos, and the mean of their pictures is better than any of them, for what each has learnt by heart
is not alike. Such a run is also over long before its minutes are. So, where there is time, it begins anew, up
to `recipe.MEMBERS` times, and then once more with photos and with pictures: the mean of what the scenes
before show between the photos' cameras (ensembles: Lakshminarayanan et al. 2017, distillation: Hinton et al.
2015). So many pictures need no rules for few photos. Until the last scene is whole, the first one is the
run's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import Camera, RenderSettings
from splatview.scene.camera_path import exponential, matrix_of, quaternion, slerp
from splatview.scene.edits import Crop
from splatview.trainer.distributed import Group
from splatview.trainer.free_space import nearest_by_blocks
from splatview.trainer.functional import Visibility, rasterize_depth
from splatview.trainer.plugin import LossPlugin
from splatview.trainer.progressive import ProgressiveResolution
from splatview.trainer.recipe import (
    FEWEST_TO_GO_ON,
    LEAST_SCENES,
    LEAST_SHORTER,
    pictures_taught,
    scenes_tried,
)
from splatview.trainer.settings import TrainSettings
from splatview.trainer.splats import Splats, copied
from splatview.trainer.strategies.mcmc import LEAST_REG
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews
from splatview.trainer.withheld import WITHHELD_UNTIL

TAUGHT_SHARE = 0.8
"""Of the last scene's steps, that look at pictures of the others; the rest look at photos. Split 0 of `miku
12 far`, three scenes of which have 24.55 dB and the mean of their pictures 25.03, has 25.09 with 0.5 and
25.27 with 0.8. Dropped: twice as many steps for it, 20.28 in place of 20.55 on split 1, 18.24 and 18.23 on
`kermit`, 21.04 and 21.10 on `toy` (means of their three scenes: 20.29, 17.87 and 20.30).

With maps of light, three minutes and splits, 0.5 has 18.63 dB in place of 18.11 on `bust`, 28.02 of 27.87 on
`miku 12 near`, 21.62 of 21.89 on `miku 12 far`, on which 0.8 was chosen: kept, as none of it is sure. Nor is
it with free space before pictures, by the same scenes before: 0.5, 0.8 and 1 have 18.91, 18.46 and 18.76 dB
on `bust`, 18.58, 18.58 and 18.52 on `kermit` (three splits each, fog.json).

Dropped, too: each of the scenes before from half of the first splats, drawn anew, so that they differ more.
Splits 1 and 2 of `miku 12 far` have 21.01 and 19.52 dB in place of 20.96 and 19.32 (three seeds each, which
differ by 0.6 and 0.9), split 0 of `miku 12 near` 31.10 in place of 31.09."""

NEIGHBOURS = 3
"""Cameras of pictures are on the ways from a photo to one of so many that are nearest to it."""

BEYOND, ASIDE = 0.15, 0.15
"""By how much of such a way they go on at both ends, and stand aside of it (standard deviation, of the way
to the nearest photo); their direction differs by a fifth of the second, in radians."""

LEAST_PHOTOS = 3
"""Between fewer there are no ways to speak of."""

SPARE = 1.1
"""Factor of what scenes are thought to take: the last one must be whole when the minutes are over. Where
there is too little time for a second scene and the last one, but enough for `LEAST_SHORTER` of them, both end
sooner. In 2.6 times what a scene takes, three splits each, one scene and two with a last one: `miku 12 far`
21.29 and 21.67 dB, `toy` 21.66 and 21.76, `miku 12 near` 27.37 and 27.28."""

OF_STUDENT = {"opacity_reg": LEAST_REG, "scale_reg": LEAST_REG, "dropout": 0.0, "max_aspect": math.inf}
"""Settings of the last scene, those of many photos, where nobody has asked for others. With those of few,
split 0 of `miku 12 near` has 31.25 dB and an SSIM of 0.935 in place of 31.50 and 0.940."""

GOES_ON_AT = 0.5
"""Where photos were withheld (`withheld`), the last scene goes on from the one before it, with all that it
has learnt, at this share of a scene, when density control has ended, and until the minutes are over. Anew,
as where photos are few, `skull RGBA 100` has 31.82 dB in place of 32.91 after three minutes, `mug` 29.59 of
29.95, `cat` (split 2) 35.53 of 35.57; where photos are few, `miku 12 far` has 25.23 and 20.84 anew, 25.00 and
20.45 so, `miku 20 far` 23.89 and 26.75, 23.42 and 26.83 (splits 0 and 1)."""

MET_AT = 0.6
"""Share of the first scene at which it is decided whether `shorter` ones follow: then the loss of photos that
can be met well is below `met_loss`, and the end has not begun.

Dropped: three scenes and a last one, of 80 to 100 steps per photo each, in one minute: the splits of `miku
12 far` 23.88, 20.50 and 19.84 dB in place of 24.44, 20.74 and 18.69 (means of three runs), two of `kermit`
17.96 and 15.79 in place of 18.07 and 16.29. Two and a last one, of 1,000 steps each, three splits: `miku 12
far` +0.58 dB, `kermit` +0.49, but `miku 12 near` -0.44 and `toy` -0.84. With maps of light, and only where
cameras stand 23 to 65 degrees apart as seen from the scene: `miku 12 far` +0.45, `kermit` +0.41, but, judged
so, `miku 8 far` -0.44 and `bust` -1.27. Dropped, too, on `miku 12 far`, which has 21.31 by one scene: two on
photos half as large and a last one, 21.15; three on photos a quarter as large, and pictures so small, 20.21
(assets/benchmarks/shorter.json)."""


FOG_OF_ONE_IN = 4
"""Scenes of which one may show something nearer, as fog of its own, before a picture taught. Of two or three
none may: by the farther of two depths `castle` loses 0.27 dB (`free_space.nearest_by_blocks`).

Chosen on `miku 8 far`, which six to eight teach: last scenes by the same ones, eleven of three splits, have
19.90 dB without free space before pictures taught, 19.73 by the least depth, 19.91 by a quantile of a
quarter, between two depths (SSIM 0.703, 0.701 and 0.708; 0.4 dB of each are chance); six of them 20.24,
20.06, 20.14, and by the middle depth 20.19. By a whole number of scenes, as here: generalisation.json."""


class EnsembleTrainer(Trainer):
    """A trainer of several scenes, one after the other."""

    is_short = False
    """Whether scenes end as `settings.shorter` says, where it says something."""

    def __init__(self, views: TrainViews, parameters: Parameters, *args: Any, **kwargs: Any) -> None:
        """As of `Trainer`, which does without what trains several: one process, and the photo loss."""
        super().__init__(views, parameters, *args, **kwargs)
        self.is_short = not self.settings.withheld > 0
        self.strategy.settings = self._local(self.settings)
        self.initial, self.initial_sky = copied(parameters), self._sky()
        """What each scene begins with, and which splats of it are a sky's."""
        self.finished: Splats | None = None
        """The first scene that is whole, while others are trained, of which the last alone is better."""
        self.finished_sky = np.empty(0)
        """Which splats of it are a sky's."""
        self.is_last = not self.settings.trains_several
        """Whether no scene follows the present one."""
        self.is_short_decided = False
        """Whether it is certain that scenes end as `settings.shorter` says, or that they do not."""
        self.goes_on = False
        """Whether the last scene is in training, and goes on from the one before it, see `GOES_ON_AT`."""
        self.taught_depths: dict[str, np.ndarray] = {}
        """(h, w) by the name of a picture taught: where what most scenes show of it begins, by blocks."""
        self.asked: set[str] = set()
        """Names of settings that somebody has chosen, which the last scene has too."""

    @property
    def scene_progress(self) -> float:
        counters, settings = self.counters, self.settings
        if self.goes_on and self.learns_by_heart:
            left = 60 * (settings.minutes or 0.0) - self.begun
            over = min(max((counters.seconds - self.begun) / max(left, 1e-9), 0.0), 1.0)
            return GOES_ON_AT + (1 - GOES_ON_AT) * over
        steps, begun = counters.iteration - self.first, self.begun or counters.prepared
        share = settings.progress(steps, counters.seconds, begun, shorter=self.is_short)
        end, lengths = 60 * (settings.minutes or 0.0), []
        if self.is_short and settings.shorter and settings.minutes and self.taught is None:
            lengths.append((end - counters.prepared) / self._least_scenes)
        if self.members and self.taught is None and not self.is_last:
            lengths.append((end - begun) / ((1 + self._length_of_last) * SPARE))
        for length in lengths:
            share = max(share, min((counters.seconds - begun) / max(length, 1e-9), 1.0))
        return share

    @property
    def progress(self) -> float:
        """The share of the run that is over, 0 to 1: of as many scenes as there seems to be time for, or,
        where the minutes end the last one, of these."""
        if self.done:
            return 1.0
        if self.learns_by_heart:
            counters, end = self.counters, 60 * (self.settings.minutes or 0.0)
            return min((counters.seconds - counters.prepared) / max(end - counters.prepared, 1e-9), 1.0)
        if self.is_last:
            return (len(self.members) + self.scene_progress) / (len(self.members) + 1)
        return min((len(self.members) + self.scene_progress) / self._scenes_in_all(), 1.0)

    @property
    def scene(self) -> Splats:
        """The splats in training, or the scene that is whole, while others are trained."""
        return self.splats if self.finished is None else self.finished

    @property
    def done(self) -> bool:
        return super().done and self.is_last

    def change(self, **settings: Any) -> None:
        """As of `Trainer`. Who changes how many steps or splats there are means each of the scenes."""
        self.asked |= settings.keys()
        if "iterations" in settings:
            settings = {"shorter": None} | settings
        elif "max_splats" in settings and self.settings.shorter is not None:
            settings = {"shorter": (self.settings.shorter[0], settings["max_splats"])} | settings
        super().change(**settings)
        if self.settings.shorter is None and self.withheld.is_watching:  # nothing is to be decided any more
            self.withheld.give_back()
            self._take_photos()

    def _local(self, settings: TrainSettings) -> TrainSettings:
        if self.is_short and settings.shorter is not None:
            settings = replace(settings, max_splats=min(settings.max_splats, settings.shorter[1]))
        return super()._local(settings)

    def delete(self, ids: np.ndarray) -> int:
        self._edit()
        return super().delete(ids)

    def crop(self, crops: Sequence[Crop]) -> int:
        self._edit()
        return super().crop(crops)

    def _edit(self) -> None:
        self.edited = self.edited or not self.is_last or self.finished is not None
        self._stay()

    def _stay(self) -> None:
        """The scene that is shown is the last one, and whole if it was: there is no time for another, or
        someone edits it."""
        self.is_last = True
        if self.finished is not None:
            self._put(self.finished.arrays, self.finished.ids, self.finished_sky)
            self.finished = self.taught = None
            shorter = self.settings.shorter if self.is_short else None
            steps = shorter[0] if shorter else self.settings.iterations or 0
            self.first = self.counters.iteration - steps
            self.first_photo = self.counters.photos - steps * self.settings.batch
        elif not self.members:  # an edit of the first one, which takes its time
            self._take(short=False)
        else:  # of the last one, which goes on: pictures of the others would bring back what has gone
            self.taught = None

    @property
    def learns_by_heart(self) -> bool:
        """Whether scenes end as `settings.shorter` says, as photos that were withheld have shown."""
        return self.is_short and self.settings.shorter is not None and self.settings.withheld > 0

    @property
    def lets_go_on(self) -> bool:
        """Whether the last scene goes on from the one before it, see `GOES_ON_AT`."""
        return self.learns_by_heart and len(self.views.all) >= FEWEST_TO_GO_ON

    @property
    def batch(self) -> int:
        """Photos that the next step looks at: one where scenes are short, which have few steps."""
        return 1 if self.learns_by_heart else super().batch

    def _decide_outliers(self, progress: float) -> None:
        super()._decide_outliers(progress)
        undecided = any(one.mode == "auto" and not one.is_decided for one in (self.outliers, self.transients))
        if not self.is_short_decided and self.withheld.is_due(progress, undecided=undecided):
            with self.clock.stage("withheld"):
                self.withheld.begin(*self._compared(), self.outliers.left_out, self.threads)
            self._take_photos()

    def _compared(self) -> tuple[Parameters, Sequence[TrainView], RenderSettings]:
        return self.splats.arrays, self.views.all, self.render_settings

    def _take_photos(self) -> None:
        rows = self.outliers.left_out | self.withheld.rows
        if rows.all():
            self.withheld.give_back()
            rows = self.outliers.left_out
        self.views.take(~rows)

    def _view_at(self, place: int, factor: int = 1) -> TrainView:
        if self.taught is not None:
            rng = np.random.default_rng([self.settings.seed, place, 4])
            if rng.random() < TAUGHT_SHARE:
                return self.taught.sized(factor)[rng.integers(len(self.taught))]
        return super()._view_at(place, factor)

    def _leave_frozen(self, info: Visibility) -> None:
        if self.taught is None:
            super()._leave_frozen(info)

    def _end_step(self) -> None:
        """Begins another scene, where one is whole and there is time."""
        if self.is_last:
            if self.done:
                self.finished = self.taught = None
            return
        decided_at = WITHHELD_UNTIL if self.settings.withheld > 0 else MET_AT
        if not self.is_short_decided and self.scene_progress >= decided_at:
            self._decide_short()
        if self.scene_progress < 1:
            return
        self.members.append(copied(self.splats.arrays))
        several = len(self.views.taken) >= LEAST_PHOTOS
        two = 1 + self._length_of_last
        if len(self.members) == 1:
            two *= LEAST_SHORTER
        another = several and len(self.members) < self.settings.ensemble and self._has_time_for(two)
        self.is_last = not another
        least = LEAST_SHORTER * self._length_of_last
        if not another and (len(self.members) < 2 or not self._has_time_for(least)):
            self._stay()
            return
        if self.finished is None:
            self.finished = Splats(copied(self.splats.arrays), self.splats.ids)
            self.finished_sky = self._sky()
        if not another:
            self._teach()
            super().change(**{name: value for name, value in OF_STUDENT.items() if name not in self.asked})
        self.first, self.begun = self.counters.iteration, self.counters.seconds
        self.first_photo = self.counters.photos
        self.passed = None
        if self.lets_go_on and self.is_last:
            self.goes_on, self.finished = True, None  # it is whole all along, so that it is shown
            return
        ids = self.splats.new_ids(len(self.initial.means))
        self._put(copied(self.initial), ids, self.initial_sky)
        self.resolution = ProgressiveResolution(self.views)

    def _decide_short(self) -> None:
        """Where a scene still learns what photos agree on, one that takes its time is better: as long as it
        shows withheld ones nearly as well, or, where none are withheld, as photos are met well."""
        if self.settings.withheld > 0:
            with self.clock.stage("withheld"):
                self.withheld.end(*self._compared(), self.threads)
            self._take(short=self.settings.shorter is not None and self.withheld.are_learnt_by_heart)
            return
        photos, steps = len(self.views.taken), self.counters.iteration / self.scene_progress
        least = LEAST_SHORTER * (self.settings.shorter[0] if self.settings.shorter else 0)
        self._take(short=photos >= LEAST_PHOTOS and steps >= least and not self.meets_photos)

    @property
    def meets_photos(self) -> bool:
        return self.state.get("photo_loss", 0.0) < self.settings.met_loss

    def _take(self, *, short: bool) -> None:
        progress, counters = self.scene_progress, self.counters
        self.is_short, self.is_short_decided = short, True
        self.strategy.settings = self._local(self.settings)
        if self.learns_by_heart and self.settings.shorter is not None:
            # By steps and seconds more of a short scene would be over: it goes on at the share where it was.
            # With too few splats, as one that is nearly over, three minutes of `museum` have 20.89 dB, not
            # 21.06, of `skull close 80`, which has time for one scene more then, 20.84 of 20.77 (three
            # splits each), ten minutes of `museum` (split 0) 20.36 of 20.58.
            length = (60 * (self.settings.minutes or 0.0) - counters.prepared) / self._least_scenes
            self.first = counters.iteration - round(progress * self.settings.shorter[0])
            self.begun = counters.seconds - progress * length
        # Of a scene that takes its time less is over: density control goes on, where it would have waited for
        # a share that lies behind its end. Three minutes of `biker front 24` have 44.10 dB in place of 44.03
        # (47,000 and 41,000 splats), of `playbot RGBA 18` 31.64 of 31.62.
        self.state["refined_progress"] = min(self.state["refined_progress"], self.scene_progress)
        self.withheld.give_back()
        self._take_photos()

    @property
    def _least_scenes(self) -> float:
        """Scenes, of the length of the first, that there is time for if they are short."""
        return scenes_tried(len(self.views.all)) if self.learns_by_heart else LEAST_SCENES

    @property
    def _length_of_last(self) -> float:
        """Of the last scene, to those before."""
        return 1 - GOES_ON_AT if self.lets_go_on else 1.0

    def _has_time_for(self, scenes: float) -> bool:
        """Whether so many more, of the length of those before, would be whole before the minutes are over.
        Where photos were withheld, of the present one's: the first had begun as one that takes its time."""
        counters, minutes = self.counters, self.settings.minutes or 0.0
        each = (counters.seconds - counters.prepared) / len(self.members)
        if self.learns_by_heart:
            each = counters.seconds - self.begun
        return SPARE * scenes * each <= 60 * minutes - counters.seconds

    def _scenes_in_all(self) -> int:
        """Scenes of the run, the last one among them, if each takes as long as those before."""
        counters, minutes = self.counters, self.settings.minutes or 0.0
        begun = len(self.members) + self.scene_progress
        each = max(counters.seconds - counters.prepared, 1e-9) / max(begun, 1e-9)
        fit = (60 * minutes - counters.prepared) / each
        members = max(math.floor(fit - 2 * SPARE), int(fit - 1 >= 2 * SPARE * LEAST_SHORTER)) + 1
        members = max(min(self.settings.ensemble, members), len(self.members) + 1)
        return members + 1 if members >= 2 and len(self.views.taken) >= LEAST_PHOTOS else 1

    def _sky(self) -> np.ndarray:
        """Flags of the splats in training, see `sky.hold`; none where there is no sky."""
        return self.state["sky"].copy() if "sky" in self.state else np.empty(0)

    def _put(self, parameters: Parameters, ids: np.ndarray, sky: np.ndarray) -> None:
        """Trains these splats from now on, as if no step had been taken. `sky`: as of `_sky`."""
        self.splats.replace(parameters, ids)
        zeros = [Parameters(*(np.zeros_like(array) for array in parameters)) for _ in range(2)]
        self.optimizer.replace(self.splats, *zeros)
        self.optimizer.steps = 0
        self.state.clear()
        self.state |= self.strategy.initialize_state(self.splats, extent=self.extent, focal=self.views.focal)
        self.state["refined_at"] = self.counters.iteration
        if len(sky):
            self.state["sky"] = sky.copy()

    def _teach(self) -> None:
        """Draws what the last scene learns from: the mean of what the others show, for cameras between those
        of the photos. With opacities, so that a step has what photos have behind it, see `standing_in`.

        Three minutes, after a fit of exposures, before the mean colour alone and so: `bust` 18.38, 21.32 and
        15.47 dB, 19.64, 21.31 and 15.85, `kermit` 18.49, 21.26 and 17.90, 18.49, 21.06 and 16.89, `beach`
        19.07, 18.82 and 18.81, 18.92, 18.67 and 18.91, `castle` (split 2) 16.77 and 16.99, `miku 12 far`
        24.84, 20.70 and 19.25, 24.99, 21.30 and 18.89: in all no more than chance, but 18 % of what a split
        of `beach` shows was holes, and none is. Kept for these.

        And with the depths at which what most of them show begins, nearer than half of which nothing of the
        last scene may stand: see `free_space.nearest_by_blocks` and `begins_for_most`.

        Dropped: pictures that weigh the less in the mean, the farther their depths are from the middle one's,
        or the farther one's of two, by exp(-|log of the ratio| / 0.3). The mean itself gains 0.42 dB on split
        0 of `bust`, 0.16 on split 1 of `miku 12 far`, 0.07 and 0.18 on two of `kermit`, and the last scene
        does not: 20.92 in place of 20.86 on `miku 12 far`, 25.20 of 25.13, 18.83 of 19.06 on `kermit`; nor
        with free space beside it, -0.72 and +2.82 on `bust` in place of +1.41 and +2.19 (a share of 0.7).
        """
        views = self.views.taken
        pixels = max(view.camera.width * view.camera.height for view in views)
        count = pictures_taught(len(views), pixels)
        transparent = self.settings.surround is not None or any(view.alpha is not None for view in views)
        workspace, pictures = Workspace(), []
        for camera in cameras_between([view.camera for view in views], count, self.settings.seed):
            total = np.zeros((camera.height, camera.width, 4))
            depths = []
            for member in self.members:
                drawn = draw_frame(member, camera, self.shown_settings, workspace, threads=self.threads)
                total += np.clip(np.nan_to_num(drawn.image), 0, 1)
                if self.settings.free_space > 0:
                    begins = depths_of(member, camera, self.shown_settings, threads=self.threads)
                    depths.append(np.where(drawn.image[..., 3] > 0.5, begins, 0))
            if depths:
                self.taught_depths[camera.name] = nearest_by_blocks(begins_for_most(np.stack(depths)))
            mean = (total / len(self.members) * 255 + 0.5).astype(np.uint8)
            alpha = np.ascontiguousarray(mean[..., 3]) if transparent else None
            pictures.append(TrainView(camera, np.ascontiguousarray(mean[..., :3]), alpha=alpha))
        self.taught = TrainViews(pictures, self.settings.seed)

    def _nearest_depth(self, view: TrainView) -> float | np.ndarray:
        taught = self.taught_depths.get(view.camera.name)
        return super()._nearest_depth(view) if taught is None else taught

    def scenes_state(self) -> dict[str, np.ndarray]:
        """Arrays by name, for checkpoints."""
        numbers = (
            *(self.first, self.begun, self.taught is not None, self.is_last, self.finished is not None),
            *(self.is_short, self.is_short_decided, self.edited),
            *(name in self.asked for name in OF_STUDENT),
        )
        arrays = {"numbers": np.array(numbers, np.float64)}
        arrays |= {f"withheld_{name}": array for name, array in self.withheld.state().items()}
        arrays |= {"sky": self.initial_sky, "finished_sky": self.finished_sky}
        arrays["first_photo"] = np.array([self.first_photo], np.float64)
        arrays["goes_on"] = np.array([self.goes_on])
        arrays["adam_steps"] = np.array([self.optimizer.steps])
        for place, scene in enumerate((self.initial, *self.members)):
            arrays |= {f"{place}.{name}": np.ascontiguousarray(a) for name, a in scene._asdict().items()}
        return arrays

    def restore_scenes(self, state: dict[str, np.ndarray]) -> None:
        """The inverse, once the rest is restored."""
        first, self.begun, teaches, is_last, waits, *short = state["numbers"].tolist()
        is_short, decided, self.edited, *asked = map(bool, (*short, *(True, False, False)[len(short) :]))
        self.asked = {name for name, chosen in zip(OF_STUDENT, asked, strict=False) if chosen}
        self.is_short, self.is_short_decided = is_short, decided
        self.strategy.settings = self._local(self.settings)
        if "withheld_rows" in state:
            self.withheld.restore({name.removeprefix("withheld_"): a for name, a in state.items()})
            self._take_photos()
        count = sum(name.endswith(".means") for name in state)
        scenes = [
            Parameters(*(state[f"{place}.{name}"] for name in Parameters._fields)) for place in range(count)
        ]
        self.first, self.is_last = int(first), bool(is_last)
        # Older files have no word about it, as all steps looked at as many.
        photos = state.get("first_photo", np.array([self.first * self.settings.batch]))
        self.first_photo = int(photos[0])
        # In older files each scene had begun with none.
        steps = state.get("adam_steps", np.array([self.counters.iteration - self.first]))
        self.optimizer.steps = int(steps[0])
        # Older files have no word about it either: the last scene went on then, but was not shown.
        goes_on = state.get("goes_on", np.array([self.learns_by_heart and bool(teaches)]))
        self.goes_on = bool(goes_on[0])
        self.initial, self.members = scenes[0], scenes[1:]
        self.initial_sky, self.finished_sky = state["sky"], state["finished_sky"]
        if waits:
            self.finished = Splats(copied(self.members[0]))
        if teaches:
            self._teach()


def depths_of(member: Parameters, camera: Camera, settings: RenderSettings, *, threads: int) -> np.ndarray:
    """(H, W) float32: expected depths of a scene, 0 where nothing is."""
    means, quats, log_scales, logits = (torch.from_numpy(array) for array in member[:4])
    with torch.no_grad():
        return rasterize_depth(means, quats, log_scales, logits, camera, settings, threads=threads).numpy()


def begins_for_most(depths: np.ndarray) -> np.ndarray:
    """(H, W) from depths (K, H, W) of K scenes: what all but one in `FOG_OF_ONE_IN` reach to. Of as many
    scenes as that, one has fog of its own nearly everywhere, and by the least depth little is known to be
    free."""
    alone = len(depths) // FOG_OF_ONE_IN
    return np.partition(depths, alone, axis=0)[alone]


def kind_of_trainer(settings: TrainSettings, group: Group | None, loss: LossPlugin | None) -> type[Trainer]:
    """What trains by these settings: of several processes, and by a loss of the user's, one scene alone."""
    alone = (group is None or group.size == 1) and loss is None
    return EnsembleTrainer if settings.trains_several and alone else Trainer


SAME_PLACE = 1e-3
"""Of the way to the farthest camera, within which two stand in one place, as all faces of a panorama do."""


def neighbours(a: int, places: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Rows of the `NEIGHBOURS` nearest to camera `a`, by places (P, 3): of those in one place, that which
    looks the same way most, by axes (P, 3), and none in its own, unless all are."""
    distances = np.linalg.norm(places - places[a], axis=1)
    apart, kept = SAME_PLACE * distances.max(), []
    order = np.argsort(distances)
    for row in order[distances[order] > apart]:
        if len(kept) == NEIGHBOURS:
            break
        if all(np.linalg.norm(places[row] - places[other]) > apart for other in kept):
            there = np.flatnonzero(np.linalg.norm(places - places[row], axis=1) <= apart)
            kept.append(int(there[np.argmax(axes[there] @ axes[a])]))
    return np.array(kept or order[order != a][:NEIGHBOURS])


def cameras_between(cameras: Sequence[Camera], count: int, seed: int) -> list[Camera]:
    """Cameras on the ways from each of `cameras`, three at least, to one that is near, see `NEIGHBOURS` and
    `BEYOND`; with the sizes and lenses of the first."""
    rng = np.random.default_rng([seed, 5])
    places = np.stack([-camera.R_camera_world.T @ camera.t_camera_world for camera in cameras])
    axes = np.stack([camera.forward for camera in cameras])
    found = []
    for number in range(count):
        a = number % len(cameras)
        camera, order = cameras[a], neighbours(a, places, axes)
        b, along = int(rng.choice(order)), rng.uniform(-BEYOND, 1 + BEYOND)
        aside = rng.normal(size=3) * ASIDE * np.linalg.norm(places[order[0]] - places[a])
        place = places[a] + along * (places[b] - places[a]) + aside
        ends = quaternion(camera.R_camera_world), quaternion(cameras[b].R_camera_world)
        shaken = matrix_of(exponential(rng.normal(size=3) * ASIDE / 5))
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = shaken @ matrix_of(slerp(*ends, min(max(along, 0.0), 1.0)))
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ place
        found.append(replace(camera, world_to_camera=world_to_camera, name=f"between {number}"))
    return found
