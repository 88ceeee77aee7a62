"""The History panel: undo, redo, every step on a click; and the offer to restore unsaved edits."""

from __future__ import annotations

from functools import partial

from imgui_bundle import ImVec2, imgui

from splatview.edit.journal import AbandonedJournal
from splatview.scene.errors import bytes_in_words, printable
from splatview.viewer import theme
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.editing import commands
from splatview.viewer.editing.files import Restoring, described, restore
from splatview.viewer.editing.session import can_edit, session_of
from splatview.viewer.editing.target import NO_WAY_BACK
from splatview.viewer.panels import widgets
from splatview.viewer.preferences import RANGES
from splatview.viewer.state import AppState


def show(app: AppState) -> None:
    session = session_of(app)
    if session is None:
        widgets.note("Nothing is held: take a tool first." if can_edit(app) else "Nothing is open.")
        return
    history = session.document.history
    if not session.target.at_rest:
        widgets.note(f"Choosing can be undone while the view waits. {NO_WAY_BACK}; rules can be removed.")
    widgets.command_button(app, "Undo", "undo")
    imgui.same_line()
    widgets.command_button(app, "Redo", "redo")
    allowed = widgets.slider(
        "Memory",
        app.preferences.edit_memory_gib,
        *RANGES["edit_memory_gib"],
        "GiB that edits and undo may take before the oldest steps become final; 0 is half of the memory "
        "that is free.",
        form="%.1f GiB" if app.preferences.edit_memory_gib else "auto",
        logarithmic=True,
    )
    if allowed is not None:
        app.prefer(edit_memory_gib=allowed)
        session.document.allow(allowed * 2**30)
    number = "1 step" if len(history.steps) == 1 else f"{len(history.steps):,} steps"
    used = f"{number}, {bytes_in_words(history.nbytes)}"
    widgets.beside(used)
    imgui.text_colored(theme.QUIET, used)
    widgets.tooltip("Steps keep runs of splat numbers, not copies of the scene.")
    if session.target.at_rest:
        for number, (name, action) in enumerate(
            (
                ("Export...", "export"),
                ("Save recipe...", "save_recipe"),
                ("Apply recipe...", "replay_recipe"),
            )
        ):
            if number:
                widgets.beside(name)
            widgets.command_button(app, name, action)
    imgui.begin_child("##steps", ImVec2(0, 0), imgui.ChildFlags_.always_use_window_padding)
    steps = ["As opened", *(step.title for step in history.steps)]
    for position, title in enumerate(steps):
        waiting = position > history.position
        imgui.begin_disabled(position < history.floor)
        if waiting:
            imgui.push_style_color(imgui.Col_.text, theme.QUIET)
        clicked, _ = imgui.selectable(widgets.item(title, position), position == history.position)
        imgui.end_disabled()
        if waiting:
            imgui.pop_style_color()
        if clicked:
            app.post(partial(commands.jump, position=position))
    if session.seen_position != history.position:
        session.seen_position = history.position
        imgui.set_scroll_here_y(1.0) if history.position == len(history.steps) else None
    imgui.end_child()


def show_restore(app: AppState) -> None:
    """The offer to restore edits that an earlier window left in no file."""
    restoring = app.feature(Restoring)
    if app.dialog != "restore" or not restoring.abandoned:
        return
    centred(34)
    opened = imgui.begin("Unsaved edits", True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    widgets.note("These edits are in no file. Restoring opens the scene and does them again.")
    for journal in tuple(restoring.abandoned):
        imgui.push_id(printable(journal.file.name))
        widgets.button(
            "Restore", "Opens the scene and does its steps again.", partial(_restore, app, journal)
        )
        imgui.same_line()
        widgets.button("Discard", "Forgets these steps for good.", partial(_discard, app, journal))
        imgui.same_line()
        imgui.text_unformatted(printable(described(journal)))
        widgets.tooltip(str(journal.scene) if journal.scene else "The bundled demo scene.")
        imgui.pop_id()
    widgets.button("Later", "Asks again at the next start.", partial(_close, app))
    imgui.end()
    if not opened or not restoring.abandoned:
        app.dialog = None


def _restore(app: AppState, journal: AbandonedJournal) -> None:
    _close(app)
    app.post(partial(restore, journal=journal))


def _discard(app: AppState, journal: AbandonedJournal) -> None:
    journal.discard()
    app.feature(Restoring).abandoned.remove(journal)


def _close(app: AppState) -> None:
    app.dialog = None
