"""Which effects a training needs, decided from its capture, with the evidence; and what the others save.

Training antialiased (kernel MIP_BLUR, in these runs by 0.0 to 0.5 dB better than 0.3) gains where photos show
the scene at scales that differ, and hardly anything where they do not. On pictures of the demo scene,
400x300, 6,000 splats, 1,500 steps, held-out photos have 25.78 dB without and 25.79 dB with it. With every
other photo half as large 25.82 and 25.88 dB, with a quarter 25.41 and 25.85 dB, and at that size 28.48 and
29.16 dB. Those of `miku` (84 to train on, 1,000 steps) have 25.70 and 25.79 dB, with a quarter 24.90 and
25.45 dB, and at that size 26.17 and 26.84 dB. So it is on from a ratio of SCALE_RATIO: below, a scene that
every viewer shows alike is worth more than a tenth of a decibel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from splatview.scene import Camera, ImageModel
from splatview.scene.captures import Capture
from splatview.scene.captures.capture import LEAST_DISPLACEMENT
from splatview.scene.effects.appearance import MIP_BLUR
from splatview.scene.effects.effect import Effect, Saving
from splatview.trainer.backdrop import ENOUGH_PHOTOS, SPREAD
from splatview.trainer.exposure import DECIDED_BY, Exposures
from splatview.trainer.free_space import FEW_OF, LOOK_STEPS, MAX_SIZE, MAX_SIZE_OF_OBJECTS
from splatview.trainer.outliers import DECIDED_BY as OUTLIERS_DECIDED_BY
from splatview.trainer.outliers import FEWEST_PHOTOS, Outliers
from splatview.trainer.recipe import GROWTH_BATCH_FROM, automatic_regularisation
from splatview.trainer.settings import TrainSettings
from splatview.trainer.shading import Shadings
from splatview.trainer.sky import Sky
from splatview.trainer.strategies.mcmc import LEAST_REG
from splatview.trainer.transients import Transients
from splatview.trainer.withheld import COMPARED, Withheld

SCALE_RATIO = 3.0
"""Of the scales at which photos show the scene, from which on training is antialiased: see above."""

OUTERMOST = 5
"""Percent of the photos at either end that do not decide."""

POINTS = 2000
"""Points of the capture that depths are measured by."""

EXPOSURE = "exposure of each photo"

SHADING = "shading of each photo"

MAPS = "a coarse map of gains for each photo, fitted and applied in each step"

OUTLIERS = "photos left out"

TRANSIENTS = "transients"

PASSING = "splats of one photo"

FROZEN = "frozen splats"

FAR = "faster far means"

SKY = "sky"

SURROUND = "surround"

LONGEST = "longest splats"

WITHHELD = "withheld photos"

SCENES = "several scenes"

FEW_PHOTOS = "rules for few photos"

MORE_PHOTOS = "more photos a step"

COVERED = "weaker regularisers"

EASED = "; eased to "

FAINT = "; opacity weighs "

TOLD = "; "

Antialiased = Literal["auto", "on", "off"]


def scales(cameras: Sequence[Camera], points: np.ndarray) -> np.ndarray:
    """px per world unit at which each camera shows what it sees, by the median depth of the points (P, 3)
    in its picture; NaN where it sees none."""
    some = points[:: max(-(-len(points) // POINTS), 1)]
    found = np.full(len(cameras), np.nan)
    for index, camera in enumerate(cameras):
        t = some @ camera.R_camera_world.T + camera.t_camera_world
        t = t[t[:, 2] > 0]
        x, y = camera.image_points(t).T
        with np.errstate(invalid="ignore"):
            depths = t[(x >= 0) & (x <= camera.width) & (y >= 0) & (y <= camera.height), 2]
        if len(depths):
            found[index] = camera.fx / np.median(depths)
    return found


def scale_ratio(capture: Capture) -> float:
    """Of the photos trained on, how many times larger some show the scene than others; 1 if none sees it."""
    found = scales([photo.camera for photo in capture.train], capture.points)
    found = found[np.isfinite(found)]
    if not len(found):
        return 1.0
    small, large = np.percentile(found, [OUTERMOST, 100 - OUTERMOST], method="nearest")
    return float(large / small)


def model_for(capture: Capture, antialiased: Antialiased) -> ImageModel:
    """The image model to train by: antialiased where that is asked for, or where the capture calls for it."""
    wanted = scale_ratio(capture) >= SCALE_RATIO if antialiased == "auto" else antialiased == "on"
    return ImageModel(antialiased=True, blur=MIP_BLUR) if wanted else ImageModel()


def capture_effects(
    capture: Capture, settings: TrainSettings, antialiased: Antialiased, covered: float = 1.0
) -> tuple[Effect, ...]:
    """What a run will do, for its start; `antialiased` is what the user asked for, `covered` the share of the
    photos' pixels that show something, see `TrainViews.covered`."""
    return (
        _sh_bands(settings),
        _exposure(settings),
        _shading(settings),
        _outliers(len(capture.train), settings),
        _transients(len(capture.train), settings),
        _passing(settings),
        _frozen(len(capture.train), settings),
        _far(capture, settings),
        _masks(capture),
        _lens(capture),
        _antialiased(capture, settings, antialiased),
        _background(capture, settings),
        _sky(settings),
        _surround(settings),
        _longest(settings),
        _covered(len(capture.train), settings, covered),
        _more_photos(settings),
        _withheld(settings),
        _scenes(settings),
        _few_photos(len(capture.train), settings),
    )


