"""The questions of saving: may a file be written over, and what becomes of unsaved edits."""

from __future__ import annotations

from functools import partial

from imgui_bundle import imgui

from splatview.scene.errors import printable
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.editing import saving
from splatview.viewer.editing.saving import Saving
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState

OVERWRITE, LEAVE = "Save over the file?", "Unsaved edits"
"""Titles of the questions."""

BUTTON_EM = 7.0
"""Width of a button, in font heights."""


def show(app: AppState) -> None:
    """The question that is open, if any; nothing else takes the mouse until it is answered."""
    question = app.feature(Saving).question
    if question == "overwrite":
        _modal(OVERWRITE, partial(_overwrite, app))
    elif question == "leave":
        _modal(LEAVE, partial(_leave, app))


def _modal(title: str, contents: partial[None]) -> None:
    if not imgui.is_popup_open(title):
        imgui.open_popup(title)
    centred(30)
    if imgui.begin_popup_modal(title, None, DIALOG_FLAGS | imgui.WindowFlags_.no_resize)[0]:
        contents()
        imgui.end_popup()


def _overwrite(app: AppState) -> None:
    path = app.feature(Saving).path
    imgui.push_text_wrap_pos(0)
    imgui.text_unformatted(
        f"{printable(path.name) if path else 'The file'} will hold the scene as it is now."
    )
    imgui.pop_text_wrap_pos()
    widgets.note(
        "What was deleted is then gone from the file; here it can still be undone. This is asked once."
    )
    widgets.tooltip(str(path))
    imgui.spacing()
    width = imgui.get_font_size() * BUTTON_EM
    widgets.button("Save", "Writes over the file (Enter).", partial(app.post, saving.overwrite), width=width)
    imgui.set_item_default_focus()
    imgui.same_line()
    widgets.button("Save as...", "Leaves the file as it is.", partial(app.post, _save_elsewhere), width=width)
    imgui.same_line()
    widgets.button("Cancel", "Saves nothing (Escape).", partial(app.post, _close), width=width)
    if imgui.is_key_pressed(imgui.Key.enter, False):
        app.post(saving.overwrite)


def _leave(app: AppState) -> None:
    imgui.push_text_wrap_pos(0)
    imgui.text_unformatted(f"The edits of {printable(app.scene.name)} are in no file yet.")
    imgui.pop_text_wrap_pos()
    imgui.spacing()
    width = imgui.get_font_size() * BUTTON_EM
    widgets.button("Save", "Saves them first (Enter).", partial(app.post, saving.save_and_leave), width=width)
    imgui.set_item_default_focus()
    imgui.same_line()
    widgets.button("Don't save", "Gives them up.", partial(app.post, saving.leave_unsaved), width=width)
    imgui.same_line()
    widgets.button("Cancel", "Stays here (Escape).", partial(app.post, _close), width=width)
    if imgui.is_key_pressed(imgui.Key.enter, False):
        app.post(saving.save_and_leave)


def _save_elsewhere(app: AppState) -> None:
    asked = app.feature(Saving)
    saving.save_as(app, asked.proceed)


def _close(app: AppState) -> None:
    app.feature(Saving).question = ""
