"""Dots on the faces of crops: where they are, and what a drag of one does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imgui_bundle import ImVec2

from splatview.scene import look_at
from splatview.scene.camera import stepped_back
from splatview.scene.edits import Adjustment, Crop
from splatview.viewer.editing.face_handles import FACES, along, dragged, face_at, place_of
from splatview.viewer.editing.tool_state import Face, FaceDrag
from splatview.viewer.navigation import Lens
from splatview.viewer.navigation.view import look_from
from splatview.viewer.theme import point_on_picture

TURNED = (np.cos(0.4), 0.0, np.sin(0.4), 0.0)

BOX = Crop(centre=(0.3, -0.2, 0.1), half_extents=(1.0, 0.5, 0.8), rotation=TURNED)


def perspective():
    return look_at((2.5, 1.5, -4.0), (0, 0, 0), up=(0, -1, 0), width=640, height=480)


def parallel():
    view = look_from(np.array([2.5, 1.5, -4.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
    view = replace(view, lens=replace(Lens(), orthographic=True))
    return stepped_back(view.camera(640, 480), np.zeros(3), 3.0)


def pixel(camera, place):
    at = point_on_picture(camera, ImVec2(0, 0), place.tolist())
    assert at is not None
    return at.x, at.y


@pytest.mark.parametrize("camera", [perspective(), parallel()], ids=["perspective", "parallel"])
@pytest.mark.parametrize("face", FACES, ids=str)
def test_a_face_follows_the_mouse_and_the_opposite_one_stays(camera, face):
    opposite = Face(face.axis, -face.sign)
    outwards = face.sign * Adjustment(rotation=BOX.rotation).R[:, face.axis]
    wanted = place_of(BOX, face) + 0.2 * outwards
    start = along(BOX, face, camera, *pixel(camera, place_of(BOX, face)))
    assert start is not None and start == pytest.approx(BOX.half_extents[face.axis], abs=1e-4)
    moved = dragged(FaceDrag(face=face, crop=BOX, start=start), camera, *pixel(camera, wanted))
    np.testing.assert_allclose(place_of(moved, face), wanted, atol=1e-4)
    np.testing.assert_allclose(place_of(moved, opposite), place_of(BOX, opposite), atol=1e-9)
    others = [axis for axis in range(3) if axis != face.axis]
    assert [moved.half_extents[axis] for axis in others] == [BOX.half_extents[axis] for axis in others]


def test_a_face_does_not_pass_the_opposite_one():
    camera, face = perspective(), Face(0, 1)
    drag = FaceDrag(face=face, crop=BOX, start=1.0)
    outwards = Adjustment(rotation=BOX.rotation).R[:, 0]
    moved = dragged(drag, camera, *pixel(camera, place_of(BOX, face) - 2.5 * outwards))
    assert 0 < moved.half_extents[0] < 0.01
    np.testing.assert_allclose(place_of(moved, Face(0, -1)), place_of(BOX, Face(0, -1)), atol=1e-9)


def test_a_pole_of_a_sphere_changes_its_radius_alone():
    camera, face = perspective(), Face(1, -1)
    sphere = Crop(shape="sphere", centre=(0.0, 0.1, 0.0), half_extents=(0.7, 0.7, 0.7))
    wanted = place_of(sphere, face) + np.array([0.0, -0.3, 0.0])
    moved = dragged(FaceDrag(face=face, crop=sphere, start=0.7), camera, *pixel(camera, wanted))
    assert moved.centre == sphere.centre
    np.testing.assert_allclose(moved.half_extents, 1.0, atol=1e-4)


def test_a_face_that_looks_at_the_eye_stays():
    box = Crop()
    camera = look_at((0, 0, -5), (0, 0, 0), up=(0, -1, 0), width=640, height=480)
    assert along(box, Face(2, -1), camera, camera.cx, camera.cy) is None
    drag = FaceDrag(face=Face(2, -1), crop=box, start=1.0)
    assert dragged(drag, camera, camera.cx, camera.cy) == box


def test_the_dot_under_the_mouse_is_found():
    camera = perspective()
    for face in FACES:
        x, y = pixel(camera, place_of(BOX, face))
        assert face_at(BOX, camera, x + 3, y - 2, reach=8) == face
    assert face_at(BOX, camera, 2, 2, reach=8) is None
