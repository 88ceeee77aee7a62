"""What `splatview train` does before the first step: reads, checks, and readies all that a run needs."""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from splatview.scene import InputError
from splatview.scene.captures import DEFAULT_LENS_USE, Capture, load_capture
from splatview.scene.effects.effect import Effect
from splatview.scene.formats import place_beside
from splatview.scene.formats.io import require_regular_file, take_lock
from splatview.scene.progress import Progress
from splatview.scene.user_dirs import cache_folder
from splatview.trainer.backdrop import find_backdrop, standing_before
from splatview.trainer.checkpoint import Checkpoint, load_checkpoint, restore
from splatview.trainer.distributed import (
    Alone,
    Group,
    Processes,
    check_equal,
    digest,
    local_processes,
    share_of_cores,
)
from splatview.trainer.effects import (
    capture_effects,
    with_exposure,
    with_outliers,
    with_shading,
    with_sky_found,
    with_transients,
)
from splatview.trainer.free_space import MOST_OF_ONE
from splatview.trainer.memory import (
    Bound,
    Machine,
    MemoryPlan,
    PhotoSizes,
    RunMemory,
    begins_by_stereo,
    check_fits,
    own_points,
    plan,
    run_memory,
    sizes_of_capture,
)
from splatview.trainer.photo_size import SizeChoice, automatic_batch, automatic_growth_batch
from splatview.trainer.recipe import LEAST_LIMIT, automatic_steps, most_scenes
from splatview.trainer.run import Outputs
from splatview.trainer.settings import TrainSettings
from splatview.trainer.strategies import STRATEGIES
from splatview.trainer.torch_import import TorchImport
from splatview.trainer.transients import LARGEST_SHARE
from splatview.trainer.views import TrainView, TrainViews, train_views

if TYPE_CHECKING:  # torch is imported while photos are read, see `_prepare`
    from splatview.trainer.plugin import LossPlugin
    from splatview.trainer.trainer import Trainer

COMPILED_SECONDS = 10.0
"""Loading kernels from the cache takes about two seconds; when it takes this long, they were compiled."""

BYTES_A_SPLAT = 250 + 2 * 710
"""In the scene's file and in two checkpoints: the old one stays until the new one is whole."""

_held: dict[Path, IO[bytes]] = {}
"""What `lock_run` claimed; claims last as long as the process, which may make one again."""

OF_THE_CHECKPOINT = [
    "seed",
    "strategy",
    "max_splats",
    "batch",
    "coarse",
    "start",
    "exposure",
    "shading",
    "outliers",
    "passing",
    "ensemble",
    "sky",
    "background",
    "antialiased",
    "abs_grad",
    "lens",
    "masks",
]
"""Options that a resumed run takes from where it was."""


def say(console: Console, text: str, style: str | None = None) -> None:
    """Prints a line as it is, however long."""
    console.print(text, style=style, soft_wrap=True)


class ToldElsewhere(Exception):
    """Something is wrong, and another process of the run says what."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run that is ready for its first step."""

    name: str
    """Name of the capture."""
    has_lens: bool
    """Whether photos are trained on through a lens."""
    trainer: Trainer
    held_out: list[TrainView]
    outputs: Outputs
    notes: dict[str, Any]
    """For checkpoints."""
    effects: tuple[Effect, ...]
    """What the run computes and why."""
    memory: MemoryPlan
    """What the run takes."""
    uncounted: float
    """Seconds spent on what is made once per installation; they count against no budget."""


def prepare(options: argparse.Namespace, console: Console, group: Group, *, window: bool = False) -> Run:
    """Reads the capture and makes the trainer; the outputs have been tried by then. `window`: there is one.

    Raises:
        InputError: the user asked for something that cannot be.
        ToldElsewhere: another process of the group raises InputError.
    """
    machine = Machine.here(_threads(options, group), local_processes())
    if not isinstance(group, Processes):
        return _prepare(options, console, group, machine, window)
    # Before anything can fail in one of them.
    machine = Machine.least(group.gathered(machine))
    run, problem = None, None
    try:
        run = _prepare(options, console, group, machine, window)
    except InputError as error:
        problem = str(error)
    problems = group.gathered(problem)
    if any(problems):
        rank = next(rank for rank, said in enumerate(problems) if said)
        if group.rank > 0:
            raise ToldElsewhere
        raise InputError(problems[rank] if rank == 0 else f"process {rank}: {problems[rank]}")
    assert run is not None
    try:
        _check_equal(run, group)
    except InputError:
        # All of them notice.
        if group.rank > 0:
            raise ToldElsewhere from None
        raise
    return run


