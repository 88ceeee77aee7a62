"""What suits a capture by the number of its photos, their pixels and the time there is: the recipe's rules.

Each says by which captures it was chosen and which have judged it. `setup.settings_for` puts them together.
"""

from __future__ import annotations

import math

from splatview.trainer.adam_kernels import FAR_FROM, FEWEST_FOR_FAST, REST_DIVISOR
from splatview.trainer.strategies.mcmc import LEAST_REG

PIXELS_PER_SPLAT = 8
"""Pixels of all photos that a splat is for, where minutes limit the run. Two and four times as many as with
30, one run each with a third held out. Chosen: `banana` at half the bench's size 27.80, 28.42 and 28.61 dB
after a minute, `biker front 24` there 41.45, 42.45 and 43.16, `miku 12 far` 21.49, 22.40 and 22.40. Judged:
`miku 8 near` 27.49, 28.03 and 27.99."""

PIXELS_PER_SPLAT_UNTIMED = 30
"""The same where only steps do: each takes longer, and photos of many pixels have little more to show."""

SPLATS_FOR_A_MINUTE = 35_000
"""What a minute can train; longer runs by the square root, as steps become slower too. Twice as many bring
little for files and frames of twice the size: `miku` -0.14 dB, `playbot RGBA 100` +0.16, `lego` +0.02;
after three minutes 0.00, +0.21, +0.14 (split 0). 20,000 cost `miku` 0.26.

Dropped: after three minutes as many as after one, 25,000 to 35,000, where more learn by heart. `beer` (split
1) 27.94 in place of 27.35 dB, `spot RGBA 60` 48.04 of 47.27, `imp` 22.40 of 22.08, `mouse` (split 1) 26.58 of
26.40, `cat` 37.39 of 37.34, but `miku 40 far` (split 2) 27.40 of 27.45, `liberty` 22.56 of 22.60, `mug` 30.36
of 30.51, `skull RGBA 100` 34.00 of 34.17, `playbot close 80` 28.05 of 28.30, `playbot RGBA 100` 38.50 of
38.94, `gum` 26.49 of 26.95. How faint splats are does not tell which: no growth while half of them are
fainter than 0.065, `beer` 27.54 (9,030 splats), `mug` 30.24 (17,239)."""

ONCE_PIXELS, MOST_DETAIL = 120e3, 2.0
"""Pixels that show a scene once, from which on there are more, by the square root, and how many times as many
at most. Three minutes, split 0, twice as many and as before (docs/training-recipe.md has more, and SSIM).
Chosen: `banana` of 750x498 px 26.79 and 26.21 dB, `building` 19.25 and 18.96, `bonsai` 25.99 and 25.64 (four
times as many 25.91), `miku` of 981x735 29.39 and 29.29; `lego` of 800x800, which is transparent, 29.84 and
30.19."""

STEPS_OF_A_MINUTE = 3_000
"""About as many steps, of one photo each, are made in a minute on two cores with so many splats. Where steps
end a run, more minutes allow no more splats: `banana`, given ten minutes that its 6,000 steps do not take,
scores 27.93 and 24.75 dB with 110,700 splats (splits 0 and 1), 27.86 and 25.11 with 49,500, in two thirds of
the time. One run each, of which chance makes 0.4 dB; no other capture has judged it."""

LEAST_LIMIT, MOST_LIMIT = 2_000, 2_000_000


def automatic_limit(
    pixels: int, minutes: float | None = None, steps: int | None = None, once: float = 0.0
) -> int:
    """A sensible `max_splats` for photos of so many pixels together, and a run of so many minutes; of fewer
    where `steps` end it sooner. `once`: pixels that show the scene once, see `ONCE_PIXELS`."""
    limit = pixels // (PIXELS_PER_SPLAT_UNTIMED if minutes is None else PIXELS_PER_SPLAT)
    if minutes is not None:
        used = minutes if steps is None else min(minutes, steps / STEPS_OF_A_MINUTE)
        detail = min(max(math.sqrt(once / ONCE_PIXELS), 1.0), MOST_DETAIL)
        limit = min(limit, round(SPLATS_FOR_A_MINUTE * detail * math.sqrt(used)))
    return min(max(limit, LEAST_LIMIT), MOST_LIMIT)


