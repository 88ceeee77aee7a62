"""Depth of field in the window: while the view rests, pictures from all over the lens are averaged.

While anything moves, and wherever it is off, the picture is that of one pinhole and costs what it always did.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import moderngl

from splatview.renderers.edit_snapshot import EditSnapshot, edit_snapshot
from splatview.renderers.gl.resolve import PictureMean
from splatview.scene import Camera, InputError, RenderSettings
from splatview.scene.depth_of_field import Aperture, camera_at, check_camera
from splatview.viewer.navigation import View, pick
from splatview.viewer.state import Feature

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


SAMPLES = 256
"""Pictures that are averaged: some 67 dB, see `scene.aperture`."""

SAVED_SAMPLES = 64
"""Pictures that a saved one is the mean of, while the user waits: some 53 dB."""

REST_SECONDS = 0.2
"""For so long nothing must have changed before the lens opens."""

USUAL_APERTURE = 0.05
"""Usual diameter of the lens, in distances in focus: what is twice as far is blurred by a fortieth of the
focal length."""


@dataclass(eq=False)
class DepthOfField(Feature):
    """The lens of the window: while the view rests, pictures from all over it are averaged."""

    on: bool = False
    share: float = USUAL_APERTURE
    """The lens's diameter over the distance to the point that the view turns about."""
    focus: float | None = None
    """Depth of the plane that is sharp, world units; None: that of the point that the view turns about."""
    picking: bool = False
    """The next click on the picture chooses what is in focus."""
    samples: int = 0
    """Pictures in the mean that is shown; 0: it is that of a pinhole."""

    def __post_init__(self) -> None:
        self._mean: PictureMean | None = None
        self._key: tuple | None = None
        self._edits: EditSnapshot | None = None
        self._since = 0.0
        self._open = False

    def aperture(self, app: AppState, view: View | None = None) -> Aperture | None:
        """The lens in force, in this view or the one that is seen; None: a pinhole."""
        if not self.on or app.mode != "splats" or not app.is_open:
            return None
        distance = (view or app.view).distance
        return Aperture(diameter=self.share * distance, focus=self.focus or distance)

    def next_camera(self, app: AppState, camera: Camera, settings: RenderSettings) -> Camera:
        """Camera of the next frame, in the place of `camera`."""
        aperture = self.aperture(app)
        if aperture is None or not is_pinhole(camera):
            self.close(app)
            return camera
        self._edits = edit_snapshot(app.edits, app.highlight, self._edits)
        gaussians = app.scene.gaussians
        kept = self._key
        same = kept is not None and camera.same_view(kept[0])
        key = (kept[0] if same and kept else camera, settings, aperture, gaussians, self._edits)
        if kept is None or not _equal(key, kept):
            self._key, self._since, self.samples = key, app.now(), 0
        # A picture of the pinhole is there first; it is also the lens's middle.
        self._open = app.now() - self._since >= REST_SECONDS and (self.samples > 0 or not app.picture.busy)
        app.picture.sharp = self._open
        return camera_at(camera, aperture, min(self.samples, SAMPLES - 1)) if self._open else camera

    def shown(self, app: AppState) -> moderngl.Texture | None:
        """The mean with the picture just drawn in it, if that is finished; None: show the picture itself."""
        if not self._open:
            return None
        if self.samples < SAMPLES and not app.picture.busy:
            if self._mean is None:
                self._mean = PictureMean(app.picture.texture.ctx)
            if self.samples == 0:
                self._mean.start()
            self._mean.add(app.picture.texture)
            self.samples = self._mean.count
        return self._mean.texture if self._mean is not None and self.samples else None

    def busy(self, app: AppState) -> bool:
        return self._key is not None and self.aperture(app) is not None and self.samples < SAMPLES

    def cancel(self, app: AppState) -> bool:
        was_picking, self.picking = self.picking, False
        return was_picking

    @property
    def badge(self) -> str:
        """How far the picture has come, or ""."""
        return f"lens: {self.samples} of {SAMPLES} pictures" if 0 < self.samples < SAMPLES else ""

    def close(self, app: AppState) -> None:
        """Gives back what the mean takes; pictures of a camera that moves may be coarse again."""
        app.picture.sharp = False
        self._key, self._edits, self.samples, self._open = None, None, 0, False
        if self._mean is not None:
            self._mean.release()
            self._mean = None


def _equal(one: tuple, other: tuple) -> bool:
    return (
        one[1:3] == other[1:3]
        and all(a is b for a, b in zip(one[3:], other[3:], strict=True))
        and (one[0] is other[0])
    )


def is_pinhole(camera: Camera) -> bool:
    """Whether a lens can be put before it."""
    try:
        check_camera(camera)
    except InputError:
        return False
    return True


def focus_on(app: AppState, x: float, y: float) -> None:
    """Makes the surface at (x, y) px of the visible area sharp."""
    lens = app.feature(DepthOfField)
    lens.picking = False
    if not app.is_open:
        return
    found = pick(app.scene.gaussians, app.camera, app.seen_settings, x, y, edits=app.edits)
    if found is None:
        app.tell("Nothing to focus on there: the pixel shows the background")
        return
    lens.focus, lens.on = found.depth, True
    app.tell(f"In focus: splat {found.index:,}, {found.depth:.4g} units ahead")


def switch(app: AppState) -> None:
    lens = app.feature(DepthOfField)
    lens.on = not lens.on
    app.tell(f"Depth of field {'on' if lens.on else 'off'}")


def focus_by_click(app: AppState) -> None:
    """Waits for the click."""
    lens = app.feature(DepthOfField)
    lens.picking = lens.on = True