def with_easing(effects: tuple[Effect, ...], need: float, faint: float = 1.0) -> tuple[Effect, ...]:
    """The same once the rules for few photos are in force by the share `need`, 0 to 1, see `need_of_reg`, and
    the weight of opacity by the share `faint` of that, see `ease_of_faint`."""

    def eased(effect: Effect) -> Effect:
        why = effect.why.split(EASED)[0].split(FAINT)[0]
        why += f"{EASED}{need:.0%}, as the scene meets them" if need < 1 and effect.on else ""
        why += f"{FAINT}{faint:.0%} as much or less, as half of the splats are faint" if faint < 1 else ""
        return replace(effect, why=why)

    return tuple(eased(one) if one.name == FEW_PHOTOS else one for one in effects)


def with_exposure(effects: tuple[Effect, ...], exposures: Exposures) -> tuple[Effect, ...]:
    """The same once the exposures are decided."""
    evidence = "" if exposures.evidence is None else f"{exposures.evidence}: "
    on = (
        "a gain and an offset for each photo and colour are learnt; the scene has their average"
        if exposures.is_on
        else "too little, not known well enough or not grey: not corrected"
    )
    return tuple(
        replace(effect, on=exposures.is_on, why=evidence + on) if effect.name == EXPOSURE else effect
        for effect in effects
    )


def with_shading(effects: tuple[Effect, ...], shadings: Shadings) -> tuple[Effect, ...]:
    """The same once it is decided whether photos are shaded."""
    why = f"few photos show each place, and light that falls on one alone stays out of the scene: {MAPS}"
    if not shadings.is_on:
        why = "photos of the same places are equally bright"
    return tuple(
        replace(effect, on=shadings.is_on, why=why)
        if effect.name == SHADING and shadings.mode == "auto"
        else effect
        for effect in effects
    )


def with_more_photos(
    effects: tuple[Effect, ...], photos: int, settings: TrainSettings, loss: float
) -> tuple[Effect, ...]:
    """The same once it is decided that steps take so many photos while splats grow, by a photo loss of
    `loss`."""
    on, why = photos > settings.batch, f"photos are met with a loss of {loss:.3f}"
    why = f"{photos} while splats grow, as {why}" if on else f"{settings.batch} all along, as {why}"
    return tuple(
        replace(effect, on=on, why=why) if effect.name == MORE_PHOTOS else effect for effect in effects
    )


UNTOLD = "none: decided before this part of the run, or photos were looked at too seldom to tell"


def with_outliers(effects: tuple[Effect, ...], outliers: Outliers) -> tuple[Effect, ...]:
    """The same once it is decided which photos are left out."""
    on = bool(outliers.left_out.any())
    why = outliers.evidence or (f"{outliers.left_out.sum()} photos, as the run began" if on else UNTOLD)
    return tuple(replace(effect, on=on, why=why) if effect.name == OUTLIERS else effect for effect in effects)


