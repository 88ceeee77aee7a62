"""The files of the Scene page in a real window; run by `conftest.drive` like the functions of `drives`."""

from __future__ import annotations

import os
import sys
from typing import Any

import drives
import numpy as np
from drives import Hand
from editing_drives import drag_handle, settle

from splatview.scene.edits import SELECTED
from splatview.viewer import dialogs as file_dialogs
from splatview.viewer.editing.edit_session import EditSession
from splatview.viewer.editing.exporting import scene_of
from splatview.viewer.editing.session import session_of
from splatview.viewer.state import AppState

SHOTS = os.environ.get("SPLATVIEW_SHOTS")
"""Folder for pictures of the window, to be looked at."""


def shoot(hand: Hand, name: str) -> None:
    hand.shoot(f"{SHOTS}/{name}.png" if SHOTS else None)


def click(hand: Hand, item: str) -> None:
    """An item of the list of files, on the Scene page."""
    hand.page("Scene")
    hand.ctx.item_click(f"files/{item}")
    settle(hand)


def row(hand: Hand, session: EditSession, number: int) -> None:
    """Makes a row active."""
    hand.page("Scene")
    if session.forms.file != number:
        hand.ctx.item_click(f"files/rows/$${number}/###row")
    settle(hand)


def difference(before: np.ndarray, after: np.ndarray) -> float:
    return float(np.abs(before - after).max())


def scene_page(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """One part after another: what a part finds is under its name."""
    file_dialogs.has_native_dialogs = lambda: False
    settle(hand)
    app.prefer(smooth=False)
    session = session_of(app)
    assert session is not None
    document = session.document
    alone = hand.picture_of_edits()
    found["software"] = hand.is_software()

    hand.press("Ctrl+M")
    hand.frames(4)
    hand.ctx.key_chars_replace_enter(options["second"])
    hand.wait(lambda: len(document.files) == 2, "the import")
    settle(hand)
    found["imported"] = {
        "files": [file.name for file in document.files],
        "counts": list(document.file_counts),
        "active": session.forms.file,
        "subject": session.subject,
        "paths": len(app.scene.paths),
    }
    hand.press("Ctrl+Shift+A")
    settle(hand)
    both = hand.picture_of_edits()
    hand.page("Scene")
    hand.frames(5)
    shoot(hand, "files")

    for part in (eye, lock, numbers, handles, names, removal, saving):
        part(app, session, hand, found.setdefault(part.__name__, {}))
        while document.history.position > 2:
            hand.press("Ctrl+Z")
            settle(hand)
        found[part.__name__]["back"] = difference(hand.picture_of_edits(), both)
    while document.history.can_undo:
        hand.press("Ctrl+Z")
        settle(hand)
    found["undone"] = [len(document.files), difference(hand.picture_of_edits(), alone)]
    found["alone"] = difference(both, alone)


def eye(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Hides a file, shows it."""
    both = hand.picture_of_edits()
    click(hand, "rows/$$1/###eye")
    hidden = hand.picture_of_edits()
    found["hidden"] = [session.document.counts.hidden, difference(hidden, both)]
    found["visible"] = len(scene_of(session.document, "visible"))
    found["everything"] = len(scene_of(session.document, "everything"))
    hand.frames(5)
    shoot(hand, "eye")
    click(hand, "rows/$$1/###eye")
    found["shown"] = [session.document.counts.hidden, difference(hand.picture_of_edits(), both)]
    found["titles"] = [step.title for step in session.document.history.done[2:]]


def lock(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Locks a file: tools, selection and crops leave it alone."""
    click(hand, "rows/$$0/###lock")
    hand.press("Ctrl+A")
    settle(hand)
    own = session.document.owners
    found["selected"] = np.bincount(own[(session.document.marks & SELECTED) != 0], minlength=2).tolist()
    hand.press("Delete")
    settle(hand)
    found["left"] = list(session.document.file_counts)
    row(hand, session, 0)
    hand.press("Shift+1")
    hand.frames(3)
    found["handles"] = session.handles
    hand.frames(5)
    shoot(hand, "lock")
    hand.press("Escape")


def numbers(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Types position, rotation and scale of the active file."""
    row(hand, session, 1)
    for field, value in (("Position/$$0", 0.5), ("Rotation/$$1", 120.0)):
        hand.ctx.item_input_value(f"files/active/##{field}", value)
        settle(hand)
    hand.ctx.item_input_value("files/active/##Scale", 2.0)
    settle(hand)
    placement = session.document.files[1].placement
    found["placement"] = [list(placement.translation), list(placement.rotation), placement.scale]
    found["angles"] = list(session.forms.file_angles)
    found["titles"] = [step.title for step in session.document.history.done[2:]]
    hand.frames(3)
    shoot(hand, "numbers")
    click(hand, "active/Reset")
    found["reset"] = session.document.files[1].placement.translation


def handles(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Drags the handles of a file that is active."""
    view = app.view
    row(hand, session, 1)
    click(hand, "rows/$$0/###eye")  # or the middle of the picture is that of both
    hand.press("Home")
    hand.press("Z")  # an axis that points at the eye has no arrow
    settle(hand)
    click(hand, "active/Move")
    found["tool"], found["subject"] = session.tool, session.subject
    hand.frames(5)
    shoot(hand, "handles")
    before = session.document.gaussians
    drag_handle(hand, "mt_move_x")
    files = session.document.files
    found["moved"] = [list(file.placement.translation) for file in files]
    found["same_arrays"] = session.document.gaussians is before
    found["titles"] = [step.title for step in session.document.history.done[2:]]
    hand.on_gl_thread(lambda: app.steer(view))
    hand.press("Escape")


def names(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Renames a file and selects its splats."""
    row(hand, session, 1)
    hand.ctx.item_click("files/active/##name")
    hand.ctx.key_chars_replace_enter("chair")
    settle(hand)
    found["name"] = session.document.files[1].name
    click(hand, "active/Select")
    found["selected"] = session.document.counts.selected
    found["subject"] = session.subject


def removal(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Removes a file; the list has one row then."""
    row(hand, session, 1)
    click(hand, "active/Remove")
    found["kept"] = session.document.counts.kept
    found["active"] = session.active_file is not None
    hand.frames(3)
    shoot(hand, "removed")


def saving(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Ctrl+S of two files asks for a name: it is neither of them."""
    hand.press("Ctrl+S")
    hand.frames(4)
    found["asks"] = hand.said[-1]
    hand.press("Escape")
    hand.frames(3)


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
