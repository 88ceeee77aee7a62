"""Laws of navigation, over random views: what stays, what moves and which way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyrr import matrix33

from splatview.scene import look_at
from splatview.viewer.navigation import (
    AXIS_NAMES,
    Lens,
    Transition,
    View,
    axis_view,
    dolly,
    focus,
    frame,
    level,
    look,
    move,
    orbit,
    pan,
    trackball,
    view_from_camera,
    with_up,
)
from splatview.viewer.navigation.view import look_from, unit

angles = st.floats(-3.0, 3.0)
steps = st.floats(-5.0, 5.0)
pixels = st.floats(-900.0, 900.0)
positions = st.tuples(*[st.floats(-100.0, 100.0)] * 3).map(np.array)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)
on_screen = st.tuples(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4))


@st.composite
def views(draw) -> View:
    """Any view, rolled ones included."""
    first, second = (matrix33.create_from_axis_rotation(draw(directions), draw(angles)) for _ in range(2))
    return View(
        target=draw(positions),
        distance=draw(st.floats(0.01, 50.0)),
        R_camera_world=first @ second,
        up=unit(draw(directions)),
        lens=Lens(fov_y=draw(st.floats(5.0, 120.0))),
    )


@st.composite
def level_views(draw) -> View:
    """Views with a level horizon, away from the poles."""
    up = unit(draw(directions))
    outwards = draw(directions.filter(lambda v: abs(float(unit(v) @ up)) < 0.95))
    target = draw(positions)
    return look_from(target + draw(st.floats(0.1, 20.0)) * unit(outwards), target, up)


def project(view: View, point: np.ndarray, width: int = 640, height: int = 480) -> np.ndarray:
    camera = view.camera(width, height)
    t = camera.R_camera_world @ point + camera.t_camera_world
    return np.array([camera.fx * t[0] / t[2] + camera.cx, camera.fy * t[1] / t[2] + camera.cy])


def assert_rotation(R: np.ndarray) -> None:
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0


def assert_same_view(a: View, b: View, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(a.R_camera_world, b.R_camera_world, atol=tolerance)
    np.testing.assert_allclose(a.target, b.target, atol=tolerance * (1 + abs(a.target).max()))
    assert a.distance == pytest.approx(b.distance, rel=tolerance)


class TestOrbit:
    @given(views(), angles, angles)
    def test_keeps_target_and_distance(self, view, azimuth, elevation):
        turned = orbit(view, azimuth, elevation)
        assert_rotation(turned.R_camera_world)
        np.testing.assert_array_equal(turned.target, view.target)
        assert np.linalg.norm(turned.eye - view.target) == pytest.approx(view.distance, rel=1e-9)

    @given(level_views(), angles, angles)
    def test_keeps_the_horizon_level(self, view, azimuth, elevation):
        turned = orbit(view, azimuth, elevation)
        assert abs(float(turned.R_camera_world[0] @ view.up)) < 1e-9
        assert float(-turned.R_camera_world[1] @ view.up) > 0, "never upside down"

    @given(level_views(), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
    def test_is_undone_by_its_opposite(self, view, azimuth, elevation):
        assert_same_view(orbit(orbit(view, azimuth, elevation), -azimuth, -elevation), view)

    @given(level_views(), angles, angles)
    def test_ways_around_add_up(self, view, first, second):
        assert_same_view(orbit(orbit(view, first, 0.0), second, 0.0), orbit(view, first + second, 0.0))

    def test_goes_the_way_it_says(self):
        view = look_from(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        assert orbit(view, 0.1, 0.0).eye[0] < -0.1, "a positive azimuth moves the eye to its left"
        assert orbit(view, 0.0, 0.1).eye[1] > 0.1, "a positive elevation raises it"
        front = np.array([0.0, 0.0, 1.0])
        assert project(orbit(view, 0.1, 0.0), front)[0] > project(view, front)[0]

    def test_leaves_the_pole_it_starts_on(self):
        view = axis_view(look_from(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0])), "+Y")
        np.testing.assert_allclose(view.eye, (0, 5, 0), atol=1e-9)
        lowered = orbit(view, 0.0, -0.5)
        assert lowered.eye[1] == pytest.approx(5 * math.cos(0.5))
        assert_rotation(lowered.R_camera_world)

    def test_many_small_turns_do_not_shear_the_view(self):
        view = look_from(np.array([0.0, 1.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        for _ in range(10_000):
            view = orbit(view, 0.013, 0.0007)
        np.testing.assert_allclose(view.R_camera_world @ view.R_camera_world.T, np.eye(3), atol=1e-14)
        assert view.R_camera_world[0] @ view.up == pytest.approx(0, abs=1e-10), "still level"


class TestFly:
    @given(views(), angles, angles)
    def test_looking_keeps_the_eye(self, view, yaw, pitch):
        turned = look(view, yaw, pitch)
        assert_rotation(turned.R_camera_world)
        np.testing.assert_allclose(turned.eye, view.eye, atol=1e-9 * (1 + abs(view.eye).max()))
        assert turned.distance == view.distance

    def test_looks_the_way_it_says(self):
        view = look_from(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        assert look(view, 0.2, 0.0).forward[0] > 0.1, "right"
        assert look(view, 0.0, 0.2).forward[1] > 0.1, "up"

    @given(views(), steps, steps, steps)
    def test_moves_along_its_own_axes(self, view, right, up, forward):
        moved = move(view, (right, up, forward))
        went = moved.R_camera_world @ (moved.eye - view.eye)
        np.testing.assert_allclose(went, (right, -up, forward), atol=1e-9)
        np.testing.assert_array_equal(moved.R_camera_world, view.R_camera_world)

    @given(level_views(), angles, angles)
    def test_keeps_the_horizon_level(self, view, yaw, pitch):
        assert abs(float(look(view, yaw, pitch).R_camera_world[0] @ view.up)) < 1e-9


class TestTrackball:
    @given(views(), on_screen, on_screen)
    def test_keeps_target_and_distance(self, view, start, end):
        turned = trackball(view, start, end)
        assert_rotation(turned.R_camera_world)
        assert np.linalg.norm(turned.eye - view.target) == pytest.approx(view.distance, rel=1e-9)

    @given(views(), on_screen, on_screen)
    def test_dragging_back_undoes_it(self, view, start, end):
        assert_same_view(trackball(trackball(view, start, end), end, start), view)

    @given(views(), on_screen, on_screen, on_screen)
    def test_only_the_ends_of_a_drag_matter(self, view, start, between, end):
        direct = trackball(view, start, end)
        assert_same_view(trackball(trackball(view, start, between), between, end), direct)

    def test_many_small_drags_do_not_shear_the_view(self):
        view = look_from(np.array([0.0, 1.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        for _ in range(10_000):
            view = trackball(view, (0.1, 0.2), (0.11, 0.18))
        np.testing.assert_allclose(view.R_camera_world @ view.R_camera_world.T, np.eye(3), atol=1e-14)

    def test_the_front_follows_the_mouse(self):
        view = look_from(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        front = np.array([0.0, 0.0, 0.5])
        turned = trackball(view, (0.0, 0.0), (0.1, 0.05))
        dx, dy = project(turned, front) - project(view, front)
        assert dx > 0 and dy > 0


class TestPanAndDolly:
    @given(views(), pixels, pixels)
    def test_the_target_plane_moves_with_the_mouse(self, view, dx, dy):
        panned = pan(view, dx, dy, height=480)
        moved = project(panned, view.target) - project(view, view.target)
        np.testing.assert_allclose(moved, (dx, dy), atol=1e-5)
        assert panned.distance == view.distance

    @given(views(), st.floats(0.1, 10.0))
    def test_dolly_scales_the_distance_and_is_undone(self, view, factor):
        assert dolly(view, factor).distance == pytest.approx(view.distance * factor)
        assert_same_view(dolly(dolly(view, factor), 1 / factor), view)

    @given(views())
    def test_dolly_never_reaches_the_target(self, view):
        assert dolly(view, 0.0).distance > 0


class TestFraming:
    @given(views(), st.tuples(*[st.floats(-1.0, 1.0)] * 2), st.floats(0.1, 20.0))
    def test_focus_puts_the_target_at_the_centre(self, view, beside, depth):
        point = view.eye + np.array([*beside, depth]) @ view.R_camera_world
        focused = focus(view, point)
        np.testing.assert_allclose(project(focused, point), (320, 240), atol=1e-5)
        np.testing.assert_array_equal(focused.R_camera_world, view.R_camera_world)
        assert focused.distance == pytest.approx(depth, rel=1e-6)

    @given(views(), positions, st.floats(0.01, 50.0), st.floats(0.3, 3.0))
    def test_a_framed_sphere_is_all_inside(self, view, centre, radius, aspect):
        framed = frame(view, centre, radius, aspect=aspect)
        height = 400
        camera = framed.camera(max(1, round(height * aspect)), height)
        t = camera.R_camera_world @ centre + camera.t_camera_world
        for size, focal in ((camera.width, camera.fx), (camera.height, camera.fy)):
            half_angle = math.atan(size / 2 / focal)
            assert math.asin(radius / t[2]) <= half_angle + 1e-3

    @given(views(), st.sampled_from(AXIS_NAMES))
    def test_axis_views_look_along_their_axis(self, view, name):
        found = axis_view(view, name)
        expected = np.zeros(3)
        expected["XYZ".index(name[1])] = -1.0 if name[0] == "+" else 1.0
        np.testing.assert_allclose(found.forward, expected, atol=1e-9)
        assert_rotation(found.R_camera_world)
        np.testing.assert_array_equal(found.target, view.target)

    @given(views(), directions)
    def test_a_new_up_axis_is_upwards_in_the_picture(self, view, up):
        raised = with_up(view, up)
        right = raised.R_camera_world[0]
        np.testing.assert_allclose(raised.eye, view.eye, atol=1e-7 * (1 + abs(view.eye).max()))
        if abs(float(view.forward @ unit(up))) < 0.999:
            assert abs(float(right @ unit(up))) < 1e-6
            assert float(-raised.R_camera_world[1] @ unit(up)) > 0

    @given(views())
    def test_levelling_keeps_eye_and_direction(self, view):
        levelled = level(view)
        np.testing.assert_allclose(levelled.forward, view.forward, atol=1e-7)
        np.testing.assert_allclose(levelled.eye, view.eye, atol=1e-7 * (1 + abs(view.eye).max()))


class TestTransition:
    @given(views(), views(), st.floats(0.0, 1.0))
    def test_starts_at_the_start_ends_at_the_end_and_stays_a_view(self, start, end, share):
        way = Transition(start=start, end=end, began=100.0, duration=2.0)
        assert_same_view(way.at(100.0), start, 1e-6)
        assert way.at(102.0) is end
        middle = way.at(100.0 + 2 * share)
        assert_rotation(middle.R_camera_world)
        assert min(start.distance, end.distance) * 0.999 <= middle.distance
        assert middle.distance <= max(start.distance, end.distance) * 1.001

    def test_without_duration_it_is_over_at_once(self):
        view = look_from(np.ones(3), np.zeros(3), np.array([0.0, 1.0, 0.0]))
        assert Transition(start=dolly(view, 3.0), end=view, began=0.0, duration=0.0).at(0.0) is view


class TestView:
    @given(views())
    def test_a_view_of_its_own_camera_is_the_same(self, view):
        again = view_from_camera(view.camera(640, 480), distance=view.distance, up=view.up)
        assert_same_view(again, view, 1e-7)
        assert again.lens.fov_y == pytest.approx(view.lens.fov_y)

    def test_a_photo_of_the_windows_shape_is_shown_exactly(self):
        photo = look_at((1, 2, 3), (0, 0, 0), width=1000, height=500)
        photo = type(photo)(
            width=1000, height=500, fx=700, fy=650, cx=480, cy=270, world_to_camera=photo.world_to_camera
        )
        view = view_from_camera(photo, distance=2.0, up=np.array([0.0, 1.0, 0.0]))
        shown = view.camera(1000, 500)
        for name in ("fx", "fy", "cx", "cy"):
            assert getattr(shown, name) == pytest.approx(getattr(photo, name))

    def test_a_narrower_window_still_shows_all_of_a_photo(self):
        photo = look_at((1, 2, 3), (0, 0, 0), width=1000, height=500)
        shown = view_from_camera(
            photo, distance=2.0, up=np.array([0.0, 1.0, 0.0]), width=400, height=600
        ).camera(400, 600)
        assert shown.width / shown.fx == pytest.approx(photo.width / photo.fx)
        assert shown.height / shown.fy > photo.height / photo.fy
