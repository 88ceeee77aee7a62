"""The window's side of a training without a window: what is taken over when, shares, comparisons, cameras."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.raster import render
from splatview.renderers import FrameStats
from splatview.scene import RenderSettings, look_at
from splatview.scene.captures.demo import demo_capture
from splatview.trainer.background import BackgroundTraining
from splatview.trainer.evaluate import evaluate
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.run import Outputs, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.splats import Splats, copied
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainViews, train_views
from splatview.viewer.navigation import orbit
from splatview.viewer.overlays import nearest, shows_cameras
from splatview.viewer.panels.training import limits
from splatview.viewer.state import AppState
from splatview.viewer.training import live as actions
from splatview.viewer.training import live as watching
from splatview.viewer.training.comparison import Comparer, ComparisonRequest, compare, shrink_for
from splatview.viewer.training.live import LiveTraining, viewer_threads, watched_photos


@pytest.fixture(scope="module")
def capture():
    return demo_capture(render, photos=9, width=48, height=36, splats=1500)


@pytest.fixture
def training(app, capture, tmp_path) -> Iterator[LiveTraining]:
    """A training that `app` watches; its thread has not begun."""
    shots, held_out = TrainViews(train_views(capture.train), 0), train_views(capture.held_out)
    start = initial_parameters(capture.points, capture.point_colours, capture.scene_radius)
    settings = TrainSettings(iterations=10**6, max_splats=8000)
    trainer = Trainer(shots, start, capture.scene_radius, settings, threads=1)
    outputs = Outputs(
        scene=tmp_path / "pond.ply",
        checkpoint=tmp_path / "pond.safetensors",
        metrics=None,
        pictures=tmp_path / "pictures",
    )
    session = TrainingRun(trainer, held_out, outputs, started=time.perf_counter(), eval_every=10**6)
    thread = BackgroundTraining(session, cores=4)
    live = LiveTraining(
        thread=thread,
        name="pond",
        photos=watched_photos(shots.all, held_out),
        settings=trainer.render_settings,
    )
    app.add(live)
    yield live
    live.close(app)
    thread.close()


def until(app: AppState, condition: Callable[[], Any], what: str) -> None:
    """Runs the part of the frame loop that trainings need."""
    limit = time.monotonic() + 200
    while not condition():
        assert time.monotonic() < limit, f"waited in vain for {what}"
        app.run_posted()
        if live := app.find(LiveTraining):
            live.before_frame(app)
        time.sleep(0.001)


def test_the_first_snapshot_is_shown_from_a_photos_camera(app, training):
    training.start(app)
    until(app, lambda: app.is_open, "a scene")
    assert app.is_open and app.scene.name == "pond (training)"
    assert app.scene.paths == (training.thread.outputs.scene,)
    middle = training.photos[len(training.photos) // 2].camera
    np.testing.assert_allclose(app.camera.eye, middle.eye, atol=1e-9)
    np.testing.assert_allclose(app.camera.forward, middle.forward, atol=1e-9)
    assert app.view.distance > 0
    assert app.settings.background == training.settings.background
    assert [camera.name for camera in app.cameras] == sorted(camera.name for camera in app.cameras)
    assert shows_cameras(app)


def test_snapshots_reach_the_picture_in_order_and_the_view_stays(app, training):
    training.start(app)
    until(app, lambda: app.is_open, "a scene")
    app.steer(look(app, 0.3))
    view = app.view
    seen = []
    until(app, lambda: seen_steps(training, seen) >= 3, "three snapshots")
    assert seen == sorted(set(seen))
    assert app.view is view, "a new snapshot moves nobody"
    assert app.picture.loaded[-1] is training.shown.gaussians is app.scene.gaussians


def seen_steps(training: LiveTraining, seen: list[int]) -> int:
    if training.shown is not None and training.shown.iteration not in seen:
        seen.append(training.shown.iteration)
    return len(seen)


def look(app: AppState, angle: float):
    return orbit(app.view, angle, 0.0)


def test_a_snapshot_waits_for_the_picture_of_the_last_one(app, training):
    training.start(app)
    until(app, lambda: training.shown is not None, "a snapshot")
    training.before_frame(app)
    app.picture.busy = True
    at = training.shown.iteration
    now = [app.now() + 100.0]  # long after the view was set
    app.now = lambda: now[0]
    for _ in range(50):
        training.before_frame(app)
        time.sleep(0.002)
    assert training.shown.iteration == at
    app.steer(look(app, 0.1))  # while the view moves, something is always being drawn
    training.before_frame(app)
    now[0] += 1.2
    until(app, lambda: training.shown.iteration > at, "a snapshot in spite of it")


def test_nothing_is_shown_in_a_minimised_window(app, training):
    training.start(app)
    until(app, lambda: training.shown is not None, "a snapshot")
    training.minimised = True
    training.before_frame(app)
    assert training.thread.snapshot_seconds is None
    at = training.shown
    until(app, lambda: training.status.iteration > at.iteration + 20, "steps")
    assert training.shown is at
    assert training.idle_fps(app) < 1


def test_shares_follow_the_users_hand(app, training):
    app.prefer(training_share=0.5)
    now = [1000.0]
    app.now = lambda: now[0]
    training.start(app)
    until(app, lambda: app.is_open, "a scene")
    training.before_frame(app)
    assert training.thread.share == 0.5, "the view has just been set"
    assert app.picture.threads == 2, "of four cores"
    assert app.picture.cores == 2
    now[0] += 10
    training.before_frame(app)
    assert training.thread.share == 1.0, "nobody moves the view"
    app.steer(look(app, 0.1))
    training.before_frame(app)
    assert training.thread.share == 0.5
    now[0] += 10
    app.prefer(training_takes_idle_cores=False)
    training.before_frame(app)
    assert training.thread.share == 0.5
    app.prefer(training_share=1.0)
    training.before_frame(app)
    assert app.picture.cores == pytest.approx(0.4), "the view can always be turned"
    training.thread.pause()
    until(app, lambda: app.picture.cores is None, "all cores for the viewer")
    assert app.picture.threads is None


@pytest.mark.parametrize(
    ("share", "cores", "threads"), [(0.5, 2, 1), (1.0, 2, 1), (0.75, 8, 2), (0.1, 4, 3), (0.5, 1, 1)]
)
def test_the_viewer_has_the_rest(share, cores, threads):
    assert viewer_threads(share, cores) == threads


def test_dear_pictures_are_made_less_often(app, training):
    """On a processor that draws, live pictures take a twentieth of the machine at most."""
    app.picture.name = "cpu"
    app.picture.threads = 2
    app.stats = FrameStats(splats=1, visible=1, ms={"forward": 900.0}, projected=1, sorted=1, drawn=1)
    frames = 2 * 0.02  # core-seconds of the window's own for each picture
    training.start(app)
    app.prefer(training_share=0.5)
    training.before_frame(app)
    assert training.thread.snapshot_seconds == pytest.approx((0.9 * 2 + frames) / (0.05 * 4))
    app.prefer(training_updates="low")
    training.before_frame(app)
    assert training.thread.snapshot_seconds == pytest.approx((0.9 * 2 + frames) / (0.02 * 4))
    app.prefer(training_updates="off")
    training.before_frame(app)
    assert training.thread.snapshot_seconds is None
    app.picture.name = "recording"
    app.prefer(training_updates="live")
    training.before_frame(app)
    assert training.thread.snapshot_seconds == 0.1, "a GPU is not counted"


def test_a_scene_that_does_not_fit_is_told_once_and_training_goes_on(app, training):
    app.picture.too_big = 1
    training.start(app)
    until(app, lambda: app.problem is not None, "word of it")
    assert "no longer shown" in app.problem
    assert app.preferences.training_updates == "off"
    at = training.status.iteration
    until(app, lambda: training.status.iteration > at + 5, "steps")


def test_actions_reach_the_thread(app, training, tmp_path):
    training.start(app)
    until(app, lambda: training.status.iteration > 3, "steps")
    app.post(actions.pause_or_resume)
    until(app, lambda: training.status.state == "paused", "the pause")
    at = training.status.iteration
    app.post(actions.step_once)
    until(app, lambda: training.status.iteration == at + 1, "a step")
    app.post(actions.pause_or_resume)
    until(app, lambda: training.status.iteration > at + 3, "more steps")
    app.post(actions.stop_and_save)
    until(app, lambda: training.status.saved_at is not None, "saving")
    assert (tmp_path / "pond.ply").exists()

    asked: dict[str, Any] = {}
    app.choose_files = lambda title, done, **options: asked.update({"done": done, **options})
    app.post(actions.export)
    until(app, lambda: "done" in asked, "the question")
    assert asked["kind"] == "save_scene" and asked["name"].endswith(".ply")
    asked["done"]([tmp_path / "out.ply"])
    until(app, (tmp_path / "out.ply").exists, "the export")
    app.post(actions.change_settings)
    app.post(lambda app: actions.change_settings(app, max_splats=0))
    until(app, lambda: any("max_splats" in message.text for message in app.messages), "a refusal")
    assert training.status.settings.max_splats == 8000


def test_actions_without_a_training_say_so(app):
    actions.pause_or_resume(app)
    assert "Nothing is being trained" in app.messages[-1].text


def test_going_to_a_photo_compares_it(app, training):
    training.start(app)
    until(app, lambda: app.is_open, "a scene")
    actions.go_to_photo(app, 3)
    training.before_frame(app)
    np.testing.assert_allclose(app.camera.eye, training.photos[3].camera.eye, atol=1e-9)
    assert training.photo is training.photos[3]
    app.camera_index = 5  # by the keys that go through the cameras
    training.before_frame(app)
    assert training.photo is training.photos[5]
    actions.compare_photo(app, -1)
    assert training.photo is training.photos[-1]


def test_another_scene_stays_until_the_training_is_asked_for(app, training, random_gaussians):
    training.start(app)
    until(app, lambda: app.is_open, "a scene")
    other = watching.LoadedScene(
        gaussians=random_gaussians(10),
        paths=(Path("other.ply"),),
        name="other",
        centre=np.zeros(3),
        radius=1.0,
        settings=RenderSettings(),
        seconds=0.0,
    )
    app.scene, app.cameras = other, []
    at = training.status.iteration
    until(app, lambda: training.status.iteration > at + 10, "steps")
    assert app.scene is other and not training.followed_by(app) and not shows_cameras(app)
    loaded = len(app.picture.loaded)
    training.thread.pause()
    actions.show_training(app)
    until(app, lambda: len(app.picture.loaded) > loaded, "the scene in training again")
    assert app.scene.name == "pond (training)" and shows_cameras(app)


def test_photos_are_named_as_briefly_as_tells_them_apart(capture):
    shots = train_views(capture.train)
    photos = watched_photos(shots[:2], train_views(capture.held_out))
    assert [photo.name for photo in photos] == sorted(photo.name for photo in photos)
    assert sum(photo.held_out for photo in photos) == len(capture.held_out)

    def named(shot, name):
        return replace(shot, camera=replace(shot.camera, name=name))

    same = [named(shots[0], "left/1.png"), named(shots[1], "right/1.png"), named(shots[2], "left/2.png")]
    assert [photo.label for photo in watched_photos(same, [])] == ["left/1.png", "2.png", "right/1.png"]


# ---- comparisons


def test_a_comparison_is_the_photo_the_render_and_their_difference(capture):
    shot = train_views(capture.photos)[1]
    scene = initial_scene(capture)
    made = compare(
        ComparisonRequest(shot=shot, gaussians=scene, settings=RenderSettings(), shrink=1, gain=2.0)
    )
    np.testing.assert_array_equal(made.photo, shot.pixels)
    expected = render(scene, shot.camera, RenderSettings())[..., :3].clip(0, 1)
    np.testing.assert_allclose(made.render / 255, expected, atol=0.51 / 255)
    apart = np.abs(made.render.astype(int) - made.photo) * 2
    np.testing.assert_allclose(made.difference, np.minimum(apart, 255), atol=1)
    error = np.mean((expected - shot.pixels / 255.0) ** 2)
    assert made.psnr == pytest.approx(-10 * math.log10(error), abs=0.05)

    half = compare(
        ComparisonRequest(shot=shot, gaussians=scene, settings=RenderSettings(), shrink=2, gain=2.0)
    )
    assert half.photo.shape == half.render.shape == half.difference.shape == (18, 24, 3)
    stronger = compare(
        ComparisonRequest(shot=shot, gaussians=scene, settings=RenderSettings(), shrink=2, gain=4.0), 1, half
    )
    assert stronger.render is half.render, "only what has changed is made anew"
    assert stronger.difference.mean() > half.difference.mean()


def initial_scene(capture):
    start = initial_parameters(capture.points, capture.point_colours, capture.scene_radius)
    return Splats(copied(start)).snapshot()


def test_what_a_mask_leaves_out_differs_nowhere(capture):
    shot = train_views(capture.photos)[1]
    mask = np.zeros(shot.pixels.shape[:2], bool)
    mask[:, :10] = True
    masked = replace(shot, mask=mask)
    request = ComparisonRequest(
        shot=masked, gaussians=initial_scene(capture), settings=RenderSettings(), shrink=1, gain=9.0
    )
    made = compare(request)
    assert (made.difference[:, 10:] == 0).all() and made.difference[:, :10].any()


def test_what_is_not_trained_on_is_dark(capture):
    shot = train_views(capture.photos)[1]
    mask = np.ones(shot.pixels.shape[:2], bool)
    mask[:, 10:20] = False
    elsewhere = replace(shot.about(np.array([5.0, 0, 0])), mask=mask)
    whole = ComparisonRequest(
        shot=shot, gaussians=initial_scene(capture), settings=RenderSettings(), shrink=1, gain=9.0
    )
    before = compare(whole)
    made = compare(replace(whole, in_part=elsewhere), 1, before)
    assert (made.photo[:, :10] == shot.pixels[:, :10]).all() and (
        made.photo[:, 20:] == shot.pixels[:, 20:]
    ).all()
    assert made.photo[:, 10:20].max() <= 0.3 * 255 < shot.pixels[:, 10:20].max()
    assert not made.difference[:, 10:20].any() and (made.render == before.render).all()
    assert made.psnr != before.psnr, "it is measured without"


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("exposures_differ", [False, True])
def test_a_photo_has_one_score(training, capture, masked, exposures_differ):
    photo = next(photo for photo in training.photos if photo.held_out)
    mask = np.zeros(photo.shot.pixels.shape[:2], bool)
    mask[:, 20:] = True
    shot = replace(photo.shot, mask=mask if masked else None)
    start = initial_parameters(capture.points, capture.point_colours, capture.scene_radius)
    request = ComparisonRequest(
        shot=shot,
        gaussians=Splats(copied(start)).snapshot(),
        settings=training.settings,
        shrink=1,
        gain=1.0,
        exposures_differ=exposures_differ,
    )
    listed = evaluate(start, [shot], training.settings, exposures_differ=exposures_differ)
    assert compare(request).psnr == pytest.approx(listed.psnr, abs=0.05)

    training.photo_index = training.photos.index(photo)
    assert training.score_text() == ""
    training.thread.status = replace(training.status, evaluation=listed, evaluated_at=1200)
    assert training.score_text() == f"{training.scores[photo.name]:.2f} dB at step 1,200"


def test_a_comparer_makes_the_latest_request_and_survives_trouble(capture, monkeypatch):
    comparer = Comparer()
    shots, scene = train_views(capture.photos), initial_scene(capture)

    def request(index: int, **changes: Any) -> ComparisonRequest:
        options = {"gaussians": scene, "settings": RenderSettings(), "shrink": 1, "gain": 1.0, **changes}
        return ComparisonRequest(shot=shots[index], **options)

    def ask(wanted: ComparisonRequest) -> None:
        limit = time.monotonic() + 200
        while comparer.latest is None or comparer.latest.request.shot is not wanted.shot or comparer.busy:
            assert time.monotonic() < limit
            comparer.request(wanted)
            if comparer.problem:
                return
            time.sleep(0.001)

    ask(request(0))
    first = comparer.latest
    comparer.request(request(0))
    assert not comparer.busy, "the same again costs nothing"
    ask(request(2))
    assert comparer.latest is not first
    monkeypatch.setattr("splatview.raster.render", lambda *arguments, **options: 1 / 0)
    ask(request(3))
    assert comparer.problem == "ZeroDivisionError: division by zero"
    monkeypatch.undo()
    comparer.problem = None
    ask(request(1))
    assert comparer.latest is not None and comparer.latest.request.shot is shots[1]
    assert comparer.problem is None
    comparer.close()


@pytest.mark.parametrize(
    ("size", "room", "shrink"),
    [
        ((400, 300), (400, 300), 1),
        ((400, 300), (199, 200), 2),
        ((4000, 3000), (300, 300), 13),
        ((8, 8), (0, 0), 1),
    ],
)
def test_photos_shrink_to_what_is_seen(size, room, shrink):
    assert shrink_for(size[0], size[1], room) == shrink


# ---- cameras in the view


def test_the_nearest_camera_is_found_within_reach():
    lines = [
        np.array([[(0, 0), (10, 0)], [(0, 0), (0, 10)]], float),
        np.array([[(50, 50), (60, 60)]] * 2, float),
    ]
    assert nearest(lines, (5, 2), 3) == 0
    assert nearest(lines, (56, 54), 3) == 1
    assert nearest(lines, (30, 30), 3) is None
    assert nearest([], (0, 0), 3) is None


def test_loaded_cameras_are_drawn_where_wanted(app):
    app.cameras = [look_at((0, 0, -3), (0, 0, 0))]
    assert not shows_cameras(app)
    app.prefer(show_cameras=True)
    assert shows_cameras(app)


def test_axes_of_curves_are_as_long_as_their_data_and_never_without_length() -> None:
    assert limits(np.array([3.0, 1.0, 2.0])) == (1.0, 3.0)
    assert limits(np.array([3.0, 1.0, 2.0]), 0.5) == (0.0, 4.0)
    for alike in (0.0, 28.0, 28.0 + 1e-12, -3.0):
        least, most = limits(np.full(4, alike))
        assert least < alike < most
        assert np.float32(least) < np.float32(most), "ImPlot ticks are of finite precision"