def _prepare(
    options: argparse.Namespace, console: Console, group: Group, machine: Machine, window: bool
) -> Run:
    torch_import = TorchImport()
    if options.plugin is not None:
        check_plugin(options.plugin)
    checkpoint = None if options.resume is None else load_checkpoint(options.resume)
    if checkpoint is not None:
        for name in OF_THE_CHECKPOINT:
            if getattr(options, name) is not None:
                raise InputError(f"--{name.replace('_', '-')} is the checkpoint's; leave it out to resume")
    batch = checkpoint.settings.batch if checkpoint else options.batch
    if batch is None and group.size > 1:
        batch = group.size
    if batch is not None and not batch >= group.size:
        raise InputError(f"{group.size} processes cannot share a batch of {batch}; start at most {batch}")
    asked_size = None if options.downscale == "auto" else options.downscale
    if checkpoint is not None:
        asked_size = asked_size or int(checkpoint.notes.get("downscale", 1))
    # Checkpoints from before there was a choice have no word about it.
    lens = checkpoint.notes.get("lens", "undistort") if checkpoint else options.lens or DEFAULT_LENS_USE
    masks = checkpoint.notes.get("masks", "ignore") if checkpoint else options.masks or "ignore"
    asked_background = None if options.background == "auto" else options.background
    background = checkpoint.settings.background if checkpoint else asked_background or (0.0, 0.0, 0.0)
    if checkpoint is not None and checkpoint.notes.get("plugin") and options.plugin is None:
        raise InputError(
            f"{options.resume}: was trained with a loss of its own; give it with --plugin"
            f" {checkpoint.notes['plugin'].get('name')}, or go on without it by --plugin none"
        )
    outputs = _outputs("demo" if options.demo else options.capture, options.output, options.metrics)
    if group.rank == 0:
        outputs.check()
        for path in (outputs.scene, outputs.checkpoint):
            lock_run(path)
    folder, uncounted = _demo(console) if options.demo else (options.capture, 0.0)
    asked = options.memory or (checkpoint.notes.get("memory") if checkpoint else None)
    bound = Bound(bytes=asked or machine.left, asked=asked is not None)

    def room_for(sizes: PhotoSizes, *, points: int) -> RunMemory:
        start, pixels = options.start or "auto", sizes.largest
        stereo = checkpoint is None and begins_by_stereo(start, points=points, pixels=pixels)
        # As many photos a step as there may be: where photos are few, there are more steps instead.
        timed = options.minutes if options.iterations is None else None
        most = batch or max(
            automatic_batch(timed, None, machine.threads),
            automatic_growth_batch(timed, None, machine.threads),
        )
        more = {"machine": machine, "batch": most, "stereo": stereo, "window": window}
        if checkpoint is not None:
            more["ensemble"] = checkpoint.settings.ensemble
        elif timed is not None and options.ensemble != "off" and options.plugin is None and group.size == 1:
            photos = sizes.trained / max(sizes.largest, 1)  # of one size, or more than so many
            more["ensemble"] = most_scenes(round(photos), timed, machine.threads)
        return _room_for(sizes, bound, options, checkpoint, **more)

    size = SizeChoice(asked_size, options.minutes, machine.threads, room_for)
    capture = _with_status(
        console,
        "Reading photos",
        lambda progress: load_capture(
            folder,
            downscale=size,
            background=background,
            lens=lens,
            masks=masks,
            progress=progress,
        ),
    )
    if size.line:
        say(console, size.line)
    memory = room_for(sizes_of_capture(capture), points=own_points(capture)["points"])
    centre = capture.centre
    capture = capture.about(centre)
    seed = options.seed or 0 if checkpoint is None else checkpoint.settings.seed
    views, held_out = TrainViews(train_views(capture.train), seed), train_views(capture.held_out)
    known = checkpoint.settings if checkpoint else None
    # Where photos are empty, and what is masked, are more numbers for their pixels.
    more = float((known is None or known.backdrop == "auto") and find_backdrop(views.all) is not None)
    more += LARGEST_SHARE * (options.passing != "stay" if known is None else known.transients == "auto")
    if more:
        sizes = sizes_of_capture(capture)
        memory = room_for(replace(sizes, planes=sizes.planes + more), points=own_points(capture)["points"])
    for warning in capture.warnings:
        say(console, warning, "yellow")
    torch_import.wait()
    loss = _loss(options, checkpoint, console)
    if checkpoint is None:
        trainer, planned = _new_trainer(
            capture, views, centre, seed, batch, options, group, loss, console, memory, bound, machine.threads
        )
        if options.iterations is None and automatic_steps(len(views)) is not None:
            few = f"{len(views)} photos are few" if len(views) > 1 else "a single photo is little to go by"
            say(
                console,
                f"{few}: {trainer.settings.iterations:,} steps at most, for more would"
                " learn single photos by heart; --iterations asks for more",
            )
    else:
        planned = plan(memory, bound, checkpoint.settings.max_splats)
        trainer = _resumed_trainer(views, centre, checkpoint, options, group, loss, planned.splats)
        if trainer.done:
            # Perhaps it was killed before its scene was written.
            say(
                console,
                f"{options.resume}: its run is over; its scene and pictures are written, and --iterations"
                f" above {trainer.counters.iteration} or more --minutes trains on",
            )
    trainer.most_splats = planned.most
    if group.rank == 0:
        _check_room(outputs, max(trainer.settings.max_splats, len(trainer.splats)))
    antialiased = (
        options.antialiased or (checkpoint.notes.get("antialiased") if checkpoint else None) or "auto"
    )
    notes: dict[str, Any] = {
        "downscale": size.factor,
        "lens": lens,
        "masks": masks,
        "antialiased": antialiased,
    }
    if loss is not None:
        notes["plugin"] = {"name": loss.name, "sha256": loss.digest}
    covered = trainer.views.covered(trainer.settings.background)
    effects = capture_effects(capture, trainer.settings, antialiased, covered)
    effects = with_shading(effects, trainer.shadings)
    effects = with_sky_found(effects, trainer.sky, int(np.count_nonzero(trainer.state.get("sky", 0))))
    if trainer.exposures.is_decided:
        effects = with_exposure(effects, trainer.exposures)
    if trainer.outliers.is_decided:
        effects = with_outliers(effects, trainer.outliers)
    if trainer.transients.is_decided:
        effects = with_transients(effects, trainer.transients)
    if asked is not None:
        notes["memory"] = asked
    return Run(
        name=capture.name,
        has_lens=any(photo.camera.lens is not None for photo in capture.photos),
        trainer=trainer,
        held_out=held_out,
        outputs=outputs,
        notes=notes,
        effects=effects,
        memory=planned,
        uncounted=uncounted,
    )


