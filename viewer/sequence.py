"""The open sequence: its frames follow the playhead onto the picture. No ImGui in here."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import partial

from splatview.scene import InputError
from splatview.scene.formats.ply_body import free_memory
from splatview.scene.formats.sequence import SceneSequence
from splatview.scene.framing import robust_bounds
from splatview.viewer import open as opening
from splatview.viewer.editing.session import Editing, EditSession, session_of
from splatview.viewer.loading import Examination, LoadedScene, Reading, load_frame, stamps_of
from splatview.viewer.picture import EMPTY
from splatview.viewer.playback import FrameCache, Playhead
from splatview.viewer.preferences import RANGES, PlayMode
from splatview.viewer.state import AppState, Feature

UPLOAD_SECONDS = 0.03
"""Share of a frame of the window, in seconds, for handing a frame to the picture: more than a single scene
gets, as the next one waits, and still an answer within 100 ms."""

SETTLE_SECONDS = 0.3
"""Rest on a frame after which it is made ready to be edited."""

STARVED_SECONDS = 2.0
"""Longest wait for a picture of the frame before."""

REACHED_OVER, LEAST_TIMES = 2.0, 4
"""Seconds over which the reached frame rate is measured, and frames, where these take longer."""

MEMORY_SHARE = 4
"""A quarter of the free memory is for frames: edits may take half, and decoding takes some too."""

USUAL_RATES = (24, 30, 60)
"""Frames a second: film, video, screens."""

SELECTING = frozenset(
    {"select", "select_all", "select_none", "select_inverse", "grow", "shrink", "select_detected"}
)
"""Steps that are no loss when the frame changes."""


@dataclass(eq=False, kw_only=True)
class Player:
    """A sequence that is open."""

    sequence: SceneSequence
    head: Playhead
    cache: FrameCache[LoadedScene]
    shown: int
    """Frame that the picture holds; -1: an edited one, to be replaced."""
    shown_tick: int = 0
    """Tick of the playhead that it was shown for."""
    shown_at: float = 0.0
    dragging: bool = False
    """Whether the slider is held: frames near the mouse are shown while its own is decoded."""
    free: float = 0.0
    """Bytes of memory that were free when it was opened."""
    arriving: tuple[int, int, LoadedScene, Generator[float]] | None = None
    """Frame on its way to the picture: number, tick, scene, and the steps left."""
    settled: bool = True
    """Whether the shown frame has been made ready to be edited."""
    times: deque[float] = field(default_factory=lambda: deque(maxlen=512))
    """Moments in which frames were shown while playing."""

    @property
    def reached(self) -> float:
        """Frames a second that have been shown of late; 0 where that is not known."""
        times = self.times
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 2 and times[-1] > times[0] else 0.0

    def target(self) -> tuple[int, int] | None:
        """Frame to be shown now, and its tick; None: the shown one stays. Of frames that are due the latest
        that is decoded: what was not in time is dropped."""
        head, cache = self.head, self.cache
        if head.playing:
            for tick in range(head.tick, max(self.shown_tick, head.tick - head.count), -1):
                index = head.after(tick - head.tick)
                if cache.get(index) is not None:
                    return index, tick
            return None
        index = head.frame
        if cache.get(index) is None and self.dragging:
            near = cache.nearest(index)
            if near is not None and abs(near - index) < abs(self.shown - index):
                index = near
        return (index, head.tick) if cache.get(index) is not None else None

    def drop_arriving(self) -> None:
        if self.arriving is not None:
            self.arriving[3].close()
            self.arriving = None


class Sequences(Feature):
    """Playback of the open sequence. At rest its frame is a scene like any other, with a session of its own;
    while it plays there is none, and whatever edits pauses it (it is a `LiveScene`)."""

    at_rest = True

    def __init__(self) -> None:
        self.player: Player | None = None
        """None where no sequence is open."""
        self.wake: Callable[[], object] = lambda: None
        """Makes an idle window draw its next frame. May be called from any thread."""

    @property
    def playing(self) -> bool:
        return self.player is not None and self.player.head.playing

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self.close(app)
        if scene.sequence is None:
            return
        sequence, preferences, wake = scene.sequence, app.preferences, self.wake
        like, by_gl = replace(scene, gaussians=EMPTY), not app.picture.draws_anywhere

        def read(index: int) -> Reading[LoadedScene]:
            work = partial(load_frame, sequence, index, like=like, by_gl=by_gl)
            return Reading(sequence.labels[index], work, on_done=wake)

        head = Playhead(len(sequence), fps=preferences.frame_rate, mode=preferences.play_mode)
        head.seek(scene.frame)
        free = float(free_memory())
        cache = FrameCache[LoadedScene](
            len(sequence), read, lambda frame: frame.gaussians.nbytes, budget=free / MEMORY_SHARE
        )
        cache.add(scene.frame, scene)
        self.player = Player(sequence=sequence, head=head, cache=cache, shown=scene.frame, free=free)
        editing = app.feature(Editing)
        if editing.live is None:
            editing.live = self

    def before_frame(self, app: AppState) -> None:
        """Moves the playhead, decodes ahead, and hands the frame that is due to the picture, in parts."""
        player = self.player
        if player is None:
            return
        if app.scene.sequence is not player.sequence:  # a training is followed again
            self.close(app)
            return
        if app.loading is not None:
            player.drop_arriving()
            return
        preferences, head = app.preferences, player.head
        head.fps, head.mode = preferences.frame_rate, preferences.play_mode
        head.advance(app.now())
        own = preferences.sequence_memory_gib * 2**30
        player.cache.budget = own or player.free / MEMORY_SHARE
        for problem in player.cache.advance(head, time.monotonic()):
            app.tell(f"{problem}; the frame is skipped")
        self._show(app, player)
        if not head.playing:
            player.times.clear()
            self._settle(app, player)

    def _show(self, app: AppState, player: Player) -> None:
        now = app.now()
        if player.arriving is None:
            target = player.target()
            if target is None or target[0] == player.shown or app.picture_size == (1, 1):
                return
            # A picture that is overtaken before it is drawn would be work for nobody.
            if not app.picture.is_current and now - player.shown_at < STARVED_SECONDS:
                return
            scene = player.cache.get(target[0])
            assert scene is not None
            if not player.head.playing and stamps_of(scene.paths) != scene.stamps:
                player.cache.forget(target[0])  # it may be what an edited frame was exported to
                return
            player.arriving = (*target, scene, app.picture.load_steps(scene.gaussians))
        index, tick, scene, steps = player.arriving
        until = time.perf_counter() + UPLOAD_SECONDS
        try:
            if not all(time.perf_counter() < until for _ in steps):
                return
        except InputError as error:
            player.arriving = None
            player.cache.problems[index] = str(error)
            app.tell(f"{player.sequence.labels[index]}: {error}; the frame is skipped")
            return
        player.arriving = None
        player.shown, player.shown_tick, player.shown_at = index, tick, now
        player.settled = False
        if player.head.playing:
            player.times.append(now)
            while now - player.times[0] > REACHED_OVER and len(player.times) > LEAST_TIMES:
                player.times.popleft()
        app.feature(Editing).leave()
        app.scene = scene
        app.call_for(scene.settings)
        app.examination, app.examined = None, True

    def _settle(self, app: AppState, player: Player, *, now: bool = False) -> None:
        """Makes the frame at rest ready to be edited, and looks it through: settings follow what is found."""
        found = app.examination
        if player.settled and found is not None and found.settings is not None:
            same = found.gaussians is app.scene.gaussians
            if same and app.scene.settings is not found.settings:
                app.scene = replace(app.scene, settings=found.settings)
        rested = not player.dragging and app.now() - player.shown_at >= SETTLE_SECONDS
        if player.settled or player.shown < 0 or not (rested or now) or player.arriving is not None:
            return
        player.settled = True
        centre, radius = robust_bounds(app.scene.gaussians.means)
        app.scene = replace(app.scene, centre=centre, radius=radius)
        editing = app.feature(Editing)
        if editing.session is None:
            editing.on_scene_opened(app, replace(app.scene, name=player.sequence.labels[app.scene.frame]))
        app.examination, app.examined = Examination(app.scene.gaussians), True

    def held(self, app: AppState) -> str | None:
        """Why no other frame may be shown now, in a line; None where one may."""
        session, player = session_of(app), self.player
        if session is None or player is None:
            return None
        label = player.sequence.labels[app.scene.frame]
        if session.job is not None and not session.job.yields:
            return f"{session.job.title} is still under way; wait for it or cancel it"
        if is_edited(session):
            return f"{label} is edited: export it, undo, or discard its edits, before another frame is shown"
        return None

    def seek(self, app: AppState, frame: int) -> None:
        """Goes to a frame; stays where it would lose edits, and says so."""
        player = self.player
        if player is None or frame == player.head.frame == player.shown:
            return
        if not self._may_leave(app):
            return
        player.head.pause()
        player.head.seek(frame)

    def play(self, app: AppState) -> None:
        if self.player is not None and self._may_leave(app):
            player = self.player
            app.feature(Editing).leave()  # an edit before the next frame is due must pause, too
            player.settled = False
            player.head.play(app.now())
            player.shown_tick = player.head.tick
            player.times.clear()

    def pause(self) -> None:
        """Rests on the frame that is seen, whatever would be due."""
        player = self.player
        if player is not None and player.head.playing:
            player.drop_arriving()
            player.head.pause()
            if player.shown >= 0:
                player.head.seek(player.shown)

    def _may_leave(self, app: AppState) -> bool:
        why = self.held(app)
        if why is not None:
            if not app.messages or app.messages[-1].text != why:  # a drag asks in every frame
                app.tell(why)
            return False
        session = session_of(app)
        if session is not None and session.job is not None:
            session.job.cancel()
        return True

    # ---- as the source of sessions while it plays

    def is_shown(self, app: AppState) -> bool:
        return self.player is not None

    def freeze(self, app: AppState) -> EditSession | None:
        """The session of the frame that is seen, on which the sequence rests from now on."""
        player = self.player
        if player is not None:
            self.pause()
            player.drop_arriving()
            player.head.seek(app.scene.frame)
            self._settle(app, player, now=True)
        return session_of(app)

    def release(self, app: AppState) -> None:
        """Nothing is frozen: frames at rest are followed by none."""

    def export(self, app: AppState) -> None:
        """Nothing: a frame at rest is exported as any scene."""

    # ----

    def busy(self, app: AppState) -> bool:
        player = self.player
        if player is None:
            return False
        head, cache = player.head, player.cache
        on_the_way = player.shown != head.frame and cache.state(head.frame) != "failed"
        return head.playing or player.arriving is not None or on_the_way or not player.settled

    def cancel(self, app: AppState) -> bool:
        playing = self.playing
        self.pause()
        return playing

    def close(self, app: AppState) -> None:
        player, self.player = self.player, None
        if player is not None:
            player.drop_arriving()
            player.cache.close()
        editing = app.feature(Editing)
        if editing.live is self:
            editing.live = None


def is_edited(session: EditSession) -> bool:
    """Whether steps are in force that are in no file, choosing splats apart."""
    history = session.document.history
    steps = history.steps[: history.position]
    return history.modified and any(step.operation.op not in SELECTING for step in steps)


# Commands, to be posted.


def play_or_pause(app: AppState) -> None:
    sequences = app.feature(Sequences)
    if sequences.player is None:
        app.tell("No sequence is open: open a folder of scenes")
    elif sequences.playing:
        sequences.pause()
    else:
        sequences.play(app)


def step(app: AppState, by: int) -> None:
    """The next or previous frame that can be read; over the end where the sequence loops."""
    sequences = app.feature(Sequences)
    player = sequences.player
    if player is None:
        return
    sequences.pause()
    count, loops = len(player.sequence), player.head.mode == "loop"
    for away in range(1, count):
        frame = player.head.frame + by * away
        if not loops and not 0 <= frame < count:
            return
        if player.cache.state(frame % count) != "failed":
            sequences.seek(app, frame % count)
            return


def seek(app: AppState, frame: int) -> None:
    app.feature(Sequences).seek(app, frame)


def go_to_end(app: AppState, *, last: bool) -> None:
    """To the first or the last frame."""
    player = app.feature(Sequences).player
    if player is not None:
        seek(app, len(player.sequence) - 1 if last else 0)


def set_rate(app: AppState, fps: float) -> None:
    low, high = RANGES["frame_rate"]
    if low <= fps <= high:
        app.prefer(frame_rate=float(fps))


def set_mode(app: AppState, mode: PlayMode) -> None:
    app.prefer(play_mode=mode)


def merge_frames(app: AppState) -> None:
    """All frames at once, as one scene: for files that are parts of one, numbered."""
    player = app.feature(Sequences).player
    if player is not None:
        opening.begin(app, player.sequence.paths)


def discard_edits(app: AppState) -> None:
    """The shown frame as its file has it."""
    sequences = app.feature(Sequences)
    player, session = sequences.player, session_of(app)
    if player is None or session is None or not is_edited(session):
        app.tell("This frame is not edited")
        return
    if session.job is not None:
        app.tell(f"{session.job.title} is still under way; wait for it or cancel it")
        return
    app.feature(Editing).leave()
    player.shown = -1
    player.head.seek(app.scene.frame)
    app.tell(f"{player.sequence.labels[app.scene.frame]}: as its file has it")
