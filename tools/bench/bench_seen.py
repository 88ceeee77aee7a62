"""Where held-out pictures of few photos are wrong: by how many of the photos trained on show the same place.

    python tools/bench/bench_seen.py DATA MADE --checkout NAME=PATH ... [--captures NAME ...]
        [--splits 0 1 2] --pictures DIR

For parts of `miku` only: where things are is told by a scene that is trained on all of its photos, three
minutes of the bench. A photo shows the place that a pixel of a held-out one shows where that scene's depth
there is the place's own, within `TOLERANCE`. Runs of the checkouts are a minute long, see
`bench_generalisation`; their pictures are kept in DIR, and only what is missing there is run.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from bench_generalisation import run_one
from capture_set import SPLITS, bench_capture, bench_split
from generalisation_run import START, step_seconds
from PIL import Image

from splatview.measure.machine import FOLDER, write_results
from splatview.raster import Parameters
from splatview.scene import Camera, RenderSettings
from splatview.scene.captures import Capture
from splatview.trainer.exposure import fitted_by_tiles
from splatview.trainer.functional import rasterize_depth
from splatview.trainer.setup import kernel_threads_only, settings_for, trainer_for
from splatview.trainer.views import TrainView, TrainViews, train_views
from splatview.trainer.warm_up import warm_up

WHOLE = "miku"
MINUTES = 3.0
"""Of the scene that tells where things are."""

TOLERANCE = 0.03
"""Relative difference of depths that are the same place's. That scene's depths are means over what is half
transparent, too."""

MOST_SEEN = 2
"""Photos that show a place, from which on they are one class."""

CLASSES = ("none", "one", "more")

NOTE = (
    "Pixels of held-out thirds of the photos by how many of the photos trained on show the same place, three "
    "splits: their share of all pixels, and of the squared error of the present recipe; then the PSNR in dB "
    "of each class alone, of all splits and photos together, after a fit of exposures and as it is. Where "
    "things are is told by a scene trained on all photos. A minute of a model of what a step costs on two "
    "cores."
)


def trained_scene(
    capture: Capture, views: TrainViews, minutes: float, centre: np.ndarray
) -> tuple[Parameters, RenderSettings]:
    """The scene of a run of so many minutes of the bench, and how it is drawn. `capture` and `views` are
    about `centre`."""
    settings = settings_for(capture, views, minutes=minutes)
    trainer = trainer_for(capture, views, settings, centre=centre, threads=1)
    pixels, used = views.pixel_count / len(views), START
    with kernel_threads_only():
        while not trainer.done:
            used += step_seconds(pixels / trainer.downscale**2, len(trainer.splats), trainer.batch)
            trainer.step(used)
    return trainer.splats.arrays, trainer.shown_settings


def whole_scene(data: Path, made: Path, centre: np.ndarray) -> tuple[Parameters, RenderSettings]:
    """A scene of all photos, about `centre`."""
    capture = bench_capture(WHOLE, data, made, 1).about(centre)
    return trained_scene(capture, TrainViews(train_views(capture.photos), 0), MINUTES, centre)


def depth_of(scene: tuple[Parameters, RenderSettings], camera: Camera) -> np.ndarray:
    """(H, W): the mean depth of what each pixel shows, 0 where that is nothing."""
    means, quats, log_scales, opacity_logits, _ = map(torch.from_numpy, scene[0])
    return rasterize_depth(means, quats, log_scales, opacity_logits, camera, scene[1]).numpy()


def places_at(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """(H·W, 3): where in the world the pixels of a camera are at a depth (H, W) each."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    local = camera.points_at(np.stack([x, y], axis=-1).reshape(-1, 2), 1.0) * depth.reshape(-1, 1)
    return (local - camera.t_camera_world) @ camera.R_camera_world


def photos_of_places(
    scene: tuple[Parameters, RenderSettings], camera: Camera, trained: list[Camera]
) -> np.ndarray:
    """(H, W): how many of the cameras `trained` show what each pixel of `camera` shows."""
    at = depth_of(scene, camera)
    places = places_at(at, camera)
    count = np.zeros(len(places), np.int64)
    for other in trained:
        there = places @ other.R_camera_world.T + other.t_camera_world
        u, v = other.image_points(there).T
        with np.errstate(invalid="ignore"):
            inside = (there[:, 2] > 0) & (u >= 0) & (u < other.width) & (v >= 0) & (v < other.height)
        known, rows = depth_of(scene, other), np.flatnonzero(inside & (at.reshape(-1) > 0))
        same = known[v[rows].astype(int), u[rows].astype(int)] / there[rows, 2]
        count[rows[np.abs(same - 1) < TOLERANCE]] += 1
    return count.reshape(at.shape)


