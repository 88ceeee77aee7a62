"""Editing without its panels: the session of the open scene, with its document, tool and slow work.

Nothing here imports ImGui, so that all of it is tested without a display.
"""

from __future__ import annotations

import operator
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from splatview.edit.document import Document, Planned
from splatview.edit.impact import frozen
from splatview.edit.journal import Journal
from splatview.edit.operations.base import Operation, Scope
from splatview.edit.selectors.attributes import TOLERANCE
from splatview.edit.warm_up import warm_up
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.request import Highlight
from splatview.scene import Gaussians, InputError, RenderSettings
from splatview.scene.edits import PREVIEW, Adjustment, Crop, SceneEdits, is_graded
from splatview.scene.effects.overrides import settings_for
from splatview.scene.progress import Cancelled, Progress
from splatview.scene.user_dirs import config_folder
from splatview.viewer.editing.job import Job, Yields
from splatview.viewer.editing.target import EditTarget, SceneTarget
from splatview.viewer.editing.tool_state import (
    CROPPING,
    TRANSFORMING,
    Depth,
    Forms,
    Measured,
    Mode,
    Place,
    Stroke,
    ToolName,
)
from splatview.viewer.loading import Examination, LoadedScene, Stamp
from splatview.viewer.state import Feature
from splatview.viewer.tasks import Task

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


LOOK = "look"
"""Section whose previews change opacity, size and colour."""

TRANSFORM = "Transform"
"""Section and handles that move, rotate and scale."""

BRUSH_RADIUS = 24.0
"""px of the picture."""


