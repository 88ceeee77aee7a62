"""Cameras that go round something."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .camera import Camera


def turned_about(camera: Camera, target: np.ndarray, up: np.ndarray, degrees: float) -> Camera:
    """The eye turned about the axis `up` (3,) through `target` (3,); what it sees turns along."""
    angle, axis = math.radians(degrees), up / np.linalg.norm(up)
    K = np.cross(np.eye(3), axis)
    # Rodrigues' formula; np.cross(I, axis) is the transpose of the cross-product matrix of the axis.
    R = np.eye(3) - math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)
    eye = target + R @ (camera.eye - target)
    matrix = np.eye(4)
    matrix[:3, :3] = camera.R_camera_world @ R.T
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return replace(camera, world_to_camera=matrix)
