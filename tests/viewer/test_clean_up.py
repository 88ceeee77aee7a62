"""Clean-up measures by itself what each detector finds and what deleting that costs."""

from __future__ import annotations

import threading
import time

import pytest

from splatview.edit.detectors import DETECTORS
from splatview.edit.document import Document
from splatview.edit.operations import Select
from splatview.edit.selectors import Everything
from splatview.renderers.cpu import CpuRenderer
from splatview.viewer.editing import cleanup
from splatview.viewer.editing.cleanup import CALM_SECONDS, COUNTING, PRICING, is_counted, is_priced
from splatview.viewer.editing.session import Editing, EditSession


class Clock:
    seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


@pytest.fixture
def opened(app, random_gaussians, monkeypatch) -> EditSession:
    """A session whose window draws a frame each time that `frame` is called."""
    monkeypatch.setattr(cleanup, "VIEWS", 2)
    app.now = Clock()
    scene = random_gaussians(300, seed=3)
    scene.log_scales[:20] = 1.5  # giants
    session = EditSession(document=Document(scene, tools=CpuRenderer()))
    app.feature(Editing).session = session
    return session


def frame(app, session, *, after: float = 0.0, touched: bool = False) -> str:
    """The next frame, so many seconds later; title of what is measured in it."""
    app.now.seconds += after
    session.advance()
    cleanup.keep_measured(app, session, touched=touched)
    return "" if session.job is None else session.job.title


def finish(app, session) -> None:
    limit = time.monotonic() + 200
    while session.job is not None:
        assert time.monotonic() < limit
        session.advance()
        time.sleep(0.002)


def test_counts_come_at_once_and_prices_when_all_is_calm(app, opened):
    assert frame(app, opened) == COUNTING
    finish(app, opened)
    assert not any(
        is_priced(opened, name) for name in DETECTORS if opened.forms.clean.counts.get(name, (0, 1))[1]
    )
    assert frame(app, opened, after=0.5 * CALM_SECONDS) == ""
    assert frame(app, opened, after=0.6 * CALM_SECONDS) == PRICING
    finish(app, opened)
    assert all(is_counted(opened, name) and is_priced(opened, name) for name in DETECTORS)
    prices = opened.forms.clean.prices
    assert prices, "something is found"
    for name, (_, impact) in prices.items():
        assert impact.views == 2 and impact.count == opened.forms.clean.counts[name][1]
    assert frame(app, opened, after=9.0) == "", "once for each state of the scene"
    assert opened.news is None and opened.given_up is None and opened.problem is None
    opened.apply(Select(by=Everything()))
    assert frame(app, opened, after=9.0) in ("", COUNTING)


def test_prices_give_way_to_the_mouse_and_go_on(app, opened, monkeypatch):
    frame(app, opened)
    finish(app, opened)
    frame(app, opened)
    go_on, compare = threading.Event(), cleanup.compare
    monkeypatch.setattr(cleanup, "compare", lambda *images: go_on.wait(200) and compare(*images))
    assert frame(app, opened, after=2 * CALM_SECONDS) == PRICING
    job = opened.job
    assert frame(app, opened, touched=True) == "" and job is not None and job.cancelled
    go_on.set()
    assert frame(app, opened, after=0.5 * CALM_SECONDS) == ""
    assert frame(app, opened, after=CALM_SECONDS) == PRICING
    finish(app, opened)
    assert all(is_priced(opened, name) for name in DETECTORS)
    assert opened.news is None and opened.given_up is None


def test_what_the_user_cancels_is_not_measured_again_before_the_next_edit(app, opened):
    frame(app, opened)
    finish(app, opened)
    frame(app, opened)
    assert frame(app, opened, after=2 * CALM_SECONDS) == PRICING
    app.feature(Editing).cancel(app)
    finish(app, opened)
    if not all(is_priced(opened, name) for name in DETECTORS):
        assert frame(app, opened, after=9.0) == ""
        assert "cancelled" in (opened.news or "")
