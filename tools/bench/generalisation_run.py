"""One training of the bench: a capture, a split, a length; its figures as a line of JSON.

    CHECKOUT/.venv/bin/python tools/bench/generalisation_run.py NAME DATA MADE [--split 0] [--minutes 1]

It needs nothing but the trainer's own names, so that it also runs in a checkout from before it was written.
A minute is that of `step_seconds`, a model of what steps cost, so that a busy machine gives the same figures.
"""

from __future__ import annotations

import argparse
import json
import resource
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from capture_set import RENDERED, bench_split, folder_of, with_fault, with_passing
from PIL import Image
from public_captures import PUBLIC

STEP_MS, KILOPIXEL_MS, THOUSAND_SPLATS_MS = 1.0, 0.2, 0.35
"""What a step costs, by the size of its photo and the number of splats: a fit within 20 % to steps of 17 to
100 ms that a quiet machine with two cores took for 45,000 to 93,000 px and 20,000 to 200,000 splats."""

ONCE_MS = 0.1
"""Of the price of a thousand splats, what a step pays once for all its photos: Adam and density control."""

DRAWN = 3
"""Pictures that are drawn in the time of a step; of a picture taught its depths are one more."""

START = 3.0
"""Seconds before the first step."""


LARGE_KILOPIXEL_MS, LARGE_SPLATS_MS = 0.065, 0.4
"""The second and third of these for photos of other sizes than the bench's: a fit within 15 % to steps of 13
to 45 ms for 107,000 and 426,000 px and 17,500 to 49,300 splats. The bench keeps its own, by which pixels cost
three times as much: else no two of its rows could be compared."""


def step_seconds(pixels: float, splats: int, photos: int = 1, *, large: bool = False) -> float:
    """The price of a step by the model above: a run is as long on a busy machine as on a quiet one."""
    of_pixels = LARGE_KILOPIXEL_MS if large else KILOPIXEL_MS
    of_splats = LARGE_SPLATS_MS if large else THOUSAND_SPLATS_MS
    once = STEP_MS + ONCE_MS * splats / 1e3
    return (once + photos * (of_pixels * pixels + (of_splats - ONCE_MS) * splats) / 1e3) / 1e3


def photo_opacity(name: str, made: Path, camera: Any) -> np.ndarray | None:
    """(H, W) uint8: the opacity of a camera's photo, in that camera's size; None where photos are opaque."""
    if name not in (*RENDERED, *PUBLIC):
        return None
    path = folder_of(name, made) / camera.name
    path = path if path.exists() else path.with_suffix(".png")  # NeRF's set names photos without
    if not path.exists():
        return None
    with Image.open(path) as image:
        if image.mode != "RGBA":
            return None
        size = (camera.width, camera.height)
        return np.asarray(image.getchannel("A").resize(size, Image.Resampling.BOX))


def haze(name: str, made: Path, views: Any, parameters: Any, settings: Any) -> float | None:
    """Mean opacity that the scene has where held-out photos are empty; None where photos are opaque."""
    from splatview.raster import Workspace, draw_frame

    found = []
    for view in views:
        opacity = photo_opacity(name, made, view.camera)
        if opacity is None:
            opacity = getattr(view, "alpha", None)  # cut out by a mask
        if opacity is None:
            return None
        drawn = draw_frame(parameters, view.camera, settings, Workspace()).image[..., 3]
        if (opacity == 0).any():
            found.append(float(drawn[opacity == 0].mean()))
    return float(np.mean(found)) if found else None


HOLE = 0.7
"""Opacity below which what a photo shows is a hole."""