def squared_errors(picture: np.ndarray, view: TrainView) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) each: squared differences of colours to the photo, after a fit of exposures and as it is."""
    truth = view.pixels.astype(np.float32) / 255
    fitted = fitted_by_tiles(picture, view)
    return tuple(((np.clip(shown, 0, 1) - truth) ** 2).mean(axis=2) for shown in (fitted, picture))  # pyright: ignore[reportReturnType]


def measured(
    name: str, split: int, arguments: argparse.Namespace, scene: Any, centre: np.ndarray
) -> dict[str, Any]:
    """Pixels of a split's held-out photos by class, and squared errors there by checkout."""
    capture = bench_split(name, split, arguments.data, arguments.made).about(centre)
    cameras, views = [photo.camera for photo in train_views(capture.train)], train_views(capture.held_out)
    classes = [
        np.minimum(photos_of_places(scene, view.camera, cameras), MOST_SEEN).reshape(-1) for view in views
    ]
    counts = np.sum([np.bincount(found, minlength=MOST_SEEN + 1) for found in classes], axis=0)
    errors = {}
    for checkout, path in arguments.checkouts.items():
        folder = arguments.pictures / checkout / f"{name.replace(' ', '-')}-{split}"
        if not folder.exists():
            key = (checkout, name, split, 1.0, 0)
            run_one(path, key, arguments.data, arguments.made, [], "--pictures", str(folder))
        sums = np.zeros((2, MOST_SEEN + 1))
        for view, found in zip(views, classes, strict=True):
            with Image.open(folder / f"{Path(view.camera.name).stem}.png") as image:
                both = np.asarray(image)
            picture = both[:, view.camera.width : 2 * view.camera.width].astype(np.float32) / 255
            for row, error in zip(sums, squared_errors(picture, view), strict=True):
                row += np.bincount(found, error.reshape(-1), minlength=MOST_SEEN + 1)
        errors[checkout] = sums.tolist()
    return {"capture": name, "split": split, "pixels": counts.tolist(), "errors": errors}


def decibels(errors: np.ndarray, pixels: np.ndarray) -> str:
    return ", ".join(f"{-10 * np.log10(error / pixels):.2f}" for error in errors)


def table(runs: list[dict[str, Any]], checkouts: list[str]) -> dict[str, Any]:
    """A row for each capture and class."""
    rows = []
    for name in dict.fromkeys(run["capture"] for run in runs):
        mine = [run for run in runs if run["capture"] == name]
        pixels = np.sum([run["pixels"] for run in mine], axis=0)
        errors = {of: np.sum([run["errors"][of] for run in mine], axis=0) for of in checkouts}
        last = errors[checkouts[-1]]
        for number, label in enumerate(CLASSES):
            shares = (pixels[number] / pixels.sum(), last[1][number] / last[1].sum())
            cells = [decibels(errors[of][:, number], pixels[number]) for of in checkouts]
            rows.append([name, label, *(f"{share:.0%}" for share in shares), *cells])
    columns = ["capture", "photos that show the place", "of the pixels", "of the error", *checkouts]
    return {"columns": columns, "rows": rows, "note": NOTE}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--checkout", action="append", required=True, metavar="NAME=PATH")
    parser.add_argument("--captures", nargs="+", default=["miku 12 far", "miku 12 near"])
    parser.add_argument("--splits", type=int, nargs="+", default=list(range(SPLITS)))
    parser.add_argument("--pictures", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "seen.json")
    arguments = parser.parse_args()
    arguments.checkouts = {
        name: Path(path) for name, path in (pair.split("=", 1) for pair in arguments.checkout)
    }
    warm_up()
    centre = bench_capture(WHOLE, arguments.data, arguments.made, 1).centre
    scene = whole_scene(arguments.data, arguments.made, centre)
    runs = []
    for name in arguments.captures:
        for split in arguments.splits:
            runs.append(measured(name, split, arguments, scene, centre))
            write_results(arguments.output, {"runs": runs, "table": table(runs, list(arguments.checkouts))})
            print(table(runs, list(arguments.checkouts))["rows"], flush=True)


if __name__ == "__main__":
    main()