def _room_for(
    sizes: PhotoSizes, bound: Bound, options: argparse.Namespace, checkpoint: Checkpoint | None, **run: Any
) -> RunMemory:
    """What the run takes on such photos; `run` goes to `run_memory`. Raises InputError where the bound has no
    room for them and the least number of splats, or those of the checkpoint."""
    if checkpoint is None:
        memory = run_memory(sizes, resolution=_resolution(options.coarse), **run)
        what = "the demo: its photos" if options.demo else f"{options.capture}: its photos"
        splats, advice = min(LEAST_LIMIT, options.max_splats or LEAST_LIMIT), "use a larger --downscale, or"
    else:
        settings, splats = checkpoint.settings, len(checkpoint.ids)
        memory = run_memory(sizes, resolution=settings.resolution, sh_degree=settings.sh_degree, **run)
        what, advice = f"{options.resume}: its photos", "resume with"
    check_fits(memory, bound, splats, f"{what} and {splats:,} splats", f"{advice} --memory {{}} or more")
    return memory


def ready_kernels(
    console: Console, *, lens: bool = False, strategies: Iterable[str] = tuple(STRATEGIES)
) -> float:
    """Compiles or loads the kernels; returns the seconds of compiling, which count against no budget.

    `lens`: those for photos through a lens; `strategies`: those of these alone.
    """
    from splatview.trainer.warm_up import warm_up

    begun = time.perf_counter()
    with console.status("Readying the kernels (once per installation: about a minute)"):
        warm_up(lens=lens, strategies=strategies)
    seconds = time.perf_counter() - begun
    if seconds < COMPILED_SECONDS:
        return 0.0
    say(
        console,
        f"compiling took {seconds:.0f} s, once per installation; --minutes does not count it",
    )
    return seconds


