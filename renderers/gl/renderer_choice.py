"""Which of `quads` and `tiles` draws faster on a GPU: tried, and remembered for each driver.

GPUs differ in this more than in anything else: an H200, which has many compute units and few that rasterise,
draws 100,000 to 6 million splats at 1920x1080 1.9 to 5.6 times as fast by tiles (assets/benchmarks/gpu.json).
"""

from __future__ import annotations

import json
import time
from contextlib import suppress
from pathlib import Path

import moderngl
import numpy as np

from splatview.renderers.gl.context import describe, missing_compute
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, InputError, look_at
from splatview.scene.formats.io import atomic_write
from splatview.scene.user_dirs import cache_folder

SPLATS, SIZE = 100_000, (1280, 720)

VIEWS = 5
"""Drawn by both in turn, after one that compiles the programs."""

KINDS = {"quads": QuadsRenderer, "tiles": TilesRenderer}


def faster(ctx: moderngl.Context) -> tuple[str, str]:
    """Name of the renderer for this GPU, and why, in words. The first time on a driver that takes a second or
    so."""
    lacking = missing_compute(ctx)
    if lacking is not None:
        return "quads", lacking
    path, info = memory(), describe(ctx)
    driver = f"{info.renderer}, {info.version}"
    known = remembered(path)
    if driver not in known:
        known[driver] = milliseconds(ctx)
        with suppress(OSError, InputError):  # costs only time
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as file:
                file.write(json.dumps(known, indent=1).encode())
    found = known[driver]
    best = min(found, key=found.__getitem__)
    times = ", ".join(f"{name} {ms:.1f} ms" for name, ms in found.items())
    return best, f"{times} for {SPLATS:,} splats at {SIZE[0]}x{SIZE[1]} on {info.renderer}"


def memory() -> Path:
    return cache_folder() / "renderers.json"


def remembered(path: Path) -> dict[str, dict[str, float]]:
    """Milliseconds a frame of each renderer by driver; nothing where the file cannot be read."""
    known: dict[str, dict[str, float]] = {}
    with suppress(OSError, ValueError, AttributeError):
        for driver, found in json.loads(path.read_bytes()).items():
            if isinstance(found, dict) and found.keys() == KINDS.keys():
                with suppress(TypeError, ValueError):
                    known[driver] = {name: float(ms) for name, ms in found.items()}
    return known


def milliseconds(ctx: moderngl.Context) -> dict[str, float]:
    """The least of a few frames of each renderer, with the settings that the window begins with."""
    scene = sample()
    renderers = {name: kind(ctx) for name, kind in KINDS.items()}
    times: dict[str, list[float]] = {name: [] for name in KINDS}
    try:
        for renderer in renderers.values():
            renderer.load(scene)
        for view in range(VIEWS + 1):
            eye = (2.6 * np.sin(0.2 * view), -0.4, -2.6 * np.cos(0.2 * view))
            request = FrameRequest(None, look_at(eye, (0, 0, 0), width=SIZE[0], height=SIZE[1]))
            for name, renderer in renderers.items():
                ctx.finish()
                begun = time.perf_counter()
                renderer.draw(request)
                ctx.finish()
                times[name].append(1e3 * (time.perf_counter() - begun))
    finally:
        for renderer in renderers.values():
            renderer.close()
    return {name: min(own[1:]) for name, own in times.items()}


def sample() -> Gaussians:
    """A ball of splats of all shapes, which covers itself some ten times."""
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(SPLATS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Gaussians(
        means=(direction * rng.uniform(0.7, 1.0, (SPLATS, 1))).astype(np.float32),
        quats=rng.normal(size=(SPLATS, 4)).astype(np.float32),
        log_scales=rng.normal(-5.0, 0.8, (SPLATS, 3)).astype(np.float32),
        opacity_logits=rng.normal(0.5, 1.8, SPLATS).astype(np.float32),
        sh=rng.normal(0, 0.3, (SPLATS, 4, 3)).astype(np.float32),
    )