def holes(views: Any, parameters: Any, settings: Any) -> float | None:
    """Share of what the photos trained on show through which something else shines, were it behind; of up to
    twelve photos. None where they are transparent."""
    from splatview.raster import Workspace, draw_frame

    found = []
    if any(view.alpha is not None for view in views):
        return None
    for view in views[:: -(-len(views) // 12)]:
        drawn = draw_frame(parameters, view.camera, settings, Workspace()).image[..., 3]
        shown = drawn if view.mask is None else drawn[view.mask]
        found.append(float((shown < HOLE).mean()) if shown.size else 0.0)
    return float(np.mean(found)) if found else None


def sky_errors(
    name: str, made: Path, held_out: Any, trained: Any, scene: Any, settings: Any, pictures: Path | None
) -> dict[str, float]:
    """How wrong the sky is where a capture's truth is known, in held-out photos ("sky") and in directions
    that no photo trained on shows ("unseen"): mean absolute difference, 0 to 1, and the share of it that is
    empty, with an opacity below a half. Nothing for other captures."""
    from splatview.raster import Workspace, draw_frame
    from splatview.scene.captures import load_capture

    folder, found = folder_of(name, made), {}
    if name not in RENDERED or not (folder / "unseen").exists():
        return found
    probes = load_capture(folder / "unseen").photos
    cases = {
        "sky": (folder, [(view.camera, view.pixels) for view in held_out]),
        "unseen": (folder / "unseen", [(photo.camera, photo.image()) for photo in probes]),
    }
    for case, (place, views) in cases.items():
        errors, empty = [], []
        for camera, truth in views:
            size = (camera.width, camera.height)
            with Image.open(place / "sky" / Path(camera.name).name) as image:
                sky = np.asarray(image.resize(size)) > 127
            if case == "unseen":
                sky = sky & ~seen_by(trained, camera)
            drawn = draw_frame(scene, camera, settings, Workspace()).image
            colours = np.clip(drawn[..., :3], 0, 1)
            errors.append(np.abs(colours - truth / 255)[sky].mean(axis=1))
            empty.append(drawn[..., 3][sky] < 0.5)
            if case == "unseen" and pictures is not None:
                pictures.mkdir(parents=True, exist_ok=True)
                both = np.concatenate(
                    [truth, (np.clip(drawn[..., :3], 0, 1) * 255 + 0.5).astype(np.uint8)], 1
                )
                Image.fromarray(both).save(pictures / f"unseen_{Path(camera.name).stem}.png")
        for kind, values in (("error", errors), ("empty", empty)):
            found[f"{case}_{kind}"] = float(np.concatenate(values).mean())
    return found


def seen_by(trained: Any, camera: Any) -> np.ndarray:
    """(H, W) bool: pixels of a camera whose directions a photo shows."""
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    rays = camera.points_at(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), 1.0) @ camera.R_camera_world
    seen = np.zeros(len(rays), np.bool_)
    for view in trained:
        shown, local = view.camera, rays @ view.camera.R_camera_world.T
        u, v = shown.image_points(local).T
        with np.errstate(invalid="ignore"):
            seen |= (local[:, 2] > 0) & (u >= 0) & (u < shown.width) & (v >= 0) & (v < shown.height)
    return seen.reshape(camera.height, camera.width)


def outliers(trainer: Any, wrong: list[str]) -> dict[str, Any]:
    """What the run left out, and how far photos were from the median one: for each, how many times as much it
    lacked to a correlation of 1 with the scene, how much more, and what was unmet of its details."""
    found = trainer.outliers
    lacking, unmets = 1 - found.correlations, getattr(found, "unmet", found.correlations * np.nan)
    median = float(np.nanmedian(lacking)) if np.isfinite(lacking).any() else np.nan
    far = {
        name: [round(float(lack / median), 2), round(float(lack - median), 3), round(float(unmet), 3)]
        for name, lack, unmet in zip(found.names, lacking, unmets, strict=True)
    }
    right = sorted((far[name] for name in found.names if name not in wrong), reverse=True)
    return {
        "left_out": sorted(found.names_left_out),
        "wrong": {name: far[name] for name in wrong if name in far},
        "farthest_right": right[:3],
    }


def passing_before(capture: Any, split: int) -> dict[str, np.ndarray]:
    """(H, W) bool by photo: where something is put before it."""
    pairs = zip(capture.train, with_passing(capture, split, masked=True).train, strict=True)
    found = {}
    for photo, masked in pairs:
        if photo.pixels is not masked.pixels:
            own, mask = photo.pixels().mask, masked.pixels().mask
            hidden = np.asarray(mask) == 0
            found[photo.name] = hidden if own is None else own & hidden
    return found


def transients(trainer: Any, passing: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the run has masked; and of the photos before which something passes, how many these are, how many
    of them are masked, and how much their masks and what passes have in common, of what either covers."""
    found = trainer.transients
    pairs = zip(found.names, found.blocks(trainer.views.all) or [None] * len(found.names), strict=True)
    masked = {name: mask for name, mask in pairs if mask is not None}
    hit = [name for name in passing if name in masked]
    common = sum(int((masked[name] & passing[name]).sum()) for name in hit)
    either = sum(int((masked[name] | passing[name]).sum()) for name in hit)
    return {
        "found": found.found,
        "masked": sorted(masked),
        "pixels": sum(float(mask.mean()) for mask in masked.values()) / len(found.names),
        "passing": len(passing),
        "hit": len(hit),
        "common": common / either if either else None,
        "evidence": found.evidence,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("name")
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--split", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--fault", help="one of capture_set.FAULTS: a tenth of the poses are wrong")
    parser.add_argument(
        "--repaired", action="store_true", help="without the photos of these poses, or what passes"
    )
    parser.add_argument(
        "--passing", action="store_true", help="something passes before a fifth of the photos"
    )
    parser.add_argument("--no-points", action="store_true", help="without the capture's points")
    parser.add_argument("--until", type=float, default=1.0, help="share of the run after which it ends")
    parser.add_argument("--smaller", type=int, default=1, help="factor of the photos, to try rules quickly")
    parser.add_argument(
        "--downscale",
        type=int,
        help="factor of real photos in place of the bench's; prices are of large ones",
    )
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=JSON", help="fields of the settings")
    parser.add_argument("--pictures", type=Path, help="folder for held-out photos beside what was trained")
    parser.add_argument("--curve", type=float, default=0, help="seconds between scores along the way")
    options = parser.parse_args()

    from splatview.raster import Workspace, draw_frame
    from splatview.scene.captures.points import random_points
    from splatview.trainer.evaluate import evaluate, side_by_side
    from splatview.trainer.setup import kernel_threads_only, settings_for, trainer_for
    from splatview.trainer.views import TrainViews, train_views
    from splatview.trainer.warm_up import warm_up

    warm_up(lens=True)
    large = options.downscale is not None
    capture = bench_split(
        *(options.name, options.split, options.data, options.made, options.smaller, options.downscale)
    )
    if options.no_points:
        points, colours = random_points([photo.camera for photo in capture.train])
        capture = replace(capture, points=points, point_colours=colours, guessed=True)
    wrong: list[str] = []
    if options.fault:
        capture, wrong = with_fault(capture, options.fault, options.split)
    if options.repaired:
        capture = replace(capture, photos=tuple(p for p in capture.photos if p.name not in wrong))
    passing: dict[str, np.ndarray] = {}
    if options.passing:
        whole = capture
        capture = with_passing(whole, options.split, masked=options.repaired)
        passing = passing_before(whole, options.split)
    centre = capture.centre
    capture = capture.about(centre)
    views, held_out = TrainViews(train_views(capture.train), 0), train_views(capture.held_out)
    fields = {key: json.loads(value) for key, value in (pair.split("=", 1) for pair in options.set)}
    settings: Any = settings_for(capture, views, minutes=options.minutes, **fields)
    trainer = trainer_for(capture, views, settings, centre=centre, threads=options.threads)

    def shown() -> Any:
        return getattr(trainer, "shown_settings", trainer.render_settings)

    def score() -> Any:
        return evaluate(
            trainer.splats.arrays,
            held_out,
            shown(),
            threads=options.threads,
            exposures_differ=trainer.exposures.is_on,
        )

    curve: list[tuple[float, int, float]] = []
    early: dict[float, Any] = {}
    pixels, used, last, pictures = views.pixel_count / len(views), START, 0.0, 0
    with kernel_threads_only():
        while not trainer.done and trainer.progress < options.until:
            known = hasattr(trainer, "downscale")
            factor = trainer.downscale if known else settings.downscale_at(trainer.progress)
            batch = getattr(trainer, "batch", getattr(settings, "batch", 1))
            used += step_seconds(pixels / factor**2, len(trainer.splats), batch, large=large)
            trainer.step(used)
            for share in (0.05, 0.1, 0.15, 0.2, 0.25, 0.3):
                if trainer.progress >= share and share not in early:
                    early[share] = (
                        round(trainer.state.get("photo_loss", 0.0), 5),
                        round(float(np.median(1 / (1 + np.exp(-trainer.splats.arrays.opacity_logits)))), 4),
                    )
            taught = getattr(trainer, "taught", None)
            if taught is not None and not pictures:
                pictures = len(taught) * len(trainer.members)
                drawn = 2 * pictures if getattr(trainer, "taught_depths", {}) else pictures
                used += drawn * step_seconds(pixels, settings.max_splats, large=large) / DRAWN
            if options.curve and used - last >= options.curve:
                curve.append((round(used, 1), trainer.counters.iteration, round(score().psnr, 3)))
                last = used

    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
        for view in held_out:
            drawn = draw_frame(trainer.splats.arrays, view.camera, shown(), Workspace())
            file = options.pictures / f"{Path(view.camera.name).stem}.png"
            side_by_side(view, drawn.image[..., :3]).save(file)
    final = score()
    (plain, fitted), without_near = (
        [evaluate(trainer.splats.arrays, held_out, settings, exposures_differ=fit) for fit in (False, True)]
        for settings in (shown(), trainer.render_settings)
    )
    skies = sky_errors(
        *(options.name, options.made, held_out, views.all),
        *(trainer.splats.arrays, shown(), options.pictures),
    )
    result = {
        "capture": options.name,
        "split": options.split,
        **({"downscale": options.downscale} if large else {}),
        "minutes": options.minutes,
        "photos": len(views),
        "psnr": final.psnr,
        "psnr_plain": plain.psnr,
        "psnr_fitted": fitted.psnr,
        "ssim": final.ssim,
        "near": shown().model.near,
        "without_near": [found.psnr for found in without_near],
        "haze": haze(options.name, options.made, held_out, trainer.splats.arrays, shown()),
        "holes": holes(views.all, trainer.splats.arrays, trainer.render_settings),
        "iteration": trainer.counters.iteration,
        "gaussians": len(trainer.splats),
        "batch": getattr(settings, "batch", 1),
        "early_loss": list(early.values()),
        "growth_batch": int(trainer.state.get("growth_batch", 0)),
        "scenes": len(getattr(trainer, "members", ())) + bool(pictures),
        "withheld": trainer.withheld.gap if hasattr(trainer, "withheld") else None,
        "seconds": used,
        "exposure": trainer.exposures.is_on,
        "evidence": str(trainer.exposures.evidence),
        "gains": float(np.sqrt((trainer.exposures.table[..., 0] ** 2).mean())),
        "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        **skies,
        **(outliers(trainer, wrong) if hasattr(trainer, "outliers") else {}),
        **({"transients": transients(trainer, passing)} if hasattr(trainer, "transients") else {}),
        "set": fields,
    }
    print(json.dumps(result | ({"curve": curve} if curve else {})))


if __name__ == "__main__":
    main()
