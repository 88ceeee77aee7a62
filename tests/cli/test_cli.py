"""The commands' work: pictures that agree with the reference, receipts, previews."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from splatview.cli.arguments import Orbit, with_joined_values
from splatview.cli.main import main
from splatview.cli.render import eight_bit
from splatview.measure.metrics import psnr
from splatview.renderers import choices
from splatview.scene import Gaussians, ImageModel, RenderSettings, look_at, reference
from splatview.scene.background import Gradient, Panorama
from splatview.scene.depth_of_field import Aperture, mean_picture
from splatview.scene.first_view import first_view
from splatview.scene.formats import load_scene, save_camera, save_scene

VIEW = ["--eye", "-0.5,-1,-3", "--target", "0,0.1,0", "--size", "48x32"]
CAMERA = look_at((-0.5, -1, -3), (0, 0.1, 0), up=(0, -1, 0), width=48, height=32)


@pytest.fixture
def gaussians(random_gaussians: Callable[..., Gaussians]) -> Gaussians:
    return random_gaussians(200, sh_degree=2)


@pytest.fixture
def scene(tmp_path: Path, gaussians: Gaussians) -> Path:
    path = tmp_path / "scene.ply"
    save_scene(gaussians, path)
    return path


@pytest.fixture
def splatview(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """`splatview(argv...)`: runs it in this process; returns what it printed to standard output."""

    def run(*argv: object) -> str:
        code = main([str(argument) for argument in argv])
        out, err = capsys.readouterr()
        assert code == 0, err
        return out

    return run


@pytest.fixture
def rendered(splatview: Callable[..., str], scene: Path, tmp_path: Path) -> Callable[..., np.ndarray]:
    """`rendered(argv...)`: what `render` writes as .npy."""

    def run(*argv: object) -> np.ndarray:
        assert splatview("render", scene, "-o", tmp_path / "picture.npy", *argv) == ""
        return np.load(tmp_path / "picture.npy")

    return run


def close(image: np.ndarray, truth: np.ndarray, bound: float) -> bool:
    return image.dtype == np.float32 and bool(np.abs(image - truth).max() <= bound)


@pytest.mark.parametrize(
    ("renderer", "bound"), [("reference", 1e-6), ("cpu", 1e-4), ("tiles", 1e-3), ("quads", 1e-3)]
)
def test_renderers_draw_what_the_reference_draws(rendered, gaussians, renderer, bound):
    image = rendered(
        *VIEW,
        "--renderer",
        renderer,
        "--background",
        "0.2,0.4,0.6",
        *(["--blend", "float32"] if renderer == "quads" else []),
    )
    settings = RenderSettings(background=(0.2, 0.4, 0.6))
    truth = reference.render(gaussians, CAMERA, settings)
    assert image.shape == (32, 48, 4)
    assert close(image, truth, bound)


def test_options_change_the_image_model(rendered, gaussians):
    image = rendered(
        *(*VIEW, "--renderer", "reference", "--sh-degree", 1, "--antialiased"),
        *("--blur", 0.1, "--near", 2.9, "--fov", 30),
    )
    settings = RenderSettings(model=ImageModel(near=2.9, blur=0.1, antialiased=True), sh_degree=1)
    camera = look_at((-0.5, -1, -3), (0, 0.1, 0), up=(0, -1, 0), fov_y=30, width=48, height=32)
    assert close(image, reference.render(gaussians, camera, settings), 1e-6)


def test_a_gradient_is_behind_the_scene(rendered, gaussians):
    for text in ("gradient:#3366cc,black", "gradient:0.2,0.4,0.8,0,0,0"):
        image = rendered(*VIEW, "--renderer", "reference", "--background", text)
        sky = Gradient(top=(0.2, 0.4, 0.8), bottom=(0, 0, 0))
        truth = reference.render(gaussians, CAMERA, RenderSettings(background=sky))
        assert close(image, truth, 1e-6)


def test_a_picture_is_behind_the_scene(rendered, gaussians, tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (16, 32, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "sky.png")
    settings = RenderSettings(background=Panorama(pixels=pixels, up=(0.0, -1.0, 0.0)))
    truth = reference.render(gaussians, CAMERA, settings)
    for renderer in ("cpu", "tiles"):
        image = rendered(*VIEW, "--renderer", renderer, "--background", tmp_path / "sky.png")
        assert close(image, truth, 1e-3)


@pytest.mark.parametrize("renderer", ["cpu", "tiles"])
def test_a_lens_averages_pinholes(rendered, gaussians, renderer):
    image = rendered(
        *(*VIEW, "--renderer", renderer, "--sh-degree", 1),
        *("--aperture", 0.4, "--focus", 2.5, "--lens-samples", 5),
    )
    truth = mean_picture(
        lambda camera: reference.render(gaussians, camera, RenderSettings(sh_degree=1)),
        CAMERA,
        Aperture(diameter=0.4, focus=2.5),
        5,
    )
    assert close(image, truth, 1e-3)


def test_antialiasing_follows_the_file_unless_told(rendered, scene, gaussians):
    save_scene(replace(gaussians, comments=("SplatRenderMode: mip",)), scene)
    view = (*VIEW, "--renderer", "reference", "--blur", 0.3)
    as_trained, plain = rendered(*view), rendered(*view, "--no-antialiased")
    on, off = RenderSettings(model=ImageModel(antialiased=True)), RenderSettings()
    assert close(as_trained, reference.render(gaussians, CAMERA, on), 1e-6)
    assert close(plain, reference.render(gaussians, CAMERA, off), 1e-6)


def test_png_is_the_npy_rounded(splatview, rendered, scene, tmp_path):
    image = rendered(*VIEW, "--renderer", "reference")
    splatview("render", scene, "-o", tmp_path / "a.png", *VIEW, "--renderer", "reference")
    with Image.open(tmp_path / "a.png") as picture:
        assert (picture.mode, picture.size) == ("RGB", (48, 32))
        assert np.array_equal(np.asarray(picture), np.floor(np.clip(image[..., :3], 0, 1) * 255 + 0.5))


def test_alpha_png_is_not_premultiplied(splatview, rendered, scene, tmp_path):
    image = rendered(*VIEW, "--renderer", "reference")
    splatview("render", scene, "-o", tmp_path / "a.png", *VIEW, "--renderer", "reference", "--alpha")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.mode == "RGBA"
        pixels = np.asarray(picture) / 255
    over_black = pixels[..., :3] * pixels[..., 3:]
    bright = (image[..., :3] < image[..., 3:]).all(axis=-1)
    assert np.abs(over_black - image[..., :3])[bright].max() <= 1 / 255
    assert (pixels[image[..., 3] == 0] == 0).all()


def test_eight_bit_clips_and_rounds_to_nearest():
    values = np.array([[[-1, 0.5 / 255, 0.499 / 255, 1], [2, 1, 254.5 / 255, 1]]])
    assert eight_bit(values).tolist() == [[[0, 1, 0], [255, 255, 255]]]


def test_camera_files(rendered, gaussians, tmp_path):
    path = tmp_path / "camera.json"
    save_camera(replace(CAMERA, name="front"), path)
    truth = reference.render(gaussians, CAMERA)
    assert close(rendered("--camera", path, "--renderer", "reference"), truth, 1e-6)
    other = look_at((2, -1, -3), (0, 0, 0), width=48, height=32)
    save_camera(replace(other, name="side"), tmp_path / "other.json")
    path.write_text(f"[{path.read_text()}, {(tmp_path / 'other.json').read_text()}]")
    for choice in (["--camera-index", 1], ["--camera-name", "side"]):
        image = rendered("--camera", path, *choice, "--renderer", "reference", "--size", "24x16")
        assert close(image, reference.render(gaussians, other.resized(24, 16)), 1e-6)


def test_without_a_camera_the_scene_is_framed(rendered, gaussians):
    image = rendered("--size", "48x32", "--renderer", "reference")
    assert close(image, reference.render(gaussians, first_view(gaussians, 48, 32).camera), 1e-6)
    assert image[..., 3].max() > 0.5


def test_turning_moves_the_eye_about_the_target():
    orbit = Orbit(
        look_at((0, 0, -2), (0, 0, 1), up=(0, -1, 0)), np.array((0, 0, 1.0)), np.array((0, -1.0, 0))
    )
    quarter = orbit.turned(90)
    assert np.allclose(quarter.eye, (-3, 0, 1)) or np.allclose(quarter.eye, (3, 0, 1))
    assert np.allclose(quarter.eye + 3 * quarter.forward, (0, 0, 1))
    assert np.allclose(quarter.R_camera_world[1], (0, 1, 0))
    assert np.allclose(orbit.turned(360).world_to_camera, orbit.camera.world_to_camera)
    assert np.allclose(orbit.turned(50).eye, Orbit(orbit.turned(20), orbit.target, orbit.up).turned(30).eye)


@pytest.mark.parametrize("renderer", ["cpu", "quads", "tiles", "reference"])
def test_stats_are_one_json_object(splatview, scene, gaussians, tmp_path, renderer):
    options = ["--frames", 3, "--turn", 40, "--stats", "--renderer", renderer]
    out = splatview("render", scene, *VIEW, *options, "-o", tmp_path / "a.npy")
    stats = json.loads(out)
    assert stats["renderer"] == renderer
    assert stats["size"] == [48, 32]
    assert stats["splats"] == 200
    assert 100 < stats["visible"] <= 200
    ms = stats["ms"]
    assert 0 < ms["min"] <= ms["total"] <= ms["max"]
    assert ms["stages"]
    assert all(value >= 0 for value in ms["stages"].values())
    orbit = Orbit(CAMERA, np.array((0, 0.1, 0)), np.array((0, -1.0, 0)))
    truth = reference.render(gaussians, orbit.turned(120))
    assert psnr(np.load(tmp_path / "a.npy"), truth) > 45, "the last frame is written"


@pytest.mark.parametrize("mode", ["points", "ellipsoids", "depth", "overdraw", "normals"])
def test_visual_modes_differ_from_the_picture(rendered, mode):
    picture, image = rendered(*VIEW, "--renderer", "quads"), rendered(*VIEW, "--mode", mode)
    assert image.shape == picture.shape
    assert np.abs(image - picture).max() > 0.1


def test_info_is_what_the_scene_is(splatview, scene, gaussians):
    receipt: dict[str, Any] = json.loads(splatview("info", scene, "--json"))
    assert receipt["count"] == 200
    assert receipt["sh_degree"] == {"stored": 2, "used": 2}
    assert np.allclose(receipt["bounds"]["min"], gaussians.means.min(axis=0))
    assert np.allclose(receipt["bounds"]["max"], gaussians.means.max(axis=0))
    assert {"name", "on", "why"} <= receipt["effects"][0].keys()
    assert {"name", "count"} <= receipt["health"][0].keys()
    band = next(effect for effect in receipt["effects"] if effect["name"] == "SH band 2")
    assert band["on"] and band["saved_bytes"] == 200 * 5 * 12 and band["largest_change"] > 1 / 510
    text = splatview("info", scene)
    assert "200 splats" in text
    assert "leaving it out saves 12,000 bytes" in text and text.count("crop") == 1
    assert "SH degree 2" in text


def test_ill_splats_open_and_are_counted(splatview, scene, gaussians, tmp_path):
    means = gaussians.means.copy()
    means[:3, 1] = np.nan
    save_scene(replace(gaussians, means=means), scene)
    receipt = json.loads(splatview("info", scene, "--json"))
    assert any(finding["count"] == 3 and finding["culled"] for finding in receipt["health"])
    splatview("render", scene, *VIEW, "--renderer", "quads", "-o", tmp_path / "a.npy")
    rest = reference.render(load_scene(scene).take(np.arange(3, 200)), CAMERA)
    assert psnr(np.load(tmp_path / "a.npy"), rest) > 45


def test_an_empty_scene_is_a_scene(splatview, scene, gaussians, tmp_path):
    save_scene(gaussians.take(np.arange(0)), scene)
    assert json.loads(splatview("info", scene, "--json"))["bounds"]["min"] is None
    for renderer in ("reference", "cpu", "quads"):
        out = tmp_path / f"{renderer}.npy"
        splatview("render", scene, "--size", "9x5", "--renderer", renderer, "-o", out)
        assert (np.load(out) == 0).all()


def test_doctor_tries_the_renderers(splatview):
    findings = json.loads(splatview("doctor", "--json"))
    assert findings["renderers"]["cpu"]["works"]
    assert findings["auto"]["renderer"] in ("cpu", "quads")
    assert findings["cores"] >= 1
    if findings["gl"]["works"]:
        assert "a new program takes" in findings["gl"]["background_compiling"]["why"]
    text = splatview("doctor")
    assert f"takes {findings['auto']['renderer']}" in text


def test_help_names_every_renderer_of_the_window(splatview):
    assert f"--renderer {'|'.join(('auto', *choices('window')))} " in splatview("--help")


def test_values_may_begin_with_a_minus():
    argv = ["S", "--eye", "-1,2,3", "--turn", "-.5", "-o", "-1.png", "--stats", "-3"]
    assert with_joined_values(argv) == ["S", "--eye=-1,2,3", "--turn=-.5", "-o", "-1.png", "--stats=-3"]


def command(*argv: object, **environment: str) -> tuple[list[str], dict[str, str]]:
    kept = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    code = "import sys; from splatview.cli.main import main; sys.exit(main())"
    return [sys.executable, "-c", code, *map(str, argv)], {**kept, **environment}


def test_without_a_display_a_preview_is_written(scene, tmp_path):
    argv, environment = command(scene)
    done = subprocess.run(
        argv, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert "no display" in done.stderr.splitlines()[0]
    assert "splatview-preview.png" in done.stderr.splitlines()[0]
    with Image.open(tmp_path / "splatview-preview.png") as picture:
        assert np.ptp(np.asarray(picture)) > 50


def test_without_egl_the_preview_is_drawn_on_the_cpu(scene, tmp_path, monkeypatch, capsys):
    from splatview.renderers.gl import context
    from splatview.scene import InputError

    def none_here(**_options: object) -> None:
        raise InputError("no OpenGL here")

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(context, "create_headless_context", none_here)
    assert main([str(scene), "-o", str(tmp_path / "a.png")]) == 0
    assert "no OpenGL here; rendering on the CPU" in capsys.readouterr().err
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_light_commands_load_no_heavy_library(scene):
    heavy = "torch", "numba", "moderngl", "glfw", "imgui_bundle", "PIL"
    code = f"""
import sys
from splatview.cli.main import main
main(["--help"]), main(["render", "--help"]), main(["info", {str(scene)!r}])
print(*sorted(set(sys.modules) & set({heavy!r})), file=sys.stderr)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stderr.strip()) == (0, "")
    assert "usage: splatview [SCENE ...]" in done.stdout


def test_a_closed_pipe_ends_it_quietly(scene):
    argv, environment = command("info", scene)
    read_end, write_end = os.pipe()
    os.close(read_end)
    try:
        done = subprocess.run(
            argv, env=environment, stdout=write_end, stderr=subprocess.PIPE, timeout=120, check=False
        )
    finally:
        os.close(write_end)
    assert (done.returncode, done.stderr) == (141, b"")


def test_interrupting_ends_it_quietly(monkeypatch, scene, capsys):
    def interrupted(*_args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("splatview.cli.info.load_scene", interrupted)
    assert main(["info", str(scene)]) == 130
    assert capsys.readouterr() == ("", "")
