"""Scenes made by code: sound arrays, the same each time, and of the kinds they promise."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.scene import Gaussians, InputError, RenderSettings, look_at, reference
from splatview.scene.demo import SCENES, demo_camera, demo_scene
from splatview.scene.demo.objects import fit_sh
from splatview.scene.demo.primitives import fbm, noise, sphere_points, spun, sunflower, turning_z_to
from splatview.scene.projection import rotation_matrices, sigmoid
from splatview.scene.sh import sh_basis, sh_colours

ARRAYS = ("means", "quats", "log_scales", "opacity_logits", "sh")


@pytest.fixture(scope="module")
def landscape() -> Gaussians:
    return demo_scene("landscape", splats=20_000)


def test_landscape_is_sound(landscape):
    assert landscape.sh_degree == 3
    assert 0.8 * 20_000 < len(landscape) < 1.2 * 20_000
    for name in ARRAYS:
        assert np.isfinite(getattr(landscape, name)).all(), name
    assert np.allclose(np.linalg.norm(landscape.quats, axis=1), 1, atol=1e-5)


def test_landscape_has_every_kind_of_splat(landscape):
    ordered = np.sort(landscape.log_scales, axis=1)
    needle = ordered[:, 2] - ordered[:, 1] > np.log(3)
    disc = (ordered[:, 1] - ordered[:, 0] > np.log(3)) & ~needle
    opacity = sigmoid(landscape.opacity_logits)
    glossy = np.abs(landscape.sh[:, 9:]).max(axis=(1, 2)) > 0.02
    for kind, share in ((needle, 0.2), (disc, 0.3), (opacity < 0.15, 0.002), (glossy, 0.03)):
        assert kind.mean() > share
    assert opacity.min() < 0.05
    assert opacity.max() > 0.97


@pytest.mark.parametrize("name", SCENES)
def test_same_arguments_same_scene(name):
    few = {"splats": 3000} if name == "landscape" else {}
    first, second = demo_scene(name, **few), demo_scene(name, **few)
    for array in ARRAYS:
        assert np.array_equal(getattr(first, array), getattr(second, array))
    assert name in first.comments[0]
    if name in ("needles", "haze"):
        assert not np.array_equal(first.sh, demo_scene(name, seed=1).sh)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("count", [1, 7, 500])
def test_any_number_of_splats_makes_a_scene(name, count):
    scene = demo_scene(name, splats=count)
    assert len(scene) >= 1
    assert all(np.isfinite(getattr(scene, array)).all() for array in ARRAYS)


def test_unknown_scenes_are_refused():
    with pytest.raises(InputError, match="'moon': choose from landscape"):
        demo_scene("moon")
    with pytest.raises(InputError, match="at least 1 splat, got 0"):
        demo_scene("haze", splats=0)


def test_first_view_has_sky_above_ground_and_no_holes(landscape):
    image = reference.render(landscape, demo_camera(64, 36))
    assert image[..., 3].min() > 0.95
    sky, ground = image[:4, :, :3].mean(axis=(0, 1)), image[-6:, :, :3].mean(axis=(0, 1))
    assert sky[2] > sky[0], "blue above"
    assert ground[1] > 1.5 * ground[2], "green below"
    assert image[..., :3].std() > 0.1


def test_highlights_move_with_the_viewer():
    scene = demo_scene("gloss", splats=4000)
    point = scene.means[:, None, :]
    eyes = np.array([(-3.0, -1.0, -3.0), (3.0, -1.0, -3.0)])
    directions = point - eyes
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    left, right = (sh_colours(scene.sh, directions[:, i].astype(np.float64), 3) for i in (0, 1))
    assert np.abs(left - right).max() > 0.4
    matt = RenderSettings(sh_degree=0)
    camera = look_at((0, -1.0, -4.5), (0, 0, 0), up=(0, -1, 0), width=32, height=32)
    assert np.abs(reference.render(scene, camera) - reference.render(scene, camera, matt)).max() > 0.15


def test_fit_recovers_coefficients(rng):
    directions = sphere_points(100)
    truth = rng.normal(size=(4, 16, 3))
    colours = 0.5 + np.einsum("dk,nkc->ndc", sh_basis(directions, 3), truth)
    fitted = fit_sh(colours, directions, np.ones((4, 100)))
    # The ridge holds the coefficients back by a few percent of 4π.
    assert np.abs(fitted - truth).max() < 0.06 * np.abs(truth).max()
    assert np.allclose(fitted[:, 0], truth[:, 0], atol=0.02)


def test_turning_frames():
    directions = np.concatenate([sphere_points(50), [(0, 0, 1), (0, 0, -1), (1, 0, 0)]])
    quats = turning_z_to(directions)
    assert np.allclose(rotation_matrices(quats)[:, :, 2], directions)
    tangents = np.cross(directions, (0.3, 0.5, 0.8))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    R = rotation_matrices(spun(quats, tangents))
    assert np.allclose(R[:, :, 2], directions)
    assert np.allclose(R[:, :, 0], tangents)


def test_sunflower_is_even():
    rank, angle = sunflower(2000)
    points = np.sqrt(rank)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + 9 * np.eye(2000)
    nearest = apart.min(axis=1) / np.sqrt(np.pi / 2000)
    assert nearest.min() > 0.7
    assert nearest.max() < 1.3


def test_noise_is_smooth_and_bounded(rng):
    for dimensions in (2, 3):
        points = rng.uniform(-50, 50, (5000, dimensions))
        values = fbm(points, 3)
        assert np.abs(values).max() < 1.3
        assert values.std() > 0.1
        step = noise(points + 1e-4, 3) - noise(points, 3)
        assert np.abs(step).max() < 2e-3
        assert np.abs(noise(np.round(points), 3)).max() < 1e-12, "zero on the lattice"
