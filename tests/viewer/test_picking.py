"""Picking finds the visible surface, exactly as compositing all splats does."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, look_at
from splatview.scene.edits import DELETED, IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits
from splatview.scene.projection import project
from splatview.scene.reference import composite
from splatview.viewer.navigation import pick
from splatview.viewer.navigation.picking import may_reach

SETTINGS = RenderSettings()


def wall(z: float, opacity_logit: float, *, size: int = 12) -> Gaussians:
    """A plane of overlapping round splats at depth z."""
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(-1, 1, size))
    n = x.size
    return Gaussians(
        means=np.stack([x.ravel(), y.ravel(), np.full(n, z)], axis=1).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), np.log(0.12), np.float32),
        opacity_logits=np.full(n, opacity_logit, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )


def both(front: Gaussians, back: Gaussians) -> Gaussians:
    from splatview.scene import concatenate

    return concatenate([front, back])


FRONTAL = look_at((0, 0, -2), (0, 0, 0), up=(0, -1, 0), width=160, height=120)


def test_finds_the_solid_wall_and_a_point_on_the_ray():
    found = pick(wall(1.0, 5.0), FRONTAL, SETTINGS, 100.5, 40.5)
    assert found is not None
    assert found.depth == pytest.approx(3.0)
    t = FRONTAL.R_camera_world @ found.point + FRONTAL.t_camera_world
    assert FRONTAL.fx * t[0] / t[2] + FRONTAL.cx == pytest.approx(100.5)
    assert FRONTAL.fy * t[1] / t[2] + FRONTAL.cy == pytest.approx(40.5)


def test_haze_in_front_does_not_hide_the_wall_behind():
    found = pick(both(wall(0.0, -4.5), wall(1.0, 6.0)), FRONTAL, SETTINGS, 80.5, 60.5)
    assert found is not None
    assert found.depth == pytest.approx(3.0)
    assert found.index >= 144


def test_a_solid_wall_hides_the_one_behind():
    found = pick(both(wall(1.0, 6.0), wall(0.0, 6.0)), FRONTAL, SETTINGS, 80.5, 60.5)
    assert found is not None
    assert found.depth == pytest.approx(2.0)
    assert found.index >= 144, "the nearer one, whatever the order in the file"


def test_haze_alone_gives_the_splat_that_adds_most():
    found = pick(wall(1.0, -2.5), FRONTAL, SETTINGS, 80.5, 60.5)
    assert found is not None
    assert found.depth == pytest.approx(3.0)


def test_background_gives_nothing():
    far_away = look_at((0, 0, -2), (0, 0, -4), up=(0, -1, 0), width=160, height=120)
    assert pick(wall(1.0, 5.0), far_away, SETTINGS, 80.5, 60.5) is None
    assert pick(wall(1.0, 5.0).take(np.zeros(0, int)), FRONTAL, SETTINGS, 80.5, 60.5) is None


def cameras() -> list[Camera]:
    return [
        look_at((0, 0, -3), (0, 0, 0), width=64, height=48),
        look_at((0.2, 0.1, 0.3), (1, 0, 0), width=64, height=48, fov_y=90),
        look_at((2, 2, 2), (0, 0, 0), width=64, height=48, fov_y=20),
    ]


@pytest.mark.parametrize("model", [ImageModel(), ImageModel(blur=0.0, jacobian_margin=None, near=0.2)])
@pytest.mark.parametrize("index", range(3))
def test_the_cheap_bound_loses_no_splat(random_gaussians, index, model):
    """The pixel composited from the candidates alone is the pixel of the whole scene."""
    scene = random_gaussians(1500, seed=index)
    camera, settings = cameras()[index], RenderSettings(model=model)
    footprints = project(scene, camera, settings)
    rng = np.random.default_rng(index)
    for x, y in rng.uniform((0, 0), (64, 48), (40, 2)):
        few = project(scene.take(may_reach(scene, camera, settings, x, y)), camera, settings)
        pixel = np.array([x]), np.array([y])
        expected = composite(footprints, np.arange(len(footprints.indices)), *pixel, settings)
        found = composite(few, np.arange(len(few.indices)), *pixel, settings)
        np.testing.assert_allclose(found[0], expected[0], atol=1e-12)
        np.testing.assert_allclose(found[1], expected[1], atol=1e-12)


def test_the_cheap_bound_is_worth_having(random_gaussians):
    scene = random_gaussians(20000)
    camera = cameras()[0].resized(1280, 960)
    assert len(may_reach(scene, camera, SETTINGS, 640, 480)) < 6000


def test_what_edits_took_away_is_not_picked_and_what_they_moved_is_where_it_is_seen():
    scene = both(wall(1.0, 6.0), wall(0.0, 6.0))
    marks = np.zeros(len(scene), np.uint32)
    marks[144:] = DELETED
    found = pick(scene, FRONTAL, SETTINGS, 80.5, 60.5, edits=SceneEdits(marks=marks, flags=DELETED))
    assert found is not None
    assert found.depth == pytest.approx(3.0)
    assert found.index < 144
    marks[:144], marks[144:] = DELETED, 1 << PALETTE_SHIFT
    back = Adjustment(translation=(0.0, 0.0, 4.0))
    moved = SceneEdits(marks=marks, palette=(IDENTITY, back), flags=DELETED)
    found = pick(scene, FRONTAL, SETTINGS, 80.5, 60.5, edits=moved)
    assert found is not None
    assert found.depth == pytest.approx(6.0)
    assert found.index >= 144
    marks[:] = DELETED
    assert pick(scene, FRONTAL, SETTINGS, 80.5, 60.5, edits=moved) is None


def test_ill_splats_are_never_picked(random_gaussians):
    scene = random_gaussians(200)
    means = scene.means.copy()
    means[::3] = np.nan
    means[1::3] = np.inf
    ill = Gaussians(
        means=means,
        quats=scene.quats,
        log_scales=scene.log_scales + 2,
        opacity_logits=scene.opacity_logits,
        sh=scene.sh,
    )
    found = pick(ill, cameras()[0], SETTINGS, 32, 24)
    assert found is not None
    assert found.index % 3 == 2
    assert np.isfinite(found.point).all()


def test_a_scene_far_from_the_origin_is_hit_as_exactly():
    near = wall(1.0, 5.0)
    shift = np.array([4e6, -2e6, 7e6])
    far = Gaussians(
        means=near.means.astype(np.float64) + shift,
        quats=near.quats,
        log_scales=near.log_scales,
        opacity_logits=near.opacity_logits,
        sh=near.sh,
    )
    eye = shift + np.array([0, 0, -2])
    camera = look_at(eye.tolist(), (shift).tolist(), up=(0, -1, 0), width=160, height=120)
    found = pick(far, camera, SETTINGS, 80.5, 60.5)
    assert found is not None
    np.testing.assert_allclose(found.point - shift, (0, 0, 1), atol=0.02)
