"""The CPU renderer in its own thread: never waits, coarse when moving, exact at rest, survives trouble."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from splatview import raster
from splatview.renderers import async_renderer, quality
from splatview.renderers.async_renderer import AsyncRenderer
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import RenderSettings, look_at

SETTINGS = RenderSettings(background=(0.1, 0.2, 0.3))


def camera(angle: float = 0.0, width: int = 96, height: int = 64):
    eye = (3 * np.sin(angle), 0.5, -3 * np.cos(angle))
    return look_at(eye, (0, 0, 0), width=width, height=height)


class Shown(AsyncRenderer):
    """Keeps the latest picture, as a window does."""

    image = np.zeros((1, 1, 4), np.float32)

    def __init__(self, **options) -> None:
        super().__init__(CpuRenderer(), **options)
        self.threads = 1

    def draw(self, request: FrameRequest) -> None:
        super().draw(request)
        new = self.take_picture()
        self.image = self.image if new is None else new

    @property
    def size(self) -> tuple[int, int]:
        return self.image.shape[1], self.image.shape[0]


@pytest.fixture
def texture() -> Iterator[Shown]:
    made = Shown()
    yield made
    made.close()


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 200
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.002)


def rest(texture: Shown, view, settings=SETTINGS) -> np.ndarray:
    """Asks for the same picture until it is the final one."""

    def final() -> bool:
        texture.draw(FrameRequest(None, view, settings))
        return not texture.busy

    until(final)
    return texture.image


def test_at_rest_it_is_the_rasterisers_picture(texture, random_gaussians):
    scene = random_gaussians(500)
    texture.load(scene)
    shown = rest(texture, camera())
    np.testing.assert_array_equal(shown, raster.render(scene, camera(), SETTINGS))
    assert texture.stats().splats == 500
    assert 0 < texture.stats().visible <= 500
    assert set(texture.stats().ms) >= {"project", "sort", "forward"}


def test_nothing_is_drawn_again_while_nothing_changes(texture, random_gaussians):
    texture.load(random_gaussians(200))
    rest(texture, camera())
    before = texture.stats().drawn
    for _ in range(50):
        texture.draw(FrameRequest(None, camera(), SETTINGS))
        time.sleep(0.001)
    assert texture.stats().drawn == before
    rest(texture, camera(0.1))
    assert texture.stats().drawn > before


def test_drawing_never_waits_and_the_latest_wish_wins(texture, random_gaussians, monkeypatch):
    texture.load(random_gaussians(300))
    rest(texture, camera())
    gate, entered, angles = threading.Event(), threading.Event(), []
    real = raster.draw_frame

    def held(splats, view, *args, **options):
        angles.append(round(float(np.arctan2(view.eye[0], -view.eye[2])), 3))
        entered.set()
        assert gate.wait(200)
        return real(splats, view, *args, **options)

    monkeypatch.setattr(raster, "draw_frame", held)
    texture.draw(FrameRequest(None, camera(0.1), SETTINGS))
    assert entered.wait(200)
    for step in range(2, 9):
        texture.draw(FrameRequest(None, camera(step / 10), SETTINGS))
    assert texture.busy
    gate.set()
    rest(texture, camera(0.8))
    assert set(angles) == {0.1, 0.8}, "wishes overtaken meanwhile are never drawn"


def never_rests(monkeypatch) -> None:
    """A camera counts as moving however long it stays where it is; undone by `rests_again`."""
    monkeypatch.setattr(async_renderer, "REST_SECONDS", math.inf)


def rests_again(monkeypatch) -> None:
    monkeypatch.setattr(async_renderer, "REST_SECONDS", 0.0)


def slow_and_not_priced(monkeypatch) -> None:
    """Moving pictures stay at half the size."""
    monkeypatch.setattr(async_renderer, "MOVING_MS", 0.0)
    monkeypatch.setattr(AsyncRenderer, "_look_for_shortcuts", lambda *_: None)


def test_moving_pictures_are_smaller_where_they_are_slow(texture, random_gaussians, monkeypatch):
    scene = random_gaussians(300)
    texture.load(scene)
    slow_and_not_priced(monkeypatch)
    rest(texture, camera())
    before = texture.stats().drawn
    never_rests(monkeypatch)
    texture.draw(FrameRequest(None, camera(0.2), SETTINGS))
    until(lambda: texture.stats().drawn > before)
    texture.draw(FrameRequest(None, camera(0.2), SETTINGS))
    assert texture.size == (48, 32)
    assert texture.busy, "the sharp one is still to come"
    rests_again(monkeypatch)
    np.testing.assert_array_equal(rest(texture, camera(0.2)), raster.render(scene, camera(0.2), SETTINGS))


def test_a_scene_that_changes_before_an_eye_at_rest_is_sharp_at_once(texture, random_gaussians, monkeypatch):
    first, second = random_gaussians(300), random_gaussians(300, seed=1)
    texture.load(first)
    slow_and_not_priced(monkeypatch)
    rest(texture, camera())
    texture.draw(FrameRequest(None, camera(0.2), SETTINGS))
    rest(texture, camera(0.2))
    before = texture.stats().drawn
    texture.load(second)
    shown = rest(texture, camera(0.2))
    assert texture.stats().drawn == before + 1, "no coarse picture came first"
    np.testing.assert_array_equal(shown, raster.render(second, camera(0.2), SETTINGS))
    texture.load(first)
    never_rests(monkeypatch)
    texture.draw(FrameRequest(None, camera(0.3), SETTINGS))
    until(lambda: texture.stats().drawn > before + 1)
    texture.draw(FrameRequest(None, camera(0.3), SETTINGS))
    assert texture.size == (48, 32), "an eye that moves gets the coarse one"


def test_a_new_scene_makes_the_old_picture_stale(texture, random_gaussians):
    first, second = random_gaussians(100), random_gaussians(100, seed=9)
    texture.load(first)
    rest(texture, camera())
    texture.load(second)
    np.testing.assert_array_equal(rest(texture, camera()), raster.render(second, camera(), SETTINGS))


def test_a_failure_is_told_and_the_next_picture_comes(texture, random_gaussians, monkeypatch):
    texture.load(random_gaussians(100))
    rest(texture, camera())

    def fail(*_, **__):
        raise MemoryError("no room")

    with monkeypatch.context() as patched:
        patched.setattr(raster, "draw_frame", fail)
        rest(texture, camera(0.3))
        assert texture.problem is not None
        assert "no room" in texture.problem
    assert np.isfinite(rest(texture, camera(0.4))).all()


def test_ready_pictures_wake_the_window(random_gaussians):
    woken = threading.Event()
    texture = Shown(on_ready=woken.set)
    try:
        texture.load(random_gaussians(50))
        texture.draw(FrameRequest(None, camera(), SETTINGS))
        assert woken.wait(200)
    finally:
        texture.close()


def test_it_ends_while_a_picture_is_under_way(random_gaussians):
    texture = Shown()
    texture.load(random_gaussians(2000))
    texture.draw(FrameRequest(None, camera(width=640, height=480), SETTINGS))
    texture.close()
    assert not any(thread.name == "splatview-cpu" and thread.is_alive() for thread in threading.enumerate())


def test_slow_scenes_are_priced_and_move_by_a_shortcut(texture, random_gaussians, monkeypatch):
    monkeypatch.setattr(async_renderer, "PATIENCE", 0.0)
    monkeypatch.setattr(async_renderer, "MOVING_MS", 0.0)  # every picture is slow
    monkeypatch.setattr(quality, "MOVING_MS", 1e-3)  # and so is every shortcut: the quickest is taken
    scene = random_gaussians(3000)
    texture.load(scene)

    def planned() -> bool:
        # The first picture of a scene is never the measure.
        for angle in (0.0, 0.1):
            rest(texture, camera(angle))
        return texture._plan is not None

    until(planned)
    before = texture.stats().drawn
    never_rests(monkeypatch)
    texture.draw(FrameRequest(None, camera(0.5), SETTINGS))
    until(lambda: texture.stats().drawn > before)
    texture.draw(FrameRequest(None, camera(0.5), SETTINGS))
    assert "dB" in texture.note
    assert texture.size != (96, 64) or "of the splats" in texture.note
    rests_again(monkeypatch)
    np.testing.assert_array_equal(rest(texture, camera(0.5)), raster.render(scene, camera(0.5), SETTINGS))
    assert texture.note == "", "a picture at rest leaves nothing out"
    texture.load(random_gaussians(10))
    rest(texture, camera(0.5))
    # The new one may have been priced by now: every picture counts as slow here.
    for plan in (texture._plan, texture._followed):
        assert plan is None or plan.gaussians is not scene, "the old scene is let go"


def test_waiting_ends_with_the_picture_and_at_once_where_none_comes(texture, random_gaussians, monkeypatch):
    texture.load(random_gaussians(300))
    rest(texture, camera())
    begun = time.monotonic()
    texture.wait(200)
    gate, real = threading.Event(), raster.draw_frame

    def held(*args, **options):
        assert gate.wait(200)
        return real(*args, **options)

    monkeypatch.setattr(raster, "draw_frame", held)
    texture.draw(FrameRequest(None, camera(0.2), SETTINGS))
    texture.wait(0.01)  # in vain
    threading.Timer(0.05, gate.set).start()
    drawn = texture.stats().drawn
    texture.wait(200)
    assert texture.stats().drawn > drawn
    assert time.monotonic() - begun < 190
    until(lambda: not texture._drawing)


def test_what_fails_while_pricing_is_told_and_pictures_go_on(texture, random_gaussians, monkeypatch):
    def fail(*_, **__):
        raise MemoryError("no room for levels")

    monkeypatch.setattr(async_renderer, "PATIENCE", 0.0)
    monkeypatch.setattr(async_renderer, "MOVING_MS", 0.0)
    monkeypatch.setattr(async_renderer, "make_levels", fail)
    texture.load(random_gaussians(100))

    def told() -> bool:
        for angle in (0.0, 0.1):
            assert np.isfinite(rest(texture, camera(angle))).all()
        return texture.problem is not None

    until(told)
    assert "no room for levels" in texture.problem


def test_pictures_keep_to_their_share_of_the_cores(texture, random_gaussians, monkeypatch):
    """After each picture the worker rests until its processor time is within what it may take."""
    rests = []
    wait_for = threading.Condition.wait_for

    def noted(self, predicate, timeout=None):
        if threading.current_thread().name == "splatview-cpu":
            rests.append(timeout)
            return wait_for(self, predicate, 0.0)
        return wait_for(self, predicate, timeout)

    monkeypatch.setattr(threading.Condition, "wait_for", noted)
    texture.load(random_gaussians(200))
    rest(texture, camera())
    assert rests == [], "where nothing is asked for, it never rests"
    texture.cores = 0.5
    began = time.perf_counter()
    rest(texture, camera(0.1))
    took = time.perf_counter() - began
    until(lambda: len(rests) > 0)
    # Twice the picture's time and a frame's, of which the picture's is over; one thread draws.
    assert 2 * async_renderer.FRAME_SECONDS <= rests[0] <= 2 * async_renderer.FRAME_SECONDS + took
