"""Uploading scenes: pages, centring, bands in use, and giving up midway."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.renderers.gl import scene_buffers
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.scene_buffers import GROUP_SIZE, SceneBuffers, placement_of, upload_steps
from splatview.renderers.request import FrameRequest
from splatview.scene import RenderSettings, look_at
from splatview.scene.effects.sh_bands import degree_in_use

CAMERA = look_at((0, 0, 2.5), (0, 0, 0), width=64, height=48)


def upload(ctx, scene, **options) -> SceneBuffers:
    *_, last = upload_steps(ctx, scene, **options)
    assert isinstance(last, SceneBuffers)
    return last


def test_a_low_limit_makes_pages_of_whole_groups_and_the_same_picture(ctx, random_gaussians, monkeypatch):
    scene = random_gaussians(2000)
    whole, paged = QuadsRenderer(ctx), QuadsRenderer(ctx)
    settings = RenderSettings(blend="float32")
    expected = whole.render(FrameRequest(scene, CAMERA, settings))
    limit = 2000 * 16  # room for the records, and for a page of 166 splats of degree 3
    monkeypatch.setattr(scene_buffers, "storage_limit", lambda _: limit)
    assert np.array_equal(paged.render(FrameRequest(scene, CAMERA, settings)), expected)
    buffers = upload(ctx, scene)
    assert [page.count for page in buffers.pages] == [GROUP_SIZE] * 7 + [208]
    assert [page.first for page in buffers.pages] == list(range(0, 2000, GROUP_SIZE))
    paged.draw(FrameRequest(None, CAMERA, settings, mode="ellipsoids"))
    whole.draw(FrameRequest(None, CAMERA, settings, mode="ellipsoids"))
    assert np.array_equal(paged.read(), whole.read())
    buffers.release()
    whole.close()
    paged.close()


def test_only_bands_in_use_are_uploaded(ctx, random_gaussians):
    sh = random_gaussians(50).sh.copy()
    assert degree_in_use(sh) == 3
    sh[:, 9:] = 0
    assert degree_in_use(sh) == 2
    sh[:, 1:] = 0
    assert degree_in_use(sh) == 0
    sh[7, 15, 2] = np.nan
    assert degree_in_use(sh) == 3
    sh = random_gaussians(50).sh.copy()
    sh[:, 4:] = 0
    buffers = upload(ctx, replace(random_gaussians(50), sh=sh))
    assert buffers.sh_degree == 1
    assert buffers.pages[0].sh.size == 50 * 4 * 12
    buffers.release()


def test_positions_are_centred_only_where_that_keeps_digits(random_gaussians):
    means = random_gaussians(500).means
    assert (placement_of(means).centre == 0).all()
    far = means.astype(np.float64) + 1e6
    placement = placement_of(far)
    centre, median, radius = placement.centre, placement.median, placement.radius
    assert np.allclose(centre, 1e6, atol=1)
    assert np.abs(centre - median).max() <= radius
    assert np.array_equal(centre, centre.astype(np.float32))
    assert 0.5 < radius < 1
    assert (placement_of(np.full((3, 3), np.nan)).centre == 0).all()


def test_loading_in_steps_tells_progress_and_can_be_given_up(ctx, random_gaussians, monkeypatch):
    monkeypatch.setattr(scene_buffers, "UPLOAD_SLICE", 100)
    renderer = QuadsRenderer(ctx)
    first = random_gaussians(300)
    shares = list(renderer.load_steps(first))
    assert shares == pytest.approx([1 / 3, 2 / 3, 1])
    expected = renderer.render(FrameRequest(first, CAMERA, RenderSettings()))
    steps = renderer.load_steps(random_gaussians(300, seed=9))
    next(steps)
    steps.close()
    renderer.draw(FrameRequest(None, CAMERA, RenderSettings()))
    assert np.array_equal(renderer.read(), expected)
    assert renderer.stats().projected == 1
    renderer.close()
