"""The background of the window: a colour, a gradient or a panorama, upright as the view is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from splatview.scene import InputError
from splatview.scene.background import Background, Gradient, Panorama
from splatview.scene.formats.panorama import load_panorama
from splatview.viewer.state import Feature

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


class WindowBackground(Feature):
    """The background by preferences and view; keeps the panorama, which is read once."""

    def __init__(self) -> None:
        self._panorama: Panorama | None = None
        self._failed = ""

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
        try:
            self._panorama = load_panorama(Path(path))
        except InputError as error:
            self._failed = path
            app.complain(str(error))
            return None
        return self._panorama

    def choose(self, app: AppState, path: Path) -> None:
        """Takes the picture at `path`, read anew; where it cannot be read, all stays as it is."""
        try:
            self._panorama = load_panorama(path.absolute())
        except InputError as error:
            app.complain(str(error))
            return
        self._failed = ""
        app.prefer(background_kind="panorama", panorama=str(path.absolute()))
        height, width = self._panorama.pixels.shape[:2]
        app.tell(f"Background: {path} ({width}x{height})")


def ask_for_picture(app: AppState) -> None:
    app.choose_files(
        "Open an equirectangular picture",
        lambda paths: app.post(app.feature(WindowBackground).choose, paths[0]),
        kind="picture",
    )
