"""Aids of the view in a window with an open scene; run by `conftest.drive` like the functions of `drives`."""

from __future__ import annotations

import sys
from typing import Any

import drives
import numpy as np
from drives import Hand
from editing_drives import settle
from hands_drives import SHOTS
from PIL import Image

from splatview.viewer.state import AppState
from splatview.viewer.view_aids import ViewAids, legend


def pixels(hand: Hand) -> np.ndarray:
    """(H, W, 3) uint8: what the window's framebuffer shows."""

    def read() -> np.ndarray:
        screen = hand.app.picture.texture.ctx.screen
        width, height = screen.size
        return np.frombuffer(screen.read(components=3), np.uint8).reshape(height, width, 3)[::-1].copy()

    hand.frames(3)
    return hand.on_gl_thread(read)


def picture(hand: Hand) -> np.ndarray:
    """The middle of the view: panels and status bar tell of frames that come and go."""
    view = hand.ctx.window_info("//View").rect_full
    low, high = (int(view.min.x), int(view.min.y)), (int(view.max.x), int(view.max.y))
    return pixels(hand)[low[1] + 110 : high[1] - 40, low[0] + 4 : high[0] - 4]


def shoot(hand: Hand, name: str) -> None:
    if SHOTS:
        Image.fromarray(pixels(hand)).save(f"{SHOTS}/{name}.png")


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of the pixels that differ visibly."""
    return float((np.abs(before.astype(int) - after).max(axis=2) > 12).mean())


def all_views(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    settle(hand)
    app.prefer(smooth=False)
    hand.point(0.5, 0.95)
    aids = app.feature(ViewAids)
    plain = picture(hand)
    for key, name in (("Shift+G", "grid"), ("Ctrl+G", "axes"), ("Shift+M", "centres"), ("Shift+R", "rings")):
        hand.press(key)
        settle(hand)
        shown = picture(hand)
        shoot(hand, f"view-{name}")
        hand.press(key)
        settle(hand)
        found[name] = [changed(plain, shown), changed(plain, picture(hand))]
    hand.press("Shift+M")
    settle(hand)
    unselected = picture(hand)
    hand.press("Ctrl+A")
    settle(hand)
    hand.frames(3)
    found["selected"] = changed(unselected, picture(hand))
    shoot(hand, "view-selected")
    hand.press("Ctrl+Shift+A")
    hand.press("Shift+M")
    settle(hand)
    found["off"] = [aids.centres, aids.rings, app.preferences.show_grid, app.preferences.show_axes]
    for key, mode in (("4", "depth"), ("5", "overdraw"), ("6", "normals"), ("1", "splats")):
        hand.press(key)
        settle(hand)
        hand.wait(lambda: not app.picture.busy, "the mode")
        shoot(hand, f"view-{mode}")
        shown = legend(app)
        found[mode] = [app.mode, None if shown is None else [shown[2], [text for _, text in shown[1]]]]
    front = app.view
    hand.drag(120, 30)
    found["moved"] = bool(np.abs(app.view.R_camera_world - front.R_camera_world).max() > 0.1)
    hand.press("Shift+Home")
    hand.settle()
    found["home"] = float(np.abs(app.view.R_camera_world - front.R_camera_world).max())
    found["ups"] = []
    for word in ("Up: +Z", "Up: -Y"):
        hand.press("Ctrl+P")
        hand.frames(4)
        hand.ctx.key_chars(word)
        hand.frames(4)
        hand.press("Enter")
        hand.settle()
        found["ups"].append(app.view.up.round(6).tolist())
    hand.press("Shift+G")
    settle(hand)
    shoot(hand, "view-end")


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
