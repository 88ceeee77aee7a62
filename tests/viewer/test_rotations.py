"""Laws of rotations in the window, with the scene's own quaternions as the judge of every convention."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pyrr import matrix33, matrix44

from splatview.scene import look_at_matrix
from splatview.scene.projection import rotation_matrices
from splatview.viewer.editing.gizmos import GL_FROM_CV, placed, quat_from_matrix, quat_of
from splatview.viewer.navigation.view import between, look_from, orthonormal, unit

vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)
quats = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
shares = st.floats(0.0, 1.0)
HALF_TURNS = [(0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (0, 0.6, -0.8, 0), (0, 0.48, 0.6, 0.64)]


def rotation(quat) -> np.ndarray:
    """(3, 3) of a quaternion wxyz."""
    return rotation_matrices(np.array([quat], dtype=np.float64))[0]


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) of a turn by `angle` radians, right-handed."""
    return rotation((math.cos(angle / 2), *(math.sin(angle / 2) * axis / np.linalg.norm(axis))))


def angle_of(R: np.ndarray) -> float:
    """Radians, 0 to π: as far as `R` is from the identity."""
    return 2 * math.asin(min(float(np.linalg.norm(R - np.eye(3))) / math.sqrt(8), 1.0))


def assert_rotation(R: np.ndarray, tolerance: float = 1e-14) -> None:
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=tolerance)
    assert np.linalg.det(R) > 0


class TestQuaternionsAndMatrices:
    @given(quats)
    def test_pyrr_turns_as_the_scene_does(self, quat):
        """Its order is xyzw, and matrices of quaternions act on columns."""
        np.testing.assert_allclose(
            matrix33.create_from_quaternion(np.roll(quat, -1)), rotation(quat), atol=1e-14
        )

    @given(vectors, st.floats(-7.0, 7.0))
    def test_matrices_of_axes_act_on_rows(self, axis, angle):
        np.testing.assert_allclose(
            matrix33.create_from_axis_rotation(axis, angle).T, about(axis, angle), atol=1e-14
        )

    @given(quats)
    def test_a_quaternion_comes_back_from_its_matrix(self, quat):
        found = np.array(quat_from_matrix(rotation(quat)))
        np.testing.assert_allclose(found * np.sign(found @ quat), quat, atol=1e-12)

    @pytest.mark.parametrize("quat", HALF_TURNS)
    def test_half_turns_come_back_too(self, quat):
        found = np.array(quat_from_matrix(rotation(quat)))
        np.testing.assert_allclose(found * np.sign(found @ quat), quat, atol=1e-12)

    @given(quats)
    def test_a_matrix_of_float32_gives_a_quaternion_of_length_1(self, quat):
        found = quat_from_matrix(rotation(quat).astype(np.float32))
        assert np.linalg.norm(found) == pytest.approx(1, abs=1e-14)
        assert abs(np.dot(found, quat)) == pytest.approx(1, abs=1e-6)

    @given(*[st.floats(-360.0, 360.0)] * 3)
    def test_angles_turn_about_x_then_y_then_z(self, x, y, z):
        about_x, about_y, about_z = (
            about(axis, math.radians(angle)) for axis, angle in zip(np.eye(3), (x, y, z), strict=True)
        )
        np.testing.assert_allclose(rotation(quat_of((x, y, z))), about_z @ about_y @ about_x, atol=1e-13)

    def test_whole_numbers_of_degrees_are_not_cut(self):
        np.testing.assert_allclose(rotation(quat_of((0, 0, 90))) @ (1, 0, 0), (0, 1, 0), atol=1e-15)


class TestOrthonormal:
    @given(quats)
    def test_a_rotation_stays_as_it_is(self, quat):
        np.testing.assert_allclose(orthonormal(rotation(quat)), rotation(quat), atol=2e-15)

    @given(quats, st.integers(0, 2**32 - 1))
    def test_what_is_nearly_one_becomes_one_nearby(self, quat, seed):
        disturbed = rotation(quat) + np.random.default_rng(seed).uniform(-1e-3, 1e-3, size=(3, 3))
        found = orthonormal(disturbed)
        assert_rotation(found)
        np.testing.assert_allclose(found, disturbed, atol=5e-3)

    @pytest.mark.parametrize("quat", HALF_TURNS)
    def test_half_turns_as_well(self, quat):
        np.testing.assert_allclose(orthonormal(rotation(quat)), rotation(quat), atol=2e-15)