def with_transients(effects: tuple[Effect, ...], transients: Transients) -> tuple[Effect, ...]:
    """The same once it is decided which parts of photos are masked."""
    on, why = transients.masked > 0, transients.evidence or UNTOLD
    return tuple(
        replace(effect, on=on, why=why) if effect.name == TRANSIENTS else effect for effect in effects
    )


def with_passing(effects: tuple[Effect, ...], count: int | None) -> tuple[Effect, ...]:
    """The same once a run has ended, and so many splats of one photo alone with it; None: none was looked
    for."""
    if count is None:
        why = "not looked for: the scene meets its photos so well that nothing stands for missing ones"
    else:
        why = f"{count:,} in front of what other photos show were taken out" if count else "none is in front"
    return tuple(
        replace(effect, on=bool(count), why=why) if effect.name == PASSING else effect for effect in effects
    )


def with_frozen(effects: tuple[Effect, ...], frozen: int, count: int) -> tuple[Effect, ...]:
    """The same once a run has ended with so many splats frozen of `count`."""
    why = f"{frozen:,} of {count:,} splats, in too few photos' frames" if frozen else "all are in more frames"
    return tuple(
        replace(effect, on=frozen > 0, why=why) if effect.name == FROZEN else effect for effect in effects
    )


def with_withheld(effects: tuple[Effect, ...], withheld: Withheld) -> tuple[Effect, ...]:
    """The same once withheld photos are given back."""
    why = f"those trained on have gained {withheld.gap:.1f} dB more than those withheld: "
    by_heart = withheld.are_learnt_by_heart
    why += "several scenes, as one learns single photos by heart" if by_heart else "one scene still learns"
    if math.isnan(withheld.gap):
        why = "nothing could be compared, or the scene was edited: one scene"
    return tuple(replace(effect, why=why) if effect.name == WITHHELD else effect for effect in effects)


def with_scenes(
    effects: tuple[Effect, ...], members: int, taught: bool, *, edited: bool = False
) -> tuple[Effect, ...]:
    """The same once so many scenes are whole, and one learns from them or not; `edited`: as someone's edit
    has ended that."""
    why = f"{members} from the same photos, and a last one that learns from them" if taught else ""
    if not taught:
        why = (
            "one alone: there was no time for another, or it still learns"
            if members == 1
            else "no time for one that learns: the first stays"
        )
    if edited:
        why = "no other follows: the one that was edited stays"

    def told(effect: Effect) -> Effect:
        if effect.name == SCENES:
            return replace(effect, on=taught, why=why)
        if effect.name == FEW_PHOTOS and taught and effect.on:
            return replace(
                effect,
                on=False,
                why=f"{effect.why.split(EASED)[0].split(FAINT)[0]}{TOLD}the last scene needs none",
            )
        return effect

    return tuple(told(effect) for effect in effects)


def _scenes(settings: TrainSettings) -> Effect:
    if settings.trains_several:
        steps_of_one = steps = f"{settings.iterations:,} steps" if settings.iterations else ""
        if settings.shorter is not None:
            if settings.shorter[0] != settings.iterations:  # as many where only splats are fewer
                steps = f"{settings.shorter[0]:,} steps, or {steps} where photos are met well,"
            if settings.withheld > 0:
                one = steps_of_one or "one is trained to the end"
                steps = f"{one}, or, if withheld photos speak for it, {settings.shorter[0]:,} steps"
        why = (
            f"{steps} end a scene: others follow, {settings.ensemble} in all at most,"
            " and one that learns from them, as far as there is time"
        )
    else:
        why = "one is trained to the end of the run"
    saving = Saving(what="as many steps again for each, and pictures of all of them")
    return Effect(name=SCENES, on=settings.trains_several and not settings.withheld, why=why, saving=saving)


def _more_photos(settings: TrainSettings) -> Effect:
    photos, usual = settings.growth_batch, settings.batch
    why = (
        f"{photos} while splats grow, if after {GROWTH_BATCH_FROM:.0%} of the run photos are met with a loss"
        f" above {settings.growth_loss:g}"
    )
    if photos <= usual:
        why = f"{usual} all along: photos are few, or of an object, or time is short, or as asked for"
    saving = Saving(what=f"{photos - usual} more photos in each step") if photos > usual else Saving()
    return Effect(name=MORE_PHOTOS, on=False, why=why, saving=saving)


