"""Who helps whom: kernels of a thread that gives way are helped by threads that give way, too."""

from __future__ import annotations

import os
import sys
import threading
import time

import pytest

from splatview.raster.compiling import even_ranges, niceness, run

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has priorities of threads")


def helpers_niceness() -> set[int]:
    """Of all threads that take part in a call from this one."""
    together = threading.Barrier(2, timeout=30)

    def kernel(_: int) -> int:
        together.wait()  # two tasks at once: the caller cannot do both
        return niceness()

    return set(run(kernel, [(0,), (1,)], (), threads=2))


def test_helpers_are_as_nice_as_their_caller() -> None:
    own, found = niceness(), {}

    def yielding() -> None:
        os.setpriority(os.PRIO_PROCESS, 0, own + 3)
        found["yielding"] = helpers_niceness()

    thread = threading.Thread(target=yielding)
    thread.start()
    thread.join()
    assert found["yielding"] == {own + 3}
    assert helpers_niceness() == {own}
    assert niceness() == own


def test_an_exception_ends_the_call_after_the_tasks_begun() -> None:
    ended = []

    def kernel(task: int) -> None:
        if task == 0:
            raise ValueError("the first")
        time.sleep(0.01)
        ended.append(task)

    with pytest.raises(ValueError, match="the first"):
        run(kernel, [(task,) for task in range(2000)], (), threads=2)
    assert len(ended) < 1999, "nobody begins another task"


@pytest.mark.parametrize(("count", "pieces", "step"), [(0, 4, 1), (10, 4, 1), (5000, 8, 1024), (1, 9, 16)])
def test_ranges_cover_everything_once(count: int, pieces: int, step: int) -> None:
    ranges = even_ranges(count, pieces, step=step)
    assert [place for start, stop in ranges for place in range(start, stop)] == list(range(count))
    assert all(start % step == 0 for start, _ in ranges)
    assert len(ranges) <= pieces
