"""Cameras in the view, loaded ones or those of photos in training: pyramids that open the way they look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from ...scene import Camera
from ...scene.image_model import NEAR
from . import theme
from .camera_list import go_to_camera
from .core import Core

SIZE = 0.06
"""Depth of a pyramid in scene radii."""

PHOTO_SIZE = 0.03
"""The same of photos in training, which are mostly many and near."""

EDGES = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)])
"""Between the eye (0) and the picture's corners (1 to 4, going round)."""

MOST = 1000
"""Pyramids drawn at most: a video's every frame would be a carpet, and slow."""


WIDEST = 2.0
"""Slope of a pyramid's sides at most where the camera has a lens: a fisheye's pyramid would be flat."""

GRAB = 0.4
"""Font heights from a line within which the mouse is on its camera."""


def wanted(core: Core) -> bool:
    """Whether the loaded cameras, or those of the photos in training, are to be drawn."""
    if core.training is not None and core.cameras is core.training.cameras:
        return core.preferences.show_photos
    return core.preferences.show_cameras and bool(core.cameras)


def show(core: Core, corner: ImVec2) -> None:
    """Draws the pyramids over the picture whose top left is at `corner`, screen coordinates; a click on
    one goes to its camera."""
    scale = imgui.get_io().display_framebuffer_scale
    radius = core.scene.radius if core.scene else core.view.distance
    step = -(-len(core.cameras) // MOST)
    training = core.training if core.training and core.cameras is core.training.cameras else None
    size = radius * (SIZE if training is None else PHOTO_SIZE)
    drawn = pyramids(core.cameras[::step], core.camera, size)
    lines = [pixels / (scale.x, scale.y) + (corner.x, corner.y) for _, pixels in drawn]
    mouse = imgui.get_mouse_pos()
    under = nearest(lines, (mouse.x, mouse.y), GRAB * imgui.get_font_size()) if may_point(core) else None
    draw = imgui.get_window_draw_list()
    for place, (index, _) in enumerate(drawn):
        index *= step
        if index == core.camera_index or place == under:
            colour = ImVec4(*theme.ACCENT, 1)
        elif training is not None and training.photos[index].held_out:
            colour = ImVec4(*theme.HELD_OUT, 0.75)
        else:
            colour = ImVec4(1, 1, 1, 0.55)
        ink, weight = imgui.get_color_u32(colour), 2.0 if place == under else 1.0
        for (x0, y0), (x1, y1) in lines[place].tolist():
            draw.add_line(ImVec2(x0, y0), ImVec2(x1, y1), ink, weight)
    if under is None:
        return
    index = drawn[under][0] * step
    held_out = " (held out)" if training is not None and training.photos[index].held_out else ""
    imgui.set_tooltip(f"{core.cameras[index].name or f'Camera {index + 1}'}{held_out}")
    dragged = imgui.get_mouse_drag_delta(imgui.MouseButton_.left)
    if imgui.is_mouse_released(imgui.MouseButton_.left) and not (dragged.x or dragged.y):
        core.post(go_to_camera, index)


def may_point(core: Core) -> bool:
    """Whether the mouse is over the picture itself, turns nothing and holds no tool."""
    if core.desk is not None and core.desk.tool != "none":
        return False
    dragged = imgui.get_mouse_drag_delta(imgui.MouseButton_.left)
    return imgui.is_window_hovered() and not (dragged.x or dragged.y)


def nearest(lines: Sequence[np.ndarray], place: tuple[float, float], reach: float) -> int | None:
    """Which of the bundles of lines, each (L, 2, 2) px, comes nearest to `place`; None beyond `reach` px."""
    if not lines:
        return None
    ends = np.stack(lines)  # (B, L, 2, 2)
    start, along = ends[:, :, 0], ends[:, :, 1] - ends[:, :, 0]
    length = np.maximum((along**2).sum(axis=-1), 1e-12)
    share = np.clip(((place - start) * along).sum(axis=-1) / length, 0, 1)
    apart = np.linalg.norm(start + share[..., None] * along - place, axis=-1).min(axis=1)
    best = int(np.argmin(apart))
    return best if apart[best] <= reach else None


def pyramids(cameras: Sequence[Camera], seen_by: Camera, size: float) -> list[tuple[int, np.ndarray]]:
    """(index, lines (8, 2, 2) px in `seen_by`'s picture) of every camera that is wholly before the eye.

    `size` is the depth of a pyramid, world units.
    """
    found = []
    for index, camera in enumerate(cameras):
        own = np.concatenate([np.zeros((1, 3)), size * picture_corners(camera, size)])
        # By way of the difference of the eyes, so that scenes far from the origin do not jitter.
        points = own @ camera.R_camera_world + (camera.eye - seen_by.eye)
        t = points @ seen_by.R_camera_world.T
        if not (t[:, 2] >= NEAR).all():
            continue
        pixels = seen_by.image_points(t)
        if np.isfinite(pixels).all():
            found.append((index, pixels[EDGES]))
    return found


def picture_corners(camera: Camera, size: float) -> np.ndarray:
    """(4, 3): where the picture's corners are `size` ahead, in camera axes and units of `size`."""
    if camera.orthographic:
        w, h = camera.width, camera.height
        return camera.points_at([(0, 0), (w, 0), (w, h), (0, h)], size) / size
    left, top, right, bottom = camera.seen_slopes
    if camera.lens is not None:
        left, top, right, bottom = np.clip((left, top, right, bottom), -WIDEST, WIDEST)
    return np.array([(left, top, 1), (right, top, 1), (right, bottom, 1), (left, bottom, 1)])