@dataclass(eq=False, kw_only=True)
class EditSession:
    """Edits of the open scene. Panels read it freely; what changes the document runs between frames."""

    document: Document
    tool: ToolName = "none"
    mode: Mode = "set"
    """How the tools that select combine with the selection, where no key is held."""
    depth: Depth = "through"
    """Whether screen tools take what is behind the surface too."""
    brush_radius: float = BRUSH_RADIUS
    tolerance: float = TOLERANCE
    """How much colours may differ, for the magic wand and the eyedropper; Oklab, black to white being 1."""
    forms: Forms = field(default_factory=Forms)
    preview_mask: np.ndarray | None = None
    """(N,) bool: splats that a tool would take, highlighted until the next edit; never written to."""
    preview_of: str = ""
    """Title of the section that the highlight belongs to and is seen with; "" where it is always seen."""
    target: EditTarget = field(default_factory=SceneTarget)
    journal: Journal | None = None
    stamps: dict[Path, Stamp] = field(default_factory=dict)
    """Stamps of the open files, as they were read or last exported over."""
    pivot: tuple[object, Place] | None = None
    """Centre of transforms, after the scope and versions that it is of."""
    told_floor: int = 0
    """Steps that the user knows to be past undoing."""
    seen_position: int = -1
    """Position in the history when its panel was drawn last."""
    loading: tuple[Gaussians, Generator[float]] | None = None
    """Changed scene on its way to the picture, and the steps left."""
    loaded: Gaussians | None = None
    """Splats that the picture holds; None before the first frame."""
    stroke: Stroke | None = None
    """Stroke being drawn on the picture."""
    picked: list[Place] = field(default_factory=list)
    """Points picked so far, for the tape measure or the ground."""
    measured: Measured | None = None
    """Last distance of the tape measure."""
    job: Job | None = None
    problem: str | None = None
    """Error for the user, in one line, taken by the window."""
    _shown: tuple[object, SceneEdits] | None = None
    _latest: SceneEdits | None = None
    _held: SceneEdits | None = None
    _previewed: np.ndarray | None = None
    _previewed_at: object = None
    news: str | None = None
    """Message for the user, in one line, taken by the window."""
    given_up: str | None = None
    """The same of a job that was dropped."""

    @property
    def gaussians(self) -> Gaussians:
        return self.document.gaussians

    @property
    def edits(self) -> SceneEdits:
        """Those of the document, and the highlight: what the picture is drawn with."""
        if self._held is not None:
            return self._held
        if (
            self.loaded is not None
            and self.loaded is not self.document.gaussians
            and self._latest is not None
        ):
            # The picture still holds the scene of before: it is shown as it was until the new one is there.
            return self._latest
        self._latest = edits = self.document.edits
        mask = self.preview_mask
        versions = self.document.versions
        if mask is not None and self._previewed is not mask:
            self._previewed, self._previewed_at = mask, versions
        if mask is None or self._previewed_at != versions:
            self.preview_mask = self._previewed = None
            return edits
        if self.preview_of and self.preview_of not in self.forms.sections:
            return edits
        key = (versions, id(mask))
        if self._shown is None or self._shown[0] != key:
            marks = edits.marks | np.where(mask, np.uint32(PREVIEW), np.uint32(0))
            lit = replace(edits, marks=marks, changes=(), flags=edits.flags | PREVIEW)
            self._shown = (key, lit)
        return self._shown[1]

    @property
    def highlight(self) -> Highlight:
        """Tints of the picture: none of the selection while its look is changed, which they would hide."""
        tinted = Highlight()
        return replace(tinted, selected=(0, 0, 0, 0)) if self.forms.previewing == LOOK else tinted

    @property
    def handles(self) -> str:
        """Handles on the picture: "Transform", "Crop", or "" where there are none."""
        forms = self.forms
        if self.tool in TRANSFORMING:
            return TRANSFORM if self.target.at_rest else ""
        chosen = 0 <= forms.crop < len(self.document.crops)
        in_hand = self.tool in CROPPING or "Crop" in forms.sections
        return "Crop" if chosen and in_hand else ""

    @property
    def scope(self) -> Scope:
        """Splats that a transform or a change of colours is of: all where none is selected."""
        return self.forms.scope if self.document.counts.selected else "scene"

    def preview(self, section: str, operation: Operation) -> None:
        """Shows what `operation` would do, until it is committed or cancelled."""
        if (self.job is not None and self.job.yields == "no") or self._refused(operation):
            return
        self._busy()
        try:
            self.document.preview(operation)
            self.forms.previewing = section
        except InputError as error:
            self.forms.previewing = ""
            self.problem = str(error)

    def commit_preview(self) -> None:
        change = self.document.commit_preview()
        self.forms.previewing = ""
        if change is not None:
            self.news = change.title

    def cancel_preview(self) -> None:
        self.document.cancel_preview()
        self.forms.previewing = ""

    def _busy(self) -> bool:
        """Says so where a job is under way: nothing may change beneath it, unless it gives way."""
        if self.job is not None and self.job.yields != "no":
            if self.job.yields == "with a word":
                self.given_up = f"{self.job.title} was given up for what followed"
            self.job.cancel()
            self.job = None
        if self.job is not None:
            self.problem = f"{self.job.title} is still under way; wait for it or cancel it"
        return self.job is not None

    def _refused(self, operation: Operation) -> bool:
        """Says so where it cannot be done in training."""
        refusal = self.target.refusal(operation)
        self.news = refusal or self.news
        return refusal is not None

    def _final(self) -> bool:
        """Says so where the trainer has been told of what would be undone."""
        final = self.target.final
        self.news = final or self.news
        return final is not None

    def jump(self, position: int) -> None:
        """Undoes or redoes until `position` steps are in force."""
        if self._busy() or self._final():
            return
        try:
            self.document.jump(position)
        except InputError as error:
            self.problem = str(error)

    def apply(self, operation: Operation | Planned) -> bool:
        """Does it now; returns whether something came of it. What is wrong becomes `problem`."""
        if self._busy() or self._refused(
            operation.operation if isinstance(operation, Planned) else operation
        ):
            return False
        try:
            change = self.document.apply(operation)
        except InputError as error:
            self.problem = str(error)
            return False
        self.news = change.title
        self.target.edited(self.document)
        return True

    def apply_slowly(
        self, operation: Operation, title: str, *, then: Callable[[], object] = lambda: None
    ) -> None:
        """Plans it in a thread, with progress, and applies it between two frames when that is done; `then`
        is called if something came of it."""
        if self._refused(operation):
            return

        def done(planned: Planned) -> None:
            if self.apply(planned):
                then()

        self.start(title, lambda progress: self.document.plan(operation, progress=progress), done)

    def start(
        self,
        title: str,
        work: Callable[[Progress], Any],
        done: Callable[[Any], None],
        *,
        edits: bool = False,
        yields: Yields = "no",
    ) -> None:
        """Runs `work(progress)` in a thread and `done(result)` between frames; one job at a time. Where it
        `edits` the document, the picture stays as it was until it has ended. One that `yields` is dropped
        where the user edits or starts another."""
        if self._busy():
            return
        if edits:
            self._held = frozen(self.edits)
        self.job = Job(title, work, done, yields=yields)

    def advance(self) -> None:
        """Called every frame: ends a job that is done, forgets a preview that undo or a step has ended, and
        tells of steps that are past undoing now."""
        if self.document.previewed is None:
            self.forms.previewing = ""
        history = self.document.history
        if history.floor > self.told_floor:
            self.told_floor = history.floor
            forgotten = f"undo has used up its memory: the oldest steps ({history.floor:,}) are final now"
            self.news = "; ".join(filter(None, (self.news, forgotten)))
        job = self.job
        if job is None or not job.done:
            return
        self.job, self._held = None, None
        if isinstance(job.error, Cancelled) or job.cancelled:
            self.news = f"{job.title}: cancelled, nothing was changed"
        elif isinstance(job.error, InputError):
            self.problem = str(job.error)
        elif job.error is not None:
            self.problem = f"{job.title} failed inside the program: {type(job.error).__name__}: {job.error}"
        else:
            job.finish(job.result)

    def take_tool(self, tool: ToolName) -> None:
        self.tool = tool
        self.stroke = None
        self.picked.clear()

    def undo(self) -> None:
        if self._busy() or self._final():
            return
        step = self.document.undo()
        self.news = f"Undone: {step.title}" if step else "Nothing to undo"

    def redo(self) -> None:
        if self._busy() or self._final():
            return
        step = self.document.redo()
        self.news = f"Redone: {step.title}" if step else "Nothing to redo"

    def close(self) -> None:
        """Ends what is under way. Edits that are in no file stay in the journal, for the next start."""
        if self.job is not None:
            self.job.cancel()
        if self.journal is not None:
            self.journal.close(keep=self.document.history.unsaved)


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
                folder=folder,
                tools=CpuRenderer(),
                budget=app.preferences.edit_memory_gib * 2**30,
            )
        except InputError as error:
            self.session = None
            app.tell(f"{error}; it can be looked at")
            return
        self.session = EditSession(document=document, stamps=dict(scene.stamps))
        self.session.journal = Journal(
            document, config_folder() / JOURNALS, scene=scene.paths[0] if len(scene.paths) == 1 else None
        )

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
        """Cancels the job, else puts back the tool, else releases the frozen snapshot."""
        session = self.session
        if session is None:
            return False
        if session.job is not None:
            session.job.cancel()
        elif session.tool != "none":
            session.take_tool("none")
        elif self.live is not None and not session.target.at_rest:
            self.live.release(app)
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
        offered = len(app.scene.paths) == 1
        kept = offered and session.journal is not None and session.document.history.unsaved
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
    """Compiles the kernels of the first edits in a thread, once for each process."""
    Task(lambda _: warm_up(), name="splatview-warm-up")
