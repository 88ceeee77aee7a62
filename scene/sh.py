"""Real spherical harmonics to degree 3, in the sign convention of trained files.

Band 1 is (-C1·y, +C1·z, -C1·x): the two minus signs (the Condon-Shortley phase) are those of Kerbl
et al. 2023 and of every .ply trained since; write-ups that drop them render such files wrongly.
"""

from __future__ import annotations

import numpy as np

from splatview.scene.gaussians import SH_COEFFICIENTS

SH_C0 = 0.28209479177387814  # sqrt(1 / (4π))
SH_C1 = 0.4886025119029199  # sqrt(3 / (4π))
SH_C2 = (
    1.0925484305920792,  # sqrt(15 / (4π))
    -1.0925484305920792,
    0.31539156525252005,  # sqrt(5 / (16π))
    -1.0925484305920792,
    0.5462742152960396,  # sqrt(15 / (16π))
)
SH_C3 = (
    -0.5900435899266435,  # sqrt(35 / (32π))
    2.890611442640554,  # sqrt(105 / (4π))
    -0.4570457994644658,  # sqrt(21 / (32π))
    0.3731763325901154,  # sqrt(7 / (16π))
    -0.4570457994644658,
    1.445305721320277,  # sqrt(105 / (16π))
    -0.5900435899266435,
)


def sh_basis(directions: np.ndarray, degree: int) -> np.ndarray:
    """Basis functions at unit `directions` (N, 3), any float dtype -> (N, (degree + 1)²), same dtype."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    basis = np.empty((len(directions), SH_COEFFICIENTS[degree]), dtype=directions.dtype)
    xx, yy, zz = x * x, y * y, z * z
    basis[:, 0] = SH_C0
    if degree >= 1:
        basis[:, 1] = -SH_C1 * y
        basis[:, 2] = SH_C1 * z
        basis[:, 3] = -SH_C1 * x
    if degree >= 2:
        basis[:, 4] = SH_C2[0] * x * y
        basis[:, 5] = SH_C2[1] * y * z
        basis[:, 6] = SH_C2[2] * (2 * zz - xx - yy)
        basis[:, 7] = SH_C2[3] * x * z
        basis[:, 8] = SH_C2[4] * (xx - yy)
    if degree >= 3:
        basis[:, 9] = SH_C3[0] * y * (3 * xx - yy)
        basis[:, 10] = SH_C3[1] * x * y * z
        basis[:, 11] = SH_C3[2] * y * (4 * zz - xx - yy)
        basis[:, 12] = SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy)
        basis[:, 13] = SH_C3[4] * x * (4 * zz - xx - yy)
        basis[:, 14] = SH_C3[5] * z * (xx - yy)
        basis[:, 15] = SH_C3[6] * x * (xx - 3 * yy)
    return basis


def sh_colours(sh: np.ndarray, directions: np.ndarray, degree: int) -> np.ndarray:
    """Colours max(0, 0.5 + SH): `sh` (N, K, 3), unit `directions` (N, 3) -> (N, 3) in the directions' dtype.

    Coefficients above `degree` are not read. A NaN coefficient gives a NaN colour (fmax would hide it).
    """
    basis = sh_basis(directions, degree)
    raw = np.einsum("nk,nkc->nc", basis, sh[:, : basis.shape[1]].astype(directions.dtype))
    return np.maximum(raw + 0.5, 0)


def rgb_to_sh(rgb: np.ndarray) -> np.ndarray:
    """The constant-band coefficient that shows as colour `rgb` in [0, 1]; any shape and float dtype."""
    return (rgb - 0.5) / SH_C0


_DIRECTIONS = 64
"""More than enough to determine 16 coefficients, well spread: rounding stays at a few 1e-16."""


def sh_rotation(R: np.ndarray, degree: int) -> np.ndarray:
    """The matrix that turns coefficients by the rotation `R` (3, 3): ((degree + 1)²,) squared, float64.

    With c' = matrix @ c, SH(c', R·d) = SH(c, d) for every direction d. Found by asking just that at
    many directions, so it holds in whatever sign convention `sh_basis` has; bands do not mix.
    """
    i = np.arange(_DIRECTIONS) + 0.5
    z = 1 - 2 * i / _DIRECTIONS
    turn = np.pi * (1 + np.sqrt(5)) * i  # a Fibonacci sphere
    flat = np.sqrt(1 - z * z)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    before = sh_basis(directions, degree)
    after = sh_basis(directions @ np.asarray(R, np.float64).T, degree)
    matrix = np.zeros((SH_COEFFICIENTS[degree], SH_COEFFICIENTS[degree]))
    matrix[0, 0] = 1.0
    for band in range(1, degree + 1):
        own = slice(SH_COEFFICIENTS[band - 1], SH_COEFFICIENTS[band])
        matrix[own, own] = np.linalg.lstsq(after[:, own], before[:, own], rcond=None)[0]
    return matrix
