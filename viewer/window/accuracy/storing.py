"""The open scene loaded anew as a shortcut stores it, while the window goes on. No ImGui in here."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator

from ....scene import Gaussians
from ....scene.stored import Attributes, stored
from ..picture import Picture

UPLOAD_SECONDS = 0.004
"""Of a frame."""


class Storing:
    """Begins when made; the picture shows the form it had until the last step."""

    def __init__(self, picture: Picture, gaussians: Gaussians, attributes: Attributes):
        self.gaussians = gaussians
        self.attributes: Attributes = attributes
        self._picture = picture
        self._form: list[Gaussians] = []
        self._steps: Generator[float] | None = None
        self._thread = threading.Thread(target=self._round, name="splatview-storing", daemon=True)
        self._thread.start()

    def _round(self) -> None:
        self._form.append(stored(self.gaussians, self.attributes))

    def advance(self) -> bool:
        """Some milliseconds of it; whether all is done. For the GL thread.

        Raises:
            InputError: the picture's renderer cannot have the scene so.
        """
        if self._thread.is_alive():
            return False
        if self._steps is None:
            self._steps = self._picture.load_steps(self._form[0], self.attributes)
        until = time.perf_counter() + UPLOAD_SECONDS
        return all(time.perf_counter() <= until for _ in self._steps)

    def end(self) -> None:
        """Gives it up; what was shown stays."""
        self._thread.join()
        if self._steps is not None:
            self._steps.close()
