"""The offer to go on with edits that an earlier window left in no file."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from imgui_bundle import imgui

from ...dialogs import DIALOG_FLAGS, centred
from ...panels import widgets
from ..files import described
from ..files import restore as restore_journal

if TYPE_CHECKING:
    from .....edit.journal import AbandonedJournal
    from ...core import Core


def show(core: Core) -> None:
    if core.dialog != "restore" or not core.abandoned:
        return
    centred(34)
    opened = imgui.begin("Unsaved edits", True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    widgets.note("These edits were never exported. Restoring opens the scene and does them again.")
    for journal in tuple(core.abandoned):
        imgui.push_id(str(journal.file))
        widgets.button(
            "Restore", "Opens the scene and does its steps again.", partial(_restore, core, journal)
        )
        imgui.same_line()
        widgets.button("Discard", "Forgets these steps for good.", partial(_discard, core, journal))
        imgui.same_line()
        imgui.text_unformatted(described(journal))
        widgets.tooltip(str(journal.scene))
        imgui.pop_id()
    widgets.button("Later", "Asks again at the next start.", partial(_close, core))
    imgui.end()
    if not opened or not core.abandoned:
        core.dialog = None


def _restore(core: Core, journal: AbandonedJournal) -> None:
    _close(core)
    core.post(partial(restore_journal, journal=journal))


def _discard(core: Core, journal: AbandonedJournal) -> None:
    journal.discard()
    core.abandoned.remove(journal)


def _close(core: Core) -> None:
    core.dialog = None
