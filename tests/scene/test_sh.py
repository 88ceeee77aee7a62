"""Spherical harmonics: sign convention, orthonormality, worked answers."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.scene.sh import SH_C1, rgb_to_sh, sh_basis, sh_colours


def test_band_one_has_the_signs_of_trained_files():
    basis = sh_basis(np.eye(3), 1)
    np.testing.assert_array_equal(basis[:, 1:], [[0, 0, -SH_C1], [-SH_C1, 0, 0], [0, SH_C1, 0]])


def test_basis_is_orthonormal():
    # Exact quadrature for polynomials of degree 6: Gauss-Legendre in z, equal steps in azimuth.
    z, weights = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * 2 * np.pi / 16
    z, azimuth = (a.ravel() for a in np.meshgrid(z, azimuth, indexing="ij"))
    r = np.sqrt(1 - z * z)
    basis = sh_basis(np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1), 3)
    gram = (basis * np.repeat(weights, 16)[:, None] * 2 * np.pi / 16).T @ basis
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-14)


@pytest.mark.parametrize(("direction", "red"), [((0.3, 0.4, 0.866), 0.751), ((-0.6, -0.2, 0.7), 0.650)])
def test_worked_answer(direction, red):
    # The answer was worked in the convention without the two minus signs: flip those coefficients.
    coefficients = np.array([0.9, 0.05, -0.10, 0.20]) * (1, -1, 1, -1)
    unit = np.array([direction]) / np.linalg.norm(direction)
    sh = np.repeat(coefficients[None, :, None], 3, axis=2)
    assert sh_colours(sh, unit, 1)[0, 0] == pytest.approx(red, abs=6e-4)


def test_colours_clamp_below_not_above(rng):
    unit = np.array([[0.0, 0.0, 1.0]])
    assert sh_colours(np.full((1, 1, 3), -9.0), unit, 0).max() == 0
    assert sh_colours(np.full((1, 1, 3), 9.0), unit, 0).min() > 2


def test_rgb_round_trip(rng):
    rgb = rng.uniform(size=(5, 3))
    np.testing.assert_allclose(sh_colours(rgb_to_sh(rgb)[:, None], np.eye(3)[[0] * 5], 0), rgb, atol=1e-15)


def test_coefficients_above_the_degree_are_not_read(random_gaussians):
    sh = random_gaussians(4).sh.copy()
    sh[:, 4:] = np.nan
    unit = np.tile([[0.0, 0.6, 0.8]], (4, 1))
    assert np.isfinite(sh_colours(sh, unit, 1)).all()
    assert np.isnan(sh_colours(sh, unit, 2)).all()
