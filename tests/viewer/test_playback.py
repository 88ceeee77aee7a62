"""The playhead and the frames ahead of it: order, budget, dropped frames, damaged ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, cast

import pytest

from splatview.viewer.playback import LEAST_FRAMES, FrameCache, Playhead, frame_at
from splatview.viewer.sequence import Player


@pytest.mark.parametrize(
    ("mode", "frames"),
    [
        ("loop", [0, 1, 2, 3, 0, 1, 2, 3, 0]),
        ("bounce", [0, 1, 2, 3, 2, 1, 0, 1, 2]),
        ("once", [0, 1, 2, 3, 3, 3, 3, 3, 3]),
    ],
)
def test_order_of_frames(mode, frames):
    assert [frame_at(tick, 4, mode) for tick in range(9)] == frames
    assert frame_at(7, 1, mode) == 0


def test_the_playhead_goes_by_the_clock():
    head = Playhead(10, fps=20)
    head.advance(5.0)
    assert head.frame == 0, "at rest"
    head.play(5.0)
    head.advance(5.26)
    assert head.frame == 5
    head.advance(6.0)
    assert head.frame == 0 and head.tick == 20, "round and round"
    head.fps = 2.0
    head.advance(6.5)
    assert head.frame == 1, "another rate counts from now on"
    head.mode = "bounce"
    assert head.frame == 1
    head.pause()
    head.advance(99.0)
    assert head.frame == 1
    head.mode = "once"
    head.seek(8)
    head.play(100.0)
    head.advance(200.0)
    assert head.frame == 9 and not head.playing
    head.play(200.0)
    assert head.frame == 0, "from the first again"


@dataclass
class Decoding:
    """In the place of `Reading`: ends when the test says so."""

    index: int
    began: float
    done: bool = False
    result: int | None = None
    problem: str | None = None
    cancelled: bool = False

    def cancel(self) -> None:
        self.cancelled = True

    def end(self, problem: str | None = None) -> None:
        self.done, self.problem = True, problem
        self.result = None if problem else self.index


@dataclass
class Frames:
    """A cache of `count` frames of `size` bytes, and what it began to decode."""

    count: int
    budget: float
    size: int = 10
    workers: int = 1
    now: float = 0.0
    started: list[Decoding] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.cache: FrameCache[int] = FrameCache(
            self.count, cast(Any, self.read), lambda _: self.size, budget=self.budget, workers=self.workers
        )
        self.cache.add(0, 0)

    def read(self, index: int) -> Decoding:
        assert self.cache.state(index) == "absent"
        self.started.append(Decoding(index, self.now))
        return self.started[-1]

    def run(self, head: Playhead, seconds: float, decode: float, step: float = 0.01) -> list[int]:
        """So many seconds of a window that asks every `step`; each frame takes `decode` seconds. Returns the
        frames that a player would have shown, in order."""
        player = Player(sequence=cast(Any, None), head=head, cache=cast(Any, self.cache), shown=head.frame)
        shown, until = [], self.now + seconds
        while self.now < until:
            self.now += step
            head.advance(self.now)
            for one in self.started:
                if not one.done and self.now - one.began >= decode:
                    one.end()
            self.cache.advance(head, self.now)
            assert self.cache.used <= max(self.budget, (LEAST_FRAMES + self.workers) * self.size)
            if (target := player.target()) is not None and target[0] != player.shown:
                player.shown, player.shown_tick = target
                shown.append(player.shown)
        return shown


def cached(frames: Frames) -> list[int]:
    return [index for index in range(frames.count) if frames.cache.state(index) == "cached"]


def test_at_rest_the_frames_around_are_decoded_within_the_budget():
    frames, head = Frames(count=20, budget=65), Playhead(20, fps=30)
    head.seek(10)
    frames.run(head, 2.0, decode=0.05)
    assert cached(frames) == [8, 9, 10, 11, 12, 13]
    assert frames.started[0].index == 10, "what is looked at comes first"
    head.seek(2)
    frames.run(head, 2.0, decode=0.05)
    assert cached(frames) == [0, 1, 2, 3, 4, 5]


def test_a_frame_that_is_gone_to_does_not_wait_for_others():
    frames, head = Frames(count=20, budget=1000), Playhead(20, fps=30)
    frames.cache.advance(head, 0.0)
    head.seek(15)
    frames.cache.advance(head, 0.0)
    assert [one.index for one in frames.started] == [1, 15]
    head.seek(7)
    frames.cache.advance(head, 0.0)
    assert len(frames.started) == 2, "one more than there are workers, and no more"
    frames.started[1].end()
    frames.cache.advance(head, 0.1)
    assert frames.started[-1].index == 7, "then the latest"


def test_what_is_decoded_in_time_is_all_shown():
    frames, head = Frames(count=12, budget=1000), Playhead(12, fps=20)
    frames.run(head, 1.0, decode=0.02)
    head.play(frames.now)
    shown = frames.run(head, 1.19, decode=0.02)
    assert shown == [*range(1, 12), *range(12)]
    assert len(frames.started) == 11, "nothing is decoded twice"


@pytest.mark.parametrize(("workers", "rate"), [(1, 10), (2, 20)])
def test_frames_that_come_too_late_are_dropped_evenly_and_never_lag(workers, rate):
    # 100 frames a second wanted; a tenth of a second for each. The budget holds a few.
    frames, head = Frames(count=1000, budget=100, workers=workers), Playhead(1000, fps=100)
    head.play(0.0)
    frames.run(head, 1.0, decode=0.1)
    begun, before = head.tick, len(frames.started)
    shown = frames.run(head, 5.0, decode=0.1)
    assert len(frames.started) - before == pytest.approx(5 * rate, rel=0.1)
    assert len(shown) > 0.7 * 5 * rate, "most of what is decoded is shown"
    gaps = [b - a for a, b in pairwise(shown)]
    assert min(gaps) > 0 and max(gaps) <= 25 and head.tick - begun == pytest.approx(500, abs=2)
    assert head.tick - shown[-1] <= 25, "what is shown is what is due"


def test_a_loop_that_does_not_fit_keeps_what_comes_next():
    frames, head = Frames(count=30, budget=105), Playhead(30, fps=10)
    head.play(0.0)
    shown = frames.run(head, 9.0, decode=0.02)
    assert shown[3:60] == [index % 30 for index in range(shown[3], shown[3] + 57)]
    assert len(cached(frames)) == 10


def test_two_frames_are_kept_whatever_they_take():
    frames, head = Frames(count=5, budget=0), Playhead(5, fps=10)
    head.play(0.0)
    shown = frames.run(head, 4.0, decode=0.02)
    assert set(shown) == set(range(5))


def test_a_frame_that_cannot_be_read_is_told_once_and_not_tried_again():
    frames, head = Frames(count=4, budget=1000), Playhead(4, fps=10)
    said = []
    for _ in range(20):
        said += frames.cache.advance(head, 0.0)
        for one in frames.started:
            if not one.done:
                one.end("2.ply: damaged" if one.index == 2 else None)
    assert said == ["2.ply: damaged"]
    assert [frames.cache.state(index) for index in range(4)] == ["cached", "cached", "failed", "cached"]
    assert sorted(one.index for one in frames.started) == [1, 2, 3]
    head.play(0.0)
    assert 2 not in frames.run(head, 2.0, decode=0.01)


def test_closing_gives_up_what_is_under_way():
    frames, head = Frames(count=4, budget=1000), Playhead(4, fps=10)
    frames.cache.advance(head, 0.0)
    frames.cache.close()
    assert frames.started[0].cancelled and frames.cache.used == 0


def test_while_the_slider_is_held_the_nearest_frame_is_shown():
    frames, head = Frames(count=100, budget=1000), Playhead(100, fps=10)
    player = Player(sequence=cast(Any, None), head=head, cache=cast(Any, frames.cache), shown=0)
    frames.cache.add(60, 60)
    head.seek(70)
    assert player.target() is None
    player.dragging = True
    assert player.target() == (60, 70)
    player.shown = 65
    assert player.target() is None, "what is shown is nearer"
