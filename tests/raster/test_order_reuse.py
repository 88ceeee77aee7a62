"""Orders that serve several frames: older where that is allowed, of the view itself at rest."""

from __future__ import annotations

import numpy as np
import pytest

from splatview import raster
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits
from splatview.scene.order_reuse import ResortPolicy, view_change

SIZE = (48, 32)
ANEW = RenderSettings()


def at(degrees: float) -> Camera:
    angle = np.radians(degrees)
    return look_at(
        (3 * np.sin(angle), -0.3, -3 * np.cos(angle)), (0, 0, 0), up=(0, -1, 0), width=SIZE[0], height=SIZE[1]
    )


def drawn(
    scene: Gaussians, camera: Camera, settings: RenderSettings, order: raster.ReusableOrder | None, edits=None
):
    frame = raster.draw_frame(
        raster.parameters_of(scene), camera, settings, raster.Workspace(), depth_order=order, edits=edits
    )
    return frame.image, order is not None and order.resort_policy.stale


def exact(scene: Gaussians, camera: Camera, edits: SceneEdits | None = None) -> np.ndarray:
    return drawn(scene, camera, ANEW, None, edits)[0]


@pytest.fixture(scope="module")
def scene(random_gaussians) -> Gaussians:
    return random_gaussians(300, seed=6)


def test_every_third_frame_of_a_path_has_its_own_order(scene):
    settings, order = RenderSettings(resort_frames=3), raster.ReusableOrder()
    for number in range(7):
        picture, stale = drawn(scene, at(10 * number), settings, order)
        apart = np.abs(picture - exact(scene, at(10 * number))).max()
        assert stale == (number % 3 != 0)
        assert apart > 1e-2 if stale else apart < 1e-5, number


def test_a_view_at_rest_has_its_own_order_and_keeps_it(scene):
    settings, order = RenderSettings(resort_frames=100), raster.ReusableOrder()
    drawn(scene, at(0), settings, order)
    assert drawn(scene, at(20), settings, order)[1]
    for _ in range(2):
        picture, stale = drawn(scene, at(20), settings, order)
        assert not stale and np.abs(picture - exact(scene, at(20))).max() < 1e-5


def test_what_comes_into_view_has_its_place():
    # A red splat is culled when the order is made, behind the eye, and then stands before a green one.
    scene = Gaussians(
        means=np.array([[0, 0, -3.5], [0, 0, 0]], np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        log_scales=np.full((2, 3), np.float32(-1)),
        opacity_logits=np.array([6, 6], np.float32),
        sh=np.array([[[1.7, -1.7, -1.7]], [[-1.7, 1.7, -1.7]]], np.float32),
    )
    order, settings = raster.ReusableOrder(), RenderSettings(resort_frames=9)
    first, _ = drawn(scene, at(0), settings, order)
    back = look_at((0, 0, -6), (0, 0, 0), up=(0, -1, 0), width=SIZE[0], height=SIZE[1])
    later, stale = drawn(scene, back, settings, order)
    middle = (SIZE[1] // 2, SIZE[0] // 2)
    assert first[middle][1] > 0.9 > first[middle][0]
    assert stale and later[middle][0] > 0.9 > later[middle][1]


def test_edits_move_splats_in_the_order_too(scene):
    marks = np.zeros(len(scene), np.uint32)
    marks[:150] = 1 << PALETTE_SHIFT
    edits = SceneEdits(marks=marks, palette=(IDENTITY, Adjustment(translation=(0.0, 0.0, 0.7))))
    order, settings = raster.ReusableOrder(), RenderSettings(resort_frames=9)
    drawn(scene, at(0), settings, order)
    picture, stale = drawn(scene, at(0.5), settings, order, edits)
    assert not stale and np.abs(picture - exact(scene, at(0.5), edits)).max() < 1e-5
    assert drawn(scene, at(1), settings, order, edits)[1], "the same edits keep their order"


def test_another_scene_is_sorted(scene, random_gaussians):
    order, settings = raster.ReusableOrder(), RenderSettings(resort_frames=9)
    drawn(scene, at(0), settings, order)
    other = random_gaussians(200, seed=7)
    picture, stale = drawn(other, at(5), settings, order)
    assert not stale and np.abs(picture - exact(other, at(5))).max() < 1e-5
    empty = other.take(np.zeros(0, np.intp))
    assert not drawn(empty, at(6), settings, order)[0][..., 3].any()


def test_after_so_many_degrees():
    resort_policy, settings = ResortPolicy(), RenderSettings(resort_degrees=5.0)
    place = {"key": None, "centre": np.zeros(3), "radius": 1.0}
    assert [resort_policy.due(at(n), settings, **place) for n in (0, 2, 4, 5, 9, 10, 10)] == [
        *(True, False, False, True, False, True),
        True,  # rests
    ]


def test_flying_counts_as_turning_by_what_the_scene_sees_of_it():
    ahead = look_at((0, 0, -3), (0, 0, 0), up=(0, -1, 0), width=8, height=8)
    aside = look_at((3, 0, -3), (3, 0, 0), up=(0, -1, 0), width=8, height=8)
    assert view_change(ahead, aside, np.zeros(3), 1.0) == pytest.approx(45)
    assert view_change(at(0), at(30), np.zeros(3), 1.0) == pytest.approx(30, abs=2.1)
    assert view_change(ahead, ahead, np.zeros(3), 0.0) == 0


@pytest.mark.parametrize("wrong", [{"resort_frames": 0}, {"resort_degrees": -1.0}])
def test_settings_that_cannot_be(wrong):
    with pytest.raises(ValueError, match="resort_frames must be at least 1"):
        RenderSettings(**wrong)