def process_age() -> float:
    """Seconds since this process began, so that a budget of minutes counts starting up; 0 if unknown."""
    try:
        with open("/proc/self/stat", encoding="ascii") as file:
            ticks = int(file.read().rpartition(")")[2].split()[19])
        return max(time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK"), 0.0)
    except (OSError, AttributeError, ValueError, IndexError):  # not on Linux
        return 0.0


def _demo(console: Console) -> tuple[Path, float]:
    """The folder of the demo's photos, and the seconds that making them took."""
    from splatview.renderers.demo_cache import cached_demo_capture

    begun = time.perf_counter()
    title = "Taking pictures of the demo scene (once per installation)"
    folder = _with_status(console, title, lambda progress: cached_demo_capture(progress=progress))
    return folder, time.perf_counter() - begun


def _with_status(console: Console, title: str, work: Callable[[Progress], Any]) -> Any:
    """Does `work` while its share shows behind the title."""
    with console.status(title) as status:
        return work(Progress(report=lambda share: status.update(f"{title}: {share:.0%}")))


def _outputs(capture: str, output: Path | None, metrics: Path | None) -> Outputs:
    scene = output or Path(f"{os.path.basename(os.path.realpath(capture)) or 'scene'}.ply")
    beside = place_beside(scene)
    stem = beside.stem if beside == scene else beside.name
    return Outputs(
        scene=scene,
        checkpoint=beside.parent / f"{stem}.checkpoint.safetensors",
        metrics=metrics,
        pictures=beside.parent / f"{stem}-held-out",
    )


def _check_room(outputs: Outputs, splats: int) -> None:
    """Raises InputError where the disk is too full for what the run will write."""
    folder = outputs.checkpoint.resolve().parent
    free, needed = shutil.disk_usage(folder).free, splats * BYTES_A_SPLAT
    if not free >= needed:
        raise InputError(
            f"{outputs.scene}: the disk has {free / 1e6:.1f} MB left, and up to {splats:,} splats with their"
            f" checkpoint need {needed / 1e6:.1f} MB; make room, or name another place with -o"
        )


def _new_trainer(
    capture: Capture,
    views: TrainViews,
    centre: np.ndarray,
    seed: int,
    batch: int | None,
    options: argparse.Namespace,
    group: Group,
    loss: LossPlugin | None,
    console: Console,
    memory: RunMemory,
    bound: Bound,
    cores: int,
) -> tuple[Trainer, MemoryPlan]:
    from splatview.trainer.setup import settings_for, trainer_for

    strategy = options.strategy or TrainSettings.strategy
    if options.abs_grad and not hasattr(STRATEGIES[strategy][0], "absolute_gradient"):
        raise InputError("--abs-grad is of the classic strategy; add --strategy classic")
    settings = settings_for(
        capture,
        views,
        iterations=options.iterations,
        minutes=options.minutes,
        max_splats=options.max_splats,
        antialiased=options.antialiased or "auto",
        seed=seed,
        strategy=strategy,
        exposure=options.exposure or "auto",
        outliers=options.outliers or "auto",
        most_of_one=1.0 if options.passing == "stay" else MOST_OF_ONE,
        transients="off" if options.passing == "stay" else "auto",
        sky=options.sky or "auto",
        **({} if options.shading in (None, "auto") else {"shading": options.shading}),
        **({"ensemble": 1} if options.ensemble == "off" else {}),
        absolute_gradient=bool(options.abs_grad),
        threads=cores,
        start=options.start or "auto",
        **({} if batch is None else {"batch": batch}),
        **({} if loss is None else {"growth_batch": 1}),  # other losses are no measure of it
        **({} if options.coarse is None else {"resolution": _resolution(options.coarse)}),
        **({} if options.background in (None, "auto") else {"background": options.background}),
    )
    planned = plan(memory, bound, settings.max_splats)
    settings = replace(settings, max_splats=planned.splats)
    threads = _threads(options, group)

    notes: list[str] = []

    def made(progress: Progress) -> Trainer:
        given = {"threads": threads, "group": group, "loss": loss, "progress": progress}
        return trainer_for(capture, views, settings, centre=centre, on_note=notes.append, **given)

    trainer = _with_status(console, "Finding where splats begin", made)
    for note in notes:
        say(console, note)
    return trainer, planned


def _resolution(coarse: tuple[tuple[float, int], ...] | str | None) -> tuple[tuple[float, int], ...] | None:
    """`TrainSettings.resolution` of the option --coarse."""
    if coarse is None:
        return TrainSettings.resolution
    return None if isinstance(coarse, str) else coarse


def _resumed_trainer(
    views: TrainViews,
    centre: np.ndarray,
    checkpoint: Checkpoint,
    options: argparse.Namespace,
    group: Group,
    loss: LossPlugin | None,
    max_splats: int,
) -> Trainer:
    settings = checkpoint.settings
    if options.iterations is not None or options.minutes is not None:
        settings = replace(settings, iterations=options.iterations, minutes=options.minutes)
    from splatview.trainer.ensemble import EnsembleTrainer, kind_of_trainer

    settings = replace(settings, max_splats=max_splats)
    if settings.backdrop == "auto":
        views = standing_before(views, settings.background)
    parameters = checkpoint.parameters
    extent, threads = checkpoint.extent, _threads(options, group)
    kind = kind_of_trainer(settings, group, loss)
    settings = settings if kind is EnsembleTrainer else replace(settings, ensemble=1)
    trainer = kind(
        views, parameters, extent, settings, centre=centre, threads=threads, group=group, loss=loss
    )
    restore(trainer, checkpoint)
    if trainer.done and (options.iterations is not None or options.minutes is not None):
        raise InputError(
            f"{options.resume}: its run is over; give --iterations above {trainer.counters.iteration}"
            " or more --minutes to train on"
        )
    return trainer


NO_PLUGIN = Path("none")
"""For --plugin: a resumed run goes on without the loss that it had."""


def check_plugin(path: Path) -> None:
    """What can be said of a plugin before torch is there: it is a file, and Python.

    Raises:
        InputError: it is not.
    """
    if path == NO_PLUGIN:
        return
    require_regular_file(path)
    try:
        compile(path.read_bytes(), str(path), "exec", dont_inherit=True)
    except SyntaxError as error:
        raise InputError(f"{path}:{error.lineno}: cannot be imported: SyntaxError: {error.msg}") from None
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read as Python: {error}") from None


def _loss(options: argparse.Namespace, checkpoint: Checkpoint | None, console: Console) -> LossPlugin | None:
    if options.plugin is None or options.plugin == NO_PLUGIN:
        return None
    from splatview.trainer.plugin import load_plugin

    loss = load_plugin(options.plugin)
    before = checkpoint.notes.get("plugin") if checkpoint else None
    if checkpoint is not None and (before or {}).get("sha256") != loss.digest:
        was = "without one" if not before else "with another"
        say(
            console, f"{options.plugin}: the checkpoint was trained {was}; it goes on with this one", "yellow"
        )
    return loss


def _threads(options: argparse.Namespace, group: Group) -> int | None:
    return options.threads or (None if isinstance(group, Alone) else share_of_cores())


def _check_equal(run: Run, group: Processes) -> None:
    trainer = run.trainer
    check_equal(
        group,
        {
            "options": digest(trainer.settings),
            "photos": digest(trainer.views.names(), *(view.pixels for view in trainer.views.all)),
            "points to begin with": digest(trainer.extent, trainer.centre, *trainer.splats.arrays),
            "plugin": trainer.loss.digest if trainer.loss else "",
            "checkpoint": digest(trainer.counters.iteration),
        },
    )


def lock_run(path: Path) -> None:
    """Keeps `path` for this process to write: two runs must not write the same scene and checkpoint in turns.

    Marks lie in the cache's folder, not beside the file; where none can be made nothing is claimed, which is
    no reason not to work.

    Raises:
        InputError: another process of this user's has it.
    """
    name = hashlib.sha256(os.fsencode(os.path.realpath(path))).hexdigest()[:16]
    mark = cache_folder() / "claims" / f"{name}.lock"
    if mark in _held:
        return
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        file = open(mark, "a+b")  # noqa: SIM115, for as long as the process
        if take_lock(file):
            file.truncate(0)
            file.write(str(os.getpid()).encode())
            file.flush()
            _held[mark] = file
            return
        file.seek(0)
        who = file.read(20).decode(errors="replace")
        file.close()
    except OSError:
        return
    raise InputError(
        f"{path}: another splatview (process {who}) trains into it; wait for it, or name another file with -o"
    )
