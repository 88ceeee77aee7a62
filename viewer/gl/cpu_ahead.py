"""Kernels of the CPU rasteriser that are not compiled yet: compiled in the background, and done without."""

from __future__ import annotations

from ... import raster
from ...raster.kinds import kind_of
from ...scene import Camera, Gaussians, RenderSettings
from ...scene.edits import SceneEdits, bake
from .rehearsal import rehearsal_of
from .rehearsing import Rehearsals
from .shown_edits import ShownEdits


class CpuAhead:
    """Says what to draw so that nothing is compiled in the window's process that takes long.

    The edited scene, baked, gives the picture that edits give, by kernels that know of none. For other
    effects there is no such way: their first picture waits, as the very first picture does. Without
    `rehearsals` all is compiled when it is needed.
    """

    def __init__(self, rehearsals: Rehearsals | None) -> None:
        self._rehearsals = rehearsals
        self._baked: tuple[Gaussians, SceneEdits, Gaussians] | None = None

    def must_wait(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, shown: ShownEdits | None
    ) -> str | None:
        """Has compiled what this picture lacks. Returns what to `wait` for, if it can only be drawn then."""
        if self._rehearsals is None:
            return None
        kind = kind_of(gaussians, camera, settings, edited=shown is not None)
        if self._rehearsals.is_done([kind]):
            return None
        pinhole = camera.lens is None and not camera.orthographic and settings.model.footprint != "disc"
        if shown is None and pinhole and not raster.will_compile():
            return None  # compiled with all the others
        self._rehearsals.ask(
            [kind],
            title_of(camera, settings, shown),
            lambda: rehearsal_of(
                "cpu",
                gaussians,
                camera,
                settings,
                edits=None if shown is None else shown.source,
                overlay=None if shown is None else shown.overlay,
            ),
        )
        return kind if shown is None or not pinhole or raster.will_compile() else None

    def wait(self, kind: str) -> bool:
        """False where nothing is to be drawn any more."""
        return self._rehearsals is None or self._rehearsals.wait([kind])

    def what_to_draw(
        self, gaussians: Gaussians, camera: Camera, settings: RenderSettings, shown: ShownEdits | None
    ) -> tuple[Gaussians, SceneEdits | None]:
        """The scene and the edits to draw it by."""
        if shown is None:
            return gaussians, None
        if self._rehearsals is None or self._rehearsals.is_done(
            [kind_of(gaussians, camera, settings, edited=True)]
        ):
            self._baked = None
            return gaussians, shown.drawn
        if self._baked is None or self._baked[0] is not gaussians or self._baked[1] is not shown.drawn:
            self._baked = gaussians, shown.drawn, bake(gaussians, shown.drawn)
        return self._baked[2], None

    @property
    def title(self) -> str:
        """What is being compiled, or ""."""
        return "" if self._rehearsals is None else self._rehearsals.title


def title_of(camera: Camera, settings: RenderSettings, shown: ShownEdits | None) -> str:
    effects = {
        "edits": shown is not None,
        "a lens": camera.lens is not None,
        "parallel rays": camera.orthographic,
        "discs": settings.model.footprint == "disc",
    }
    return ", ".join(name for name, on in effects.items() if on) or "the CPU renderer"
