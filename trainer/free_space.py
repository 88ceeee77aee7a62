"""Free space before cameras: no splat may stand between a photo and what it shows, much nearer than that.

A splat right before a camera covers its whole photo and explains what no other photo contradicts: shine, or
exposure, as a veil. Views from between the cameras then look through it. The points that a photo shows say
how near its scene begins; a splat nearer than a share of that is made invisible, and density control puts
it elsewhere. Adam knows no smaller gradients, so that scaling those near cameras (Philip and Deschaintre
2023, Floaters No More) would do nothing here.

One minute of the bench at half the size, one split, without and with it. Chosen: `playbot close 80` 27.79
and 27.96 dB, opacity where held-out photos are empty 0.068 and 0.016; `banana` (chance: 0.1 dB) 28.71 and
28.62. Judged: `skull close 80` 19.61 and 20.60 dB, 0.48 and 0.26; with a share of 0.8 20.35 dB, 0.39.

Nor may a splat be longer than half its distance to a camera whose photo shows it. What a footprint is near
its mean stands for all of it, so that one that is longer than the scene is wide reaches into photos from far
aside, as a veil before all they show; photos trained on balance it with others, and the next camera does
not. On `miku` (every 8th photo held out) two such splats out of 39,134, 6.6 and 10 units long 2.3 and 2.6
before a camera, made one photo of 13.5 dB among 13 of 29.8: a run of ten minutes scored 29.75 dB as it was,
1.0 less than one of three. Chosen there, ten minutes of the bench: 31.06 dB, that photo 29.6; three minutes
30.75 without, and 30.79, 30.83 and 30.57 with shares of 0.3, 0.5 and 1. Dropped: half the depth in place of
the distance, 25.50 dB, as what stands beside a camera is shortened to nothing; and, as higher bands of SH
had made that veil bright, to draw these towards 0 by their mean square in the loss (30.66 dB there, but
29.39 in place of 32.53 on `skull RGBA 100`, which shines), or to take from each splat's bands, in the end,
what the directions that photos see it from do not need (29.91 in place of 29.75).

Where photos say what is empty, it may not be longer than a twentieth of that distance. Of `skull close 80`,
photos of which show a part each, 203 splats of 22,969 make four fifths of the haze: glazes over a part of the
skull, six times as long as most splats and of an opacity of 0.2, which go on where no photo looks. A minute
of the bench, split 0, chosen: 20.29 dB and a haze of 0.339 with 0.5, 20.42 and 0.290 with 0.2, 20.34 and
0.234 with 0.1, 20.45 and 0.142 with 0.05, 20.13 and 0.098 with 0.025. Judged: sizes_objects.json. Dropped:
0.15 where photos show something everywhere, three splits of `miku 12 far` 21.20 in place of 21.49 dB.

Nor do other cameras see what stands nearer than the free space of every photo: a near plane at a share of
the least depth at which one's points begin, by which held-out photos, the window and the file's readers draw
it. Photos trained on lose 0.02 dB at most, by what reaches in from beside them. Fog that a camera stands in
is what photos from opposite have as their horizon, so that it cannot go. By the same scenes without and with
it, after fits of exposure and as they are,
a minute: `kermit` 14.92 and 17.23, 15.65 and 17.04 dB (split 2), `bust` 19.57 and 21.03, 17.93 and 18.50
(split 1), 16.25 in both (split 2), `miku 12 far` 19.54 and 20.39, 17.89 and 19.68 (split 1). All these chose
the least depth and the share that stood already: with 0.75 of it 17.63, 21.49, 16.25 and 20.72 dB, with all
of it 15.52, 20.67, 16.26 and 20.19; with half the median depth 17.59, 21.49, 16.25 and 20.68. Judged by
near.json. Dropped: whatever is nearer than a share of the way to the scene's middle, half of which would
bring 2.6 dB to `kermit` and -2.6 to `toy`; what is larger than a third of its distance, `miku 12 far` +0.08
(one photo -1.9); what a camera stands inside of, within 1 to 4 standard deviations, 0.00 to -0.01 dB on split
0 of `miku 12 far`, +0.01 to -0.05 on split 2.

Dropped: a depth for each of 16x16 cells of a photo, by the points in it and beside it, in place of one for
all of it. Half of that, 20 splits of 8 captures, a minute, the means of one to three runs each: +0.09 dB
after fits of exposure (standard error 0.11), `skull close 80` +0.22 and a haze of 0.20 as before, two splits
of `bust` +1.2, `toy` -0.35; a share of 0.8, 8 splits, -0.19; 32x32 cells, 9 splits, -0.16.

Before a picture taught (`ensemble`) what others show of it says in each place how near the scene begins, and
half the least depth about that place is free. The mean of scenes that disagree is a blur, and without that
the last scene explained it by fog close to the picture's camera: of split 0 of `bust` the mean of two scenes
has 20.70 dB, the last one had 17.51, a photo of it covered by five such splats. `nearest_by_blocks` and
assets/benchmarks/fog.json have what it brings.

Dropped, a minute of the bench, three splits each, held-out photos as they are and after fits of exposure
(chance: 0.4 dB): both rules for cameras on the ways between neighbouring photos, too, `miku 12 far` +0.03 and
+0.27, `miku 12 near` -0.06 and -0.15, `kermit` -0.53 and -0.34 dB. Nor is it the veils alone: without what
such cameras show ten times as much as any photo does, two splits of `miku 12 far` have 20.30 in place of
20.29 and 17.55 in place of 18.37 dB, for there is nothing behind.
On captures from all around a held-out camera may stand in fog that those opposite see as the horizon. With
both rules for the ways `biker sky 30` has 30.45 and 29.42 dB in place of 30.56 and 28.29, `guitar sky 24`
32.88 and 31.71 in place of 33.51 and 30.99 (two splits each), `skull close 80` 20.10 in place of 20.36 and a
haze of 0.24 in place of 0.20: as much is lost as gained. Dropped, too, three minutes: a share of 0.8, `beach`
17.20 and 17.62 in place of 17.26 and 17.90; copies of nothing that one photo alone shows by 0.9, 17.48 in
place of 17.26, `biker sky 30` 29.00 in place of 28.46, where a finer sky brings 30.83.

And what no photo shows: splats that have faded where the scene does without them, and those behind others.
Nothing has ever told what they look like from elsewhere, and steps take longer for them. They go when density
control ends, and as the run does. One minute of the bench at half the size, the same scenes with all splats
and without those that contribute less than 0.3 px to all photos together. Chosen: `miku` 35,000 and 14,011
splats, 29.79 and 29.84 dB; `banana` 28,985 and 17,120, 28.50 and 28.62. Judged: `skull close 80` 35,000 and
25,144, 20.20 and 20.23. With 0.001 px 29.84, 28.61 and 20.20; with 3 px 29.66, 26.02 and 20.27. Half-way
too, in runs that then make more steps: `miku` 29.96 dB (6,637 in place of 5,214), `banana` 28.65; judged by
`skull RGBA 100`, 33.45 and 33.54, and `playbot RGBA 100`, 38.48 and 38.57; these runs dropped them at five
shares of the second half, what contributes less than 0.1 px. Dropped: to have density control
move them to where the scene is, at 0.1, 0.2, 0.3 and 0.4 of the run: 30.11, 28.04 and 38.50 dB on `miku`,
`banana` and `playbot RGBA 100`.

What photos show a hundredth of hangs as fog before cameras between theirs: splats of which less than 0.01
of the own footprint contributes go too. Half the bench's size, a minute, two seeds. Chosen: `skull close 80`
from 20.15 and 20.02 to 20.49 and 20.30 dB, opacity where photos are empty from 0.34 and 0.47 to 0.22 and
0.28. Judged: `playbot close 80` 28.15 and 28.17 dB, 0.020 and 0.018; `banana` 28.62 and 28.65; `miku` 29.96
and 29.83, 29.91 and 29.81. With 0.003 it changes nothing (20.06 dB, 0.36), with 0.03 no more (20.40, 0.22;
`miku` 29.90); nor does it more often, at 0.15, 0.25, 0.35 and 0.7 of the run too (20.42, 0.23; `miku` 29.94).

At the end of a run nothing mends what that takes from the photos, and each splat that hides shows little, but
many of them a highlight: 3,372 of 46,285 of `bronze`, which shines, 1.5 dB of held-out photos after three
minutes. So they stay there where without them the pictures would change by more than `MOST_CHANGED`
(hidden.json): by 35.6 dB on `bronze`, 51.6 on `skull RGBA 100` (0.07 dB), and 57.9 or more where nothing is
lost (chosen on seven captures); judged by `beer`, 39.6 dB (0.10), three minutes of `cat`, 53.3 (0.06), and
six others, 55.1 or more (0.01 at most).

And what only one photo shows, in front of what others do: a branch, or somebody passing by. Nobody knows how
far away that is, and other cameras look at the scene through it. Until the run ends it explains what no
other splat should; then it goes, unless something is seen through all that is behind it, or the photos are
met so well (a loss below `full_reg_loss`) that it is rather a detail that the others hide: of `guitar RGBA
24` 0.4 % of the splats, which bring 0.14 dB. The same scenes with and without, a minute but for the first.
Chosen: `castle`, before one of whose photos a tree stands, 18.38 and 20.12 dB after three minutes in the
split that hides the tree from the other photos; `toy` -0.04, -0.03 and +0.18 dB in three splits (with 0.97
for LEAST_BEHIND -0.03, -0.26 and +0.21). Judged: `castle` 0.00 and 0.00 in its other splits, `kermit` +0.01,
+0.03 and 0.00, `bust` -0.02 and 0.00, `beach` +0.01 and -0.01, `tree` -0.01, `street` +0.03, `miku 12 far`
+0.03, `miku 12 near` 0.00. With something put before a fifth of the photos: assets/benchmarks/passing.json.
Dropped: whatever is behind it, -3.2 dB on `bust`, opposite sides of which are one photo's alone; what also
lies in the frame of another photo, -1.0 dB there; only what is nearer than 0.9 of what is behind it: no gain
on `castle`.

And what one or two photos show, the others cannot contradict: it is learnt by heart, with needles along those
photos' rays that are streaks to a camera from elsewhere, and the longer the run, the more. Splats in the
frames of so few photos stay as they are once every photo was looked at `FEW_VIEWS_ROUNDS` times. Frames, as
nobody knows in time what hides what; where every photo shows the whole scene, none is frozen. Three minutes
of the bench, splits 0, 1 and 2 (chance: 0.3 dB). Chosen: `beach` 17.64, 17.67 and 17.38 dB without, 17.92,
17.97 and 17.68 with it; `castle`, whose 7 photos are too few for it, 20.57 and 14.33 without, 19.55 and 14.57
after 90 rounds (splits 0 and 1). Judged, split 0 each: `tree` 19.53 and 19.55, `demo lens 40` 36.01 and
36.17, `demo drift 40` 36.04 and 36.01, `demo hard 40` 30.55 and 30.53, `playbot close 80` 27.94 and 27.94:
what it brings elsewhere is chance, and it costs nothing (assets/benchmarks/frozen.json, where all runs are).
Dropped, `beach` as above: after 60 rounds 17.64, 17.80 and 16.91 dB, after 90 17.93, 18.10 and 17.33; in the
frames of three photos after 90 rounds 17.91 and 17.37 (splits 0 and 2); at a share of the run, which is too
early in runs of a minute. Split 0: that no splat of one photo, or of three, is longer along their rays than
across them, 17.56 and 17.25; a dropout of 0.35 in place of 0.2, 17.24; `scale_reg` of 0.3 in place of 0.1,
16.91.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatview.raster import Parameters, Workspace, available_threads, draw_frame, parameters_of
from splatview.raster.compiling import kernel, run
from splatview.raster.contributions import contributions_and_footprints
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.trainer.views import TrainView

FREE_SPACE = 0.5
"""See `TrainSettings.free_space`."""

MAX_SIZE = 0.5
"""See `TrainSettings.max_size`."""

MAX_SIZE_OF_OBJECTS = 0.05
"""The same where photos say where nothing is."""

NEAREST = 0.02
"""Quantile of the depths of a photo's points that counts as where its scene begins: some points are wrong."""