MOST_THREADS = 8
"""More are not counted on: cores share their memory, and a part of each step is for one thread."""

MOST_REG = 0.1


def automatic_regularisation(photos: int, covered: float = 1.0) -> float:
    """Sensible `opacity_reg` and `scale_reg` for so many photos, which show something in this share of their
    pixels, see `TrainViews.covered`: the fewer, the stronger; the less they show, the weaker.

    Splats that serve few views then fade. On held-out photos of `banana` (13 to train on) 0.1 scores
    0.6 dB more than 0.01, on those of `miku` (84) 0.6 dB less.

    The photo loss is a mean over pixels, the regularisers are means over splats, all of which are where
    something is: on photos that are empty for the most part they press harder than on others. One run each
    in full size, a third held out (regularisers.json), by the number of photos alone and by both. Chosen:
    `biker front 24` (20 % of its pixels show something) 41.08 and 42.91 dB after a minute, `train front 30`
    (6 %) 38.06 and 41.41 after three. Judged, a minute: `guitar RGBA 24` (16 %) 39.57 and 40.24, `playbot
    RGBA 18` (36 %) 30.35 and 30.88, `skull RGBA 24` (46 %) 27.79 and 27.78, `skull RGBA 100` 32.71 and 32.56.

    Since copies are shared only so far (`strategies.mcmc.LEAST_SHARED`) it still takes both: by the number of
    photos alone and by both `biker front 24` scores 41.31 and 42.92 dB, `guitar RGBA 24` 39.69 and 40.31
    after a minute, `train front 30` 44.07 and 45.60 after three.

    Dropped, before that: fewer splats for it, too. One for 8 and 4 pixels that show something, and for 8 of
    all, three minutes: `biker front 24` 43.40, 44.07 and 44.55 dB, `train front 30` (exposures off) 45.38,
    43.97 and 41.97, which has 1,000 splats and 45.63 after one minute; a minute by 8, `guitar RGBA 24` 40.05,
    `playbot RGBA 18` 30.82. Dropped, too: by the least loss so far in place of the present one in
    `FULL_REG_LOSS`, which rose there for a while, 41.81.

    Dropped: to go by how many photos show the same place instead of how many there are. `playbot close 80` of
    the bench (53 to train on, each of which shows a part) scores 26.50 dB by its number of photos, 26.31 with
    the rules for few.

    Not taken: a third as strong, a minute ("weaker" in regularisers.json). 10 to 13 photos gain: `banana` 0.3
    dB, every 8th held out 28.81 and 29.05 (three splits), `miku 20 far` 0.55 and 0.09, `fern` 26.50 and 26.90
    after three minutes; 8 neither gain nor lose, `miku 40 far` (26) has 27.70 and 27.59 (three splits).
    """
    return min(max(1.3 / max(photos, 1), LEAST_REG), MOST_REG) * covered


def automatic_far_from(photos: int, everywhere: bool) -> float:
    """A sensible `far_from` for so many photos, see `FAR_FROM`; `everywhere`: see `automatic_steps`."""
    return FAR_FROM if everywhere and photos >= FEWEST_FOR_FAST else math.inf


