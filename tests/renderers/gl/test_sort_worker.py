"""The depth order from a thread: right, latest wins, never in the way."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from splatview.raster import Workspace
from splatview.renderers.gl import sort_thread as sort_worker
from splatview.renderers.gl.sort_thread import SortWorker, ViewLine, depth_order
from splatview.scene import look_at

AHEAD = ViewLine((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def view_at(x: float) -> ViewLine:
    return ViewLine((x, 0.0, 0.0), (1.0, 0.0, 0.0))


@pytest.fixture
def worker(rng):
    worker = SortWorker(rng.normal(size=(1000, 3)).astype(np.float32))
    yield worker
    worker.release()


@pytest.fixture
def gate(monkeypatch):
    """Sorting waits until the gate is set; `gate.views` lists what was sorted."""
    gate = threading.Event()
    views = []

    def gated(means, view, workspace):
        gate.wait(20)
        views.append(view)
        return depth_order(means, view, workspace)

    monkeypatch.setattr(sort_worker, "depth_order", gated)
    gate.views = views  # pyright: ignore[reportAttributeAccessIssue]
    return gate


@pytest.mark.parametrize("size", [0, 1, 2, 4095, 70_000])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_front_to_back_then_what_is_behind(rng, size, dtype):
    means = rng.normal(size=(size, 3)).astype(dtype)
    camera = look_at((0.3, -0.2, 0.1), (1, 2, 3))
    result = depth_order(means, ViewLine.of(camera), Workspace())
    depths = ((means - camera.eye) @ camera.forward).astype(np.float32)
    before = np.flatnonzero(depths >= 0)
    behind = np.flatnonzero(depths < 0)
    expected = np.concatenate(
        [
            before[np.argsort(depths[before], kind="stable")],
            behind[np.argsort(-depths[behind], kind="stable")],
        ]
    )
    assert result.before_eye == len(before)
    np.testing.assert_array_equal(result.order, expected)


def test_ties_go_by_index():
    means = np.tile(np.array([0, 0, 2], np.float32), (5000, 1))
    means[::2, 2] = 1
    order = depth_order(means, AHEAD, Workspace()).order
    np.testing.assert_array_equal(order, [*range(0, 5000, 2), *range(1, 5000, 2)])


def test_splats_without_a_depth_come_last():
    depths = np.array([np.nan, 3, -np.inf, 1, np.inf, -np.nan, 2, -1], np.float32)
    means = np.stack([np.zeros_like(depths), np.zeros_like(depths), depths], axis=1)
    result = depth_order(means, ViewLine((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), Workspace())
    # 0 times infinity is not a number: infinite means have no depth in any direction but their own
    assert list(result.order[:3]) == [3, 6, 1]
    assert sorted(result.order.tolist()) == list(range(8))
    assert result.order.tolist().index(7) >= 3


def test_far_from_the_origin_neighbours_keep_their_order():
    """At 10⁷ m float32 depths of the means themselves are a metre apart; the order must not be."""
    means = np.array([[1e7, 0, 0.03], [1e7, 0, 0.01], [1e7, 0, 0.02]])
    view = ViewLine((1e7, 0.0, -1.0), (0.0, 0.0, 1.0))
    assert depth_order(means, view, Workspace()).order.tolist() == [1, 2, 0]


def test_the_result_stays_when_the_workspace_is_used_again(rng):
    means, workspace = rng.normal(size=(3000, 3)), Workspace()
    first = depth_order(means, AHEAD, workspace)
    kept = first.order.copy()
    depth_order(-means, AHEAD, workspace)
    np.testing.assert_array_equal(first.order, kept)


def test_wait_gives_the_order_of_the_last_request(worker):
    for x in range(20):
        worker.request(view_at(float(x)))
    result = worker.wait()
    assert result.view == view_at(19.0)
    assert worker.newest() is result
    assert not worker.busy


def test_requests_overtaken_are_dropped(worker, gate):
    for x in range(100):
        worker.request(view_at(float(x)))
        time.sleep(0.001)
    assert worker.busy
    assert worker.newest() is None
    gate.set()
    worker.wait()
    assert gate.views[-1] == view_at(99.0)
    assert len(gate.views) <= 2


def test_the_same_request_again_sorts_nothing(worker):
    worker.request(AHEAD)
    first = worker.wait()
    worker.request(ViewLine((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    assert not worker.busy
    assert worker.wait() is first


def test_an_earlier_order_is_there_while_the_next_is_made(worker, gate):
    gate.set()
    worker.request(view_at(0.0))
    first = worker.wait()
    gate.clear()
    worker.request(view_at(1.0))
    assert worker.newest() is first
    assert worker.busy
    gate.set()
    assert worker.wait().view == view_at(1.0)


def test_an_error_in_the_thread_is_raised_to_who_asks(worker, monkeypatch):
    def fail(*arguments):
        raise MemoryError("not enough")

    monkeypatch.setattr(sort_worker, "depth_order", fail)
    worker.request(AHEAD)
    with pytest.raises(RuntimeError, match="sorting in the background failed") as caught:
        worker.wait()
    assert isinstance(caught.value.__cause__, MemoryError)
    with pytest.raises(RuntimeError, match="sorting in the background failed"):
        worker.newest()


def test_waiting_for_nothing_is_refused(worker):
    with pytest.raises(RuntimeError, match="no order was asked for"):
        worker.wait()


def test_release_ends_the_thread(rng):
    worker = SortWorker(rng.normal(size=(10, 3)))
    worker.request(AHEAD)
    worker.release()
    assert not worker._thread.is_alive()
