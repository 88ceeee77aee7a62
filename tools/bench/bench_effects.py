"""Pipelines made for what a scene calls for, against one pipeline that has every effect, in one run.

    python tools/bench/bench_effects.py [SCENE ...] [--size WxH] [--frames N]

`quads`, `tiles`: specialised programs and the bands that the scene has, against general programs with
every effect switched off by uniforms, harmonics to degree 3 in float32, and the buffers that the effects
need.
`cpu`: kernels without edits and the scene's degree, against the kernels with edits, told that no splat has
any, and degree 3. Both give the same picture.

Every view is drawn by the specialised, the general, and a second time by the specialised pipeline, in an
order that turns round from frame to frame; the last against the first is the noise. Without a scene two
synthetic ones are drawn, of degree 0 and 3.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from bench_kernels import synthetic_scene
from harness import in_turn, load_scenes, make_parser, orbit_of

from splatview import raster
from splatview.measure.machine import write_results
from splatview.renderers.gl.context import create_headless_context, describe, held_bytes
from splatview.renderers.gl.programs import Variants
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import IDENTITY, SELECTED, Adjustment, SceneEdits
from splatview.scene.effects.overrides import settings_for
from splatview.scene.framing import frame_camera

UNSEEN = 1e-30
"""In place of zeros: stored and read as every other number is, and lost in the first sum."""

MEASURED = ("specialised", "general", "again")


@dataclass
class Pipeline:
    draw: Callable[[Camera], dict[str, float]]
    """Draws a view to finished pixels and returns the milliseconds of its stages."""
    read: Callable[[], np.ndarray]
    memory: Callable[[], int]
    """Bytes held for drawing."""


def padded(gaussians: Gaussians) -> Gaussians:
    """With all bands of degree 3, none of them zero."""
    sh = np.full((len(gaussians), 16, 3), UNSEEN, np.float32)
    have = gaussians.sh.shape[1]
    sh[:, :have] = np.where(gaussians.sh == 0, np.float32(UNSEEN), gaussians.sh)
    return replace(gaussians, sh=sh)


def settings_of(gaussians: Gaussians, *, general: bool) -> RenderSettings:
    settings = replace(settings_for(gaussians), blend="float32")
    return replace(settings, sh_degree=3) if general else settings


def every_edit(count: int) -> SceneEdits:
    """That changes nothing: the palette has an entry that no mark names."""
    return SceneEdits(marks=np.zeros(count, np.uint32), palette=(IDENTITY, Adjustment(scale=2.0)))


def on_gpu(
    kind: type[QuadsRenderer] | type[TilesRenderer], ctx, gaussians: Gaussians, *, general: bool
) -> Pipeline:
    variants = Variants(ctx)
    renderer = kind(ctx, variants=variants)
    chosen = variants.generally if general else contextlib.nullcontext
    settings = settings_of(gaussians, general=general)
    renderer.every_band = general
    with chosen():
        renderer.load(padded(gaussians) if general else gaussians)
    if general:
        # What the effects need is there before one is switched on.
        camera = frame_camera(gaussians, 64, 64)
        marks = np.full(len(gaussians), SELECTED, np.uint32)
        with chosen():
            renderer.draw(
                FrameRequest(
                    None,
                    camera,
                    settings,
                    edits=SceneEdits(marks=marks, flags=SELECTED),
                    highlight=Highlight(),
                )
            )

    def draw(camera: Camera) -> dict[str, float]:
        with chosen():
            renderer.draw(FrameRequest(None, camera, settings))
            ctx.finish()
        return dict(renderer.stats(wait=True).ms)

    def memory() -> int:
        sorted_only = general and isinstance(renderer, QuadsRenderer)
        return held_bytes(renderer) + (target_bytes(renderer) if sorted_only else 0)

    return Pipeline(draw, renderer.read, memory)


def target_bytes(renderer: QuadsRenderer) -> int:
    """Of the depth buffer and the sums of weights, that orders without a sort take."""
    width, height = renderer.texture.size
    return width * height * (4 + 16)


def cpu(gaussians: Gaussians, *, general: bool) -> Pipeline:
    splats = raster.parameters_of(padded(gaussians) if general else gaussians)
    edits = every_edit(len(gaussians)) if general else None
    nonzero = None if general else raster.nonzero_bands(gaussians)
    settings, workspace = settings_of(gaussians, general=general), raster.Workspace()
    last: dict[str, np.ndarray] = {}

    def draw(camera: Camera) -> dict[str, float]:
        frame = raster.draw_frame(splats, camera, settings, workspace, edits=edits, nonzero=nonzero)
        last["image"] = frame.image
        return frame.milliseconds

    def memory() -> int:
        scene = sum(array.nbytes for array in splats if isinstance(array, np.ndarray))
        return scene + workspace.nbytes + (edits.marks.nbytes if edits else 0)

    return Pipeline(draw, lambda: last["image"], memory)


def compare(pipelines: dict[str, Pipeline], view: Callable[[int], Camera], frames: int) -> dict[str, Any]:
    differences: list[float] = []

    def difference(frame: int) -> None:
        pictures = [pipelines[name].read() for name in ("specialised", "general")]
        differences.append(float(np.abs(pictures[0] - pictures[1]).max()))

    ways = {name: (lambda frame, draw=pipelines[name].draw: draw(view(frame))) for name in MEASURED}
    times = in_turn(ways, frames, after_round=difference)
    measured = {name: np.array(own.ms) for name, own in times.items()}
    return {
        "median_ms": {name: own.median for name, own in times.items()},
        "stages_ms": {name: times[name].medians() for name in ("specialised", "general")},
        "ratio": spread(measured["general"] / np.sqrt(measured["specialised"] * measured["again"])),
        "noise": spread(measured["again"] / measured["specialised"]),
        "bytes": {name: pipelines[name].memory() for name in ("specialised", "general")},
        "largest_difference": max(differences),
    }


def spread(ratios: np.ndarray) -> dict[str, float]:
    low, middle, high = np.percentile(ratios, [25, 50, 75])
    return {"median": float(middle), "low": float(low), "high": float(high)}


def measure(ctx, gaussians: Gaussians, size: tuple[int, int], frames: int) -> list[dict[str, Any]]:
    view, results = orbit_of(gaussians, size), []
    pipeline_of: dict[str, Callable[..., Pipeline]] = {
        "quads": partial(on_gpu, QuadsRenderer, ctx),
        "tiles": partial(on_gpu, TilesRenderer, ctx),
        "cpu": cpu,
    }
    for renderer, make in pipeline_of.items():
        pipelines = {name: make(gaussians, general=name == "general") for name in MEASURED}
        result = compare(pipelines, view, frames)
        results.append({"renderer": renderer, "size": list(size), **result})
    return results


def cells(result: dict[str, Any]) -> list[str]:
    ratio, noise, held = result["ratio"], result["noise"], result["bytes"]
    return [
        f"{result['scene']} (degree {result['degree']})",
        f"`{result['renderer']}`",
        f"{result['size'][0]}x{result['size'][1]}",
        f"{result['median_ms']['specialised']:.0f}",
        f"{result['median_ms']['general']:.0f}",
        f"{ratio['median']:.2f} ({ratio['low']:.2f} to {ratio['high']:.2f})",
        f"{noise['low']:.2f} to {noise['high']:.2f}",
        f"{held['specialised'] / 1e6:.0f}",
        f"{held['general'] / 1e6:.0f}",
        f"{held['general'] / held['specialised']:.2f}",
    ]


COLUMNS = ["scene", "renderer", "size", "ms", "general, ms", "ratio", "noise", "MB", "general, MB", "ratio"]


def main() -> None:
    options = make_parser(__doc__, "effects.json", scenes=True, size="640x360", frames=16).parse_args()
    ctx = create_headless_context(require=430)

    def synthetic() -> dict[str, Gaussians]:
        rich = synthetic_scene(100_000)
        return {"synthetic": rich, "synthetic, flat": replace(rich, sh=rich.sh[:, :1].copy())}

    results = []
    for name, gaussians in load_scenes(options.scenes, synthetic).items():
        for result in measure(ctx, gaussians, options.size, options.frames):
            degree = round(gaussians.sh.shape[1] ** 0.5) - 1
            results.append({"scene": name, "splats": len(gaussians), "degree": degree, **result})
            print(" | ".join(cells(results[-1])), results[-1]["stages_ms"], flush=True)
    write_results(
        options.output,
        {
            "gl": describe(ctx).renderer,
            "results": results,
            "table": {
                "columns": COLUMNS,
                "rows": [cells(result) for result in results],
                "note": f"Medians of {options.frames} views (ratios with quartiles), each drawn by both in "
                "turn, to the same picture. Noise: the specialised pipeline against itself. GL is "
                f"{describe(ctx).renderer}.",
            },
        },
    )


if __name__ == "__main__":
    main()
