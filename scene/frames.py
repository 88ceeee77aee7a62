"""Frames of scene files: which way their axes point, and scenes turned from one to another.

A frame is three letters, one for each axis: right or left, up or down, front or back. Scenes in memory are
"RDF", as trained .ply files are: x to the right, y down, z to the front.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from functools import cache

import numpy as np

from splatview.scene.edits import quat_product
from splatview.scene.errors import InputError
from splatview.scene.gaussians import Gaussians
from splatview.scene.lod import quaternions
from splatview.scene.sh import sh_rotation

OURS = "RDF"

_DIRECTIONS = {"R": (0, 1), "L": (0, -1), "U": (1, 1), "D": (1, -1), "F": (2, 1), "B": (2, -1)}

FRAMES = tuple(
    "".join(letters)
    for axes in itertools.permutations(("LR", "DU", "BF"))
    for letters in itertools.product(*axes)
)
"""All 48 of them."""


def frame_matrix(frame: str, to: str = OURS) -> np.ndarray:
    """(3, 3) float64 that takes points of `frame` to points of `to`; a mirror where one is left-handed."""

    def axes(name: str) -> np.ndarray:
        matrix = np.zeros((3, 3))
        for column, letter in enumerate(name):
            row, sign = _DIRECTIONS[letter]
            matrix[row, column] = sign
        return matrix

    return axes(to).T @ axes(frame)


TURN_OVER = "x180"
"""What takes RUB for RDF, and back: half a turn about x."""


def turn_matrix(turns: str) -> np.ndarray:
    """(3, 3) float64, exact: ``x180``, or several one after another, ``x90,z-90``; ``over`` is TURN_OVER.

    Raises:
        InputError: a turn is about no axis, or by no whole number of quarter turns.
    """
    matrix = np.eye(3)
    for turn in turns.lower().split(","):
        found = re.fullmatch(r"([xyz])([+-]?\d{1,4})", TURN_OVER if turn.strip() == "over" else turn.strip())
        if found is None or int(found[2]) % 90:
            raise InputError(
                f"{turn!r} is no turn: give an axis and degrees in steps of 90, such as x180 or z-90, "
                "several with commas between, or over (x180)"
            )
        # Right-handed, as seen against the axis; in the frame that scenes have in memory.
        axis, quarters = "xyz".index(found[1]), int(found[2]) // 90 % 4
        quarter = np.zeros((3, 3))
        first, second = (axis + 1) % 3, (axis + 2) % 3
        quarter[axis, axis] = quarter[second, first] = 1
        quarter[first, second] = -1
        matrix = np.linalg.matrix_power(quarter, quarters) @ matrix
    return matrix


def reframed(gaussians: Gaussians, frame: str, to: str = OURS) -> Gaussians:
    """The scene of a file in `frame` with its axes as `to` has them; exact but for rotated SH."""
    return gaussians if frame == to else turned(gaussians, frame_matrix(frame, to))


Flips = tuple[np.ndarray, np.ndarray, np.ndarray]
"""What becomes of a scene whose axes change their signs alone, float32: the sign of each axis (3,), the turn
that quaternions get before their own (4,), and the sign of each SH coefficient (16,)."""

NO_FLIPS: Flips = (np.ones(3, np.float32), np.array([1, 0, 0, 0], np.float32), np.ones(16, np.float32))


@cache
def axis_flips(frame: str, to: str = OURS) -> Flips | None:
    """How a scene of `frame` becomes one of `to`; None where axes change places."""
    matrix = frame_matrix(frame, to)
    if not np.array_equal(matrix, np.diag(matrix.diagonal())):
        return None
    turn = quaternions(matrix[None] * np.linalg.det(matrix))[0]
    signs = np.round(sh_rotation(matrix, 3).diagonal())
    return matrix.diagonal().astype(np.float32), turn.astype(np.float32), signs.astype(np.float32)


TURNED_AT_ONCE = 1 << 15
"""Splats, so that no second copy of the scene is made."""


def turn_in_place(arrays: dict[str, np.ndarray], matrix: np.ndarray) -> None:
    """Turns the arrays of a `Gaussians` that nobody has yet, as `turned` does."""
    for start in range(0, len(arrays["means"]), TURNED_AT_ONCE):
        part = {name: values[start : start + TURNED_AT_ONCE] for name, values in arrays.items()}
        logits, sh = part["opacity_logits"], part["sh"]
        means, quats, log_scales = part["means"], part["quats"], part["log_scales"]
        before = Gaussians(means=means, quats=quats, log_scales=log_scales, opacity_logits=logits, sh=sh)
        done = turned(before, matrix)
        for name in ("means", "quats", "sh"):
            part[name][:] = getattr(done, name)


def turned(gaussians: Gaussians, matrix: np.ndarray) -> Gaussians:
    """The scene turned by an orthogonal matrix (3, 3), mirrored where its determinant is -1."""
    # A Gaussian is its own mirror image, so a reflection turns it as its negative does, which is a rotation.
    turn = quaternions(matrix[None] * np.linalg.det(matrix))[0].astype(np.float32)
    sh = gaussians.sh
    if gaussians.sh_degree:
        bands = np.round(sh_rotation(matrix, gaussians.sh_degree), 12).astype(np.float32)
        if np.array_equal(bands, np.diag(signs := bands.diagonal())):
            sh = sh * signs[:, None]  # as is where axes only change their signs
        else:
            sh = np.einsum("jk,nkc->njc", bands, sh, optimize=True)
    return replace(
        gaussians,
        means=gaussians.means @ matrix.T.astype(gaussians.means.dtype),
        quats=quat_product(np.broadcast_to(turn, gaussians.quats.shape), gaussians.quats),
        sh=sh,
    )
