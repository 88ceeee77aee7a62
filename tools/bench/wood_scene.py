"""A wood from above for the bench: photos of a drone that flies to and fro over trees, in a calm or in wind.

Wind moves each tree as a whole and each leaf on its own between one photo and the next, so that no scene
meets what photos show of the leaves: only of the ground, and of how bright a tree is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatview.raster import render
from splatview.scene import Camera, Gaussians
from splatview.scene.camera import look_at
from splatview.scene.sh import SH_C0

TREES, LEAVES, GROUND = 220, 350, 25_000
"""Trees, splats of each, and splats of the ground."""

WIDTH, DEPTH = 9.0, 6.0
"""Of the wood, world units; a tree's radius is 0.2 to 0.5."""

HEIGHT = 4.2
"""Of the drone above the ground, world units: most places are in four of its photos or more."""

STRIPS, PHOTOS_OF_A_STRIP = 3, 6

FOV_Y = 45.0


def wood(rng: np.random.Generator) -> Gaussians:
    """Trees over a ground at z = 0, upwards being -z; the splats of the trees come first, tree by tree."""
    low = np.array([-WIDTH / 2, -DEPTH / 2, -1.2])
    trees = rng.uniform(low, (WIDTH / 2, DEPTH / 2, -0.5), (TREES, 3))
    outward = rng.normal(size=(TREES, LEAVES, 3))
    outward /= np.linalg.norm(outward, axis=2, keepdims=True)
    outward[..., 2] = -np.abs(outward[..., 2])
    radii = rng.uniform(0.2, 0.5, (TREES, 1, 1)) * rng.uniform(0.75, 1.05, (TREES, LEAVES, 1))
    leaves = (trees[:, None] + radii * outward).reshape(-1, 3)
    green = np.array([0.25, 0.35, 0.15]) + rng.normal(scale=0.06, size=(TREES, 1, 3))
    leaf_colours = (green * np.exp(rng.normal(scale=0.7, size=(TREES, LEAVES, 1)))).reshape(-1, 3)

    border = np.array([WIDTH / 2 + 1, DEPTH / 2 + 1])
    level = rng.normal(scale=0.02, size=(GROUND, 1))
    ground = np.concatenate([rng.uniform(-border, border, (GROUND, 2)), level], axis=1)
    earth = (0.4, 0.33, 0.25) * np.exp(rng.normal(scale=0.35, size=(GROUND, 1)))

    count = len(leaves) + GROUND
    quats = np.concatenate([rng.normal(size=(len(leaves), 4)), np.tile([1.0, 0, 0, 0], (GROUND, 1))])
    scales = np.concatenate(
        [rng.uniform(0.015, 0.04, (len(leaves), 3)), np.tile([0.04, 0.04, 0.01], (GROUND, 1))]
    )
    sh = np.zeros((count, 16, 3), np.float32)
    sh[:, 0] = (np.clip(np.concatenate([leaf_colours, earth]), 0, 1) - 0.5) / SH_C0
    return Gaussians(
        means=np.concatenate([leaves, ground]).astype(np.float32),
        quats=quats.astype(np.float32),
        log_scales=np.log(scales).astype(np.float32),
        opacity_logits=np.full(count, 3.0, np.float32),
        sh=sh,
    )


def flight(rng: np.random.Generator) -> list[Camera]:
    """Cameras that look down, in strips, as steadily as a drone."""
    cameras = []
    for strip in range(STRIPS):
        for place in range(PHOTOS_OF_A_STRIP):
            below = np.array(
                [1.15 * (place - (PHOTOS_OF_A_STRIP - 1) / 2), 1.3 * (strip - (STRIPS - 1) / 2), 0]
            )
            eye = below + np.array([0, 0, -HEIGHT]) + rng.normal(scale=0.1, size=3)
            target = below + np.array([*rng.normal(scale=0.15, size=2), 0])
            cameras.append(look_at(eye, target, up=(0, -1, 0), fov_y=FOV_Y, width=256, height=192))
    return cameras


def flown_over(wind: float) -> tuple[Gaussians, list[Camera], list[np.ndarray]]:
    """The wood at rest, cameras, and what they see, (H, W, 3) uint8 each. `wind`: standard deviation of how
    far trees, and leaves besides, are moved in each photo, world units."""
    rng = np.random.default_rng(11)
    scene, pictures = wood(rng), []
    cameras = flight(rng)
    for camera in cameras:
        sway = rng.normal(scale=wind, size=(TREES, 1, 3)) + rng.normal(scale=wind, size=(TREES, LEAVES, 3))
        means = scene.means.copy()
        means[: TREES * LEAVES] += sway.reshape(-1, 3).astype(np.float32)
        drawn = np.clip(render(replace(scene, means=means), camera)[..., :3], 0, 1)
        pictures.append((drawn * 255 + 0.5).astype(np.uint8))
    return scene, cameras, pictures