FULL_REG_LOSS = 0.02
"""Photo loss, a running mean, below which `opacity_reg`, `scale_reg` and `dropout` go down, and `max_aspect`
goes up, in proportion: what keeps a scene from learning few photos by heart also keeps it from meeting
photos that it could meet, and their number alone does not tell which.

One run each with a third held out, half the bench's size (`generalisation_run --smaller 2`, steps as
below). Chosen: 0, 0.02 and 0.04 score 38.66, 40.17 and 41.03 dB on `biker front 24` after 3,840 steps,
20.86, 20.86 and 20.74 dB on `miku 12 far` after 4,800; 0 and 0.02 score 29.61 and 29.51 dB on `playbot RGBA
18` after 7,200. Judged: 36.51 and 37.83 dB on `guitar RGBA 24` after 2,880; `miku 12 near` and `train front
30`, whose losses stay above, are the same after 4,800 and 3,600. In full size a minute on `guitar RGBA 24`
scores 36.76 and 38.06 dB.

Dropped: twice as much where photos are transparent, which tell what is empty. Chosen on `guitar RGBA 24`,
38.14 and 39.17 dB, and `playbot RGBA 18`, 30.76 and 31.16; judged by `skull RGBA 24`, which shines: 28.22 and
28.26 (two seeds) become 28.01 and 27.98. For all photos: `banana` +0.1 and +0.3, `miku 20 far` +0.3, `miku 20
near` -0.5 and -0.4. Dropped too: in proportion to the square, 38.19 on `guitar RGBA 24`.
"""

GROWTH_LOSS, GROWTH_BATCH_FROM = 0.058, 0.05
"""Photo loss, a running mean, above which steps look at more photos while splats grow, and the share of the
run at which that is decided. See `photo_size.automatic_growth_batch`."""

FULL_REG_OPACITY = 0.06
"""Median opacity of the splats, below which the weight of opacity goes down, see
`strategies.mcmc.ease_of_faint`: where texture is weak, as of a table's wood, the photo loss has little
against that weight, so that splats are as faint as copies may be (`strategies.mcmc.LEAST_SHARED`), die, and
leave a smooth table, the more so the longer a run is. As a minute's number of splats grows, the median comes
to 0.03 or 0.04 on `mug`, `beer`, `coke`, `desk` and `fruit`, to 0.06 to 0.08 on `cat`, `miku` and `field`,
and stays at 0.09 to 0.14 on `gum`, `fox`, `skull RGBA 100` and `games`.

Chosen on split 0 after three minutes of `mug`, 29.59 dB without and 30.13 with it, and `fruit` 28.73 and
28.63 with an SSIM of 0.765 and 0.769 (faint.json). Dropped: down to a twentieth of the weight, in place of a
third, 30.34 on `mug`, 25.03 in place of 24.45 on `beer`, but 28.41 on `fruit` and 37.32 of 37.43 on `coke`; a
weight of 0.002 (0.003 for `beer`) whatever the opacities, 30.51 dB on `mug` and 25.54 on `beer`, but 26.53 of
27.11 on `gum` and 30.70 of 30.93 on `miku`. That of opacity alone makes it, 30.52 on `mug`, and 29.71 by that
of scale alone. Dropped on `mug`, before that: colours by direction that change more slowly, +0.2 dB, and
several shorter scenes in its three minutes, 28.74.

Dropped, in its place: to cap what the weight adds to a splat's gradient by a tenth of that's root mean square
(capped.json): `mug` 30.03 dB after three minutes, `beer` 24.99, but `miku` 30.25 in place of 30.48 after one.
A tenth of the weight from the end of growth on, in place of either: 29.66 on `mug`."""


def automatic_full_reg_opacity(photos: int) -> float:
    """A sensible `full_reg_opacity` for so many photos: few ones need the weight of opacity, however faint
    splats are. A minute of split 0 of `queen` (15 photos) has 19.99 dB without it and 19.29 with it (down to
    a twentieth), `miku 20 far` (13) 23.57 and 23.17, `beach` (12) 18.70 and 18.59."""
    return FULL_REG_OPACITY if photos >= FEWEST_FOR_FAST else 0.0


