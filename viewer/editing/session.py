"""Editing without its panels: the feature that holds the session of the open scene, and ways to it.

Nothing here imports ImGui, so that all of it is tested without a display.
"""

from __future__ import annotations

import operator
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, wraps
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from splatview.edit.document import Document
from splatview.edit.journal import Journal
from splatview.edit.warm_up import warm_up
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.edit_snapshot import tinted
from splatview.renderers.request import Highlight
from splatview.scene import Gaussians, InputError, RenderSettings
from splatview.scene.edits import SELECTED, Adjustment, Crop, SceneEdits, is_graded
from splatview.scene.effects.overrides import settings_for
from splatview.scene.user_dirs import config_folder
from splatview.viewer.editing.edit_session import EditSession
from splatview.viewer.loading import Examination, LoadedScene
from splatview.viewer.state import Feature
from splatview.viewer.tasks import Task

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


class LiveScene(Protocol):
    """A scene that changes while it is shown, in training or as a sequence: edited by way of snapshots."""

    at_rest: bool
    """Whether every edit of a snapshot can be done and kept."""

    def is_shown(self, app: AppState) -> bool:
        """Whether the window shows a snapshot of it that can be edited."""
        ...

    def freeze(self, app: AppState) -> EditSession | None:
        """A session on the shown snapshot, which stays until it is released."""
        ...

    def release(self, app: AppState) -> None:
        """Closes the session: snapshots are followed again."""
        ...

    def export(self, app: AppState) -> None:
        """Asks where the scene goes, and writes it as it is then."""
        ...


LOAD_SECONDS = 0.012
"""Share of each frame, in seconds, for giving the picture a changed scene."""


class Editing(Feature):
    """The session of the open scene; picture, health check and messages follow its edits."""

    def __init__(self) -> None:
        self.session: EditSession | None = None
        """None where nothing is open, or the scene cannot be edited."""
        self.live: LiveScene | None = None
        """Source of sessions while a training is watched."""
        self.examining: Examination | None = None
        """Examination of splats that an edit has changed, under way."""
        self.outlined: tuple[Crop, ...] = ()
        """Crops of a training's rule under the mouse, to be drawn on the picture."""
        self._followed: tuple[RenderSettings | None, tuple[Adjustment, ...]] = (None, ())
        """What the settings followed last: those of the scene, and a palette."""

    @property
    def edits(self) -> SceneEdits | None:
        return self.session.edits if self.session else None

    @property
    def highlight(self) -> Highlight | None:
        return self.session.highlight if self.session else None

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        """Opens a session of its own on `scene`; edits of the one before end with theirs."""
        warm_up_once()
        self.examining = None
        if self.session is not None:
            self.session.close()
        folder = scene.paths[0].parent if scene.paths else None
        try:
            document = Document(
                scene.gaussians,
                name=scene.name,
                files=files_of(scene),
                folder=folder,
                tools=CpuRenderer(),
                budget=app.preferences.edit_memory_gib * 2**30,
            )
        except InputError as error:
            self.session = None
            app.tell(f"{error}; it can be looked at")
            return
        self.session = EditSession(document=document, stamps=dict(scene.stamps))
        self.session.journal = Journal(document, config_folder() / JOURNALS, scenes=scene.paths)

    def leave(self) -> None:
        """Closes the session for good, its edits with it: another frame is shown."""
        session, self.session, self.examining = self.session, None, None
        if session is not None:
            if session.journal is not None:
                session.journal.close(keep=False)
                session.journal = None
            session.close()

    def before_frame(self, app: AppState) -> None:
        """Ends jobs, and reports what they and the user's edits came to."""
        self._examine(app)
        self._follow(app)
        session = self.session
        if session is None:
            return
        session.forms.sections, session.forms.drawn = frozenset(session.forms.drawn), set()
        session.advance()
        load_changed_scene(app, session)
        if session.journal is not None and session.journal.problem is not None:
            app.tell(session.journal.problem)
            session.journal.close(keep=True)
            session.journal = None
        if session.problem is not None:
            app.complain(session.problem)
            session.problem = None
        for said in filter(None, (session.given_up, session.news)):
            app.tell(said)
        session.given_up = session.news = None

    def busy(self, app: AppState) -> bool:
        session = self.session
        return self.examining is not None or (
            session is not None and (session.job is not None or session.loading is not None)
        )

    def cancel(self, app: AppState) -> bool:
        """Cancels the job, else puts back the tool, else releases the frozen snapshot. A job that nobody
        asked for comes last: the user did not begin it, and may not even see it."""
        session = self.session
        if session is None:
            return False
        job = session.job
        if job is not None and job.yields != "silently":
            job.cancel()
        elif session.tool != "none":
            session.take_tool("none")
        elif self.live is not None and not session.target.at_rest:
            self.live.release(app)
        elif job is not None:
            job.cancel()
        else:
            return False
        return True

    def close_session(self, app: AppState) -> str | None:
        """Closes the session with the window; a line for the user where edits are in no file."""
        session, self.session = self.session, None
        if session is None:
            return None
        if session.job is not None:
            session.job.cancel()
            session.job.join(LEAVING_SECONDS)
        journal = session.journal
        kept = journal is not None and session.document.history.unsaved
        session.close()
        return "the edits are in no file yet; the next start offers to restore them" if kept else None

    def take_over(self, app: AppState, gaussians: Gaussians) -> None:
        """The picture holds the edited splats now: scene and health check follow."""
        if app.is_open:
            app.scene = replace(app.scene, gaussians=gaussians)
            # One at a time: of many steps undone in a row only the last state is looked through.
            self.examining = self.examining or Examination(gaussians)

    def _examine(self, app: AppState) -> None:
        """Takes over the examination of changed splats."""
        found = self.examining
        if found is None or not found.done:
            return
        self.examining = None
        scene = app.scene
        if scene.gaussians is not found.gaussians:
            if self.session is not None and self.session.loaded is scene.gaussians:
                self.examining = Examination(scene.gaussians)
            return
        app.examination = found
        if found.settings is not None:
            app.scene = replace(scene, settings=found.settings)

    def _follow(self, app: AppState) -> None:
        """Settings follow what scene and colour grade call for, where the user has not set them otherwise;
        not before the scene has been looked through, as that takes long."""
        found, scene = app.examination, app.scene
        if found is None or found.settings is None or found.gaussians is not scene.gaussians:
            return
        palette = self.edits.palette if self.edits else ()
        looked_at = scene.settings, palette
        if all(map(operator.is_, looked_at, self._followed)):
            return
        self._followed = looked_at
        wanted = scene.settings
        if is_graded(palette):
            graded = settings_for(scene.gaussians, palette=palette)
            wanted = replace(wanted, sh_degree=graded.sh_degree, early_stop=graded.early_stop)
        app.call_for(wanted)


