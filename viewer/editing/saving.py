"""Saving the edited scene: over its own file, under another name, and the question before it is left."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from splatview.edit.document import export
from splatview.renderers.conversion import Conversion, convert
from splatview.scene.formats import FORMATS, format_of, losses
from splatview.scene.progress import Progress
from splatview.viewer.editing.session import Editing, EditSession, at_rest, can_edit, session_of, with_session
from splatview.viewer.editing.target import AT_REST
from splatview.viewer.loading import LoadedScene, stamp_of, stamps_of
from splatview.viewer.preferences import with_recent
from splatview.viewer.state import Feature

if TYPE_CHECKING:
    from splatview.viewer.state import AppState

Question = Literal["", "overwrite", "leave"]

HEADER_BYTES = 1 << 16
"""First bytes of a .ply in which its header is looked for."""


def nothing(app: AppState) -> None:
    """Does nothing, after a save that nothing follows."""


class Saving(Feature):
    """The questions of saving: before a file is written over, and before unsaved edits are left."""

    def __init__(self) -> None:
        self.question: Question = ""
        """Question that is open."""
        self.path: Path | None = None
        """File that would be written over."""
        self.proceed: Callable[[AppState], object] = nothing
        """What follows once the scene is saved, or given up."""
        self.agreed: Path | None = None
        """File of the open scene that the user has agreed to write over, or has saved it as."""

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self.question, self.proceed, self.agreed = "", nothing, None

    def asks_first(self, app: AppState, proceed: Callable[[AppState], object]) -> bool:
        if not has_unsaved_edits(app):
            return False
        self.question, self.proceed = "leave", proceed
        return True

    def cancel(self, app: AppState) -> bool:
        asked, self.question = self.question != "", ""
        return asked


def has_unsaved_edits(app: AppState) -> bool:
    """Whether the open scene, no trainer's, has been changed since it was last saved as it is."""
    session = session_of(app)
    return session is not None and session.target.at_rest and session.document.history.unsaved


def own_file(app: AppState) -> tuple[Path | None, str]:
    """The file that the scene can be saved over with every number kept; or None and why there is none, for
    the user."""
    session, path = session_of(app), app.scene_path
    if path is None:
        return None, "The scene is in no file yet"
    merged = session is not None and sum(not file.removed for file in session.document.files) > 1
    if len(app.scene.paths) > 1 or (merged and path != app.feature(Saving).agreed):
        return None, "The scene is of several files"
    known = format_of(path)
    if known is None or known.write is None:
        return None, f"{path.name}: files of this kind are read, but not written"
    if not known.exact or _is_packed(path):
        return None, f"{path.name}: its format rounds numbers"
    if session is not None and (lost := losses(session.document.gaussians, path)):
        return None, f"{path.name} would lose {lost[0]}"
    return path, ""


def _is_packed(path: Path) -> bool:
    """Whether a .ply is a compressed one, whatever its name ends with."""
    if path.suffix.lower() != FORMATS["ply"].suffix:
        return False
    try:
        with open(path, "rb") as file:
            return b"\nelement chunk " in file.read(HEADER_BYTES).partition(b"end_header")[0]
    except OSError:
        return False


# Commands, to be posted.


def save(app: AppState, proceed: Callable[[AppState], object] = nothing) -> None:
    """Saves the scene over its file, asking the first time; where that would lose something, asks where.
    `proceed` follows once it is saved."""
    if not _can_save(app):
        return
    saving = app.feature(Saving)
    saving.question = ""
    path, why_not = own_file(app)
    if path is None:
        app.tell(f"{why_not}: choose a file; .ply keeps everything")
        save_as(app, proceed, why=f"{why_not}; a .ply keeps everything.")
    elif not has_unsaved_edits(app):
        app.tell(f"{path.name}: nothing has been changed since it was opened or saved")
        app.post(proceed)
    elif path == saving.agreed:
        write(app, path, proceed)
    else:
        saving.question, saving.path, saving.proceed = "overwrite", path, proceed


def save_as(app: AppState, proceed: Callable[[AppState], object] = nothing, *, why: str = "") -> None:
    """Asks where the scene is to be saved; from then on that is its file. `why`: what the user is told who
    did not ask to be asked."""
    if not _can_save(app):
        return
    app.feature(Saving).question = ""
    stem = (app.scene_path.name.split(".")[0] if app.scene_path else "") or "scene"
    name = f"{stem}{FORMATS['ply'].suffix}"
    if app.scene_path is not None and (other := app.scene_path.with_name(name)) != app.scene_path:
        # Beside x.sog there is often its source x.ply, which is not to be one key press from being replaced.
        name = f"{stem}-edited{FORMATS['ply'].suffix}" if other.exists() else name
    app.choose_files(
        "Save the scene",
        lambda paths: app.post(write, paths[0], proceed),
        kind="save_scene",
        name=name,
        note=why,
    )


def overwrite(app: AppState) -> None:
    """The user agrees to write over the scene's file."""
    saving = app.feature(Saving)
    saving.question = ""
    if saving.path is not None:
        saving.agreed = saving.path
        write(app, saving.path, saving.proceed)


def save_and_leave(app: AppState) -> None:
    """The user wants the scene saved before what was asked about."""
    saving = app.feature(Saving)
    save(app, saving.proceed)


def leave_unsaved(app: AppState) -> None:
    """The user gives the unsaved edits up."""
    saving, session = app.feature(Saving), session_of(app)
    saving.question = ""
    if session is not None:
        session.document.history.mark_saved()  # or the next start would offer to restore them
    app.post(saving.proceed)


def _can_save(app: AppState) -> bool:
    """Whether there is a scene to save here; one in training is exported by its trainer."""
    if at_rest(app):
        return True
    live = app.feature(Editing).live
    if live is not None and can_edit(app):
        live.export(app)
    else:
        app.tell(AT_REST if can_edit(app) else "Open a scene first")
    return False


@with_session
def write(
    app: AppState, session: EditSession, path: Path, proceed: Callable[[AppState], object] = nothing
) -> None:
    """Writes the edited scene, whole or not at all, in a thread. Where the format keeps every number, `path`
    is the scene's file from then on and the edits count as saved."""
    target = path if path.suffix else path.with_suffix(FORMATS["ply"].suffix)
    read = session.stamps.get(Path(os.path.realpath(target)))
    if read is not None and stamp_of(target) not in (read, None):
        app.complain(
            f"{target}: another program has changed it since it was opened here; save under another name,"
            " or open it again"
        )
        return
    document = session.document
    found: list[Conversion] = []
    session.cancel_preview()

    def work(progress: Progress) -> int:
        session.before_writing(target)
        return export(
            document,
            target,
            write=lambda scene, path: found.append(convert(scene, path, progress=progress)),
        )

    def done(count: int) -> None:
        session.stamps.update(stamps_of([target]))
        session.written(target)
        session.news = f"Saved {count:,} splats to {target}: {found[0].in_words}"
        for loss in found[0].lost:
            app.tell(f"{target.name}: {loss}")
        if document.history.unsaved:
            session.news += "; the scene here keeps what the file has lost, and is unsaved"
            return
        app.feature(Saving).agreed = target
        app.scene = replace(app.scene, paths=(target,), name=target.name)
        app.preferences = with_recent(app.preferences, target)
        for feature in app.features.values():
            feature.on_scene_saved(app)
        app.post(proceed)

    session.start(f"Saving {target.name}", work, done)
