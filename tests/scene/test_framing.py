"""The first view: it has the scene in it, upright, whatever the scene is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import Gaussians
from splatview.scene.formats import load_scene
from splatview.scene.framing import frame_camera, robust_bounds
from splatview.scene.image_model import RenderSettings
from splatview.scene.projection import project
from splatview.scene.reference import render


def moved(scene: Gaussians, scale: float, offset: tuple[float, float, float]) -> Gaussians:
    """The same scene larger and elsewhere, positions in float64."""
    return replace(
        scene,
        means=scene.means.astype(np.float64) * scale + offset,
        log_scales=scene.log_scales + np.float32(np.log(scale)),
    )


@pytest.mark.parametrize("size", [(320, 180), (180, 320), (7, 300)])
@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e6])
@pytest.mark.parametrize("offset", [(0, 0, 0), (4e5, -5e6, 100)])
def test_the_bulk_is_in_view(random_gaussians, size, scale, offset):
    scene = moved(random_gaussians(500), scale, offset)
    camera = frame_camera(scene, *size)
    footprints = project(scene, camera, RenderSettings())
    inside = ((footprints.means2d >= 0) & (footprints.means2d <= size)).all(axis=1)
    assert inside.sum() >= 0.9 * len(footprints.indices) and len(footprints.indices) > 400
    spread = np.ptp(np.percentile(footprints.means2d, [5, 95], axis=0), axis=0).max()
    assert spread > 0.4 * min(size) or scale < 1e-3


def test_up_is_minus_y(random_gaussians):
    camera = frame_camera(random_gaussians(100), 100, 100)
    assert camera.R_camera_world[1] @ (0, 1, 0) > 0.8 and abs(camera.R_camera_world[0, 1]) < 1e-12
    assert camera.eye[1] < 0  # looks down on the scene


def test_field_of_view_is_kept(random_gaussians):
    scene = random_gaussians(100)
    for fov_y in (10.0, 50.0, 120.0):
        camera = frame_camera(scene, 200, 100, fov_y=fov_y)
        assert np.degrees(2 * np.arctan(50 / camera.fy)) == pytest.approx(fov_y)


def test_floaters_do_not_shrink_the_scene(random_gaussians):
    scene = random_gaussians(1000)
    centre, radius = robust_bounds(scene.means)
    means = scene.means.copy()
    means[:20] = 1e6
    floating_centre, floating_radius = robust_bounds(means)
    assert np.abs(floating_centre - centre).max() < 0.1 and abs(floating_radius - radius) < 0.1


def test_ill_means_do_not_count(random_gaussians):
    scene = random_gaussians(90)
    centre, radius = robust_bounds(scene.means)
    ill = np.array([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]], np.float32)
    ill_centre, ill_radius = robust_bounds(np.concatenate([ill, scene.means]))
    assert np.array_equal(ill_centre, centre) and ill_radius == radius


@pytest.mark.parametrize(
    "means", [np.zeros((0, 3), "f4"), np.full((3, 3), np.nan, "f4"), np.full((2, 3), 1e300)]
)
def test_nothing_to_see(random_gaussians, means):
    centre, radius = robust_bounds(means)
    assert centre.tolist() == [0, 0, 0] and radius == 1
    scene = replace(random_gaussians(len(means)), means=means)
    assert render(scene, frame_camera(scene, 16, 9)).shape == (9, 16, 4)


@pytest.mark.parametrize("log_scale", [-12.0, -3.0, 4.0])
def test_one_splat_fills_the_view(random_gaussians, log_scale):
    scene = replace(
        random_gaussians(1),
        means=np.array([[5.0, 6.0, 7.0]]),
        log_scales=np.full((1, 3), log_scale, np.float32),
        opacity_logits=np.full(1, 5, np.float32),
    )
    assert robust_bounds(scene.means)[1] == 1
    picture = render(scene, frame_camera(scene, 33, 33))
    assert picture[16, 16, 3] > 0.9
    # The smallest is held off by the near plane; the others reach well into the picture.
    assert log_scale < -10 or (picture[..., 3] > 0.1).mean() > 0.1
    assert picture[0, 0, 3] < 0.1


def test_coincident_splats_far_away(random_gaussians):
    scene = replace(random_gaussians(9), means=np.full((9, 3), 1e30, np.float32))
    camera = frame_camera(scene, 16, 16)
    assert np.isfinite(camera.world_to_camera).all()


def test_trained_scenes_are_seen(data_file):
    scene = load_scene(data_file("scenes/train-1000.ply"))
    assert render(scene, frame_camera(scene, 64, 48))[..., 3].max() > 0.3
