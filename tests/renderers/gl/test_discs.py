"""Flat splats by every renderer of OpenGL, against the reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.measure.hard_cases.case import camera, splats
from splatview.renderers.gl.context import held_bytes
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, ImageModel, InputError, Lens, RenderSettings, reference
from splatview.scene.edits import HIDDEN, IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits, bake

Renderer = QuadsRenderer | QuadsGL33Renderer

EXACT = RenderSettings(blend="float32", background=(0.1, 0.3, 0.2))
DISCS = replace(EXACT, model=ImageModel().with_footprint("disc"))
CAMERA = camera(50, 41, focal=36.0)
PARALLEL = replace(camera(50, 41, focal=16.0, turn=20.0), orthographic=True)


@pytest.fixture(params=[QuadsRenderer, QuadsGL33Renderer, TilesRenderer], ids=["quads", "legacy", "tiles"])
def renderer(ctx: moderngl.Context, request: pytest.FixtureRequest) -> Iterator[Renderer]:
    if request.param is not QuadsGL33Renderer and ctx.version_code < 430:
        pytest.skip("needs OpenGL 4.3")
    made = request.param(ctx)
    yield made
    made.close()


def of_all_kinds(seed: int, count: int = 60) -> Gaussians:
    rng = np.random.default_rng(seed)
    scales = rng.normal(-1.5, 1.2, (count, 3))
    scales[np.arange(count), rng.integers(0, 3, count)] = -20
    return splats(
        rng.uniform((-1.5, -1.0, -0.2), (1.5, 1.0, 3.0), (count, 3)),
        log_scales=scales,
        quats=rng.normal(size=(count, 4)),
        logits=rng.normal(1.0, 2.0, count),
        rgb=rng.uniform(0, 1, (count, 3)),
    )


def assert_close(picture: np.ndarray, truth: np.ndarray) -> None:
    # Some roundings of float32; an alpha may sit on its cut, or a ray on the least slope.
    assert (np.abs(picture - truth).max(axis=-1) > 1e-3).sum() <= 1


@pytest.mark.parametrize("seed", range(4))
def test_pictures_are_the_references(renderer, seed):
    scene = of_all_kinds(seed)
    for view, blur in ((CAMERA, 0.5), (PARALLEL, 0.5), (CAMERA, 0.0)):
        chosen = replace(DISCS, model=replace(DISCS.model, blur=blur))
        assert_close(
            renderer.render(FrameRequest(scene, view, chosen)), reference.render(scene, view, chosen)
        )


def test_edits_are_seen_as_they_are_baked(renderer):
    scene = of_all_kinds(7)
    palette = (
        IDENTITY,
        Adjustment(rotation=(0.8, 0.36, -0.48, 0.0), scale=1.3, translation=(0.2, 0.0, 0.1)),
        Adjustment(size=0.6, opacity=(1.5, -0.1, 0.05, 0.9)),
    )
    marks = (np.arange(len(scene)) % 3).astype(np.uint32) << PALETTE_SHIFT
    marks[::7] |= HIDDEN
    edits = SceneEdits(marks=marks, palette=palette, flags=HIDDEN)
    drawn = renderer.render(FrameRequest(scene, CAMERA, DISCS, edits=edits))
    assert_close(drawn, reference.render(bake(scene, edits), CAMERA, DISCS))


def test_discs_take_memory_only_once_they_are_drawn(renderer):
    scene = of_all_kinds(1, count=3000)
    before = renderer.render(FrameRequest(scene, CAMERA, EXACT))
    bytes_before = held_bytes(renderer)
    flat = renderer.render(FrameRequest(scene, CAMERA, DISCS))
    assert held_bytes(renderer) >= bytes_before + 32 * len(scene)
    assert np.abs(flat - before).max() > 0.05
    # And back, to the bit.
    assert (renderer.render(FrameRequest(scene, CAMERA, EXACT)) == before).all()
    other = of_all_kinds(2, count=3000)
    renderer.render(FrameRequest(other, CAMERA, EXACT))
    assert held_bytes(renderer) == bytes_before


def test_every_mode_shows_discs(renderer):
    scene = of_all_kinds(5)
    shown = [
        renderer.render(FrameRequest(scene, CAMERA, DISCS, mode=mode))
        for mode in ("splats", "points", "ellipsoids", "depth", "overdraw")
    ]
    assert all(np.isfinite(picture).all() and picture[..., :3].std() > 0.01 for picture in shown)
    # Points and bodies are those of any splat.
    for mode in ("points", "ellipsoids"):
        same = renderer.render(FrameRequest(scene, CAMERA, EXACT, mode=mode))
        assert np.abs(renderer.render(FrameRequest(scene, CAMERA, DISCS, mode=mode)) - same).mean() < 0.02


def test_a_lens_is_refused(renderer):
    bent = replace(CAMERA, lens=Lens(model="SIMPLE_RADIAL", parameters=(0.1,)))
    with pytest.raises(InputError, match="has a lens"):
        renderer.render(FrameRequest(of_all_kinds(1), bent, DISCS))
