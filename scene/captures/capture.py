"""What a trainer learns from: photos with known cameras, and points on the surfaces that they show."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.errors import InputError

LEAST_DISPLACEMENT = 0.05
"""Px of a photo at its final size. A lens that moves no point of the picture by more is left out: nothing is
resampled. Poses are rarely known to better than ten times this; where two pixels side by side are black and
white, a twentieth of a pixel is 13 grey levels, elsewhere less."""

SAMPLES = 33
"""A side, borders included. Displacements are smooth: between these they exceed them by less than 1 %."""

MARGIN = 1.01
"""For that."""


@dataclass(frozen=True, kw_only=True)
class PhotoStatistics:
    """Statistics of all photos of a capture, at their final sizes."""

    lenses: int = 0
    """Photos whose camera has a lens that is no pinhole."""
    lenses_left_out: int = 0
    """Of these, photos whose lens shows nowhere: see LEAST_DISPLACEMENT."""
    displacement: float = 0.0
    """px, the largest distance of any point in a picture from where a pinhole has it."""
    transparent: int = 0
    """Photos with transparency, laid over the background."""
    masks: int = 0
    """Photos that come with a mask of their own."""
    cut_out: bool = False
    """Whether what masks hide is empty, as in transparent photos."""
    hidden: float = 0.0
    """Share of all photos' pixels that do not count: masked, or beyond what the lens has seen."""


LONG_LENS = 1.75
"""Focal length, in longer sides of the photo, of a lens that shows 32 degrees along these."""

STRAY, MOST_STRAY = 6.0, 0.15
"""Times the usual distance from the middle of the cameras beyond which one is astray: those of the bench's
captures are within 4.1. And the share that may be: where more stand apart, as when somebody has stood still
for most of a video and walked then, they belong to the scene. See `astray`."""


def shown_share(camera: Camera) -> float:
    """Of what a lens of LONG_LENS shows from as far, what a longer one does: 1 of those that are no longer.

    A splat that moves by a share of its distance crosses as many more pixels: `tank`, rendered from far
    away by a lens of 14.6 longer sides, was smeared while rates went by distances alone. A minute of its
    split 0, on which that was chosen, has 25.93 dB without, 31.93 with a LONG_LENS of 0.83, 32.17 with 1.4
    and 31.69 with 2.4. That of 0.83 would change captures whose lens is not long, for nothing: `playbot
    white 60` has 35.77 dB in place of 35.61, `skull RGBA 24` 27.56 of 27.64, `rose` 44.86 of 44.90. Others:
    how_large.json.

    Dropped: longest splats that are shorter in proportion, too, 32.06 dB in place of 32.17 (with 1.4)."""
    return min(1.0, LONG_LENS * max(camera.width, camera.height) / camera.fx)


def astray(eyes: np.ndarray) -> np.ndarray:
    """Which of the cameras' places (P, 3) are far from the others, (P,) bool: as a pose that went wrong may
    be, or a photo from far away. By the farthest camera of all such a scene was as large as that: splats were
    moved so many times as far a step, and a sky was looked for so much farther away. See how_large.json.

    Dropped: an extent of at most 2.5 or 3 times the depth at which photos show the scene, which leaves it too
    large: `playbot RGBA 18`, a tenth of whose cameras are far away, has 30.46 dB with 2.5, 30.87 so (a minute
    of split 0; 21.45 before). Nor is it too large where cameras walk along a scene: 84 of them on a way of 28
    units along robots 2.8 units away have 24.36 dB by an extent of 15, 24.04 by 3 depths, 22.83 by 1.2."""
    with np.errstate(over="ignore", invalid="ignore"):
        distances = np.linalg.norm(eyes - np.median(eyes, axis=0), axis=1)
        usual = np.median(distances)  # 0 on a tripod, which says nothing of how far away others are
        far = ~(distances <= STRAY * usual)
    return far if usual > 0 and far.mean() < MOST_STRAY else np.zeros(len(eyes), np.bool_)


def gathered(cameras: Sequence[Camera]) -> list[Camera]:
    """Those that are not astray."""
    far = astray(np.array([camera.eye for camera in cameras]))
    return [camera for camera, is_far in zip(cameras, far, strict=True) if not is_far]


def intrinsics_of(camera: Camera) -> tuple:
    """All of a camera but its pose and name; the same for cameras that see alike."""
    return camera.lens, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy


def largest_displacement(camera: Camera) -> float:
    """The largest distance, px, of any point in the picture from where a pinhole has it; inf where a lens
    does not show all that the pinhole does."""
    if camera.lens is None:
        return 0.0
    x, y = (np.linspace(0.0, float(size), SAMPLES) for size in (camera.width, camera.height))
    pixels = np.stack(np.meshgrid(x, y), axis=-1)
    rays = replace(camera, lens=None).points_at(pixels, 1.0)
    away = np.linalg.norm(camera.image_points(rays) - pixels, axis=-1)
    return float(MARGIN * away.max()) if np.isfinite(away).all() else float("inf")


