"""What a rim of transparency costs a training where it counts as empty.

    python tools/bench/bench_transparency.py DATA MADE [--captures NAME ...] [--steps N]

DATA and MADE are those of `bench_generalisation.py`. The corners of all photos are made transparent, as
around what a lens has seen, and scenes are trained as if nothing were there, and without what nobody has
seen, see `splatview.scene.captures.transparency`. Takes some five minutes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from capture_set import bench_split

from splatview.measure.machine import FOLDER, write_results
from splatview.raster import render
from splatview.scene.captures import Capture
from splatview.scene.captures.capture import Photo, Pixels
from splatview.scene.captures.transparency import outline_of, unknown_for, without_unknown
from splatview.scene.effects.overrides import settings_for
from splatview.trainer.evaluate import masked_psnr
from splatview.trainer.setup import train
from splatview.trainer.views import train_views

CAPTURES = ("carton", "fox", "desk")

OBJECTS = (
    *("playbot RGBA 18", "skull RGBA 24", "guitar RGBA 24", "spot RGBA 60", "cat"),
    *("playbot close 80", "skull close 80"),
)
"""Whose transparency is to count as empty."""

REACH = 0.88
"""Of half a photo's diagonal, beyond which it is transparent: 5 % of its pixels."""

SPLATS = 15_000


def with_rim(pixels: Pixels) -> Pixels:
    height, width = pixels.image.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    away = np.hypot(x - width / 2, y - height / 2) / np.hypot(width / 2, height / 2)
    alpha = np.where(away > REACH, 0, 255).astype(np.uint8)
    image = np.where(alpha[..., None] > 0, pixels.image, 0).astype(np.uint8)
    alpha.flags.writeable = image.flags.writeable = False
    return replace(pixels, image=image, alpha=alpha)


def made_of(photos: tuple[Photo, ...], made: list[Pixels]) -> tuple[Photo, ...]:
    def of(pixels: Pixels) -> Any:
        return lambda: pixels

    return tuple(replace(photo, pixels=of(one)) for photo, one in zip(photos, made, strict=True))


def scored(capture: Capture, within: Capture, steps: int) -> float:
    """Mean PSNR, dB, of a scene of the capture on the photos that the other holds out."""
    scene = train(capture, iterations=steps, max_splats=SPLATS, threads=2).scene
    settings, views = settings_for(scene), train_views(within.held_out)
    return float(np.mean([masked_psnr(render(scene, view.camera, settings), view) for view in views]))


def measured(name: str, data: Path, made: Path, steps: int) -> dict[str, Any]:
    whole = bench_split(name, 0, data, made)
    rimmed = [with_rim(photo.pixels()) for photo in whole.photos]
    outlines = [outline_of(pixels.alpha) for pixels in rimmed if pixels.alpha is not None]
    empty = replace(whole, photos=made_of(whole.photos, rimmed), background=(0.0, 0.0, 0.0))
    ignored = replace(whole, photos=made_of(whole.photos, [without_unknown(one) for one in rimmed]))
    return {
        "capture": name,
        "photos": len(whole.train),
        "told": unknown_for(outlines, len(outlines)) is not None,
        "empty": scored(empty, ignored, steps),
        "ignored": scored(ignored, ignored, steps),
    }


def told(name: str, data: Path, made: Path) -> dict[str, Any]:
    """What an object is taken for, and how much of its photos it fills."""
    alphas = [photo.pixels().alpha for photo in bench_split(name, 0, data, made).photos]
    outlines = [outline_of(alpha) for alpha in alphas if alpha is not None]
    is_rim = unknown_for(outlines, len(alphas)) is not None
    return {"capture": name, "told": is_rim, "shown": float(np.mean(outlines))}


def row(result: dict[str, Any]) -> list[str]:
    gain = result["ignored"] - result["empty"]
    cells = [f"{result[way]:.2f}" for way in ("empty", "ignored")]
    is_rim = "yes" if result["told"] else "no"
    return [result["capture"], str(result["photos"]), is_rim, *cells, f"{gain:+.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--captures", nargs="+", default=CAPTURES, metavar="NAME")
    parser.add_argument("--steps", type=int, default=1200)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    results = []
    for name in options.captures:
        results.append(measured(name, options.data, options.made, options.steps))
        print(row(results[-1]), flush=True)
    table = {
        "columns": ["capture", "photos", "told as a rim", "empty, dB", "ignored, dB", "gain, dB"],
        "rows": [row(result) for result in results],
        "note": f"{options.steps:,} steps, {SPLATS:,} splats at most, one run each, a third of the photos "
        "held out: mean PSNR of these within the rim, where the transparent corners of all photos count as "
        "empty, and where they are ignored.",
    }
    objects = [told(name, options.data, options.made) for name in OBJECTS]
    print(*objects, sep="\n")
    out = options.output or FOLDER / "transparency.json"
    write_results(out, {"results": results, "objects": objects, "table": table})


if __name__ == "__main__":
    main()
