"""Films from the command line: frames that repeat to the bit, videos of them, and nothing half done."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.cli import film as command
from splatview.cli.main import main
from splatview.scene import film as module
from splatview.scene.camera import orbited
from splatview.scene.camera_path import CameraPath, Keyframe, Pose
from splatview.scene.camera_path_files import save_camera_path
from splatview.scene.film import film_writer
from splatview.scene.first_view import turntable_view
from splatview.scene.formats import save_scene

Run = Callable[..., tuple[int, str, str]]

FRAMES, SIZE = 8, (64, 48)

SHORT = ("--size", "64x48", "--fps", "4", "--seconds", "2", "--renderer", "cpu")

needs_av = pytest.mark.skipif(find_spec("av") is None, reason="PyAV is not installed (pip install av)")


@pytest.fixture
def run(capsys) -> Run:
    def run(*argv: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in argv])
        return code, *capsys.readouterr()

    return run


@pytest.fixture(scope="module")
def scene(tmp_path_factory, random_gaussians) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.ply"
    save_scene(random_gaussians(200, seed=6), path)
    return path


def pictures(folder: Path) -> list[np.ndarray]:
    return [np.asarray(Image.open(path)) for path in sorted(folder.iterdir())]


def test_a_turntable_is_a_folder_of_frames_the_same_to_the_bit(run, scene, tmp_path):
    code, out, err = run("film", scene, "-o", tmp_path / "one", *SHORT)
    assert (code, out) == (0, "") and err.endswith("one: 8 frames, 2 s of 64x48, by cpu\n")
    assert run("film", scene, "--turntable", "-o", tmp_path / "two", *SHORT)[0] == 0
    names = [path.name for path in sorted((tmp_path / "one").iterdir())]
    assert names == [f"frame_{i + 1:05}.png" for i in range(FRAMES)]
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    frames = pictures(tmp_path / "one")
    assert all(frame.shape == (48, 64, 3) for frame in frames)
    assert all(abs(a.astype(int) - b).max() > 20 for a, b in pairwise(frames))


def test_frames_are_the_pictures_of_render(run, scene, tmp_path):
    camera = ("--eye", "0,-1,-4", "--target", "0,0,0")
    assert run("film", scene, "-o", tmp_path / "film", *SHORT, *camera)[0] == 0
    still = ("render", scene, "-o", tmp_path / "still.png", "--size", "64x48", "--renderer", "cpu")
    assert run(*still, *camera, "--turn", 45)[0] == 0
    expected = np.asarray(Image.open(tmp_path / "still.png"))
    assert abs(pictures(tmp_path / "film")[1].astype(int) - expected).max() <= 1  # the angle has rounding


def test_a_path_of_a_file_is_followed_in_the_time_that_is_asked_for(run, scene, tmp_path):
    def pose(x: float) -> Pose:
        return Pose(target=np.array((x, 0.0, 0.0)), distance=4.0, R_camera_world=np.eye(3), fov_y=40.0)

    keys = (Keyframe(time=0.0, pose=pose(-1)), Keyframe(time=1.0, pose=pose(1)))
    save_camera_path(CameraPath(keyframes=keys, duration=1.0), tmp_path / "p.json", fps=7.0, size=(64, 48))
    argv = ("film", scene, "--path", tmp_path / "p.json", "--renderer", "cpu", "-o")
    assert run(*argv, tmp_path / "own")[0] == 0
    assert len(pictures(tmp_path / "own")) == 8, "both ends of an open path are frames"
    assert run(*argv, tmp_path / "longer", "--seconds", 2)[0] == 0
    longer = pictures(tmp_path / "longer")
    assert len(longer) == 15
    for i, frame in enumerate(pictures(tmp_path / "own")):
        np.testing.assert_array_equal(frame, longer[2 * i])
    eye = ("--eye", "1,0,-4", "--target", "1,0,0", "--up", "0,-1,0", "--fov", 40, "--size", "64x48")
    assert run("render", scene, "-o", tmp_path / "last.png", "--renderer", "cpu", *eye)[0] == 0
    np.testing.assert_array_equal(longer[-1], np.asarray(Image.open(tmp_path / "last.png")))


def test_each_scene_of_a_sequence_is_a_frame(run, tmp_path, random_gaussians):
    frames, scene = tmp_path / "frames", random_gaussians(80, seed=3)
    frames.mkdir()
    for i in range(5):
        save_scene(replace(scene, means=scene.means + np.float32(0.2 * i)), frames / f"f_{i}.ply")
    argv = ("film", frames, "--size", "64x48", "--renderer", "cpu", "--eye", "0,-1,-5", "--target", "0,0,0")
    code, _, err = run(*argv, "-o", tmp_path / "film", "--fps", 5)
    assert code == 0 and "5 frames, 1 s" in err
    whole = pictures(tmp_path / "film")
    still = ("render", frames / "f_1.ply", "--turn", 72, *argv[2:], "-o", tmp_path / "still.png")
    assert run(*still)[0] == 0
    assert abs(whole[1].astype(int) - np.asarray(Image.open(tmp_path / "still.png"))).max() <= 1
    (frames / "f_2.ply").write_bytes((frames / "f_2.ply").read_bytes()[:1500])
    code, _, err = run(*argv, "-o", tmp_path / "damaged", "--fps", 5)
    assert code == 2 and "1 of 5 frames failed, in their place the frame before is shown" in err
    damaged = pictures(tmp_path / "damaged")
    assert len(damaged) == 5
    for i, frame in enumerate(damaged):
        np.testing.assert_array_equal(frame, whole[1 if i == 2 else i])
    code, _, err = run(*argv, "-o", tmp_path / "no", "--seconds", 2)
    assert code == 2 and "choose --fps" in err


@needs_av
@pytest.mark.parametrize(
    ("name", "codec"),
    [("f.mp4", None), ("f.mp4", "h264"), ("f.webm", None), ("f.gif", None)],
    ids=["mp4", "h264", "webm", "gif"],
)
def test_a_video_holds_the_frames(tmp_path, name, codec):
    import av

    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    frames = [
        np.stack([4 * x % 256, 5 * y % 256, (2 * x + 30 * i) % 256], axis=-1).astype(np.uint8) // 2 + 40
        for i in range(FRAMES)
    ]
    with film_writer(tmp_path / name, size=SIZE, fps=25.0, codec=codec) as write:
        for frame in frames:
            write(frame)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    with av.open(str(tmp_path / name)) as container:
        shown = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)]
        rate = container.streams.video[0].average_rate or 0
    assert len(shown) == FRAMES and float(rate) == pytest.approx(25, rel=0.01)
    for frame, picture in zip(frames, shown, strict=True):
        assert abs(frame.astype(float) - picture).mean() < 4.5


@needs_av
def test_a_video_from_the_command_line(run, scene, tmp_path):
    (tmp_path / "f.webm").write_bytes(b"an old one")
    code, _, err = run("film", scene, "-o", tmp_path / "f.webm", *SHORT)
    assert code == 0 and "8 frames" in err
    assert (tmp_path / "f.webm").read_bytes()[:4] == b"\x1aE\xdf\xa3"  # EBML


@pytest.mark.parametrize("name", ["frames", pytest.param("f.mp4", marks=needs_av)])
def test_who_interrupts_it_finds_nothing(run, scene, tmp_path, monkeypatch, name):
    made = []

    def interrupted(image: np.ndarray) -> np.ndarray:
        made.append(image)
        if len(made) == 3:
            raise KeyboardInterrupt
        return real(image)

    real = command.eight_bit
    monkeypatch.setattr(command, "eight_bit", interrupted)
    code, _, err = run("film", scene, "-o", tmp_path / name, *SHORT)
    assert code == 130 and f"{name} is not written" in err
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_filmed_is_told_in_a_line(run, scene, tmp_path, monkeypatch):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    (tmp_path / "bad.json").write_text(json.dumps({"camera_path": [{}]}))
    wrong = {
        "films are written as": ("-o", tmp_path / "f.avi"),
        "is there already": ("-o", tmp_path / "full"),
        "does not exist": ("-o", tmp_path / "none" / "frames"),
        "take 642x480": ("-o", tmp_path / "f.mp4", "--size", "641x480"),
        "at most 50 frames": ("-o", tmp_path / "f.gif", "--fps", 60),
        "not vp9": ("-o", tmp_path / "f.mp4", "--codec", "vp9"),
        "has no codec": ("-o", tmp_path / "frames", "--codec", "av1"),
        "no such file": ("-o", tmp_path / "frames", "--path", tmp_path / "none.json"),
        "is missing": ("-o", tmp_path / "frames", "--path", tmp_path / "bad.json"),
        "only --size goes": ("-o", tmp_path / "frames", "--path", tmp_path / "bad.json", "--fov", 50),
        "not allowed with": ("-o", tmp_path / "frames", "--path", tmp_path / "bad.json", "--turntable"),
        "more than 1,000,000 frames": ("-o", tmp_path / "frames", "--seconds", 1e6),
        "must be more than 0": ("-o", tmp_path / "frames", "--fps", 0),
    }
    for told, argv in wrong.items():
        code, out, err = run("film", scene, *argv)
        assert (code, out) == (2, "") and told in err and err.count("\n") == 1, err
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    code, _, err = run("film", scene, "-o", tmp_path / "f.mp4")
    assert code == 2 and "pip install av" in err and err.count("\n") == 1
    assert run("film", scene, "-o", tmp_path / "frames", *SHORT)[0] == 0, "a folder needs nothing else"


@pytest.mark.parametrize("offset", [(0, 0, 0), (300, -20, 100)])
def test_the_turntable_has_the_scene_in_view_from_all_sides(random_gaussians, offset):
    scene = random_gaussians(2000, seed=3)
    stretched = scene.means * np.array((3, 1, 0.3), np.float32) + np.array(offset, np.float32)
    scene = replace(scene, means=stretched, log_scales=np.full_like(scene.log_scales, -6))
    view = turntable_view(scene, 320, 180)
    middle = np.array(offset, np.float64)
    apart = np.cross(view.target - middle, view.up)
    assert np.linalg.norm(apart) < 0.1, "the axis goes through the middle"
    sizes = []
    for degrees in range(0, 360, 30):
        camera = orbited(view.camera, view.target, view.up, degrees)
        t = (stretched - camera.eye) @ camera.R_camera_world.T
        pixels = camera.image_points(t)
        inside = (t[:, 2] > 0) & (pixels >= 0).all(axis=1) & (pixels <= (320, 180)).all(axis=1)
        assert inside.mean() > 0.995
        sizes.append(np.ptp(pixels, axis=0) / (320, 180))
    assert np.max(sizes) > 0.75, "and fills the picture from some"


def test_modes_and_depth_of_field_are_those_of_render(run, scene, tmp_path):
    draw = ("--size", "64x48", "--renderer", "cpu", "--eye", "0,-1,-4", "--target", "0,0,0")
    for name, options in {
        "depth": ("--mode", "depth"),
        "soft": ("--aperture", 0.4, "--focus", 3, "--lens-samples", 4),
    }.items():
        assert run("film", scene, "-o", tmp_path / name, "--seconds", 1, "--fps", 1, *draw, *options)[0] == 0
        assert run("render", scene, "-o", tmp_path / f"{name}.png", *draw, *options)[0] == 0
        (frame,) = pictures(tmp_path / name)
        np.testing.assert_array_equal(frame, np.asarray(Image.open(tmp_path / f"{name}.png")))
    code, _, err = run("film", scene, "-o", tmp_path / "no", "--focus", 3)
    assert code == 2 and "go with --aperture" in err
