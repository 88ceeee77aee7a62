"""Whatever a user gets wrong is one line on standard error and exit code 2; nothing is written."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.scene import Gaussians
from splatview.scene.formats import save_scene

Refused = Callable[..., str]


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    """`refused(argv...)`: the one line, without the command's name; checks exit code and stdout."""

    def run(*argv: object) -> str:
        code = main([str(argument) for argument in argv])
        out, err = capsys.readouterr()
        assert (code, out) == (2, "")
        lines = err.splitlines()
        assert len(lines) == 1, err
        assert lines[0].startswith("splatview: ")
        return lines[0].removeprefix("splatview: ")

    return run


@pytest.fixture
def scene(tmp_path: Path, random_gaussians: Callable[..., Gaussians]) -> Path:
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(20, sh_degree=0), path)
    return path


HEADER = "ply\nformat binary_little_endian 1.0\nelement vertex {n}\n{properties}end_header\n"
POSITION, COLOUR = ["x", "y", "z"], ["f_dc_0", "f_dc_1", "f_dc_2"]
SHAPE = ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
SPLAT = [*POSITION, *COLOUR, "opacity", *SHAPE]


def ply(n: int, names: list[str], body: bytes, *, kind: str = "float") -> bytes:
    properties = "".join(f"property {kind} {name}\n" for name in names)
    return HEADER.format(n=n, properties=properties).encode() + body


ROW = np.ones(len(SPLAT), "<f4").tobytes()

MESH = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)

BAD_SCENES = {
    "empty": (b"", "empty"),
    "text": (b"hello world\n", "scene.ply"),
    "truncated": (ply(3, SPLAT, ROW * 2), "scene.ply"),
    "promises": (ply(10**12, SPLAT, ROW), "scene.ply"),
    "mesh": (MESH, "mesh"),
    "wrong-type": (ply(1, SPLAT, ROW, kind="string"), "scene.ply"),
    "no-opacity": (ply(1, [n for n in SPLAT if n != "opacity"], ROW[4:]), "opacity"),
}


@pytest.mark.parametrize("command", ["render", "info", "window"])
@pytest.mark.parametrize("name", BAD_SCENES)
def test_bad_scene_files(refused, tmp_path, monkeypatch, command, name):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    content, word = BAD_SCENES[name]
    path, out = tmp_path / "scene.ply", tmp_path / "out.png"
    path.write_bytes(content)
    argv = {"render": ["render", path, "-o", out], "info": ["info", path], "window": [path, "-o", out]}
    line = refused(*argv[command])
    assert "scene.ply" in line
    assert word in line
    assert not out.exists()


@pytest.mark.parametrize("name", [*BAD_SCENES, "cameras.json", "cameras.bin", "gone.json", "folder"])
def test_no_window_opens_for_a_bad_file(refused, tmp_path, monkeypatch, name):
    monkeypatch.setattr("splatview.cli.window.no_window", lambda: pytest.fail("the file comes first"))
    path = tmp_path / ("scene.ply" if name in BAD_SCENES else name)
    if name == "folder":
        path.mkdir()
    elif name == "gone.json":
        path.symlink_to("nowhere.json")
    else:
        path.write_bytes(BAD_SCENES[name][0] if name in BAD_SCENES else b"[]")
    assert path.name in refused(path)


def test_options_that_are_not_there_have_a_suggestion(refused):
    assert refused("render", "a.ply", "--siz", "4x4").startswith(
        "unrecognized arguments: --siz 4x4; did you mean --size? (see"
    )
    assert "did you mean --renderer?" in refused("a.ply", "--renderers=cpu")
    assert "did you mean" not in refused("info", "a.ply", "--qqq")