MET_OF_OBJECTS = 0.035
"""Of the share of the photos' pixels that show an object: the loss below which these are met well. The loss
is a mean over all pixels, most of which are empty and right at once, so that `FULL_REG_LOSS` tells nothing.

After three fifths of a scene of 2,769 steps it is 0.047 and 0.054 of that share on `banana cut out` (splits 0
and 1), whose masks contradict one another, and 0.028 on `playbot RGBA 18`, which was rendered. Three minutes
of one long scene, and of two or three so short and a last one: 27.98 and 29.18, 29.23 and 31.01 dB, 31.32 and
31.18 (chosen on these). Judged by `mother`, whose masks agree (0.024): 33.41 and 33.20 dB after a fit. By the
rule, where a scene goes by a short one's schedule until then, `playbot RGBA 18` has 31.57 dB, `mother` 33.41,
`skull RGBA 24` 27.78, and 27.97 without (one run each; objects.json).

Dropped: `FULL_REG_LOSS` times that share, so that regularisers stay where masks are poor: `banana cut out`
27.98 and 28.23 dB after three minutes, `mother` 33.13 and 33.16, but `guitar RGBA 24` 40.15 and 39.53 after
one, `playbot RGBA 18` 31.18 and 30.98, `biker front 24` 42.92 and 42.00."""


def automatic_met_loss(covered: float, everywhere: bool) -> float:
    """A sensible `met_loss` for photos that show something in this share of their pixels, see
    `TrainViews.covered`; `everywhere`: see `automatic_steps`."""
    return FULL_REG_LOSS if everywhere else MET_OF_OBJECTS * covered


LEAST_DROPOUT, MOST_DROPOUT = 0.05, 0.2
"""The second is that of Park et al. 2025, for 3 to 24 photos."""


def automatic_dropout(photos: int) -> float:
    """A sensible `dropout` for so many photos: the fewer, the more; none from about fifty on.

    On held-out photos of `banana` (13 to train on) after 8,000 steps at half size 0.2 scores 0.2 dB more
    than none, and 0.6 dB more after 4,000 at a quarter. Many photos have no use for it: 0, 0.1 and 0.2 score
    33.48, 33.38 and 33.34 dB on `skull RGBA 100` at half the bench's size.

    Dropped: besides, to move splats by chance in each step, in the end by 0.3 of their size, after Zhao et
    al. 2025, SE-GS. Three minutes, 400 steps per photo, three splits each (runs in steps.json). Chosen by a
    minute of `miku 12 far` and `near`, which after three have 21.21 and 21.52, 27.21 and 27.28 dB without and
    with it; judged by `banana` 26.83 and 26.86, `toy` 21.53 and 21.57, `kermit` 18.61 and 18.47, `bust` 18.58
    and 18.42, `castle` 17.07 and 16.80. Dropped, too: to leave out whole cells of space, -0.06 and +0.18 dB
    after a minute of `miku 12 far` and `near`.

    Dropped, too: the mean of the parameters over the last fifth to two fifths of a run, taken every ten
    steps, in place of what the last step left. A minute, one split each: `miku 12 far` 24.84 and 24.83 dB in
    place of 24.88, `toy` 22.73 in place of 22.85, and 20.39 of 20.40 (over the last three tenths).
    """
    share = min(2.6 / max(photos, 1), MOST_DROPOUT)
    return share if share >= LEAST_DROPOUT else 0.0


FEWEST_FOR_SH, LEAST_SH_DIVISOR = 20.0, 3.0

SH_STEPS = 10_000
"""Steps from which on the higher bands of SH go as far in a run, however long. The divisor of the paper's
30,000 is 20.

Ten minutes of the bench, 30,000 steps of one photo each, with 3 and 9, one run each. Chosen: `miku`, a photo
of which has an edge that glows where no photo looked at it from, 30.61 and 30.90 dB, 30.62 and 30.89 (splits
0 and 1, after a fit of exposures; 30.89 and 31.04 after three minutes). Judged: `playbot RGBA 100` 39.21 and
39.70, `skull RGBA 100`, which shines, 35.20 and 35.02 (split 1; 34.79 after three minutes)."""


