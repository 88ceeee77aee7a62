"""Watching a training: its snapshots, its share of the cores, and its photos. No ImGui in here."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from splatview.renderers.async_renderer import FRAME_SECONDS
from splatview.scene import Camera, InputError, RenderSettings
from splatview.scene.framing import robust_bounds
from splatview.trainer.background import BackgroundTraining, Snapshot, State, Status, pace_of
from splatview.trainer.memory import MemoryPlan
from splatview.trainer.views import TrainView
from splatview.viewer.camera import common_up, go_to_camera
from splatview.viewer.editing.session import Editing
from splatview.viewer.loading import EMPTY_SCENE, Examination, LoadedScene
from splatview.viewer.navigation import view_from_camera
from splatview.viewer.open import UPLOAD_SECONDS
from splatview.viewer.preferences import TrainingUpdates
from splatview.viewer.state import AppState, Feature
from splatview.viewer.training.comparison import Comparer, Pictures
from splatview.viewer.training.live_edits import TrainingEdits


@dataclass(frozen=True)
class UpdateRate:
    """Cost that new pictures of the scene may have."""

    seconds: float
    """Least seconds between snapshots."""
    share: float
    """Share of all cores that drawing them may take where the processor draws."""
    fps: float
    """Frames per second of the window itself while nobody touches it."""


RATES: dict[TrainingUpdates, UpdateRate] = {
    "off": UpdateRate(math.inf, 0.0, 1.0),
    "low": UpdateRate(2.0, 0.02, 2.0),
    "live": UpdateRate(0.1, 0.05, 10.0),
}

SOFTWARE_FPS = 1.0
"""At most so many frames where the processor draws those, too; a new picture is shown at once besides."""

FRAMES_A_PICTURE = 2
"""Where the processor draws them: one takes the snapshot over, one shows the picture made of it."""

TOUCHED_SECONDS = 1.5
"""After the view was last moved: so long the viewer keeps the cores that the slider leaves it."""

STARVED_SECONDS = 1.0
"""While the view is moved, a snapshot waits so long for a moment in which nothing is being drawn."""

MINIMISED_FPS = 0.5

LEAST_FOR_VIEWER = 0.1
"""Share of the cores even where training has been given all: a view that can be turned, if slowly."""

MOST_FOR_BOUNDS = 20_000
"""Splats that tell where the scene is: enough for that, and done within a millisecond or two."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WatchedPhoto:
    """One row of the list of photos."""

    shot: TrainView
    held_out: bool
    label: str
    """Its name, without folders where that is enough to tell it from the others."""

    @property
    def camera(self) -> Camera:
        return self.shot.camera

    @property
    def name(self) -> str:
        return self.camera.name


