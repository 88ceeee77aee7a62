"""Where the window's edits pass: one scene's document, the tool in hand, and slow work under way.

Nothing here imports ImGui, so that all of it is tested without a display.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from splatview.edit.document import Document, Planned
from splatview.edit.impact import Impact, frozen
from splatview.edit.journal import Journal
from splatview.edit.operations.appearance import Grade, How
from splatview.edit.operations.base import Operation, Scope
from splatview.edit.selectors import Histogram
from splatview.edit.selectors.attributes import TOLERANCE
from splatview.edit.warm_up import warm_up
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.request import Highlight
from splatview.scene import Gaussians, InputError, RenderSettings
from splatview.scene.edits import PREVIEW, SceneEdits
from splatview.scene.progress import Cancelled, Progress
from splatview.scene.user_dirs import config_folder
from splatview.viewer.editing.tool_state import Depth, Measured, Place, Stroke, ToolName
from splatview.viewer.loading import Examination, Stamp

if TYPE_CHECKING:
    from splatview.viewer.loading import LoadedScene
    from splatview.viewer.state import AppState
    from splatview.viewer.training.live_edits import TrainingTarget


# ---- What is filled in on the editing panels, until it is applied.


Euler = tuple[float, float, float]
"""Degrees about x, y, z."""


@dataclass(kw_only=True)
class MoveForm:
    """Of the transform section; neutral values change nothing."""

    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World units."""
    rotation: Euler = (0.0, 0.0, 0.0)
    scale: float = 1.0
    gizmo: bool = False
    """Whether handles are shown on the picture."""
    turning: bool = False
    """Whether the handles turn rather than move."""


@dataclass(kw_only=True)
class LookForm:
    """Of the looks section."""

    opacity: float = 1.0
    """Factor, or the value."""
    size: float = 1.0
    """Likewise."""
    grade: Grade = field(default_factory=Grade)


@dataclass(kw_only=True)
class RangeForm:
    """Of selecting by a range of an attribute."""

    attribute: str = "opacity"
    values: np.ndarray | None = None
    """(N,) float32 of the attribute, and..."""
    of: object = None
    """... the attribute and the document's versions that they are of."""
    histogram: Histogram | None = None
    low: float = 0.0
    high: float = 1.0


@dataclass(kw_only=True)
class CleanForm:
    """Of the clean-up section."""

    detector: str = "clusters"
    scores: np.ndarray | None = None
    """(N,) float32, and..."""
    of: object = None
    """... the detector and the document's versions that they are of."""
    threshold: float = 0.0
    mask: np.ndarray | None = None
    """(N,) bool: what would go."""
    count: int = 0
    price: Impact | None = None
    """Of deleting `mask`; None: not measured."""
    keep: int = 0
    """Splats that decimation leaves; 0: not filled in yet."""
    kept_price: tuple[object, Impact] | None = None
    """What it is of, and the price of decimation."""


@dataclass(kw_only=True)
class HealthForm:
    """Of the health report."""

    prices: dict[str, Impact] = field(default_factory=dict)
    """Of the repair of each finding, by its name, and..."""
    of: object = None
    """... the document's versions that they are of."""


@dataclass(kw_only=True)
class Forms:
    """All of them."""

    scope: Scope = "selection"
    move: MoveForm = field(default_factory=MoveForm)
    look: LookForm = field(default_factory=LookForm)
    how: How = "scale"
    """Whether opacities and sizes are multiplied or set."""
    range: RangeForm = field(default_factory=RangeForm)
    clean: CleanForm = field(default_factory=CleanForm)
    health: HealthForm = field(default_factory=HealthForm)
    crop: int = -1
    """Which crop has the handles; -1: none."""
    crop_handles: int = 0
    """What they do, an index of `panels.crops.KINDS`, and..."""
    crop_dragged: bool = False
    """... whether they are being dragged."""
    open_section: str = ""
    """Title of the section that the Edit panel is to open, once."""
    previewing: str = ""
    """The section whose preview is in force; "" for none."""


BRUSH_RADIUS = 24.0
"""px of the picture."""


