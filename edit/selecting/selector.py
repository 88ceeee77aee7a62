"""What all ways of selecting have in common."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ...scene import Gaussians
from ...scene.edits import SceneEdits
from ..tools import Tools
from ..watch import UNWATCHED, Watch


class Selector(Protocol):
    """A frozen dataclass whose fields are numbers, texts, lists of them and cameras: a line of a recipe.

    Its constructor raises ValueError that names the field where one cannot be used.
    """

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
    ) -> np.ndarray:
        """Which splats are meant: (N,) bool, of all, whether shown, hidden or deleted.

        Raises:
            InputError: the selector does not fit the scene, or wants a renderer that there is not.
            Cancelled: the watch says so.
        """
        ...
