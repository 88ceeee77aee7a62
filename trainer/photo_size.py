"""The size that photos are trained on where nobody says, and how many a step takes: by the time there is, and
what will be looked at.

A step costs what its photo has of pixels. A minute on two cores is enough for three steps on photos of 12
megapixels (11.6 dB on `miku` enlarged to that) or three thousand on 0.08 megapixels, which show large
structures as well. But splats that met small photos alone are wrong where they are looked at closely: too
thin, or too coarse. So a run spends most of its time on photos that there are enough steps for, and its end
on larger ones, which the memory of a machine and the detail of a window have room for.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from splatview.scene import InputError
from splatview.scene.captures import PosedPhotos
from splatview.scene.captures.photos import downscaled_size
from splatview.trainer.adam_kernels import FEWEST_FOR_FAST
from splatview.trainer.memory import sizes_of_files
from splatview.trainer.recipe import MOST_THREADS, STEPS_OF_A_MINUTE

LARGEST_SIDE = 1600
"""px of the longer side that photos have at most, as in the code of Kerbl et al. 2023."""

SMALLEST_SIDE = 64
"""px of the shorter side that photos are made no smaller than."""

THREAD_PIXELS = 40e3
"""Pixels of a photo that a minute has steps enough for, for each thread. See `LAST_FACTOR`."""

GROWTH = 0.5
"""Exponent of the minutes: a longer run has more steps on larger photos. See `LAST_FACTOR`."""

LEAST_MINUTES = 0.5
"""Shorter runs are looks at whether all works."""

FIRST_SHARE, LAST_SHARE = 0.3, 0.2
"""Of the run: on photos of half the size that there is time for, and on larger ones."""

LAST_FACTOR = 3
"""Photos of the end are larger each way by at most this factor.

Chosen on `miku` (981x735) and `banana` (750x498), a third held out and measured in full size. A minute on
photos smaller each way by 1, 2, 3, 4 and 6: 25.72, 27.90, 28.18, 27.91 and 26.73 dB on `miku`; 25.44, 25.15,
23.11 and 22.58 by 1 to 4 on `banana`, where smaller photos show less than half. By 3 until 0.8, 0.9 and 0.95
of the run and then all of them: 28.39, 28.32 and 28.19 on `miku`, by 4 until 0.9 27.42, by 2 until 0.8 27.68;
by 2 until 0.7, 0.8 and 0.9 26.13, 26.00 and 25.96 on `banana`, by 3 until 0.9 24.89. Three minutes by 1, 2, 3
and 4: 28.06, 28.90, 28.52 and 27.89 on `miku`, by 2 until 0.9 28.82 (SSIM 0.897 in place of 0.890); 26.62 and
25.10 by 1 and 2 on `banana`, by 2 until 0.9 26.60. Ten minutes on `miku` by 1 29.02, by 2 until 0.9 29.20.
"""

Levels = tuple[tuple[float, int], ...]
"""As `TrainSettings.resolution`."""

HALF_THE_SIZE: Levels = ((FIRST_SHARE, 2),)


def pixels_for(minutes: float, threads: int) -> float:
    """Pixels of a photo that so many minutes have steps enough for."""
    return THREAD_PIXELS * min(threads, MOST_THREADS) * max(minutes, LEAST_MINUTES) ** GROWTH


Sizes = Sequence[tuple[int, int]]
"""Widths and heights of photos, px."""


def automatic_downscale(sizes: Sizes, minutes: float | None, threads: int) -> int:
    """By how much photos are made smaller each way; minutes None: as long as it takes."""
    longest, pixels = max(map(max, sizes)), sum(map(math.prod, sizes)) / len(sizes)
    factor = math.ceil(longest / LARGEST_SIDE)
    if minutes is not None:
        factor = max(factor, round(math.sqrt(pixels / pixels_for(minutes, threads)) / LAST_FACTOR))
    return min(factor, most_downscale(sizes))


def most_downscale(sizes: Sizes) -> int:
    """By how much photos may be made smaller each way."""
    return max(min(map(min, sizes)) // SMALLEST_SIDE, 1)


def sizes_of(posed: PosedPhotos) -> Sizes:
    """Of a capture's photos as its files have them, before they are read."""
    return [(entry.camera.width, entry.camera.height) for entry in posed.entries]


