"""Stage timers: every stage gets a time, and reading is late rather than waited for."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from splatview.renderers.gl.renderer import FRAMES_IN_FLIGHT, StageTimers


class FakeQuery:
    """A timer query that notes when it is read."""

    made: list[FakeQuery]

    def __init__(self) -> None:
        FakeQuery.made.append(self)
        self.uses = 0
        self.reads = 0

    def __enter__(self) -> None:
        self.uses += 1

    def __exit__(self, *error: object) -> None:
        pass

    @property
    def elapsed(self) -> int:
        self.reads += 1
        return self.uses * 1_000_000


@pytest.fixture
def gpu_timers() -> StageTimers:
    FakeQuery.made = []
    info = {"GL_VENDOR": "", "GL_RENDERER": "some GPU", "GL_VERSION": ""}
    context = SimpleNamespace(info=info, version_code=430, query=lambda time: FakeQuery())
    return StageTimers(context)  # pyright: ignore[reportArgumentType]


def test_results_are_read_a_few_frames_later(gpu_timers):
    for _ in range(FRAMES_IN_FLIGHT):
        with gpu_timers.stage("sort"):
            pass
    assert gpu_timers.latest == {}
    assert all(query.reads == 0 for query in FakeQuery.made)
    with gpu_timers.stage("sort"):
        pass
    assert gpu_timers.latest == {"sort": 1.0}
    assert sum(query.reads for query in FakeQuery.made) == 1


def test_queries_are_used_again(gpu_timers):
    for _ in range(50):
        with gpu_timers.stage("project"):
            pass
        with gpu_timers.stage("draw"):
            pass
    assert len(FakeQuery.made) <= 2 * (FRAMES_IN_FLIGHT + 1)


def test_finish_reads_all(gpu_timers):
    for name in ("project", "sort", "draw"):
        with gpu_timers.stage(name):
            pass
    assert set(gpu_timers.finish()) == {"project", "sort", "draw"}


def test_time_on_a_real_context(ctx):
    timers = StageTimers(ctx)
    buffer = ctx.buffer(reserve=1 << 20)
    began = time.perf_counter()
    for _ in range(3):
        with timers.stage("clear"):
            buffer.clear()
    ctx.finish()
    passed = (time.perf_counter() - began) * 1000
    assert 0 <= timers.finish()["clear"] <= passed
    buffer.release()
