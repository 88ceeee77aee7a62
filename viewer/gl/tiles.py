"""A second renderer for GL 4.3: splats are dealt out to tiles of the picture, and each tile blends its own.

What comes before, and every mode but the splats themselves, is what quads have. Sums are kept in float32
whatever the target's precision is to be, as a tile keeps them in registers.
"""

from __future__ import annotations

from dataclasses import replace

import moderngl

from ...scene import Camera, Gaussians, InputError, RenderSettings
from ...scene.edits import SceneEdits
from .frame import VisualMode
from .overlay import Overlay
from .programs import COMPUTE_VERSION
from .quads import QuadsRenderer
from .scene_buffers import SceneBuffers
from .tiles_gathering import TilesGathering, TileTuning
from .variants import Variants


class TilesRenderer(QuadsRenderer):
    """The `Renderer` for GL 4.3 that gathers by tiles.

    Raises:
        InputError: the context is older than GL 4.3.
    """

    name = "tiles"
    orders = ("32-bit", "16-bit", "per-pixel")

    def __init__(
        self,
        ctx: moderngl.Context,
        *,
        tuning: TileTuning | None = None,
        variants: Variants | None = None,
    ) -> None:
        if not ctx.version_code >= COMPUTE_VERSION:
            version = f"{ctx.version_code // 100}.{ctx.version_code // 10 % 10}"
            raise InputError(f"--renderer tiles needs OpenGL 4.3, this is {version}; use --renderer quads")
        variants = variants or Variants(ctx)
        self._tiles = TilesGathering(ctx, variants, tuning)
        super().__init__(ctx, gathering=self._tiles, variants=variants)

    def _use(self, scene: SceneBuffers, source: Gaussians) -> None:
        super()._use(scene, source)
        self._tiles.start_anew()

    def draw(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        mode: VisualMode = "splats",
        edits: SceneEdits | None = None,
        overlay: Overlay | None = None,
    ) -> None:
        if mode == "splats":
            self._tiles.pairs.check((camera.width, camera.height))
        settings = replace(settings, blend="float32")
        super().draw(camera, settings, mode=mode, edits=edits, overlay=overlay)
