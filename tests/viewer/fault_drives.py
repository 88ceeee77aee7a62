"""What goes wrong around a window, run by `conftest.drive` or by `test_faults` in a process of its own.

usage: fault_drives.py NAME RESULT.json OPTIONS.json [SCENE or CAPTURE ...]
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import drives
import training_drives
from drives import Hand
from training_drives import end_after, seen, steps, training_of

from splatview.edit.operations import Delete, SelectAll
from splatview.edit.operations.transform import Transform
from splatview.viewer import layout, overlays
from splatview.viewer.editing import commands, saving
from splatview.viewer.editing.session import session_of
from splatview.viewer.state import AppState


def edit_for_good(app: AppState, hand: Hand) -> None:
    """Some edit that is in no file, after one that is undone; of a selection nothing would be kept."""
    hand.on_gl_thread(lambda: commands.apply(app, SelectAll()))
    hand.on_gl_thread(lambda: commands.apply(app, Delete()))
    hand.on_gl_thread(lambda: commands.undo(app))
    hand.on_gl_thread(lambda: commands.apply(app, Transform(translation=(0.0, 0.1, 0.0))))
    hand.frames(2)


def broken_frames(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A panel fails, then a part between two frames; then a request to end."""
    hand.settle()
    kept, over = app.scene, overlays.over_picture

    def fail(_: AppState) -> None:
        from imgui_bundle import imgui

        imgui.begin_child("never ended")
        imgui.push_id("never popped")
        raise ValueError("a panel broke")

    layout.overlays.over_picture = fail  # pyright: ignore[reportPrivateImportUsage]
    hand.wait(lambda: app.problem is not None, "word of it")
    found["panel"] = app.problem
    hand.frames(20)
    layout.overlays.over_picture = over  # pyright: ignore[reportPrivateImportUsage]
    hand.ctx.item_click("//That did not work/OK")

    def fail_too() -> None:
        raise ZeroDivisionError("between two frames")

    app.note_statistics = fail_too  # pyright: ignore[reportAttributeAccessIssue]
    hand.wait(lambda: app.problem is not None, "word of that")
    found["part"] = app.problem
    hand.frames(20)
    del app.note_statistics
    hand.ctx.item_click("//That did not work/OK")
    found["told"] = sum("inside the program" in line for line in hand.said)
    found["scene_stays"] = app.scene is kept
    found["picture_mean"] = float(hand.picture()[..., :3].mean())
    edit_for_good(app, hand)
    hand.drag(30, 10)
    os.kill(os.getpid(), signal.SIGTERM)
    hand.wait(lambda: app.quitting, "the window to heed it")


def display_ends(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The X server is killed under a window with unsaved edits."""
    hand.settle()
    edit_for_good(app, hand)
    app.prefer(fly_speed=2.5)
    os.kill(options["server"], signal.SIGKILL)
    hand.wait(lambda: False, "an end")


def display_ends_in_training(
    app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]
) -> None:
    seen(hand, 10)
    os.kill(options["server"], signal.SIGKILL)
    hand.wait(lambda: False, "an end")


def closes_while_saving(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The window is closed while a file is being written."""
    hand.settle()
    export, begun = saving.export, threading.Event()

    def slowly(*arguments: Any) -> int:
        begun.set()
        time.sleep(1.0)
        return export(*arguments)

    saving.export = slowly  # pyright: ignore[reportPrivateImportUsage]
    hand.on_gl_thread(lambda: saving.write(app, Path(options["out"])))
    hand.wait(begun.is_set, "the saving to begin")
    found["there"] = Path(options["out"]).exists()


def capture_goes(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The folder of photos is removed in the middle of training."""
    training = training_of(app)
    seen(hand, 5)
    shutil.rmtree(options["capture"])
    steps(hand, 30)
    training.thread.evaluate()
    hand.wait(lambda: training.status.evaluation is not None, "the scores")
    found["scores"] = len(training.scores)
    hand.strip("Compare")
    hand.wait(lambda: training.comparer.latest is not None, "the comparison")
    end_after(training, 20)
    hand.wait(lambda: training.status.state == "done", "the end")
    hand.wait(lambda: training.status.saved_at is not None and not training.status.activity, "saving")
    found["failure"] = training.status.failure


def edits_until_killed(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Beside another window on the same scene: edits, and says so; ends when it is killed, or told to."""
    hand.settle()
    edit_for_good(app, hand)
    hand.press("B")
    app.prefer(fly_speed=options["speed"])
    hand.wait(lambda: app.preferences == app.preferences, "a frame")
    Path(options["ready"]).touch()
    hand.wait(Path(options["go"]).exists, "the word")
    found["export"] = None
    if options["export"]:
        hand.on_gl_thread(lambda: commands.apply(app, Delete()))
        hand.on_gl_thread(lambda: commands.undo(app))
        hand.on_gl_thread(lambda: saving.write(app, Path(options["export"])))
        hand.wait(lambda: (session := session_of(app)) is not None and session.job is None, "the export")
        hand.frames(3)
    found["said"] = hand.said
    found["position"] = session.document.history.position if (session := session_of(app)) else None


TRAINING = (display_ends_in_training, capture_goes)

if __name__ == "__main__":
    if sys.argv[1] in {function.__name__ for function in TRAINING}:
        training_drives.functions.update({function.__name__: function for function in TRAINING})
        sys.exit(training_drives.main())
    sys.exit(drives.main(globals()))
