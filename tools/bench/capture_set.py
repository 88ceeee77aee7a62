"""Captures that training is judged on: real ones, parts of them, and pictures of scenes whose truth is known.

    python tools/bench/capture_set.py DATA OUT [NAME ...]

DATA holds the folders `captures` and `scenes`. Pictures are rendered into OUT, a folder for each capture with
transforms.json, once; the same arguments make the same files. `CAPTURES` says what each is, and whether
rules of the recipe may be chosen on it or are only judged by it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import sky_scenes
import wood_scene
from PIL import Image, ImageFilter
from public_captures import PUBLIC

from splatview.raster import render
from splatview.scene import Camera, Gaussians, Lens, RenderSettings
from splatview.scene.camera import look_at
from splatview.scene.captures import load_capture
from splatview.scene.captures.capture import Capture, MaskUse, Photo, Pixels
from splatview.scene.captures.demo import demo_cameras, demo_truth
from splatview.scene.captures.nerfstudio import save_capture
from splatview.scene.formats import load_scene
from splatview.scene.framing import bulk
from splatview.scene.projection import sigmoid
from splatview.scene.sh import SH_C0

Use = Literal["choose", "judge"]

DEMO_SPLATS = 60_000
FOV_Y = 40.0
DISTANCE = 2.6
"""Radii of the scene's bulk from its centre to the eye."""
CLOSE = 0.7
POINTS = 3000
POINT_NOISE = 0.004
"""Standard deviation of a point, in radii."""


def orbit(scene: Gaussians, count: int, size: int, *, around: float = 360.0) -> list[Camera]:
    """Cameras on the upper part of a sphere about the scene's bulk, within `around` degrees of its front, in
    an order that jumps about."""
    centre, radius = bulk(scene)
    cameras = []
    for i in range(count):
        # A golden-ratio sequence along the height and another irrational one around: even for any count.
        height = np.radians(-5 + 55 * ((i * 0.6180339887498949) % 1.0))
        angle = np.radians(around * (((i * 0.7548776662466927) % 1.0) - 0.5))
        away = np.array([np.sin(angle) * np.cos(height), -np.sin(height), -np.cos(angle) * np.cos(height)])
        eye = centre + DISTANCE * radius * away
        cameras.append(look_at(eye, centre, up=(0, -1, 0), fov_y=FOV_Y, width=size, height=size))
    return cameras


def closeups(scene: Gaussians, count: int, size: int) -> list[Camera]:
    """Cameras CLOSE radii before places all over the scene's bulk, each of which shows a small part of it: a
    capture with many photos, of which few show the same."""
    centre, radius = bulk(scene)
    opaque = scene.means[sigmoid(scene.opacity_logits) > 0.6].astype(np.float64) - centre
    rng = np.random.default_rng(3)
    opaque = opaque[(np.linalg.norm(opaque, axis=1) < 1.2 * radius)]
    cameras = []
    for _ in range(count):
        away = rng.normal(size=3)
        away /= np.linalg.norm(away)
        # The outermost of what lies that way.
        along = opaque @ away
        target = opaque[np.argmax(along - 2 * np.linalg.norm(opaque - along[:, None] * away, axis=1))]
        eye = centre + target + CLOSE * radius * away
        cameras.append(look_at(eye, centre + target, up=(0, -1, 0), fov_y=FOV_Y, width=size, height=size))
    return cameras


def rgba_pictures(scene: Gaussians, cameras: list[Camera]) -> list[np.ndarray]:
    """(H, W, 4) uint8 each: straight colours and opacity, as NeRF-synthetic photos have them."""
    pictures = []
    for camera in cameras:
        drawn = np.clip(np.nan_to_num(render(scene, camera)), 0, 1)
        straight = drawn[..., :3] / np.maximum(drawn[..., 3:], 1e-6)
        rgba = np.concatenate([np.clip(straight, 0, 1), drawn[..., 3:]], axis=-1)
        pictures.append((rgba * 255 + 0.5).astype(np.uint8))
    return pictures


def laid_over(rgba: np.ndarray, grey: float) -> np.ndarray:
    """(H, W, 3) uint8: a transparent picture before a plain backdrop."""
    alpha = rgba[..., 3:] / 255
    return (rgba[..., :3] * alpha + 255 * grey * (1 - alpha) + 0.5).astype(np.uint8)


