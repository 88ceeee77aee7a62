"""EWA projection: worked answers, and that the float32-safe forms equal the textbook's in float64."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from splatview.scene import TEXTBOOK, Camera, ImageModel, RenderSettings, look_at
from splatview.scene.projection import covariances_3d, footprint_covariances, project, projection_jacobians

TURN_45_Z = (math.cos(math.pi / 8), 0, 0, math.sin(math.pi / 8))


def test_covariance_worked_answer():
    covariance = covariances_3d(np.array([TURN_45_Z]), np.log([[0.03, 0.15, 0.20]]))[0]
    expected = [[0.0117, -0.0108, 0], [-0.0108, 0.0117, 0], [0, 0, 0.04]]
    np.testing.assert_allclose(covariance, expected, atol=1e-15)


def test_footprint_worked_answer(flat_gaussians, identity_camera):
    gaussians = flat_gaussians((0.3, -0.1, 2), (0.03, 0.15, 0.20), TURN_45_Z)
    footprints = project(gaussians, identity_camera(1000, 800, 500), RenderSettings(model=TEXTBOOK))
    np.testing.assert_allclose(footprints.means2d[0] - (500, 400), (75, -25), atol=1e-4)
    xx, xy, yy = footprints.covariances[0]
    np.testing.assert_allclose((xx, xy, yy), (787.5, -693.75, 737.5), rtol=1e-6)
    radii = np.sqrt(np.linalg.eigvalsh([[xx, xy], [xy, yy]]))
    np.testing.assert_allclose(radii[::-1], (38.2, 8.3), atol=0.05)
    major = np.linalg.eigh([[xx, xy], [xy, yy]])[1][:, 1]
    # In image axes: x right, y down.
    assert math.degrees(math.atan2(major[1], major[0])) % 180 == pytest.approx(136.0, abs=0.05)


def test_conic_factors_are_the_inverse_covariance(random_gaussians):
    footprints = project(random_gaussians(200), look_at((0, 0.3, 3), (0, 0, 0)), RenderSettings())
    a, b, c = footprints.conic_factors.T
    xx, xy, yy = footprints.covariances.T
    np.testing.assert_allclose(a * a * xx + a * b * xy, 1, atol=1e-9)
    np.testing.assert_allclose(a * b * xx + (b * b + c * c) * xy, 0, atol=1e-9 * np.abs(xx).max())
    np.testing.assert_allclose(a * b * xy + (b * b + c * c) * yy, 1, atol=1e-9)


def test_half_extents_bound_the_visible_pixels(random_gaussians):
    footprints = project(random_gaussians(200), look_at((0, 0.3, 3), (0, 0, 0)), RenderSettings())
    # The point of the cut ellipse that is furthest right: S'·(1, 0) / sqrt(S'xx), scaled to the cut.
    reach = np.sqrt(2 * np.log(255 * footprints.opacities))
    xx, xy, _ = footprints.covariances.T
    dx, dy = reach * np.sqrt(xx), reach * xy / np.sqrt(xx)
    a, b, c = footprints.conic_factors.T
    alpha = footprints.opacities * np.exp(-((a * dx + b * dy) ** 2 + (c * dy) ** 2) / 2)
    np.testing.assert_allclose(alpha, 1 / 255, rtol=1e-9)
    np.testing.assert_allclose(footprints.half_extents[:, 0], dx, rtol=1e-12)


@given(st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6), st.sampled_from([0.0, 0.1, 0.3]))
@example([0.0, 0.0, 1.0338320286013205e-154, 1.0, 1.0, 778.0], 0.0)
def test_determinant_equals_the_textbook_form(entries, blur):
    M = np.array(entries).reshape(1, 2, 3)
    covariance, det, det_unblurred, spread = footprint_covariances(M, blur)
    S = M[0] @ M[0].T + blur * np.eye(2)
    xx, xy, yy = covariance[0] * spread[0] ** 2
    np.testing.assert_allclose([[xx, xy], [xy, yy]], S, rtol=1e-12, atol=1e-12)
    # Below, with a spread of up to 2e3 whose fourth power is taken out, determinants are subnormal numbers.
    scale = max(S[0, 0] * S[1, 1], 1e-290)
    assert det[0] * spread[0] ** 4 == pytest.approx(np.linalg.det(S), abs=1e-12 * scale)
    assert det_unblurred[0] <= det[0]


def test_determinant_of_a_needle_survives_float32():
    """3000 px long, a fifth of a pixel thin: the textbook form loses the determinant, ours keeps it."""
    angle = 0.7
    M = np.zeros((1, 2, 3))
    M[0, :, 0] = 3000 * math.cos(angle), 3000 * math.sin(angle)
    M[0, :, 1] = -0.2 * math.sin(angle), 0.2 * math.cos(angle)
    exact = footprint_covariances(M, 0.3)[1][0] * footprint_covariances(M, 0.3)[3][0] ** 4
    covariance, det, _, spread = footprint_covariances(M.astype(np.float32), 0.3)
    assert det.dtype == np.float32
    assert det[0] * float(spread[0]) ** 4 == pytest.approx(exact, rel=1e-4)
    xx, xy, yy = covariance[0]
    assert abs((xx * yy - xy * xy) * float(spread[0]) ** 4 / exact - 1) > 0.05, "the case is not hard enough"


def test_jacobian_is_the_derivative_inside_the_clamp():
    camera = look_at((0, 0, 0), (0, 0, 1), width=200, height=100)
    t = np.array([[0.2, -0.1, 1.5]])

    def pixel(p):
        return p[:2] / p[2] * (camera.fx, camera.fy)

    steps = 1e-6 * np.eye(3)
    numeric = np.stack([(pixel(t[0] + h) - pixel(t[0] - h)) / 2e-6 for h in steps], axis=1)
    np.testing.assert_allclose(projection_jacobians(t, camera, 0.3)[0], numeric, rtol=1e-7, atol=1e-7)


def test_jacobian_clamp_knows_the_principal_point():
    camera = Camera(width=100, height=100, fx=50, fy=50, cx=20, cy=50, world_to_camera=np.eye(4))
    J = projection_jacobians(np.array([[9.0, 0, 1], [-9.0, 0, 1]]), camera, 0.3)
    tan = 1.0
    np.testing.assert_allclose(-J[:, 0, 2] / 50, [80 / 50 + 0.3 * tan, -20 / 50 - 0.3 * tan])


@pytest.mark.parametrize(
    ("field", "value", "kept"),
    [
        ("means", (0, 0, 0.01), True),
        ("means", (0, 0, np.nextafter(np.float32(0.01), 0, dtype=np.float32)), False),
        ("means", (0, 0, -1), False),
        ("means", (np.nan, 0, 1), False),
        ("means", (np.inf, 0, 1), False),
        ("quats", (0, 0, 0, 0), False),
        ("quats", (1e-25, 0, 0, 1e-25), True),
        ("quats", (1e30, 0, 0, -1e30), True),
        ("quats", (np.nan, 0, 0, 1), False),
        ("quats", (np.inf, 0, 0, 1), False),
        ("log_scales", (30, 30, 30), True),
        ("log_scales", (-30, -30, -30), True),
        ("log_scales", (89, 0, 0), False),
        ("log_scales", (np.nan, 0, 0), False),
        ("opacity_logits", (np.inf,), True),
        ("opacity_logits", (100,), True),
        ("opacity_logits", (-np.inf,), False),
        ("opacity_logits", (-100,), False),
        ("opacity_logits", (np.nan,), False),
        ("sh", (np.nan, 0, 0), False),
        ("sh", (np.inf, 0, 0), False),
        ("sh", (-1e30, 1e30, 0), True),
    ],
)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_what_is_culled_and_what_stays(flat_gaussians, identity_camera, field, value, kept, dtype):
    gaussians = flat_gaussians([(0, 0, 1)], 0.1, opacity_logits=3.0)
    getattr(gaussians, field).reshape(-1)[: np.size(value)] = value
    model = ImageModel(near=float(np.float32(0.01)))  # the plane itself, not the nearest float64 to it
    footprints = project(gaussians, identity_camera(64, 64, 64), RenderSettings(model=model), dtype=dtype)
    assert len(footprints.indices) == kept
    for values in (footprints.means2d, footprints.conic_factors, footprints.opacities, footprints.colours):
        assert np.isfinite(values).all()


def test_order_is_by_depth_then_index(flat_gaussians, identity_camera):
    gaussians = flat_gaussians([(0, 0, z) for z in (3, 1, 2, 1, 3)], 0.1)
    footprints = project(gaussians, identity_camera(8, 8, 8), RenderSettings())
    assert footprints.indices.tolist() == [1, 3, 2, 0, 4]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 3), st.floats(0, 2 * math.pi))
def test_moving_scene_and_camera_together_changes_nothing(random_gaussians, degree, angle):
    """A shift of the world is invisible; SH see only directions, so colours stay too."""
    gaussians = random_gaussians(50, sh_degree=degree)
    shift = 5 * np.array([math.cos(angle), 0.3, math.sin(angle)])
    shifted = type(gaussians)(**{**vars(gaussians), "means": gaussians.means.astype(np.float64) + shift})
    here = project(gaussians, look_at((0, 0, 3), (0, 0, 0)), RenderSettings())
    there = project(shifted, look_at(np.array((0, 0, 3)) + shift, shift), RenderSettings())
    np.testing.assert_array_equal(here.indices, there.indices)
    for name in ("means2d", "covariances", "opacities", "colours"):
        np.testing.assert_allclose(getattr(here, name), getattr(there, name), rtol=1e-9, atol=1e-9)
