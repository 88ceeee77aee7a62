"""The state of the window: the open scene, the view, settings, messages, and the features on top of them.

Panels draw from an `AppState` and post commands to it; the frame loop runs them between two frames, on the
GL thread. Nothing here imports ImGui, so all of it is tested without a display.
"""

from __future__ import annotations

import time
import traceback
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from splatview.renderers import FrameStats, VisualMode
from splatview.renderers.request import Highlight
from splatview.scene import Camera, RenderSettings
from splatview.scene.camera import stepped_back
from splatview.scene.edits import SceneEdits
from splatview.scene.effects.overrides import followed
from splatview.scene.errors import printable
from splatview.scene.formats.io import resident_memory
from splatview.scene.image_model import NEAR
from splatview.viewer.loading import EMPTY_SCENE, Examination, LoadedScene, Loading, Reading
from splatview.viewer.navigation import Transition, View
from splatview.viewer.navigation.view import look_from
from splatview.viewer.picture import NullPicture, Picture
from splatview.viewer.preferences import Bookmark, Preferences

F = TypeVar("F", bound="Feature")

Y_UP = np.array([0.0, 1.0, 0.0])

MESSAGES_KEPT = 200


@dataclass(frozen=True, kw_only=True)
class Message:
    """One line of the messages panel."""

    text: str
    error: bool
    at: float
    """Seconds since the epoch."""


@dataclass(kw_only=True)
class Palette:
    """The command palette: what is typed, and which line is chosen."""

    query: str = ""
    chosen: int = 0
    fresh: bool = True
    """Just opened: takes the keyboard."""


@dataclass
class Rate:
    """Pictures drawn a second."""

    seen: deque[tuple[float, int]] = field(default_factory=deque)
    """Seconds, and number of pictures drawn until then, of the last SECONDS."""

    SECONDS: ClassVar[float] = 1.0

    def at(self, now: float, drawn: int) -> float | None:
        """The rate at `now`; None where nothing is drawn."""
        seen = self.seen
        if not seen or seen[-1][1] != drawn:
            seen.append((now, drawn))
        while seen and now - seen[0][0] > self.SECONDS:
            seen.popleft()
        if len(seen) < 2 or not (span := seen[-1][0] - seen[0][0]) > 0:
            return None
        return (seen[-1][1] - seen[0][1]) / span


class Feature:
    """One subject of the window with a state of its own, such as editing or depth of field. `viewer.app`
    registers them; all methods run on the GL thread, between two frames."""

    reading: Reading[Any] | None = None
    """A file on its way, to be told of with its progress; `cancel` ends it."""

    @property
    def edits(self) -> SceneEdits | None:
        """Edits of the open scene to be drawn."""
        return None

    @property
    def highlight(self) -> Highlight | None:
        """Highlight of those edits on the picture."""
        return None

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        """Another scene is open, in the place of the one before."""

    def on_scene_saved(self, app: AppState) -> None:
        """The open scene is in its file now, as it is edited."""

    def asks_first(self, app: AppState, proceed: Callable[[AppState], object]) -> bool:
        """Whether the user is asked something before the open scene is left for another one, or the window
        closed; then `proceed` is posted once he agrees."""
        return False

    def before_frame(self, app: AppState) -> None:
        """Takes over finished work and prepares the frame that follows."""

    def busy(self, app: AppState) -> bool:
        """Whether work is under way whose result a next frame should show."""
        return False

    def cancel(self, app: AppState) -> bool:
        """Ends the latest thing that the user began; whether there was one. For the Escape key."""
        return False

    def close(self, app: AppState) -> None:
        """Ends work under way and frees GL objects; the window closes."""


