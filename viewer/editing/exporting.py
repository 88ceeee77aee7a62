"""What the Export dialog asks for: a format and what it may cost, measured before anything is written.

The file that is measured waits in a folder of its own; writing copies that one, byte for byte.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from splatview.edit.document import Document, exported
from splatview.renderers.conversion import Measured, measure
from splatview.renderers.rate_distortion import Target
from splatview.scene import Gaussians, InputError
from splatview.scene.edits import DELETED, SELECTED, bake
from splatview.scene.formats import FORMATS, Format, check_saving, format_of
from splatview.scene.progress import Progress
from splatview.viewer.editing.files import changed_elsewhere, check_at_rest
from splatview.viewer.editing.session import Editing, EditSession, at_rest, can_edit, session_of, with_session
from splatview.viewer.loading import LoadedScene, stamps_of
from splatview.viewer.state import Feature

if TYPE_CHECKING:
    from splatview.viewer.state import AppState

Scope = Literal["everything", "visible", "selected"]
SCOPES: tuple[Scope, ...] = get_args(Scope)

Goal = Literal["none", "quality", "size"]
GOALS: tuple[Goal, ...] = get_args(Goal)

DIALOG = "export"


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """What the file shall hold."""

    format: str = "ply"
    """Name in `FORMATS`."""
    scope: Scope = "everything"
    """Hidden splats go along with everything; deleted and cropped ones never do."""
    sh_degree: int = 3
    """Highest that is kept."""
    goal: Goal = "none"
    psnr: float = 40.0
    """dB, where the goal is a quality."""
    megabytes: float = 5.0
    """Where it is a size."""

    @property
    def known(self) -> Format:
        return FORMATS[self.format]

    @property
    def target(self) -> Target | None:
        if self.goal == "quality":
            return Target(psnr=self.psnr)
        return Target(bytes=round(self.megabytes * 1e6)) if self.goal == "size" else None


WRITTEN = tuple(name for name, known in FORMATS.items() if known.write is not None)
"""Names of the formats that can be chosen."""


def title_of(name: str) -> str:
    """A format as lists show it."""
    suffix = FORMATS[name].suffix
    return {"sog folder": "folder of .sog", "streamed": "streamed SOG (folder, levels of detail)"}.get(
        name, suffix
    )


def contents_of(known: Format) -> str:
    """What a format holds, in a line."""
    held = ["every number as float32" if known.exact else "numbers in fewer bits"]
    held[0] = "every number" if known.doubles else held[0]
    held += ["SH up to degree 3" if known.sh else "one colour from everywhere, no SH"]
    tags = [name for name, has in (("antialiased", known.antialiased), ("disc", known.discs)) if has]
    held += [f"the {' and '.join(tags)} tag{'s' * (len(tags) > 1)}"] if tags else []
    held += ["comments"] if known.comments else []
    held += ["other properties"] if known.extras else []
    return ", ".join(held)


class Exporting(Feature):
    """The dialog's settings, and the file that was measured for them."""

    def __init__(self) -> None:
        self.settings = ExportSettings()
        self.path = ""
        """Where the file goes, as it is typed."""
        self.measured: Measured | None = None
        self._measured_for: object = None

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self.forget()
        self.path = ""

    def close(self, app: AppState) -> None:
        self.forget()

    def forget(self) -> None:
        """Removes the measured file."""
        if self.measured is not None:
            self.measured.close()
        self.measured = self._measured_for = None

    def adopt(self, session: EditSession, settings: ExportSettings, measured: Measured) -> None:
        self.forget()
        self.measured, self._measured_for = measured, _state(session, settings)

    def is_current(self, session: EditSession) -> bool:
        """Whether the measured file is what these settings and the scene as it is now ask for."""
        return self.measured is not None and self._measured_for == _state(session, self.settings)

    def choose(self, app: AppState, **changes: object) -> None:
        """Changes settings; the file's name follows the format."""
        self.settings = replace(self.settings, **changes)
        if "format" in changes:
            self.path = str(renamed(Path(self.path), self.settings.known))

    def problem(self, session: EditSession) -> str:
        """What is in the way of writing to `path`, in a line; "" where nothing is."""
        path = Path(os.path.expanduser(self.path))
        if not self.path.strip():
            return "Name the file"
        if format_of(path) is not self.settings.known:
            return f"The name must end in {self.settings.known.suffix}"
        try:
            check_saving(path)
        except InputError as error:
            return str(error)
        return changed_elsewhere(session, path)


