"""From poses to a capture: reads the photos, holds some out, and makes up what is missing."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.captures.capture import (
    LEAST_DISPLACEMENT,
    Capture,
    Files,
    LensUse,
    MaskUse,
    Photo,
    PhotoStatistics,
    Pixels,
    PosedPhoto,
    PosedPhotos,
    astray,
    check_photos,
    gathered,
    intrinsics_of,
    largest_displacement,
    some,
    tidy_name,
)
from splatview.scene.captures.panoramas import FACES
from splatview.scene.captures.photo_files import photo_folders
from splatview.scene.captures.photos import downscaled_size, read_file, read_pixels
from splatview.scene.captures.points import MIN_POINTS, first_points, random_points
from splatview.scene.captures.transparency import OPAQUE, outline_of, unknown_for, without_unknown
from splatview.scene.errors import InputError
from splatview.scene.formats import load_cameras
from splatview.scene.image_model import NEAR
from splatview.scene.lens import Lens
from splatview.scene.progress import Progress

HOLD_OUT_EVERY = 8
"""By sorted name, starting with the first: the usual split since Barron et al. 2022."""

KEEP_BYTES = 2 << 30
"""Of pixels in memory; photos beyond are read from their files each time."""

MAX_READERS = 8
"""Threads that decode; each holds a full photo."""

LEAST_RADIUS, LARGEST_RADIUS = 1e-9, 1e12
"""Of scenes, in their own units: float32 holds sizes and their squares with room to spare."""

SMALL = 5 * NEAR
"""Distance of a scene from its cameras below which the near plane cuts into it."""

STRETCH_TO_MENTION = 2.5
"""Of pixels: anamorphic lenses have up to 2."""

LOSS_TO_MENTION = 0.05
"""Share of a photo that its undistorted picture does not show."""

FOLD_TO_MENTION = 0.1
"""Share of a photo beyond where its lens's polynomial turns back on itself. Those that are fitted to what a
photo shows do so at its corners, if at all; wrong ones within it."""


def capture_of(
    posed: PosedPhotos,
    *,
    name: str,
    downscale: int,
    background: tuple[float, float, float],
    lens: LensUse,
    masks: MaskUse,
    progress: Progress,
) -> Capture:
    """Raises InputError, Cancelled."""
    entries, twice = _unique(posed.entries)
    _check_count(posed, [entry.name for entry in entries])
    entries, statistics = _without_lenses_that_do_not_show(entries, downscale)
    folding = _folding_lenses(entries)
    held_out = _held_out(entries)
    if all(held_out):
        raise InputError(f"{posed.source}: all photos are held out; nothing is left to train on")

    cut_out = masks == "cut-out"
    photos, hidden, opaque, outlines, kept = [], [], [], {}, 0
    faint: set[str] = set()
    pixel_count = hidden_pixels = unknown = 0
    read = (downscale, background, lens, masks)
    for entry, is_held_out, pixels in zip(entries, held_out, _read_all(entries, read, progress), strict=True):
        if pixels.mask is not None and not pixels.mask.any():
            hidden.append(entry.name)
            continue
        if cut_out and entry.mask is None and pixels.alpha is None:
            opaque.append(entry.name)
            continue
        if pixels.alpha is not None:
            outlines[entry.name] = outline_of(pixels.alpha)
            unknown += int((pixels.alpha < OPAQUE).sum())
            if not (pixels.alpha >= OPAQUE).any():
                faint.add(entry.name)
        pixel_count += pixels.image[..., 0].size
        hidden_pixels += 0 if pixels.mask is None else int((~pixels.mask).sum())
        arrays = (pixels.image, pixels.mask, pixels.alpha)
        kept += sum(array.nbytes for array in arrays if array is not None)
        photos.append(
            Photo(
                name=entry.name,
                camera=_resized(entry, downscale, lens),
                held_out=is_held_out,
                pixels=_in_memory(pixels) if kept <= KEEP_BYTES else _on_demand(entry, read),
            )
        )

    faces = len(FACES) if any(entry.face is not None for entry in entries) else 1
    reason = None if cut_out else unknown_for(list(outlines.values()), len(photos), faces)
    if reason is not None:
        shown = [photo for photo in photos if photo.name not in faint]
        photos = [replace(photo, pixels=_without_unknown(photo.pixels)) for photo in shown]
        hidden_pixels += unknown
    else:
        faint = set()

    if opaque and not photos:
        raise InputError(
            f"{posed.source}: none of its photos has a mask to be cut out by, nor is one transparent; put"
            " masks into the folder masks of the capture, named as the photos"
        )
    if all(photo.held_out for photo in photos):
        left_out = some(sorted([*hidden, *opaque, *faint]))
        why = f"masks leave nothing of the photos to train on: {left_out}"
        raise InputError(f"{posed.source}: {next(iter(folding), why)}")
    _check_count(posed, [photo.name for photo in photos])

    warnings = list(posed.warnings)
    if opaque:
        warnings.append(
            f"{len(opaque)} photos are left out, for they have no mask to be cut out by: {some(opaque)}"
        )
    if hidden:
        warnings.append(
            f"{len(hidden)} photos are left out, for their masks hide all of them: {some(hidden)}"
        )
    if unknown and reason is not None:
        warnings.append(
            f"{len(outlines)} photos are transparent, which does not count as empty, for {reason}"
        )
    if faint:
        warnings.append(f"{len(faint)} of these show nothing and are left out: {some(sorted(faint))}")
    if posed.missing:
        total = len(posed.missing) + len(posed.entries)
        warnings.append(
            f"{len(posed.missing)} of {total} photos are not in {posed.images} and are left out: "
            f"{some(posed.missing)}"
        )
    if twice:
        warnings.append(f"{len(twice)} photos are named twice; the first pose is used: {some(twice)}")
    warnings += folding + _stretched(entries)
    if lens == "undistort":
        warnings += _lens_notes(entries)
    usable = np.all(np.abs(posed.points) <= LARGEST_RADIUS, axis=1)
    points, colours = posed.points[usable], posed.point_colours[usable]
    lost = len(usable) - np.count_nonzero(usable)
    if lost:
        warnings.append(f"{lost} of {len(usable)} points are not finite, or out of all bounds, and left out")
    guessed = len(points) < MIN_POINTS
    if guessed:
        points, colours = random_points(gathered([photo.camera for photo in photos if not photo.held_out]))
        warnings.append(
            "the capture has no points on the surfaces; training looks for some in the photos, by stereo"
        )
    capture = Capture(
        name=name,
        photos=tuple(photos),
        points=np.ascontiguousarray(points, dtype=np.float64),
        point_colours=np.ascontiguousarray(colours),
        guessed=guessed,
        background=background if outlines and reason is None else None,
        statistics=replace(
            statistics,
            transparent=0 if reason else len(outlines),
            masks=sum(entry.mask is not None for entry in entries),
            cut_out=cut_out,
            hidden=hidden_pixels / pixel_count,
        ),
        warnings=tuple(warnings),
    )
    with np.errstate(over="ignore"):
        distances = np.linalg.norm([photo.camera.eye - capture.middle for photo in photos], axis=1)
    spread = max(capture.scene_radius, float(distances.max()))
    if not (capture.scene_radius >= LEAST_RADIUS and spread <= LARGEST_RADIUS):
        raise InputError(
            f"{posed.source}: its cameras and points are spread over {spread:.3g} units, which"
            " cannot be a scene; look for a pose that is far from the others"
        )
    if capture.usual_distance < SMALL:
        times = 10 ** math.ceil(-math.log10(capture.usual_distance))
        warnings.append(
            f"the scene is some {capture.usual_distance:.2g} units from its cameras, and nothing nearer than"
            f" {NEAR:g} is drawn: multiply the places of cameras and points, by {times:,} say"
        )
    far = np.flatnonzero(astray(np.array([photo.camera.eye for photo in photos])))
    if len(far):
        times = distances[far].min() / np.median(distances)
        names = some([photos[row].name for row in far])
        warnings.append(
            f"{len(far)} of {len(photos)} cameras stand {times:,.0f} times as far away as usual, or more: "
            f"their poses may be wrong, and the size of the scene does not go by them: {names}"
        )
    return replace(capture, warnings=tuple(warnings))


def _without_lenses_that_do_not_show(
    entries: Sequence[PosedPhoto], downscale: int
) -> tuple[list[PosedPhoto], PhotoStatistics]:
    """Those whose lens moves nothing by more than LEAST_DISPLACEMENT become pinholes, here and for good."""
    by_lens = {
        intrinsics_of(entry.camera): largest_displacement(entry.camera) / downscale
        for entry in entries
        if entry.camera.lens is not None
    }
    kept, left_out = [], 0
    for entry in entries:
        shows = entry.camera.lens is None or not by_lens[intrinsics_of(entry.camera)] <= LEAST_DISPLACEMENT
        kept.append(entry if shows else replace(entry, camera=replace(entry.camera, lens=None)))
        left_out += not shows
    statistics = PhotoStatistics(
        lenses=sum(entry.camera.lens is not None for entry in kept),
        lenses_left_out=left_out,
        displacement=max(by_lens.values(), default=0.0),
    )
    return kept, statistics


def _unique(entries: Sequence[PosedPhoto]) -> tuple[list[PosedPhoto], list[str]]:
    """Sorted by name, and the names that came again."""
    by_name: dict[str, PosedPhoto] = {}
    twice = [entry.name for entry in entries if by_name.setdefault(entry.name, entry) is not entry]
    return [by_name[name] for name in sorted(by_name)], twice


def _check_count(posed: PosedPhotos, names: Sequence[str]) -> None:
    if len(names) == 1:
        raise InputError(
            f"{posed.source}: only one photo ({names[0]}) is left to learn from; at least two are needed"
        )


def _held_out(entries: Sequence[PosedPhoto]) -> list[bool]:
    if any(entry.held_out is not None for entry in entries):
        return [bool(entry.held_out) for entry in entries]
    # All faces of a panorama or none.
    files = {path: i for i, path in enumerate(dict.fromkeys(entry.path for entry in entries))}
    return [files[entry.path] % HOLD_OUT_EVERY == 0 for entry in entries]


def _resized(entry: PosedPhoto, downscale: int, lens: LensUse):
    camera = replace(entry.camera, name=entry.name, lens=entry.camera.lens if lens == "through" else None)
    width, height = downscaled_size(camera.width, camera.height, downscale)
    if not (width >= 1 and height >= 1):
        raise InputError(
            f"{entry.path}: at {camera.width}x{camera.height} pixels nothing is left of it after "
            f"downscaling by {downscale}"
        )
    return camera.resized(width, height)


How = tuple[int, tuple[float, float, float], LensUse, MaskUse]
"""How photos are read: downscale, background, and what is done about lenses and masks."""


def _read_all(entries: Sequence[PosedPhoto], how: How, progress: Progress) -> Iterator[Pixels]:
    """Yields `read_pixels` of each photo in turn."""
    downscale, _, lens, _ = how
    for entry in entries:
        _resized(entry, downscale, lens)
    # A panorama is decoded once for all of its faces, which follow one another by their names.
    files = [list(group) for _, group in groupby(entries, key=lambda entry: entry.path)]
    readers = max(1, min(MAX_READERS, os.cpu_count() or 1))
    pool = ThreadPoolExecutor(readers, thread_name_prefix="photos")
    try:
        progress.step(0.0)
        # Only a few ahead: what is read and waits is held in memory.
        pending = [pool.submit(read_file, file, *how) for file in files[: 2 * readers]]
        for i in range(len(files)):
            result = pending[i].result()
            progress.step((i + 1) / len(files))
            if len(pending) < len(files):
                pending.append(pool.submit(read_file, files[len(pending)], *how))
            yield from result
    finally:
        pool.shutdown(cancel_futures=True)


def _in_memory(pixels: Pixels) -> Callable[[], Pixels]:
    return lambda: pixels


def _without_unknown(pixels: Callable[[], Pixels]) -> Callable[[], Pixels]:
    return lambda: without_unknown(pixels())


def _on_demand(entry: PosedPhoto, how: How) -> Callable[[], Pixels]:
    return lambda: read_pixels(entry, *how)


def _by_lens(entries: Sequence[PosedPhoto]) -> Iterator[tuple[Camera, Lens, np.ndarray]]:
    """Cameras that see alike, through their lens, and (25, 25, 2) pixels, px, all over their photos."""
    cameras = {intrinsics_of(entry.camera): entry.camera for entry in entries}
    for camera in cameras.values():
        if camera.lens is not None:
            x, y = (np.linspace(0.5, size - 0.5, 25) for size in (camera.width, camera.height))
            yield camera, camera.lens, np.stack(np.meshgrid(x, y), axis=-1)


def _lens_notes(entries: Sequence[PosedPhoto]) -> list[str]:
    """A line for each lens of which a good part of the photo lies outside the undistorted picture."""
    notes = []
    for camera, lens, grid in _by_lens(entries):
        pinhole = replace(camera, lens=None)
        there = pinhole.image_points(camera.points_at(grid, 1.0))
        with np.errstate(invalid="ignore"):
            shown = ((there >= 0) & (there <= (camera.width, camera.height))).all(axis=-1)
        lost = 1 - shown.mean()
        if lost > LOSS_TO_MENTION:
            notes.append(
                f"{lost:.0%} of each {lens.model} photo lies outside its undistorted picture and is not used"
            )
    return notes


def _folding_lenses(entries: Sequence[PosedPhoto]) -> list[str]:
    """A line about the worst of lenses, no fisheyes, whose polynomial turns back on itself well within
    photos."""
    found = [
        (1 - np.isfinite(camera.points_at(grid, 1.0)).all(axis=-1).mean(), str(lens))
        for camera, lens, grid in _by_lens(entries)
        if not lens.form.slope
    ]
    share, lens = max(found, default=(0.0, ""))
    if not share > FOLD_TO_MENTION:
        return []
    return [
        f"{share:.0%} of a photo is beyond what its lens ({lens}) can show, and is not used: such a"
        " calibration is wrong; find it and the poses anew, or remove the distortion from the file"
    ]


def _stretched(entries: Sequence[PosedPhoto]) -> list[str]:
    """A line about the worst of the cameras whose pixels would be no squares by far."""
    worst = max((entry.camera for entry in entries), key=_stretch)
    if not _stretch(worst) > STRETCH_TO_MENTION:
        return []
    return [
        f"a photo's pixels would be {_stretch(worst):.3g} times as long one way as the other (focal lengths "
        f"{worst.fx:.4g} and {worst.fy:.4g} px): such a calibration is wrong; find it and the poses anew"
    ]


def _stretch(camera: Camera) -> float:
    return max(camera.fx / camera.fy, camera.fy / camera.fx)


def capture_name(path: Path) -> str:
    return path.absolute().name or "capture"


FILE_NAME = "cameras.json"

POINTS = ("input.ply", "points3d.ply")
"""Where that trainer keeps the points that it started from."""


def read_camera_list(folder: Path, path: Path) -> PosedPhotos:
    """The capture in `folder` by the list of cameras at `path`. Raises InputError.

    The list gives the photos' names, with or without suffix, but not where they are: see
    `photo_folders`.
    """
    cameras = load_cameras(path)
    places = [Files(place) for place in photo_folders(folder)]
    photos = next((p for p in places if any(p.photo(camera.name) for camera in cameras)), places[0])
    masks = Files(folder / "masks")
    entries, missing = [], []
    for camera in cameras:
        name, photo = tidy_name(camera.name), photos.photo(camera.name)
        if photo is None:
            missing.append(name)
            continue
        entries.append(PosedPhoto(name=name, path=photo, camera=camera, mask=masks.mask(name)))
    check_photos(path, photos.root, entries, missing)
    points, colours, warnings = first_points(folder, (), POINTS)
    return PosedPhotos(
        source=path,
        images=photos.root,
        entries=entries,
        missing=missing,
        points=points,
        point_colours=colours,
        warnings=warnings,
    )