def automatic_sh_divisor(shown: float, steps: float = SH_STEPS) -> float:
    """A sensible `sh_divisor` where so many photos show a place, see `TrainViews.photos_of_a_place`: from
    more directions higher bands may follow faster what shines; from few they learn single photos by heart,
    and from many in a run of many `steps`, see `SH_STEPS`.

    One minute of the bench, one split. Chosen, with 20, 5 and 2: `playbot RGBA 100` (51 show a place) 36.51,
    37.30 and 37.37 dB; at half the size `banana` (10) 28.71, 28.50 and 28.06, `biker front 24` (16) 42.86 and
    42.58 with 20 and 5; `miku 12 far` (7, split 1) 19.20 and 18.52. `playbot close 80` (19 of 53) scores
    26.72, 26.34 and 25.85 with 20, 7 and 3.8, so it does not go by the number of all photos; `miku` (51)
    28.91, 29.25 and 29.04 with 20, 3.6 and 2, without correction of exposures. Judged: `skull RGBA 100` (51),
    which shines, 29.82, 32.19 and 32.98; after three minutes 33.47 and 33.06 with 3 and 2.

    Dropped: more than 20 where fewer photos show a place: with 200 `miku 12 far` and `near` have 0.45 and
    0.40 dB less, `kermit` 0.42 more (three, three and two splits; chance is as large).

    Dropped: not to count photos from which nearer points hide a place. `building`, which photos surround (37
    of 42 by their frames, 27 so), has 18.96 dB after three minutes, 19.27 by the latter and 19.48 with 20;
    but with 20 `skull close 80` has 20.22 in place of 20.37, `mouse` 26.09 of 26.39, `fox` 30.49 of 30.45.

    Dropped: none where few photos show a place: `bust` 19.35 in place of 18.76 dB, `castle` 16.83 of 17.01,
    `beach` 18.51 of 18.60 after a minute, `statue` 19.22 of 19.02 after three (three splits each).

    Judged later, a minute by this rule and with 20: `gum` (66) 25.37 and 24.53 dB, `coke` (74) 36.17 and
    35.51, `mug` (51) 29.82 and 29.45, `fox` (28) 29.74 and 29.53, `carton` (42) 26.99 and 26.85. Three
    minutes of `mug`, which loses with time, have 29.70, and with 9 and 20 29.85 and 29.89; `gum` 26.99 and
    26.75 with 9.

    Dropped: to make the higher bands decay, by 0.0005 in each step, against what they learn by heart (39.79
    dB on the photos trained on): `skull RGBA 100` at half the size 33.47 dB without, 33.06 with.
    """
    divisor = max(REST_DIVISOR * (FEWEST_FOR_SH / max(shown, 1.0)) ** 2.5, LEAST_SH_DIVISOR)
    return min(divisor * max(steps / SH_STEPS, 1.0), float(REST_DIVISOR))


FEW_PHOTOS = 50

LONGEST_OF_FEW = 6.0


def automatic_max_aspect(photos: int) -> float:
    """A sensible `max_aspect` for so many photos: where they are few, needles make out a texture in the
    photos, and streaks in between.

    On held-out photos of `banana` (13 to train on) after 8,000 steps at half size 6 scores 0.24 dB and 0.02
    SSIM more than none.
    """
    return LONGEST_OF_FEW if photos < FEW_PHOTOS else math.inf


STEPS_PER_PHOTO, LEAST_STEPS = 600, 3_000

STEPS_BY_PHOTOS, LEAST_PER_PHOTO, FEWEST = 46.5, 300, 13
"""Steps per photo for each photo of those that show something everywhere, and the fewest. So 8 photos are
done with within a minute, as a rule, and from the third number on nothing is different."""


