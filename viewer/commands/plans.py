"""Drawing by a plan: the settings in the renderer, and the shortcuts that are taken around it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ...measure.enlarging import enlarged, reduced_size
from ...measure.knobs import Plan
from ...measure.paths import path_to_view
from ...scene import Camera, Gaussians
from ..reduced import reduced
from .renderers import HeadlessRenderer, Quads

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

    def __init__(
        self,
        renderer: HeadlessRenderer,
        gaussians: Gaussians,
        turned: Callable[[Camera, float], Camera] = lambda camera, degrees: camera,
    ):
        """`turned`: a camera so many degrees farther on its way, for pictures that depend on those before."""
        self.name = renderer.name
        self._renderer, self.scene, self._turned = renderer, gaussians, turned

    def can_draw(self, plan: Plan) -> bool:
        renderer = self._renderer
        return not isinstance(renderer, Quads) or renderer.can_draw(plan.settings, plan.attributes)

    def prepare(self, camera: Camera, plan: Plan) -> None:
        prepared(self._renderer, self.scene, plan)

    def draw(self, camera: Camera, plan: Plan) -> np.ndarray:
        path = [self._turned(camera, degrees) for degrees in path_to_view(plan.settings)]
        if len(path) > 1:
            self._renderer.forget_order()
        for each in path[:-1]:
            draw_plan(self._renderer, self.scene, each, plan)
        return draw_plan(self._renderer, self.scene, path[-1], plan)

    def follow(self, camera: Camera, plan: Plan) -> np.ndarray:
        """The picture of the next frame, sorted."""
        self._renderer.forget_order()
        return draw_plan(self._renderer, self.scene, camera, plan)

    def timed(self, camera: Camera, plan: Plan) -> float:
        """ms of a frame up to its pixels in memory: of a path, the mean."""
        begun = time.perf_counter()
        self.draw(camera, plan)
        return 1e3 * (time.perf_counter() - begun) / len(path_to_view(plan.settings))

    def memory(self, plan: Plan) -> int:
        """Bytes that the scene and the picture drawn last take in the renderer, beside the scene itself."""
        return self._renderer.memory()
