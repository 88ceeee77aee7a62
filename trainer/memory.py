"""Memory that a run takes at its peak, stated before it begins, and the number of splats that a bound allows.

What is held is counted: photos in their sizes, the arrays of each splat, the buffers of the largest picture.
What cannot be counted is measured, by `tools/bench/bench_training_memory.py`: the constants are fits to its
runs on `banana` and `playbot RGBA 100`, judged on the others.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from splatview.raster.compiling import TASKS_PER_THREAD, available_threads, will_compile
from splatview.scene import InputError
from splatview.scene.captures import Capture
from splatview.scene.captures.assemble import HOLD_OUT_EVERY, MAX_READERS
from splatview.scene.captures.capture import PosedPhoto
from splatview.scene.captures.panoramas import pixels_of_file
from splatview.scene.captures.photos import downscaled_size
from splatview.scene.errors import bytes_in_words
from splatview.scene.formats.io import resident_memory
from splatview.scene.formats.ply_body import free_memory
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.trainer.recipe import pictures_taught
from splatview.trainer.stereo import MOST_PHOTOS, PIXELS, PIXELS_PER_POINT

MARGIN = 1.03
"""Factor of the sum: equal runs differ by some percent, and a bound must hold."""

PROGRAM_BYTES = 420e6
"""The program with torch and the kernels of training loaded."""

COMPILER_BYTES = 250e6
"""What the compiler leaves where kernels are not on disk yet."""

WINDOW_BYTES = 250e6
"""What a window takes besides: its interface, fonts, OpenGL and the picture."""

READ_BYTES = 6
"""Of a pixel of a photo while it is decoded and made smaller."""

STEREO_BYTES, STEREO_PIXEL_BYTES = 60e6, 30
"""Of its kernels, and of a pixel of the photos that are swept."""

PIXEL_BYTES = 125
"""Of a pixel of the largest photo: the picture and its gradient, maps of the loss."""

COMPARED_BYTES = 240
"""The same while a picture is compared with a photo held out, in float64."""

BUFFER_BYTES = 205
"""Per splat, in buffers of a picture: its record, depth, place in the order, and sums of its gradient."""

PAIR_BYTES = 72
"""Per splat and tile: its span, its place in the list, and the sums of its gradient there."""

PAIRS = (2.0, 10.0, 150.0)
"""Factors of `pairs`."""

FREED = 0.8
"""Copies of the splats and Adam's averages that density control has left behind: it makes arrays anew when it
adds splats, and the allocator keeps much of the old."""

CHECKPOINT = 2
"""Copies of the same while a checkpoint is written."""

SNAPSHOTS = 3
"""Copies of the splats that a window holds: the published one, the shown one, and what it is drawn from."""

TAUGHT_PLANES = 4
"""Bytes of a pixel of the pictures of an ensemble: colours and opacity."""

TILE_PIXELS = 256

AVAILABLE_SHARE = 0.9
"""Of the memory that the machine has left: what a run takes where no bound is asked for."""


@dataclass(frozen=True, kw_only=True)
class PhotoSizes:
    """What the memory of photos depends on; sizes are those that are trained on."""

    pixels: int
    """Of all photos together, those held out included."""
    trained: int
    """Of the photos to train on."""
    largest: int
    """Of the largest photo."""
    stored: int
    """Of the largest photo as its file has it."""
    planes: float = 3
    """Bytes of a pixel: colours, opacity, mask."""


def sizes_of_files(entries: Sequence[PosedPhoto], downscale: int) -> PhotoSizes:
    """By what a capture says before its photos are read: they may yet turn out to be transparent, and which
    are held out may be left to `HOLD_OUT_EVERY`."""
    sizes = [(entry.camera.width, entry.camera.height) for entry in entries]
    pixels = [math.prod(downscaled_size(*size, downscale)) for size in sizes]
    held_out = [1 / HOLD_OUT_EVERY if entry.held_out is None else float(entry.held_out) for entry in entries]
    return PhotoSizes(
        pixels=sum(pixels),
        trained=round(sum(size * (1 - out) for size, out in zip(pixels, held_out, strict=True))),
        largest=max(pixels, default=0),
        stored=max(map(pixels_of_file, entries), default=0),
        planes=3 + any(entry.mask is not None for entry in entries),
    )


def sizes_of_capture(capture: Capture) -> PhotoSizes:
    """By a capture whose photos were read."""
    pixels = [photo.camera.width * photo.camera.height for photo in capture.photos]
    found = capture.statistics
    return PhotoSizes(
        pixels=sum(pixels),
        trained=sum(size for size, photo in zip(pixels, capture.photos, strict=True) if not photo.held_out),
        largest=max(pixels),
        stored=max(pixels),
        planes=3 + (found.hidden > 0) + (found.transparent > 0),
    )


@dataclass(frozen=True, kw_only=True)
class RunMemory:
    """What a run's peak is made of, bytes."""

    program: float
    photos: float
    """In all sizes that are held at once."""
    pictures: float
    """Buffers of the largest picture, whatever it shows."""
    start: float
    """Peak before the first step."""
    splat: float
    """Of one splat in all steps."""
    saved: float
    """Of one splat besides while a checkpoint is written."""
    largest: int
    """Pixels of the largest photo."""

    def splats(self, count: int) -> float:
        """What so many splats take, in arrays of their own and in buffers of a picture."""
        return count * self.splat + PAIR_BYTES * pairs(count, self.largest)

    def peak(self, count: int) -> int:
        """Peak of a run with at most so many splats."""
        transient = max(count * self.saved, self.largest * COMPARED_BYTES)
        steady = self.program + self.photos + self.pictures + self.splats(count)
        return math.ceil(MARGIN * max(self.start, steady + transient))

    def most_splats(self, bound: float) -> int:
        """The largest number of splats whose peak is within `bound`; 0 where there is none."""
        low, high = 0, 1
        while self.peak(high) <= bound:
            low, high = high, 2 * high
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.peak(middle) <= bound else (low, middle)
        return low


