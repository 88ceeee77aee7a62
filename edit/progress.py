"""How work that may take seconds says where it is, and learns that nobody waits for it any more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.edits import SceneEdits


class Cancelled(Exception):
    """The caller's `cancelled()` turned true; nothing was changed."""


@dataclass(frozen=True, kw_only=True)
class Watch:
    """The caller's two callbacks; both are called from the thread that works, every few milliseconds."""

    progress: Callable[[float], None] | None = None
    """Gets the share done, 0 to 1, never falling."""
    cancelled: Callable[[], bool] | None = None

    def step(self, share: float) -> None:
        """Tells that `share` of the work is done. Raises Cancelled where nobody waits for the rest."""
        if self.cancelled is not None and self.cancelled():
            raise Cancelled
        if self.progress is not None:
            self.progress(min(max(share, 0.0), 1.0))

    def part(self, start: float, stop: float) -> Watch:
        """For a piece of the work: its 0 to 1 is `start` to `stop` of the whole."""
        progress = self.progress
        if progress is None:
            return self
        return Watch(
            progress=lambda share: progress(start + share * (stop - start)), cancelled=self.cancelled
        )


UNWATCHED = Watch()
"""Nobody asks."""


# ---- What editing needs of a renderer, handed in from above: this package knows no renderer.


class Tools(Protocol):
    """All see the scene as `edits` make it; indices are those of `gaussians`."""

    def front(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
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

    def front(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        raise InputError("selecting the front surface needs a renderer")

    def contributions(self, gaussians: Gaussians, cameras: Sequence[Camera], edits: SceneEdits) -> np.ndarray:
        raise InputError("measuring contributions needs a renderer")

    def picture(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        raise InputError("measuring pictures needs a renderer")
