"""What of a scene's haze photos could have told: opacity where held-out photos are empty, by whether a photo
trained on shows that nothing is there.

    python tools/bench/bench_haze.py DATA MADE [--captures NAME ...] [--splits 0 1 2]

A photo tells that a place is empty where it is transparent there. What hides behind an object from every
photo, or stands before one, none tells of: its colours alone can. Runs are a minute long, see
`bench_generalisation`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from bench_seen import depth_of, places_at, trained_scene
from capture_set import SPLITS, bench_split, use_of
from generalisation_run import photo_opacity

from splatview.measure.machine import FOLDER, write_results
from splatview.raster import Workspace, draw_frame
from splatview.scene import Camera
from splatview.trainer.views import TrainViews, train_views
from splatview.trainer.warm_up import warm_up

CAPTURES = [
    *("playbot close 80", "skull close 80", "playbot RGBA 100", "skull RGBA 100"),
    *("playbot RGBA 18", "skull RGBA 24"),
]

MINUTES = 1.0

LEAST = 1 / 255
"""Opacity below which a pixel is as empty as its photo, and nothing needs to tell."""

NOTE = (
    "Mean opacity in all pixels where held-out thirds of the photos are empty, three splits: of those where "
    "what stands there hides from all photos trained on, behind or before what they show, and of all others, "
    "where one at least is transparent there, or nothing stands. Places are those of the mean depth of what "
    "is drawn. A minute of a model of what a step costs on two cores."
)


def told_empty(places: np.ndarray, photos: list[tuple[Camera, np.ndarray]]) -> np.ndarray:
    """(P,) bool: whether a photo is transparent at these places (P, 3) of the world. `photos`: their cameras
    and opacities (H, W)."""
    told = np.zeros(len(places), np.bool_)
    for camera, opacity in photos:
        local = places @ camera.R_camera_world.T + camera.t_camera_world
        u, v = camera.image_points(local).T
        with np.errstate(invalid="ignore"):
            inside = (local[:, 2] > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        rows = np.flatnonzero(inside)
        told[rows] |= opacity[v[rows].astype(int), u[rows].astype(int)] == 0
    return told


def measured(name: str, split: int, data: Path, made: Path) -> dict[str, Any]:
    """Empty pixels of a split's held-out photos, and their opacities in sum: of those that hide from all
    photos trained on, and of the others."""
    capture = bench_split(name, split, data, made)
    centre = capture.centre
    capture = capture.about(centre)
    views = TrainViews(train_views(capture.train), 0)
    scene = trained_scene(capture, views, MINUTES, centre)
    opacities = [photo_opacity(name, made, view.camera) for view in views.all]
    photos = [(v.camera, found) for v, found in zip(views.all, opacities, strict=True) if found is not None]
    pixels, sums = np.zeros(2, np.int64), np.zeros(2)
    for view in train_views(capture.held_out):
        photo = photo_opacity(name, made, view.camera)
        if photo is None:
            raise SystemExit(f"{name}: its photos are opaque, name captures that are transparent")
        drawn = draw_frame(scene[0], view.camera, scene[1], Workspace()).image[..., 3].reshape(-1)
        hidden = ~told_empty(places_at(depth_of(scene, view.camera), view.camera), photos) & (drawn >= LEAST)
        empty = photo.reshape(-1) == 0
        for place, chosen in enumerate((empty & hidden, empty & ~hidden)):
            pixels[place] += int(chosen.sum())
            sums[place] += float(drawn[chosen].sum())
    return {"capture": name, "split": split, "pixels": pixels.tolist(), "opacities": sums.tolist()}


def table(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """A row for each capture."""
    rows = []
    for name in dict.fromkeys(run["capture"] for run in runs):
        mine = [run for run in runs if run["capture"] == name]
        pixels = np.sum([run["pixels"] for run in mine], axis=0)
        sums = np.sum([run["opacities"] for run in mine], axis=0)
        hidden, other = sums / np.maximum(pixels, 1)
        cells = [f"{sums.sum() / pixels.sum():.4f}", f"{pixels[0] / pixels.sum():.2%}"]
        cells += [f"{hidden:.3f}", f"{sums[0] / sums.sum():.0%}", f"{other:.4f}"]
        rows.append([name, use_of(name), len(mine), *cells])
    columns = ["capture", "rules", "splits", "haze of all", "hides from all photos", "haze there"]
    return {"columns": [*columns, "of all haze", "haze elsewhere"], "rows": rows, "note": NOTE}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--captures", nargs="+", default=CAPTURES)
    parser.add_argument("--splits", type=int, nargs="+", default=list(range(SPLITS)))
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "haze.json")
    arguments = parser.parse_args()
    warm_up()
    runs = []
    for name in arguments.captures:
        for split in arguments.splits:
            runs.append(measured(name, split, arguments.data, arguments.made))
            write_results(arguments.output, {"runs": runs, "table": table(runs)})
            print(table(runs)["rows"][-1], flush=True)


if __name__ == "__main__":
    main()