class Job:
    """Work that may take seconds, in a thread of its own: its progress, its end, its result."""

    def __init__(
        self,
        title: str,
        work: Callable[[Progress], Any],
        done: Callable[[Any], None],
        *,
        gives_way: bool = False,
    ):
        self.title = title
        self.gives_way = gives_way
        """Nobody asked for it: it is dropped where the user edits."""
        self.progress = 0.0
        self.result: Any = None
        self.error: BaseException | None = None
        self.finish = done
        """Called with the result on the GL thread."""
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(work,), name="splatview-edit", daemon=True)
        self._thread.start()

    def _run(self, work: Callable[[Progress], Any]) -> None:
        try:
            self.result = work(Progress(report=self._note, cancelled=self._cancelled.is_set))
        except BaseException as error:
            # Every end is the GL thread's to tell of.
            self.error = error

    def _note(self, share: float) -> None:
        self.progress = share

    def cancel(self) -> None:
        self._cancelled.set()

    @property
    def cancelled(self) -> bool:
        return self._cancelled.is_set()

    def join(self, timeout: float) -> None:
        self._thread.join(timeout)

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()


@dataclass(eq=False, kw_only=True)
class EditSession:
    """Edits of the open scene. Panels read it freely; what changes the document runs between frames."""

    document: Document
    highlight: Highlight = field(default_factory=Highlight)
    tool: ToolName = "none"
    depth: Depth = "through"
    """Whether screen tools take what is behind the surface too."""
    brush_radius: float = BRUSH_RADIUS
    tolerance: float = TOLERANCE
    """How much colours may differ, for the magic wand and the eyedropper; Oklab, black to white being 1."""
    forms: Forms = field(default_factory=Forms)
    preview_mask: np.ndarray | None = None
    """(N,) bool: splats that a tool would take, lit up on the picture until the next edit; never written
    to."""
    target: TrainingTarget | None = None
    """Where the scene is in training: what edits mean to the trainer."""
    journal: Journal | None = None
    stamps: dict[Path, Stamp] = field(default_factory=dict)
    """Of the files that are open, as they were read or as they were exported over since."""
    pivot: tuple[object, Place] | None = None
    """What it is of, and the middle that transforms turn about."""
    seen_position: int = -1
    """Of the history, when its panel was drawn last."""
    loading: tuple[Gaussians, Generator[float]] | None = None
    """A changed scene on its way to the picture."""
    loaded: Gaussians | None = None
    """What the picture holds; None: the document's own scene."""
    stroke: Stroke | None = None
    """What is being drawn on the picture."""
    picked: list[Place] = field(default_factory=list)
    """Points picked so far, for the tape measure or the ground."""
    measured: Measured | None = None
    """What the tape measure said last."""
    job: Job | None = None
    problem: str | None = None
    """A line for the user, taken by the window."""
    _shown: tuple[object, SceneEdits] | None = None
    _latest: SceneEdits | None = None
    _held: SceneEdits | None = None
    _previewed: np.ndarray | None = None
    _previewed_at: object = None
    news: str | None = None
    """Likewise, of less weight."""

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
        key = (versions, id(mask))
        if self._shown is None or self._shown[0] != key:
            marks = edits.marks | np.where(mask, np.uint32(PREVIEW), np.uint32(0))
            lit = replace(edits, marks=marks, changes=(), flags=edits.flags | PREVIEW)
            self._shown = (key, lit)
        return self._shown[1]

    def preview(self, section: str, operation: Operation) -> None:
        """Shows what `operation` would do, until it is committed or cancelled."""
        if (self.job is not None and not self.job.gives_way) or self._refused(operation):
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
        if self.job is not None and self.job.gives_way:
            self.job.cancel()
            self.job = None
        if self.job is not None:
            self.problem = f"{self.job.title} is still under way; wait for it or cancel it"
        return self.job is not None

    def _refused(self, operation: Operation) -> bool:
        """Says so where it cannot be done in training."""
        refusal = self.target.refusal(operation) if self.target else None
        self.news = refusal or self.news
        return refusal is not None

    def _final(self) -> bool:
        """Says so where the trainer has been told of what would be undone."""
        final = self.target.final if self.target else None
        self.news = final or self.news
        return final is not None

    def jump(self, position: int) -> None:
        """Undoes or redoes until `position` steps are in force."""
        if not self._busy() and not self._final():
            self.document.jump(position)

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
        if self.target is not None:
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
        gives_way: bool = False,
    ) -> None:
        """Runs `work(progress)` in a thread and `done(result)` between frames; one job at a time. Where it
        `edits` the document, the picture stays as it was until it has ended. One that `gives_way` is dropped
        without a word where the user edits or starts another."""
        if self._busy():
            return
        if edits:
            self._held = frozen(self.edits)
        self.job = Job(title, work, done, gives_way=gives_way)

    def advance(self) -> None:
        """Called every frame: ends a job that is done."""
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
            self.journal.close(keep=self.document.history.modified)