def _withheld(settings: TrainSettings) -> Effect:
    tries = settings.trains_several and settings.withheld > 0
    why = "none: photos or time are few, or one scene or photos of a step are asked for"
    if tries:
        why = f"{settings.withheld:.1%} of the photos for a while, to tell whether several scenes are better"
    saving = Saving(what=f"two pictures of each photo that is withheld, and of {COMPARED} others")
    return Effect(name=WITHHELD, on=tries, why=why, saving=saving)


def _passing(settings: TrainSettings) -> Effect:
    stay = settings.most_of_one == 1
    why = "they stay, as asked for" if stay else "as the run ends, in front of what other photos show"
    saving = Saving(what="a picture of each photo's view, once")
    return Effect(name=PASSING, on=False, why=why, saving=saving)


def _frozen(photos: int, settings: TrainSettings) -> Effect:
    few, rounds = settings.few_views, settings.few_views_rounds
    why = f"after {rounds:g} rounds of photos, those in the frames of {few} photos or fewer"
    if not few:
        why = "all learn to the end, as asked for"
    elif not photos > FEW_OF * few:
        why = f"of {photos} photos each counts"
    saving = Saving(what=f"the places of all splats in the photos' frames, every {LOOK_STEPS} steps")
    return Effect(name=FROZEN, on=False, why=why, saving=saving)


def _far(capture: Capture, settings: TrainSettings) -> Effect:
    saving = Saving(what="a distance for each splat of a step")
    if settings.far_from == math.inf:
        why = "all move alike: photos are few, or before nothing or a plain colour, or it was asked for"
        return Effect(name=FAR, on=False, why=why, saving=saving)
    if capture.guessed:  # random points tell no distance
        why = f"from {settings.far_from:g} times the distance on at which most splats begin, in proportion"
        return Effect(name=FAR, on=True, why=why, saving=saving)
    radius = settings.far_from * capture.usual_distance
    distances = np.linalg.norm(capture.points - capture.middle, axis=1)
    farther = distances[distances > radius]
    why = f"no point is farther than {radius:.3g} units from the middle of the cameras"
    if len(farther):
        why = (
            f"from {radius:.3g} units from the middle of the cameras on, where "
            f"{len(farther) / len(distances):.0%} of the points are, in proportion: "
            f"{np.median(farther) / radius:.1f} times as fast at half of these or more"
        )
    return Effect(name=FAR, on=len(farther) > 0, why=why, saving=saving)


def _outliers(photos: int, settings: TrainSettings) -> Effect:
    why = f"decided within {OUTLIERS_DECIDED_BY:.0%} of the run, by whether photos show the same scene"
    if settings.outliers == "off":
        why = "as asked for"
    elif photos < FEWEST_PHOTOS:
        why = f"of {photos} photos nobody could say which are wrong; {FEWEST_PHOTOS} are needed"
    return Effect(
        name=OUTLIERS, on=False, why=why, saving=Saving(what="a small picture of each photo's view, once")
    )


def _transients(photos: int, settings: TrainSettings) -> Effect:
    why = f"decided within {OUTLIERS_DECIDED_BY:.0%} of the run, by whether photos show the same everywhere"
    if settings.transients == "off":
        why = "they are trained on, as asked for"
    elif photos < FEWEST_PHOTOS:
        why = f"of {photos} photos nobody could say which are wrong; {FEWEST_PHOTOS} are needed"
    saving = Saving(what="five small pictures of each photo's view, once")
    return Effect(name=TRANSIENTS, on=False, why=why, saving=saving)


def _sh_bands(settings: TrainSettings) -> Effect:
    degree = settings.sh_degree
    shares = ", ".join(f"{band} from {band * settings.sh_every:.0%}" for band in range(1, degree + 1))
    # The parameter and Adam's two averages, each float32 for three colours.
    saved = 9 * 4 * ((degree + 1) ** 2 - 1)
    return Effect(
        name="SH bands",
        on=degree > 0,
        why=f"band {shares} of the run on; before, a band is neither computed nor stored nor optimised"
        if degree
        else "one colour for all directions was asked for",
        saving=Saving(bytes=saved, what="for each splat until then") if degree else Saving(),
    )


