"""What moving pictures leave out: prices measured, the choice by time, and that it does not flicker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatview import raster
from splatview.renderers import quality as moving
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.quality import (
    MOVING_MS,
    MOVING_SLACK,
    Governor,
    Level,
    MovingPlan,
    Shortcut,
    badness,
    best_of,
    doubled,
    make_levels,
    price,
    squared_error,
)
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings, concatenate, look_at
from splatview.scene.framing import views_around

SETTINGS = RenderSettings(background=(0.1, 0.2, 0.3))
CAMERA = look_at((0, 0.5, -3), (0, 0, 0), width=96, height=64)
REQUEST = FrameRequest(None, CAMERA, SETTINGS)


def shortcut(scene: Gaussians, ms: float, error: float, **options) -> Shortcut:
    return Shortcut(gaussians=scene, ms=ms, error=error, **{"kept": 0.5, "scale": 1.0, **options})


def plan_of(scene: Gaussians, *times: float) -> MovingPlan:
    """Shortcuts of `times` ms, ever worse."""
    shortcuts = [shortcut(scene, ms, 0.001 * i) for i, ms in enumerate(times)]
    return MovingPlan(gaussians=scene, levels=(Level(scene),), shortcuts=tuple(shortcuts), work=(100, 1000))


@pytest.fixture
def scene(random_gaussians) -> Gaussians:
    return random_gaussians(400)


@pytest.fixture
def dense(random_gaussians) -> Gaussians:
    """Small splats in a small ball, which merge well."""
    made = random_gaussians(4000)
    return Gaussians(
        means=made.means,
        quats=made.quats,
        log_scales=made.log_scales * 0 - 2.5,
        opacity_logits=made.opacity_logits,
        sh=made.sh,
    )


def test_errors_are_those_of_the_pictures(dense):
    levels = make_levels(dense, lambda: False)
    assert len(levels) > 1
    plan = price(levels, REQUEST, CpuRenderer(), lambda: False)
    assert plan is not None
    assert plan.levels is levels
    views = views_around(CAMERA, dense)
    full = [raster.render(dense, view, SETTINGS)[..., :3] for view in views]
    for one in plan.shortcuts:
        assert one.ms > 0
        if one.is_exact:
            assert one.error == 0
            assert one.note == ""
        elif one.scale == 1:
            assert one.gaussians is not None
            seen = [raster.render(one.gaussians, view, SETTINGS)[..., :3] for view in views]
            assert one.error == pytest.approx(max(map(squared_error, seen, full)), rel=1e-3)
            assert f"{one.kept:.0%} of the splats" in one.note
            assert one.note.endswith("dB at worst in 4 views")


def test_the_error_that_a_badge_states_is_true_of_other_views(random_gaussians):
    """A wall that hides everything from one side: from there nothing is lost."""
    dense = random_gaussians(6000)
    dense = replace(dense, log_scales=dense.log_scales - 1.5)
    wall = random_gaussians(1)
    wall = replace(
        wall,
        means=np.array([[0, 0, -1.5]], np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        log_scales=np.log(np.array([[30, 30, 0.01]], np.float32)),
        opacity_logits=np.array([9], np.float32),
    )
    hidden = concatenate([dense, *[wall] * 4])
    plan = price(make_levels(hidden, lambda: False), REQUEST, CpuRenderer(), lambda: False)
    assert plan is not None
    quick = max((one for one in plan.shortcuts if one.scale == 1), key=lambda one: one.error or 0)
    assert quick.gaussians is not None and quick.error is not None
    for view in views_around(CAMERA, hidden):
        pictures = [raster.render(each, view, SETTINGS)[..., :3] for each in (hidden, quick.gaussians)]
        assert squared_error(pictures[0], pictures[1]) <= quick.error * 1.001


def test_every_shortcut_is_the_best_for_its_time(dense):
    plan = price(make_levels(dense, lambda: False), REQUEST, CpuRenderer(), lambda: False)
    assert plan is not None
    times = [one.ms for one in plan.shortcuts]
    errors = [badness(one) for one in plan.shortcuts]
    assert times == sorted(times, reverse=True)
    assert errors == sorted(errors)
    assert any(one.is_exact for one in plan.shortcuts), "nothing is better than the full picture"


def test_what_is_slower_and_worse_is_left_out(scene):
    good, dominated, quick = (shortcut(scene, *values) for values in ((5, 0.1), (6, 0.2), (1, 0.5)))
    assert best_of([dominated, quick, good]) == (good, quick)


def test_pricing_ends_when_it_is_told_to(dense):
    assert price((Level(dense),), REQUEST, CpuRenderer(), lambda: True) is None
    assert len(make_levels(dense, lambda: True)) == 2


def test_levels_that_cost_too_much_memory_are_not_kept(dense, monkeypatch):
    monkeypatch.setattr(moving, "MOST_BYTES", 0)
    (only,) = make_levels(dense, lambda: False)
    assert only.gaussians is dense


def test_the_finest_that_the_time_allows_is_chosen(scene):
    governor = Governor()
    governor.follow(plan_of(scene, 4 * MOVING_MS, 0.9 * MOVING_MS, 0.2 * MOVING_MS).shortcuts)
    assert governor.step is not None
    assert governor.step.ms == 0.9 * MOVING_MS


def test_where_nothing_is_quick_enough_the_quickest_is_taken(scene):
    governor = Governor()
    governor.follow(plan_of(scene, 9 * MOVING_MS, 3 * MOVING_MS).shortcuts)
    assert governor.step is not None
    assert governor.step.ms == 3 * MOVING_MS


def test_a_machine_that_got_slower_is_followed_and_one_that_trembles_is_not(scene):
    governor = Governor()
    governor.follow(plan_of(scene, 4 * MOVING_MS, 0.95 * MOVING_MS, 0.2 * MOVING_MS).shortcuts)
    first = governor.step
    assert first is not None
    for step in range(40):
        governor.learn(first, first.ms * (1 + 0.15 * (-1) ** step))
        assert governor.step is first, "noise changes nothing"
    for _ in range(20):
        now = governor.step
        assert now is not None
        governor.learn(now, 2 * MOVING_SLACK * now.ms)
    assert governor.step is not first
    for _ in range(40):
        now = governor.step
        assert now is not None
        governor.learn(now, 0.7 * now.ms)
    assert governor.step is first, "and when it has become quick again, the finer one returns"


def test_prices_hold_for_views_of_about_the_same_work(scene):
    plan = plan_of(scene, 1.0)
    assert plan.holds_for((110, 900))
    assert not plan.holds_for((10, 1000))
    assert not plan.holds_for((100, 4000))
    assert not plan.holds_for((0, 0))


def test_pictures_are_doubled_as_the_window_shows_them():
    ramp = np.linspace(0, 1, 6)[None, :, None] * np.ones((4, 1, 3))
    big = doubled(ramp)
    assert big.shape == (8, 12, 3)
    steps = np.diff(big[0, 1:-1, 0])
    np.testing.assert_allclose(steps, steps[0])
    np.testing.assert_allclose(doubled(np.full((1, 1, 3), 0.3)), 0.3)


@given(st.lists(st.tuples(st.integers(0, 2), st.floats(0, 1e6)), max_size=30))
def test_whatever_is_measured_a_shortcut_of_the_plan_is_chosen(random_gaussians_once, measured):
    plan = plan_of(random_gaussians_once, 100.0, 10.0, 1.0)
    governor = Governor()
    governor.follow(plan.shortcuts)
    for which, ms in measured:
        governor.learn(plan.shortcuts[which], ms)
        assert governor.step in plan.shortcuts


@pytest.fixture(scope="module")
def random_gaussians_once() -> Gaussians:
    return Gaussians(
        means=np.zeros((1, 3), np.float32),
        quats=np.ones((1, 4), np.float32),
        log_scales=np.zeros((1, 3), np.float32),
        opacity_logits=np.zeros(1, np.float32),
        sh=np.zeros((1, 1, 3), np.float32),
    )