def downscale_for(posed: PosedPhotos, *, minutes: float | None, threads: int) -> int:
    """`automatic_downscale` of a capture, before its photos are read."""
    return automatic_downscale(sizes_of(posed), minutes, threads)


def automatic_levels(sizes: Sizes, minutes: float | None, threads: int) -> Levels:
    """The factors by which photos of these sizes are smaller along a run."""
    if minutes is None:
        return HALF_THE_SIZE
    pixels = sum(map(math.prod, sizes)) / len(sizes)
    factor = min(
        round(math.sqrt(pixels / pixels_for(minutes, threads))),
        most_downscale(sizes) // HALF_THE_SIZE[0][1],
    )
    if factor < 2:
        return HALF_THE_SIZE
    return (FIRST_SHARE, HALF_THE_SIZE[0][1] * factor), (1 - LAST_SHARE, factor)


KILOPIXEL_MS, FREE_KILOPIXELS = 0.065, 50.0
"""What a thousand pixels more cost a step on two cores, and those that `STEPS_OF_A_MINUTE` has room for.
Measured on an Intel Xeon: 12.9 and 31.0 ms with 17,500 splats for 107 and 426 thousand, 20.6 and 44.6 with
49,300."""


def steps_of_a_minute(pixels: float, levels: Levels) -> float:
    """About as many steps of one photo of so many pixels as a minute on two cores has, along these levels."""
    steps, start = 0.0, 0.0
    for until, factor in (*levels, (1.0, 1)):
        more = max(pixels / factor**2 / 1e3 - FREE_KILOPIXELS, 0.0)
        steps += max(until - start, 0.0) / (1 / STEPS_OF_A_MINUTE + more * KILOPIXEL_MS / 60e3)
        start = max(start, until)
    return steps


BATCH_STEPS, MOST_BATCH = 4_500, 2
"""Steps that a run has at least where it takes several photos a step, and photos that it takes at most."""

MANY_STEPS, MOST_OF_MANY = 7_500, 4
"""The same for more than that, where photos show something everywhere."""


def automatic_batch(
    minutes: float | None,
    steps: int | None,
    threads: int,
    of_a_minute: float = STEPS_OF_A_MINUTE,
    *,
    everywhere: bool = True,
) -> int:
    """A sensible `batch` for a run of so many minutes on so many threads; 1 where steps end it.
    `of_a_minute`: steps that a minute has for such photos, see `steps_of_a_minute`; `everywhere`: whether
    they show something everywhere.

    Three minutes of the bench, one run each (batch.json), by one photo and by two. Chosen: `skull RGBA 100`
    33.40 and 34.01 dB, by three 34.09. Judged: `playbot RGBA 100` 38.29 and 38.66, `miku` (split 1, exposures
    learnt) 30.22 and 30.25. A minute has too few steps for it: 33.48 and 32.92 on `skull RGBA 100` at half
    the size. Where steps end a run, more photos in each bring nothing: `banana`, 6,000 steps by one, two and
    three, 27.79, 27.73 and 27.61.

    Large photos have fewer steps. Three minutes by one and two photos, 3,200 to 4,600 steps by two. Chosen:
    `lego` at 800x800 30.79 and 30.19 dB. Judged: `miku` at 981x735 29.35 and 29.29, `bonsai` 25.63 and 25.64,
    `chair` at 800x800 32.14 and 32.26.

    Ten minutes by two and by four (batch_long.json). Chosen: `miku` 31.09 and 31.21 dB (three splits, of
    which none loses; by three, one split, +0.16). Judged: `building` at a third of the bench's size, every
    8th photo held out, 20.84 and 21.08, and, where photos show an object, `lego` 35.96 and 36.04, but `skull
    RGBA 100`, which shines, 34.40 and 34.21 (by three 34.28): these keep two. Dropped, for `miku`: three
    scenes of its photos and a last one that learns from them, 30.63 in place of 30.77 (split 0); 36,000
    splats at most, of which 22,000 are left (in place of 56,000), 30.72.
    """
    if minutes is None or steps is not None:
        return 1
    photos = of_a_minute * minutes * min(threads, MOST_THREADS) / 2
    most = min(max(int(photos / BATCH_STEPS), 1), MOST_BATCH)
    return max(most, min(int(photos / MANY_STEPS), MOST_OF_MANY)) if everywhere else most


