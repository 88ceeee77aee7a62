"""Merged splats: moments kept, pictures alike, large and ill splats left alone."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene import lod as merging
from splatview.scene.lod import levels_and_cells, merge_in_cells, quaternions
from splatview.scene.projection import covariances_3d, rotation_matrices
from splatview.scene.reference import render


def splats(means, *, log_scale=-4.0, logit=0.0, sh=None) -> Gaussians:
    means = np.asarray(means, np.float32)
    count = len(means)
    colours = np.zeros((count, 1, 3), np.float32) if sh is None else np.asarray(sh, np.float32)
    return Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), log_scale, np.float32),
        opacity_logits=np.full(count, logit, np.float32),
        sh=colours,
    )


def carpet(side: int) -> Gaussians:
    """An opaque square of side² overlapping flat splats, coloured in a slow wave."""
    u, v = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    means = np.stack([u, v, 0 * u], axis=-1).reshape(-1, 3)
    sh = np.stack([np.sin(3 * u), np.cos(2 * v), u * v], axis=-1).reshape(-1, 1, 3)
    made = splats(means, logit=1.5, sh=sh)
    made.log_scales[:] = np.log([1.2 / side, 1.2 / side, 0.001])
    return made


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    difference = np.clip(image[..., :3], 0, 1) - np.clip(truth[..., :3], 0, 1)
    return float(-10 * np.log10(np.mean(difference**2)))


def test_a_pair_becomes_one_with_its_moments():
    pair = splats(
        [[0.2, 0.2, 0.2], [0.6, 0.2, 0.2], [-50, 50, 50.0]], sh=[[[1, 0, 0]], [[0, 1, 0]], [[0, 0, 1]]]
    )
    merged = merge_in_cells(pair, 1.0)
    assert len(merged) == 2
    one, lone = merged.take(np.array([0])), merged.take(np.array([1]))
    np.testing.assert_allclose(one.means[0], [0.4, 0.2, 0.2], atol=1e-6)
    variance = np.exp(-8.0)
    np.testing.assert_allclose(
        covariances_3d(one.quats, one.log_scales)[0],
        np.diag([variance + 0.04, variance, variance]),
        rtol=1e-3,
    )
    np.testing.assert_allclose(one.sh[0, 0], [0.5, 0.5, 0], atol=1e-6)
    np.testing.assert_array_equal(lone.means[0], pair.means[2])


def test_the_brighter_and_larger_splat_counts_for_more():
    pair = splats([[0.1, 0.1, 0.1], [0.5, 0.1, 0.1]])
    pair.opacity_logits[:] = [5.0, -5.0]
    assert merge_in_cells(pair, 1.0).means[0, 0] < 0.11


def test_large_splats_and_ill_ones_stay_as_they_are():
    scene = splats(np.full((7, 3), 0.3))
    scene.log_scales[0] = 3.0
    scene.means[1] = np.nan
    scene.quats[2] = 0
    scene.sh[3] = np.inf
    scene.opacity_logits[4] = np.nan
    merged = merge_in_cells(scene, 1.0)
    assert len(merged) == 6, "the two sound ones have become one"
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(merged, name)[1:], getattr(scene, name)[:5])
    assert np.isfinite(merged.means[0]).all()


def test_batches_do_not_show(random_gaussians, monkeypatch):
    scene = random_gaussians(3000)
    whole = merge_in_cells(scene, 0.2)
    monkeypatch.setattr(merging, "MEMBERS_AT_ONCE", 50)
    parts = merge_in_cells(scene, 0.2)
    assert len(whole) < 2500
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-4, atol=1e-5)


def test_a_carpet_of_fewer_splats_looks_the_same():
    full = carpet(40)
    camera = look_at((0.3, 0.4, -3), (0, 0, 0), width=48, height=48)
    settings = RenderSettings()
    truth = render(full, camera, settings)
    counts, values = [len(full)], []
    for level, _ in levels_and_cells(full):
        counts.append(len(level))
        values.append(psnr(render(level, camera, settings), truth))
    assert len(values) >= 2
    assert all(after < 0.85 * before for before, after in pairwise(counts))
    assert counts[2] < 0.4 * counts[0]
    assert min(values[:2]) > 30
    random = np.sort(np.random.default_rng(0).permutation(len(full))[: counts[2]])
    assert values[1] > psnr(render(full.take(random), camera, settings), truth) + 5, "better than leaving out"


def test_there_is_no_hole_in_a_merged_carpet():
    camera = look_at((0, 0, -3), (0, 0, 0), width=48, height=48)
    for level, _ in levels_and_cells(carpet(60), levels=3):
        alpha = render(level, camera, RenderSettings())[20:28, 20:28, 3]
        assert alpha.min() > 0.9


@pytest.mark.parametrize("count", [0, 1])
def test_what_cannot_be_fewer_has_no_levels(count):
    assert list(levels_and_cells(splats(np.zeros((count, 3))))) == []


def test_scenes_that_only_have_ill_splats_have_no_levels():
    scene = splats(np.zeros((3, 3)))
    scene.log_scales[:] = np.nan
    assert list(levels_and_cells(scene)) == []
    scene.log_scales[:] = 0
    scene.means[:] = np.inf
    assert list(levels_and_cells(scene)) == []


def test_far_away_scenes_keep_their_places():
    scene = splats([[0, 0, 0], [0.25, 0, 0]])
    far = Gaussians(
        means=scene.means.astype(np.float64) + 4e6 + 0.25,
        quats=scene.quats,
        log_scales=scene.log_scales,
        opacity_logits=scene.opacity_logits,
        sh=scene.sh,
    )
    merged = merge_in_cells(far, 1.0)
    assert merged.means.dtype == np.float64
    np.testing.assert_allclose(merged.means.mean(axis=0), far.means.mean(axis=0), rtol=0, atol=1e-6)


def test_quaternions_undo_rotation_matrices():
    quats = np.random.default_rng(1).normal(size=(500, 4))
    quats = np.concatenate([quats, np.eye(4), -np.eye(4)])
    R = rotation_matrices(quats)
    np.testing.assert_allclose(rotation_matrices(quaternions(R)), R, atol=1e-12)
