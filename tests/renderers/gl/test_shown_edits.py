"""Edits kept for a picture in another thread, and tints as colour maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.measure.metrics import largest_error, psnr
from splatview.renderers.async_renderer import AsyncRenderer
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.edit_snapshot import edit_snapshot, tinted
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Gaussians, RenderSettings, look_at, reference
from splatview.scene.edits import (
    DELETED,
    IDENTITY,
    LOCKED,
    PALETTE_SHIFT,
    PREVIEW,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    bake,
)

Make = Callable[..., Gaussians]

CAMERA = look_at((0.5, -0.4, -2.4), (0, 0, 0), width=64, height=48)
FLOAT32 = RenderSettings(blend="float32")
GRADE = Adjustment(size=0.8, colour=((0.5, 0.2, 0, 0.1), (0, 0.9, 0.1, 0), (0.3, 0, 0.4, 0.2)))


def bright(scene: Gaussians) -> Gaussians:
    """Without colours below 0: a tint is blended before those are cut here, and after it on the GPU."""
    sh = scene.sh * np.float32(0.1)
    sh[:, 0] = np.abs(scene.sh[:, 0])
    return replace(scene, sh=sh)


def some_edits(count: int) -> SceneEdits:
    rng = np.random.default_rng(0)
    flags = rng.choice(np.array([0, SELECTED, LOCKED, PREVIEW | SELECTED, DELETED], np.uint32), count)
    entries = rng.integers(0, 2, count).astype(np.uint32)
    return SceneEdits(
        marks=flags | entries << PALETTE_SHIFT,
        palette=(IDENTITY, GRADE),
        crops=(Crop(half_extents=(0.7, 0.7, 0.7)),),
        flags=31,
    )


def test_tints_as_adjustments_give_the_picture_of_the_shaders(ctx: moderngl.Context, random_gaussians: Make):
    if ctx.version_code < 430:
        pytest.skip("needs OpenGL 4.3")
    scene, edits, highlight = bright(random_gaussians(300)), some_edits(300), Highlight()
    renderer = QuadsRenderer(ctx)
    lit = renderer.render(FrameRequest(scene, CAMERA, FLOAT32, edits=edits, highlight=highlight))
    renderer.close()
    truth = reference.render(bake(scene, tinted(edits, highlight)), CAMERA, FLOAT32)
    assert psnr(lit, truth) >= 80
    assert largest_error(lit, reference.render(bake(scene, edits), CAMERA, FLOAT32)) > 0.2


def test_tinting_leaves_the_edits_alone():
    edits = some_edits(100)
    before = edits.marks.copy()
    result = tinted(edits, Highlight(locked=(0, 0, 1, 0)))
    assert np.array_equal(edits.marks, before)
    assert np.array_equal(result.marks & 255, before & 255)
    plain = (before & (SELECTED | PREVIEW)) == 0
    assert np.array_equal(result.marks[plain], before[plain])
    assert (result.marks[~plain] >> PALETTE_SHIFT >= 2).all()
    assert len(result.palette) == 6  # two tints of two adjustments
    assert result.palette[:2] == edits.palette
    for marks in (np.zeros(0, np.uint32), np.full(5, DELETED, np.uint32)):
        nothing = SceneEdits(marks=marks, flags=31)
        assert tinted(nothing, Highlight()) is nothing


def test_what_shows_is_one_object_until_it_changes():
    marks = np.zeros(10, np.uint32)
    edits, highlight = SceneEdits(marks=marks, flags=SELECTED), Highlight()
    assert edit_snapshot(None, highlight, None) is None
    assert edit_snapshot(edits, None, None) is None, "a selection without an overlay is not to be seen"
    assert edit_snapshot(edits, Highlight(selected=(1, 0, 0, 0)), None) is None
    first = edit_snapshot(edits, highlight, None)
    assert first is not None
    marks[3] = SELECTED
    assert first.kept.marks[3] == 0
    assert edit_snapshot(replace(edits), Highlight(), first) is first
    newer = (
        replace(edits, marks_version=1),
        replace(edits, marks=marks.copy()),
        replace(edits, palette=(IDENTITY, GRADE)),
        replace(edits, crops=(Crop(),)),
        replace(edits, flags=SELECTED | DELETED),
    )
    for changed in newer:
        second = edit_snapshot(changed, highlight, first)
        assert second is not None
        assert second is not first
        assert second.kept.marks[3] == SELECTED
    assert edit_snapshot(replace(edits, crops=(Crop(enabled=False),)), highlight, first) is first
    assert edit_snapshot(edits, Highlight(selected=(1, 0, 0, 1)), first) is not first


def test_the_cpu_s_pictures_show_edits(random_gaussians: Make):
    scene, edits, highlight = random_gaussians(300), some_edits(300), Highlight()
    renderer = AsyncRenderer(CpuRenderer())
    try:
        renderer.load(scene)
        for lit in (None, highlight):
            drawn = edits if lit is None else tinted(edits, lit)
            truth = reference.render(bake(scene, drawn), CAMERA, FLOAT32)
            request = FrameRequest(None, CAMERA, FLOAT32, edits=edits, highlight=lit)
            assert psnr(renderer.render(request), truth) >= 80
            for _ in range(2):  # the second time, edits have changed before an eye at rest
                edits.marks[:] = np.roll(edits.marks, 7)
                edits = replace(edits, marks_version=edits.marks_version + 1)
                request = replace(request, edits=edits)
                renderer.draw(request)
                shown = truth
                while renderer.busy:
                    renderer.wait(1.0)
                    new = renderer.take_picture()
                    shown = shown if new is None else new
                    renderer.draw(request)
                drawn = edits if lit is None else tinted(edits, lit)
                assert psnr(shown, reference.render(bake(scene, drawn), CAMERA, FLOAT32)) >= 80
        drawings = renderer.stats().drawn
        renderer.draw(FrameRequest(None, CAMERA, FLOAT32, edits=replace(edits), highlight=Highlight()))
        assert not renderer.busy
        assert renderer.stats().drawn == drawings
    finally:
        renderer.close()
