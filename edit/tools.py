"""What editing needs of a renderer, handed in from above: this package knows no renderer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.edits import SceneEdits


class Tools(Protocol):
    """All see the scene as `edits` make it; indices are those of `gaussians`."""

    def dominant_splats(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        """(H, W) int32: the splat that makes the visible surface at each pixel, -1 where there is none."""
        ...

    def contributions(self, gaussians: Gaussians, cameras: Sequence[Camera], edits: SceneEdits) -> np.ndarray:
        """(N,) float64: the sum over all pixels of all `cameras` of alpha times the light that reaches it."""
        ...

    def picture(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        """(H, W, 4) float32: RGB over black, and alpha."""
        ...


class NoTools:
    """For documents that were given no renderer: whatever needs one says so.

    Raises:
        InputError: always.
    """

    def dominant_splats(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        raise InputError("selecting the front surface needs a renderer")

    def contributions(self, gaussians: Gaussians, cameras: Sequence[Camera], edits: SceneEdits) -> np.ndarray:
        raise InputError("measuring contributions needs a renderer")

    def picture(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        raise InputError("measuring pictures needs a renderer")
