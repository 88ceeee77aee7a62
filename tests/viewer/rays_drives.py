"""Parallel rays and camera lenses as a person uses them, in a real window; run by `conftest.drive`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import drives
import numpy as np
from drives import Hand

from splatview.viewer.editing.session import session_of
from splatview.viewer.open import open_paths
from splatview.viewer.state import AppState


def other_rays(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Parallel rays by a key, the wheel, an axis view and a selection; then a fisheye's view, and without."""
    hand.settle()
    app.prefer(smooth=False)
    hand.frames(2)
    hand.press("Shift+P")
    hand.settle()
    found["orthographic"] = app.camera.orthographic
    before = app.camera.fx
    hand.point(0.5, 0.5)
    hand.ctx.mouse_wheel_y(2)
    hand.frames(3)
    found["scaled"] = app.camera.fx / before
    hand.press("Z")
    hand.settle()
    found["axis"] = [app.camera.orthographic, app.camera.forward.round(6).tolist()]
    hand.press("R")
    hand.drag(80, 60, over=(0.4, 0.4))
    hand.settle()
    found["selected"] = session.document.counts.selected if (session := session_of(app)) else 0
    hand.press("Escape")
    hand.shoot(options.get("shot_parallel"))
    hand.press("Shift+P")
    hand.settle()
    found["perspective"] = not app.camera.orthographic

    app.post(open_paths, [Path(options["cameras"])])
    hand.settle()
    hand.press("PageDown")
    hand.settle()
    found["through"] = app.camera.lens is not None
    bent = hand.picture()
    hand.shoot(options.get("shot_fisheye"))
    hand.press("Shift+L")
    hand.settle()
    found["without"] = app.camera.lens is None
    found["differs"] = float(np.abs(hand.picture() - bent).max())


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
