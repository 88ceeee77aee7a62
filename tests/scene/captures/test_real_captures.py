"""Captures that COLMAP made of real photos."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.scene.captures import load_capture


@pytest.mark.parametrize(
    ("name", "downscale", "size", "photos", "held_out"),
    [("banana", 2, (375, 249), 15, 2), ("miku", 4, (245, 183), 97, 13)],
)
def test_cameras_see_their_points(data_file, name, downscale, size, photos, held_out):
    folder = data_file(f"captures/{name}")
    capture = load_capture(folder, downscale=downscale)
    assert capture.name == name
    assert capture.warnings == ()
    assert (len(capture.photos), len(capture.held_out)) == (photos, held_out)
    assert capture.held_out[1] is capture.photos[8]
    for photo in capture.photos:
        camera = photo.camera
        assert (camera.width, camera.height) == size
        assert photo.image().shape == (size[1], size[0], 3)
        assert photo.mask() is None
    # Points have the colours of the photos where they fall, but those that something hides from there.
    distances, shuffled = [], []
    for photo in capture.photos[::4]:
        camera = photo.camera
        x, y, z = (capture.points @ camera.R_camera_world.T + camera.t_camera_world).T
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        seen = (z > 0) & (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
        assert seen.mean() > 0.2
        pixels = photo.image()[v[seen].astype(int), u[seen].astype(int)].astype(float)
        colours = capture.point_colours[seen].astype(float)
        distances.append(np.median(np.abs(pixels - colours)))
        shuffled.append(np.median(np.abs(pixels - np.roll(colours, 1000, axis=0))))
    assert np.mean(distances) < 0.75 * np.mean(shuffled)


@pytest.mark.parametrize("name", ["banana", "miku"])
def test_both_formats_say_the_same(data_file, name):
    folder = data_file(f"captures/{name}")
    colmap = load_capture(folder, downscale=8)
    transforms = load_capture(folder / "transforms.json", downscale=8)
    assert transforms.scene_radius == pytest.approx(colmap.scene_radius)
    for a, b in zip(colmap.photos, transforms.photos, strict=True):
        assert f"images/{a.name}" == b.name
        assert a.held_out == b.held_out
        np.testing.assert_allclose(a.camera.world_to_camera, b.camera.world_to_camera, atol=1e-9)
        np.testing.assert_array_equal(a.image(), b.image())
    # Random points are where the reconstruction found surfaces, give or take their spread.
    inner = np.percentile(colmap.points, [25, 75], axis=0).mean(axis=0)
    spread = np.percentile(np.linalg.norm(colmap.points - inner, axis=1), 90)
    assert np.linalg.norm(np.median(transforms.points, axis=0) - inner) < spread
