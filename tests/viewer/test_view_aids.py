"""Grid, axes, legends and turns by their numbers."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from splatview import shaders
from splatview.scene import Lens, look_at
from splatview.scene.camera import with_parallel_rays
from splatview.scene.formats import save_scene
from splatview.shaders.colour_maps import MOST_OVERDRAW, colour_map
from splatview.viewer import ground_grid, view_aids
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing.session import session_of
from splatview.viewer.ground_grid import axis_lines, cell_size, ground_lines, plane_axes
from splatview.viewer.open import open_paths

CAMERA = look_at((0.3, -1.5, -4.0), (0, 0, 0), up=(0, -1, 0), width=200, height=120)
UP = np.array((0.0, -1.0, 0.0))


@pytest.mark.parametrize(
    ("radius", "cell"), [(5.0, 1.0), (9.9, 1.0), (10.0, 2.0), (25.0, 5.0), (0.05, 0.01), (4e6, 5e5)]
)
def test_cells_are_round_numbers(radius, cell):
    assert cell_size(radius) == pytest.approx(cell)


@pytest.mark.parametrize("up", [(0, -1, 0), (0, 0, 1), (0.6, 0.8, 0.0), (1, 1, 1)])
def test_the_ground_is_square_to_up(up):
    up = np.array(up) / np.linalg.norm(up)
    both = np.vstack([plane_axes(up), up])
    np.testing.assert_allclose(both @ both.T, np.eye(3), atol=1e-12)


def test_grid_lines_lie_on_the_ground_at_multiples_of_the_cell():
    floor = np.array((0.4, 0.8, 0.1))
    lines = ground_lines(CAMERA, UP, floor, 2.0)
    assert len(lines.ends) > 500 and np.isfinite(lines.ends).all()
    assert (lines.colours[..., 3] <= 1).all() and (lines.colours[..., 3] >= 0).all()
    # Back to the ground: where the pixels' rays meet it.
    ends = lines.ends.astype(np.float64)
    rays = CAMERA.points_at(ends, 1.0) @ CAMERA.R_camera_world
    points = CAMERA.eye + rays * ((floor[1] - CAMERA.eye[1]) / rays[..., 1])[..., None]
    near = np.linalg.norm(points - floor, axis=2).max(axis=1) < 3
    cells = points[near][..., [0, 2]] / cell_size(2.0)
    off = np.abs(cells - np.round(cells)).max(axis=1).min(axis=1)
    assert near.sum() > 50 and off.max() < 0.02


@pytest.mark.parametrize("kind", ["below", "inside", "lens", "parallel", "along"])
def test_lines_are_drawn_from_everywhere(kind):
    camera = CAMERA
    if kind == "below":
        camera = look_at((0, 3, 0.1), (0, 0, 0), up=(0, 0, 1), width=90, height=60)
    if kind == "inside":
        camera = look_at((0, 0.7999, 0), (1, 0.7999, 0), up=(0, -1, 0), width=90, height=60)
    if kind == "along":
        camera = look_at((0, 0.8, -3), (0, 0.8, 0), up=(0, -1, 0), width=90, height=60)
    if kind == "lens":
        camera = replace(CAMERA, lens=Lens(model="SIMPLE_RADIAL", parameters=(-0.2,)))
    if kind == "parallel":
        camera = with_parallel_rays(CAMERA, 4.0)
    grid, axes = ground_lines(camera, UP, np.array((0, 0.8, 0)), 2.0), axis_lines(camera, 1.0)
    for lines in (grid, axes):
        assert np.isfinite(lines.ends).all() and np.isfinite(lines.vertices()).all()
    assert len(grid.ends) >= ground_grid.PIECES


def test_legends_have_the_colours_of_the_shaders():
    dark, bright = colour_map("inferno", 32)[[0, -1]]
    assert dark.max() < 0.05 and bright[0] > 0.9 and bright.min() > 0.5
    purple, yellow = colour_map("viridis", 32)[[0, -1]]
    assert purple[2] > purple[1] and yellow[:2].min() > 0.8 and yellow[2] < 0.3
    text = resources.files(shaders).joinpath("quads/resolve.frag.glsl").read_text()
    (most,) = re.findall(r"MOST_OVERDRAW = ([\d.]+)", text)
    assert float(most) == MOST_OVERDRAW


@pytest.fixture
def opened(app, tmp_path, random_gaussians, wait_for_loading):
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(60), path)
    open_paths(app, [path])
    wait_for_loading(app)
    return app


@pytest.mark.parametrize("name", ["+X", "-X", "+Y", "-Y", "+Z", "-Z"])
def test_up_by_one_command(opened, name):
    COMMANDS[f"up_{name}"].run(opened)
    up = opened.view.up
    assert up["XYZ".index(name[1])] == (1 if name[0] == "+" else -1)
    assert abs(opened.view.R_camera_world[0] @ up) < 1e-9, "level"
    assert COMMANDS[f"up_{name}"].checked(opened)


def test_the_view_is_turned_by_90_degrees_and_back(opened):
    before = opened.view
    COMMANDS["roll_right"].run(opened)
    right = opened.view
    np.testing.assert_allclose(right.forward, before.forward, atol=1e-9)
    np.testing.assert_allclose(-right.R_camera_world[1], before.R_camera_world[0], atol=1e-9)
    COMMANDS["roll_left"].run(opened)
    np.testing.assert_allclose(opened.view.R_camera_world, before.R_camera_world, atol=1e-9)


def test_the_scene_is_turned_by_90_degrees_as_a_step_of_editing(opened):
    session = session_of(opened)
    assert session is not None
    before = view_aids.bounds(opened)
    COMMANDS["turn_scene_+Y"].run(opened)
    assert len(session.document.history.done) == 1 and opened.edits is not None and opened.edits.adjusts
    np.testing.assert_allclose(opened.edits.palette[-1].R @ (0, 0, 1), (1, 0, 0), atol=1e-7)
    after = view_aids.bounds(opened)
    assert before is not None and after is not None
    assert np.linalg.norm(after[0] - before[0]) < 0.05 * before[1], "about the middle"