@pytest.mark.parametrize("command", [["render", "-o", "x.png"], ["info"], []])
def test_missing_file_and_folder(refused, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "nowhere.ply: no such file" in refused(*command, "nowhere.ply")
    assert str(tmp_path) in refused(*command, tmp_path)


def test_a_word_that_is_neither_command_nor_file(refused):
    assert refused("nothing") == "nothing: no such file, nor a command; see splatview --help"
    assert refused("rendr", "a.ply", "--eye", "1,2,3") == (
        "rendr: no such file, nor a command; did you mean render?"
    )
    assert refused("dir/rendr") == "dir/rendr: no such file"
    assert "no such file" in refused("x" * 5000)


USAGE = {
    "no scene": ([], "SCENE"),
    "unknown option": (["S", "-o", "O", "--colour", "red"], "--colour"),
    "abbreviated option": (["S", "-o", "O", "--rend", "cpu"], "--rend"),
    "nothing to do": (["S"], "-o OUT.png or --stats"),
    "unknown renderer": (["S", "-o", "O", "--renderer", "gpu"], "--renderer"),
    "no such renderer": (["S", "-o", "O", "--renderer", "pixels"], "--renderer"),
    "blend of tiles": (["S", "-o", "O", "--renderer", "tiles", "--blend", "float16"], "quads can do it"),
    "eye without target": (["S", "-o", "O", "--eye", "0,0,1"], "--target"),
    "target without eye": (["S", "-o", "O", "--target", "0,0,1"], "--eye"),
    "eye is target": (["S", "-o", "O", "--eye", "0,0,1", "--target", "0,0,1"], "same point"),
    "two numbers": (["S", "-o", "O", "--eye", "0,1", "--target", "0,0,1"], "three numbers"),
    "no number": (["S", "-o", "O", "--eye", "0,1,up", "--target", "0,0,1"], "'up'"),
    "nan": (["S", "-o", "O", "--eye", "0,1,nan", "--target", "0,0,1"], "'nan'"),
    "too far": (["S", "-o", "O", "--eye", "0,0,-1e300", "--target", "0,0,0"], "go to 1e+100"),
    "no direction": (["S", "-o", "O", "--eye", "0,0,1", "--target", "0,0,0", "--up", "0,0,0"], "direction"),
    "up alone": (["S", "-o", "O", "--up", "0,1,0"], "--eye"),
    "field of view": (["S", "-o", "O", "--fov", "180"], "180"),
    "size": (["S", "-o", "O", "--size", "1280"], "1280x720"),
    "no pixels": (["S", "-o", "O", "--size", "0x10"], "1x1"),
    "all the pixels": (["S", "-o", "O", "--size", "65536x65536"], "megapixels"),
    "colour": (["S", "-o", "O", "--background", "0,0,255"], "from 0 to 1"),
    "no such colour": (["S", "-o", "O", "--background", "#12"], "is no colour"),
    "gradient": (["S", "-o", "O", "--background", "gradient:red"], "two colours"),
    "gradient of five": (["S", "-o", "O", "--background", "gradient:1,1,1,0,0"], "two colours"),
    "gradient too bright": (["S", "-o", "O", "--background", "gradient:1,1,1,0,0,2"], "from 0 to 1"),
    "no such background": (["S", "-o", "O", "--background", "sky.jpg"], "sky.jpg: no such picture"),
    "scene for a background": (["S", "-o", "O", "--background", "S"], "is no picture that can be read"),
    "aperture without focus": (["S", "-o", "O", "--aperture", "0.1"], "--focus"),
    "focus without aperture": (["S", "-o", "O", "--focus", "3"], "--aperture"),
    "samples without aperture": (["S", "-o", "O", "--lens-samples", "3"], "--aperture"),
    "closed aperture": (["S", "-o", "O", "--aperture", "0", "--focus", "3"], "more than 0"),
    "sh degree": (["S", "-o", "O", "--sh-degree", "4"], "--sh-degree"),
    "near": (["S", "-o", "O", "--near", "0"], "more than 0"),
    "blur": (["S", "-o", "O", "--blur=-1"], "at least 0"),
    "frames": (["S", "-o", "O", "--frames", "0"], "at least 1"),
    "turn": (["S", "-o", "O", "--turn", "inf"], "'inf'"),
    "two cameras": (["S", "-o", "O", "--camera", "C", "--eye", "0,0,1", "--target", "0,0,0"], "one of them"),
    "camera with fov": (["S", "-o", "O", "--camera", "C", "--fov", "30"], "--fov"),
    "index without camera": (["S", "-o", "O", "--camera-index", "1"], "--camera"),
    "index and name": (["S", "-o", "O", "--camera", "C", "--camera-index", "1", "--camera-name", "a"], "one"),
    "camera file missing": (["S", "-o", "O", "--camera", "C"], "no such file"),
    "mode by tiles": (["S", "-o", "O", "--mode", "depth", "--renderer", "tiles"], "quads or cpu"),
    "alpha and background": (["S", "-o", "O", "--alpha", "--background", "0,0,0"], "--background"),
    "alpha in npy": (["S", "-o", "N", "--alpha"], "--alpha"),
}


@pytest.mark.parametrize("name", USAGE)
def test_bad_usage_of_render(refused, scene, tmp_path, name):
    argv, word = USAGE[name]
    names = {"S": scene, "O": tmp_path / "o.png", "N": tmp_path / "o.npy", "C": tmp_path / "cameras.json"}
    assert word in refused("render", *(names.get(argument, argument) for argument in argv))
    assert sorted(tmp_path.iterdir()) == [scene]


@pytest.mark.parametrize(
    ("output", "word"),
    [("o.jpg", ".png or .npy"), ("o", ".png or .npy"), ("", "suffix"), ("no/o.png", "does not exist")],
)
def test_outputs_are_checked_before_the_scene_is_read(refused, tmp_path, output, word):
    line = refused("render", tmp_path / "missing.ply", "-o", tmp_path / output if output else "")
    assert word in line


def test_output_that_is_a_folder(refused, scene, tmp_path):
    (tmp_path / "o.png").mkdir()
    assert "is a folder" in refused("render", scene, "-o", tmp_path / "o.png")


def test_pictures_larger_than_opengl_draws(refused, scene, tmp_path):
    line = refused("render", scene, "-o", tmp_path / "o.png", "--renderer", "quads", "--size", "65536x8")
    assert "not 65536x8; use --renderer cpu" in line


def test_too_little_memory_is_said_in_one_line(refused, scene, monkeypatch):
    def too_large(*_args: object) -> None:
        raise MemoryError("Unable to allocate 9 TiB")

    monkeypatch.setattr("splatview.cli.info.load_scene", too_large)
    assert "9 TiB" in refused("info", scene)


def test_choosing_a_camera_that_is_not_there(refused, scene, tmp_path):
    camera = {"width": 9, "height": 9, "fx": 9, "fy": 9, "cx": 4, "cy": 4, "name": "front"}
    camera["world_to_camera"] = np.eye(4).tolist()
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([camera, camera]))
    render = ("render", scene, "-o", tmp_path / "o.png", "--camera", path)
    assert "--camera-index goes to 1" in refused(*render, "--camera-index", 2)
    assert "'back'" in refused(*render, "--camera-name", "back")
    path.write_text("{")
    assert "not JSON" in refused(*render)


def test_commands_refuse_what_they_do_not_know(refused, scene):
    assert "--yaml" in refused("info", scene, "--yaml")
    assert "extra" in refused("info", scene, "extra")
    assert "SCENE" in refused("info")
    assert "extra" in refused("doctor", "extra")
    assert "--full" in refused("--full")


@pytest.mark.parametrize(
    "argv",
    [
        ("info", "-x.ply"),
        ("-x.ply",),
        ("convert", "a.ply", "-x.ply"),
        ("render", "a.ply", "-o", "-x.ply"),
        ("edit", "a.ply", "--recipe", "-x.ply", "-o", "b.ply"),
    ],
)
def test_names_that_begin_with_a_dash_are_told_how_to_write(refused, argv):
    assert "a name that begins with a dash is written ./-x.ply" in refused(*argv)


def test_an_option_that_is_none_is_no_name(refused):
    assert "./" not in refused("info", "a.ply", "-x")
    assert "./" not in refused("info", "a.ply", "-0.5")


def test_defects_of_ours_keep_their_traceback(monkeypatch, scene):
    def broken(*_args: object) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr("splatview.cli.info.load_scene", broken)
    with pytest.raises(RuntimeError, match="a defect"):
        main(["info", str(scene)])
