"""What editing needs of a renderer, done by the CPU rasteriser: the same on every machine with any GPU."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ... import raster
from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits
from ...scene.effects import settings_for


class RasterTools:
    """`edit.tools.Tools`; recipes give the same file in the window and without one because both use it."""

    def front(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        return raster.front(gaussians, camera, settings_for(gaussians), edits=edits)

    def contributions(self, gaussians: Gaussians, cameras: Sequence[Camera], edits: SceneEdits) -> np.ndarray:
        return raster.contributions(gaussians, cameras, settings_for(gaussians), edits=edits)

    def render(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        return raster.render(gaussians, camera, settings_for(gaussians), edits=edits)
