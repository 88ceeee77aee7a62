"""Drivers that can do no more than OpenGL 4.3 promises, or less: whole pictures all the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl import sort
from splatview.renderers.gl.programs import load_compute
from splatview.renderers.gl.project import QUADS_PER_INSTANCE, SCAN_SIZE, SLABS
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.sort import RadixSort, SortTuning
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings, look_at

Make = Callable[..., Gaussians]

SETTINGS = RenderSettings(blend="float32", early_stop=1e-3, background=(0.3, 0.1, 0.2))

FEW_GROUPS = 16
"""Work groups of a dispatch in one dimension: of 256 splats each, the hundredth part of a small scene."""


def many_splats(random_gaussians: Make, count: int = 20_000) -> Gaussians:
    scene = random_gaussians(count)
    return replace(scene, log_scales=scene.log_scales - 1.5, opacity_logits=scene.opacity_logits + 2)


@pytest.mark.parametrize("kind", [QuadsRenderer, TilesRenderer])
@pytest.mark.parametrize("resort_frames", [1, 4])
def test_more_splats_than_one_dispatch_has_groups_for(
    ctx, limited, random_gaussians: Make, monkeypatch, kind, resort_frames
):
    monkeypatch.setattr(sort, "SOFTWARE", sort.HARDWARE)  # its digits have 16 values
    scene = many_splats(random_gaussians)
    views = [look_at((0, 0.3, 2 - 0.1 * i), (0, 0, 0), width=128, height=96) for i in range(2)]
    settings = replace(SETTINGS, resort_frames=resort_frames)
    pictures = []
    for most in (65_535, FEW_GROUPS):
        limited(GL_MAX_COMPUTE_WORK_GROUP_COUNT=(most, 65_535, 65_535))
        renderer = kind(ctx)
        pictures.append([renderer.render(FrameRequest(scene, view, settings)) for view in views])
        renderer.close()
    assert pictures[0][0].std() > 0.05
    assert np.array_equal(pictures[0], pictures[1])


def test_more_keys_than_one_dispatch_has_groups_for(ctx, limited):
    limited(GL_MAX_COMPUTE_WORK_GROUP_COUNT=(FEW_GROUPS, 65_535, 65_535))
    keys = np.random.default_rng(3).integers(0, 1 << 32, 10_000, dtype=np.uint32)
    sorter = RadixSort(ctx, len(keys), tuning=SortTuning(digit_bits=4, workgroup=16, keys_per_invocation=16))
    buffers = [ctx.buffer(data) for data in (keys, np.arange(len(keys), dtype=np.uint32))]
    count = ctx.buffer(np.uint32(len(keys)).tobytes())
    done = [np.frombuffer(buffer.read(), np.uint32) for buffer in sorter.sort(*buffers, count)]
    assert np.array_equal(done[0], np.sort(keys))
    assert np.array_equal(done[1], np.argsort(keys, kind="stable"))
    for thing in (sorter, count, *buffers):
        thing.release()


@pytest.mark.parametrize("visible", [0, 5, 1 << 24, (1 << 24) + 1, (1 << 25) + 13])
def test_slabs_hold_all_splats_beyond_the_whole_numbers_of_float32(ctx: moderngl.Context, visible):
    flags = {"SCAN_SIZE": SCAN_SIZE, "QUADS_PER_INSTANCE": QUADS_PER_INSTANCE, "SLABS": SLABS}
    scan = load_compute(ctx, "quads/scan.comp.glsl", flags)
    counts = np.array([visible // 2, visible - visible // 2], np.uint32)
    buffers = [ctx.buffer(counts)] + [ctx.buffer(reserve=size) for size in (8, 4, 20 * SLABS, 4 * SLABS + 4)]
    for slot, buffer in enumerate(buffers):
        buffer.bind_to_storage_buffer(slot)
    scan["u_groups"] = 2
    scan.run(1)
    ends = np.frombuffer(buffers[4].read(), np.uint32)
    drawn = np.frombuffer(buffers[3].read(), np.uint32).reshape(SLABS, 5)[:, 1] * QUADS_PER_INSTANCE
    assert ends.tolist() == [slab * visible // SLABS for slab in range(SLABS + 1)]
    assert (drawn >= np.diff(ends)).all()
    for thing in (scan, *buffers):
        thing.release()
