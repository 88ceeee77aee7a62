"""Playback of frames: the playhead, and the frames decoded ahead of it. No ImGui and no OpenGL."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping
from typing import Generic, Literal, TypeVar

from splatview.viewer.loading import Reading
from splatview.viewer.preferences import PlayMode

FrameState = Literal["absent", "coming", "cached", "failed"]

Frame = TypeVar("Frame")


def frame_at(tick: int, count: int, mode: PlayMode) -> int:
    """Frame, 0 to count - 1, that is due in tick 0, 1, ... of a playback of `count` frames."""
    if count < 2:
        return 0
    match mode:
        case "loop":
            return tick % count
        case "bounce":
            place = tick % (2 * count - 2)
            return place if place < count else 2 * count - 2 - place
        case "once":
            return min(max(tick, 0), count - 1)


class Playhead:
    """Position in a sequence, in ticks of its frame rate; it moves by the clock, whatever is decoded."""

    def __init__(self, count: int, *, fps: float, mode: PlayMode = "loop"):
        self.count = count
        self.fps = fps
        """Frames a second, > 0."""
        self.playing = False
        self._mode: PlayMode = mode
        self._tick = 0.0
        self._at = 0.0

    @property
    def mode(self) -> PlayMode:
        return self._mode

    @mode.setter
    def mode(self, mode: PlayMode) -> None:
        """The frame stays."""
        if mode != self._mode:
            self.seek(self.frame)
            self._mode = mode

    @property
    def tick(self) -> int:
        return int(self._tick)

    @property
    def frame(self) -> int:
        return self.after(0)

    def after(self, ticks: int) -> int:
        """Frame that is due so many ticks from now."""
        return frame_at(self.tick + ticks, self.count, self._mode)

    def seek(self, frame: int) -> None:
        self._tick = float(min(max(frame, 0), self.count - 1))

    def play(self, now: float) -> None:
        """Begins at the frame that is shown; at the end of what does not repeat, from the first."""
        if self._mode == "once" and self.frame == self.count - 1:
            self.seek(0)
        self.playing, self._at = True, now

    def pause(self) -> None:
        self.playing = False
        self.seek(self.frame)

    def advance(self, now: float) -> None:
        """Moves on to `now`, in seconds of a clock that never goes back."""
        if not self.playing:
            return
        self._tick += max(now - self._at, 0.0) * self.fps
        self._at = now
        if self._mode == "once" and self._tick >= self.count - 1:
            self.pause()


WORKERS = max(1, min(4, (os.cpu_count() or 2) // 2))
"""Frames that are decoded at once: half of the cores are left to drawing."""

LEAST_FRAMES = 2
"""Frames that are kept whatever memory they take: the one that is shown and the next."""

LEARNING = 0.3
"""Weight of the latest frame in the mean time of decoding."""


class FrameCache(Generic[Frame]):
    """Frames of a sequence, decoded in background threads ahead of the playhead, within a budget of memory.

    For the thread of the window, which calls `advance` in each of its frames. Kept are the frames that are
    needed next, in the order of playing: by least recent use, a loop that does not fit would never find any
    of its frames.
    """

    def __init__(
        self,
        count: int,
        read: Callable[[int], Reading[Frame]],
        size: Callable[[Frame], int],
        *,
        budget: float,
        workers: int = WORKERS,
    ):
        """`read` starts to read a frame; `size` is what one takes, in bytes."""
        self.budget = budget
        """Bytes for all frames; `LEAST_FRAMES` are kept whatever they take."""
        self.problems: dict[int, str] = {}
        """Reason why a frame cannot be read, in a line, by its number."""
        self.used = 0
        """Bytes of the frames that are kept."""
        self.seconds = 0.0
        """Mean time from the start of a frame's decoding to its end; 0 before the first."""
        self.version = 0
        """Rises whenever the state of a frame changes."""
        self._count, self._read, self._size, self._workers = count, read, size, workers
        self._frames: dict[int, Frame] = {}
        self._running: dict[int, Reading[Frame]] = {}
        self._last_tick = 0
        self._largest = 0

    def __len__(self) -> int:
        return len(self._frames)

    def get(self, index: int) -> Frame | None:
        return self._frames.get(index)

    def nearest(self, index: int) -> int | None:
        """The frame nearest to `index` that is there."""
        return min(self._frames, key=lambda one: abs(one - index), default=None)

    def state(self, index: int) -> FrameState:
        if index in self._frames:
            return "cached"
        if index in self.problems:
            return "failed"
        return "coming" if index in self._running else "absent"

    def add(self, index: int, frame: Frame) -> None:
        """Keeps a frame, which may have come by another way."""
        if index not in self._frames:
            size = self._size(frame)
            self._frames[index] = frame
            self.used += size
            self._largest = max(self._largest, size)
            self.version += 1

    def forget(self, index: int) -> None:
        """Gives up a frame whose file has changed."""
        frame = self._frames.pop(index, None)
        if frame is not None:
            self.used -= self._size(frame)
            self.version += 1

    def advance(self, head: Playhead, now: float) -> list[str]:
        """Takes over frames that have come and starts to decode what is needed next; returns the problems of
        frames that cannot be read, each once. `now`: seconds of the clock of `Reading.began`."""
        said = self._collect(now)
        order = self._needed(head)
        self._evict(order)
        self._start(head, order)
        return said

    def close(self) -> None:
        """Gives up what is being decoded and forgets all frames."""
        for reading in self._running.values():
            reading.cancel()
        self._running.clear()
        self._frames.clear()
        self.used = 0

    def _collect(self, now: float) -> list[str]:
        said = []
        for index, reading in list(self._running.items()):
            if not reading.done:
                continue
            del self._running[index]
            self.version += 1
            took = max(now - reading.began, 0.0)
            self.seconds += (took - self.seconds) * (LEARNING if self.seconds else 1.0)
            if reading.result is not None:
                self.add(index, reading.result)
            elif reading.problem is not None:
                self.problems[index] = reading.problem
                said.append(reading.problem)
        return said

    @property
    def room(self) -> int:
        """Number of frames for which there is memory, going by the largest so far."""
        if not self._largest:
            return LEAST_FRAMES
        return int(min(max(self.budget / self._largest, LEAST_FRAMES), self._count))

    def _needed(self, head: Playhead) -> dict[int, int]:
        """The frames to keep, as many as there is memory for, those needed first in front; with the tick that
        they are needed in. At rest those around the playhead, in playing those that follow."""
        coming = self._coming(head) if head.playing else ((index, head.tick) for index in _around(head))
        return _first(min(self.room, self._count), coming)

    def _coming(self, head: Playhead) -> Iterator[tuple[int, int]]:
        """The frames that follow, and when. Those that could not be decoded by the time that they are due are
        left out; where decoding is slower than the frame rate, every so-manieth comes first, evenly."""
        late = self.seconds * head.fps
        lead, stride = math.ceil(late), max(1, int(late / self._workers))
        ticks = range(head.tick, head.tick + lead + 2 * self._count)
        frames = [(frame_at(tick, self._count, head.mode), tick) for tick in ticks]
        for index, tick in frames:
            in_time = tick >= head.tick + lead and (tick - self._last_tick) % stride == 0
            if in_time or index in self._frames or index in self._running:
                yield index, tick
        yield from frames[lead:]

    def _evict(self, order: Mapping[int, int]) -> None:
        """Forgets the frames that are needed last, until the rest fits."""
        if self.used <= self.budget or len(self._frames) <= LEAST_FRAMES:
            return
        rank = {index: place for place, index in enumerate(order)}
        kept = sorted(self._frames, key=lambda index: rank.get(index, self._count))
        while self.used > self.budget and len(kept) > LEAST_FRAMES:
            self.used -= self._size(self._frames.pop(kept.pop()))
            self.version += 1

    def _start(self, head: Playhead, order: Mapping[int, int]) -> None:
        # Where the user goes to a frame, those that are being decoded for later are not waited for.
        urgent = not head.playing and self.state(head.frame) == "absent"
        while len(self._running) < self._workers + urgent:
            index = next((index for index in order if self.state(index) == "absent"), None)
            if index is None or not (urgent or self._fits(index, order)):
                return
            self._running[index] = self._read(index)
            self._last_tick = order[index]
            self.version += 1
            urgent = False

    def _fits(self, index: int, order: Mapping[int, int]) -> bool:
        """Whether there is memory for one more beside those under way, or frames needed later to forget."""
        coming = self.used + (len(self._running) + 1) * self._largest
        if coming <= self.budget or len(self._frames) + len(self._running) < LEAST_FRAMES:
            return True
        sooner = set(itertools.takewhile(lambda one: one != index, order))
        spare = sum(self._size(frame) for kept, frame in self._frames.items() if kept not in sooner)
        return coming - spare <= self.budget or len(sooner | self._running.keys()) < LEAST_FRAMES


def _around(head: Playhead) -> Iterator[int]:
    """The frame at rest, then the next, the one before, the next but one..."""
    for away in range(head.count):
        yield from (index for index in (head.frame + away, head.frame - away) if 0 <= index < head.count)


def _first(most: int, frames: Iterator[tuple[int, int]]) -> dict[int, int]:
    """The first `most` different frames of (frame, tick), each with its first tick."""
    found: dict[int, int] = {}
    for index, tick in frames:
        found.setdefault(index, tick)
        if len(found) >= most:
            break
    return found