def files_of(scene: LoadedScene) -> Sequence[tuple[str, int]]:
    """Paths and numbers of splats of its files, for the document."""
    if len(scene.counts) == len(scene.paths) > 1:
        return [(str(path), count) for path, count in zip(scene.paths, scene.counts, strict=True)]
    path = str(scene.paths[0]) if len(scene.paths) == 1 else scene.name
    return [(path, len(scene.gaussians))]


def session_of(app: AppState) -> EditSession | None:
    """The session of the open scene, or of the frozen snapshot of a training; None where there is none."""
    return app.feature(Editing).session


def session_for_edit(app: AppState) -> EditSession | None:
    """As `session_of`, but freezes the shown snapshot of a training where nothing is frozen yet."""
    editing = app.feature(Editing)
    if editing.session is None and editing.live is not None:
        return editing.live.freeze(app)
    return editing.session


def with_session(command: Callable[..., None]) -> Callable[..., None]:
    """`command(app, session, *args)` as `command(app, *args)`, which does nothing where no session
    is open."""

    @wraps(command)
    def run(app: AppState, *args: Any, **options: Any) -> None:
        session = session_of(app)
        if session is not None:
            command(app, session, *args, **options)

    return run


def post_edit(app: AppState, method: Callable[..., object], *args: Any) -> None:
    """Posts a method of `EditSession`, for the session that is open then."""

    def run(app: AppState) -> None:
        session = session_of(app)
        if session is not None:
            method(session, *args)

    app.post(run)


def can_edit(app: AppState) -> bool:
    """Whether splats are shown that tools can choose from."""
    editing = app.feature(Editing)
    return editing.session is not None or (editing.live is not None and editing.live.is_shown(app))


def at_rest(app: AppState) -> bool:
    """Whether a scene is open that no trainer changes: every edit can be done and kept."""
    editing = app.feature(Editing)
    if editing.session is None:
        return editing.live is not None and editing.live.at_rest and editing.live.is_shown(app)
    return editing.session.target.at_rest


def load_changed_scene(app: AppState, session: EditSession) -> None:
    """Gives the picture a scene whose values or number of splats an edit has changed, a part in each frame.
    Flags, colours and crops need none of this; they are drawn over the scene that the picture holds."""
    wanted = session.document.gaussians
    if session.loaded is None:
        session.loaded = wanted
    if session.job is not None or app.loading is not None:
        return
    if session.loading is not None and session.loading[0] is not wanted:
        session.loading[1].close()
        session.loading = None
    if session.loaded is wanted:
        return
    if session.loading is None:
        session.loading = (wanted, app.picture.load_steps(wanted))
    until = time.perf_counter() + LOAD_SECONDS
    try:
        while time.perf_counter() < until:
            next(session.loading[1])
    except StopIteration:
        session.loaded, session.loading = wanted, None
        app.feature(Editing).take_over(app, wanted)
    except InputError as error:
        session.loading = None
        session.problem = f"{error}; the last step is taken back"
        session.undo()


JOURNALS = "journals"
"""Folder beside the settings: steps of windows that run, and of those that did not end well."""

LEAVING_SECONDS = 60.0
"""Longest wait of a closing window for a file that is being written; other work is given up at once."""


@cache
def warm_up_once() -> None:
    """Compiles the kernels of the first edits, and those that light up what is selected, in a thread, once
    for each process."""

    def work(_: Task[None]) -> None:
        marks = np.array([0, SELECTED], np.uint32)
        tinted(SceneEdits(marks=marks, flags=SELECTED), Highlight())
        warm_up()

    Task(work, name="splatview-warm-up")