@dataclass(eq=False, kw_only=True)
class AppState:
    """State that all parts of the window share; features keep their own. Fields are plain: panels set the
    simple ones, commands the rest."""

    preferences: Preferences
    picture: Picture = field(default_factory=NullPicture)
    scene: LoadedScene = EMPTY_SCENE
    """The open scene; the empty one where nothing is open."""
    loading: Loading | None = None
    """A scene on its way; the old one stays until it is there."""
    upload: Generator[float] | None = None
    """Last stage of loading, advanced a little in every frame."""
    examination: Examination | None = None
    """Effects and health of the scene."""
    examined: bool = True
    """Whether the findings have been reported."""
    stats: FrameStats = field(default_factory=FrameStats)
    """Statistics of the picture, read once a frame."""
    features: dict[type[Feature], Feature] = field(default_factory=dict)
    """In the order in which the frame loop calls them; see `viewer.app.window_state`."""

    view: View = field(default_factory=lambda: look_from(np.array([0.0, 1.0, 4.0]), np.zeros(3), Y_UP))
    transition: Transition | None = None
    settings: RenderSettings = field(default_factory=RenderSettings)
    called_for: RenderSettings = field(default_factory=RenderSettings)
    """Settings that the scene calls for as it is edited; the user may have set others."""
    mode: VisualMode = "splats"

    cameras: list[Camera] = field(default_factory=list)
    """Loaded camera list."""
    camera_index: int = -1
    through_lenses: bool = True
    """Whether the views of cameras with a lens are shown through it."""
    bookmarks: list[Bookmark] = field(default_factory=list)
    bookmark_index: int = -1
    bookmarks_read: frozenset[str] = frozenset()
    """Entries of their file, when it was last looked at."""

    picture_size: tuple[int, int] = (1, 1)
    """Px of the visible area; the rendered picture is `preferences.resolution_scale` times that."""
    rate: Rate = field(default_factory=Rate)
    frame_history: deque[dict[str, float]] = field(default_factory=lambda: deque(maxlen=120))
    """Stage times in ms of the latest drawn frames."""
    messages: deque[Message] = field(default_factory=lambda: deque(maxlen=MESSAGES_KEPT))
    undrawn: str | None = None
    """Why the picture could not be drawn in the last frame."""
    problem: str | None = None
    """An error that waits in a dialog for the user to read it."""
    dialog: str | None = None
    """Which dialog is open: "help", "screenshot", "palette", "recent", "restore" or none."""
    palette: Palette = field(default_factory=Palette)
    screenshot_size: tuple[int, int] | None = None
    """Px, as the screenshot dialog has it; None: the size that is seen."""
    gpu_name: str = ""
    process_mib: float | None = None
    """Memory of this process, MiB, where the system tells."""
    clipboard_write: str | None = None
    """Text for the system's clipboard, taken by the frame loop."""
    clipboard_read: Callable[[], str] = str
    choose_files: Callable[..., None] = lambda *args, **kwargs: None
    """Opens a file dialog; set by the window. (title, done(paths), kind)"""
    page: str = "Scene"
    """Page of the inspector that is open; "" for none."""
    strip: str = ""
    """Panel of the bottom strip that is open; "" for none."""
    panels_hidden: bool = False
    """Whether only the picture is shown."""
    reveal: str = ""
    """Title of a section of the open page that is to be opened and scrolled to, once."""
    quitting: bool = False
    now: Callable[[], float] = time.monotonic
    _failures: set[str] = field(default_factory=set)
    _frames_noted: int = 0
    _memory_due: float = 0.0
    _posted: deque[tuple[Callable[..., object], tuple[Any, ...]]] = field(default_factory=deque)

    def post(self, command: Callable[..., object], *args: Any) -> None:
        """Runs `command(app, *args)` before the next frame. May be called from any thread."""
        self._posted.append((command, args))

    @property
    def has_posted(self) -> bool:
        """Whether commands wait for the next frame."""
        return bool(self._posted)

    def run_posted(self) -> int:
        """Runs what was posted, what that posts included; returns how many commands ran.

        A command that fails is told of, with a traceback on standard error, and the window goes on: the
        user's unsaved state is worth more than a clean end.
        """
        ran = 0
        while self._posted:
            command, args = self._posted.popleft()
            try:
                command(self, *args)
            except Exception as error:
                traceback.print_exc()
                self.complain(f"That failed inside the program: {type(error).__name__}: {error}")
            ran += 1
        return ran

    def attempt(self, part: Callable[..., object], *args: Any, **options: Any) -> None:
        """Runs a part of a frame; what fails is told of, and the frame goes on."""
        try:
            part(*args, **options)
        except Exception as error:
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """Tells of a defect of ours in what is done in every frame; once, as the next frame will fail too."""
        text = f"That failed inside the program: {type(error).__name__}: {error}"
        if text not in self._failures:
            self._failures.add(text)
            traceback.print_exception(error)
            self.complain(text)

    def tell(self, text: str) -> None:
        """One line into the messages panel and the status bar."""
        self.messages.append(Message(text=printable(text), error=False, at=time.time()))

    def complain(self, text: str) -> None:
        """One line that the user must not miss: a dialog, and the messages panel."""
        self.problem = printable(text)
        self.messages.append(Message(text=self.problem, error=True, at=time.time()))

    def call_for(self, wanted: RenderSettings) -> None:
        """Has the scene call for `wanted`: settings follow, where the user has not set them otherwise."""
        self.settings = followed(self.settings, self.called_for, wanted)
        self.called_for = wanted

    def go_to(self, view: View, *, smooth: bool = True) -> None:
        """Changes the view, as a short motion where the user likes that."""
        if smooth and self.preferences.smooth:
            self.transition = Transition(start=self.view, end=view, began=self.now())
        else:
            self.transition = None
            self.view = view

    @property
    def seen_settings(self) -> RenderSettings:
        """`settings`; a near plane that the scene calls for is half-way to the target at most: what the user
        goes up to stays. One that the user has set, to look inside, stands."""
        model, most = self.settings.model, max(self.view.distance / 2, NEAR)
        if model.near != self.called_for.model.near or not model.near > most:
            return self.settings
        return replace(self.settings, model=replace(model, near=most))

    @property
    def destination(self) -> View:
        """Where the view is going: two quick key presses add up rather than cut each other off."""
        return self.transition.end if self.transition else self.view

    def steer(self, view: View) -> None:
        """The user's hand on the view: ends any motion and takes effect at once."""
        self.transition = None
        self.view = view

    def advance(self) -> None:
        """Moves a running transition on to now."""
        if self.transition:
            now = self.now()
            self.view = self.transition.at(now)
            if self.transition.done(now):
                self.transition = None

    @property
    def camera(self) -> Camera:
        """The camera of the visible area at full resolution."""
        camera = self.view.camera(*self.picture_size)
        if not camera.orthographic:
            return camera
        if not self.is_open:
            return stepped_back(camera, self.view.target, self.view.distance)
        return stepped_back(camera, self.scene.centre, self.scene.radius)

    @property
    def waiting(self) -> bool:
        """Whether something is on its way that the next frames should show."""
        return (
            self.loading is not None
            or not self.examined
            or self.picture.busy
            or any(feature.busy(self) for feature in self.features.values())
        )

    def add(self, feature: Feature) -> None:
        self.features[type(feature)] = feature

    def leave(self, proceed: Callable[[AppState], object]) -> None:
        """Does `proceed(app)`, which leaves the open scene, now or when the user has agreed."""
        if not any(feature.asks_first(self, proceed) for feature in self.features.values()):
            proceed(self)

    def feature(self, kind: type[F]) -> F:
        """The feature of class `kind`, which must have been added."""
        feature = self.features[kind]
        assert isinstance(feature, kind)
        return feature

    def find(self, kind: type[F]) -> F | None:
        """The feature of class `kind`; None where this window has none."""
        return self.feature(kind) if kind in self.features else None

    @property
    def edits(self) -> SceneEdits | None:
        """Edits of the scene that the picture holds; None where nothing is edited."""
        found = (feature.edits for feature in self.features.values())
        return next((edits for edits in found if edits is not None), None)

    @property
    def highlight(self) -> Highlight | None:
        """Marking of the edits on the picture."""
        found = (feature.highlight for feature in self.features.values())
        return next((highlight for highlight in found if highlight is not None), None)

    def note_statistics(self) -> None:
        """Remembers what the latest drawn frame cost, and once a second the process's memory."""
        stats = self.stats = self.picture.stats
        if stats.drawn != self._frames_noted and stats.ms:
            self._frames_noted = stats.drawn
            self.frame_history.append(dict(stats.ms))
        if problem := self.picture.take_problem():
            self.complain(problem)
        if self.now() >= self._memory_due:
            self._memory_due = self.now() + 1.0
            self.process_mib = process_memory()

    def prefer(self, **changes: Any) -> None:
        """Changes preferences; those that decide the picture take effect in `settings` too."""
        self.preferences = replace(self.preferences, **changes)
        if "background" in changes or "blend" in changes:
            self.settings = replace(
                self.settings, background=self.preferences.background, blend=self.preferences.blend
            )
        if "fov_y" in changes:
            self.steer(replace(self.view, lens=replace(self.view.lens, fov_y=self.preferences.fov_y)))

    @property
    def is_open(self) -> bool:
        """Whether a scene is open."""
        return self.scene is not EMPTY_SCENE

    @property
    def scene_path(self) -> Path | None:
        """The first file of the open scene, of a sequence the frame that is shown: pictures go beside it."""
        return self.scene.paths[0] if self.scene.paths else None


def process_memory() -> float | None:
    """Resident memory of this process in MiB; None where it cannot be told without more libraries."""
    resident = resident_memory()
    return None if resident is None else resident / 2**20