def _state(session: EditSession, settings: ExportSettings) -> object:
    return id(session), session.document.revision, settings


def renamed(path: Path, known: Format) -> Path:
    """`path` with the suffix of a format in place of that of another."""
    old = format_of(path)
    if old is not None and old.folder:
        path = path.parent
    elif old is not None:
        path = path.with_name(path.name[: -len(old.suffix)])
    return path / known.suffix[1:] if known.folder else path.with_name(path.name + known.suffix)


def open_dialog(app: AppState) -> None:
    """Opens the dialog; a scene in training goes to a file as it is then."""
    live = app.feature(Editing).live
    if live is not None and can_edit(app) and not at_rest(app):
        live.export(app)
        return
    session = session_of(app)
    if not check_at_rest(app) or session is None:
        return
    exporting = app.feature(Exporting)
    if not exporting.path:
        folder = app.scene_path.parent if app.scene_path else Path.cwd()
        stem = app.scene_path.stem if app.scene_path else "scene"
        exporting.path = str(renamed(folder / f"{stem}-edited.ply", exporting.settings.known))
    app.dialog = DIALOG


def choose_place(app: AppState) -> None:
    """Asks for the file's name by the system's dialog."""
    exporting = app.feature(Exporting)
    known = exporting.settings.known

    def take(paths: list[Path]) -> None:
        chosen = paths[0]
        if format_of(chosen) is not known:
            chosen = (
                chosen / known.suffix[1:] if known.folder else chosen.with_name(chosen.name + known.suffix)
            )
        exporting.path = str(chosen)

    current = Path(exporting.path)
    app.choose_files(
        "Export as", take, kind="save_scene", name=current.parent.name if known.folder else current.name
    )


def scene_of(document: Document, scope: Scope) -> Gaussians:
    """The edited splats of a scope. Raises InputError where there are none."""
    if scope == "everything":
        return exported(document)
    document.cancel_preview()
    edits = document.edits
    if scope == "selected":
        marks = document.marks | DELETED * ((document.marks & SELECTED) == 0).astype(document.marks.dtype)
        edits = replace(edits, marks=marks, crops=(), flags=SELECTED | DELETED)
    scene = bake(document.gaussians, edits)
    if not len(scene):
        raise InputError(f"no splats are {scope}; there is nothing to export")
    return scene


@with_session
def measure_export(app: AppState, session: EditSession, *, write: bool = False) -> None:
    """Writes a file for trial and measures it, in a thread; with `write` it is then put to its place."""
    exporting = app.feature(Exporting)
    settings, document = exporting.settings, session.document
    document.cancel_preview()

    def work(progress: Progress) -> Measured:
        scene = scene_of(document, settings.scope)
        name = Path(settings.known.suffix[1:] if settings.known.folder else f"scene{settings.known.suffix}")
        degree = settings.sh_degree if settings.sh_degree < scene.sh_degree else None
        return measure(scene, name, sh_degree=degree, target=settings.target, progress=progress)

    def done(measured: Measured) -> None:
        exporting.adopt(session, settings, measured)
        if write:
            app.post(write_export)

    session.start("Measuring", work, done)


@with_session
def write_export(app: AppState, session: EditSession) -> None:
    """Copies the measured file to its place, in a thread, and measures it first where that was not done; the
    dialog closes when it is there."""
    exporting = app.feature(Exporting)
    measured, settings = exporting.measured, exporting.settings
    target = Path(os.path.expanduser(exporting.path))
    if exporting.problem(session):
        return
    if measured is None or not exporting.is_current(session):
        measure_export(app, write=True)
        return
    whole = settings.scope == "everything" and measured.found.psnr == math.inf

    def done(_: None) -> None:
        if Path(os.path.realpath(target)) in session.stamps:
            session.stamps.update(stamps_of([target]))
        if whole:
            session.document.history.mark_saved()
            session.written(target)
        session.news = f"Exported {measured.found.splats:,} splats to {target}: {measured.found.in_words}"
        for loss in measured.found.lost:
            app.tell(f"{target.name}: {loss}")
        exporting.forget()
        if app.dialog == DIALOG:
            app.dialog = None

    def work(progress: Progress) -> None:
        session.before_writing(target)
        measured.write(target, progress)

    session.start(f"Exporting {target.name}", work, done)
