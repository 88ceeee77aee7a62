"""Curves that stay short however long the run."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from splatview.trainer.counters import History


def test_rows_come_back_as_they_were_added() -> None:
    history = History(("iteration", "loss"))
    for i in range(5):
        history.add(i, 2 * i)
    iteration, loss = history.read("iteration", "loss")
    assert iteration.tolist() == [0, 1, 2, 3, 4] and loss.tolist() == [0, 2, 4, 6, 8]
    assert len(history) == 5


def test_a_long_run_is_kept_whole_in_means_of_equal_numbers_of_steps() -> None:
    history = History(("iteration",), limit=8)
    for i in range(64):
        history.add(i)
        (iteration,) = history.read("iteration")
        assert len(iteration) <= 8
        strides = np.diff(iteration)
        assert (strides == strides[:1]).all(), "evenly spaced"
        stride = strides[0] if len(strides) else 1
        assert iteration[0] == (stride - 1) / 2, "from the first step on"
        assert i - iteration[-1] < 2 * stride, "to nearly the last"


def test_what_was_read_does_not_change() -> None:
    history = History(("x",), limit=4)
    for i in range(4):
        history.add(i)
    (before,) = history.read("x")
    for _ in range(100):
        history.add(-1)
    assert before.tolist() == [0, 1, 2, 3]


def test_readers_see_whole_rows_while_another_thread_adds() -> None:
    history = History(("x", "twice"), limit=64)
    stop = threading.Event()

    def write() -> None:
        i = 0
        while not stop.is_set():
            history.add(i, 2 * i)
            i += 1

    thread = threading.Thread(target=write)
    thread.start()
    try:
        for _ in range(3000):
            x, twice = history.read("x", "twice")
            assert len(x) == len(twice)
            np.testing.assert_array_equal(twice, 2 * x)
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize("limit", [0, 3])
def test_a_limit_must_be_even(limit) -> None:
    with pytest.raises(ValueError, match="even"):
        History(("x",), limit=limit)
