"""What edits cost the `quads` renderer: uploading what is new, and drawing with each kind in force.

    python tools/bench/bench_edits_drawn.py [SCENE] [--size WxH] [--frames N]

Uploads are timed on the processor's side, up to and with the calls into GL. Frames with each kind of
edits are drawn in turn with frames without any; the ratios are those of the medians of the stage.
Without a scene a synthetic one of 500,000 splats is drawn.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import moderngl
import numpy as np
from bench_kernels import synthetic_scene
from harness import in_turn, make_parser

from splatview.measure.machine import write_results
from splatview.renderers import make_renderer
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.gl.edit_textures import EditTextures
from splatview.renderers.gl.scene_buffers import placement_of
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.edits import DELETED, IDENTITY, PALETTE_SHIFT, SELECTED, Adjustment, Crop, SceneEdits
from splatview.scene.formats import load_scene
from splatview.scene.framing import frame_camera, robust_bounds

COUNTS = (1_000_000, 5_000_000)
"""Splats whose marks are uploaded."""

REPEATS = 15

MOVE = Adjustment(
    rotation=(0.8, 0.6, 0.0, 0.0), scale=1.01, colour=((0.9, 0.1, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0))
)


def upload_times(ctx: moderngl.Context, count: int) -> dict[str, float]:
    """Median milliseconds of `EditTextures.update` after each kind of change."""
    means = np.zeros((count, 3), np.float32)
    textures = EditTextures(ctx)
    textures.load(placement_of(means), means)
    marks = np.zeros(count, np.uint32)
    edits = SceneEdits(marks=marks, palette=(IDENTITY, MOVE), flags=SELECTED | DELETED)
    textures.update(edits, Highlight())
    found = {}
    runs = {"all": (0, count), "a tenth": (count // 2, count // 2 + count // 10), "one": (7, 8)}
    for name, (start, stop) in runs.items():
        times = []
        for _ in range(REPEATS):
            marks[start:stop] ^= SELECTED
            version = edits.marks_version + 1
            edits = replace(edits, marks_version=version, changes=((version, start, stop),))
            begun = time.perf_counter()
            textures.update(edits, Highlight())
            times.append(1000 * (time.perf_counter() - begun))
        found[name] = float(np.median(times))
    times = []
    for step in range(REPEATS):
        moved = replace(MOVE, translation=(0.01 * step, 0.0, 0.0))
        begun = time.perf_counter()
        textures.update(replace(edits, palette=(IDENTITY, moved)), Highlight())
        times.append(1000 * (time.perf_counter() - begun))
    found["a gizmo's step"] = float(np.median(times))
    textures.release()
    ctx.finish()
    return found


def kinds_of(gaussians: Gaussians) -> dict[str, tuple[SceneEdits | None, Highlight | None]]:
    """Edits that leave nearly all splats shown, so that the stages have the same work but for them."""
    count = len(gaussians)
    index = np.arange(count)
    few = np.where(index % 1000 == 0, DELETED, 0).astype(np.uint32)
    half = (index % 2 << PALETTE_SHIFT).astype(np.uint32)
    third = np.where(index % 3 == 0, SELECTED, 0).astype(np.uint32)
    centre, radius = robust_bounds(gaussians.means)
    x, y, z = np.asarray(centre, np.float64).tolist()
    reach = 1e3 * float(radius)
    crops = tuple(Crop(centre=(x, y, z), half_extents=(reach, reach, reach)) for _ in range(4))
    return {
        "none": (None, None),
        "0.1 % deleted": (SceneEdits(marks=few, flags=DELETED), None),
        "half adjusted": (SceneEdits(marks=half, palette=(IDENTITY, replace(MOVE, scale=1.0))), None),
        "four crops": (SceneEdits(marks=np.zeros(count, np.uint32), crops=crops), None),
        "a third selected": (SceneEdits(marks=third, flags=SELECTED), Highlight()),
    }


def frame_ratios(
    ctx: moderngl.Context, gaussians: Gaussians, size: tuple[int, int], frames: int
) -> dict[str, dict[str, float]]:
    """By kind of edits: median time of stages, relative to that without."""
    renderer = make_renderer("quads", ctx)
    renderer.load(gaussians)
    camera = frame_camera(gaussians, *size)
    target, _ = robust_bounds(gaussians.means)

    def draw(edits: SceneEdits | None, highlight: Highlight | None, frame: int) -> dict[str, float]:
        eye = camera.eye + 1e-3 * frame * (camera.eye - target)
        view = look_at(eye, target, width=size[0], height=size[1])
        renderer.draw(FrameRequest(None, view, RenderSettings(), edits=edits, highlight=highlight))
        return {stage: renderer.stats(wait=True).ms[stage] for stage in ("project", "draw")}

    ways = {kind: partial(draw, *given) for kind, given in kinds_of(gaussians).items()}
    medians = {kind: own.medians() for kind, own in in_turn(ways, frames).items()}
    renderer.close()
    return {
        kind: {stage: ms / medians["none"][stage] for stage, ms in stages.items()}
        for kind, stages in medians.items()
    }


def main() -> None:
    options = make_parser(__doc__, "edits_drawn.json", scene=True, size="640x360", frames=7).parse_args()
    width, height = options.size
    ctx = create_headless_context()
    gaussians = load_scene(options.scene) if options.scene else synthetic_scene(500_000)
    uploads = {count: upload_times(ctx, count) for count in COUNTS}
    ratios = frame_ratios(ctx, gaussians, (width, height), options.frames)
    write_results(
        options.output,
        {
            "gl": describe(ctx).renderer,
            "scene": options.scene.name if options.scene else "synthetic",
            "splats": len(gaussians),
            "size": [width, height],
            "upload_ms": {str(count): times for count, times in uploads.items()},
            "ratio_to_none": ratios,
            "table": {
                "columns": [
                    "what changed",
                    *(f"{count // 1_000_000} million splats, ms" for count in COUNTS),
                ],
                "rows": [
                    [what, *(f"{uploads[count][what]:.2f}" for count in COUNTS)]
                    for what in uploads[COUNTS[0]]
                ],
            },
        },
    )
    for kind, stages in ratios.items():
        print(f"{kind}: " + ", ".join(f"{stage} {ratio:.2f}" for stage, ratio in stages.items()))


if __name__ == "__main__":
    main()
