"""From a capture to a trainer with the recipe that it calls for; and a whole run in one call."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch

from splatview.raster.compiling import available_threads
from splatview.scene import Gaussians
from splatview.scene.captures import DEFAULT_LENS_USE, Capture, LensUse, load_capture
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.trainer.adam import automatic_scale_rates
from splatview.trainer.backdrop import (
    automatic_surround,
    checked_colour,
    find_backdrop,
    mean_colour,
    standing_before,
)
from splatview.trainer.counters import PluginError, StepReport
from splatview.trainer.distributed import Group
from splatview.trainer.effects import Antialiased, model_for
from splatview.trainer.ensemble import EnsembleTrainer, kind_of_trainer
from splatview.trainer.evaluate import Evaluation, evaluate
from splatview.trainer.free_space import automatic_max_size, nearest_depths
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.memory import (
    Bound,
    Machine,
    RunMemory,
    begins_by_stereo,
    check_fits,
    own_points,
    plan,
    run_memory,
    sizes_of_capture,
)
from splatview.trainer.photo_size import (
    HALF_THE_SIZE,
    automatic_batch,
    automatic_growth_batch,
    automatic_levels,
    downscale_for,
    steps_of_a_minute,
)
from splatview.trainer.plugin import LossPlugin, LossStep, load_plugin
from splatview.trainer.recipe import (
    FULL_REG_LOSS,
    LEAST_LIMIT,
    MEMBERS,
    STEPS_OF_A_MINUTE,
    automatic_dropout,
    automatic_far_from,
    automatic_full_reg_opacity,
    automatic_limit,
    automatic_max_aspect,
    automatic_met_loss,
    automatic_regularisation,
    automatic_sh_divisor,
    automatic_shorter,
    automatic_steps,
    automatic_tried,
)
from splatview.trainer.settings import PAPER_ITERATIONS, TrainSettings
from splatview.trainer.shading import automatic_shading
from splatview.trainer.sky import find_sky, with_sky
from splatview.trainer.stereo import contracted, stereo_points, thinned
from splatview.trainer.trainer import Trainer
from splatview.trainer.transients import LARGEST_SHARE
from splatview.trainer.views import TrainViews, train_views
from splatview.trainer.withheld import SHARE

LEAST_FOUND, MOST_FOUND = 500, 20_000
"""Points by stereo that show a scene, fewer being chance matches; and those that are used: density control
adds where more are needed, and each costs time from the first step on."""


def settings_for(
    capture: Capture,
    views: TrainViews,
    *,
    iterations: int | None = None,
    minutes: float | None = None,
    max_splats: int | None = None,
    memory: int | None = None,
    antialiased: Antialiased = "auto",
    threads: int | None = None,
    **fields: Any,
) -> TrainSettings:
    """The recipe that suits a capture; `fields` are those of `TrainSettings`, which stand as they are.
    `memory`: bytes that the run may take, by which the number of splats is limited; `threads`: those it will
    have, None for all cores.

    Raises:
        InputError: the memory is too little for the photos and a least number of splats.
        ValueError, TypeError: a field makes no sense, or there is none of its name.
    """
    if "background" in fields:
        fields["background"] = checked_colour("background", fields["background"])
    if fields.get("surround") is not None:
        fields["surround"] = checked_colour("surround", fields["surround"])
    photos, pixels = len(views), views.pixel_count
    threads = threads or available_threads()
    timed = minutes if iterations is None else None
    shown = views.photos_of_a_place(capture.points)
    backdrop = find_backdrop(views.all) if fields.get("backdrop") != "off" else None
    says_empty = backdrop is not None or capture.background is not None
    everywhere = not says_empty and mean_colour(views.all) is not None
    few_steps = automatic_steps(photos, everywhere, shown)
    # Photos that say where nothing is show an object, which fewer splats are enough for.
    once = pixels / max(shown, 1.0) if everywhere else 0.0
    limit = max_splats or automatic_limit(pixels, timed, few_steps, once)
    if "background" not in fields:
        fields["background"] = backdrop.colour if backdrop else capture.background or (0.0, 0.0, 0.0)
        if not says_empty:
            fields.setdefault("surround", automatic_surround(views.all, shown))
    covered = views.covered(fields["background"])
    weight = automatic_regularisation(photos, covered)
    sizes = [(view.camera.width, view.camera.height) for view in views.all]
    levels = automatic_levels(sizes, minutes, threads)
    along = fields.get("resolution", levels)
    # By evidence (None) nobody knows yet how long photos will be smaller.
    of_a_minute = steps_of_a_minute(pixels / photos, levels if along is None else along)
    batch = automatic_batch(timed, few_steps, threads, of_a_minute, everywhere=everywhere)
    growth_batch = (
        1
        if "batch" in fields
        else automatic_growth_batch(
            timed, few_steps, threads, of_a_minute, photos=photos, everywhere=everywhere
        )
    )
    if iterations is None:
        iterations = few_steps or (PAPER_ITERATIONS if minutes is None else None)
    steps = min(iterations or math.inf, STEPS_OF_A_MINUTE * (minutes or math.inf))
    fewer = None
    # Where there is no time for all pixels of one scene, there is none for several, unless withheld photos
    # say so: three minutes of `fern`, 17 photos of 1344x1008 px, have 23.70 dB by one, 22.61 by two and a
    # last one (chosen); judged by `queen` of 1000x658 px, 22.56 and 20.46 (shorter.json).
    if few_steps is not None and timed is not None and levels == HALF_THE_SIZE:
        unmet = None if everywhere else automatic_steps(photos, True, shown)
        fewer = automatic_shorter(photos, few_steps, timed, threads, unmet, of_a_minute)
    withheld = 0.0
    # Short scenes look at one photo per step: who has asked for more has one scene.
    if fewer is None and timed is not None and "batch" not in fields:
        large = levels != HALF_THE_SIZE
        fewer = automatic_tried(photos, iterations, timed, threads, of_a_minute, large=large)
        withheld = SHARE if fewer else 0.0
    automatic: dict[str, Any] = {
        "batch": batch,
        "growth_batch": growth_batch if withheld or not fewer else 1,
        "opacity_reg": weight,
        "scale_reg": weight,
        "full_reg_loss": FULL_REG_LOSS,
        "full_reg_opacity": automatic_full_reg_opacity(photos),
        "dropout": automatic_dropout(photos),
        "ensemble": MEMBERS if timed is not None and (few_steps is not None or fewer) else 1,
        "withheld": withheld,
        "met_loss": automatic_met_loss(covered, everywhere),
        "shorter": fewer and (fewer, min(limit, automatic_limit(pixels, timed, fewer, once))),
        "max_aspect": automatic_max_aspect(photos),
        "max_size": automatic_max_size(says_empty),
        "sh_divisor": automatic_sh_divisor(shown, steps),
        "far_from": automatic_far_from(photos, everywhere),
        "shading": automatic_shading(everywhere, shown),
        "model": model_for(capture, antialiased),
        "resolution": levels,
        **automatic_scale_rates(photos, everywhere, fields.get("strategy", TrainSettings.strategy)),
    }
    settings = TrainSettings(
        iterations=iterations, minutes=minutes, max_splats=limit, **{**automatic, **fields}
    )
    if memory is None:
        return settings
    needed, bound = memory_of(capture, settings, views), Bound(bytes=memory, asked=True)
    check_fits(needed, bound, min(limit, LEAST_LIMIT), f"{capture.name}: its photos", "give it {} or more")
    return replace(settings, max_splats=plan(needed, bound, limit).splats)


def more_planes(views: TrainViews, settings: TrainSettings) -> float:
    """Numbers for each pixel besides those of the photos as they are read: where they are empty, and what is
    masked of those that others contradict."""
    empty = settings.backdrop == "auto" and find_backdrop(views.all) is not None
    return empty + (settings.transients == "auto") * LARGEST_SHARE


def memory_of(capture: Capture, settings: TrainSettings, views: TrainViews) -> RunMemory:
    """What a run of this process on all cores takes."""
    sizes = sizes_of_capture(capture)
    sizes = replace(sizes, planes=sizes.planes + more_planes(views, settings))
    return run_memory(
        sizes,
        resolution=settings.resolution,
        batch=max(settings.batch, settings.growth_batch),
        sh_degree=settings.sh_degree,
        stereo=_begins_by_stereo(capture, settings),
        ensemble=settings.ensemble if settings.trains_several else 1,
        machine=Machine.here(),
    )


def trainer_for(
    capture: Capture,
    views: TrainViews,
    settings: TrainSettings,
    *,
    centre: np.ndarray,
    threads: int | None = None,
    group: Group | None = None,
    loss: LossPlugin | None = None,
    asked: Collection[str] = (),
    on_note: Callable[[str], object] = lambda note: None,
    progress: Progress = NO_PROGRESS,
) -> Trainer:
    """A trainer at its start: splats at the capture's points, or where stereo finds surfaces. `capture` and
    `views` are about `centre`; `asked` names fields of `settings` that somebody has chosen, which none of
    several scenes does without; `on_note` is told what stereo and a look for a sky have found. Raises
    Cancelled."""
    if settings.backdrop == "auto":
        views = standing_before(views, settings.background)
    points, colours = start_points(
        capture, views, settings, threads=threads, on_note=on_note, progress=progress
    )
    are_random = capture.guessed and points is capture.points
    begun = replace(capture, points=points, guessed=are_random)
    extent = begun.extent  # by the cameras alone `fern` has 24.20 dB in place of 25.06, see extent.json
    sky = find_sky(
        capture,
        views.all,
        points,
        mode=settings.sky,
        most=settings.max_splats,
        background=settings.background,
        random_points=are_random,
    )
    if sky.count:
        on_note(f"{sky.count:,} far splats are the sky: {sky.evidence}")
    limit = max(settings.max_splats - sky.count, 1)
    parameters = initial_parameters(points, colours, extent, limit=limit, seed=settings.seed)
    kind = kind_of_trainer(settings, group, loss)
    trainer = kind(
        views,
        with_sky(parameters, sky),
        extent,
        settings if kind is EnsembleTrainer else replace(settings, ensemble=1, shorter=None, withheld=0.0),
        centre=centre,
        threads=threads,
        group=group,
        loss=loss,
        sky=sky,
    )
    if isinstance(trainer, EnsembleTrainer):
        trainer.asked |= set(asked)
    trainer.optimizer.set_options("means", middle=capture.middle, distance=begun.usual_distance)
    if not are_random:  # random points say nothing
        trainer.nearest_depths = nearest_depths(points, views.all)
        # Where splats begin, so that what is decided does not go by how long the run is.
        trainer.exposures.measure(trainer.places, views.sized(trainer.downscale), settings.background)
    trainer.shadings.decide(trainer.exposures.evidence)
    return trainer


def start_points(
    capture: Capture,
    views: TrainViews,
    settings: TrainSettings,
    *,
    threads: int | None = None,
    on_note: Callable[[str], object] = lambda note: None,
    progress: Progress = NO_PROGRESS,
) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) float64 and colours (P, 3) uint8 that splats begin at, by `TrainSettings.start`; the
    capture's own where stereo finds fewer than LEAST_FOUND, which `on_note` is told. Raises Cancelled."""
    known = capture.points, capture.point_colours
    if not _begins_by_stereo(capture, settings):
        return known
    threads = threads or 2
    most, places = min(settings.max_splats, MOST_FOUND), None
    found = np.empty((0, 3)), np.empty((0, 3), np.uint8)
    if capture.guessed and mean_colour(views.all) is not None:
        # An object is where all look; how far away a room or a street is no camera tells.
        found = stereo_points(views.all, None, threads=threads, progress=progress.part(0.0, 0.8))
        places = contracted(found[0], capture.middle, capture.scene_radius)
        progress = progress.part(0.8, 1.0)
    if len(found[0]) < LEAST_FOUND:
        found, places = stereo_points(views.all, capture.points, threads=threads, progress=progress), None
    progress.step(1.0)
    found = thinned(*found, most, seed=settings.seed, places=places)
    count = len(found[0])
    if count < LEAST_FOUND:
        those = f"{len(known[0]):,} {'random points' if capture.guessed else 'points of the capture'}"
        on_note(
            f"photos agree about {count} points by stereo, which is too few: training starts from {those}"
        )
        return known
    on_note(f"training starts from {count:,} points that photos agree about, by stereo")
    if capture.guessed:
        return found
    return np.concatenate([known[0], found[0]]), np.concatenate([known[1], found[1]])


