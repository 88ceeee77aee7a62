"""Scenes of one or a few splats, written down value by value."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from splatview.scene import Camera, Gaussians
from splatview.scene.sh import rgb_to_sh


@pytest.fixture(scope="session")
def flat_gaussians() -> Callable[..., Gaussians]:
    """`flat_gaussians(means, scales, quats, opacity_logits, rgb)`: splats of one colour from any side."""

    def make(means, scales, quats=(1, 0, 0, 0), opacity_logits=0.0, rgb=(0.5, 0.5, 0.5)) -> Gaussians:
        means = np.atleast_2d(np.asarray(means, dtype=np.float32))
        n = len(means)
        return Gaussians(
            means=means,
            quats=np.broadcast_to(np.asarray(quats, np.float32), (n, 4)).copy(),
            log_scales=np.log(np.broadcast_to(np.asarray(scales, np.float32), (n, 3))),
            opacity_logits=np.broadcast_to(np.asarray(opacity_logits, np.float32), (n,)).copy(),
            sh=rgb_to_sh(np.broadcast_to(np.asarray(rgb, np.float32), (n, 3))[:, None]).astype(np.float32),
        )

    return make


@pytest.fixture(scope="session")
def identity_camera() -> Callable[..., Camera]:
    """`identity_camera(width, height, focal)`: at the origin, looking along +z, principal point centred."""

    def make(width: int, height: int, focal: float) -> Camera:
        return Camera(
            width=width,
            height=height,
            fx=focal,
            fy=focal,
            cx=width / 2,
            cy=height / 2,
            world_to_camera=np.eye(4),
        )

    return make