def pairs(splats: int, pixels: int) -> float:
    """Pairs of splats and tiles that meet, in a picture of so many pixels that so many splats cover: some
    for each splat, more where splats are large for being few, and those that a scene has as it begins."""
    each, by_size, by_tile = PAIRS
    tiles = pixels / TILE_PIXELS
    return each * splats + by_size * math.sqrt(splats * tiles) + by_tile * tiles


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What the memory of a run depends on besides the run."""

    left: int
    """Bytes that this process may take, those that it has included."""
    threads: int
    compiles: bool
    """Whether kernels have to be compiled first."""

    @classmethod
    def here(cls, threads: int | None = None, processes: int = 1) -> Machine:
        """This one, shared with so many processes alike; threads: None means all cores."""
        left = (resident_memory() or 0) + free_memory() / processes
        return cls(
            left=int(AVAILABLE_SHARE * left),
            threads=threads or available_threads(),
            compiles=will_compile(),
        )

    @classmethod
    def least(cls, machines: Sequence[Machine]) -> Machine:
        """The one that takes the most and has the least: processes of a run must decide alike."""
        return cls(
            left=min(machine.left for machine in machines),
            threads=max(machine.threads for machine in machines),
            compiles=any(machine.compiles for machine in machines),
        )


def begins_by_stereo(start: str, *, points: int, pixels: int) -> bool:
    """Whether stereo looks for surfaces, by `TrainSettings.start`, where the capture has so many points of
    its own and its largest photo so many pixels."""
    return start == "stereo" or (start == "auto" and points * PIXELS_PER_POINT < min(pixels, PIXELS))


def own_points(capture: Capture) -> dict[str, int]:
    """What `begins_by_stereo` asks of a capture whose photos were read."""
    points = 0 if capture.guessed else len(capture.points)
    return {"points": points, "pixels": sizes_of_capture(capture).largest}


def run_memory(
    sizes: PhotoSizes,
    *,
    resolution: Iterable[tuple[float, float]] | None,
    batch: int = 1,
    sh_degree: int = 3,
    stereo: bool = False,
    ensemble: int = 1,
    machine: Machine,
    window: bool = False,
) -> RunMemory:
    """Of a run on a machine. `resolution`, `batch`, `sh_degree` and `ensemble` are those of `TrainSettings`,
    the last 1 where it trains one scene alone; `stereo`: splats begin where stereo finds surfaces."""
    factors = [2.0] if resolution is None else [factor for _, factor in resolution if factor > 1]
    smaller = sizes.trained / min(factors) ** 2 if factors else 0.0
    photos = sizes.planes * sizes.pixels
    if ensemble > 1:
        taught = pictures_taught(max(sizes.trained // sizes.largest, 1), sizes.largest) * sizes.largest
        smaller += TAUGHT_PLANES / sizes.planes * taught * (1 + (1 / min(factors) ** 2 if factors else 0))
    swept = min(sizes.trained, MOST_PHOTOS * min(sizes.largest, PIXELS)) if stereo else 0
    program = PROGRAM_BYTES + window * WINDOW_BYTES + machine.compiles * COMPILER_BYTES
    program += stereo * STEREO_BYTES + swept * STEREO_PIXEL_BYTES
    readers = min(MAX_READERS, os.cpu_count() or 1)
    pieces = TASKS_PER_THREAD * machine.threads
    parameters = 4 * (11 + 3 * SH_COEFFICIENTS[sh_degree])
    held, gradients = 3 * parameters + 8, parameters + 16
    return RunMemory(
        program=program,
        photos=photos + sizes.planes * smaller,
        pictures=sizes.largest * (PIXEL_BYTES + 2 * 8 * pieces / TILE_PIXELS),
        # Photos twice: as they were read, and as they are trained on.
        start=program + photos + max(photos, readers * READ_BYTES * sizes.stored),
        splat=held * (1 + FREED)
        + gradients * (1 + (batch > 1))
        + BUFFER_BYTES
        + (ensemble + 1) * parameters * (ensemble > 1)  # its scenes, and a copy of the first
        + window * SNAPSHOTS * (parameters + 20),
        saved=held * CHECKPOINT,
        largest=sizes.largest,
    )


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Memory that a run may take."""

    bytes: int
    asked: bool
    """Whether the user has said so; otherwise it is what the machine has left."""

    @property
    def in_words(self) -> str:
        size = bytes_in_words(self.bytes)
        return f"--memory allows {size}" if self.asked else f"this machine has {size} left for it"