def _exposure(settings: TrainSettings) -> Effect:
    what = "a gain and an offset for each photo and colour, fitted and applied in each step"
    why = {
        "off": "as asked for",
        "on": f"as asked for: {what}",
        "auto": f"from within {DECIDED_BY:.0%} of the run on, if photos differ in brightness where they"
        " show the same places",
    }
    return Effect(
        name=EXPOSURE,
        on=settings.exposure == "on",
        why=why[settings.exposure],
        saving=Saving(what=what),
    )


def _shading(settings: TrainSettings) -> Effect:
    why = {
        "off": f"{ENOUGH_PHOTOS} and more photos show each place, or an object alone, or none is wanted",
        "on": f"as asked for: {MAPS}",
        "auto": "where photos differ in brightness",
    }
    on = settings.shading == "on"
    return Effect(name=SHADING, on=on, why=why[settings.shading], saving=Saving(what=MAPS))


def _masks(capture: Capture) -> Effect:
    statistics = capture.statistics
    why = f"{statistics.masks} of {len(capture.photos)} photos have a mask"
    cuts = statistics.cut_out and statistics.masks > 0
    if cuts:
        why += ": what they hide is empty, as in transparent photos"
    if statistics.hidden > 0:
        what = " or beyond what their lens saw" if statistics.lenses else ""
        why += f"; {statistics.hidden:.2%} of all pixels are masked{what}, and not compared"
    on = cuts or statistics.hidden > 0
    return Effect(name="masks", on=on, why=why, saving=Saving(what="a look at each pixel"))


def _lens(capture: Capture) -> Effect:
    statistics, photos = capture.statistics, len(capture.photos)
    through = any(photo.camera.lens is not None for photo in capture.photos)
    if statistics.lenses:
        most = f"moves points by up to {statistics.displacement:.3g} px"
        if not np.isfinite(statistics.displacement):
            most = "shows less than a pinhole would"
        why = f"{statistics.lenses} of {photos} photos have a lens that {most}: " + (
            "pictures are drawn through them" if through else "taken out of the photos"
        )
    elif statistics.lenses_left_out:
        most = f"lenses move no point by more than {statistics.displacement:.2g} px"
        why = f"{most}, of {LEAST_DISPLACEMENT:g} that could show: photos are used as they are"
    else:
        why = f"all {photos} cameras are pinholes"
    return Effect(
        name="lens distortion",
        on=statistics.lenses > 0,
        why=why,
        saving=Saving(what="the resampling of each photo"),
        # Where a photo goes from black to white within a pixel.
        bound=min(statistics.displacement, 1.0),
    )


def _antialiased(capture: Capture, settings: TrainSettings, asked: Antialiased) -> Effect:
    ratio = scale_ratio(capture)
    found = f"photos show the scene at scales up to {ratio:.2g} times apart"
    if asked != "auto":
        why = f"as asked for; {found}"
    elif settings.model.antialiased:
        why = f"{found}, {SCALE_RATIO:g} or more; kernel {settings.model.blur:g} px²"
    else:
        why = f"{found}, less than {SCALE_RATIO:g}: 0.1 dB at most, and every viewer shows it alike"
    return Effect(
        name="antialiased opacity",
        on=settings.model.antialiased,
        why=why,
        saving=Saving(what="a determinant and a root for each splat and photo"),
        forced=None if asked == "auto" else asked == "on",
        can_override=True,
    )


def _background(capture: Capture, settings: TrainSettings) -> Effect:
    transparent = capture.statistics.transparent
    colour = ", ".join(f"{part:g}" for part in settings.background)
    why = f"{transparent} of {len(capture.photos)} photos have transparency"
    if transparent:
        behind = f", laid over {colour}, which is behind the scene too"
    elif any(settings.background):
        behind = (
            f"; {colour} is behind the scene, the plain colour before which they stand, and is no part of it"
        )
    elif settings.surround is not None:
        behind = ", and they stand before no plain colour"
    else:
        behind = "; black is behind the scene"
    if transparent and settings.alpha_weight > 0:
        behind += f"; their opacity is part of the loss, {settings.alpha_weight:g} of its mean difference"
    return Effect(
        name="background",
        on=transparent > 0 or any(settings.background),
        why=why + behind,
        saving=Saving(what="a look at each pixel's opacity"),
    )


