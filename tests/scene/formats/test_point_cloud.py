"""Plain point clouds open as round splats of a fitting size."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.scene import InputError, look_at
from splatview.scene.formats import load_scene
from splatview.scene.formats.point_cloud import CLAMP, morton_codes, spacing
from splatview.scene.reference import render


def grid(step: float) -> np.ndarray:
    """(400, 3): a plane of points `step` apart."""
    x, y = np.meshgrid(np.arange(20), np.arange(20))
    return np.stack([x.ravel() * step, y.ravel() * step, np.zeros(400)], axis=1).astype(np.float32)


def opened(tmp_path, make_ply, columns, **options):
    path = tmp_path / "points.ply"
    path.write_bytes(make_ply(columns, **options))
    return load_scene(path)


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_colours_of_bytes(tmp_path, make_ply, form):
    points = grid(0.1)
    columns = dict(zip("xyz", points.T, strict=True))
    colours = {"red": np.full(400, 255, "u1"), "green": np.full(400, 51, "u1"), "blue": np.zeros(400, "u1")}
    extra = {"alpha": np.full(400, 9, "u1")}
    # An empty face element is what point cloud tools write: no mesh.
    faces = ("element face 0\nproperty list uchar int vertex_indices", b"")
    scene = opened(tmp_path, make_ply, columns | colours | extra, form=form, after=faces)
    assert np.array_equal(scene.means, points)
    assert np.array_equal(scene.extras["alpha"], extra["alpha"])
    assert any("point cloud of 400 points (coloured)" in comment for comment in scene.comments)
    camera = look_at((0.95, 0.95, -3), (0.95, 0.95, 0), up=(0, -1, 0), width=32, height=32)
    picture = render(scene, camera)
    # The splats close the gaps: the middle of the picture is the cloud's colour, opaque.
    assert np.abs(picture[12:20, 12:20, :3] - (1, 0.2, 0)).max() < 0.02
    assert picture[12:20, 12:20, 3].min() > 0.98


@pytest.mark.parametrize(
    ("colours", "expected"),
    [
        (np.array([0.25, 0.5, 1.0], "f4"), (0.25, 0.5, 1.0)),
        (np.array([51, 102, 255], "f4"), (0.2, 0.4, 1.0)),
        (np.array([13107, 26214, 65535], "u2"), (0.2, 0.4, 1.0)),
    ],
)
def test_other_colour_types(tmp_path, make_ply, colours, expected):
    columns = dict(zip("xyz", grid(0.1).T, strict=True))
    columns |= {name: np.repeat(value, 400) for name, value in zip("rgb", colours, strict=True)}
    scene = opened(tmp_path, make_ply, columns)
    assert np.allclose(scene.sh[:, 0] * 0.28209479 + 0.5, expected, atol=1e-6)


def test_no_colours_give_grey(tmp_path, make_ply):
    scene = opened(tmp_path, make_ply, dict(zip("xyz", grid(0.1).T, strict=True)))
    assert not scene.sh.any()
    assert any("grey" in comment for comment in scene.comments)


def test_double_and_integer_positions_stay_exact(tmp_path, make_ply):
    points = grid(1).astype(np.float64) + 123456.78125
    assert np.array_equal(opened(tmp_path, make_ply, dict(zip("xyz", points.T, strict=True))).means, points)
    points = grid(1).astype(np.int32) + 2**24 + 1
    assert np.array_equal(opened(tmp_path, make_ply, dict(zip("xyz", points.T, strict=True))).means, points)


def test_no_points_and_ill_points(tmp_path, make_ply):
    for count in (0, 1, 3):
        points = np.zeros((count, 3), "f4")
        if count == 3:
            points[0], points[1, 1] = np.nan, np.inf
        scene = opened(tmp_path, make_ply, dict(zip("xyz", points.T, strict=True)))
        assert len(scene) == count and np.isfinite(scene.log_scales).all()


def test_a_coordinate_missing(tmp_path, make_ply):
    with pytest.raises(InputError, match="no z; it is neither splats nor a point cloud"):
        opened(tmp_path, make_ply, {"x": np.zeros(2, "f4"), "y": np.zeros(2, "f4")})


@pytest.mark.parametrize("step", [1e-4, 1.0, 1e5])
def test_spacing_follows_density(rng, step):
    points = grid(step)
    assert (
        np.array_equal(
            spacing(points[rng.permutation(400)]).round(6), np.full(400, np.float32(step)).round(6)
        )
        or (np.abs(spacing(points) / step - 1) < 0.42).all()
    )


def test_spacing_of_random_points_is_near_the_true_neighbour(rng):
    points = rng.normal(size=(2000, 3))
    true = np.sqrt(((points[:, None] - points) ** 2).sum(-1) + np.diag(np.full(2000, np.inf))).min(axis=1)
    ratio = np.median(spacing(points)) / np.median(true)
    assert 1 <= ratio < 1.6


def test_spacing_of_far_points_and_copies(rng):
    points = np.concatenate([grid(0.1), grid(0.1), [[1e6, 0, 0]]])
    sizes = spacing(points)
    assert sizes.max() <= CLAMP * np.median(sizes) and sizes.min() >= 0.099


def test_morton_codes_interleave():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2**21 - 1] * 3], float)
    assert morton_codes(points).tolist() == [0, 1, 2, 4, 2**63 - 1]