@dataclass(eq=False, kw_only=True)
class LiveTraining(Feature):
    """A training that the window watches. Fields are plain: panels set the simple ones."""

    thread: BackgroundTraining
    name: str
    """Name of the capture."""
    photos: list[WatchedPhoto]
    """All photos, sorted by name."""
    settings: RenderSettings
    """Settings that the scene is trained for."""
    memory: MemoryPlan | None = None
    """What the run takes, where that was stated."""
    minimised: bool = False
    """Whether the window is minimised, so that nothing is shown."""
    photo_index: int = 0
    """Index of the compared one of `photos`."""
    gain: float = 4.0
    """Factor by which differences are brightened."""
    by_seconds: bool = False
    """Whether curves are over seconds rather than steps."""
    shown: Snapshot | None = None
    """Snapshot that the view shows."""
    app: AppState | None = None
    """State of the window, once there is one."""
    cameras: list[Camera] = field(init=False)
    """Cameras of the photos, for the window's list."""
    editor: TrainingEdits = field(init=False)
    comparer: Comparer = field(default_factory=Comparer)
    pictures: Pictures = field(default_factory=Pictures)
    _scene: LoadedScene = EMPTY_SCENE
    _arriving: tuple[Snapshot, Generator[float]] | None = None
    _last_view: object = None
    _touched: float = -1e9
    _shown_at: float = -1e9
    _reported: State = "training"
    _camera_index: int = -1

    def __post_init__(self) -> None:
        self.cameras = [photo.camera for photo in self.photos]
        self.editor = TrainingEdits(self.thread, lambda app: self.shown if self.followed_by(app) else None)

    @property
    def status(self) -> Status:
        return self.thread.status

    @property
    def photo(self) -> WatchedPhoto:
        return self.photos[self.photo_index]

    def idle_fps(self, app: AppState) -> float:
        """Frames a second for a window that nobody touches."""
        if self.minimised:
            return MINIMISED_FPS
        runs = self.status.state == "training"
        fps = RATES[app.preferences.training_updates if runs else "low"].fps
        return min(fps, SOFTWARE_FPS) if app.picture.name == "cpu" else fps

    def followed_by(self, app: AppState) -> bool:
        """Whether the window shows this training, and not something that was opened since."""
        return app.scene is self._scene

    @property
    def scores(self) -> dict[str, float]:
        """Held-out PSNR in dB by the photo's name, of the latest evaluation."""
        evaluation = self.status.evaluation
        return {} if evaluation is None else {score.name: score.psnr for score in evaluation.scores}

    def score_text(self) -> str:
        """PSNR of the compared photo: that of the list where it was held out, else that of the pictures."""
        if self.photo.name in self.scores:
            return f"{self.scores[self.photo.name]:.2f} dB at step {self.status.evaluated_at:,}"
        comparison = self.comparer.latest
        if comparison is None or comparison.request.shot is not self.photo.shot:
            return ""
        height, width = comparison.photo.shape[:2]
        return f"{comparison.psnr:.2f} dB at {width} x {height}"

    def start(self, app: AppState, *, on_change: Callable[[], object] = lambda: None) -> None:
        """The window is there: shows the first snapshot and begins. `on_change` wakes the window."""
        self.app = app
        app.feature(Editing).live = self.editor
        self.comparer = Comparer(on_change)
        self.thread.on_change = on_change
        app.called_for = self.settings
        app.settings = replace(self.settings, blend=app.preferences.blend)
        app.cameras = self.cameras
        self.thread.begin()

    def close(self, app: AppState) -> None:
        """Stops watching; the thread is left to whoever made it."""
        self.thread.on_change = lambda: None
        self.comparer.close()
        self.pictures.release()
        self._drop_arriving()

    def before_frame(self, app: AppState) -> None:
        for note in self.thread.take_notes():
            app.tell(note)
        if app.cameras is self.cameras and app.camera_index != self._camera_index:
            # However the user came to a photo's camera, that photo is compared.
            self._camera_index = app.camera_index
            self.photo_index = max(app.camera_index, 0)
        self._report(app)
        self._keep_shares(app)
        self._take_snapshot(app)

    def follow(self, app: AppState) -> None:
        """Shows this training again after something else was opened."""
        app.scene = self._scene
        app.cameras, app.camera_index = self.cameras, -1
        app.called_for = self.settings
        app.settings = replace(self.settings, blend=app.preferences.blend)
        self.shown = None
        # The picture holds something else, so even an unchanged scene is to be handed over.
        self.thread.show_now(again=True)

    def _report(self, app: AppState) -> None:
        """Says once what the thread's new state means."""
        status = self.status
        if status.state == self._reported:
            return
        self._reported = status.state
        if status.state == "failed":
            app.complain(f"Training has stopped: {status.failure}. The scene is kept as it was.")
        elif status.state == "done":
            app.tell(f"Training is done: {status.gaussians:,} splats after {status.iteration:,} steps")

    def _keep_shares(self, app: AppState) -> None:
        now = app.now()
        if app.view is not self._last_view:
            self._last_view, self._touched = app.view, now
        moved = now - self._touched < TOUCHED_SECONDS
        wanted, cores = app.preferences.training_share, self.thread.cores
        self.thread.share = wanted if moved or not app.preferences.training_takes_idle_cores else 1.0
        runs = self.status.state == "training"
        app.picture.threads = viewer_threads(wanted, cores) if runs else None
        app.picture.cores = max(1 - wanted, LEAST_FOR_VIEWER) * cores if runs else None
        rate = RATES["off" if self.minimised else app.preferences.training_updates]
        if rate.share > 0:
            cost = redraw_seconds(app) / (rate.share * cores)
            self.thread.snapshot_seconds = max(rate.seconds, cost)
        else:
            self.thread.snapshot_seconds = None

    def _take_snapshot(self, app: AppState) -> None:
        """Takes the latest snapshot over, for a few milliseconds of uploading."""
        if app.loading is not None or not self.followed_by(app) or self.editor.stays_frozen(app):
            self._drop_arriving()
            return
        if app.picture_size == (1, 1):  # nothing has been laid out yet
            return
        if self._arriving is None:
            if self.minimised or (app.picture.busy and self.shown is not None and not self._starved(app)):
                return
            snapshot = self.thread.take_snapshot()
            if snapshot is None:
                return
            self._arriving = snapshot, app.picture.load_steps(snapshot.gaussians)
        snapshot, steps = self._arriving
        try:
            if advanced(steps, UPLOAD_SECONDS):
                self._arriving = None
                self._adopt(app, snapshot)
        except InputError as error:
            self._arriving = None
            app.prefer(training_updates="off")
            app.complain(f"The scene in training is no longer shown: {error}")

    def _drop_arriving(self) -> None:
        if self._arriving is not None:
            self._arriving[1].close()
            self._arriving = None

    def _starved(self, app: AppState) -> bool:
        """Whether the view is moved, so that something is being drawn all the time."""
        now, last = app.now(), sum(app.stats.ms.values()) / 1000 if app.stats else 0.0
        moved = now - self._touched < TOUCHED_SECONDS
        return moved and now - self._shown_at >= max(STARVED_SECONDS, 4 * last)

    def _adopt(self, app: AppState, snapshot: Snapshot) -> None:
        first = self._scene is EMPTY_SCENE
        means = snapshot.gaussians.means
        centre, radius = robust_bounds(means[:: -(-len(means) // MOST_FOR_BOUNDS)])
        self._scene = app.scene = LoadedScene(
            gaussians=snapshot.gaussians,
            paths=(self.thread.outputs.scene,),
            name=f"{self.name} (training)",
            centre=centre,
            radius=radius,
            settings=self.settings,
            seconds=0.0,
        )
        self.shown, self._shown_at = snapshot, app.now()
        self.editor.carry_over(app, snapshot)
        if first:
            self._first_view(app)
        if self.status.state != "training":
            app.examination, app.examined = Examination(snapshot.gaussians), True

    def _first_view(self, app: AppState) -> None:
        """From the camera of the middle photo: there the scene is surely before the eye."""
        camera = self.photos[len(self.photos) // 2].camera
        ahead = float((self._scene.centre - camera.eye) @ camera.forward)
        up = common_up(app.cameras)
        app.steer(
            view_from_camera(
                camera,
                distance=ahead if ahead > 0 else self._scene.radius,
                up=-camera.R_camera_world[1] if up is None else up,
                width=app.picture_size[0],
                height=app.picture_size[1],
            )
        )


def advanced(steps: Generator[float], seconds: float) -> bool:
    """Runs an upload for about so long; whether it is through."""
    until = time.perf_counter() + seconds
    return all(time.perf_counter() < until for _ in steps)


def viewer_threads(share: float, cores: int) -> int:
    """Number of cores that training leaves, at least one."""
    return max(cores - pace_of(share, cores).threads, 1)


def watched_photos(
    train: Sequence[TrainView], held_out: Sequence[TrainView], centre: np.ndarray | None = None
) -> list[WatchedPhoto]:
    """Both sorts, sorted by name, in the world, where `centre` (3,) is their origin; None: at the world's."""
    shots = [(shot, False) for shot in train] + [(shot, True) for shot in held_out]
    if centre is not None:
        shots = [(shot.about(-centre), kept) for shot, kept in shots]
    files = Counter(PurePosixPath(shot.camera.name).name for shot, _ in shots)

    def label(name: str) -> str:
        file = PurePosixPath(name).name
        return file if files[file] == 1 else name

    photos = [WatchedPhoto(shot=shot, held_out=kept, label=label(shot.camera.name)) for shot, kept in shots]
    return sorted(photos, key=lambda photo: photo.name)


def redraw_seconds(app: AppState) -> float:
    """Core-seconds that the processor spends on a new picture of the scene, the window's frames for it
    included; 0 where a GPU does it."""
    if app.picture.name != "cpu":
        return 0.0
    drawing = sum(app.stats.ms.values()) / 1000 * (app.picture.threads or 1)
    return drawing + FRAMES_A_PICTURE * FRAME_SECONDS


def training_of(app: AppState) -> LiveTraining | None:
    """The training in this window; says so where there is none."""
    training = app.find(LiveTraining)
    if training is None:
        app.tell("Nothing is being trained: start with splatview train CAPTURE")
    return training


# Commands, to be posted.


def pause_or_resume(app: AppState) -> None:
    training = training_of(app)
    if training is None:
        return
    if training.status.state == "training":
        training.thread.pause()
    else:
        training.thread.resume()


def step_once(app: AppState) -> None:
    if training := training_of(app):
        training.thread.step_once()


def stop_and_save(app: AppState) -> None:
    if training := training_of(app):
        training.thread.stop()


def save_checkpoint(app: AppState) -> None:
    if training := training_of(app):
        training.thread.save_checkpoint()


def evaluate(app: AppState) -> None:
    if training := training_of(app):
        training.thread.evaluate()


def export(app: AppState) -> None:
    """Asks where the scene goes, and writes it as it is then."""
    if training := training_of(app):
        training.editor.export(app)


def change_settings(app: AppState, **settings: Any) -> None:
    if training := training_of(app):
        training.thread.change(**settings)


def show_training(app: AppState) -> None:
    """Back from something else that was opened."""
    if training := training_of(app):
        training.follow(app)


def show_now(app: AppState) -> None:
    if training := training_of(app):
        training.thread.show_now()


def compare_photo(app: AppState, index: int) -> None:
    """Compares photo `index`, counted round the list; the view stays."""
    if training := app.find(LiveTraining):
        training.photo_index = index % len(training.photos)


def go_to_photo(app: AppState, index: int) -> None:
    """Looks from where photo `index` was taken, and compares it."""
    if training := app.find(LiveTraining):
        compare_photo(app, index)
        app.cameras = training.cameras
        go_to_camera(app, index)
