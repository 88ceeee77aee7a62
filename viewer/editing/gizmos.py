"""Handles on the picture that move, turn and scale things, by ImGuizmo."""

from __future__ import annotations

import math

import numpy as np
from imgui_bundle import ImVec2, imgui, imguizmo

from splatview.scene import Camera
from splatview.scene.edits import Four, quat_product
from splatview.scene.image_model import NEAR

guizmo = imguizmo.im_guizmo

OPERATIONS = {
    "move": guizmo.OPERATION.translate,
    "turn": guizmo.OPERATION.rotate,
    "size": guizmo.OPERATION.scale,
}

GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes x right, y down, z forward to x right, y up, z backward."""


def handles(
    name: str, camera: Camera, corner: ImVec2, matrix: np.ndarray, kind: str, *, local: bool
) -> np.ndarray | None:
    """Draws handles of a `kind` of OPERATIONS for the object that `matrix` (4, 4) places in the world, over
    the picture of `camera` with its top left at `corner`. The new matrix while the user drags one. None are
    drawn through a lens, which bends lines.
    """
    if camera.lens is not None:
        return None
    guizmo.push_id(name)
    guizmo.set_orthographic(camera.orthographic)
    guizmo.set_drawlist(imgui.get_window_draw_list())
    guizmo.set_rect(corner.x, corner.y, camera.width, camera.height)
    placed = _columns(matrix)
    mode = guizmo.MODE.local if local else guizmo.MODE.world
    view, lens = _columns(GL_FROM_CV @ camera.world_to_camera), _columns(projection(camera))
    changed = guizmo.manipulate(view, lens, OPERATIONS[kind], mode, placed)
    guizmo.pop_id()
    if not changed:
        return None
    new = np.array(placed.values, np.float64).reshape(4, 4).T
    return new if np.isfinite(new).all() else None


def grabbed() -> bool:
    """Whether the mouse is on the handles of this frame or the last, or drags them. To be asked only where
    some were drawn: without any ImGuizmo's answer is that of a handle nowhere, which may be yes."""
    return guizmo.is_over() or guizmo.is_using()


def dragging() -> bool:
    return guizmo.is_using()


def projection(camera: Camera) -> np.ndarray:
    """OpenGL's clip matrix (4, 4) of a camera without a lens; the far plane is of no account here."""
    near, far = NEAR, 1e5
    w, h = camera.width, camera.height
    if camera.orthographic:
        return np.array(
            [
                [2 * camera.fx / w, 0, 0, 2 * camera.cx / w - 1],
                [0, 2 * camera.fy / h, 0, 1 - 2 * camera.cy / h],
                [0, 0, -2 / (far - near), -(far + near) / (far - near)],
                [0, 0, 0, 1],
            ]
        )
    return np.array(
        [
            [2 * camera.fx / w, 0, 1 - 2 * camera.cx / w, 0],
            [0, 2 * camera.fy / h, 2 * camera.cy / h - 1, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )


def _columns(matrix: np.ndarray) -> imguizmo.im_guizmo.Matrix16:
    return guizmo.Matrix16(matrix.T.astype(np.float32).ravel().tolist())


# ---- Rotations as people type them and as the scene keeps them. No ImGui in here.


Euler = tuple[float, float, float]
"""Degrees about the axes x, y, z, turned in this order about axes that stay."""


def quat_of(angles: Euler) -> Four:
    """wxyz of length 1."""
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, degrees in enumerate(angles):
        turn = np.zeros(4)
        turn[0], turn[1 + axis] = math.cos(math.radians(degrees) / 2), math.sin(math.radians(degrees) / 2)
        quat = quat_product(turn, quat)
    w, x, y, z = quat.tolist()
    return (w, x, y, z)


def quat_from_matrix(R: np.ndarray) -> Four:
    """wxyz of length 1 of a rotation (3, 3), by the largest component so that no digits are lost."""
    w2 = 1 + R[0, 0] + R[1, 1] + R[2, 2]
    x2 = 1 + R[0, 0] - R[1, 1] - R[2, 2]
    y2 = 1 - R[0, 0] + R[1, 1] - R[2, 2]
    z2 = 1 - R[0, 0] - R[1, 1] + R[2, 2]
    products = np.array(
        [
            [w2, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], x2, R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
            [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], y2, R[2, 1] + R[1, 2]],
            [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], z2],
        ]
    )
    row = products[int(np.argmax([w2, x2, y2, z2]))]
    w, x, y, z = (row / np.linalg.norm(row)).tolist()
    return (w, x, y, z)


def angles_of(quat: Four) -> Euler:
    """The angles that `quat_of` makes `quat` (wxyz, length 1) of; y within ±90°."""
    w, x, y, z = quat
    pitch = max(-1.0, min(1.0, 2 * (w * y - z * x)))
    if abs(pitch) > 1 - 1e-12:
        # Straight up or down: only the sum or difference of the other two counts.
        return (math.degrees(2 * math.atan2(x, w)), math.copysign(90.0, pitch), 0.0)
    return (
        math.degrees(math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))),
        math.degrees(math.asin(pitch)),
        math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))),
    )
