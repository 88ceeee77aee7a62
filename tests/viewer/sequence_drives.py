"""Sequences in a real window; run by `conftest.drive` like the functions of `drives`."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import drives
from drives import Hand
from hands_drives import shoot
from imgui_bundle import ImVec2

from splatview.viewer.editing.session import session_of
from splatview.viewer.palette import matching
from splatview.viewer.sequence import Player, Sequences
from splatview.viewer.state import AppState

STRIP = "**/"


def player_of(app: AppState) -> Player:
    player = app.feature(Sequences).player
    assert player is not None
    return player


def at_rest(hand: Hand) -> None:
    """Until the frame at the playhead is shown and can be edited."""
    player = player_of(hand.app)
    hand.wait(lambda: player.shown == player.head.frame, "the frame at the playhead")
    hand.wait(lambda: not hand.app.waiting, "the frame to settle")
    hand.frames(2)


def seen(app: AppState) -> dict[str, Any]:
    player = player_of(app)
    path = app.scene_path
    return {
        "frame": player.head.frame,
        "shown": player.shown,
        "file": path.name if path else "",
        "splats": len(app.scene.gaussians),
        "playing": player.head.playing,
    }


def whole(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A folder of frames, one of them damaged: opened, played, stepped, dragged, edited, left."""
    app.prefer(smooth=False)
    hand.settle()
    found["strip_before"] = app.feature(Sequences).player is not None
    tall = app.picture_size[1]
    hand.drop(options["folder"])
    hand.wait(lambda: app.feature(Sequences).player is not None, "the sequence")
    at_rest(hand)
    player = player_of(app)
    found["opened"] = seen(app) | {"said": [text for text in hand.said if "frames" in text]}
    found["picture_shrinks"] = tall - app.picture_size[1]
    hand.wait(lambda: player.cache.state(11) == "cached", "all frames")
    found["failed"] = dict(player.cache.problems)
    found["told"] = [text for text in hand.said if "skipped" in text]
    hand.drag(40, 10)
    hand.settle()
    found["view"] = drives.pose(app)
    shoot(hand, "opened")

    for key, name in (("Period", "next"), ("Period", "over"), ("Comma", "back"), ("Shift+Period", "last")):
        hand.press(key)
        at_rest(hand)
        found[name] = seen(app)
    hand.press("Period")
    at_rest(hand)
    found["round"] = seen(app)

    ctx = hand.ctx
    ctx.item_click(f"{STRIP}###play")
    hand.wait(lambda: player.head.playing, "playing")
    shown: set[int] = set()

    def enough() -> bool:
        shown.add(player.shown)
        return len(shown) >= 5 and player.reached > 0

    hand.wait(enough, "five frames")
    found["played"] = {"shown": sorted(shown), "reached": player.reached}
    found["session_while_playing"] = session_of(app) is not None
    shoot(hand, "playing")
    hand.press("Space")
    hand.frames(2)
    at_rest(hand)
    found["paused"] = seen(app)
    found["view_after"] = drives.pose(app)
    hand.press("3")
    hand.settle()
    hand.press("Period")
    at_rest(hand)
    found["mode"] = app.mode
    hand.press("1")

    rect = ctx.item_info(f"{STRIP}frames").rect_full
    middle = (rect.min.y + rect.max.y) / 2

    def over(share: float) -> ImVec2:
        return ImVec2(rect.min.x + share * (rect.max.x - rect.min.x), middle)

    ctx.mouse_teleport_to_pos(over(0.05))
    ctx.mouse_down(0)
    hand.frames(2)
    found["pressed"] = seen(app)["frame"]
    for step in range(10):
        ctx.mouse_teleport_to_pos(over(0.1 + 0.07 * step))
        hand.frames(2)
    found["dragged"] = seen(app)["frame"]
    ctx.mouse_up(0)
    at_rest(hand)
    found["released"] = seen(app)
    ctx.mouse_teleport_to_pos(over((3 + 0.5) / 12))
    hand.frames(4)
    if os.environ.get("SPLATVIEW_SHOTS"):
        hand.frames(30)
    shoot(hand, "damaged")
    ctx.mouse_down(0)
    hand.frames(2)
    ctx.mouse_up(0)
    hand.frames(3)
    found["on_damaged"] = seen(app)
    shoot(hand, "on_damaged")

    ctx.item_input_value(f"{STRIP}##rate", 12.5)
    hand.frames(3)
    found["rate"] = app.preferences.frame_rate
    beside = ctx.item_info(f"{STRIP}##rate").rect_full  # the test engine knows combos by no name
    ctx.mouse_teleport_to_pos(ImVec2(beside.max.x + 40, (beside.min.y + beside.max.y) / 2))
    ctx.mouse_click(0)
    hand.frames(3)
    popup = ctx.window_info("//##Combo_00").rect_full
    ctx.mouse_teleport_to_pos(ImVec2((popup.min.x + popup.max.x) / 2, (popup.min.y + popup.max.y) / 2))
    ctx.mouse_click(0)
    hand.frames(3)
    found["mode_chosen"] = app.preferences.play_mode
    ctx.item_input_value(f"{STRIP}##frame", 9)
    at_rest(hand)
    found["typed"] = seen(app)
    found["palette"] = {
        word: [command.id for command in matching(word)][:3]
        for word in (
            "play",
            "pause",
            "sequence",
            "timeline",
            "next frame",
            "previous frame",
            "frame rate",
            "loop",
        )
    }
    menu = "//##MainMenuBar/##MenuBar/Sequence"
    found["menu"] = ctx.item_exists(menu)

    hand.press("Ctrl+A")
    hand.settle()
    hand.press("Period")
    at_rest(hand)
    found["selection_is_left"] = seen(app)
    hand.press("Ctrl+A")
    hand.press("Delete")
    hand.settle()
    hand.press("Period")
    hand.press("Space")
    hand.frames(6)
    found["held"] = seen(app) | {"said": hand.said[-1], "steps": session_of(app) is not None}
    shoot(hand, "held")
    hand.press("Ctrl+Z")
    hand.settle()
    hand.press("Period")
    at_rest(hand)
    found["undone"] = seen(app)
    hand.press("Ctrl+A")
    hand.press("Delete")
    hand.settle()
    app.post(drives.keys.COMMANDS["discard_frame_edits"].run)
    hand.frames(3)
    at_rest(hand)
    found["discarded"] = seen(app) | {"deleted": session_of(app).document.counts.deleted}  # type: ignore

    hand.press("Space")
    hand.wait(lambda: player.head.playing, "playing again")
    hand.press("Ctrl+A")  # whatever edits pauses
    hand.wait(lambda: session_of(app) is not None, "the frame to be edited")
    hand.settle()
    session = session_of(app)
    found["edited_in_play"] = seen(app) | {"selected": session.document.counts.selected if session else -1}

    hand.drop(options["other"])
    hand.wait(lambda: app.scene.name == Path(options["other"]).name, "the other scene")
    hand.settle()
    found["closed"] = [app.feature(Sequences).player is None, app.picture_size[1] == tall]
    found["menu_after"] = ctx.item_exists(menu)
    found["recent"] = [Path(name).name for name in app.preferences.recent]


