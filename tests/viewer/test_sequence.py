"""The open sequence without a window: what is opened, what is shown, and what edits hold."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from splatview.edit.operations import Delete, Select
from splatview.edit.selectors import Sphere
from splatview.scene import RenderSettings
from splatview.scene.effects.overrides import quick_settings, settings_for
from splatview.scene.formats import load_scene, save_scene
from splatview.viewer import open as opening
from splatview.viewer import sequence
from splatview.viewer.editing import saving
from splatview.viewer.editing.session import at_rest, can_edit, session_for_edit, session_of
from splatview.viewer.open import open_paths
from splatview.viewer.sequence import SETTLE_SECONDS, Player, Sequences
from splatview.viewer.state import AppState


@pytest.fixture
def folder(tmp_path, random_gaussians) -> Path:
    """Frames 1 to 12, each with as many splats more than 100."""
    folder = tmp_path / "frames"
    folder.mkdir()
    scene = random_gaussians(120, seed=5)
    for i in range(1, 13):
        save_scene(scene.take(slice(0, 100 + i)), folder / f"f{i}.ply")
    return folder


def player_of(app: AppState) -> Player:
    player = app.feature(Sequences).player
    assert player is not None
    return player


def until(app: AppState, condition: Callable[[], bool]) -> None:
    """Frames of the window, without one, until `condition`."""
    limit = time.monotonic() + 200
    while not condition():
        assert time.monotonic() < limit, [message.text for message in app.messages]
        app.run_posted()
        for feature in app.features.values():
            feature.before_frame(app)
        time.sleep(0.002)


@pytest.fixture
def opened(app, folder, wait_for_loading) -> AppState:
    open_paths(app, [folder])
    wait_for_loading(app)
    app.picture_size = (64, 48)
    return app


def go(app: AppState, frame: int) -> None:
    sequence.seek(app, frame)
    until(app, lambda: player_of(app).shown == frame and session_of(app) is not None)


def test_a_folder_opens_with_its_first_frame(opened, folder):
    app = opened
    assert app.scene.sequence is not None and app.scene.name == "frames"
    assert app.scene_path == folder / "f1.ply"
    assert app.preferences.recent == (str(folder),)
    assert next(message.text for message in app.messages) == "frames: 12 frames from f1.ply to f12.ply"
    assert app.scene.bookmarked == folder / "f1.ply"


def test_frames_follow_and_everything_else_stays(opened, folder):
    app = opened
    view, name = app.view, app.scene.name
    app.settings = replace(app.settings, background=(0.2, 0.3, 0.4))
    app.mode = "depth"
    go(app, 6)
    assert len(app.scene.gaussians) == 107 and app.scene_path == folder / "f7.ply"
    assert app.view is view and app.mode == "depth" and app.scene.name == name
    assert app.settings.background == (0.2, 0.3, 0.4)
    assert app.scene.bookmarked == folder / "f1.ply"
    session = session_of(app)
    assert session is not None and session.gaussians is app.scene.gaussians


def test_settings_of_a_frame_at_rest_are_those_it_calls_for(opened):
    app = opened
    go(app, 3)
    until(app, lambda: app.called_for == settings_for(app.scene.gaussians))
    assert app.settings == replace(
        app.called_for, background=app.settings.background, blend=app.settings.blend
    )


def test_settings_at_a_glance_show_no_less(random_gaussians):
    for seed, factor in ((0, 0.1), (1, 1.0), (2, 300.0)):
        scene = random_gaussians(300, seed=seed, sh_degree=3)
        scene = replace(scene, sh=scene.sh * scene.sh.dtype.type(factor))
        exact, quick = settings_for(scene), quick_settings(scene)
        assert quick.model == exact.model and quick.sh_degree is None
        usual = 2e-4
        assert (usual if quick.early_stop is None else quick.early_stop) <= (
            usual if exact.early_stop is None else exact.early_stop
        )
    assert isinstance(quick, RenderSettings) and quick.early_stop is not None


def test_steps_go_over_damaged_frames_and_round(app, folder, wait_for_loading):
    for i in (1, 4, 5):
        (folder / f"f{i}.ply").write_bytes(b"ply\nno")
    open_paths(app, [folder])
    wait_for_loading(app)
    assert app.scene.frame == 1, "the first that can be read"
    player = player_of(app)
    until(app, lambda: len(player.cache.problems) == 3 and len(player.cache) == 9)
    told = [message.text for message in app.messages if "skipped" in message.text]
    assert len(told) == 3 and all("\n" not in line for line in told)
    for by, frame in ((1, 2), (1, 5), (-1, 2), (-1, 1), (-1, 11), (1, 1)):
        sequence.step(app, by)
        assert player.head.frame == frame
    app.prefer(play_mode="once")
    until(app, lambda: player.head.mode == "once")
    sequence.step(app, -1)
    assert player.head.frame == 1, "no way round"


def test_none_that_can_be_read_is_one_line(app, folder, wait_for_loading):
    for path in folder.iterdir():
        path.write_bytes(b"ply\nno")
    open_paths(app, [folder])
    wait_for_loading(app)
    assert not app.is_open and "\n" not in app.problem
    assert "none of its 12 frames can be read" in app.problem and "f1.ply" in app.problem


def test_playing_has_no_session_until_something_edits(opened):
    app = opened
    sequence.play_or_pause(app)
    player = player_of(app)
    until(app, lambda: player.shown > 3)
    assert session_of(app) is None and can_edit(app) and at_rest(app)
    assert app.waiting
    session = session_for_edit(app)
    assert session is not None and not player.head.playing
    assert session.gaussians is app.scene.gaussians and player.head.frame == player.shown
    assert session.apply(Select(by=Sphere(centre=(0, 0, 0), radius=9)))
    sequence.play_or_pause(app)
    assert player.head.playing, "a selection is no loss"


def test_an_edit_right_after_play_pauses_before_the_next_frame_is_due(opened):
    app = opened
    go(app, 2)
    sequence.play_or_pause(app)
    player = player_of(app)
    assert session_of(app) is None and player.shown == 2
    session = session_for_edit(app)
    assert session is not None and not player.head.playing and player.head.frame == 2
    assert session.apply(Select(by=Sphere(centre=(0, 0, 0), radius=9)))
    until(app, lambda: not app.waiting)
    assert session_of(app) is session


def test_edits_hold_the_frame(opened):
    app = opened
    go(app, 2)
    session = session_of(app)
    assert session is not None
    session.apply(Select(by=Sphere(centre=(0, 0, 0), radius=1)))
    session.apply(Delete())
    player = player_of(app)
    for command in (
        sequence.play_or_pause,
        lambda app: sequence.step(app, 1),
        lambda app: sequence.seek(app, 9),
        lambda app: sequence.go_to_end(app, last=True),
    ):
        command(app)
        assert player.head.frame == 2 and not player.head.playing
        assert "f3.ply is edited" in app.messages[-1].text
    session.undo()
    go(app, 3)
    session = session_of(app)
    assert session is not None
    session.apply(Select(by=Sphere(centre=(0, 0, 0), radius=1)))
    session.apply(Delete())
    sequence.discard_edits(app)
    until(app, lambda: player.shown == 3 and session_of(app) is not None)
    fresh = session_of(app)
    assert fresh is not None and fresh is not session and fresh.document.counts.deleted == 0


def test_a_saved_frame_may_be_left(opened, folder):
    """A saved frame may be left; where it went to its own file, that is what is found there again."""
    app = opened
    session = session_for_edit(app)
    assert session is not None
    session.apply(Select(by=Sphere(centre=(0, 0, 0), radius=0.4)))
    session.apply(Delete())
    assert app.feature(Sequences).held(app) is not None
    saving.write(app, folder / "f1.ply")
    until(app, lambda: session.job is None)
    assert app.problem is None and "Saved" in app.messages[-1].text
    assert app.feature(Sequences).held(app) is None
    kept = len(load_scene(folder / "f1.ply"))
    assert 0 < kept < 101
    go(app, 1)
    go(app, 0)
    assert len(app.scene.gaussians) == kept


def test_numbered_files_play_and_can_be_merged(app, folder, wait_for_loading):
    paths = [folder / f"f{i}.ply" for i in (3, 1, 2)]
    open_paths(app, paths)
    wait_for_loading(app)
    assert len(player_of(app).sequence) == 3 and app.scene_path == folder / "f1.ply"
    sequence.merge_frames(app)
    wait_for_loading(app)
    assert app.feature(Sequences).player is None and len(app.scene.gaussians) == 101 + 102 + 103
    open_paths(app, paths, merge=True)
    wait_for_loading(app)
    assert app.feature(Sequences).player is None and len(app.scene.gaussians) == 306


def test_reading_again_finds_new_frames_and_stays(opened, folder):
    app = opened
    go(app, 4)
    view = app.view
    (folder / "f13.ply").write_bytes((folder / "f12.ply").read_bytes())
    opening.reload(app)
    until_loaded = time.monotonic() + 200
    while app.loading is not None:
        assert time.monotonic() < until_loaded
        app.loading.join(0.01)
        opening.continue_loading(app)
    player = player_of(app)
    assert len(player.sequence) == 13 and player.head.frame == 4 and app.view is view


def test_a_frame_that_the_picture_cannot_hold_is_skipped(opened):
    app = opened
    app.picture.too_big = 110  # type: ignore[attr-defined]
    player = player_of(app)
    sequence.seek(app, 10)
    until(app, lambda: 10 in player.cache.problems)
    assert player.shown == 0 and "does not hold it" in app.messages[-1].text


def test_settling_takes_a_moment(opened):
    assert 0 < SETTLE_SECONDS < 1
    app = opened
    player = player_of(app)
    sequence.seek(app, 5)
    until(app, lambda: player.shown == 5)
    assert session_of(app) is None or player.settled
    until(app, lambda: player.settled)
    assert not app.feature(Sequences).busy(app)