MaskUse = Literal["ignore", "cut-out"]
"""What masks say about what is black in them: that it is not to be compared, or that nothing is there."""

LensUse = Literal["undistort", "through"]
"""What is done about photos whose lens is no pinhole: their distortion is taken out when they are read, or
they stay as they are and are compared with pictures that are rendered through their lens."""

DEFAULT_LENS_USE: LensUse = "through"
"""By measurement (tools/bench/bench_lens.py), as all of the photo is used and no pixel interpolated: as
good with a lens that bends little, some dB better with one that bends much, at all but equal times a step.
The exception are very wide pinhole views of a scene that a fisheye saw: undistorted photos are such views."""

NEAR_ORIGIN = 16.0
"""Scene radii: float32 holds a scene well whose cameras are no farther from the origin. It rounds positions
there to less than 1e-6 radii, a sixth of the largest step that the end of a run takes."""

EXTENT_MARGIN = 1.1
"""How far a scene reaches beyond its cameras, by Kerbl et al. 2023."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Pixels:
    """A photo as training compares it, at its final size."""

    image: np.ndarray
    """(H, W, 3) uint8, read-only."""
    mask: np.ndarray | None
    """(H, W) bool, read-only: which pixels show the scene; None where all do."""
    alpha: np.ndarray | None = None
    """(H, W) uint8, read-only: opacity of a transparent photo, whose `image` is laid over the capture's
    background; None where it is opaque."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Photo:
    name: str
    """As the capture names it, sub-folders with forward slashes."""
    camera: Camera
    """Of the image's size: after downscaling, and a pinhole after undistortion. Its name is the photo's."""
    held_out: bool
    """Kept from training, to measure it by."""
    pixels: Callable[[], Pixels]
    """From memory, or read from the file again where the capture is too large for that.
    May be called from any thread."""

    def image(self) -> np.ndarray:
        """(H, W, 3) uint8, read-only. Raises InputError where the file has to be read again and cannot."""
        return self.pixels().image

    def mask(self) -> np.ndarray | None:
        """(H, W) bool, read-only: True where the pixel counts; None where all do. Raises as `image`."""
        return self.pixels().mask


@dataclass(frozen=True, eq=False, kw_only=True)
class Capture:
    """At least two photos, of which at least one is to train on; sorted by name."""

    name: str
    """Name of its folder."""
    photos: tuple[Photo, ...]
    points: np.ndarray
    """(P, 3) float64, finite, P >= 4: where surfaces are, or random where the capture does not say."""
    point_colours: np.ndarray
    """(P, 3) uint8 RGB."""
    guessed: bool = False
    """Whether the points are random."""
    background: tuple[float, float, float] | None = None
    """What photos with transparency were laid over, RGB in 0..1; None where none has any."""
    statistics: PhotoStatistics = field(default_factory=PhotoStatistics)
    """What was found out about the photos while they were read."""
    warnings: tuple[str, ...] = ()
    """A line each: what was left out or made up."""

    @property
    def train(self) -> tuple[Photo, ...]:
        return tuple(photo for photo in self.photos if not photo.held_out)

    @property
    def held_out(self) -> tuple[Photo, ...]:
        """May be empty: then there is nothing to measure by."""
        return tuple(photo for photo in self.photos if photo.held_out)

    @property
    def scene_radius(self) -> float:
        """World units: 1.1 x the largest distance of a training camera from their mean (Kerbl et al. 2023),
        but for those astray.

        Where all cameras stand in one place, the median distance of the points from it.
        """
        eyes, centre = self._eyes, self.middle
        radius = float(np.linalg.norm(eyes - centre, axis=1).max())
        if not radius > 1e-9 * (1 + np.abs(centre).max()):
            radius = float(np.median(np.linalg.norm(self.points - centre, axis=1)))
        return EXTENT_MARGIN * radius

    @property
    def middle(self) -> np.ndarray:
        """(3,) float64, world units: the mean of the training cameras' places, but for those astray."""
        return self._eyes.mean(axis=0)

    @cached_property
    def _eyes(self) -> np.ndarray:
        """(P, 3): places of the training cameras that are not astray."""
        return np.array([camera.eye for camera in gathered([photo.camera for photo in self.train])])

    @property
    def usual_distance(self) -> float:
        """World units: how far from the `middle` of the cameras most of a scene is. The median of its points,
        or the `scene_radius` where they stand around it."""
        distances = np.linalg.norm(self.points - self.middle, axis=1)
        return max(float(np.median(distances)), self.scene_radius)

    @property
    def extent(self) -> float:
        """World units: the scale by which a scene is trained, its `usual_distance`, or as much less as a long
        lens shows, see `shown_share`. By the `scene_radius` of Kerbl et al. 2023, which is less where cameras
        stand side by side, where nothing is known of points."""
        share = float(np.median([shown_share(photo.camera) for photo in self.train]))
        return share * (self.scene_radius if self.guessed else self.usual_distance)

    @property
    def centre(self) -> np.ndarray:
        """(3,) float64, world units: what float32 positions should be relative to. 0 where the cameras are
        near the origin, else their mean, rounded: then a position and this add up without loss."""
        radius, middle = self.scene_radius, self.middle
        if not np.linalg.norm(middle) > NEAR_ORIGIN * radius:
            return np.zeros(3)
        step = 2.0 ** math.floor(math.log2(radius))
        return np.round(middle / step) * step

    def about(self, origin: np.ndarray) -> Capture:
        """The same capture in a world whose origin is at `origin` (3,) of this one."""
        photos = tuple(replace(photo, camera=photo.camera.about(origin)) for photo in self.photos)
        return replace(self, photos=photos, points=self.points - origin)


SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""Suffixes of photos whose names come without."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PosedPhoto:
    """A photo on disk with its pose."""

    name: str
    path: Path
    camera: Camera
    """With its lens, at the size of the file, or of the face."""
    mask: Path | None = None
    held_out: bool | None = None
    """None: the capture does not say."""
    face: str | None = None
    """Which face of its file, a panorama, this is, see `panoramas`; None: the file is the photo."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PosedPhotos:
    """All that a capture says, before its photos are read."""

    source: Path
    """The file or folder that names the photos."""
    images: Path
    """Where they were looked for."""
    entries: Sequence[PosedPhoto]
    missing: Sequence[str] = ()
    """Photos with a pose that are not on disk."""
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    """(P, 3) float64, any values."""
    point_colours: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=np.uint8))
    """(P, 3) uint8."""
    warnings: Sequence[str] = ()


AT_ONCE = 4096
"""Photos looked for between two questions whether to go on."""


class Files:
    """The files below a folder, which may not exist. Each of its folders is listed once: to ask the system
    for the names of a large model one by one takes minutes."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._listed: dict[str, set[str]] = {}

    def photo(self, name: str) -> Path | None:
        """The photo `name`, its suffix added where it has none; None where there is none."""
        return self._first(name, lambda file: (file, *(file + suffix for suffix in SUFFIXES)))

    def mask(self, name: str) -> Path | None:
        """The mask of photo `name`, as it is named from the folder of the photos: the photo's name, the same
        with ".png" behind it (COLMAP's way), or with another suffix."""

        def names(file: str) -> tuple[str, ...]:
            stem = os.path.splitext(file)[0]
            return (file, file + ".png", *(stem + suffix for suffix in SUFFIXES))

        return self._first(name, names)

    def _first(self, name: str, candidates: Callable[[str], Sequence[str]]) -> Path | None:
        folder, _, file = name.replace("\\", "/").rpartition("/")
        if folder not in self._listed:
            self._listed[folder] = _files_in(os.path.join(self.root, folder))
        there = self._listed[folder]
        if not there:
            return None
        found = next((one for one in candidates(file) if os.path.normcase(one) in there), None)
        return None if found is None else self.root / folder / found


def _files_in(folder: str) -> set[str]:
    """Names of the files in a folder, in one case where the system knows but one; none where it cannot be
    read."""
    try:
        with os.scandir(folder) as entries:
            return {os.path.normcase(entry.name) for entry in entries if entry.is_file()}
    except (OSError, ValueError):
        # A name that no folder can have (too long, a zero byte) is the name of none.
        return set()


def check_photos(source: Path, images: Path, entries: Sequence[PosedPhoto], missing: Sequence[str]) -> None:
    """Raises InputError where there is not one photo: `entries` are those found of `source`, `missing` the
    names of the others."""
    if not entries and not missing:
        raise InputError(f"{source}: names no photos")
    if not entries:
        hint, name = "put them there", missing[0]
        if (found := _folder_beside(images, name.rpartition("/")[2])) is not None:
            hint = f"{found} has one of that name: rename it to images"
        elif (found := _folder_beside(images, name)) is not None:
            hint = f"{found} has one of that name: move what is in it there"
        raise InputError(
            f"{source}: none of its {len(missing):,} photos is in {images} "
            f"(the first is {some(missing[:1])}); {hint}"
        )


def _folder_beside(images: Path, name: str) -> Path | None:
    """A folder in the capture's, or in that of `images`, that has a photo of that name, with the folders
    before it. It is told, not taken: it may be one of masks or depths."""
    for root in (images, images.parent):
        try:
            folders = sorted(one.path for one in os.scandir(root) if one.is_dir())
        except OSError:
            continue
        found = next((Path(one) for one in folders if Files(Path(one)).photo(name)), None)
        if found is not None:
            return found
    return None


NAMES_SHOWN = 5


def some(names: Sequence[str]) -> str:
    """The first names, on one line."""
    shown = ", ".join(ascii(name)[1:-1] for name in names[:NAMES_SHOWN])
    return shown + (", ..." if len(names) > NAMES_SHOWN else "")


def tidy_name(name: str) -> str:
    """`name` with forward slashes and without "./" in front."""
    return os.path.normpath(name.replace("\\", "/")).replace(os.sep, "/")