GROWTH_BATCH, GROWTH_PHOTOS = 4, 6_000
"""Photos of a step while splats grow, and those that a run has time for at least where steps take so many."""


def automatic_growth_batch(
    minutes: float | None,
    steps: int | None,
    threads: int,
    of_a_minute: float = STEPS_OF_A_MINUTE,
    *,
    photos: int = FEWEST_FOR_FAST,
    everywhere: bool = True,
) -> int:
    """A sensible `growth_batch`, as of `automatic_batch`, for a capture of so many photos; 1 where `steps`
    end the run before the minutes do.

    Three minutes by one and by four while splats grow (batch_growth.json), and their loss at a
    twentieth of the run: from there on `mug` (0.062) 30.06 and 30.51 dB, SSIM 0.858 and 0.874, `beer` (0.066)
    24.61 and 24.95; from a tenth on these 30.29 and 24.82, `room` (0.103) 22.91 and 23.04, `gum` (0.080)
    26.64 and 26.65 (two runs), `field` (0.059) 29.01 and 29.17; by four all along `fruit` (0.068) 28.52 and
    28.80, `games` (0.063) 28.08 and 28.04; four from half of the run on, 29.90 on `mug`. Of what is met
    better `fox` (0.049) gains 0.37, but `mouse` (0.055) loses 0.34 (two runs), `coke` (0.019) 0.31 and
    `carton` (0.044) 0.08: the least loss is between. Judged by `bedroom` (0.060), 25.90 and 25.94, and
    `museum` (0.112), 19.55 and 19.15, SSIM 0.679 and 0.687. Ten minutes of `beer` so, from a tenth on, have
    24.57. What tells it no better: how much of a splat's gradient is alike from step to step. Dropped: four
    all along, `mug` 30.49, though `beer` (split 1) has 27.59 in place of 27.35.
    """
    if minutes is None or not everywhere or photos < FEWEST_FOR_FAST:
        return 1
    looked_at = of_a_minute * minutes * min(threads, MOST_THREADS) / 2
    return GROWTH_BATCH if GROWTH_PHOTOS <= looked_at < (math.inf if steps is None else steps) else 1


@dataclass
class SizeChoice:
    """By how much photos are made smaller, by what a capture says before they are read."""

    asked: int | None
    """What the user has asked for."""
    minutes: float | None
    threads: int
    room_for: Callable[..., object]
    """Raises InputError where the run has no room for photos of such sizes."""
    factor: int = 1
    line: str = ""
    """What was decided and why, where photos are made smaller."""

    def __call__(self, posed: PosedPhotos) -> int:
        """The factor. Raises InputError."""
        if self.asked is not None:
            # The least that it can be: what photos really are is told once they are read.
            least = replace(sizes_of_files(posed.entries, self.asked), trained=0, planes=3)
            self.room_for(least, points=sys.maxsize)
            self.factor = self.asked
            return self.factor
        sizes = sizes_of(posed)
        most = most_downscale(sizes)
        first = self.factor = automatic_downscale(sizes, self.minutes, self.threads)
        while True:
            try:
                self.room_for(sizes_of_files(posed.entries, self.factor), points=len(posed.points))
                break
            except InputError:
                if self.factor >= most:
                    raise
                self.factor += 1
        if self.factor > 1:
            whole = max(sizes)
            smaller = "{}x{}".format(*downscaled_size(*whole, self.factor))
            all_of_them = "; --downscale 1 trains on all their pixels"
            why = f"{LARGEST_SIDE} px are the most{all_of_them}"
            if self.factor > first:
                why = "there is memory for no more"
            elif first > automatic_downscale(sizes, None, self.threads):
                why = f"--minutes {self.minutes:g} has no time for more{all_of_them}"
            self.line = f"photos of {whole[0]}x{whole[1]} px are trained on at {smaller}: {why}"
        return self.factor
