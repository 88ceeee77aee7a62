"""Frames: algebraic laws, and one picture whatever the frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import InputError, RenderSettings, look_at, reference
from splatview.scene.frames import FRAMES, OURS, frame_matrix, reframed, turn_matrix


@pytest.mark.parametrize("frame", FRAMES)
def test_there_and_back_is_nothing(frame, random_gaussians):
    scene = random_gaussians(30, sh_degree=3)
    back = reframed(reframed(scene, OURS, frame), frame)
    np.testing.assert_allclose(back.means, scene.means, atol=1e-6)
    np.testing.assert_allclose(back.sh, scene.sh, atol=1e-5)
    unit = [g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True) for g in (back, scene)]
    np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", *unit)), 1, atol=1e-6)


def test_the_flip_of_spz_is_exact(random_gaussians):
    scene = random_gaussians(30, sh_degree=3)
    turned = reframed(scene, "RUB")
    np.testing.assert_array_equal(turned.means, scene.means * [1, -1, -1])
    np.testing.assert_array_equal(np.abs(turned.sh), np.abs(scene.sh))
    np.testing.assert_array_equal(np.sort(np.abs(turned.quats)), np.sort(np.abs(scene.quats)))


@pytest.mark.parametrize("frame", ["RUB", "LUF", "RFU", "FRD"])
def test_a_picture_does_not_depend_on_the_frame(frame, random_gaussians):
    """The scene and the camera turned together, in frames that are no mirrors of ours."""
    scene, camera = (
        random_gaussians(30, sh_degree=2),
        look_at((0.4, -0.3, -3), (0, 0, 0), width=40, height=30),
    )
    matrix = np.eye(4)
    matrix[:3, :3] = frame_matrix(frame)
    turned = replace(camera, world_to_camera=camera.world_to_camera @ matrix)
    settings = RenderSettings()
    before = reference.render(scene, camera, settings)
    after = reference.render(reframed(scene, OURS, frame), turned, settings)
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_turns_are_exact_rotations():
    assert np.array_equal(turn_matrix("over"), frame_matrix("RUB", "RDF"))
    assert np.array_equal(turn_matrix("z90") @ [1, 0, 0], [0, 1, 0])
    assert np.array_equal(turn_matrix("y90,x-90"), turn_matrix("x270") @ turn_matrix("Y+450"))
    for text in ("x180", "y90", "z-90", "x90,y90,z90"):
        assert np.linalg.det(turn_matrix(text)) == 1


@pytest.mark.parametrize("text", ["", "x", "x45", "w90", "180", "x90;y90", "x9999999", "nan"])
def test_what_is_no_turn_is_refused(text):
    with pytest.raises(InputError, match="x180"):
        turn_matrix(text)
