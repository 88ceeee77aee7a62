"""Per-pixel order: against sorting every pixel in full, and without popping."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.raster import Workspace, draw_frame, parameters_of, render
from splatview.raster.forward_per_pixel import NEAREST, depth_slopes
from splatview.raster.gradients import differentiate
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits, bake
from splatview.scene.projection import covariances_3d, project, projection_jacobians

GLOBAL, PER_PIXEL = RenderSettings(early_stop=0.0), RenderSettings(order="per-pixel", early_stop=0.0)


def camera_at(x: float) -> Camera:
    return look_at((x, -0.3, -2.5), (x * 0.4, 0, 0), up=(0, -1, 0), width=40, height=33)


def sorted_in_full(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """(H, W, 4) float64: every pixel sorts all splats by depth on its ray, conditioning the projected
    Gaussian of place and depth on the pixel."""
    settings = RenderSettings()
    f = project(gaussians, camera, settings)
    R = camera.R_camera_world
    t = (gaussians.means[f.indices].astype(np.float64) - camera.eye) @ R.T
    S = (
        R
        @ covariances_3d(*(a[f.indices].astype(np.float64) for a in (gaussians.quats, gaussians.log_scales)))
        @ R.T
    )
    J = projection_jacobians(t, camera, settings.model.jacobian_margin)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    alphas, depths = [], []
    for i in range(len(f.indices)):
        d = np.stack([x - f.means2d[i, 0], y - f.means2d[i, 1]], axis=-1)
        image = J[i] @ S[i] @ J[i].T + settings.model.blur * np.eye(2)
        inverse = np.linalg.inv(image)
        alpha = np.minimum(0.99, f.opacities[i] * np.exp(-0.5 * np.einsum("yxi,ij,yxj->yx", d, inverse, d)))
        alphas.append(np.where(alpha >= settings.model.alpha_cut, alpha, 0))
        depths.append(t[i, 2] + d @ (inverse @ J[i] @ S[i][:, 2]))
    order = np.argsort(np.array(depths), axis=0, kind="stable")
    alpha = np.take_along_axis(np.array(alphas), order, axis=0)
    light = np.cumprod(1 - alpha, axis=0)
    before = np.concatenate([np.ones_like(light[:1]), light[:-1]])
    colour = ((alpha * before)[..., None] * f.colours[order]).sum(axis=0)
    return np.concatenate([colour, 1 - light[-1:].transpose(1, 2, 0)], axis=2)


def test_up_to_the_memory_every_pixel_is_sorted_in_full(random_gaussians):
    scene = random_gaussians(NEAREST, seed=3)
    camera = camera_at(0.2)
    image = render(scene, camera, PER_PIXEL)
    np.testing.assert_allclose(image, sorted_in_full(scene, camera), atol=1e-4)
    assert np.abs(image - render(scene, camera, GLOBAL)).max() > 0.02, "this scene has splats that cross"


def test_flat_splats_that_face_the_camera_come_in_the_global_order(random_gaussians):
    made = random_gaussians(200, sh_degree=0)
    scene = Gaussians(
        means=made.means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (200, 1)),
        log_scales=np.tile(np.array([-2, -2, -12], np.float32), (200, 1)),
        opacity_logits=made.opacity_logits,
        sh=made.sh,
    )
    camera = look_at((0, 0, -2e4), (0, 0, 0), up=(0, -1, 0), width=32, height=32, fov_y=0.006)
    np.testing.assert_allclose(render(scene, camera, PER_PIXEL), render(scene, camera, GLOBAL), atol=1e-4)


def test_ill_splats_are_culled_as_ever(random_gaussians):
    made = random_gaussians(30)
    means, quats = made.means.copy(), made.quats.copy()
    means[0], quats[1] = np.nan, 0
    scene = Gaussians(
        means=means, quats=quats, log_scales=made.log_scales, opacity_logits=made.opacity_logits, sh=made.sh
    )
    image = render(scene, camera_at(0), PER_PIXEL)
    np.testing.assert_array_equal(image, render(scene.take(np.arange(2, 30)), camera_at(0), PER_PIXEL))
    assert np.isfinite(image).all()


def test_needles_keep_finite_slopes(random_gaussians):
    scene = random_gaussians(50)
    needles = Gaussians(
        means=scene.means,
        quats=scene.quats,
        log_scales=np.tile(np.array([0, -14, -14], np.float32), (50, 1)),
        opacity_logits=scene.opacity_logits,
        sh=scene.sh,
    )
    slopes = depth_slopes(parameters_of(needles), np.arange(50, dtype=np.int32), camera_at(0), PER_PIXEL)
    assert np.isfinite(slopes).all()
    assert np.abs(slopes).max() > 0


def test_an_empty_scene_and_what_has_no_gradients(random_gaussians):
    nothing = random_gaussians(0)
    assert (render(nothing, camera_at(0), PER_PIXEL) == 0).all()
    splats = parameters_of(random_gaussians(5))
    frame = draw_frame(splats, camera_at(0), PER_PIXEL, Workspace())
    with pytest.raises(ValueError, match="per-pixel"):
        differentiate(splats, frame, np.zeros_like(frame.image))
    with pytest.raises(ValueError, match="stochastic"):
        render(nothing, camera_at(0), RenderSettings(order="stochastic"))


def test_edits_are_seen_as_they_would_be_baked(random_gaussians):
    scene = random_gaussians(60, seed=8)
    turned = Adjustment(rotation=(0.8, 0.36, 0.48, 0.0), translation=(0.2, -0.1, 0.3), scale=1.3, size=0.8)
    palette = (IDENTITY, turned)
    marks = np.where(np.arange(60) % 3 == 0, 1 << PALETTE_SHIFT, 0).astype(np.uint32)
    edits = SceneEdits(marks=marks, palette=palette)
    image = render(scene, camera_at(0.1), PER_PIXEL, edits=edits)
    np.testing.assert_allclose(image, render(bake(scene, edits), camera_at(0.1), PER_PIXEL), atol=2e-4)
    assert np.abs(image - render(scene, camera_at(0.1), PER_PIXEL)).max() > 0.05
