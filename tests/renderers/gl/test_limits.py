"""Drivers that can do no more than OpenGL 4.3 promises, or less: whole pictures all the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.renderers import make_renderer
from splatview.renderers.gl import sort
from splatview.renderers.gl.programs import load_compute
from splatview.renderers.gl.project import QUADS_PER_INSTANCE, SCAN_SIZE, SLABS
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.sort import RadixSort, SortTuning
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.modes import MODES
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Gaussians, ImageModel, InputError, RenderSettings, look_at
from splatview.scene.edits import SELECTED, SceneEdits

Make = Callable[..., Gaussians]

SETTINGS = RenderSettings(blend="float32", early_stop=1e-3, background=(0.3, 0.1, 0.2))

FEW_GROUPS = 16
"""Work groups of a dispatch in one dimension: of 256 splats each, the hundredth part of a small scene."""


def many_splats(random_gaussians: Make, count: int = 20_000) -> Gaussians:
    scene = random_gaussians(count, sh_degree=0)
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
    keyed, values = (ctx.buffer(data) for data in (keys, np.arange(len(keys), dtype=np.uint32)))
    count = ctx.buffer(np.uint32(len(keys)).tobytes())
    done = [np.frombuffer(buffer.read(), np.uint32) for buffer in sorter.sort(keyed, values, count)]
    assert np.array_equal(done[0], np.sort(keys))
    assert np.array_equal(done[1], np.argsort(keys, kind="stable"))
    for thing in (sorter, count, keyed, values):
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


VIEW = look_at((0, 0.3, 2), (0, 0, 0), width=64, height=48)
FLAT = replace(SETTINGS, model=ImageModel().with_footprint("disc"))
RECORD = 48
"""Bytes a splat."""


def requests(kind: type[QuadsRenderer], scene: Gaussians) -> list[FrameRequest]:
    """Everything that reads records."""
    marks = np.where(np.arange(len(scene)) % 3 == 0, SELECTED, 0).astype(np.uint32)
    edits = SceneEdits(marks=marks, flags=SELECTED)
    orders = [order for order in kind.capabilities.orders if order not in ("32-bit", "16-bit")]
    modes = MODES if kind is QuadsRenderer else ("splats",)
    return [
        *(FrameRequest(scene, VIEW, SETTINGS, mode=mode) for mode in modes),
        *(FrameRequest(scene, VIEW, replace(SETTINGS, order=order)) for order in orders),
        FrameRequest(scene, VIEW, FLAT),
        FrameRequest(scene, VIEW, SETTINGS, edits=edits, highlight=Highlight()),
    ]


@pytest.mark.parametrize("kind", [QuadsRenderer, TilesRenderer])
def test_records_that_no_storage_buffer_holds(ctx, limited, random_gaussians: Make, kind):
    scene = many_splats(random_gaussians, 3000)
    pictures = []
    for most in (RECORD * len(scene), RECORD * len(scene) - 1):
        limited(GL_MAX_SHADER_STORAGE_BLOCK_SIZE=most)
        renderer = kind(ctx)
        pictures.append([renderer.render(request) for request in requests(kind, scene)])
        assert renderer._projector.textured is (most < RECORD * len(scene))
        assert renderer.memory() > RECORD * len(scene)
        renderer.close()
    for whole, paged in zip(*pictures, strict=True):
        assert whole[..., :3].std() > 0.02
        assert np.abs(whole - paged).max() < 1e-6


def test_more_splats_than_a_storage_buffer_has_keys(ctx, limited, random_gaussians: Make):
    limited(GL_MAX_SHADER_STORAGE_BLOCK_SIZE=4 * 300)
    renderer = QuadsRenderer(ctx)
    few = random_gaussians(10, sh_degree=0)
    renderer.load(few)
    with pytest.raises(
        InputError, match=r"301 splats are more than this OpenGL driver can sort \(300\); use"
    ):
        renderer.load(random_gaussians(301, sh_degree=0))
    renderer.draw(FrameRequest(None, VIEW, RenderSettings()))
    assert renderer.stats().splats == 10
    renderer.close()


def test_the_least_storage_blocks_take_the_path_of_old_opengl(ctx, limited, random_gaussians: Make):
    scene = many_splats(random_gaussians, 500)
    renderer = make_renderer("quads", ctx)
    expected = renderer.render(FrameRequest(scene, VIEW, SETTINGS))
    renderer.close()
    limited(GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS=8, GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS=0)
    renderer = make_renderer("quads", ctx)
    assert renderer.name == "quads-gl33"
    assert np.abs(renderer.render(FrameRequest(scene, VIEW, SETTINGS)) - expected).max() < 1e-4
    renderer.close()
    with pytest.raises(InputError, match="a vertex shader has 0 storage blocks, 5 are needed"):
        make_renderer("tiles", ctx)
