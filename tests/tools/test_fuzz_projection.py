"""Splats of every float32 pattern through each projection, a few blocks of what the fuzzer goes through."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl.context import create_headless_context
from splatview.scene import InputError

from patterns import LENSES, RAYS, SPECIAL_BITS, block_of  # isort: skip
from projections import CpuProjection, GLProjection, Projected, by_reference, truth_of, wrong_rows  # isort: skip

SPLATS = 3000

BLOCKS = [(seed, "pinhole") for seed in range(8)] + [
    *((seed, "parallel") for seed in range(4)),
    *((seed, "lens") for seed in range(0, 4 * len(LENSES), 4)),
]
"""All cameras and SH degrees, with and without antialiasing; parallel rays, and every lens."""


@pytest.fixture(scope="module")
def ctx() -> moderngl.Context:
    try:
        return create_headless_context(require=430)
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module", params=["quads", "legacy"])
def gl_projection(request: pytest.FixtureRequest, ctx: moderngl.Context) -> Iterator[GLProjection]:
    projection = GLProjection(ctx, legacy=request.param == "legacy")
    yield projection
    projection.release()
    assert ctx.error == "GL_NO_ERROR"


def check(projection, seed: int, rays: str) -> None:
    block = block_of(seed, SPLATS, rays=rays)
    truth = truth_of(block, seed)
    projected = projection(block)
    assert projected.finite
    assert wrong_rows(projected, truth) == {}


@pytest.mark.parametrize(("seed", "rays"), BLOCKS)
def test_gl(gl_projection: GLProjection, seed: int, rays: str) -> None:
    check(gl_projection, seed, rays)


@pytest.mark.parametrize(("seed", "rays"), BLOCKS)
def test_cpu_and_its_gradients(seed: int, rays: str) -> None:
    check(CpuProjection(backward=True), seed, rays)


@pytest.mark.parametrize("rays", RAYS)
def test_most_splats_are_decided_each_way(rays: str) -> None:
    decided = []
    for seed in range(4):
        truth = truth_of(block_of(seed, 20_000, rays=rays), seed)
        decided.append((truth.must_show.mean(), truth.must_cull.mean()))
    assert np.mean(decided, axis=0).min() > 0.2, decided


def test_blocks_reach_every_pattern_in_every_slot() -> None:
    seen: dict[str, list[set[int]]] = {}
    for seed in range(4):
        block = block_of(seed, 20_000)
        g = block.gaussians
        for name, values in (
            *(("mean", g.means), ("quat", g.quats), ("scale", g.log_scales)),
            *(("opacity", g.opacity_logits[:, None]), ("sh", g.sh[:, 0])),
        ):
            bits = np.ascontiguousarray(values).view(np.uint32)
            slots = seen.setdefault(name, [set() for _ in range(bits.shape[1])])
            for slot, column in zip(slots, bits.T, strict=True):
                slot |= set(np.unique(column[np.isin(column, SPECIAL_BITS)]).tolist())
    for name, slots in seen.items():
        assert all(slot == set(SPECIAL_BITS.tolist()) for slot in slots), name


def test_wrong_projections_are_told() -> None:
    block = block_of(3, SPLATS)
    truth = truth_of(block, 3)
    exact, _ = by_reference(block.gaussians, block)
    assert wrong_rows(exact, truth) == {}
    parts = (exact.means2d, exact.conics, exact.opacities, exact.colours)
    none, every = np.zeros(SPLATS, bool), np.ones(SPLATS, bool)
    assert set(wrong_rows(Projected(none, *parts), truth)) == {"not shown"}
    assert "not culled" in wrong_rows(Projected(every, *parts), truth)
    for slot, name in enumerate(("mean", "conic", "opacity", "colour")):
        off = [values * 1.01 + 1e-4 if i == slot else values for i, values in enumerate(parts)]
        means2d, conics, opacities, colours = off
        projected = Projected(exact.visible, means2d, conics, opacities, colours)
        assert name in wrong_rows(projected, truth)
