"""Training through the lens against training on undistorted photos: held-out PSNR against known truth.

    python tools/bench/bench_lens.py [--steps 3000] [--seconds 60]

The demo scene is photographed through lenses that distort a lot, and trained both ways, a pair of runs at a
time, each on one thread, so that both meet the same machine; once for an equal number of steps, once for
equal seconds. Both results are measured on the same pictures of the truth from the held-out poses: through
the lens, as the photos are, and by the pinhole that undistorted photos have. Takes about 15 minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from splatview.measure.machine import FOLDER, write_results
from splatview.measure.metrics import psnr
from splatview.raster import render
from splatview.scene import Camera, Gaussians, Lens
from splatview.scene.captures import LensUse, load_capture
from splatview.scene.captures.demo import demo_capture, demo_truth
from splatview.scene.captures.nerfstudio import save_capture
from splatview.scene.formats import load_scene

SPLATS, PHOTOS, WIDTH, HEIGHT = 60_000, 40, 320, 240

MAX_SPLATS = 30_000
"""Of a run: both ways the same."""

LENSES = {
    "OPENCV, barrel": (Lens(model="OPENCV", parameters=(-0.28, 0.07, 0.002, -0.001)), 75.0),
    "RADIAL, mild": (Lens(model="RADIAL", parameters=(-0.03, 0.005)), 46.0),
    "fisheye, 140° across": (
        Lens(model="OPENCV_FISHEYE", parameters=(0.02, -0.01, 0.0, 0.0)),
        2 * math.degrees(math.atan(HEIGHT / 2 / (WIDTH / 2 / math.radians(70)))),
    ),
}
"""Lens, and the vertical angle of the pinhole with its focal length."""


def begin(capture: Path, use: str, length: Sequence[str], out: Path) -> subprocess.Popen[bytes]:
    program = "import sys; from splatview.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "train", str(capture), "--headless", "--lens", use, *length]
    command += ["--max-splats", str(MAX_SPLATS), "--threads", "1"]
    command += ["--metrics", str(out.with_suffix(".jsonl")), "-o", str(out)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def mean_psnr(scene: Gaussians, truth: Gaussians, cameras: Sequence[Camera]) -> float:
    """dB, of pictures of the truth rounded as photos are."""
    values = []
    for camera in cameras:
        photo = np.round(np.clip(render(truth, camera)[..., :3], 0, 1) * 255) / 255
        values.append(psnr(render(scene, camera)[..., :3], photo))
    return float(np.mean(values))


def compare(name: str, length: Sequence[str], folder: Path, truth: Gaussians) -> list[dict[str, Any]]:
    """A pair of runs at the same time."""
    capture = folder / name
    held_out = [photo.camera for photo in load_capture(capture, lens="through").held_out]
    uses = get_args(LensUse)
    outs = [folder / f"{use}.ply" for use in uses]
    for out in outs:
        out.with_suffix(".jsonl").unlink(missing_ok=True)
    runs = [begin(capture, use, length, out) for use, out in zip(uses, outs, strict=True)]
    if any(run.wait() for run in runs):
        raise SystemExit(f"{name}: a run failed")
    found = []
    for use, out in zip(uses, outs, strict=True):
        last = json.loads(out.with_suffix(".jsonl").read_text().splitlines()[-1])
        scene = load_scene(out)
        found.append(
            {
                "lens": name,
                "use": use,
                "length": " ".join(length).removeprefix("--"),
                "iteration": last["iteration"],
                "seconds": last["seconds"],
                "gaussians": last["gaussians"],
                "psnr_lens": mean_psnr(scene, truth, held_out),
                "psnr_pinhole": mean_psnr(scene, truth, [replace(c, lens=None) for c in held_out]),
            }
        )
        print(found[-1], flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--seconds", type=float, default=60)
    options = parser.parse_args()
    truth = demo_truth(SPLATS)
    lengths = (["--iterations", str(options.steps)], ["--minutes", str(options.seconds / 60)])
    runs: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for lens_name, (lens, fov_y) in LENSES.items():
            size = {"photos": PHOTOS, "width": WIDTH, "height": HEIGHT, "fov_y": fov_y}
            save_capture(demo_capture(render, truth=truth, lens=lens, **size), folder / lens_name)
            for length in lengths:
                runs += compare(lens_name, length, folder, truth)
    columns = ["lens", "photos", "length", "steps", "through the lens, dB", "as a pinhole, dB"]
    rows = [
        [
            run["lens"],
            run["use"],
            run["length"],
            f"{run['iteration']:,}",
            f"{run['psnr_lens']:.2f}",
            f"{run['psnr_pinhole']:.2f}",
        ]
        for run in runs
    ]
    note = (
        f"{PHOTOS} pictures of the demo scene, {WIDTH}x{HEIGHT}, {SPLATS:,} splats; held-out PSNR against "
        "the truth itself. Pairs ran side by side on one thread each. Far off a fisheye's axis large splats, "
        "linearised at their middle, smear over the picture, from each place differently: no scene explains "
        "all of these photos, and neither way does well."
    )
    write_results(
        FOLDER / "lens.json", {"runs": runs, "table": {"columns": columns, "rows": rows, "note": note}}
    )


if __name__ == "__main__":
    main()