# ---- A scene whose values or number of splats an edit has changed: picture, census and panels follow.
#
# Marks, colours and crops need none of this; they are drawn over the scene that the picture holds.


LOAD_SECONDS = 0.012
"""Of each frame, for giving the picture the changed scene."""


def load_changed_scene(app: AppState, session: EditSession) -> None:
    """Gives the picture a scene whose values or number of splats an edit has changed, some at each frame."""
    wanted = session.document.gaussians
    if session.loaded is None:
        session.loaded = wanted
    if session.job is not None or app.loading is not None or app.picture is None:
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
        take_over(app, wanted)
    except InputError as error:
        session.loading = None
        session.problem = f"{error}; the last step is taken back"
        session.undo()


def take_over(app: AppState, gaussians: Gaussians) -> None:
    """The picture holds these splats of the open scene now: so does whatever else looks at them."""
    if app.scene is not None:
        app.scene = replace(app.scene, gaussians=gaussians)
        # One at a time: of many steps undone in a row only the last state is looked through.
        app.examining = app.examining or Examination(gaussians)


def continue_examining(app: AppState) -> None:
    """Called every frame: takes over what has been found out about changed splats. Settings follow what they
    call for, where the user has not set them otherwise."""
    found = app.examining
    if found is None or not found.done:
        return
    app.examining = None
    scene = app.scene
    if scene is None or scene.gaussians is not found.gaussians:
        if scene is not None and app.session is not None and app.session.loaded is scene.gaussians:
            app.examining = Examination(scene.gaussians)
        return
    app.examination = found
    if found.settings is not None:
        app.settings = followed(app.settings, scene.settings, found.settings)
        app.scene = replace(scene, settings=found.settings)


def followed(settings: RenderSettings, before: RenderSettings, after: RenderSettings) -> RenderSettings:
    """`settings` with what was as a scene called for `before` as it calls for `after`."""
    near = settings.model.near
    if settings.model == replace(before.model, near=near):
        settings = replace(settings, model=replace(after.model, near=near))
    if settings.sh_degree == before.sh_degree:
        settings = replace(settings, sh_degree=after.sh_degree)
    if settings.early_stop == before.early_stop:
        settings = replace(settings, early_stop=after.early_stop)
    return settings


# ---- A desk for each scene that is opened, and what of it the frame loop does.


JOURNALS = "journals"
"""Folder beside the settings: steps of windows that run, and of those that did not end well."""


@cache
def compile_ahead() -> None:
    """Once, in a thread: what the first edits need is there before the first click."""
    threading.Thread(target=warm_up, name="splatview-warm-up", daemon=True).start()


def take_up(app: AppState, scene: LoadedScene) -> None:
    """Puts `scene`, just opened, on a desk of its own; edits of the one before end with it."""
    compile_ahead()
    if app.session is not None:
        app.session.close()
    folder = scene.paths[0].parent if scene.paths else None
    try:
        document = Document(scene.gaussians, name=scene.name, folder=folder, tools=CpuRenderer())
    except InputError as error:
        app.session = None
        app.tell(f"{error}; it can be looked at")
        return
    app.session = EditSession(document=document, stamps=dict(scene.stamps))
    app.session.journal = Journal(
        document, config_folder() / JOURNALS, scene=scene.paths[0] if len(scene.paths) == 1 else None
    )


def continue_editing(app: AppState) -> None:
    """Called every frame: ends jobs, tells what they and the user's edits came to."""
    continue_examining(app)
    session = app.session
    if session is None:
        return
    session.advance()
    load_changed_scene(app, session)
    if session.journal is not None and session.journal.problem is not None:
        app.tell(session.journal.problem)
        session.journal.close(keep=True)
        session.journal = None
    if session.problem is not None:
        app.complain(session.problem)
        session.problem = None
    if session.news is not None:
        app.tell(session.news)
        session.news = None


LEAVING_SECONDS = 60.0
"""For so long a window that closes waits for a file that is being written; other work is given up at once."""


def put_away(app: AppState) -> str | None:
    """The window closes: a line for the user where edits are in no file."""
    session, app.session = app.session, None
    if session is None:
        return None
    if session.job is not None:
        session.job.cancel()
        session.job.join(LEAVING_SECONDS)
    offered = app.scene is not None and len(app.scene.paths) == 1
    kept = offered and session.journal is not None and session.document.history.modified
    session.close()
    return "the edits are in no file yet; the next start offers to restore them" if kept else None
