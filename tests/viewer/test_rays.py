"""Parallel rays and lenses in the window: views, picking, what is drawn over the picture, commands, files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import Camera, Lens, RenderSettings, look_at
from splatview.scene.formats import save_scene
from splatview.scene.projection import project
from splatview.scene.reference import composite
from splatview.viewer.camera import (
    camera_from_text,
    camera_text,
    go_to_camera,
    toggle_lenses,
    toggle_orthographic,
)
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing.gizmos import GL_FROM_CV, projection
from splatview.viewer.navigation import View, axis_view, dolly, focus, frame, pan, pick, view_from_camera
from splatview.viewer.navigation.picking import may_reach
from splatview.viewer.navigation.view import look_from
from splatview.viewer.open import open_paths
from splatview.viewer.overlays import EDGES, picture_corners, pyramids
from splatview.viewer.preferences import Bookmark, load_bookmarks, save_bookmarks

UP = np.array([0.0, -1.0, 0.0])
PINHOLE = look_at((0.3, -0.2, -2.0), (0, 0, 0), up=(0, -1, 0), fov_y=70, width=120, height=90)
BARREL = Lens(model="OPENCV", parameters=(-0.2, 0.03, 0.01, -0.01))
FISHEYE = Lens(model="OPENCV_FISHEYE", parameters=(0.02, 0.0, 0.0, 0.0))
CAMERAS = {
    "barrel": replace(PINHOLE, lens=BARREL),
    "fisheye": replace(PINHOLE, lens=FISHEYE, fx=40.0, fy=40.0),
    "parallel": replace(PINHOLE, orthographic=True, fx=38.0, fy=38.0),
}


def view(**lens) -> View:
    found = look_from(np.array([1.0, -2.0, -4.0]), np.array([0.1, 0.2, 0.3]), UP)
    return replace(found, lens=replace(found.lens, **lens))


def seen(shown: Camera, point: np.ndarray) -> np.ndarray:
    return shown.image_points(shown.R_camera_world @ point + shown.t_camera_world)


@pytest.fixture
def opened(app, tmp_path, random_gaussians, wait_for_loading):
    path = tmp_path / "room.ply"
    save_scene(random_gaussians(200), path)
    open_paths(app, [path])
    wait_for_loading(app)
    return app


def test_what_is_at_the_target_is_as_large_with_parallel_rays():
    across = view().target + view().R_camera_world[0] * 0.5
    a, b = (seen(v.camera(640, 480), across) for v in (view(), view(orthographic=True)))
    np.testing.assert_allclose(a, b, atol=1e-9)
    # Nearer and farther it stays so, which a pinhole's does not.
    deeper = across + view().forward
    np.testing.assert_allclose(seen(view(orthographic=True).camera(640, 480), deeper), b, atol=1e-9)
    assert np.abs(seen(view().camera(640, 480), deeper) - a).max() > 5


def test_moves_with_parallel_rays():
    parallel = view(orthographic=True)
    point = parallel.target
    before = seen(parallel.camera(640, 480), point)
    moved = seen(pan(parallel, 30, -12, height=480).camera(640, 480), point)
    np.testing.assert_allclose(moved - before, (30, -12), atol=1e-9)
    off = point + parallel.R_camera_world[0]
    near = seen(dolly(parallel, 0.5).camera(640, 480), off) - before
    np.testing.assert_allclose(near, 2 * (seen(parallel.camera(640, 480), off) - before), atol=1e-9)
    focused = focus(parallel, off + parallel.forward * 3)
    np.testing.assert_allclose(seen(focused.camera(640, 480), off), (320, 240), atol=1e-9)
    assert focused.camera(640, 480).fx == parallel.camera(640, 480).fx, "the scale stays"
    for kept in (axis_view(parallel, "+X"), frame(parallel, point, 2.0)):
        assert kept.lens.orthographic


@pytest.mark.parametrize("kind", CAMERAS)
def test_a_camera_of_the_windows_shape_is_shown_exactly(kind):
    camera = replace(CAMERAS[kind], cx=55.0, cy=48.0)
    shown = view_from_camera(camera, distance=2.5, up=UP).camera(camera.width, camera.height)
    points = np.random.default_rng(0).uniform(-0.4, 0.4, size=(20, 3))
    for point in points:
        np.testing.assert_allclose(seen(shown, point), seen(camera, point), atol=1e-9)
    assert shown.lens == camera.lens and shown.orthographic == camera.orthographic


@pytest.mark.parametrize("kind", CAMERAS)
def test_picking_agrees_with_compositing_all_splats(kind, random_gaussians):
    """The point picked is seen at the pixel, and nothing that reaches the pixel was overlooked."""
    scene, camera, settings = random_gaussians(500, seed=6), CAMERAS[kind], RenderSettings()
    footprints = project(scene, camera, settings)
    found = 0
    for x, y in np.random.default_rng(1).uniform((5, 5), (115, 85), size=(25, 2)):
        everything = np.arange(len(footprints.indices))
        _, light = composite(footprints, everything, np.array([x]), np.array([y]), settings)
        picked = pick(scene, camera, settings, x, y)
        assert (picked is not None) == bool(light[0] <= 0.98)
        if picked is None:
            continue
        found += 1
        np.testing.assert_allclose(seen(camera, picked.point), (x, y), atol=1e-6)
        near = may_reach(scene, camera, settings, x, y)
        dx, dy = np.abs(footprints.means2d - (x, y)).T
        reaching = footprints.indices[
            (dx <= footprints.half_extents[:, 0]) & (dy <= footprints.half_extents[:, 1])
        ]
        assert set(reaching) <= set(near)
    assert found > 5


def test_pyramids_of_and_through_other_cameras():
    seen_by = replace(PINHOLE, lens=BARREL)
    camera = look_at((0.2, 0.1, 0.5), (1, 0, 3), up=(0, -1, 0), width=60, height=40)
    for shown in (
        camera,
        replace(camera, orthographic=True, fx=90.0, fy=90.0),
        replace(camera, lens=FISHEYE),
    ):
        ((_, lines),) = pyramids([shown], seen_by, 0.3)
        corners = np.concatenate([np.zeros((1, 3)), 0.3 * picture_corners(shown, 0.3)])
        world = (corners - shown.t_camera_world) @ shown.R_camera_world
        expected = np.array([seen(seen_by, point) for point in world])
        np.testing.assert_allclose(lines, expected[EDGES], atol=1e-6)
    # Beyond what a lens shows nothing is drawn.
    beside = look_at((30.0, 0, -1.5), (40, 0, 0), up=(0, -1, 0))
    assert pyramids([beside], replace(PINHOLE, lens=Lens(model="RADIAL", parameters=(-0.3, 0.0))), 0.1) == []


@pytest.mark.parametrize("camera", [PINHOLE, CAMERAS["parallel"]], ids=["pinhole", "parallel"])
def test_handles_are_projected_as_the_picture_is(camera):
    camera = replace(camera, cx=50.0, cy=40.0)
    for point in np.random.default_rng(2).uniform(-1, 1, size=(10, 3)):
        clip = projection(camera) @ GL_FROM_CV @ camera.world_to_camera @ np.append(point, 1)
        x, y = (clip[:2] / clip[3] * (1, -1) + 1) / 2 * (camera.width, camera.height)
        np.testing.assert_allclose((x, y), seen(camera, point), atol=1e-6)


def test_parallel_rays_by_a_command_cut_nothing_off(opened):
    opened.steer(dolly(opened.view, 0.02))
    toggle_orthographic(opened)
    assert opened.view.lens.orthographic and opened.camera.orthographic
    means = opened.scene.gaussians.means
    depths = means @ opened.camera.R_camera_world[2] + opened.camera.t_camera_world[2]
    assert (depths > 0).all()
    # It is the same picture as without the step back.
    point = means[0].astype(np.float64)
    np.testing.assert_allclose(
        seen(opened.camera, point), seen(opened.view.camera(*opened.picture_size), point), atol=1e-6
    )
    toggle_orthographic(opened)
    assert not opened.camera.orthographic
    for name in ("toggle_orthographic", "toggle_lenses"):
        assert name in COMMANDS


def test_views_of_cameras_go_through_their_lenses_or_not(opened):
    opened.cameras = [PINHOLE, CAMERAS["barrel"], CAMERAS["fisheye"]]
    opened.preferences = replace(opened.preferences, smooth=False)
    go_to_camera(opened, 1)
    assert opened.camera.lens == BARREL
    toggle_lenses(opened)
    assert opened.camera.lens is None
    go_to_camera(opened, 2)
    assert opened.camera.lens is None
    toggle_lenses(opened)
    assert opened.camera.lens == FISHEYE
    go_to_camera(opened, 0)
    assert opened.camera.lens is None


@pytest.mark.parametrize("kind", CAMERAS)
def test_clipboard_and_bookmarks_keep_how_rays_go(tmp_path, kind):
    camera = CAMERAS[kind]
    assert camera_from_text(camera_text(camera)).same_view(camera)
    marked = Bookmark(name="here", view=view_from_camera(camera, distance=2.0, up=UP))
    scene = tmp_path / "scene.ply"
    save_bookmarks(scene, [marked])
    (found,) = load_bookmarks(scene)
    assert found.view.lens == marked.view.lens


def test_a_clipboard_with_a_lens_that_is_none_says_so():
    text = camera_text(CAMERAS["barrel"]).replace("OPENCV", "BOTTLE")
    with pytest.raises(ValueError, match="unknown lens model 'BOTTLE'"):
        camera_from_text(text)
