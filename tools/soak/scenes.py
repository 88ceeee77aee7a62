"""What a soak opens: scenes of several kinds, some of them bad, and photos to train on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from splatview.raster import render
from splatview.scene import Gaussians
from splatview.scene.captures.demo import demo_capture
from splatview.scene.captures.nerfstudio import save_capture
from splatview.scene.formats import save_scene

GOOD = ("ball.ply", "flat.ply", "one.ply", "far.ply", "ill.ply")
BROKEN = "broken.ply"


def make_scenes(folder: Path, *, small: bool) -> None:
    """Writes GOOD scenes and the BROKEN one."""
    most = 800 if small else 8000
    ball = random_scene(most, seed=1, degree=3)
    save_scene(ball, folder / "ball.ply")
    save_scene(random_scene(most // 2, seed=2, degree=0), folder / "flat.ply")
    save_scene(random_scene(1, seed=3, degree=1), folder / "one.ply")
    # What float32 can still tell apart there: steps of 0.06.
    far = random_scene(most // 4, seed=4, degree=2)
    save_scene(replace(far, means=(50 * far.means + np.float32(5e5))), folder / "far.ply")
    save_scene(ill(random_scene(most // 2, seed=5, degree=1)), folder / "ill.ply")
    (folder / BROKEN).write_bytes((folder / "ball.ply").read_bytes()[:-100])


def make_capture(folder: Path, *, small: bool) -> Path:
    """Photos of the demo scene."""
    width, height = (64, 48) if small else (160, 120)
    path = folder / "capture"
    if not path.exists():
        save_capture(demo_capture(render, photos=10, splats=3000, width=width, height=height), path)
    return path


def random_scene(count: int, *, seed: int, degree: int) -> Gaussians:
    """Splats of all shapes in a unit ball."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Gaussians(
        means=(direction * rng.uniform(size=(count, 1)) ** (1 / 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(-3.2, 0.8, (count, 3)).astype(np.float32),
        opacity_logits=rng.normal(0.5, 2.0, count).astype(np.float32),
        sh=rng.normal(0, 0.25, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def ill(scene: Gaussians) -> Gaussians:
    """With some of what files should not hold, and may."""
    means, quats, log_scales = scene.means.copy(), scene.quats.copy(), scene.log_scales.copy()
    opacity_logits = scene.opacity_logits.copy()
    means[0, 0], means[1] = np.nan, np.inf
    quats[2:4] = 0
    log_scales[4, 0], log_scales[5], log_scales[6] = 30, -30, np.nan
    opacity_logits[7:10] = np.nan, np.inf, -np.inf
    means[10:20] = means[10]
    return replace(scene, means=means, quats=quats, log_scales=log_scales, opacity_logits=opacity_logits)