def check_fits(memory: RunMemory, bound: Bound, splats: int, what: str, advice: str) -> None:
    """Raises InputError where the run cannot have so many splats, be it the photos' fault or their own.

    `what` needs the memory; `advice` says what to do, with {} for the size that is enough.
    """
    needed = memory.peak(splats)
    if not needed <= bound.bytes:
        raise InputError(
            f"{what} need about {bytes_in_words(needed)} of memory, of which photos take"
            f" {bytes_in_words(memory.photos)}, and {bound.in_words};"
            f" {advice.format(f'{math.ceil(needed / 1e6)}MB')}"
        )


@dataclass(frozen=True, kw_only=True)
class MemoryPlan:
    """What a run will take, as it is stated."""

    memory: RunMemory
    bound: Bound
    most: int
    """Splats that the bound has room for."""
    splats: int
    """Most splats of the run."""
    wanted: int
    """Most splats without a bound."""

    @property
    def peak(self) -> int:
        """Bytes."""
        return self.memory.peak(self.splats)

    @property
    def line(self) -> str:
        """The statement, with what the bound has changed."""
        memory = self.memory
        text = f"memory: about {bytes_in_words(self.peak)} at most"
        text += (
            f" ({bytes_in_words(memory.photos)} for photos,"
            f" {bytes_in_words(memory.splats(self.splats))} for up to {self.splats:,} splats)"
        )
        if self.bound.asked or self.splats < self.wanted:
            text += f"; {self.bound.in_words}"
        if self.splats < self.wanted:
            text += f", so that {self.wanted:,} splats become {self.splats:,} at most"
        return text


def plan(memory: RunMemory, bound: Bound, wanted: int) -> MemoryPlan:
    """As many of the `wanted` splats as the bound has room for; `check_fits` has passed for fewer."""
    most = max(memory.most_splats(bound.bytes), 1)
    return MemoryPlan(memory=memory, bound=bound, most=most, splats=min(wanted, most), wanted=wanted)
