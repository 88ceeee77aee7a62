"""The Export dialog by mouse: formats, Measure, Write; run by `conftest.drive` like the functions of
`drives`."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import drives
from drives import Hand
from editing_drives import counts, settle
from imgui_bundle import imgui

from splatview.renderers import conversion
from splatview.scene.progress import Progress
from splatview.viewer.camera import shown_sample
from splatview.viewer.editing import exporting as export_module
from splatview.viewer.editing.exporting import SCOPES, WRITTEN, Exporting, title_of
from splatview.viewer.editing.session import session_of
from splatview.viewer.panels.export import GOAL_NAMES
from splatview.viewer.state import AppState

SHOTS = os.environ.get("SPLATVIEW_SHOTS")
"""Folder for pictures of the window, to be looked at."""

DIALOG = "//Export the scene"


def shoot(hand: Hand, name: str) -> None:
    hand.frames(4)
    hand.shoot(f"{SHOTS}/{name}.png" if SHOTS else None)


def until_cancelled(*arguments: Any, progress: Progress, **options: Any) -> conversion.Measured:
    """A search that begins when it is cancelled: as slow as the user is."""
    limit = time.monotonic() + 100
    while progress.cancelled is not None and not progress.cancelled() and time.monotonic() < limit:
        time.sleep(0.001)
    return conversion.measure(*arguments, progress=progress, **options)


def exports(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Menu, format, Measure, Write; a target, a setting changed in between, a cancelled search, a folder."""
    settle(hand)
    folder = Path(options["folder"])
    session = session_of(app)
    exporting = app.feature(Exporting)
    assert session is not None

    def is_enabled(name: str) -> bool:
        hand.frames(3)
        return not hand.ctx.item_info(f"{DIALOG}/{name}").item_flags & imgui.ItemFlags_.disabled

    def choose(row: str, index: int) -> None:
        formats = [title_of(name) for name in WRITTEN]
        rows = {"Format": formats, "Splats": SCOPES, "Target": GOAL_NAMES}
        hand.ctx.set_ref(DIALOG)
        hand.ctx.combo_click(f"##{row}/{rows[row][index]}")
        hand.frames(3)

    def measure() -> None:
        hand.ctx.item_click(f"{DIALOG}/Measure")
        hand.frames(2)
        hand.wait(lambda: session.job is None, "the measurement")
        hand.frames(3)

    def write_to(path: Path) -> None:
        hand.ctx.item_input_value(f"{DIALOG}/##path", str(path))
        hand.frames(3)
        hand.ctx.item_click(f"{DIALOG}/Write")
        hand.frames(2)
        hand.wait(lambda: session.job is None and app.dialog is None, "the file")
        hand.frames(3)

    hand.ctx.set_ref("##MainMenuBar")
    hand.ctx.menu_click("File/Export the edited scene...")
    hand.frames(4)
    found["opened"] = app.dialog
    found["first"] = [exporting.path, exporting.measured is None]
    shoot(hand, "export-opened")
    choose("Format", 3)
    found["format"] = [exporting.settings.format, Path(exporting.path).name]
    measure()
    found["measured"] = [exporting.measured is not None, sorted(os.listdir(folder))]
    assert exporting.measured is not None
    found["said"] = [exporting.measured.found.bytes, exporting.measured.found.psnr]
    shoot(hand, "export-measured")
    write_to(folder / "plain.spz")
    found["plain"] = (folder / "plain.spz").stat().st_size
    found["closed"] = app.dialog

    hand.press("Ctrl+E")
    choose("Target", 1)
    hand.frames(2)
    found["stale"] = exporting.is_current(session)
    search = export_module.measure
    export_module.measure = until_cancelled
    hand.ctx.item_click(f"{DIALOG}/Measure")
    hand.frames(3)
    shoot(hand, "export-searching")
    found["searching"] = session.job is not None
    hand.ctx.item_click(f"{DIALOG}/Cancel")
    hand.wait(lambda: session.job is None, "the end of the search")
    export_module.measure = search
    hand.frames(3)
    found["cancelled"] = [exporting.measured is None, hand.said[-1]]
    measure()
    shoot(hand, "export-target")
    assert exporting.measured is not None
    found["target"] = [exporting.measured.found.bytes, exporting.measured.found.psnr]
    write_to(folder / "small.spz")
    found["small"] = (folder / "small.spz").stat().st_size

    hand.press("Ctrl+E")
    choose("Target", 0)
    choose("Splats", 2)
    hand.ctx.item_click(f"{DIALOG}/Write")
    hand.frames(2)
    hand.wait(lambda: session.job is None, "the measurement")
    hand.frames(3)
    found["none_selected"] = [app.problem, app.dialog]
    app.problem = None
    hand.frames(3)
    hand.press("Escape")
    hand.frames(2)
    hand.press("Ctrl+A")
    settle(hand)
    hand.press("Ctrl+E")
    choose("Format", 5)
    found["selected"] = counts(app)["selected"]
    hand.ctx.item_input_value(f"{DIALOG}/##path", str(folder / "foreign" / "meta.json"))
    hand.frames(4)
    found["foreign"] = is_enabled("Write")
    shoot(hand, "export-refused")
    write_to(folder / "sogs" / "meta.json")  # measured first, as that was not done
    found["folder"] = sorted(os.listdir(folder / "sogs"))
    turn_over(app, hand, found)


def turn_over(app: AppState, hand: Hand, found: dict[str, Any]) -> None:
    """Upside down by the menu, and back by undo; the step is one of recipes."""

    def middle() -> list[float]:
        settle(hand)
        sample = shown_sample(app)
        assert sample is not None
        return sample.means.mean(axis=0).tolist()

    session = session_of(app)
    assert session is not None
    found["upright"] = middle()
    hand.ctx.set_ref("##MainMenuBar")
    hand.ctx.menu_click("Edit/Turn over")
    hand.frames(3)
    found["turned"] = middle()
    found["step"] = session.document.history.done[-1].operation.to_json()
    shoot(hand, "turned-over")
    hand.press("Ctrl+Z")
    found["undone"] = middle()


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
