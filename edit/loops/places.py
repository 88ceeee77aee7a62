"""Where the splats of an edited scene are: their means, moved by what their marks name."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.adjustment import adjustment_rows
from ...scene.edits import PALETTE_SHIFT, SceneEdits
from .compiling import inline, kernel
from .pieces import in_pieces


class Places(NamedTuple):
    """What `place` needs to know."""

    means: np.ndarray
    """(N, 3) float32 or float64."""
    marks: np.ndarray
    """(N,) uint32."""
    moves: np.ndarray
    """(P, 12) float64: linear part beside translation, 3x4 by rows; (0, 12) where nothing was moved."""


def places_of(gaussians: Gaussians, edits: SceneEdits) -> Places:
    """No copy of the scene: N is not touched."""
    moves = np.zeros((0, 12))
    if any(adjustment.moves for adjustment in edits.palette):
        moves = np.ascontiguousarray(adjustment_rows(edits.palette)[:, :12])
    return Places(gaussians.means, edits.marks, moves)


@inline
def place(places, i):
    """World position of splat `i` as three float64."""
    x, y, z = np.float64(places.means[i, 0]), np.float64(places.means[i, 1]), np.float64(places.means[i, 2])
    entry = places.marks[i] >> PALETTE_SHIFT
    if entry == 0 or len(places.moves) == 0:
        return x, y, z
    m = places.moves[entry]
    return (
        m[0] * x + m[1] * y + m[2] * z + m[3],
        m[4] * x + m[5] * y + m[6] * z + m[7],
        m[8] * x + m[9] * y + m[10] * z + m[11],
    )


class View(NamedTuple):
    """A camera as numbers."""

    R: np.ndarray
    """(3, 3) float64, world to camera."""
    eye: np.ndarray
    """(3,) float64."""
    fx: float
    fy: float
    cx: float
    cy: float
    orthographic: bool


def view_of(camera: Camera) -> View:
    return View(
        np.ascontiguousarray(camera.R_camera_world),
        camera.eye,
        float(camera.fx),
        float(camera.fy),
        float(camera.cx),
        float(camera.cy),
        camera.orthographic,
    )


def image_points(start: int, stop: int, places: Places, camera: Camera, near: float) -> np.ndarray:
    """(stop - start, 2) float64: pixels of the means of splats start to stop; NaN before `near` and beyond
    the reach of the camera's lens."""
    points = np.empty((stop - start, 2))
    if camera.lens is None:
        project_places(start, stop, places, view_of(camera), near, points)
        return points
    slopes = view_of(camera)._replace(fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    project_places(start, stop, places, slopes, near, points)
    return camera.image_points(np.column_stack([points, np.ones(len(points))]))


@kernel
def project_places(start, stop, places, view, near, points):
    """points (stop - start, 2) float64: pixels of the means of splats start to stop; NaN before `near`."""
    R, eye = view.R, view.eye
    for i in range(start, stop):
        x, y, z = place(places, i)
        x, y, z = x - eye[0], y - eye[1], z - eye[2]
        depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
        if depth >= near:
            right = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
            down = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
            away = 1.0 if view.orthographic else depth
            points[i - start, 0] = view.fx * right / away + view.cx
            points[i - start, 1] = view.fy * down / away + view.cy
        else:
            points[i - start, 0] = np.nan
            points[i - start, 1] = np.nan


@kernel
def in_volume(start, stop, places, unit, ellipsoid, inside):
    """inside[start:stop]: whether means are in the unit box or ball after `unit` (3, 4)."""
    for i in range(start, stop):
        x, y, z = place(places, i)
        u = unit[0, 0] * x + unit[0, 1] * y + unit[0, 2] * z + unit[0, 3]
        v = unit[1, 0] * x + unit[1, 1] * y + unit[1, 2] * z + unit[1, 3]
        w = unit[2, 0] * x + unit[2, 1] * y + unit[2, 2] * z + unit[2, 3]
        if ellipsoid:
            inside[i] = u * u + v * v + w * w <= 1
        else:
            inside[i] = (abs(u) <= 1) & (abs(v) <= 1) & (abs(w) <= 1)


@kernel
def _positions(start, stop, places, positions):
    for i in range(start, stop):
        positions[i, 0], positions[i, 1], positions[i, 2] = place(places, i)


def positions_of(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N, 3) float64, as `scene.edits.adjusted_means`."""
    positions = np.empty((len(gaussians), 3))
    places = places_of(gaussians, edits)
    in_pieces(len(gaussians), lambda start, stop: _positions(start, stop, places, positions))
    return positions
