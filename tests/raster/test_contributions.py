"""Contributions of splats to pictures, and the dominant splat of each pixel, against plain numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatview import raster
from splatview.raster.contributions import contributions, contributions_and_footprints, dominant_splats
from splatview.scene import ImageModel, RenderSettings, look_at, reference
from splatview.scene.edits import HIDDEN, IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits, bake
from splatview.scene.projection import project

NEAR_CUT = 1e-6


def all_contributions(scene, camera, chosen=None) -> tuple[np.ndarray, np.ndarray]:
    """alpha·T of every splat at every pixel, (N, H, W) float64; pixels (H, W) where rounding to float32 may
    decide whether a splat shows."""
    chosen = chosen or RenderSettings()
    footprints = project(scene, camera, chosen)
    visible = np.arange(len(footprints.indices))
    x, y = (
        axis.ravel() for axis in np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    )
    alphas = reference.alphas(footprints, visible, x, y, chosen)
    transmittance = np.cumprod(np.vstack([np.ones(len(x)), 1 - alphas]), axis=0)[:-1]
    shares = np.zeros((len(scene), camera.height, camera.width))
    shares[footprints.indices] = (alphas * transmittance).reshape(-1, camera.height, camera.width)
    uncut = replace(chosen, model=replace(chosen.model, alpha_cut=0.0))
    near = np.abs(reference.alphas(footprints, visible, x, y, uncut) - chosen.model.alpha_cut) <= NEAR_CUT
    return shares, near.any(axis=0).reshape(camera.height, camera.width)


def assert_contributions(scene, cameras, chosen=None, **options) -> None:
    found = contributions(scene, cameras, chosen, **options)
    expected = [all_contributions(scene, camera, chosen) for camera in cameras]
    total = sum(shares.sum(axis=(1, 2)) for shares, _ in expected)
    # In a pixel beside the cut a splat may be missing: those behind it then show by that much more.
    slack = sum(near.sum() for _, near in expected) / 255
    assert found.dtype == np.float64
    assert found.shape == (len(scene),)
    assert (np.abs(found - total) <= 1e-5 * total + 1e-4 + slack).all()


CAMERAS = [
    look_at(eye, (0, 0, 0), width=37, height=29) for eye in ((0.4, 0.3, -2.4), (2, 0, 0.5), (0, 0, -0.3))
]


def test_every_splat_of_several_pictures(random_gaussians):
    scene = random_gaussians(300, sh_degree=1, seed=1)
    assert_contributions(scene, CAMERAS)
    assert_contributions(scene, CAMERAS[:1], RenderSettings(model=ImageModel(antialiased=True, blur=0.1)))
    total = contributions(scene, iter(CAMERAS))
    assert np.array_equal(total, contributions(scene, CAMERAS))
    alphas = [raster.render(scene, camera)[..., 3].sum() for camera in CAMERAS]
    assert total.sum() == pytest.approx(sum(alphas), rel=1e-5)


def test_footprints_are_contributions_with_nothing_before(random_gaussians):
    """To 2 % and what the cut takes: sums over pixels of at least a pixel's width stand for integrals."""
    scene = random_gaussians(40, sh_degree=0, seed=5)
    small = np.minimum(scene.log_scales, np.float32(-2))  # so that none meets the border
    scene = replace(scene, means=scene.means * np.float32(0.4), log_scales=small)
    camera = look_at((0.2, -0.1, -2.2), (0, 0, 0), width=80, height=60)
    ((total, footprints),) = contributions_and_footprints(scene, [camera])
    np.testing.assert_array_equal(total, contributions(scene, [camera]))
    alone = np.array([contributions(scene.take(np.array([row])), [camera])[0] for row in range(len(scene))])
    cut = footprints / 255 / np.exp(-np.logaddexp(0, -scene.opacity_logits.astype(np.float64)))
    wrong = np.abs(footprints - alone) - cut
    assert (wrong / footprints).max() <= 0.02
    assert (total[footprints == 0] == 0).all() and (total < 0.9 * alone).any()


def test_footprints_end_where_pictures_do(random_gaussians):
    scene = random_gaussians(1, sh_degree=0, seed=5)
    scene = replace(scene, means=np.zeros_like(scene.means), log_scales=np.full_like(scene.means, -1.5))
    camera = look_at((0, 0, -2.2), (0, 0, 0), width=81, height=61)
    left = replace(camera, width=41, cx=camera.cx)
    (whole,), (half,) = (found[1] for found in contributions_and_footprints(scene, [camera, left]))
    assert half == pytest.approx(whole / 2, rel=0.05)
    assert all(
        len(array) == 0 for array in next(contributions_and_footprints(scene.take(slice(0)), [camera]))
    )