class TestBetween:
    @given(quats, quats)
    def test_begins_and_ends_where_it_should(self, start, end):
        np.testing.assert_allclose(between(rotation(start), rotation(end), 0.0), rotation(start), atol=1e-13)
        np.testing.assert_allclose(between(rotation(start), rotation(end), 1.0), rotation(end), atol=1e-7)

    @given(quats, vectors, st.floats(0.0, math.pi), shares)
    def test_is_even_also_at_small_angles_and_180_degrees(self, start, axis, angle, share):
        turned = between(rotation(start), about(axis, angle) @ rotation(start), share)
        assert_rotation(turned)
        assert angle_of(turned @ rotation(start).T) == pytest.approx(angle * share, abs=1e-6)

    @given(quats, vectors, st.floats(0.0, 3.0), shares)
    def test_the_way_back_is_the_same_way(self, start, axis, angle, share):
        near, far = rotation(start), about(axis, angle) @ rotation(start)
        np.testing.assert_allclose(between(near, far, share), between(far, near, 1 - share), atol=1e-7)

    @given(quats, vectors, st.floats(0.1, 3.0), shares)
    def test_goes_the_short_way_round(self, start, axis, beyond, share):
        end = about(axis, math.pi + beyond) @ rotation(start)
        turned = between(rotation(start), end, share)
        assert angle_of(turned @ rotation(start).T) == pytest.approx((math.pi - beyond) * share, abs=1e-6)

    @pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-16, 1e-9, 1e-8, 1e-7])
    def test_almost_no_turn_at_all_is_a_rotation(self, angle):
        turned = between(np.eye(3), about(np.array([1.0, 2.0, 3.0]), angle), 0.5)
        assert_rotation(turned)
        np.testing.assert_allclose(turned, about(np.array([1.0, 2.0, 3.0]), angle / 2), atol=2e-8)


class TestUnit:
    @given(vectors, st.integers(-140, 140))
    def test_keeps_the_direction_of_vectors_long_and_short(self, vector, exponent):
        found = unit(vector * 10.0**exponent)
        assert np.linalg.norm(found) == pytest.approx(1, abs=1e-14)
        np.testing.assert_allclose(found, vector / np.linalg.norm(vector), atol=1e-14)

    def test_takes_whole_numbers(self):
        np.testing.assert_allclose(unit(np.array([0, 3, -4])), (0, 0.6, -0.8), atol=1e-15)

    @pytest.mark.filterwarnings("ignore:overflow")
    @pytest.mark.parametrize(
        "vector", [(0, 0, 0), (0, 1, math.inf), (0, 1, math.nan), (1e200, 0, 0)], ids=str
    )
    def test_refuses_what_has_no_direction(self, vector):
        with pytest.raises(ValueError, match="no direction"):
            unit(np.array(vector))


class TestMatrices:
    @given(vectors, vectors, vectors)
    def test_a_view_looks_as_the_scenes_cameras_do(self, eye, forward, up):
        assume(np.linalg.norm(np.cross(unit(forward), unit(up))) > 1e-2)
        target = eye + forward
        found = look_from(eye, target, up).camera(640, 480).world_to_camera
        np.testing.assert_allclose(found, look_at_matrix(eye, target, up), atol=1e-9)
        # pyrr's has OpenGL's axes and acts on rows.
        np.testing.assert_allclose(
            (GL_FROM_CV @ found).T, matrix44.create_look_at(eye, target, up), atol=1e-9
        )

    @given(vectors, quats, vectors, vectors)
    def test_handles_lie_where_their_object_does(self, centre, quat, sizes, own):
        matrix = placed(centre, rotation(quat), sizes)
        world = rotation(quat) @ (sizes * own) + centre
        np.testing.assert_allclose(matrix @ np.append(own, 1), np.append(world, 1), atol=1e-13)
        np.testing.assert_array_equal(matrix[3], (0, 0, 0, 1))

    def test_handles_of_whole_numbers_keep_their_place(self):
        matrix = placed((1, 2, 3), rotation((1, 1, 0, 0)), (1, 2, 3))
        np.testing.assert_allclose(matrix @ (1, 1, 1, 1), (2, -1, 5, 1), atol=1e-14)
