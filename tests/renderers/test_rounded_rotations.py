"""Cameras whose rotation was rounded by a file, far from the origin: every renderer draws W·mu + p."""

from __future__ import annotations

import json

import numpy as np
import pytest

from splatview.scene import Camera, Gaussians, RenderSettings, look_at, reference
from splatview.scene.formats import load_cameras

FAR = np.array([5.0e5, 4.2e6, 120.0])
"""UTM coordinates, metres."""

OFFSET = np.array([0.5, -1.0, -5.0])
"""Of the eye from the scene, metres."""

ROUNDINGS = {"float32": lambda R: R.astype(np.float32).astype(np.float64), "3 digits": lambda R: R.round(3)}


def scene_at(place: np.ndarray) -> Gaussians:
    rng = np.random.default_rng(3)
    n = 40
    return Gaussians(
        means=place + rng.uniform(-1, 1, (n, 3)),
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        log_scales=rng.normal(-2.0, 0.3, (n, 3)).astype(np.float32),
        opacity_logits=rng.normal(1.0, 1.0, n).astype(np.float32),
        sh=rng.normal(0.0, 0.6, (n, 4, 3)).astype(np.float32),
    )


def rounded_camera(place: np.ndarray, rounding: str) -> Camera:
    exact = look_at(place + OFFSET, place, fov_y=40, width=96, height=64)
    matrix = np.eye(4)
    matrix[:3, :3] = R = ROUNDINGS[rounding](exact.R_camera_world)
    matrix[:3, 3] = -R @ exact.eye
    return Camera(width=96, height=64, fx=exact.fx, fy=exact.fy, cx=48.0, cy=32.0, world_to_camera=matrix)


def expected_picture(place: np.ndarray, rounding: str) -> np.ndarray:
    """The scene moved to the origin with the camera's matrix moved along, W·(mu - c) + (W·c + p) in exact
    arithmetic: the eye's offset from `place` is known, so nothing large is ever subtracted."""
    exact = look_at(place + OFFSET, place, fov_y=40, width=96, height=64)
    R = ROUNDINGS[rounding](exact.R_camera_world)
    near = scene_at(place)
    near = Gaussians(
        means=near.means - place,
        quats=near.quats,
        log_scales=near.log_scales,
        opacity_logits=near.opacity_logits,
        sh=near.sh,
    )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, -R @ (exact.eye - place)
    camera = Camera(width=96, height=64, fx=exact.fx, fy=exact.fy, cx=48.0, cy=32.0, world_to_camera=matrix)
    return reference.render(near, camera, RenderSettings())


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("place", [np.zeros(3), FAR], ids=["origin", "far"])
def test_the_eye_is_what_the_matrix_takes_to_zero(place, rounding):
    camera = rounded_camera(place, rounding)
    assert np.abs(camera.R_camera_world @ camera.eye + camera.t_camera_world).max() < 1e-8
    np.testing.assert_allclose(camera.eye, place + OFFSET, atol=1e-8)


@pytest.mark.parametrize("rounding", ROUNDINGS)
@pytest.mark.parametrize("place", [np.zeros(3), FAR], ids=["origin", "far"])
def test_pictures_are_those_of_the_matrix(backend, place, rounding):
    picture = backend.draw(
        scene_at(place), rounded_camera(place, rounding), RenderSettings(blend="float32", early_stop=0.0)
    )
    assert np.abs(picture - expected_picture(place, rounding)).max() <= backend.bound


def test_a_trainer_s_list_of_cameras_keeps_the_position(tmp_path):

    exact = look_at(FAR + OFFSET, FAR, fov_y=40, width=96, height=64)
    entry = {
        "id": 0,
        "img_name": "a",
        "width": 96,
        "height": 64,
        "position": exact.eye.tolist(),
        "rotation": exact.R_camera_world.T.round(3).tolist(),
        "fx": exact.fx,
        "fy": exact.fy,
    }
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([entry]))
    np.testing.assert_allclose(load_cameras(path)[0].eye, exact.eye, atol=1e-8)
