"""What is behind the scene and what is out of focus, in a real window; run by `conftest.drive`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import drives
import numpy as np
from drives import Hand

from splatview.renderers.request import FrameRequest
from splatview.scene.background import Gradient, Panorama
from splatview.scene.depth_of_field import mean_picture
from splatview.viewer import depth_of_field
from splatview.viewer import save as saving
from splatview.viewer.background import WindowBackground
from splatview.viewer.depth_of_field import DepthOfField
from splatview.viewer.navigation import orbit
from splatview.viewer.state import AppState


def behind_and_before(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Choose each kind of background, then open the lens, focus by a click, move, and save."""
    depth_of_field.SAMPLES = saving.SAVED_SAMPLES = options["samples"]
    hand.settle()
    app.prefer(smooth=False)
    backgrounds(app, hand, options, found)
    lens(app, hand, options, found)


def backgrounds(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    hand.page("View")
    hand.ctx.item_open("Background")
    hand.ctx.combo_click("##Behind/Gradient")
    hand.settle()
    gradient = app.settings.background
    found["gradient"] = isinstance(gradient, Gradient) and [gradient.top, gradient.bottom, gradient.up]
    found["up"] = app.view.up.tolist()
    found["corner"] = hand.picture()[0, 0, :3].tolist()
    hand.shoot(options.get("shot_gradient"))

    app.post(app.feature(WindowBackground).choose, Path(options["sky"]))
    hand.frames(2)
    hand.settle()
    found["panorama"] = isinstance(app.settings.background, Panorama)
    found["remembered"] = [app.preferences.background_kind, app.preferences.panorama]
    hand.shoot(options.get("shot_panorama"))
    kept = app.settings.background

    app.post(app.feature(WindowBackground).choose, Path(options["broken"]))
    hand.wait(lambda: app.problem is not None, "the refusal")
    found["problem"], app.problem = app.problem, None
    hand.frames(2)
    found["kept"] = app.settings.background is kept


def lens(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    sharp = hand.picture()
    hand.page("View")
    hand.ctx.item_close("Background")
    hand.ctx.item_close("Picture")
    hand.ctx.item_close("Camera")
    hand.ctx.item_open("Lens")
    hand.ctx.item_click("**/##Depth of field")
    lens = app.feature(DepthOfField)
    lens.share = 0.2
    hand.frames(3)
    hand.ctx.item_click("**/Focus by click")
    hand.frames(3)
    before = app.view.eye.copy()
    hand.point(0.5, 0.5)
    hand.ctx.mouse_click(0)
    hand.frames(3)
    found["focus"], found["distance"] = lens.focus, app.view.distance
    found["stayed"] = bool((app.view.eye == before).all())
    hand.wait(lambda: lens.samples >= 2, "the lens to open")
    found["badge"] = lens.badge
    hand.shoot(options.get("shot_opening"))
    hand.settle()
    found["samples"] = lens.samples
    hand.shoot(options.get("shot_lens"))
    found["error"] = float(np.abs(shown(hand, app)[..., :3] - through(hand, app)[..., :3]).max())
    found["blurred"] = float(np.abs(shown(hand, app)[..., :3] - sharp[..., :3]).max())

    drawn = app.stats.drawn
    hand.frames(10)
    found["idle"] = app.stats.drawn - drawn

    app.steer(orbit(app.view, 0.2, 0.0))
    hand.frames(1)
    found["while_moving"] = lens.samples
    hand.settle()
    found["again"] = lens.samples
    path = Path(options["saved"])
    app.post(saving.save_picture, app.camera, path)
    hand.wait(path.exists, "the saved picture")
    from PIL import Image

    saved = np.asarray(Image.open(path)) / 255
    found["saved_error"] = float(np.abs(saved - np.clip(through(hand, app)[..., :3], 0, 1)).max())

    hand.page("View")
    hand.ctx.item_click("**/##Depth of field")
    hand.frames(3)
    hand.settle()
    found["closed"] = [lens.samples, lens._mean is None, app.picture.sharp]
    hand.press("Shift+B")
    found["by_key"] = [lens.on]
    hand.press("Shift+B")
    found["by_key"].append(lens.on)


def through(hand: Hand, app: AppState) -> np.ndarray:
    """The picture through the lens, drawn by the renderer that the window has."""
    picture, aperture = app.picture, app.feature(DepthOfField).aperture(app)
    assert aperture is not None
    return hand.on_gl_thread(
        lambda: mean_picture(
            lambda camera: picture.read(FrameRequest(None, camera, app.settings, mode=app.mode)),
            app.camera,
            aperture,
            depth_of_field.SAMPLES,
        )
    )


def shown(hand: Hand, app: AppState) -> np.ndarray:
    """The mean that the window shows (H, W, 4)."""
    mean = app.feature(DepthOfField)._mean
    assert mean is not None and mean.texture is not None
    texture = mean.texture
    return hand.on_gl_thread(
        lambda: np.frombuffer(texture.read(), np.float32).reshape(*reversed(texture.size), 4).copy()
    )


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