BLOCKS = 40
"""Along the longer side of a picture, each with a depth of its own; see `nearest_by_blocks`."""

ABOUT = 3
"""Blocks to each side of one of which that is the least."""

LEAST_POINTS = 20
"""Where a photo shows fewer, nothing is known."""

LEAST_SHOWN = 2e-6
"""See `TrainSettings.least_shown`: 0.12 px of a photo of 60,000."""

LEAST_VISIBILITY = 0.01
"""See `TrainSettings.least_visibility`."""

MOST_CHANGED = (0.5 / 255) ** 2
"""Mean squared difference, 0 to 1, by which photos' pictures may change where splats that hide go as a run
ends: half a level of their 8 bits, 54.2 dB."""

COMPARED_PIXELS = 20_000_000
"""Of the pictures by which that is told, about: a second's work on two cores. Of more photos it is some."""

MOST_OF_ONE = 0.95
"""See `TrainSettings.most_of_one`."""

LEAST_BEHIND = 0.99
"""Opacity of all else where such a splat is, from which on it stands before what others show."""

FEW_VIEWS = 2
"""See `TrainSettings.few_views`."""

FEW_OF = 5
"""Times as many photos as are few, that there must be more of: of fewer, two are what places are known by."""

FEW_VIEWS_ROUNDS = 180
"""See `TrainSettings.few_views_rounds`."""

