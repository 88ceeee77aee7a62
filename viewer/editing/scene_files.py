"""The rows of the Scene page: files of the open scene, the active one, and what is done to them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from splatview.edit.operations.files import LockFile, RemoveFile, SelectFile, ShowFile
from splatview.edit.state import SceneFile
from splatview.scene.edits import IDENTITY
from splatview.viewer.editing import commands
from splatview.viewer.editing.edit_session import EditSession
from splatview.viewer.editing.session import at_rest, can_edit, post_edit, session_of
from splatview.viewer.editing.target import AT_REST
from splatview.viewer.editing.transform import placed

if TYPE_CHECKING:
    from splatview.viewer.state import AppState

CHOOSE = "Choose a file first: click its row on the Scene page"

OPEN = "Open a scene first"

UNLOCK = "Unlock it first"


class Row(NamedTuple):
    """One file in the list."""

    number: int
    file: SceneFile
    splats: int
    """Without deleted ones."""
    active: bool


def rows(app: AppState) -> list[Row]:
    """The files of the open scene; one of its name where there is no session."""
    session = session_of(app)
    if session is None or not session.target.at_rest:
        name = app.scene.name or "scene"
        source = str(app.scene.paths[0]) if len(app.scene.paths) == 1 else ""
        return [Row(0, SceneFile(name=name, source=source), len(app.scene.gaussians), active=False)]
    document = session.document
    return [
        Row(number, file, count, active=number == session.forms.file)
        for number, (file, count) in enumerate(zip(document.files, document.file_counts, strict=True))
        if not file.removed
    ]


def chosen(app: AppState) -> Row | None:
    """The active row, or the only one."""
    found = rows(app)
    return next((row for row in found if row.active), found[0] if len(found) == 1 else None)


def refusal(app: AppState) -> str:
    """Why rows cannot be changed, as a sentence; "" where they can."""
    return "" if at_rest(app) else AT_REST if can_edit(app) else OPEN


def lacks(app: AppState, *, unlocked: bool = False) -> str:
    """What a command on the active row lacks, as a sentence."""
    if refusal(app):
        return refusal(app)
    row = chosen(app)
    if row is None:
        return CHOOSE
    return UNLOCK if unlocked and row.file.locked else ""


def toggle_eye(app: AppState, row: Row) -> None:
    commands.apply(app, ShowFile(file=row.number, shown=row.file.hidden))


def toggle_lock(app: AppState, row: Row) -> None:
    commands.apply(app, LockFile(file=row.number, locked=not row.file.locked))


def toggle_active(app: AppState, row: Row) -> None:
    """Makes a row the active one, or none where it is."""
    post_edit(app, EditSession.activate_file, -1 if row.active else row.number)


def select(app: AppState, row: Row) -> None:
    commands.apply(app, SelectFile(file=row.number))


def remove(app: AppState, row: Row) -> None:
    commands.apply(app, RemoveFile(file=row.number))


def reset(app: AppState, row: Row) -> None:
    """Puts a file back to where its own coordinates have it."""
    commands.apply(app, placed(row.number, IDENTITY))


def move(app: AppState, row: Row) -> None:
    """Makes a row active and takes the tool that moves it."""
    post_edit(app, EditSession.activate_file, row.number)
    session = session_of(app)
    if session is None or session.tool != "move":
        app.post(commands.take_tool, "move")


def on_chosen(command: Callable[[AppState, Row], None], *, unlocked: bool) -> Callable[[AppState], None]:
    """`command` of the active row; says what it lacks where there is none."""

    def run(app: AppState) -> None:
        row, missing = chosen(app), lacks(app, unlocked=unlocked)
        if missing or row is None:
            app.tell(missing or CHOOSE)
        else:
            command(app, row)

    return run


# fmt: off
COMMANDS = tuple(
    (id, title, on_chosen(command, unlocked=unlocked), unlocked, words)
    for id, title, command, unlocked, words in (
        ("eye", "show or hide it", toggle_eye, False, ("hide file", "show file", "eye", "visibility")),
        ("lock", "lock or unlock it", toggle_lock, False, ("lock file", "unlock file", "freeze file")),
        ("move", "move it as a whole", move, True, ("move file", "place file", "align")),
        ("reset", "reset its transform", reset, True, ("reset transform", "reset file")),
        ("select", "select its splats", select, True, ("select file",)),
        ("remove", "remove it from the scene", remove, True, ("remove file", "delete file", "unload")),
    )
)
# fmt: on
"""Id, title, function, whether it needs an unlocked file, and synonyms of each command on the active row."""