def automatic_steps(photos: int, everywhere: bool = False, shown: float = math.inf) -> int | None:
    """Steps after which a run on so few photos should be over; None: they are not few. `everywhere`: whether
    they show something everywhere, and so say of no place that it is empty; `shown`: how many of them show a
    place, see `TrainViews.photos_of_a_place`.

    On held-out photos of `banana` (13 to train on, half size) runs of 8,000 and of 16,000 steps both score
    28.74 dB; without a limit to the aspect they score 28.8 and 28.2 dB, and one of 67,000 steps, with
    neither dropout nor fading regularisers, 26.6 dB: what is left to learn by then is single photos. With
    10 photos to train on, at half that size, 6,000 and 18,000 steps score 27.84 and 27.29 dB.

    Photos that say where nothing is make good use of them: 400 per photo and 600, with as many splats, half
    the bench's size, `playbot RGBA 18` 30.72 and 30.76 dB, `skull RGBA 24` 28.15 and 28.22. What shows
    something everywhere is learnt by heart the sooner, the fewer photos contradict it, since the mean colour
    behind it (`surround`) makes what one photo shows opaque, and sharp. Three minutes, three splits each, by
    300, 400 and 600 per photo (assets/benchmarks/steps.json). Chosen: `toy` (6 photos) 21.66, 21.53 and
    21.12 dB, `bust` (7) 18.11, 18.58 and 17.81, `kermit` (7) 18.60, 18.61 and 18.56, `banana` (10) 26.64,
    26.83 and 26.72, and, 13 of its photos in the command's own three minutes, 400 and 600, 28.76 and 29.19
    dB, SSIM 0.822 and 0.836. Judged: `castle` (7) 17.01, 17.07 and 17.18, `miku 12 near` (8) 27.32, 27.21 and
    27.11, `miku 12 far` (8) 21.03, 21.21 and 21.47: what is lost there is less than chance, in half the time.
    (Compared before black two thirds of the steps had 0.8 dB less on `kermit`, 0.2 on `toy` and 0.2 more on
    `bust`.)

    Where a place is shown by half of so few photos or fewer, their number is its geometric mean with that of
    those: `beach` (4 of 12), on which that was chosen, has 18.52, 18.58 and 18.52 dB after three minutes with
    30,000 splats at most, 18.29, 18.39 and 18.35 by their number alone. By as many as there are in three
    minutes it has 18.58, 17.55 and 18.52: the second is chance.

    Dropped: by how many photos show a place, half the steps where these are fewer than six, and one splat
    for 30 pixels. `beach` (4 of 12) has 18.24 and 18.36 dB in place of 17.26 and 17.90, but `demo hard 40`
    (3 of 26) 29.23 and 30.17 in place of 29.39 and 30.47 (two splits each, three minutes), and `demo lens
    40`, as sparse, gains 3.6 between 5,000 and 11,000 steps.

    Dropped: as many steps as there is time for, where there is none for a second scene. Three minutes, 10
    photos, the scene that ends after two of them first: `skater` 30.24, 28.94 and 29.94 dB, 30.81, 28.73 and
    30.00, `banana` (split 0) 27.93 and 27.34, 15 photos of `fox` 26.46 and 26.26, of `hero` 18.19 and 18.42.

    Dropped: to withhold an eighth of the photos for the first 40 % of the run, and to settle when they
    become worse. The 10 photos of `banana` miss the one by 0.3 dB in the end, though it comes back (0.0 dB
    on `miku 12 far`); and one photo tells little: there, where nobody stops the run, it falls by 3.9 dB
    while those held out stay within 0.4 dB.
    """
    if photos >= FEW_PHOTOS:
        return None
    if everywhere:
        few = photos if 2 * shown > photos or photos >= FEWEST else math.sqrt(photos * shown)
        steps = round(photos * min(max(STEPS_BY_PHOTOS * few, LEAST_PER_PHOTO), STEPS_PER_PHOTO))
        return max(steps, LEAST_STEPS // 2)
    return max(photos * STEPS_PER_PHOTO, LEAST_STEPS)


MEMBERS = 8
"""Scenes that teach a last one, at most, see `ensemble`. Ten minutes of the bench by three and eight, which
leave less to chance: `kermit` 18.68 and 18.97 dB, `bust` 18.26 and 18.64 (three splits each, chosen)."""

LEAST_SHORTER, MOST_SHORTER = 2 / 3, 4_200
"""Where there is time for no longer ones, see `automatic_shorter`: the share of a long scene's steps that
there should be time for; and the steps of each of several scenes at most."""


FEWEST_TRIED, LEAST_TRIED = 10, 2_500
"""Photos, and steps of each of several scenes, from which on a run withholds some of the photos to see
whether it is to train several, see `automatic_tried`. Of fewer photos those withheld would be half."""

FEWEST_TO_GO_ON = 16
"""Photos from which on the last of several scenes goes on from the one before it, see `ensemble.GOES_ON_AT`;
of fewer ones it begins anew, as all of theirs do."""


def automatic_shorter(
    photos: int,
    steps: int,
    minutes: float,
    threads: int,
    unmet: int | None = None,
    of_a_minute: float = STEPS_OF_A_MINUTE,
) -> int | None:
    """Steps of each of several scenes of so many photos, where `steps` for each are too many for the minutes
    and fewer are not; None: `steps`, or one scene alone, or photos are enough to withhold some, which then
    decide, see `automatic_tried`. `unmet`: for photos of an object, the steps that others have, which are
    enough for these too where they are not met well, see `MET_OF_OBJECTS`; `of_a_minute`: then, how many a
    minute has, see `photo_size.steps_of_a_minute`.

    Unless photos are met well: then a long one still learns. Ten minutes of the bench, split 0 each, by one
    long scene and by two or three short ones and a last: `statue` (21 photos, a loss of 0.067) 19.14 and
    21.04 dB, `demo hard 40` (26, 0.047, for they are noisy) 30.82 and 30.54, and of those whose loss is below
    0.02, `miku 40 far` (26, 0.016) 27.69 and 27.86, `demo lens 40` (26, 0.014) 37.36 and 35.45. Chosen on
    these; judged by splits of `statue`: docs/training-recipe.md. All of these go by withheld photos now.

    After three minutes, three splits, `beach` (time for 0.72 of a long scene's steps) has 18.22 by one and
    18.90 by several, but `banana` (0.60) 26.78 and 27.00 with an SSIM of 0.743 and 0.724; both are chosen on.
    Longer ones are fewer: ten minutes of `statue`, three splits, have 20.10 dB and an SSIM of 0.727 by two
    scenes of 7,350 steps, 20.46 and 0.711 by five of MOST_SHORTER (chosen).

    Dropped, before far means moved faster, against what `statue` learns by heart in one scene (19.56 dB, and
    28.00 on `miku 40 far`): a dropout of 0.2 and 0.3 in place of 0.12, 19.74 and 20.00, but `miku 40 far`
    27.77; no bands of SH, 19.95, but none for splats in the frames of three photos or fewer 19.48;
    `few_views` of 4, 19.47; blocks withheld, 19.90, but `miku 40 far` never settles: 27.59 in ten minutes;
    the mean colour behind it, 18.67, and in the second half alone of a minute 20.48 in place of 21.50.
    Dropped, too: 200 steps per photo where there is time for more, so that there are more scenes. Three
    minutes: `miku 12 far` 21.73 and 21.96, `kermit` 18.81 and 19.15, but `bust` 18.93 and 18.42.
    """
    budget = STEPS_OF_A_MINUTE * minutes * min(threads, MOST_THREADS) / 2 / LEAST_SCENES
    if unmet is not None:
        budget *= of_a_minute / STEPS_OF_A_MINUTE
        fewer = min(unmet, round(budget), MOST_SHORTER)
        least = max(min(LEAST_UNMET, unmet), LEAST_OF_OBJECTS * photos)
        return fewer if least <= budget and fewer < steps else None
    few = photos < FEWEST_TO_GO_ON
    return min(MOST_SHORTER, steps) if few and LEAST_SHORTER * steps <= budget < steps else None


def scenes_tried(photos: int) -> float:
    """Scenes that there is time for then: two, a last one that is half as long where it goes on from the one
    before it, and some to spare."""
    return LEAST_SCENES - 0.5 * (photos >= FEWEST_TO_GO_ON)


def automatic_tried(
    photos: int,
    steps: int | None,
    minutes: float,
    threads: int,
    of_a_minute: float = STEPS_OF_A_MINUTE,
    *,
    large: bool = False,
) -> int | None:
    """Steps of each of several scenes, fewer than `steps`, where `automatic_shorter` asks for none, and
    photos are enough to withhold some, which then decide (`withheld`). None: nothing is tried. `large`:
    whether there is no time for all pixels of the photos.

    Of large photos one scene still learns where it would be trained for less than MOST_SHORTER: three minutes
    of `imp` at 540x960 px (split 2, a gap of 2.0 dB) have 22.73 dB by one and 22.23 by several of 2,541
    steps, ten of `museum` at 844x844 px (split 0, 3.9) 19.40 and 20.47, of 4,200 (both chosen).

    Nor is it for fewer than FEWEST_TO_GO_ON photos where there is time for several long scenes: ten minutes
    of `miku 20 far` (split 0, a gap of 4.9) had 24.94 dB by three of 7,800 steps and an earlier recipe, and
    have 24.08 by eight of 4,200.
    Dropped: scenes of 1,900 steps, too, for these; three minutes of `hero 20 far` (6.5) have 20.27 dB by one,
    20.17 by several of 2,123."""
    in_all = of_a_minute * minutes * min(threads, MOST_THREADS) / 2
    budget = in_all / scenes_tried(photos)
    # As many scenes as there are at most are longer, if there is time.
    tried = round(max(min(budget, MOST_SHORTER), in_all / (MEMBERS + 1)))
    least = MOST_SHORTER if large else LEAST_TRIED
    if photos < FEWEST_TRIED or budget < least or (steps is not None and steps <= tried):
        return None
    if photos < FEWEST_TO_GO_ON and steps is not None and steps <= budget:
        return None
    return tried


def most_scenes(photos: int, minutes: float, threads: int) -> int:
    """Scenes that a run of so many photos and minutes trains at most, besides a last one, whatever its photos
    show; 1: one alone."""
    steps = automatic_steps(photos)
    several = steps is not None or automatic_tried(photos, steps, minutes, threads) is not None
    return MEMBERS if several else 1


LEAST_UNMET, LEAST_OF_OBJECTS = 2_000, 80
"""Of the steps of photos of an object, and for each of them, that there should be time for: none had fewer
that were tried. 28 photos of `milk`, which was turned in the light of a window, lose by one scene from one
minute to three, 24.28 and 23.98 dB (three splits), and do not by scenes of 88 steps per photo, 24.27: chosen
on it. `guitar front 36` (24), which meets its own, takes its time as before (objects.json). Were photos of
`milk` withheld, two of three splits would have several scenes by a gap of 2.9 and 3.3 dB; the first, so,
23.94 dB in place of 24.12."""

LEAST_SCENES = 3.25
"""Scenes that there must be time for where several are trained: two and one that learns from them, and some
to spare."""

PICTURES, PICTURE_PIXELS = 150, 50_000_000
"""Pictures by which they do, and the pixels of all of them, at most; of large photos there are two for each
at least."""


def pictures_taught(photos: int, pixels: int) -> int:
    """How many pictures so many photos of so many pixels each are taught besides."""
    return min(max(PICTURE_PIXELS // pixels, 2 * photos), PICTURES)
