"""Parallel rays and camera lenses in a real window."""

from __future__ import annotations

from dataclasses import replace

import pytest

from splatview.scene import Lens, look_at
from splatview.scene.formats import save_camera, save_scene


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("quads", marks=pytest.mark.slow)])
def test_parallel_rays_and_a_fisheye(drive, random_gaussians, tmp_path, renderer):
    scene, cameras = tmp_path / "ball.ply", tmp_path / "cam.json"
    save_scene(random_gaussians(800, seed=4), scene)
    fisheye = Lens(model="OPENCV_FISHEYE", parameters=(0.02, 0.0, 0.0, 0.0))
    camera = look_at((0.3, 0.2, -0.9), (0, 0, 0), up=(0, -1, 0), width=600, height=400)
    save_camera(replace(camera, lens=fisheye, fx=180.0, fy=180.0), cameras)
    found = drive(
        "other_rays",
        scene,
        script="rays_drives.py",
        renderer=renderer,
        size=[700, 450] if renderer == "cpu" else [520, 360],
        cameras=str(cameras),
        shot_parallel=str(tmp_path / "parallel.png"),
        shot_fisheye=str(tmp_path / "fisheye.png"),
    )
    assert found["orthographic"] and found["perspective"]
    assert found["scaled"] == pytest.approx(0.85**-2), "the wheel's two notches"
    assert found["axis"] == [True, [0, 0, -1]]
    assert found["selected"] > 5
    assert found["through"] and found["without"]
    assert found["differs"] > 0.1
