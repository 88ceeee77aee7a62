"""What the GL renderers keep, upload and do again: the state beside their pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.metrics import largest_error
from splatview.renderers.gl.context import held_bytes
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, look_at, reference
from splatview.scene.edits import (
    DELETED,
    HIDDEN,
    LOCKED,
    PREVIEW,
    SELECTED,
    SceneEdits,
)

Make = Callable[..., Gaussians]

EXACT = RenderSettings(blend="float32", background=(0.1, 0.3, 0.2))
FLAT = replace(EXACT, model=ImageModel().with_footprint("disc"))


def camera_at(width: int = 64, height: int = 48) -> Camera:
    return look_at((0.5, -0.4, -2.4), (0, 0, 0), width=width, height=height)


def test_draw_leaves_the_callers_framebuffer_bound(ctx, gl_renderer, random_gaussians: Make):
    before = ctx.detect_framebuffer()
    mine = ctx.simple_framebuffer((8, 8))
    mine.use()
    gl_renderer.render(FrameRequest(random_gaussians(50), camera_at(), EXACT))
    assert ctx.detect_framebuffer().glo == mine.glo
    before.use()  # releasing a bound framebuffer is an error in moderngl
    mine.release()


def test_results_before_load_and_draw_are_refused(gl_renderer, random_gaussians: Make):
    with pytest.raises(RuntimeError, match=r"load\(\) comes before draw\(\)"):
        gl_renderer.draw(FrameRequest(None, camera_at(), EXACT))
    gl_renderer.load(random_gaussians(10))
    for result in (gl_renderer.read, lambda: gl_renderer.texture, lambda: gl_renderer.framebuffer):
        with pytest.raises(RuntimeError, match=r"draw\(\) comes first"):
            result()


def test_flat_splats_take_memory_only_once_they_are_drawn(gl_renderer, random_gaussians: Make):
    scene, camera = random_gaussians(3000, seed=1), camera_at()
    before = gl_renderer.render(FrameRequest(scene, camera, EXACT))
    bytes_before = held_bytes(gl_renderer)
    flat = gl_renderer.render(FrameRequest(scene, camera, FLAT))
    assert held_bytes(gl_renderer) >= bytes_before + 32 * len(scene)
    assert largest_error(flat, before) > 0.05
    # And back, to the bit.
    assert np.array_equal(gl_renderer.render(FrameRequest(scene, camera, EXACT)), before)
    gl_renderer.render(FrameRequest(random_gaussians(3000, seed=2), camera, EXACT))
    assert held_bytes(gl_renderer) == bytes_before


def test_no_edits_cost_nothing(gl_renderer, random_gaussians: Make):
    scene, camera = random_gaussians(200), camera_at()
    plain = gl_renderer.render(FrameRequest(scene, camera, EXACT))
    none = SceneEdits(marks=np.zeros(200, np.uint32))
    same = gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=none, highlight=Highlight()))
    assert np.array_equal(plain, same)
    assert gl_renderer.stats().drawn == 1
    assert gl_renderer._edits.marks_uploaded == 0
    # A row of each texture where a compiler keeps what no path of a program reads, as NVIDIA's does.
    assert held_bytes(gl_renderer._edits) <= (4 + 16 + 16) * TEXTURE_WIDTH


def counters(gl_renderer) -> tuple[int, int, int]:
    stats = gl_renderer.stats()
    return stats.projected, stats.sorted, stats.drawn


def test_a_selection_is_only_drawn_anew(gl_renderer, random_gaussians: Make):
    scene, camera, highlight = random_gaussians(200), camera_at(), Highlight()
    marks = np.zeros(200, np.uint32)
    marks[7] = DELETED
    edits = SceneEdits(marks=marks, flags=DELETED | SELECTED)
    first = gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits, highlight=highlight))
    assert counters(gl_renderer) == (1, 1, 1)

    marks[10:60] = SELECTED
    edits = replace(edits, marks_version=1, changes=((1, 10, 60),))
    lit = gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits, highlight=highlight))
    assert counters(gl_renderer) == (1, 1, 2)
    assert np.array_equal(lit[..., 3], first[..., 3])
    assert largest_error(lit, first) > 0.1
    # Without a tint there is nothing to draw it for.
    plain = gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert np.array_equal(plain, first)
    drawn = counters(gl_renderer)
    marks[70:80] = LOCKED
    edits = replace(edits, marks_version=2, changes=((1, 10, 60), (2, 70, 80)))
    gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert counters(gl_renderer) == drawn

    marks[20] |= HIDDEN
    edits = replace(edits, marks_version=3, changes=((3, 20, 21),), flags=31)
    gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert counters(gl_renderer)[0] == 2


def test_only_what_changed_is_uploaded(gl_renderer, random_gaussians: Make):
    scene, camera = random_gaussians(9000, sh_degree=0), camera_at(24, 16)
    marks = np.zeros(9000, np.uint32)
    edits = SceneEdits(marks=marks, flags=DELETED)

    def uploaded(version: int, changes: tuple, start: int, stop: int) -> int:
        nonlocal edits
        marks[start:stop] ^= DELETED
        edits = replace(edits, marks_version=version, changes=changes)
        before = gl_renderer._edits.marks_uploaded
        image = gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
        left = scene.take(np.flatnonzero(marks == 0))
        assert largest_error(image, reference.render(left, camera, EXACT)) <= 2e-3
        return gl_renderer._edits.marks_uploaded - before

    gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert uploaded(1, ((1, 5, 6),), 5, 6) == 1
    # From the middle of one row of texels over two whole ones into a fourth.
    assert uploaded(2, ((1, 5, 6), (2, 2000, 8500)), 2000, 8500) == 6500
    assert uploaded(3, ((3, 4000, 4096),), 4000, 4096) == 96
    assert uploaded(9, ((9, 0, 1),), 100, 3000) == 9000  # some changes are not told
    # The same marks in an array of their own need no upload; other marks do.
    edits, before = replace(edits, marks=marks.copy(), marks_version=0), gl_renderer._edits.marks_uploaded
    gl_renderer.render(FrameRequest(scene, camera, EXACT, edits=edits))
    assert gl_renderer._edits.marks_uploaded == before


def test_depth_and_overdraw_are_not_tinted(gl_renderer, random_gaussians: Make):
    scene = random_gaussians(50)
    edits = SceneEdits(marks=np.full(50, SELECTED, np.uint32), flags=SELECTED)
    for mode in ("depth", "overdraw"):
        plain = gl_renderer.render(FrameRequest(scene, camera_at(), EXACT, mode=mode))
        drawn = gl_renderer.stats().drawn
        lit = gl_renderer.render(
            FrameRequest(scene, camera_at(), EXACT, mode=mode, edits=edits, highlight=Highlight())
        )
        assert np.array_equal(plain, lit)
        assert gl_renderer.stats().drawn == drawn


def test_the_first_of_several_marks_counts():
    highlight = Highlight(selected=(0, 1, 0, 0.5), preview=(1, 0, 0, 0.5), locked=(0, 0, 1, 0))
    table = highlight.table
    assert highlight.flags == PREVIEW | SELECTED
    assert table[SELECTED].tolist() == [0, 1, 0, 0.5]
    assert table[SELECTED | PREVIEW | HIDDEN].tolist() == [1, 0, 0, 0.5]
    assert not table[LOCKED].any()
    assert table[LOCKED | SELECTED].tolist() == [0, 1, 0, 0.5]
    assert not table[[0, HIDDEN, DELETED, HIDDEN | DELETED]].any()