def rgb_picture(scene: Gaussians, camera: Camera) -> np.ndarray:
    """(H, W, 3) float32 within 0..1, over black."""
    return np.clip(np.nan_to_num(render(scene, camera, RenderSettings())[..., :3]), 0, 1)


def surface_points(scene: Gaussians, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) float64 and (P, 3) uint8: means of opaque splats, disturbed, as a reconstruction finds them."""
    rng = np.random.default_rng(seed)
    _, radius = bulk(scene)
    opaque = np.flatnonzero(sigmoid(scene.opacity_logits) > 0.6)
    found = rng.choice(opaque, min(POINTS, len(opaque)), replace=False)
    noise = rng.normal(scale=POINT_NOISE * radius, size=(len(found), 3))
    points = scene.means[found].astype(np.float64) + noise
    colours = np.clip(scene.sh[found, 0] * SH_C0 + 0.5, 0, 1)
    return points, (colours * 255 + 0.5).astype(np.uint8)


def no_points() -> tuple[np.ndarray, np.ndarray]:
    """Those of a capture that has none."""
    return np.empty((0, 3)), np.empty((0, 3), np.uint8)


def capture_from(
    pictures: list[np.ndarray], cameras: list[Camera], points: tuple[np.ndarray, np.ndarray]
) -> Capture:
    photos = []
    for i, (picture, camera) in enumerate(zip(pictures, cameras, strict=True)):
        name = f"view_{i:03d}.png"
        pixels = Pixels(image=np.ascontiguousarray(picture[..., :3]), mask=None)
        camera = replace(camera, name=name)
        photos.append(Photo(name=name, camera=camera, held_out=i % 8 == 0, pixels=lambda kept=pixels: kept))
    return Capture(name="rendered", photos=tuple(photos), points=points[0], point_colours=points[1])


def write(capture: Capture, folder: Path, *, rgba: list[np.ndarray] | None = None) -> None:
    """As `save_capture`, with transparent photos in place of its own where there are any."""
    save_capture(capture, folder)
    if not len(capture.points):
        (folder / "sparse_pc.ply").unlink(missing_ok=True)
        path = folder / "transforms.json"
        content = json.loads(path.read_text(encoding="utf8"))
        content.pop("ply_file_path", None)
        path.write_text(json.dumps(content, indent=1), encoding="utf8")
    for photo, picture in zip(capture.photos, rgba or [], strict=bool(rgba)):
        Image.fromarray(picture, "RGBA").save(folder / "images" / photo.name)


def objects(
    scene_file: str,
    count: int,
    *,
    points: bool,
    size: int = 200,
    before: float | None = None,
    cameras_of: Callable[[Gaussians, int, int], list[Camera]] = orbit,
) -> Callable[[Path, Path], None]:
    """Transparent photos from all around; opaque ones, where they stand `before` a grey of 0 to 1."""

    def make(data: Path, folder: Path) -> None:
        scene = load_scene(data / "scenes" / scene_file)
        cameras = cameras_of(scene, count, size)
        pictures = rgba_pictures(scene, cameras)
        found = surface_points(scene, 0) if points else no_points()
        if before is None:
            write(capture_from(pictures, cameras, found), folder, rgba=pictures)
            return
        over = [laid_over(picture, before) for picture in pictures]
        write(capture_from(over, cameras, found), folder)

    return make


def front(scene_file: str, count: int, *, size: int = 240) -> Callable[[Path, Path], None]:
    """Opaque photos from one side, with points."""

    def make(data: Path, folder: Path) -> None:
        scene = load_scene(data / "scenes" / scene_file)
        cameras = orbit(scene, count, size, around=70.0)
        pictures = [(rgb_picture(scene, camera) * 255 + 0.5).astype(np.uint8) for camera in cameras]
        write(capture_from(pictures, cameras, surface_points(scene, 0)), folder)

    return make


NIGHT = 0.12
"""Of the light of day."""


def demo(kind: Literal["drift", "hard", "lens", "night"], count: int = 40) -> Callable[[Path, Path], None]:
    """The demo's landscape: exposures that drift; noise, motion blur and bad masks; through a lens; at night,
    with noise."""

    def make(data: Path, folder: Path) -> None:
        scene = demo_truth(DEMO_SPLATS)
        lens = Lens(model="OPENCV", parameters=(-0.18, 0.04, 0.001, -0.001)) if kind == "lens" else None
        cameras = [replace(camera, lens=lens) for camera in demo_cameras(count, 256, 192)]
        rng = np.random.default_rng(5)
        pictures, masks = [], []
        for i, camera in enumerate(cameras):
            picture = rgb_picture(scene, camera)
            if kind == "drift":
                gain = np.exp(0.25 * np.sin(2 * np.pi * i / count) + rng.normal(scale=0.03, size=3))
                picture = picture * gain + rng.normal(scale=0.01, size=3)
            if kind == "hard":
                if i % 4 == 1:
                    picture = moved(scene, camera, rng)
                picture = picture + rng.normal(scale=0.02, size=picture.shape)
                mask = np.ones(picture.shape[:2], bool)
                # What a poor segmentation does: a block of the scene is cut out, elsewhere in each photo.
                top, left = rng.integers(0, 150), rng.integers(0, 200)
                mask[top : top + 40, left : left + 50] = False
                masks.append(mask)
            if kind == "night":
                picture = picture * NIGHT + rng.normal(scale=0.01, size=picture.shape)
            pictures.append((np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8))
        capture = capture_from(pictures, cameras, surface_points(scene, 1))
        write(capture, folder)
        for photo, mask in zip(capture.photos, masks, strict=bool(masks)):
            path = folder / "masks" / "images" / photo.name
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.where(mask, 255, 0).astype(np.uint8)).save(path)

    return make


def outdoors(
    make_scene: Callable[[Path, int], sky_scenes.Outdoors], count: int
) -> Callable[[Path, Path], None]:
    """Photos before a sky at infinity. Beside them `sky` has where they show it, and `unseen` pictures that
    look where few or no photos do, with theirs."""

    def make(data: Path, folder: Path) -> None:
        world = make_scene(data, count)
        points, colours = surface_points(world.scene, 1)
        points = np.concatenate([points, world.points])
        grey = np.full((len(world.points), 3), 128, np.uint8)
        found = points, np.concatenate([colours, grey])
        for cameras, place in ((world.cameras, folder), (world.probes, folder / "unseen")):
            if not cameras:
                continue
            drawn = [world.picture(camera) for camera in cameras]
            capture = capture_from([(p * 255 + 0.5).astype(np.uint8) for p, _ in drawn], cameras, found)
            write(capture, place)
            (place / "sky").mkdir(exist_ok=True)
            for photo, (_, sky) in zip(capture.photos, drawn, strict=True):
                Image.fromarray(np.where(sky, 255, 0).astype(np.uint8)).save(place / "sky" / photo.name)

    return make


def from_above(wind: float) -> Callable[[Path, Path], None]:
    """A wood, whose trees and leaves wind moves so far from photo to photo."""

    def make(data: Path, folder: Path) -> None:
        scene, cameras, pictures = wood_scene.flown_over(wind)
        write(capture_from(pictures, cameras, surface_points(scene, 1)), folder)

    return make


def photographs_cut_out(name: str, downscale: int) -> Callable[[Path, Path], None]:
    """Photographs of an object with masks by its colour, as a poor segmentation has them: its shadow and what
    is beside it are in some, and its ends and stickers are not."""

    def make(data: Path, folder: Path) -> None:
        capture = load_capture(data / "captures" / name, downscale=downscale)
        write(capture, folder)
        for photo in capture.photos:
            path = folder / "masks" / "images" / Path(photo.name).with_suffix(".png").name
            path.parent.mkdir(parents=True, exist_ok=True)
            yellow_parts(Image.fromarray(photo.image())).save(path)

    return make


YELLOW, LEAST_SATURATION, LEAST_VALUE = (15, 60), 90, 30
"""Hues, and the least of the others, of 255."""


def yellow_parts(photo: Image.Image) -> Image.Image:
    """White where a photo is yellow, black elsewhere; without what is narrower than 5 px."""
    hue, saturation, value = np.moveaxis(np.asarray(photo.convert("HSV")), -1, 0)
    is_yellow = (hue > YELLOW[0]) & (hue < YELLOW[1]) & (saturation > LEAST_SATURATION)
    mask = Image.fromarray(np.where(is_yellow & (value > LEAST_VALUE), 255, 0).astype(np.uint8))
    larger, smaller = ImageFilter.MaxFilter, ImageFilter.MinFilter
    for step in (larger(9), smaller(9), smaller(5), larger(5)):
        mask = mask.filter(step)
    return mask


def moved(scene: Gaussians, camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """The mean of pictures along a short way: a photo taken by a hand in motion, some 4 px long."""
    _, radius = bulk(scene)
    way = rng.normal(size=3)
    way *= 0.01 * radius / np.linalg.norm(way)
    pictures = []
    for share in np.linspace(-0.5, 0.5, 5):
        shifted = camera.about(share * way)
        pictures.append(rgb_picture(scene, shifted))
    return np.mean(pictures, axis=0)


RENDERED: dict[str, tuple[Use, Callable[[Path, Path], None]]] = {
    "playbot RGBA 100": ("choose", objects("playbot_lod0.ply", 100, points=False)),
    "skull RGBA 100": ("judge", objects("skull.ply", 100, points=False)),
    "guitar RGBA 24": ("judge", objects("guitar/guitar.compressed.ply", 24, points=True)),
    "playbot RGBA 18": ("choose", objects("playbot_lod0.ply", 18, points=True)),
    "skull RGBA 24": ("judge", objects("skull.ply", 24, points=True)),
    "guitar white 24": ("judge", objects("guitar/guitar.compressed.ply", 24, points=True, before=1.0)),
    "playbot white 60": ("judge", objects("playbot_lod0.ply", 60, points=False, before=1.0)),
    "spot RGBA 60": ("judge", objects("spot_10k.splat", 60, points=False)),
    "biker white 60": ("judge", objects("biker/biker.compressed.ply", 60, points=False, before=1.0)),
    "playbot close 80": ("choose", objects("playbot_lod0.ply", 80, points=True, cameras_of=closeups)),
    "skull close 80": ("choose", objects("skull.ply", 80, points=True, cameras_of=closeups)),
    "train front 30": ("choose", front("train-1000.ply", 30)),
    "biker front 24": ("choose", front("biker/biker.compressed.ply", 24)),
    "guitar front 36": ("judge", front("guitar/guitar.compressed.ply", 36)),
    "demo drift 40": ("choose", demo("drift")),
    "demo hard 40": ("choose", demo("hard")),
    "demo lens 40": ("choose", demo("lens")),
    "demo night 40": ("judge", demo("night")),
    "wood 18": ("judge", from_above(0.0)),
    "wood wind 18": ("judge", from_above(0.04)),
    "demo sky 40": ("choose", outdoors(sky_scenes.demo_outdoors, 40)),
    "biker sky 30": ("choose", outdoors(sky_scenes.biker_outdoors, 30)),
    "biker room 40": ("choose", outdoors(sky_scenes.biker_indoors, 40)),
    "guitar sky 24": ("judge", outdoors(sky_scenes.guitar_outdoors, 24)),
    "guitar room 24": ("judge", outdoors(sky_scenes.guitar_indoors, 24)),
    "banana cut out": ("choose", photographs_cut_out("banana", 2)),
}
"""Name -> what it is for, and what renders it, or masks it."""

CUT_OUT = ("banana cut out", *(name for name, capture in PUBLIC.items() if capture.cut_out))
"""Whose masks say where nothing is."""


@dataclass(frozen=True)
class RealCapture:
    """A capture of photographs among the data."""

    use: Use
    downscale: int


REAL = {"banana": RealCapture("choose", 2), "miku": RealCapture("choose", 4)}

EVERY = 8
"""The command holds out one of so many photos."""


@dataclass(frozen=True)
class Part:
    """Some photos of a capture of photographs, or all of them, others held out than thirds."""

    use: Use
    whole: str
    photos: int | None = None
    spread: Literal["far", "near"] = "far"
    every: int | None = None
    """One of so many photos is held out, as by the command; None: thirds."""


PARTS = {
    "banana, every 8th": Part("choose", "banana", every=EVERY),
    "miku 8 far": Part("choose", "miku", 8),
    "miku 8 near": Part("judge", "miku", 8, "near"),
    "miku 12 far": Part("choose", "miku", 12),
    "miku 12 near": Part("choose", "miku", 12, "near"),
    "miku 20 far": Part("choose", "miku", 20),
    "miku 20 near": Part("choose", "miku", 20, "near"),
    "miku 24 far": Part("judge", "miku", 24),
    "miku 40 far": Part("choose", "miku", 40),
    "fox 20 far": Part("judge", "fox", 20),
    "fox 24 far": Part("choose", "fox", 24),
    "fox 24 near": Part("choose", "fox", 24, "near"),
    "building 24 near": Part("choose", "building", 24, "near"),
    "building, every 8th": Part("judge", "building", every=EVERY),
    "mouse 24 far": Part("choose", "mouse", 24),
    "hero 20 far": Part("judge", "hero", 20),
}

NAMES = (*REAL, *PARTS, *PUBLIC, *RENDERED)
"""All captures, in the order of tables."""


def whole_of(name: str) -> str:
    """The capture whose photos these are."""
    return PARTS[name].whole if name in PARTS else name


DRIFTING = tuple(
    name
    for name in NAMES
    if whole_of(name) in ("demo drift 40", "miku")
    or (whole_of(name) in PUBLIC and not PUBLIC[whole_of(name)].rendered)
)
"""Captures whose photos differ, or may differ, in exposure. What is held out is measured after a fit, see
`trainer.exposure`, whether a run has learnt exposures or not, so that its runs can be compared."""

SPLITS = 3


def part_of(capture: Capture, count: int | None, spread: str) -> Capture:
    """`count` photos of the capture, as far apart as can be or near one another; all where it is None."""
    if count is None:
        return capture
    eyes = np.array([photo.camera.eye for photo in capture.photos])
    axes = np.array([photo.camera.forward for photo in capture.photos])
    scale = np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).mean()
    places = np.concatenate([eyes / scale, axes], axis=1)
    first = int(np.argmin(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
    nearest = np.linalg.norm(places - places[first], axis=1)
    if spread == "near":
        kept = np.argsort(nearest, kind="stable")[:count]
    else:
        chosen = [first]
        while len(chosen) < count:
            chosen.append(int(np.argmax(nearest)))
            nearest = np.minimum(nearest, np.linalg.norm(places - places[chosen[-1]], axis=1))
        kept = np.array(chosen)
    return replace(capture, photos=tuple(capture.photos[i] for i in np.sort(kept)))


def split_of(capture: Capture, split: int, every: int | None = None) -> Capture:
    """The capture with a random third of its photos held out: `split` 0, 1 or 2 of one shuffle; or with one
    of `every` photos, beginning with the first, as the command does, the second or the third."""
    count = len(capture.photos)
    place = np.arange(count) if every else np.argsort(np.random.default_rng(11).permutation(count))
    held = place % (every or SPLITS) == split
    photos = [replace(p, held_out=bool(out)) for p, out in zip(capture.photos, held, strict=True)]
    return replace(capture, photos=tuple(photos))


def bench_capture(
    name: str, data: Path, made: Path, smaller: int = 1, downscale: int | None = None
) -> Capture:
    """A capture of the bench by its name, with photos smaller by a factor; rendered ones are in `made`, see
    `make_all`. `downscale`: the factor of photographs in place of the bench's own."""
    if name in PARTS:
        part = PARTS[name]
        whole = bench_capture(part.whole, data, made, smaller, downscale)
        return part_of(whole, part.photos, part.spread)
    if name in REAL:
        return load_capture(data / "captures" / name, downscale=(downscale or REAL[name].downscale) * smaller)
    masks: MaskUse = "cut-out" if whole_of(name) in CUT_OUT else "ignore"
    if name in PUBLIC:
        if not (made / name / "whole").exists():
            raise SystemExit(f"{name}: {made / name} has no posed photos: see public_captures.py")
        factor = (downscale or PUBLIC[name].downscale) * smaller
        return load_capture(made / name, downscale=factor, masks=masks)
    return load_capture(folder_of(name, made), downscale=smaller, masks=masks)


