"""The background of the window: a colour, a gradient or a panorama, upright as the view is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from splatview.scene.background import Background, Gradient, Panorama
from splatview.scene.formats.panorama import load_panorama
from splatview.viewer.loading import Reading
from splatview.viewer.state import Feature

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


class WindowBackground(Feature):
    """The background by preferences and view; keeps the panorama, which is read once."""

    def __init__(self) -> None:
        self.reading: Reading[Panorama] | None = None
        self._panorama: Panorama | None = None
        self._path, self._failed = "", ""
        """Of the latest picture that was read, and of one that the preferences name and that cannot be."""
        self._chosen = False
        """Whether the user has just chosen it."""

    def follow(self, app: AppState) -> None:
        """Brings the settings' background up to date with preferences and the up axis; costs nothing where
        they have not changed. A picture that cannot be read is told of once, and a colour takes its place."""
        if app.preferences.background_kind == "colour" and isinstance(app.settings.background, tuple):
            return  # which a training may have chosen
        background = self._background(app)
        if background != app.settings.background:
            app.settings = replace(app.settings, background=background)

    def _background(self, app: AppState) -> Background:
        preferences = app.preferences
        x, y, z = (float(part) for part in np.round(app.view.up, 6))
        if preferences.background_kind == "gradient":
            return Gradient(top=preferences.sky, bottom=preferences.ground, up=(x, y, z))
        if preferences.background_kind == "panorama":
            panorama = self._loaded(app, preferences.panorama)
            if panorama is not None:
                if panorama.up != (x, y, z):
                    self._panorama = panorama = replace(panorama, up=(x, y, z))
                return panorama
        return preferences.background

    def _loaded(self, app: AppState, path: str) -> Panorama | None:
        if self._panorama is not None and self._panorama.name == path:
            return self._panorama
        if not path or path == self._failed:
            return None
        if self.reading is None:
            self._read(Path(path), chosen=False)
        return None

    def choose(self, app: AppState, path: Path) -> None:
        """Takes the picture at `path` once it has been read anew; where it cannot be, all stays as it is."""
        self._read(path.absolute(), chosen=True)

    def _read(self, path: Path, *, chosen: bool) -> None:
        if self.reading is not None:
            self.reading.cancel()
        self._path, self._chosen = str(path), chosen
        self.reading = Reading(path.name, lambda _: load_panorama(path))
        self.reading.progress = -1.0  # decoders do not tell

    def before_frame(self, app: AppState) -> None:
        """Takes over a picture that has been read."""
        reading = self.reading
        if reading is None or not reading.done:
            return
        self.reading = None
        if reading.problem is not None:
            self._failed = self._failed if self._chosen else self._path
            app.complain(reading.problem)
        if reading.result is None:
            return
        self._panorama, self._failed = reading.result, ""
        if self._chosen:
            app.prefer(background_kind="panorama", panorama=self._path)
            height, width = reading.result.pixels.shape[:2]
            app.tell(f"Background: {self._path} ({width}x{height})")

    def busy(self, app: AppState) -> bool:
        return self.reading is not None

    def cancel(self, app: AppState) -> bool:
        reading, self.reading = self.reading, None
        if reading is None:
            return False
        self._failed = self._failed if self._chosen else self._path
        reading.cancel()
        return True


def ask_for_picture(app: AppState) -> None:
    app.choose_files(
        "Open an equirectangular picture",
        lambda paths: app.post(app.feature(WindowBackground).choose, paths[0]),
        kind="picture",
    )
