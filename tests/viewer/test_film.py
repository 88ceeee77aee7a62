"""The film of a window, without one: keyframes, the playhead, and what is kept with a scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.scene.camera_path_files import load_camera_path
from splatview.scene.formats import save_scene
from splatview.viewer import film as commands
from splatview.viewer.depth_of_field import DepthOfField
from splatview.viewer.film import FILE_NAME, KEPT_AFTER, Film
from splatview.viewer.navigation import dolly, orbit
from splatview.viewer.open import open_paths
from splatview.viewer.save import FilmExport, film_cameras, open_film_dialog, save_path
from splatview.viewer.state import AppState


@pytest.fixture
def scene(tmp_path, random_gaussians) -> Path:
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(50), path)
    return path


@pytest.fixture
def opened(app, scene, wait_for_loading) -> AppState:
    open_paths(app, [scene])
    wait_for_loading(app)
    assert app.is_open
    return app


def keyframes(app: AppState, count: int = 3) -> Film:
    """So many, 40 degrees apart."""
    for _ in range(count):
        commands.add_keyframe(app)
        app.steer(orbit(app.view, 0.7, 0.1))
    return app.feature(Film)


def times(film: Film) -> list[float]:
    return [] if film.path is None else [key.time for key in film.path.keyframes]


def clock(app: AppState) -> list[float]:
    """Seconds that `app.now` tells, to be changed."""
    now = [100.0]
    app.now = lambda: now[0]
    return now


def test_keyframes_follow_one_another_and_go_where_the_playhead_is(opened):
    film = keyframes(opened)
    assert times(film) == [0, 2, 4] and film.chosen == 2
    film.show(opened, 1.0)
    commands.add_keyframe(opened)
    assert times(film) == [0, 1, 2, 4] and film.chosen == 1
    commands.delete_keyframe(opened)
    assert times(film) == [0, 2, 4]
    for _ in range(5):
        film.undo(opened)
    assert film.path is None and not film.can_undo


def test_updating_gives_the_chosen_keyframe_this_view(opened):
    film = keyframes(opened)
    commands.go_to_keyframe(opened, 1)
    opened.steer(dolly(opened.view, 0.5))
    commands.update_keyframe(opened)
    assert film.path is not None
    np.testing.assert_allclose(film.path.pose(2.0).eye, opened.view.eye, atol=1e-12)
    assert times(film) == [0, 2, 4]


def test_it_plays_by_the_clock_to_its_end(opened):
    film, now = keyframes(opened), clock(opened)
    film.time = 0.0
    commands.play_or_pause(opened)
    for moment in (0.5, 1.7, 3.9):
        now[0] = 100 + moment
        film.before_frame(opened)
        assert film.playing and film.time == pytest.approx(moment)
        assert film.path is not None
        np.testing.assert_allclose(opened.view.eye, film.path.pose(moment).eye, atol=1e-12)
    now[0] = 105
    film.before_frame(opened)
    assert not film.playing and film.time == 4.0
    commands.play_or_pause(opened)
    assert film.playing and film.time == 0.0, "from the beginning again"


def test_a_loop_goes_on(opened):
    film, now = keyframes(opened), clock(opened)
    commands.toggle_loop(opened)
    assert film.path is not None and film.path.duration == 6.0
    film.time = 0.0
    film.play(opened)
    now[0] += 13.0
    film.before_frame(opened)
    assert film.playing and film.time == pytest.approx(1.0)
    commands.toggle_loop(opened)
    assert film.path.duration == 4.0


@pytest.mark.parametrize("hand", ["orbit", "jump", "escape"])
def test_whoever_moves_the_view_has_it(opened, hand):
    film, now = keyframes(opened), clock(opened)
    film.time = 0.0
    film.play(opened)
    now[0] += 0.5
    film.before_frame(opened)
    if hand == "orbit":
        opened.steer(orbit(opened.view, 0.1, 0.0))
    elif hand == "jump":
        opened.preferences = replace(opened.preferences, smooth=True)
        opened.go_to(orbit(opened.view, 0.1, 0.0))
    else:
        assert film.cancel(opened)
    eye = opened.view.eye
    now[0] += 0.5
    film.before_frame(opened)
    assert not film.playing
    np.testing.assert_array_equal(opened.view.eye, eye)


def test_a_keyframe_is_moved_between_its_neighbours_in_one_step(opened):
    film = keyframes(opened)
    for number, time in enumerate((1.5, 0.5, -3.0)):
        commands.move_keyframe(opened, 1, time, again=number > 0)
    assert times(film) == [0, commands.GAP, 4]
    commands.move_keyframe(opened, 2, 9.0, again=False)
    assert times(film)[-1] == 9.0 and film.path is not None and film.path.duration == 9.0
    film.undo(opened)
    film.undo(opened)
    assert times(film) == [0, 2, 4]
    commands.toggle_loop(opened)
    commands.move_keyframe(opened, 2, 99.0, again=False)
    assert film.path.duration == 6.0 and times(film)[-1] < 6.0


def test_the_length_is_that_of_the_whole(opened):
    film = keyframes(opened)
    film.time = 1.0
    commands.set_length(opened, 8.0)
    assert times(film) == [0, 4, 8] and film.time == 2.0
    commands.set_length(opened, 0.01)
    assert times(film) == [0, 4, 8], "too short for three keyframes"


def test_a_turntable_goes_round_what_is_looked_at(opened):
    film = opened.feature(Film)
    opened.steer(dolly(opened.view, 0.5))
    target, distance = opened.view.target, opened.view.distance
    commands.make_turntable(opened)
    assert film.path is not None and film.path.loop and film.playing
    for time in (0.0, 1.1, 4.4):
        pose = film.path.pose(time)
        np.testing.assert_allclose(pose.target, target, atol=1e-9)
        assert pose.distance == pytest.approx(distance)
    eyes = [film.path.pose(time).eye for time in (0.0, 3.0)]
    assert np.linalg.norm(eyes[0] - eyes[1]) > distance


def test_the_path_is_kept_with_its_scene(opened, scene, wait_for_loading, tmp_path, random_gaussians):
    film, now = keyframes(opened), clock(opened)
    commands.toggle_loop(opened)
    kept = film.path
    now[0] += KEPT_AFTER + 1
    film.before_frame(opened)
    assert (Path(tmp_path) / "config" / FILE_NAME).exists()
    other = tmp_path / "other.ply"
    save_scene(random_gaussians(20), other)
    for path, count in ((other, 0), (scene, 3)):
        open_paths(opened, [path])
        wait_for_loading(opened)
        assert len(times(film)) == count
    assert film.path is not None and kept is not None
    assert film.path.loop and film.path.duration == kept.duration
    np.testing.assert_array_equal(film.path.pose(1.3).eye, kept.pose(1.3).eye)


def test_files_that_were_written_anew_keep_their_path(opened, scene, wait_for_loading, random_gaussians):
    film = keyframes(opened)
    save_scene(random_gaussians(70, seed=9), scene)
    open_paths(opened, [scene])
    wait_for_loading(opened)
    assert len(opened.scene.gaussians) == 70 and times(film) == [0, 2, 4]


def test_an_aperture_of_the_window_is_that_of_its_film(opened):
    film, lens = keyframes(opened), opened.feature(DepthOfField)
    assert film.path is not None
    assert film_cameras(opened, film.path, 1.0, (64, 48))[0][1] is None
    lens.on = True
    for camera, aperture in film_cameras(opened, film.path, 1.0, (64, 48)):
        assert (camera.width, camera.height) == (64, 48) and aperture is not None
        assert aperture.focus == pytest.approx(opened.view.distance)


@pytest.mark.parametrize("text", ["{", "[]", '{"films": [{"scene": 1}]}', '{"films": 3}'])
def test_a_damaged_file_of_films_costs_nothing(app, scene, wait_for_loading, tmp_path, text):
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / FILE_NAME).write_text(text)
    open_paths(app, [scene])
    wait_for_loading(app)
    film = keyframes(app, 1)
    assert app.is_open and times(film) == [0]
    film.close(app)
    assert "target" in (tmp_path / "config" / FILE_NAME).read_text()


def test_paths_are_saved_and_opened(opened, tmp_path):
    film = keyframes(opened)
    save_path(opened, tmp_path / "way")
    assert [key.time for key in load_camera_path(tmp_path / "way.json").path.keyframes] == [0, 2, 4]
    commands.delete_keyframe(opened)
    commands.open_path(opened, tmp_path / "way.json")
    assert times(film) == [0, 2, 4]
    (tmp_path / "bad.json").write_text("{}")
    commands.open_path(opened, tmp_path / "bad.json")
    assert opened.problem is not None and "is no camera path" in opened.problem
    assert times(film) == [0, 2, 4]


def test_the_export_says_what_is_in_the_way(opened, tmp_path):
    film, made = opened.feature(Film), opened.feature(FilmExport)
    open_film_dialog(opened)
    assert opened.dialog is None and made.problem(opened, film) == "Add keyframes first"
    keyframes(opened)
    open_film_dialog(opened)
    assert opened.dialog == "film" and Path(made.file).parent == tmp_path
    made.choose(film, format="folder")
    assert Path(made.file).suffix == "" and made.problem(opened, film) == ""
    made.file = str(tmp_path)
    assert "is there already" in made.problem(opened, film)
    made.file = str(tmp_path / "film.gif")
    assert made.problem(opened, film) == "Name a new folder"
    made.file = " "
    assert made.problem(opened, film) == "Name the file"


def test_without_a_scene_or_keyframes_commands_say_so(app):
    for run in (commands.update_keyframe, commands.delete_keyframe, commands.toggle_loop):
        run(app)
    commands.play_or_pause(app)
    commands.step_keyframe(app, 1)
    assert app.feature(Film).path is None
    assert {message.text for message in app.messages} == {
        "Choose a keyframe first",
        "There are no keyframes yet",
    }
