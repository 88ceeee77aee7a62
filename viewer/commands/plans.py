"""Drawing by a plan: the settings in the renderer, and the shortcuts that are taken around it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...measure.enlarging import enlarged, reduced_size
from ...measure.knobs import Plan
from ...scene import Camera, Gaussians
from ..reduced import reduced
from .renderers import HeadlessRenderer

if TYPE_CHECKING:
    from ..gl import VisualMode


def draw_plan(
    renderer: HeadlessRenderer, gaussians: Gaussians, camera: Camera, plan: Plan, mode: VisualMode = "splats"
) -> np.ndarray:
    """The picture (H, W, 4) float32 of `camera`'s size."""
    scene = prepared(renderer, gaussians, plan)
    size = reduced_size(camera.width, camera.height, plan.resolution)
    if size == (camera.width, camera.height):
        return renderer.draw(scene, camera, plan.settings, mode)
    small = renderer.draw(scene, camera.resized(*size), plan.settings, mode)
    return enlarged(small, camera.width, camera.height)


def prepared(renderer: HeadlessRenderer, gaussians: Gaussians, plan: Plan) -> Gaussians:
    """The scene that `plan` draws, loaded into `renderer`; nothing where that was done before."""
    scene = reduced(gaussians, plan)
    renderer.load(scene, plan.attributes)
    return scene


class SceneArtist:
    """A renderer and the scene it draws, as the ladder wants them."""

    def __init__(self, renderer: HeadlessRenderer, gaussians: Gaussians):
        self.name = renderer.name
        self._renderer, self.scene = renderer, gaussians

    def prepare(self, camera: Camera, plan: Plan) -> None:
        prepared(self._renderer, self.scene, plan)

    def draw(self, camera: Camera, plan: Plan) -> np.ndarray:
        return draw_plan(self._renderer, self.scene, camera, plan)

    def memory(self, plan: Plan) -> int:
        """Bytes that the scene and the picture drawn last take in the renderer, beside the scene itself."""
        return self._renderer.memory()