def glance(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """What a sequence given on the command line plays like: reached rate and longest frame of the window."""
    hand.settle()
    at_rest(hand)
    player = player_of(app)
    app.prefer(smooth=False, frame_rate=options.get("fps", 30.0))
    feature, costs = app.feature(Sequences), []
    before_frame = feature.before_frame

    def timed(app: AppState) -> None:
        begun = time.thread_time()
        before_frame(app)
        costs.append(time.thread_time() - begun)

    feature.before_frame = timed
    hand.press("Space")
    shown, spans = set(), []
    until, last = time.monotonic() + options["seconds"], time.monotonic()
    while time.monotonic() < until:
        hand.frames(1)
        now = time.monotonic()
        spans.append(now - last)
        last = now
        shown.add(player.shown)
    spans.sort()
    costs.sort()
    found["play"] = {
        "reached": player.reached,
        "longest": spans[-1],
        "cost_ms": [round(1e3 * costs[int(share * (len(costs) - 1))], 2) for share in (0.5, 0.95, 1.0)],
        "p95": spans[int(0.95 * len(spans))],
        "median": spans[len(spans) // 2],
        "frames": len(spans),
        "shown": len(shown),
        "decode": player.cache.seconds,
        "cached": len(player.cache),
    }
    shoot(hand, options.get("shot", "glance"))
    hand.press("Space")


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