LOOK_STEPS = 200
"""Steps after which it is looked again which splats few photos can show: they move, and new ones come."""

COUNTED_PIXELS = 60_000
"""Of photos that are looked at for that: of larger ones a smaller picture tells."""

GONE = -8.0
"""Opacity logit of a splat made invisible: below what every strategy takes for dead."""


def automatic_max_size(says_empty: bool) -> float:
    """`TrainSettings.max_size`, by whether photos say where nothing is."""
    return MAX_SIZE_OF_OBJECTS if says_empty else MAX_SIZE


def nearest_depths(points: np.ndarray, views: Sequence[TrainView]) -> np.ndarray:
    """(V,) float64: the depth at which what each photo shows begins, by points (P, 3); 0 where unknown."""
    depths = np.zeros(len(views))
    for row, view in enumerate(views):
        shown = _local(points[in_picture(points, view.camera)], view.camera)[:, 2]
        if len(shown) >= LEAST_POINTS:
            depths[row] = np.quantile(shown, NEAREST)
    return depths


def nearest_by_blocks(depths: np.ndarray) -> np.ndarray:
    """(h, w) from depths of a picture (H, W): the least of each block and of those about it, see `BLOCKS` and
    `ABOUT`. Depths are means of what a pixel shows, so that leaves before a sky, and other edges, are nearer.

    What is nearer than the near plane that those pictures are drawn with stays: between photos that are far
    apart it is what the others look at. Without that, a last scene of `miku 8 far` (split 1, 5 photos) had
    0.49 dB less than without free space, and 0.66 by another order of photos; with it 0.15 more. `bust`
    gains 2.45 in place of 2.73 (fog.json). Dropped: a near plane in steps by pictures, too, -0.63 and +2.07.

    Last scenes by the same scenes before, with half of that free and without, before that was so: `bust`
    19.95 and 18.46 dB (four of split 0), `castle` 19.80 and 19.77 (two; both chosen on); judged by three of
    `kermit` 19.68 and 19.62, one of `toy` 20.74 and 20.75, three of `miku 12 far` 22.27 and 22.36, one of
    `miku 12 near` 32.40 and 32.44. Dropped: one block about in place of three, +1.49 on `bust`, but -0.22 on
    `castle`; 0.7 in place of half, +1.02 and -0.24; the farther of two scenes' depths, with one about, +1.64
    and -0.27, and 0.7 of it +1.32 and -0.73, where the SSIM falls from 0.849 to 0.777."""
    block = block_of(*depths.shape)
    tall, wide = (-(-size // block) for size in depths.shape)
    missing = [(0, blocks * block - size) for blocks, size in zip((tall, wide), depths.shape, strict=True)]
    blocks = np.pad(depths, missing, mode="edge").reshape(tall, block, wide, block).min(axis=(1, 3))
    around = np.pad(blocks, ABOUT, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(around, [2 * ABOUT + 1] * 2).min(axis=(2, 3))


def block_of(height: int, width: int) -> int:
    """px of a side of the blocks of a picture."""
    return -(-max(height, width) // BLOCKS)


def past_free_space(settings: RenderSettings, depths: np.ndarray) -> RenderSettings:
    """`settings` for other cameras than those of the photos, before which space is free up to `depths` (V,),
    0 where unknown: with a near plane at the least of these."""
    known = depths[depths > 0]
    if not len(known):
        return settings
    near = max(float(known.min()), settings.model.near)
    return replace(settings, model=replace(settings.model, near=near))


def clear(
    parameters: Parameters,
    pieces: Sequence[np.ndarray],
    camera: Camera,
    depth: float | np.ndarray,
    max_size: float,
    threads: int | None = None,
    *,
    near: float = 0.0,
) -> None:
    """Of a photo's `pieces`, indices (V,) each: makes invisible what stands nearer to its camera than
    `depth`, one or (h, w) by blocks, 0 for nothing, but not nearer than `near`, and shortens what is too long
    to be told from a veil, see `limit_sizes`."""
    if max_size < math.inf:
        limit_sizes(parameters, pieces, camera, max_size, threads)
    for indices in pieces if np.max(depth) > 0 else ():
        wrong = standing_before(parameters.means, indices, camera, depth, near=near)
        parameters.opacity_logits[wrong] = GONE


def standing_before(
    means: np.ndarray, indices: np.ndarray, camera: Camera, depth: float | np.ndarray, *, near: float = 0.0
) -> np.ndarray:
    """Those of the splats at `indices` (V,) whose means (N, 3) a camera shows nearer than a depth, or than
    that of their block, (h, w), but not nearer than `near`: what a near plane hides nobody has told."""
    axis, offset = camera.R_camera_world[2], camera.t_camera_world[2]
    found = indices[means[indices] @ axis.astype(np.float32) < np.float32(np.max(depth) - offset)]
    found = found[in_picture(means[found], camera)] if len(found) else found
    local = _local(means[found], camera)
    nearest = depth
    if isinstance(depth, np.ndarray):
        block = block_of(camera.height, camera.width)
        column, row = (camera.image_points(local) // block).astype(np.int64).T
        nearest = depth[row, column]
    return found[(local[:, 2] < nearest) & (local[:, 2] >= near)]


def limit_sizes(
    parameters: Parameters,
    pieces: Sequence[np.ndarray],
    camera: Camera,
    max_size: float,
    threads: int | None = None,
) -> None:
    """Shortens those splats of a photo's `pieces`, indices (V,) each, that are longer along an axis than a
    share of the distance of their means to its camera: log_scales (N, 3) are changed."""
    eye = camera.eye.astype(parameters.means.dtype)
    arguments = (parameters.means, parameters.log_scales, eye, math.log(max_size))
    tasks = [(indices,) for indices in pieces if len(indices)]
    run(shorten, tasks, arguments, threads or available_threads())


@kernel
def shorten(indices, means, log_scales, eye, log_share):
    """Axes of the splats at `indices` are cut at e^log_share distances of their means to `eye` (3,)."""
    for i in indices:
        longest = max(log_scales[i, 0], max(log_scales[i, 1], log_scales[i, 2]))  # noqa: PLW3301 of two each
        x, y, z = means[i, 0] - eye[0], means[i, 1] - eye[1], means[i, 2] - eye[2]
        most = log_share + 0.5 * np.log(np.float64(x * x + y * y + z * z))
        if longest > most > -np.inf:
            for k in range(3):
                log_scales[i, k] = min(log_scales[i, k], most)


def _local(points: np.ndarray, camera: Camera) -> np.ndarray:
    return points.astype(np.float64) @ camera.R_camera_world.T + camera.t_camera_world


def in_picture(points: np.ndarray, camera: Camera) -> np.ndarray:
    """(P,) bool: which of the places (P, 3) lie ahead of a camera and within its picture."""
    local = _local(points, camera)
    inside = local[:, 2] > 0
    x, y = camera.image_points(local[inside]).T
    with np.errstate(invalid="ignore"):
        inside[inside] = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return inside


def shown_by_few(means: np.ndarray, cameras: Sequence[Camera], few: int) -> np.ndarray:
    """(N,) bool: which of the places (N, 3) lie in the pictures of at most `few` cameras."""
    counts, rest = np.zeros(len(means), np.int32), np.arange(len(means))
    for camera in cameras:
        counts[rest] += in_picture(means[rest], camera)
        rest = rest[counts[rest] <= few]  # soon nothing is left where all photos show the same
        if not len(rest):
            break
    return counts <= few


def worth_keeping(
    scene: Gaussians,
    views: Sequence[TrainView],
    settings: RenderSettings,
    *,
    least_shown: float,
    least_visibility: float,
    most_changed: float = math.inf,
    threads: int | None = None,
) -> np.ndarray:
    """(N,) bool: the splats that photos show so much of; see `TrainSettings.least_shown` and
    `TrainSettings.least_visibility`. What hides stays where without all of it the photos' pictures would
    change by more than `most_changed`, a mean squared difference, 0 to 1."""
    total, whole = np.zeros(len(scene)), np.zeros(len(scene))
    cameras = [_counted(view.camera) for view in views]
    found = contributions_and_footprints(scene, cameras, settings, threads=threads)
    for camera, (pixels, footprints) in zip(cameras, found, strict=True):
        total += pixels / (camera.width * camera.height)
        whole += footprints / (camera.width * camera.height)
    kept = total >= least_shown
    seen = kept & (total >= least_visibility * whole)
    if math.isinf(most_changed) or (seen == kept).all():
        return seen
    # In the photos' own size: in smaller pictures what is gone is less.
    pixels = sum(view.camera.width * view.camera.height for view in views)
    some = [view.camera for view in views[:: max(math.ceil(pixels / COMPARED_PIXELS), 1)]]
    return seen if change(scene, seen, some, settings, threads=threads) <= most_changed else kept


def change(
    scene: Gaussians,
    kept: np.ndarray,
    cameras: Sequence[Camera],
    settings: RenderSettings,
    *,
    threads: int | None = None,
) -> float:
    """Mean squared difference, 0 to 1, of the cameras' pictures of a scene and of those of the splats `kept`,
    (N,) bool."""
    whole, workspace = parameters_of(scene), Workspace()
    rest = Parameters(*(np.ascontiguousarray(array[kept]) for array in whole))
    total, count = 0.0, 0
    for camera in cameras:
        shown, left = (
            draw_frame(one, camera, settings, workspace, threads=threads).image[..., :3].clip(0, 1)
            for one in (whole, rest)
        )
        total += float(((shown - left) ** 2).sum(dtype=np.float64))
        count += shown.size
    return total / max(count, 1)


def passing(
    scene: Gaussians,
    views: Sequence[TrainView],
    settings: RenderSettings,
    *,
    most_of_one: float = MOST_OF_ONE,
    stays: np.ndarray | None = None,
    threads: int | None = None,
) -> np.ndarray:
    """(N,) bool: the splats that one photo shows alone, by more than a share `most_of_one`, in front of what
    others show. `stays` (N,) bool: splats that are none, whoever shows them."""
    total, most, of = np.zeros(len(scene)), np.zeros(len(scene)), np.zeros(len(scene), np.int32)
    cameras = [_counted(view.camera) for view in views]
    found = contributions_and_footprints(scene, cameras, settings, threads=threads)
    for row, (camera, (pixels, _)) in enumerate(zip(cameras, found, strict=True)):
        shown = pixels / (camera.width * camera.height)
        of[shown > most] = row
        np.maximum(most, shown, out=most)
        total += shown
    alone = most > most_of_one * total
    if stays is not None:
        alone &= ~stays
    parameters, workspace = parameters_of(scene), Workspace()
    others = Parameters(*(np.ascontiguousarray(array[~alone]) for array in parameters))
    colourless = replace(settings, sh_degree=0)
    wrong = np.zeros(len(scene), np.bool_)
    for row, camera in enumerate(cameras):
        its = np.flatnonzero(alone & (of == row))
        if len(its):
            behind = draw_frame(others, camera, colourless, workspace, threads=threads).image[..., 3]
            # Of what reaches into the picture from beside it, the nearest place in the picture tells.
            places = camera.image_points(_local(parameters.means[its], camera))
            known = np.isfinite(places).all(axis=1)
            x, y = np.clip(places[known], 0, (camera.width - 1, camera.height - 1)).astype(np.int64).T
            wrong[its[known]] = behind[y, x] >= LEAST_BEHIND
    return wrong


def _counted(camera: Camera) -> Camera:
    """The camera of a picture of COUNTED_PIXELS at most."""
    factor = math.ceil(math.sqrt(camera.width * camera.height / COUNTED_PIXELS))
    if factor == 1:
        return camera
    return camera.resized(max(camera.width // factor, 1), max(camera.height // factor, 1))