def bench_split(
    name: str, split: int, data: Path, made: Path, smaller: int = 1, downscale: int | None = None
) -> Capture:
    """A capture of the bench with the photos of a split held out, as its name says which."""
    whole = bench_capture(name, data, made, smaller, downscale)
    return split_of(whole, split, PARTS[name].every if name in PARTS else None)


Fault = Literal["turned 3", "turned 5", "moved", "swapped", "far"]
"""Wrong poses: turned by degrees, moved by `MOVED`, or those of other photos, or `FAR` away."""

FAULTS: tuple[Fault, ...] = ("turned 3", "turned 5", "moved", "swapped", "far")

FAULTY_SHARE = 0.1
"""Of the photos trained on, that get a wrong pose; one at least."""

MOVED, FAR = 0.15, 30.0
"""Mean distances of the cameras to their middle; the second is how far one has gone backwards."""


def with_fault(capture: Capture, fault: Fault, seed: int) -> tuple[Capture, list[str]]:
    """The capture with wrong poses, and the names of the photos that have them."""
    rng, photos = np.random.default_rng(seed), list(capture.photos)
    trained = [row for row, photo in enumerate(photos) if not photo.held_out]
    wrong = rng.choice(trained, max(round(FAULTY_SHARE * len(trained)), 1), replace=False)
    eyes = np.array([photo.camera.eye for photo in photos])
    extent = np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).mean()
    for row in wrong:
        camera = photos[row].camera
        motion, axis = np.eye(4), rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        matrix = camera.world_to_camera
        if fault == "swapped":
            other = rng.choice([place for place in trained if place != row])
            matrix = capture.photos[other].camera.world_to_camera
        elif fault == "moved":
            motion[:3, 3] = MOVED * extent * axis
        elif fault == "far":
            motion[2, 3] = FAR * extent
        else:
            x, y, z = axis
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            angle = np.radians(float(fault.split()[1]))
            motion[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        photos[row] = replace(photos[row], camera=replace(camera, world_to_camera=motion @ matrix))
    return replace(capture, photos=tuple(photos)), [photos[row].name for row in wrong]


PASSING_SHARE = 0.2
"""Share of the photos trained on that something passes before."""


def with_passing(capture: Capture, seed: int, *, masked: bool = False) -> Capture:
    """The capture with a spot before the scene in some of the photos trained on, in each another: a sixth to
    two fifths as wide as the photo, half to four fifths as high, of a mottled colour. `masked`: the photos'
    masks take them out."""
    rng = np.random.default_rng(seed)
    names = [photo.name for photo in capture.train]
    picked = set(rng.choice(names, max(1, round(PASSING_SHARE * len(names))), replace=False))
    photos = [
        replace(photo, pixels=spotted(photo.pixels, int(rng.integers(1 << 30)), masked=masked))
        if photo.name in picked
        else photo
        for photo in capture.photos
    ]
    return replace(capture, photos=tuple(photos))


def spotted(pixels: Callable[[], Pixels], seed: int, *, masked: bool = False) -> Callable[[], Pixels]:
    """The photo's pixels with a spot on them, which its mask takes out where `masked`."""

    def draw() -> Pixels:
        found, rng = pixels(), np.random.default_rng(seed)
        image = np.array(found.image)
        height, width = image.shape[:2]

        def clouds(cells: int) -> np.ndarray:
            cell = max(height // cells, 2)
            small = rng.normal(size=(max(height // cell, 2), max(width // cell, 2))).astype(np.float32)
            return np.asarray(Image.fromarray(small).resize((width, height), Image.Resampling.BICUBIC))

        y, x = np.mgrid[:height, :width]
        middle, radius = (
            (rng.uniform(0.2, 0.8), rng.uniform(0.3, 0.9)),
            (rng.uniform(0.08, 0.2), rng.uniform(0.2, 0.4)),
        )
        across, down = (x / width - middle[0]) / radius[0], (y / height - middle[1]) / radius[1]
        inside = across**2 + down**2 + 0.25 * clouds(8) < 1
        mottled = rng.uniform(20, 200, 3) + 30 * np.stack([clouds(20) for _ in range(3)], axis=-1)
        image[inside, :3] = np.clip(mottled, 0, 255)[inside]
        if not masked:
            return replace(found, image=image)
        return replace(found, image=image, mask=~inside if found.mask is None else found.mask & ~inside)

    return draw


def folder_of(name: str, made: Path) -> Path:
    return made / name.replace(" ", "-").lower()


def use_of(name: str) -> Use:
    found = {**REAL, **PARTS, **PUBLIC}.get(name)
    return found.use if found else RENDERED[name][0]


def make_all(data: Path, out: Path, names: list[str]) -> None:
    """Renders those that are not there yet."""
    for name in names:
        folder = folder_of(name, out)
        if not (folder / "whole").exists():
            print(f"rendering {name}", flush=True)
            RENDERED[name][1](data, folder)
            (folder / "whole").touch()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*", default=list(RENDERED))
    options = parser.parse_args()
    make_all(options.data, options.out, options.names)


if __name__ == "__main__":
    main()
