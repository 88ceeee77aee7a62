"""Every lens against its definition and against its own inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.scene.captures.lens import distort, fold_radius, undistort
from splatview.scene.files.colmap import ColmapCamera

SIZES = {
    "SIMPLE_PINHOLE": 0,
    "PINHOLE": 0,
    "SIMPLE_RADIAL": 1,
    "RADIAL": 2,
    "OPENCV": 4,
    "OPENCV_FISHEYE": 4,
    "FULL_OPENCV": 8,
    "RADIAL4": 6,
    "FOV": 1,
    "SIMPLE_RADIAL_FISHEYE": 1,
    "RADIAL_FISHEYE": 2,
    "THIN_PRISM_FISHEYE": 8,
    "RAD_TAN_THIN_PRISM_FISHEYE": 12,
}


def lens(model: str, distortion) -> ColmapCamera:
    return ColmapCamera(
        model=model,
        width=640,
        height=480,
        fx=500.0,
        fy=510.0,
        cx=320.0,
        cy=240.0,
        distortion=tuple(float(k) for k in distortion),
        is_fisheye=False,
    )


@pytest.mark.parametrize("model", SIZES)
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_round_trip(model, seed):
    rng = np.random.default_rng(seed)
    size = 0.02 if model != "FOV" else 0.9
    a_lens = lens(model, rng.uniform(-size, size, SIZES[model]))
    points = rng.uniform(-0.6, 0.6, size=(50, 2))
    assert fold_radius(a_lens, 0.9) == np.inf
    back = undistort(distort(points, a_lens), a_lens)
    np.testing.assert_allclose(back, points, atol=1e-9)


@pytest.mark.parametrize("model", SIZES)
def test_the_axis_stays_and_no_distortion_is_none(model):
    k = [0.05] * SIZES[model]
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
    ],
)
def test_by_definition(model, k, expected):
    np.testing.assert_allclose(distort(np.array([[U, V]]), lens(model, k))[0], expected, rtol=1e-12)


def test_a_polynomial_that_turns_back_is_cut():
    # r(1 - 0.5 r²) has its largest value at r = sqrt(2/3).
    a_lens = lens("SIMPLE_RADIAL", [-0.5])
    assert fold_radius(a_lens, 2.0) == pytest.approx(np.sqrt(2 / 3), abs=0.01)
    assert fold_radius(a_lens, 0.7) == np.inf
    # Nothing is seen at twice the largest value.
    assert np.isnan(undistort(np.array([[1.2, 0.0]]), a_lens)).all()
