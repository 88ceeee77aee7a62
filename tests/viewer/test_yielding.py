"""A window beside a training gives way to it, and slow work gives way to the window."""

from __future__ import annotations

import sys
import threading

import pytest

from splatview.raster.compiling import niceness
from splatview.viewer.editing.job import NICER, Job
from splatview.viewer.platform import NICENESS, give_way

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has priorities of threads")


def test_the_thread_and_those_it_starts_are_nicer_and_nobody_else():
    own, found = niceness(), {}

    def window() -> None:
        older = threading.Thread(target=lambda: (gate.wait(), found.update(older=niceness())))
        older.start()
        assert give_way()
        assert give_way(), "once more changes nothing"
        younger = threading.Thread(target=lambda: found.update(younger=niceness()))
        younger.start()
        gate.set()
        older.join()
        younger.join()
        found["window"] = niceness()

    gate = threading.Event()
    thread = threading.Thread(target=window)
    thread.start()
    thread.join()
    lowered = max(own, NICENESS)
    assert found == {"older": own, "younger": lowered, "window": lowered}
    assert niceness() == own


def test_slow_work_gives_way_to_the_window_which_keeps_its_priority():
    own = niceness()
    job = Job("Counting", lambda progress: niceness(), lambda result: None)
    job.join(200)
    assert job.result == min(own + NICER, 19) and niceness() == own