def with_sky_found(effects: tuple[Effect, ...], sky: Sky | None, count: int) -> tuple[Effect, ...]:
    """The same once it is decided whether there is a sky, of so many splats; None: in an earlier part of the
    run."""
    if sky is None:
        why = f"as the run began: {count:,} splats" if count else "as the run began"
    else:
        why = f"as asked for; {sky.evidence}" if sky.mode == "on" else str(sky.evidence)
        if sky.count:
            why += f": {sky.fine:,} splats whose colours are trained, {sky.radius:.3g} units away, before"
            why += f" {sky.count - sky.fine:,} that stay as they are"
    return tuple(replace(one, on=count > 0, why=why) if one.name == SKY else one for one in effects)


def _sky(settings: TrainSettings) -> Effect:
    return Effect(
        name=SKY,
        on=settings.sky == "on",
        why="as asked for" if settings.sky != "auto" else "far splats where photos agree at infinity",
        saving=Saving(what="far splats behind all others"),
    )


def _surround(settings: TrainSettings) -> Effect:
    if settings.surround is None:
        why = (
            "photos say where nothing is, stand before a plain colour, a background is asked for, or"
            f" {ENOUGH_PHOTOS} and more show each place"
        )
    else:
        colour = ", ".join(f"{part:.2f}" for part in settings.surround)
        why = (
            f"photos show something everywhere: their mean colour, {colour}, is behind the scene, for what"
            f" none shows; up to {SPREAD:g} more or less of it in a step, which makes the scene opaque"
        )
    return Effect(
        name=SURROUND,
        on=settings.surround is not None,
        why=why,
        saving=Saving(what="three random numbers a photo"),
    )


def _longest(settings: TrainSettings) -> Effect:
    limit = settings.max_size
    reasons = {
        MAX_SIZE: "; longer ones are veils before what photos from aside show",
        MAX_SIZE_OF_OBJECTS: ": photos say where nothing is, and longer ones reach there as haze",
    }
    is_on = limit < math.inf
    why = f"none is longer than {limit:g} of its distance to a camera that shows it{reasons.get(limit, '')}"
    return Effect(
        name=LONGEST,
        on=is_on,
        why=why if is_on else "of any length, as asked for",
        saving=Saving(what="a look at the scales of what photos show, in some of the steps"),
    )


def _few_photos(photos: int, settings: TrainSettings) -> Effect:
    rules = []
    if settings.strategy == "mcmc" and max(settings.opacity_reg, settings.scale_reg) > LEAST_REG:
        rules.append(f"mean opacity and scale weigh {settings.opacity_reg:.2g} and {settings.scale_reg:.2g}")
    if settings.dropout > 0:
        rules.append(f"up to {settings.dropout:.0%} of the splats are left out of a step")
    if settings.max_aspect < math.inf:
        rules.append(f"splats are at most {settings.max_aspect:g} times as long as wide")
    what = (
        "; ".join(rules) if rules else "enough, or as asked for: nothing stands for photos that are missing"
    )
    return Effect(
        name=FEW_PHOTOS,
        on=bool(rules),
        why=f"{photos} photos to train on: {what}",
        saving=Saving(what="draws of the splats that are left out"),
    )


def _covered(photos: int, settings: TrainSettings, covered: float) -> Effect:
    weights = settings.opacity_reg, settings.scale_reg
    by_pixels = settings.strategy == "mcmc" and automatic_regularisation(photos, covered) in weights
    why = f"photos show something in {covered:.1%} of their pixels"
    if settings.strategy != "mcmc":
        why += ", which this strategy does not go by"
    elif not by_pixels:
        why += "; mean opacity and scale weigh as asked for"
    elif covered < 1:
        why += f", so mean opacity and scale weigh {weights[0]:.2g} and {weights[1]:.2g}"
    return Effect(
        name=COVERED,
        on=by_pixels and covered < 1,
        why=why,
        saving=Saving(what="a look at a part of the pixels, once"),
    )
