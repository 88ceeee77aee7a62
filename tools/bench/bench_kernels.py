"""Times every stage of the rasteriser beside what the machine's multipliers can do at best.

    python tools/bench/bench_kernels.py [--full] [--threads N] [--json FILE]

The peak is measured in the same run: a loop of independent fused multiply-adds.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from splatview.raster import Frame, Parameters, Workspace, available_threads, draw_frame, parameters_of
from splatview.raster.compiling import kernel
from splatview.raster.forward import draw_tiles
from splatview.raster.gradients import differentiate
from splatview.raster.simd import LANES, fill, fma, load, store
from splatview.scene import Camera, Gaussians, RenderSettings, look_at

FLOPS_PER_PIXEL_SPLAT = 33
"""Floating-point operations of `forward.blend_items`'s loop a pixel, a fused multiply-add being two:
6 for dx, dy, u and v, 4 for the power, 15 for 2^power, 8 for weight, transmittance and three colours."""

STAGES = ("project", "sort", "bin", "forward", "backward", "gather", "project_backward")
COUNTS = (1_000, 20_000, 100_000, 500_000, 2_000_000)
SIZES = ((128, 128), (256, 256), (640, 360), (1280, 720), (1920, 1080))
QUICK = (
    (1_000, 128, 128),
    (20_000, 256, 256),
    (100_000, 640, 360),
    (500_000, 1280, 720),
    (2_000_000, 1920, 1080),
)
"""Splats, width, height: one of each kind."""

SECONDS_PER_CASE = 1.5
MIN_REPEATS = 3
MAX_REPEATS = 50


def synthetic_scene(count: int, *, seed: int = 0) -> Gaussians:
    """Splats on a bumpy sphere, flat and of all directions, sized so that they cover it some ten times
    whatever their number, SH degree 3."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radius = (
        1 + 0.15 * np.sin(5 * normal[:, :1]) * np.cos(4 * normal[:, 1:2]) + 0.02 * rng.normal(size=(count, 1))
    )
    typical = 1.1 * np.sqrt(4 / count)
    sh = rng.normal(scale=0.08, size=(count, 16, 3))
    sh[:, 0] = 1.5 * np.sin(3 * normal) + 0.3 * rng.normal(size=(count, 3))
    return Gaussians(
        means=(normal * radius).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=(np.log(typical) + rng.normal(-0.5, 0.7, size=(count, 3))).astype(np.float32),
        opacity_logits=rng.normal(0.5, 1.8, size=count).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def synthetic_camera(width: int, height: int) -> Camera:
    """Sees the whole sphere of `synthetic_scene`, filling most of the picture's height."""
    return look_at((0.9, 0.7, -2.6), (0, 0, 0), width=width, height=height, fov_y=45.0)


@kernel
def _multiply(repeats, numbers):
    """Ten independent chains of fused multiply-adds: enough to hide their latency on any machine."""
    x = load(numbers, 0)
    factor = fill(x, 0.5)
    a, b, c, d, e = x, x + factor, x * factor, x - factor, factor
    f, g, h, i, j = a + b, b + c, c + d, d + e, e + a
    for _ in range(repeats):
        a, b, c, d, e = (
            fma(a, factor, x),
            fma(b, factor, x),
            fma(c, factor, x),
            fma(d, factor, x),
            fma(e, factor, x),
        )
        f, g, h, i, j = (
            fma(f, factor, x),
            fma(g, factor, x),
            fma(h, factor, x),
            fma(i, factor, x),
            fma(j, factor, x),
        )
    store(numbers, 0, a + b + c + d + e + f + g + h + i + j)


def peak_gflops(*, repeats: int = 1_000_000) -> float:
    """Float32 fused multiply-adds of one thread, two operations each, in GFLOP a second of its own CPU
    time: what else the machine does at the moment counts little."""
    numbers = np.ones(LANES, np.float32)
    _multiply(repeats, numbers)
    return repeats * 10 * LANES * 2 / _least_cpu_seconds(lambda: _multiply(repeats, numbers)) / 1e9


def forward_rate(frame: Frame) -> float:
    """Pixel-splats a second of CPU time of one thread, over the whole of the forward stage: setting up
    tiles, gathering records and writing pixels included."""
    bins, image = frame.bins, np.empty_like(frame.image)
    tiles = len(bins.offsets) - 1
    arguments = (
        bins.offsets,
        0,
        frame.lists,
        frame.records,
        frame.surfels,
        frame.view,
        frame.background,
        frame.termination,
        image,
        np.empty_like(frame.transmittance),
        np.empty_like(frame.n_contrib),
    )
    return frame.pixel_splats / _least_cpu_seconds(lambda: draw_tiles(0, tiles, *arguments))


def _least_cpu_seconds(call: Callable[[], object], *, repeats: int = 5) -> float:
    best = np.inf
    for _ in range(repeats):
        begun = time.thread_time()
        call()
        best = min(best, time.thread_time() - begun)
    return best


def measure(
    splats: Parameters, camera: Camera, threads: int, *, seconds: float = SECONDS_PER_CASE
) -> dict[str, Any]:
    """Median and least milliseconds by stage of forward and backward, what there was to do, and the rate of
    the forward stage beside the peak measured just before, both of one thread."""
    workspace = Workspace()
    weights = np.random.default_rng(1).normal(size=(camera.height, camera.width, 4)).astype(np.float32)
    samples: list[dict[str, float]] = []
    frame = draw_frame(splats, camera, RenderSettings(), workspace, threads=threads)
    gradients = differentiate(splats, frame, weights, by_view=False)  # compiles, and finds its memory
    deadline = time.perf_counter() + seconds
    while len(samples) < MIN_REPEATS or (time.perf_counter() < deadline and len(samples) < MAX_REPEATS):
        frame = draw_frame(splats, camera, RenderSettings(), workspace, threads=threads)
        gradients = differentiate(splats, frame, weights, by_view=False, reuse=gradients)
        samples.append({**frame.milliseconds, **gradients.milliseconds})
    peak, rate = peak_gflops(), forward_rate(frame)
    times = np.array([[sample.get(stage, 0.0) for stage in STAGES] for sample in samples])
    return {
        "splats": len(splats.means),
        "size": [camera.width, camera.height],
        "threads": threads,
        "visible": len(frame.bins.order),
        "pairs": int(frame.bins.offsets[-1]),
        "pixel_splats": frame.pixel_splats,
        "ms": dict(zip(STAGES, np.median(times, axis=0).round(3).tolist(), strict=True)),
        "min_ms": dict(zip(STAGES, times.min(axis=0).round(3).tolist(), strict=True)),
        "picture_ms": round(float(np.median(times[:, :4].sum(axis=1))), 3),
        "step_ms": round(float(np.median(times.sum(axis=1))), 3),
        "repeats": len(times),
        "workspace_bytes": workspace.nbytes,
        "gpixel_splats_per_s": round(rate / 1e9, 3),
        "peak_gflops": round(peak, 1),
        "share_of_peak": round(rate * FLOPS_PER_PIXEL_SPLAT / 1e9 / peak, 3),
    }


def measure_all(*, full: bool, threads: int) -> Iterator[dict[str, Any]]:
    """All cases one by one."""
    cases = [(count, *size) for count in COUNTS for size in SIZES] if full else QUICK
    scene, count_before = None, 0
    for count, width, height in cases:
        if scene is None or count != count_before:
            scene, count_before = parameters_of(synthetic_scene(count)), count
        yield measure(scene, synthetic_camera(width, height), threads)


def summary(result: dict[str, Any]) -> str:
    """One line for a person."""
    stages = " ".join(f"{name} {value:.2f}" for name, value in result["ms"].items())
    width, height = result["size"]
    return (
        f"{result['splats']:>8} splats {width}x{height}: {stages} ms; {result['pairs']} pairs, "
        f"{result['gpixel_splats_per_s']:.2f} G pixel-splats/s a thread, "
        f"{result['share_of_peak']:.0%} of its FMA peak"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python tools/bench/bench_kernels.py", description=__doc__)
    parser.add_argument("--full", action="store_true", help="all counts at all sizes: some minutes")
    parser.add_argument("--threads", type=int, default=available_threads())
    parser.add_argument("--json", help="write the results to this file")
    options = parser.parse_args()
    results = []
    for result in measure_all(full=options.full, threads=options.threads):
        print(summary(result), flush=True)
        results.append(result)
    if options.json:
        with open(options.json, "w", encoding="utf8") as file:
            json.dump(results, file, indent=1)


if __name__ == "__main__":
    main()