def _begins_by_stereo(capture: Capture, settings: TrainSettings) -> bool:
    return begins_by_stereo(settings.start, **own_points(capture))


class TrainedScene(NamedTuple):
    """What `train` returns."""

    scene: Gaussians
    evaluation: Evaluation | None
    """Scores on the held-out photos; None where there are none."""


def train(
    capture: Capture | str | Path,
    *,
    loss: Callable[[LossStep], torch.Tensor] | str | Path | None = None,
    iterations: int | None = None,
    minutes: float | None = None,
    downscale: int | Literal["auto"] = "auto",
    lens: LensUse = DEFAULT_LENS_USE,
    threads: int | None = None,
    on_step: Callable[[StepReport], object] = lambda report: None,
    **settings: Any,
) -> TrainedScene:
    """Trains a scene on a capture, or on the folder of one, as `splatview train` does; writes nothing.

    `loss`: a loss of one's own, a function or a file with one, see `plugin`; `downscale` and `lens` are of
    photos that are read from a folder, "auto" makes them smaller by what there is time for, see `photo_size`;
    `on_step` is called after each step; `settings` are those of
    `settings_for`. Ctrl-C ends it early, and what is there is returned.

    Raises:
        InputError: the capture cannot be read, or trained on.
        ValueError, TypeError: a setting makes no sense, or there is none of its name.
        PluginError: the loss failed. Its `scene` is what was trained so far.
    """
    plugin = None
    if callable(loss):
        plugin = LossPlugin(loss)
    elif loss is not None:
        plugin = load_plugin(Path(loss))
    if not isinstance(capture, Capture):
        cores = threads or available_threads()
        factor = partial(downscale_for, minutes=minutes, threads=cores) if downscale == "auto" else downscale
        capture = load_capture(capture, downscale=factor, lens=lens)
    centre = capture.centre
    capture = capture.about(centre)
    views = TrainViews(train_views(capture.train), settings.get("seed", 0))
    recipe = settings_for(capture, views, iterations=iterations, minutes=minutes, threads=threads, **settings)
    trainer = trainer_for(capture, views, recipe, centre=centre, threads=threads, loss=plugin, asked=settings)
    with kernel_threads_only():
        try:
            while not trainer.done:
                on_step(trainer.step())
        except KeyboardInterrupt:
            pass
        except PluginError as error:
            error.scene = trainer.snapshot()
            raise
    held_out, evaluation = train_views(capture.held_out), None
    if held_out:
        evaluation = evaluate(
            trainer.scene.arrays,
            held_out,
            trainer.shown_settings,
            threads=threads,
            exposures_differ=trainer.exposures.is_on,
        )
    return TrainedScene(trainer.snapshot(), evaluation)


@contextmanager
def kernel_threads_only() -> Iterator[None]:
    """Within, torch has one thread: its others would wait in loops on the cores that the kernels work on."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
