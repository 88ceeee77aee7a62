"""`splatview render` through lenses and with parallel rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.scene import Gaussians, Lens, look_at, reference
from splatview.scene.camera import stepped_back, through_lens, with_parallel_rays
from splatview.scene.formats import load_scene, save_camera, save_scene

VIEW = ["--eye", "-0.5,-1,-3", "--target", "0,0.1,0", "--size", "48x32", "--renderer", "cpu"]
CAMERA = look_at((-0.5, -1, -3), (0, 0.1, 0), up=(0, -1, 0), width=48, height=32)
LENS = Lens(model="OPENCV", parameters=(-0.2, 0.02, 0.01, 0.0))


@pytest.fixture
def scene(tmp_path: Path, random_gaussians: Callable[..., Gaussians]) -> Path:
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(200, sh_degree=1), path)
    return path


@pytest.fixture
def picture(tmp_path: Path, scene: Path) -> Callable[..., np.ndarray]:
    def render(*options: object) -> np.ndarray:
        out = tmp_path / "out.npy"
        assert main(["render", str(scene), "-o", str(out), *map(str, options)]) == 0
        return np.load(out)

    return render


def test_a_lens_by_its_numbers_keeps_the_field_of_view(picture, scene):
    camera = through_lens(CAMERA, LENS)
    truth = reference.render(load_scene(scene), camera)
    assert np.abs(picture(*VIEW, "--lens", "opencv:-0.2,0.02,0.01,0") - truth).max() < 2e-3
    top = camera.image_points(np.array([0.0, -CAMERA.height / 2 / CAMERA.fy, 1.0]))
    assert top[1] == pytest.approx(0, abs=0.7), "but for the lens's own skew"


def test_parallel_rays_show_the_target_as_large(picture, scene):
    depth = float(np.linalg.norm(CAMERA.eye - (0, 0.1, 0)))
    camera = with_parallel_rays(CAMERA, depth)
    truth = reference.render(load_scene(scene), stepped_back(camera, np.zeros(3), 1.0))
    assert np.abs(picture(*VIEW, "--orthographic") - truth).max() < 2e-3
    # From within the scene nothing of it is cut off.
    inside = picture("--eye", "0,0,-0.1", "--target", "0,0,0", "--size", "48x32", "--orthographic")
    assert (inside[..., 3] > 0.5).all()


def test_a_camera_file_s_lens_and_without_it(picture, scene, tmp_path, capsys):
    camera = replace(CAMERA, lens=LENS)
    save_camera(camera, tmp_path / "cam.json")
    gaussians = load_scene(scene)
    file = ["--camera", tmp_path / "cam.json", "--renderer", "cpu"]
    assert np.abs(picture(*file) - reference.render(gaussians, camera)).max() < 2e-3
    assert np.abs(picture(*file, "--lens", "none") - reference.render(gaussians, CAMERA)).max() < 2e-3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--lens", "BOTTLE:1"], "unknown lens model 'BOTTLE'"),
        (["--lens", "OPENCV:1,2"], "a OPENCV lens has 4 parameters, got 2"),
        (["--lens", "RADIAL:1,x"], "'x' is not a number"),
        (["--lens", "FOV:0.9", "--orthographic"], "--orthographic has no lens"),
        (["--lens", "SIMPLE_RADIAL:-0.3", "--fov", "120"], "sees at most 93.02 degrees, not the 120"),
    ],
)
def test_what_cannot_be(scene, tmp_path, capsys, options, message):
    view = [value for value in VIEW if value not in ("--renderer", "cpu")]
    code = main(["render", str(scene), "-o", str(tmp_path / "out.png"), *view, *options])
    err = capsys.readouterr().err
    assert code == 2 and len(err.splitlines()) == 1 and message in err, err


def test_a_lens_sees_no_farther_than_its_reach():
    with pytest.raises(ValueError, match="sees at most"):
        through_lens(replace(CAMERA, fy=1.0), Lens(model="SIMPLE_RADIAL", parameters=(-0.5,)))
