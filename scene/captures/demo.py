"""A capture with known truth: pictures of a demo scene from known poses, and noisy points on it.

Nothing is stored: the same arguments make the same capture, so that training can be tried, and tested
against the truth, from a fresh installation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from splatview.scene.camera import Camera, look_at
from splatview.scene.captures.assemble import HOLD_OUT_EVERY
from splatview.scene.captures.capture import Capture, Photo, Pixels
from splatview.scene.demo import demo_scene
from splatview.scene.errors import InputError
from splatview.scene.gaussians import Gaussians
from splatview.scene.image_model import RenderSettings
from splatview.scene.lens import Lens
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.scene.projection import sigmoid
from splatview.scene.sh import SH_C0

Render = Callable[[Gaussians, Camera, RenderSettings], np.ndarray]
"""A renderer: float32 (H, W, 3 or 4)."""

TARGET = (0.35, -0.75, 0.3)
DISTANCE = 5.6
TURN = (-29.0, 26.0)
"""Degrees from the first view, within which no tree stands before the camera."""
HEIGHTS = (0.55, 1.75)
"""Heights of the eye over the target, in turn."""
FOV_Y = 46.0

POINTS = 6000
POINT_NOISE = 0.004
"""Standard deviation of a point across and along its ray, in its depths: about a pixel at 320 px."""
OUTLIERS = 0.01
"""Share of the points that are wrong matches: anywhere along their ray."""
MIN_OPACITY = 0.6
"""Least opacity of splats that a reconstruction would find points on."""


def demo_truth(splats: int | None = None) -> Gaussians:
    """The scene that `demo_capture` shows, for an equal number of splats."""
    return demo_scene("landscape", splats=splats)


def demo_cameras(count: int, width: int, height: int, fov_y: float = FOV_Y) -> list[Camera]:
    """On two arcs around the pond, in turn the low and the high one; `fov_y` in degrees."""
    cameras = []
    for i, angle in enumerate(np.radians(np.linspace(*TURN, count))):
        offset = np.array([np.sin(angle) * DISTANCE, -HEIGHTS[i % 2], -np.cos(angle) * DISTANCE])
        cameras.append(
            look_at(TARGET + offset, TARGET, up=(0, -1, 0), fov_y=fov_y, width=width, height=height)
        )
    return cameras


def demo_capture(
    render: Render,
    *,
    photos: int = 40,
    width: int = 320,
    height: int = 240,
    splats: int | None = None,
    truth: Gaussians | None = None,
    lens: Lens | None = None,
    fov_y: float = FOV_Y,
    seed: int = 0,
    progress: Progress = NO_PROGRESS,
) -> Capture:
    """`photos` pictures of the demo landscape by `render`, and noisy points on what they show.

    `truth` is `demo_truth(splats)` where the caller has it already. `lens` is what pictures are taken
    through, with the focal length of a pinhole of `fov_y` degrees. `seed` is of the noise alone. A renderer
    may be anything; this package knows none.

    Raises:
        InputError: fewer than two photos.
    """
    if not photos >= 2:
        raise InputError(f"a demo capture needs at least two photos, got {photos}")
    if truth is None:
        truth = demo_truth(splats)
    entries = []
    for i, camera in enumerate(demo_cameras(photos, width, height, fov_y)):
        camera = replace(camera, lens=lens)
        picture = render(truth, camera, RenderSettings())[..., :3]
        image = (np.clip(np.nan_to_num(picture), 0, 1) * 255 + 0.5).astype(np.uint8)
        image.flags.writeable = False
        entries.append(_photo(camera, image, i))
        progress.step((i + 1) / photos)
    cameras = [entry.camera for entry in entries]
    points, colours = _points(truth, cameras, np.random.default_rng(seed))
    return Capture(name="demo", photos=tuple(entries), points=points, point_colours=colours)


def _photo(camera: Camera, image: np.ndarray, i: int) -> Photo:
    name = f"view_{i:03d}.png"
    pixels = Pixels(image=image, mask=None)
    return Photo(
        name=name, camera=replace(camera, name=name), held_out=i % HOLD_OUT_EVERY == 0, pixels=lambda: pixels
    )


def _points(
    truth: Gaussians, cameras: list[Camera], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) float64 and (P, 3) uint8: means of splats that at least two cameras have in view, disturbed.

    Hidden splats are among them, where a reconstruction would have none; few enough to be pruned.
    """
    means = truth.means.astype(np.float64)
    seen = np.zeros(len(means), dtype=np.int64)
    for camera in cameras:
        t = means @ camera.R_camera_world.T + camera.t_camera_world
        with np.errstate(invalid="ignore"):
            x, y = camera.image_points(t).T
            seen += (t[:, 2] > 0.1) & (x > 0) & (x < camera.width) & (y > 0) & (y < camera.height)
    found = np.flatnonzero((seen >= 2) & (sigmoid(truth.opacity_logits) > MIN_OPACITY))
    found = rng.choice(found, min(POINTS, len(found)), replace=False)

    eye = cameras[len(cameras) // 2].eye
    rays = means[found] - eye
    depth = np.linalg.norm(rays, axis=1, keepdims=True)
    points = means[found] + rng.normal(scale=POINT_NOISE, size=rays.shape) * depth
    wrong = rng.uniform(size=len(found)) < OUTLIERS
    points[wrong] = eye + rays[wrong] * rng.uniform(0.3, 2.0, size=(wrong.sum(), 1))
    colours = np.clip(truth.sh[found, 0] * SH_C0 + 0.5, 0, 1)
    return points, (colours * 255 + 0.5).astype(np.uint8)