@given(
    seed=st.integers(0, 2**31),
    count=st.integers(0, 200),
    logit=st.floats(-4, 6),
    width=st.integers(1, 40),
    height=st.integers(1, 40),
)
@settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_generated_scenes(random_gaussians, seed, count, logit, width, height):
    scene = random_gaussians(count, sh_degree=0, seed=seed)
    scene = replace(scene, opacity_logits=scene.opacity_logits + np.float32(logit))
    camera = look_at((0.2, -0.1, -2.2), (0, 0, 0), width=width, height=height)
    assert_contributions(scene, [camera])
    assert_dominant(scene, camera)


def assert_dominant(scene, camera, chosen=None) -> None:
    found = dominant_splats(scene, camera, chosen)
    assert found.dtype == np.int32
    assert found.shape == (camera.height, camera.width)
    shares, near = all_contributions(scene, camera, chosen)
    coverage = shares.sum(axis=0)
    clear = ~near & (np.abs(coverage - 0.5) > 1e-5)
    if not len(scene):
        assert (found == -1).all()
        return
    best = np.where(coverage >= 0.5, shares.argmax(axis=0), -1)
    if len(scene) > 1:
        second, first = np.sort(shares, axis=0)[-2:]
        clear &= (first - second > 1e-5) | (coverage < 0.5)
    assert np.array_equal(found[clear], best[clear])
    assert clear.mean() > 0.9


def test_dominant_splats(random_gaussians):
    scene = random_gaussians(400, sh_degree=0, seed=2)
    for camera in CAMERAS:
        assert_dominant(scene, camera)
    some = dominant_splats(scene, CAMERAS[0])
    assert (some == -1).any()
    assert len(np.unique(some)) > 20
    all_of_it = dominant_splats(scene, CAMERAS[0], least_coverage=0.0)
    shown = raster.render(scene, CAMERAS[0])[..., 3] > 0
    assert np.array_equal(all_of_it >= 0, shown)
    with pytest.raises(ValueError, match="least_coverage"):
        dominant_splats(scene, CAMERAS[0], least_coverage=float("nan"))


def test_nearer_of_equals_is_in_front(random_gaussians):
    scene = random_gaussians(1, sh_degree=0).take(np.zeros(3, np.int64))
    scene = replace(
        scene,
        means=np.array([[0, 0, 1], [0, 0, 0], [0, 0, 0.5]], np.float32),
        log_scales=np.full((3, 3), 2.0, np.float32),
        opacity_logits=np.full(3, 3.0, np.float32),
    )
    camera = look_at((0, 0, -3), (0, 0, 0), width=9, height=9)
    assert (dominant_splats(scene, camera) == 1).all()


def test_edits_and_threads(random_gaussians):
    """Hidden splats contribute nothing, moved ones where they went; threads do not show."""
    scene = random_gaussians(3000, sh_degree=0, seed=3)
    marks = np.full(3000, 1 << PALETTE_SHIFT, np.uint32)
    marks[::3] |= HIDDEN
    palette = (IDENTITY, Adjustment(translation=(0.2, 0, 0), size=1.5))
    edits = SceneEdits(marks=marks, palette=palette, flags=HIDDEN)
    camera = look_at((0.4, 0.3, -2.4), (0, 0, 0), width=60, height=50)
    found = contributions(scene, [camera], edits=edits)
    assert (found[::3] == 0).all()
    kept = np.flatnonzero(marks & HIDDEN == 0)
    baked = contributions(bake(scene, edits), [camera])
    assert np.allclose(found[kept], baked, rtol=1e-4, atol=1e-2)
    ids = dominant_splats(scene, camera, edits=edits)
    assert not np.isin(ids, np.arange(0, 3000, 3)).any()
    for threads in (1, 3):
        again = contributions(scene, [camera], edits=edits, threads=threads)
        assert np.array_equal(again, found)
        assert np.array_equal(dominant_splats(scene, camera, edits=edits, threads=threads), ids)


def test_bands_do_not_show(random_gaussians, monkeypatch):
    scene = random_gaussians(1500, sh_degree=0, seed=4)
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=90, height=75)
    whole, ids = contributions(scene, [camera]), dominant_splats(scene, camera)
    monkeypatch.setattr("splatview.raster.frame.MAX_LISTED_PAIRS", 700)
    assert np.allclose(contributions(scene, [camera]), whole, rtol=1e-12)
    assert np.array_equal(dominant_splats(scene, camera), ids)


def test_nobody_sees_what_is_behind(random_gaussians):
    scene = random_gaussians(50)
    away = look_at((0, 0, -3), (0, 0, -9), width=20, height=20)
    assert (contributions(scene, [away]) == 0).all()
    assert (contributions(scene, []) == 0).all()
    assert (dominant_splats(scene, away) == -1).all()
