"""Handles on the picture that move, turn and scale things, by ImGuizmo; Euler angles and quaternions."""

from __future__ import annotations

import math

import numpy as np
from imgui_bundle import ImVec2, imgui, imguizmo
from numpy.typing import ArrayLike
from pyrr import matrix44, quaternion

from splatview.scene import Camera
from splatview.scene.edits import Four
from splatview.scene.image_model import NEAR
from splatview.viewer.editing.tool_state import Euler

guizmo = imguizmo.im_guizmo

KINDS = ("move", "rotate", "scale")

OPERATIONS = {
    "move": guizmo.OPERATION.translate,
    "rotate": guizmo.OPERATION.rotate,
    "scale": guizmo.OPERATION.scale,
}

GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes x right, y down, z forward to x right, y up, z backward."""

SIZE = 0.18
"""Length of the handles, in halves of the picture's width: ImGuizmo's own 0.1 are 30 px at 1000 x 700."""

FAR = 1e5
"""World units: of the far plane, which is of no account to handles."""


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
    guizmo.set_gizmo_size_clip_space(SIZE)
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
    """Whether the left button is the handles' in this frame, rather than the picture's: the mouse drags them,
    or is on them with nothing else in hand. To be asked once a frame before the picture's item, only where
    handles are drawn."""
    guizmo.begin_frame()  # forgets where the mouse was; without, ImGuizmo takes but the first handle it met
    return dragging() or (guizmo.is_over() and not imgui.is_any_item_active())


def dragging() -> bool:
    return guizmo.is_using_any()


def placed(centre: ArrayLike, R: np.ndarray, sizes: ArrayLike = (1.0, 1.0, 1.0)) -> np.ndarray:
    """The matrix (4, 4) for `handles` of an object at `centre` (3,) whose axes, as long as `sizes` (3,), are
    the columns of `R` (3, 3); world units."""
    # pyrr's matrices act on rows, the first one first.
    own = matrix44.create_from_scale(np.asarray(sizes, np.float64)) @ matrix44.create_from_matrix33(R.T)
    return (own @ matrix44.create_from_translation(np.asarray(centre, np.float64))).T


def projection(camera: Camera) -> np.ndarray:
    """OpenGL's clip matrix (4, 4) of a camera without a lens."""
    left, top, right, bottom = camera.visible_slopes  # y down, where pyrr's is up
    if camera.orthographic:
        return matrix44.create_orthogonal_projection(left, right, -bottom, -top, NEAR, FAR).T
    left, top, right, bottom = (NEAR * slope for slope in (left, top, right, bottom))
    return matrix44.create_perspective_projection_from_bounds(left, right, -bottom, -top, NEAR, FAR).T


def _columns(matrix: np.ndarray) -> imguizmo.im_guizmo.Matrix16:
    return guizmo.Matrix16(matrix.T.astype(np.float32).ravel().tolist())


def quat_of(angles: Euler) -> Four:
    """wxyz of length 1."""
    # One by one: pyrr's create_from_eulers turns about x last.
    x, y, z = np.radians(angles)
    turned = quaternion.cross(quaternion.create_from_y_rotation(y), quaternion.create_from_x_rotation(x))
    return _wxyz(quaternion.cross(quaternion.create_from_z_rotation(z), turned))


def quat_from_matrix(R: np.ndarray) -> Four:
    """wxyz of length 1 of a rotation (3, 3)."""
    return _wxyz(quaternion.normalize(quaternion.create_from_matrix(np.asarray(R, np.float64))))


def angles_of(quat: Four) -> Euler:
    """The angles that `quat_of` makes `quat` (wxyz, length 1) of; y within ±90°."""
    # pyrr makes quaternions of angles, but no angles of quaternions.
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


def _wxyz(xyzw: np.ndarray) -> Four:
    """pyrr's order to the scene's."""
    x, y, z, w = xyzw.tolist()
    return (w, x, y, z)
