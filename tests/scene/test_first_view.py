"""The first view: the side with the most to see, filling the picture, upright, whatever the scene is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import Gaussians, concatenate
from splatview.scene.first_view import Front, first_view
from splatview.scene.image_model import RenderSettings
from splatview.scene.projection import project
from splatview.scene.reference import render
from splatview.scene.sh import rgb_to_sh

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def sheet(count: int, place: Sequence[float], size: Sequence[float], *, seed: int, rgb=None) -> Gaussians:
    """Splats evenly over a box about `place` of `size` along x, y and z; `rgb` of one colour, or of all."""
    rng = np.random.default_rng(seed)
    colours = rng.uniform(size=(count, 3)) if rgb is None else np.broadcast_to(rgb, (count, 3))
    flat = np.log(np.where(np.array(size) > 0, 0.02, 1e-4))
    return Gaussians(
        means=(rng.uniform(-0.5, 0.5, (count, 3)) * size + place).astype(np.float32),
        quats=np.tile(np.array(IDENTITY, np.float32), (count, 1)),
        log_scales=np.tile(flat.astype(np.float32), (count, 1)),
        opacity_logits=np.full(count, 3.0, np.float32),
        sh=rgb_to_sh(colours).astype(np.float32)[:, None],
    )


def panel(direction: int) -> Gaussians:
    """A grey block on a floor, chequered on the side of `direction`: x, z, -x, -z."""
    body = sheet(4000, (0, 0, 0), (0.9, 1.4, 0.9), seed=1, rgb=(0.4, 0.4, 0.4))
    axis, sign = (0, 2)[direction % 2], (1, -1)[direction // 2]
    place, size = [0.0, 0.0, 0.0], [0.9, 1.4, 0.9]
    place[axis], size[axis] = 0.47 * sign, 0.0
    face = sheet(3000, tuple(place), tuple(size), seed=2)
    across = 2 - axis
    chequers = np.floor(face.means[:, across] * 6) + np.floor(face.means[:, 1] * 6)
    hue = np.stack([chequers % 2, chequers % 3 / 2, chequers % 5 / 4], axis=1)
    floor = sheet(2000, (0, 0.7, 0), (1.4, 0, 1.4), seed=6, rgb=(0.3, 0.3, 0.3))
    return concatenate([body, replace(face, sh=rgb_to_sh(hue).astype(np.float32)[:, None]), floor])


@pytest.mark.parametrize("direction", range(4))
def test_the_side_with_the_most_to_see_is_in_front(direction):
    camera = first_view(panel(direction), 160, 100).camera
    towards = np.zeros(3)
    towards[(0, 2)[direction % 2]] = (1, -1)[direction // 2]
    assert -camera.forward @ towards > math.cos(math.radians(60))


@pytest.mark.parametrize("size", [(320, 180), (180, 320), (64, 64)])
@pytest.mark.parametrize(
    ("scale", "offset"), [(1.0, (0, 0, 0)), (100.0, (4e5, -5e6, 100)), (1e-1, (3, 0, 0))]
)
def test_the_scene_fills_the_picture_and_is_all_in_it(size, scale, offset):
    scene = panel(1)
    scene = replace(
        scene,
        means=scene.means.astype(np.float64) * scale + offset,
        log_scales=scene.log_scales + np.float32(math.log(scale)),
    )
    view = first_view(scene, *size)
    pixels = project(scene, view.camera, RenderSettings()).means2d
    low, high = np.quantile(pixels, (0.002, 0.998), axis=0)
    assert (low >= 0).all() and (high <= size).all()
    assert ((high - low) / size).max() > 0.85
    assert np.abs((low + high) / 2 - np.array(size) / 2).max() < 0.06 * max(size)
    assert np.linalg.norm(view.target - np.array(offset)) < scale


def test_floaters_and_far_surroundings_do_not_shrink_the_subject():
    alone = first_view(panel(1), 160, 100).camera
    floaters = sheet(30, (0, 0, 0), (60, 60, 60), seed=3)
    hill = sheet(1500, (0, 0, 0), (80, 20, 80), seed=4)
    hill = replace(hill, log_scales=np.full_like(hill.log_scales, 0.3))
    among = first_view(concatenate([panel(1), floaters, hill]), 160, 100)
    assert np.linalg.norm(among.camera.eye) < 1.5 * np.linalg.norm(alone.eye)


def test_a_floor_says_which_axis_is_up():
    floor = sheet(4000, (0, 0.8, 0), (3, 0, 3), seed=5, rgb=(0.3, 0.5, 0.2))
    usual = concatenate([panel(1), floor])
    front = Front.of(usual)
    assert front is not None and front.up.tolist() == [0, -1, 0]
    z_up = replace(
        usual,
        means=np.ascontiguousarray(usual.means[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)),
        log_scales=np.ascontiguousarray(usual.log_scales[:, [0, 2, 1]]),
    )
    turned = Front.of(z_up)
    assert turned is not None and turned.up.tolist() == [0, 0, 1]
    camera = first_view(z_up, 100, 100).camera
    assert camera.R_camera_world[1, 2] < -0.8 and camera.eye[2] > 0, "upright, and from above the floor"


def test_without_a_floor_minus_y_is_up(random_gaussians):
    view = first_view(random_gaussians(400), 100, 100)
    assert view.up.tolist() == [0, -1, 0]
    assert view.camera.R_camera_world[1] @ (0, 1, 0) > 0.8


@pytest.mark.parametrize("count", [0, 1, 3])
def test_any_scene_has_one(random_gaussians, count):
    scene = random_gaussians(count)
    for broken in (
        scene,
        replace(scene, means=np.full_like(scene.means, np.nan)),
        replace(scene, means=np.full_like(scene.means, 1e30)),
        replace(scene, quats=np.zeros_like(scene.quats)),
        replace(scene, log_scales=np.full_like(scene.log_scales, 80)),
        replace(scene, log_scales=np.full_like(scene.log_scales, -np.inf)),
        replace(scene, sh=np.full_like(scene.sh, np.nan)),
        replace(scene, opacity_logits=np.full_like(scene.opacity_logits, np.nan)),
    ):
        view = first_view(broken, 16, 9)
        assert np.isfinite(view.camera.world_to_camera).all() and np.isfinite(view.target).all()
        assert render(broken, view.camera).shape == (9, 16, 4)


def test_one_splat_is_seen(random_gaussians):
    scene = replace(
        random_gaussians(1), means=np.array([[5.0, 6.0, 7.0]]), opacity_logits=np.full(1, 5, np.float32)
    )
    assert render(scene, first_view(scene, 33, 33).camera)[16, 16, 3] > 0.9


@pytest.mark.parametrize(
    ("name", "front", "within"),
    [
        ("scenes/skull.ply", (0, 0, 1), 60),
        ("scenes/guitar/guitar.compressed.ply", (1, 0, 0), 60),
        ("scenes/biker/biker.spz", (-1, 0, 0), 60),
        ("scenes/playbot_lod0.ply", (0, 0, -1), 60),
        ("scenes/spot_10k.splat", (0, 0, -1), 80),
    ],
)
def test_fronts_of_real_scenes(data_file, name, front, within):
    from splatview.scene.formats import load_scene

    camera = first_view(load_scene(data_file(name)), 160, 100).camera
    assert -camera.forward @ front > math.cos(math.radians(within))
