"""Loaded cameras in the view, each as a small pyramid that opens the way it looks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from ...scene import Camera
from ...scene.image_model import NEAR
from . import theme
from .core import Core

SIZE = 0.06
"""Depth of a pyramid in scene radii."""

EDGES = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)])
"""Between the eye (0) and the picture's corners (1 to 4, going round)."""

MOST = 1000
"""Pyramids drawn at most: a video's every frame would be a carpet, and slow."""


def show(core: Core, corner: ImVec2) -> None:
    """Draws the pyramids over the picture whose top left is at `corner`, screen coordinates."""
    scale = imgui.get_io().display_framebuffer_scale
    radius = core.scene.radius if core.scene else core.view.distance
    cameras = core.cameras[:: -(-len(core.cameras) // MOST)]
    chosen = core.cameras[core.camera_index] if core.camera_index >= 0 else None
    draw = imgui.get_window_draw_list()
    usual = imgui.get_color_u32(ImVec4(1, 1, 1, 0.55))
    bright = imgui.get_color_u32(ImVec4(*theme.ACCENT, 1))
    for index, lines in pyramids(cameras, core.camera, SIZE * radius):
        colour = bright if cameras[index] is chosen else usual
        for (x0, y0), (x1, y1) in (lines / (scale.x, scale.y)).tolist():
            draw.add_line(ImVec2(corner.x + x0, corner.y + y0), ImVec2(corner.x + x1, corner.y + y1), colour)


def pyramids(cameras: Sequence[Camera], seen_by: Camera, size: float) -> list[tuple[int, np.ndarray]]:
    """(index, lines (8, 2, 2) px in `seen_by`'s picture) of every camera that is wholly before the eye.

    `size` is the depth of a pyramid, world units.
    """
    found = []
    for index, camera in enumerate(cameras):
        left, right = -camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
        top, bottom = -camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
        own = size * np.array(
            [(0, 0, 0), (left, top, 1), (right, top, 1), (right, bottom, 1), (left, bottom, 1)]
        )
        # By way of the difference of the eyes, so that scenes far from the origin do not jitter.
        points = own @ camera.R_camera_world + (camera.eye - seen_by.eye)
        t = points @ seen_by.R_camera_world.T
        if not (t[:, 2] >= NEAR).all():
            continue
        pixels = t[:, :2] / t[:, 2:] * (seen_by.fx, seen_by.fy) + (seen_by.cx, seen_by.cy)
        found.append((index, pixels[EDGES]))
    return found
