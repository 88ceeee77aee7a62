"""Every lens against its definition and against its own inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from splatview.scene import Lens
from splatview.scene.lens import (
    COUNTS,
    FISHEYE_RADIUS,
    distort,
    distortion_jacobians,
    magnifications,
    slopes_through,
    undistort,
)
from splatview.scene.lens_formula import lens_bending


def lens(model: str, parameters) -> Lens:
    return Lens(model=model, parameters=tuple(float(k) for k in parameters))


def random_lens(model: str, seed: int, size: float = 0.02) -> Lens:
    rng = np.random.default_rng(seed)
    if model == "EUCM":
        return lens(model, (rng.uniform(0, 1), rng.uniform(0.2, 2)))
    size = size if model != "FOV" else 0.9
    return lens(model, rng.uniform(-size, size, COUNTS[model]))


@pytest.mark.parametrize("model", COUNTS)
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_round_trip(model, seed):
    a_lens = random_lens(model, seed)
    points = np.random.default_rng(seed + 1).uniform(-0.6, 0.6, size=(50, 2))
    assert a_lens.valid_radius > 0.9
    back = undistort(distort(points, a_lens), a_lens)
    np.testing.assert_allclose(back, points, atol=1e-9)


@pytest.mark.parametrize("model", COUNTS)
def test_the_axis_stays_and_no_distortion_is_none(model):
    k = [0.05] * COUNTS[model]
    np.testing.assert_allclose(distort(np.zeros((1, 2)), lens(model, k)), 0, atol=1e-15)
    # The scale at the axis is that of the focal length, but of FOV, whose own scale it is.
    if model != "FOV":
        np.testing.assert_allclose(
            distort(np.array([[1e-6, 0]]), lens(model, k)), [[1e-6, 0]], rtol=1e-5, atol=1e-11
        )


U, V = 0.3, -0.4
RR = 0.25
R = 0.5
THETA = np.arctan(R)


@pytest.mark.parametrize(
    ("model", "k", "expected"),
    [
        ("SIMPLE_RADIAL", [0.1], (U * (1 + 0.1 * RR), V * (1 + 0.1 * RR))),
        ("RADIAL", [0.1, 0.2], (U * (1.025 + 0.0125), V * (1.025 + 0.0125))),
        (
            "OPENCV",
            [0.1, 0.2, 0.01, 0.02],
            (
                U * 1.0375 + 2 * 0.01 * U * V + 0.02 * (RR + 2 * U * U),
                V * 1.0375 + 2 * 0.02 * U * V + 0.01 * (RR + 2 * V * V),
            ),
        ),
        (
            "FULL_OPENCV",
            [0.1, 0.2, 0.0, 0.0, 0.3, 0.04, 0.05, 0.06],
            tuple(
                x * (1 + 0.1 * RR + 0.2 * RR**2 + 0.3 * RR**3) / (1 + 0.04 * RR + 0.05 * RR**2 + 0.06 * RR**3)
                for x in (U, V)
            ),
        ),
        (
            "RADIAL4",
            [0.1, 0.2, 0.3, 0.4, 0.01, 0.02],
            (
                U * (1 + 0.1 * RR + 0.2 * RR**2 + 0.3 * RR**3 + 0.4 * RR**4)
                + 2 * 0.01 * U * V
                + 0.02 * (RR + 2 * U * U),
                V * (1 + 0.1 * RR + 0.2 * RR**2 + 0.3 * RR**3 + 0.4 * RR**4)
                + 2 * 0.02 * U * V
                + 0.01 * (RR + 2 * V * V),
            ),
        ),
        (
            "OPENCV_FISHEYE",
            [0.1, 0.2, 0.3, 0.4],
            tuple(
                x / R * THETA * (1 + 0.1 * THETA**2 + 0.2 * THETA**4 + 0.3 * THETA**6 + 0.4 * THETA**8)
                for x in (U, V)
            ),
        ),
        ("SIMPLE_RADIAL_FISHEYE", [0.1], tuple(x / R * THETA * (1 + 0.1 * THETA**2) for x in (U, V))),
        (
            "RADIAL_FISHEYE",
            [0.1, 0.2],
            tuple(x / R * THETA * (1 + 0.1 * THETA**2 + 0.2 * THETA**4) for x in (U, V)),
        ),
        ("FOV", [0.8], tuple(x / R * np.arctan(2 * R * np.tan(0.4)) / 0.8 for x in (U, V))),
        (
            "THIN_PRISM_FISHEYE",
            [0, 0, 0, 0, 0, 0, 0.1, 0.2],
            (U / R * THETA + 0.1 * THETA**2, V / R * THETA + 0.2 * THETA**2),
        ),
        (
            "RAD_TAN_THIN_PRISM_FISHEYE",
            [0, 0, 0, 0, 0, 0, 0.01, 0, 0.1, 0.2, 0.3, 0.4],
            (
                U / R * THETA
                + 0.01 * (THETA**2 + 2 * (U / R * THETA) ** 2)
                + 0.1 * THETA**2
                + 0.2 * THETA**4,
                V / R * THETA + 2 * 0.01 * U * V / RR * THETA**2 + 0.3 * THETA**2 + 0.4 * THETA**4,
            ),
        ),
        ("SIMPLE_FISHEYE", [], (U / R * THETA, V / R * THETA)),
        ("FISHEYE", [], (U / R * THETA, V / R * THETA)),
        # What a division lens does to a distorted point is the definition: divide it by 1 + k·r².
        ("SIMPLE_DIVISION", [0.3], tuple(x * (1 - np.sqrt(1 - 1.2 * RR)) / (0.6 * RR) for x in (U, V))),
        ("DIVISION", [-0.3], tuple(x * (1 - np.sqrt(1 + 1.2 * RR)) / (-0.6 * RR) for x in (U, V))),
        ("EUCM", [0.6, 1.5], tuple(x / (0.6 * np.sqrt(1.5 * RR + 1) + 0.4) for x in (U, V))),
        # By COLMAP 4.2: `pycolmap.Camera.img_from_cam` of (0.3, -0.4, 1), for focal lengths of 1.
        ("DIVISION", [-0.3], (0.2803508501982759, -0.37380113359770123)),
        ("EUCM", [0.6, 1.5], (0.2718468931106099, -0.36246252414747987)),
    ],
)
def test_by_definition(model, k, expected):
    np.testing.assert_allclose(distort(np.array([[U, V]]), lens(model, k))[0], expected, rtol=1e-12)


@pytest.mark.parametrize("model", COUNTS)
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
@example(seed=1255457)  # beside a pole
def test_derivatives_are_those_of_finite_differences(model, seed):
    """First derivatives by differences of points, second ones by differences of first ones, of strong lenses.

    Central differences with a step of 1e-5 are good to 1e-9 of numbers about 1. Beside a pole of a rational
    lens, or of a division's derivative, numbers grow without bounds, and differences are worth less: such
    points are left out.
    """
    a_lens = random_lens(model, seed, 0.2)
    form = a_lens.form
    rng = np.random.default_rng(seed + 1)
    points, along = rng.uniform(-0.8, 0.8, size=(20, 2)), rng.normal(size=(20, 2))
    step = 1e-5 * along
    changes = (distort(points + step, a_lens) - distort(points - step, a_lens)) / 2e-5
    J = distortion_jacobians(points, a_lens)
    bends = (distortion_jacobians(points + step, a_lens) - distortion_jacobians(points - step, a_lens)) / 2e-5
    u, v = points.T
    bending = lens_bending(form, u, v, *magnifications(form, u * u + v * v), *along.T)
    # Where numbers do not depend on the point they are plain floats.
    bending = np.stack(np.broadcast_arrays(*bending), axis=-1).reshape(-1, 2, 2)
    usual = (np.abs(bends) < 100).all(axis=(1, 2)) & (1 + form.beta * (u * u + v * v) > 0.01)
    assert usual.sum() >= 10
    np.testing.assert_allclose((J @ along[:, :, None])[usual, :, 0], changes[usual], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(bending[usual], bends[usual], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("model", COUNTS)
def test_derivatives_on_the_axis_are_finite(model):
    """r = 0 divides nothing, and the derivative is that of a point beside it."""
    a_lens = random_lens(model, 3)
    at = np.array([[0.0, 0.0], [1e-7, -1e-7]])
    J = distortion_jacobians(at, a_lens)
    np.testing.assert_allclose(J[0], J[1], atol=1e-6)
    u, v = at.T
    bending = np.stack(
        np.broadcast_arrays(
            *lens_bending(a_lens.form, u, v, *magnifications(a_lens.form, u * u + v * v), 1.0, 0.0)
        )
    )
    assert np.isfinite(bending).all()
    np.testing.assert_allclose(bending[:, 0], bending[:, 1], atol=1e-5)


def test_float32_stays_float32_and_close():
    rays = np.random.default_rng(0).uniform(-3, 3, size=(200, 2))
    for model in COUNTS:
        a_lens = random_lens(model, 1)
        J = distortion_jacobians(rays.astype(np.float32), a_lens)
        assert J.dtype == np.float32
        np.testing.assert_allclose(J, distortion_jacobians(rays, a_lens), atol=3e-5, rtol=3e-5)


def test_the_reach_is_where_the_polynomial_turns_back():
    # r(1 - 0.5 r²) has its largest value at r = sqrt(2/3).
    a_lens = lens("SIMPLE_RADIAL", [-0.5])
    assert a_lens.valid_radius == pytest.approx(np.sqrt(2 / 3), rel=1e-9)
    # Nothing is seen at twice the largest value.
    assert np.isnan(undistort(np.array([[1.2, 0.0]]), a_lens)).all()
    # In angles for a fisheye: theta(1 - 0.2 theta²) turns back at sqrt(1 / 0.6).
    fisheye = lens("OPENCV_FISHEYE", [-0.2, 0, 0, 0])
    assert fisheye.valid_radius == pytest.approx(np.tan(np.sqrt(1 / 0.6)), rel=1e-9)
    # A pole of the rational polynomial: 1 - 0.2 r² = 0.
    assert lens("FULL_OPENCV", [0, 0, 0, 0, 0, -0.2, 0, 0]).valid_radius == pytest.approx(
        np.sqrt(5), rel=1e-9
    )
    # Of division rays end where 4·k·r² = 1, and nothing of what is farther out is seen.
    division = lens("DIVISION", [0.1])
    assert division.valid_radius == pytest.approx(np.sqrt(2.5), rel=1e-5)
    assert np.isnan(undistort(np.array([[3.2, 0.0]]), division)).all()
    assert np.isfinite(undistort(np.array([[3.1, 0.0]]), division)).all()
    assert lens("DIVISION", [-0.1]).valid_radius == FISHEYE_RADIUS
    assert lens("EUCM", [0.6, 1.5]).valid_radius == FISHEYE_RADIUS
    assert lens("OPENCV", [0.1, 0.1, 0, 0]).valid_radius == np.inf
    assert lens("OPENCV_FISHEYE", [0.01, 0, 0, 0]).valid_radius == FISHEYE_RADIUS


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_within_the_reach_no_two_rays_meet(seed):
    """Of random strong lenses: rays from a grid within the reach, distorted, come back to where they were."""
    model = ("RADIAL", "OPENCV", "OPENCV_FISHEYE", "THIN_PRISM_FISHEYE")[seed % 4]
    a_lens = random_lens(model, seed, 0.1)
    radius = min(a_lens.valid_radius, 2.0) * 0.98
    angle = np.linspace(0, 2 * np.pi, 25)
    rays = np.concatenate(
        [share * radius * np.stack([np.cos(angle), np.sin(angle)], 1) for share in (0.3, 0.7, 1)]
    )
    J = distortion_jacobians(rays, a_lens)
    assert (np.linalg.det(J) > 0).all()


def test_a_fisheye_without_distortion_is_no_pinhole():
    assert not lens("OPENCV_FISHEYE", [0, 0, 0, 0]).is_pinhole
    assert not lens("FOV", [0.9]).is_pinhole
    assert lens("FOV", [0.0]).is_pinhole
    assert lens("OPENCV", [0, 0, 0, 0]).is_pinhole
    assert not lens("FISHEYE", []).is_pinhole
    assert lens("DIVISION", [0.0]).is_pinhole and not lens("DIVISION", [0.01]).is_pinhole
    assert lens("EUCM", [0.0, 1.0]).is_pinhole and not lens("EUCM", [0.5, 1.0]).is_pinhole


@pytest.mark.parametrize(
    ("model", "parameters", "message"),
    [
        ("EQUIRECTANGULAR", (), "unknown lens model 'EQUIRECTANGULAR'"),
        ("OPENCV", (0.1,), "a OPENCV lens has 4 parameters, got 1"),
        ("FOV", (4.0,), "below pi"),
        ("EUCM", (1.1, 1.0), "alpha of an EUCM lens must be from 0 to 1"),
        ("EUCM", (0.5, 0.0), "beta above 0, got 0.5 and 0.0"),
        ("RADIAL", (0.1, float("nan")), "must be finite"),
    ],
)
def test_what_is_no_lens(model, parameters, message):
    with pytest.raises(ValueError, match=message):
        Lens(model=model, parameters=parameters)


def test_what_a_picture_sees_through_a_fisheye():
    """160 degrees across, and 179 from corner to corner, which are what sees farthest to the side."""
    fisheye = lens("OPENCV_FISHEYE", [0, 0, 0, 0])
    focal = 200 / np.radians(80)
    u_min, v_min, u_max, v_max = slopes_through(fisheye, 400, 200, focal, focal, 200.0, 100.0)
    corner = np.tan(np.hypot(200, 100) / focal) * np.array([200, 100]) / np.hypot(200, 100)
    np.testing.assert_allclose([(u_min, v_min), (u_max, v_max)], [-corner, corner], rtol=1e-6)
    # Through a narrow one it is nearly the pinhole's: r(1 - 0.1 r²) at the corners.
    barrel = lens("SIMPLE_RADIAL", [-0.1])
    _, _, u_max, v_max = slopes_through(barrel, 400, 200, 400.0, 400.0, 200.0, 100.0)
    np.testing.assert_allclose(distort(np.array([u_max, v_max]), barrel), (0.5, 0.25), rtol=1e-9)
    # Beyond 180 degrees the reach bounds it.
    wide = slopes_through(fisheye, 400, 400, 100.0, 100.0, 200.0, 200.0)
    np.testing.assert_allclose(wide, [-FISHEYE_RADIUS, -FISHEYE_RADIUS, FISHEYE_RADIUS, FISHEYE_RADIUS])
