"""Sequences from the command line: pictures, receipts and recipes of all frames, one of them damaged."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.cli.main import main
from splatview.cli.sequence import frame_targets
from splatview.scene import InputError
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.formats.sequence import SceneSequence, resolve

Run = Callable[..., tuple[int, str, str]]

DRAW = ("--renderer", "quads", "--eye", "0,-1,-4", "--target", "0,0,0", "--size", "40x24")


@pytest.fixture
def run(capsys) -> Run:
    def run(*argv: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in argv])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def frames(tmp_path, random_gaussians) -> Path:
    """Frames 2, 9, 10 and 11, of which 10 is damaged."""
    folder = tmp_path / "frames"
    folder.mkdir()
    scene = random_gaussians(80, seed=3)
    for i in (2, 9, 10, 11):
        moved = replace(scene, means=scene.means + np.float32(0.05 * i))
        save_scene(moved.take(slice(0, 40 + i)), folder / f"f_{i}.ply")
    (folder / "f_10.ply").write_bytes((folder / "f_10.ply").read_bytes()[:1500])
    return folder


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_a_picture_of_each_frame_by_one_camera(run, frames, tmp_path):
    code, out, err = run("render", frames, "-o", tmp_path / "out", *DRAW)
    assert (code, out) == (2, "") and len(err.splitlines()) == 1
    assert "1 of 4 frames failed, the other 3 are rendered" in err and "f_10.ply" in err
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"f_2.png", "f_9.png", "f_11.png"}
    alone = tmp_path / "alone.png"
    assert run("render", frames / "f_9.ply", "-o", alone, *DRAW)[0] == 0
    np.testing.assert_array_equal(pixels(tmp_path / "out" / "f_9.png"), pixels(alone))


def test_without_a_camera_that_of_the_first_frame_is_kept(run, frames, tmp_path):
    (frames / "f_10.ply").unlink()
    plain = ("--renderer", "quads", "--size", "40x24")
    code, _, err = run("render", f"{frames}/f_*.ply", "-o", tmp_path / "n_%03d.npy", *plain)
    assert code == 0 and "3 pictures, 40x24" in err
    pictures = [np.load(tmp_path / f"n_{i:03}.npy") for i in (1, 2, 3)]
    assert run("render", frames / "f_2.ply", "-o", tmp_path / "first.npy", *plain)[0] == 0
    np.testing.assert_array_equal(pictures[0], np.load(tmp_path / "first.npy"))
    centres = [np.average(np.arange(40), weights=picture[..., 3].sum(axis=0) + 1e-9) for picture in pictures]
    assert centres[0] < centres[1] < centres[2], "the scene moves through the picture"


def test_turn_goes_on_from_frame_to_frame(run, frames, tmp_path):
    (frames / "f_10.ply").unlink()
    assert run("render", frames, "-o", tmp_path / "t_%d.png", "--turn", 30, *DRAW)[0] == 0
    single = ("render", frames / "f_11.ply", "-o", tmp_path / "alone.png", "--turn", 60, *DRAW)
    assert run(*single)[0] == 0
    np.testing.assert_array_equal(pixels(tmp_path / "t_3.png"), pixels(tmp_path / "alone.png"))


def test_what_the_frames_hold(run, frames):
    code, out, err = run("info", frames, "--json")
    assert code == 2 and "f_10.ply" in err
    receipt = json.loads(out)
    assert [Path(entry["file"]).name for entry in receipt["frames"]] == [
        *("f_2.ply", "f_9.ply", "f_10.ply", "f_11.ply")
    ]
    assert receipt["count"] == {"min": 42, "max": 51}
    assert "error" in receipt["frames"][2]
    (frames / "f_10.ply").unlink()
    code, out, err = run("info", frames)
    assert (code, err) == (0, "")
    assert "3 frames from f_2.ply to f_11.ply" in out and "42 to 51 splats" in out


def test_a_recipe_for_every_frame(run, frames, tmp_path):
    steps = [
        {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 1}},
        {"op": "delete"},
    ]
    recipe = tmp_path / "r.json"
    recipe.write_text(json.dumps({"splatview_recipe": 1, "steps": steps}))
    code, _, err = run("edit", frames, "--recipe", recipe, "-o", tmp_path / "edited")
    assert code == 2 and "1 of 4 frames failed, the other 3 are written" in err
    for i in (2, 9, 11):
        edited, whole = load_scene(tmp_path / "edited" / f"f_{i}.ply"), load_scene(frames / f"f_{i}.ply")
        assert len(edited) == int((np.linalg.norm(whole.means, axis=1) > 1).sum()) < len(whole)
    before = (frames / "f_2.ply").read_bytes()
    code, _, err = run("edit", frames, "--recipe", recipe, "-o", frames)
    assert code == 2 and "is a frame of the sequence itself" in err
    assert (frames / "f_2.ply").read_bytes() == before
    recipe.write_text(json.dumps({"splatview_recipe": 1, "steps": [{"op": "split", "path": "a.ply"}]}))
    assert "splits files off" in run("edit", frames, "--recipe", recipe, "-o", tmp_path / "edited")[2]


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["-o", "DIR/a.png"], "a_%04d.png"),
        (["-o", "DIR/%d_%d.png"], "one place for the frame's number"),
        (["-o", "DIR/%04d.jpg"], ".png or .npy"),
        (["-o", "DIR/no/where"], "cannot be made"),
        (["-o", "DIR/out", "--stats"], "name one of the sequence's files"),
        (["-o", "DIR/out", "--frames", "3"], "name one of the sequence's files"),
        ([], "give -o"),
    ],
)
def test_what_cannot_be_is_one_line(run, frames, tmp_path, argv, words):
    argv = [word.replace("DIR", str(tmp_path)) for word in argv]
    code, out, err = run("render", frames, *argv)
    assert (code, out) == (2, "") and len(err.splitlines()) == 1
    assert words in err
    assert not (tmp_path / "out").exists()


def test_frames_of_one_name_are_numbered(tmp_path):
    for name in ("t1", "t2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "cloud.ply").write_bytes(b"x")
    sequence = resolve(tmp_path / "t*" / "cloud.ply")
    assert isinstance(sequence, SceneSequence)
    names = [path.name for path in frame_targets(tmp_path / "out", sequence, (".png", ".npy"))]
    assert names == ["frame_0001.png", "frame_0002.png"]
    spz = [path.name for path in frame_targets(tmp_path / "%02d.spz", sequence, (".ply", ".spz"))]
    assert spz == ["01.spz", "02.spz"]
    with pytest.raises(InputError, match="itself"):
        frame_targets(
            tmp_path / "t1", SceneSequence(paths=(tmp_path / "t1" / "cloud.ply",) * 1, name="t"), (".ply",)
        )


def test_none_that_can_be_read(run, frames, tmp_path):
    for command in (
        ["render", "-o", tmp_path / "out"],
        ["info"],
        ["edit", "--recipe", "r.json", "-o", tmp_path],
    ):
        code, _, err = run(*command, f"{frames}/g*.ply")
        assert code == 2 and err.endswith("g*.ply: nothing matches it\n")
    for path in frames.iterdir():
        path.write_bytes(b"ply\nnothing")
    code, _, err = run("render", frames, "-o", tmp_path / "out", *DRAW)
    assert code == 2 and "4 of 4 frames failed" in err and len(err.splitlines()) == 1
    assert run("info", frames)[0] == 2
