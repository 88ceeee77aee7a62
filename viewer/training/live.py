"""The window's side of a training: takes snapshots over, keeps the shares of the cores, knows the photos.

Nothing here imports ImGui, so all of it is tested without a display.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from splatview.renderers.cpu_async import FRAME_SECONDS
from splatview.scene import Camera, InputError, RenderSettings
from splatview.scene.edits import Crop
from splatview.scene.framing import robust_bounds
from splatview.trainer.background import Snapshot, State, Status, TrainingThread, pace_of
from splatview.trainer.views import Shot
from splatview.viewer import open as camera_list
from splatview.viewer.loading import Examination, LoadedScene
from splatview.viewer.navigation import view_from_camera
from splatview.viewer.open import UPLOAD_SECONDS, common_up
from splatview.viewer.preferences import TrainingUpdates
from splatview.viewer.state import Core
from splatview.viewer.training.comparison import Comparer, Pictures
from splatview.viewer.training.live_edits import succeed, waits


@dataclass(frozen=True)
class UpdateRate:
    """What new pictures of the scene may cost."""

    seconds: float
    """Between snapshots at least."""
    share: float
    """Of all cores, that drawing them may take where the processor draws."""
    fps: float
    """Frames of the window itself a second, while nobody touches it."""


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
"""Of the cores, even where training has been given all: a view that can be turned, if slowly."""

MOST_FOR_BOUNDS = 20_000
"""Splats that tell where the scene is: enough for that, and done within a millisecond or two."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WatchedPhoto:
    """One row of the list of photos."""

    shot: Shot
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
class Training:
    """A training and how it is watched. Fields are plain: panels set the simple ones."""

    thread: TrainingThread
    name: str
    """Of the capture."""
    photos: list[WatchedPhoto]
    """By name."""
    settings: RenderSettings
    """What the scene is trained for."""
    minimised: bool = False
    """Nobody sees the window: nothing is shown."""
    photo_index: int = 0
    """Of `photos`, the one that is compared."""
    gain: float = 4.0
    """By how much differences are brightened."""
    by_seconds: bool = False
    """Whether curves are over seconds rather than steps."""
    shown: Snapshot | None = None
    """What the view shows."""
    pointed: tuple[Crop, ...] = ()
    """Crops of a rule under the mouse, to be drawn on the picture."""
    core: Core | None = None
    """The window's, once there is one."""
    cameras: list[Camera] = field(init=False)
    """Of the photos, what the window's list of cameras is."""
    comparer: Comparer = field(default_factory=Comparer)
    pictures: Pictures = field(default_factory=Pictures)
    _scene: LoadedScene | None = None
    _arriving: tuple[Snapshot, Generator[float]] | None = None
    _last_view: object = None
    _touched: float = -1e9
    _shown_at: float = -1e9
    _told: State = "training"
    _camera_index: int = -1

    def __post_init__(self) -> None:
        self.cameras = [photo.camera for photo in self.photos]

    @property
    def status(self) -> Status:
        return self.thread.status

    @property
    def photo(self) -> WatchedPhoto:
        return self.photos[self.photo_index]

    def idle_fps(self, core: Core) -> float:
        """Frames a second for a window that nobody touches."""
        if self.minimised:
            return MINIMISED_FPS
        runs = self.status.state == "training"
        fps = RATES[core.preferences.training_updates if runs else "low"].fps
        return min(fps, SOFTWARE_FPS) if core.picture is not None and core.picture.name == "cpu" else fps

    def followed_by(self, core: Core) -> bool:
        """Whether the window shows this training, and not something that was opened since."""
        return core.scene is self._scene

    @property
    def scores(self) -> dict[str, float]:
        """Held-out PSNR in dB by the photo's name, of the latest evaluation."""
        evaluation = self.status.evaluation
        return {} if evaluation is None else {score.name: score.psnr for score in evaluation.scores}

    def start(self, core: Core, *, on_change: Callable[[], object] = lambda: None) -> None:
        """The window is there: shows the first snapshot and begins. `on_change` wakes the window."""
        self.core = core
        self.comparer = Comparer(on_change)
        self.thread.on_change = on_change
        core.settings = replace(self.settings, blend=core.preferences.blend)
        core.cameras = self.cameras
        self.thread.begin()

    def stop(self) -> None:
        """The window is about to go. The thread is left to whoever made it."""
        self.thread.on_change = lambda: None
        self.comparer.close()
        self.pictures.release()
        self._drop_arriving()

    def advance(self, core: Core) -> None:
        """Called every frame, between two frames."""
        for note in self.thread.take_notes():
            core.tell(note)
        if core.cameras is self.cameras and core.camera_index != self._camera_index:
            # However the user came to a photo's camera, that photo is compared.
            self._camera_index = core.camera_index
            self.photo_index = max(core.camera_index, 0)
        self._report(core)
        self._keep_shares(core)
        self._follow(core)

    def follow(self, core: Core) -> None:
        """Shows this training again after something else was opened."""
        core.scene = self._scene
        core.cameras, core.camera_index = self.cameras, -1
        core.settings = replace(self.settings, blend=core.preferences.blend)
        self.shown = None
        # The picture holds something else, so even an unchanged scene is to be handed over.
        self.thread.show_now(again=True)

    # ---- parts of a frame

    def _report(self, core: Core) -> None:
        """Says once what the thread's new state means."""
        status = self.status
        if status.state == self._told:
            return
        self._told = status.state
        if status.state == "failed":
            core.complain(f"Training has stopped: {status.failure}. The scene is kept as it was.")
        elif status.state == "done":
            core.tell(f"Training is done: {status.gaussians:,} splats after {status.iteration:,} steps")

    def _keep_shares(self, core: Core) -> None:
        now = core.now()
        if core.view is not self._last_view:
            self._last_view, self._touched = core.view, now
        moved = now - self._touched < TOUCHED_SECONDS
        wanted, cores = core.preferences.training_share, self.thread.cores
        self.thread.share = wanted if moved or not core.preferences.training_takes_idle_cores else 1.0
        if core.picture is not None:
            runs = self.status.state == "training"
            core.picture.threads = viewer_threads(wanted, cores) if runs else None
            core.picture.cores = max(1 - wanted, LEAST_FOR_VIEWER) * cores if runs else None
        rate = RATES["off" if self.minimised else core.preferences.training_updates]
        if rate.share > 0:
            cost = redraw_seconds(core) / (rate.share * cores)
            self.thread.snapshot_seconds = max(rate.seconds, cost)
        else:
            self.thread.snapshot_seconds = None

    def _follow(self, core: Core) -> None:
        """Takes the latest snapshot over, for a few milliseconds of uploading."""
        if core.loading is not None or not self.followed_by(core) or waits(core):
            self._drop_arriving()
            return
        if core.picture is None or core.picture_size == (1, 1):  # nothing has been laid out yet
            return
        if self._arriving is None:
            if self.minimised or (core.picture.busy and self.shown is not None and not self._starved(core)):
                return
            snapshot = self.thread.take_snapshot()
            if snapshot is None:
                return
            self._arriving = snapshot, core.picture.load_steps(snapshot.gaussians)
        snapshot, steps = self._arriving
        try:
            if advanced(steps, UPLOAD_SECONDS):
                self._arriving = None
                self._adopt(core, snapshot)
        except InputError as error:
            self._arriving = None
            core.prefer(training_updates="off")
            core.complain(f"The scene in training is no longer shown: {error}")

    def _drop_arriving(self) -> None:
        if self._arriving is not None:
            self._arriving[1].close()
            self._arriving = None

    def _starved(self, core: Core) -> bool:
        """Whether the view is moved, so that something is being drawn all the time."""
        now, last = core.now(), sum(core.stats.ms.values()) / 1000 if core.stats else 0.0
        moved = now - self._touched < TOUCHED_SECONDS
        return moved and now - self._shown_at >= max(STARVED_SECONDS, 4 * last)

    def _adopt(self, core: Core, snapshot: Snapshot) -> None:
        first = self._scene is None
        means = snapshot.gaussians.means
        centre, radius = robust_bounds(means[:: -(-len(means) // MOST_FOR_BOUNDS)])
        self._scene = core.scene = LoadedScene(
            gaussians=snapshot.gaussians,
            paths=(self.thread.outputs.scene,),
            name=f"{self.name} (training)",
            centre=centre,
            radius=radius,
            settings=self.settings,
            seconds=0.0,
        )
        self.shown, self._shown_at = snapshot, core.now()
        succeed(core, snapshot)
        if first:
            self._first_view(core)
        if self.status.state != "training":
            core.examination, core.examined = Examination(snapshot.gaussians), True

    def _first_view(self, core: Core) -> None:
        """From the camera of the middle photo: there the scene is surely before the eye."""
        assert self._scene is not None
        camera = self.photos[len(self.photos) // 2].camera
        ahead = float((self._scene.centre - camera.eye) @ camera.forward)
        up = common_up(core.cameras)
        core.steer(
            view_from_camera(
                camera,
                distance=ahead if ahead > 0 else self._scene.radius,
                up=-camera.R_camera_world[1] if up is None else up,
                width=core.picture_size[0],
                height=core.picture_size[1],
            )
        )


def advanced(steps: Generator[float], seconds: float) -> bool:
    """Runs an upload for about so long; whether it is through."""
    until = time.perf_counter() + seconds
    return all(time.perf_counter() < until for _ in steps)


def viewer_threads(share: float, cores: int) -> int:
    """What training leaves of the cores, at least one."""
    return max(cores - pace_of(share, cores).threads, 1)


def watched_photos(train: Sequence[Shot], held_out: Sequence[Shot]) -> list[WatchedPhoto]:
    """Both sorts, sorted by name."""
    shots = [(shot, False) for shot in train] + [(shot, True) for shot in held_out]
    files = Counter(PurePosixPath(shot.camera.name).name for shot, _ in shots)

    def label(name: str) -> str:
        file = PurePosixPath(name).name
        return file if files[file] == 1 else name

    photos = [WatchedPhoto(shot=shot, held_out=kept, label=label(shot.camera.name)) for shot, kept in shots]
    return sorted(photos, key=lambda photo: photo.name)


def redraw_seconds(core: Core) -> float:
    """Core-seconds that the processor spends on a new picture of the scene, the window's frames for it
    included; 0 where a GPU does it."""
    if core.stats is None or core.picture is None or core.picture.name != "cpu":
        return 0.0
    drawing = sum(core.stats.ms.values()) / 1000 * (core.picture.threads or 1)
    return drawing + FRAMES_A_PICTURE * FRAME_SECONDS


# ---- What the user can ask of a training; all are posted to the `Core`, as `viewer.window.actions` are.


def training_of(core: Core) -> Training | None:
    """The training in this window; says so where there is none."""
    if core.training is None:
        core.tell("Nothing is being trained: start with splatview train CAPTURE")
    return core.training


def pause_or_resume(core: Core) -> None:
    training = training_of(core)
    if training is None:
        return
    if training.status.state == "training":
        training.thread.pause()
    else:
        training.thread.resume()


def step_once(core: Core) -> None:
    if training := training_of(core):
        training.thread.step_once()


def stop_and_save(core: Core) -> None:
    if training := training_of(core):
        training.thread.stop()


def save_checkpoint(core: Core) -> None:
    if training := training_of(core):
        training.thread.save_checkpoint()


def evaluate(core: Core) -> None:
    if training := training_of(core):
        training.thread.evaluate()


def export(core: Core) -> None:
    """Asks where, and writes the scene as it stands then."""
    training = training_of(core)
    if training is None:
        return
    proposal = training.thread.outputs.scene
    core.choose_files(
        "Export the scene",
        lambda paths: training.thread.export(Path(paths[0])),
        kind="save_scene",
        name=f"{proposal.stem}-{training.status.iteration}.ply",
    )


def change_settings(core: Core, **settings: Any) -> None:
    if training := training_of(core):
        training.thread.change(**settings)


def show_training(core: Core) -> None:
    """Back from something else that was opened."""
    if training := training_of(core):
        training.follow(core)


def show_now(core: Core) -> None:
    if training := training_of(core):
        training.thread.show_now()


def compare_photo(core: Core, index: int) -> None:
    """Compares photo `index`, counted round the list; the view stays."""
    if core.training is not None:
        core.training.photo_index = index % len(core.training.photos)


def go_to_photo(core: Core, index: int) -> None:
    """Looks from where photo `index` was taken, and compares it."""
    training = core.training
    if training is None:
        return
    compare_photo(core, index)
    core.cameras = training.cameras
    camera_list.go_to_camera(core, index)
