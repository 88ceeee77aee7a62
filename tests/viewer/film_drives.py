"""Films in a real window; run by `conftest.drive` like the functions of `drives`."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import drives
import numpy as np
from drives import Hand, pose
from hands_drives import shoot
from imgui_bundle import ImVec2, imgui

from splatview.viewer import save as saving
from splatview.viewer.film import Film
from splatview.viewer.save import FilmExport
from splatview.viewer.state import AppState

MENU = "//##MainMenuBar/##MenuBar"


def seen(app: AppState) -> dict[str, Any]:
    film = app.feature(Film)
    path = film.path
    return {
        "times": [round(key.time, 3) for key in path.keyframes] if path is not None else [],
        "length": path.duration if path is not None else 0.0,
        "loop": path is not None and path.loop,
        "chosen": film.chosen,
        "time": film.time,
        "playing": film.playing,
        "eye": pose(app)["eye"],
    }


def until_stopped(made: FilmExport) -> None:
    """From now on a film's second frame takes as long as nobody stops the film."""
    levels, frames = saving.levels, itertools.count()

    def held(image: np.ndarray) -> np.ndarray:
        task = made.task
        if next(frames) == 1 and task is not None:
            task._cancelled.wait(100)
        return levels(image)

    saving.levels = held


def place_on_axis(hand: Hand, seconds: float) -> ImVec2:
    """Where the axis of the panel has a time; keyframes lie at 0.62 of its height."""
    rect, em = hand.ctx.item_info("//Film/axis").rect_full, 16.0
    left, span = rect.min.x + em, rect.max.x - rect.min.x - 2 * em
    share = seconds / hand.app.feature(Film).grip.seconds
    return ImVec2(left + span * share, rect.min.y + 0.62 * (rect.max.y - rect.min.y))


def whole(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Keyframes by keys and mouse, played, stopped, changed, saved, opened, exported."""
    ctx, film, made = hand.ctx, app.feature(Film), app.feature(FilmExport)
    app.prefer(smooth=False)
    begun = app.now()
    # By frames, however long they take: else a slow window's film is over before anybody can stop it.
    app.now = lambda: begun + 0.02 * imgui.get_frame_count()
    hand.settle()
    hand.strip("Film")
    shoot(hand, "empty")
    views = []
    for drag in ((0, 0), (120, 0), (60, 50)):
        if any(drag):
            hand.drag(*drag)
        hand.press("Ctrl+K")
        views.append(pose(app)["eye"])
    hand.settle()
    found["added"] = seen(app) | {"views": views}
    shoot(hand, "keyframes")

    ctx.mouse_teleport_to_pos(place_on_axis(hand, 2.0))  # a click goes to a keyframe
    hand.frames(3)
    ctx.mouse_click(0)
    hand.frames(3)
    found["clicked"] = seen(app)
    hand.press("Ctrl+Right")
    found["next"] = seen(app)
    ctx.mouse_teleport_to_pos(place_on_axis(hand, 4.0))  # a drag moves one
    ctx.mouse_down(0)
    hand.frames(2)
    for seconds in (3.8, 3.4, 3.0):
        ctx.mouse_teleport_to_pos(place_on_axis(hand, seconds))
        hand.frames(2)
    ctx.mouse_up(0)
    hand.frames(3)
    found["dragged"] = seen(app)
    place = place_on_axis(hand, 1.0)
    ctx.mouse_teleport_to_pos(ImVec2(place.x, place.y - 20))  # beside them the playhead follows
    ctx.mouse_down(0)
    hand.frames(2)
    ctx.mouse_up(0)
    hand.frames(3)
    found["scrubbed"] = seen(app)
    shoot(hand, "scrubbed")

    hand.press("Shift+Space")
    hand.wait(lambda: film.time > 1.3, "the film to play")
    found["played"] = seen(app)
    hand.drag(30, 0)
    hand.frames(3)
    found["stopped"] = seen(app)
    hand.press("Shift+Space")
    ctx.item_click("//Film/###play_film")
    hand.frames(2)
    found["paused"] = seen(app)

    ctx.item_click("//Film/###delete_keyframe")
    hand.frames(3)
    found["deleted"] = seen(app)
    ctx.item_click("//Film/###undo_film")
    hand.frames(3)
    found["undone"] = seen(app)
    ctx.item_click("//Film/Loop")
    hand.frames(3)
    found["looped"] = seen(app)
    app.choose_files = lambda title, done, **_: done([Path(options["path"])])
    ctx.item_click("//Film/###save_camera_path")
    hand.frames(3)
    ctx.item_click("//Film/###turntable")
    hand.wait(lambda: film.time > 0.2, "the turntable")
    hand.press("Escape")
    hand.frames(2)
    found["turntable"] = seen(app)
    hand.settle()
    shoot(hand, "turntable")
    ctx.item_click("//Film/###open_camera_path")
    hand.frames(3)
    found["opened"] = seen(app)

    ctx.item_click("//Film/###export_film")
    hand.frames(3)
    shoot(hand, "dialog")
    made.choose(film, format="folder", size=(64, 48), fps=4.0)
    made.file = options["folder"]
    hand.frames(3)
    ctx.item_click("//Export the film/###begin film")
    hand.wait(lambda: made.task is None and Path(options["folder"]).is_dir(), "the film")
    hand.frames(3)
    found["frames"] = sorted(entry.name for entry in Path(options["folder"]).iterdir())
    made.choose(film, fps=60.0, size=(640, 480))
    made.file = options["stopped"]
    until_stopped(made)
    hand.frames(3)
    ctx.item_click("//Export the film/###begin film")
    hand.wait(lambda: made.task is not None and made.task.progress > 0, "the second film")
    shoot(hand, "progress")
    before = hand.ctx.item_info("//Export the film/###cancel film").id_
    ctx.item_click("//Export the film/###cancel film")
    hand.wait(lambda: made.task is None, "its end")
    hand.frames(3)
    found["ended"] = [before != 0, Path(options["stopped"]).exists(), hand.said[-1]]
    hand.press("Escape")
    found["said"] = hand.said


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
