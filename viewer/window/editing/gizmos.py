"""Handles on the picture that move, turn and scale things, by ImGuizmo."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui, imguizmo

from ....scene import Camera
from ....scene.image_model import NEAR

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
