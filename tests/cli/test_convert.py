"""`splatview convert`: what a format costs is said before it is written."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.renderers.conversion import convert
from splatview.scene import look_at
from splatview.scene.formats import load_scene, save_camera, save_scene

COMMENTS = ("SplatRenderMode: mip", "a note")


@pytest.fixture
def splatview(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """`splatview(argv...)`: exit code, standard output, standard error."""

    def run(*argv: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in argv])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def scene(tmp_path, random_gaussians):
    path = tmp_path / "scene.ply"
    extras = {"label": np.arange(60, dtype=np.int32)}
    save_scene(replace(random_gaussians(60, sh_degree=1), comments=COMMENTS, extras=extras), path)
    return path


@pytest.mark.parametrize(
    ("suffix", "least_db", "said"),
    [
        ("ply", None, []),
        ("glb", None, ["tag that it was trained antialiased", "a comment", "own: label"]),
        ("compressed.ply", 40, ["fewer bits", "own: label"]),
        ("sog", 40, ["fewer bits", "kernel of 0.1 px", "a comment", "own: label"]),
        ("spz", 30, ["fewer bits", "kernel of 0.1 px", "a comment", "own: label"]),
        ("splat", 15, ["one colour from everywhere", "fewer bits", "trained antialiased", "own: label"]),
    ],
)
def test_what_is_lost_is_told(splatview, scene, tmp_path, suffix, least_db, said):
    out = tmp_path / f"out.{suffix}"
    code, text, err = splatview("convert", scene, out, "--json")
    assert code == 0
    report = json.loads(text)
    assert report["format"] == suffix and report["bytes"] == out.stat().st_size
    assert len(load_scene(out)) == 60
    assert [any(words in line for line in report["lost"]) for words in said] == [True] * len(said)
    assert all(line in err for line in report["lost"])
    if least_db is None:
        assert report["psnr"] is None and "every number as it was" in err
    else:
        assert report["psnr"] > least_db and f"{report['psnr']:.1f} dB" in err


@pytest.mark.parametrize("suffix", ["glb", "sog"])
def test_losses_are_told_before_anything_is_written(scene, tmp_path, suffix):
    """Also by a format that keeps every number, but drops comments."""
    out, told = tmp_path / f"out.{suffix}", []
    convert(load_scene(scene), out, on_measured=lambda found: told.append((found.lost != (), out.exists())))
    assert told == [(True, False)] and out.exists()


def test_values_beyond_a_format_are_counted(splatview, tmp_path, random_gaussians):
    """Sizes, colours and SH that become the nearest that there is; positions that no float32 is."""
    scene = random_gaussians(50, sh_degree=1)
    means = scene.means.astype(np.float64)
    sh, log_scales = np.clip(scene.sh, -0.5, 0.5), np.clip(scene.log_scales, -5, 0)
    means[0], log_scales[1], sh[2:4, 0, 1], sh[4:7, 1, 0] = 1e300, 9.0, 5.0, -3.0
    save_scene(replace(scene, means=means, log_scales=log_scales, sh=sh), tmp_path / "a.ply")
    for suffix, said in (
        ("spz", "1 splats have sizes beyond its range of 4.54e-05 to 379, and get the nearest"),
        ("spz", "2 splats have colours beyond its range of -0.44 to 1.44, and get the nearest"),
        ("spz", "3 splats have SH coefficients beyond its range of -1 to 0.938, and get the nearest"),
        ("splat", "2 splats have colours beyond its range of 0 to 1, and get the nearest"),
        ("compressed.ply", "1 splats with values that nothing can draw are left out"),
    ):
        code, _, err = splatview("convert", tmp_path / "a.ply", tmp_path / f"out.{suffix}")
        assert code == 0 and said in err, err
        assert len(load_scene(tmp_path / f"out.{suffix}")) == 49
    code, _, err = splatview("convert", tmp_path / "out.spz", tmp_path / "again.spz")
    assert code == 0 and "get the nearest" not in err, "what came from the format is in its range"


def test_nothing_is_written_where_the_scene_does_not_fit(splatview, tmp_path, random_gaussians):
    far = random_gaussians(5)
    save_scene(replace(far, means=far.means + np.float32(1e8)), tmp_path / "far.ply")
    (tmp_path / "out.spz").write_bytes(b"older")
    code, _, err = splatview("convert", tmp_path / "far.ply", tmp_path / "out.spz")
    assert code == 2 and "move the scene to the origin" in err
    assert (tmp_path / "out.spz").read_bytes() == b"older"


def test_a_target_is_searched_for(splatview, scene, tmp_path):
    out = tmp_path / "out.spz"
    code, text, err = splatview("convert", scene, out, "--target", "30 dB", "--json")
    report = json.loads(text)
    assert code == 0 and report["psnr"] >= 30 and report["bytes"] == out.stat().st_size
    assert "position bits" in err and report["knobs"]["position_bits"] < 24
    code, _, err = splatview("convert", scene, tmp_path / "no.splat", "--target", "120dB")
    assert code == 2 and "at most" in err and err.count("\n") == 1 and not (tmp_path / "no.splat").exists()
    code, _, err = splatview("convert", scene, tmp_path / "no.spz", "--target", "much")
    assert code == 2 and "40dB" in err


def test_a_folder_is_written_for_a_name_without_suffix(splatview, scene, tmp_path):
    assert splatview("convert", scene, tmp_path / "sogs")[0] == 0
    assert len(load_scene(tmp_path / "sogs")) == 60
    lods = tmp_path / "lods" / "lod-meta.json"
    assert splatview("convert", tmp_path / "sogs", lods, "--sh-degree", 0)[0] == 0
    assert load_scene(lods).sh_degree == 0


def test_turning_over_twice_is_nothing(splatview, scene, tmp_path):
    once, twice = tmp_path / "once.ply", tmp_path / "twice.ply"
    assert splatview("convert", scene, once, "--turn", "over")[0] == 0
    assert splatview("convert", once, twice, "--turn", "X90,x90")[0] == 0
    before, turned, after = (load_scene(path) for path in (scene, once, twice))
    assert np.allclose(turned.means, before.means * np.array([1, -1, -1], np.float32))
    assert np.allclose(after.means, before.means, atol=1e-6) and np.allclose(after.sh, before.sh, atol=1e-5)
    code, _, err = splatview("convert", scene, once, "--turn", "x45")
    assert code == 2 and "steps of 90" in err


def test_cameras_can_be_given(splatview, scene, tmp_path):
    camera = look_at(np.array([0, 0, -4.0]), np.zeros(3), fov_y=40, width=64, height=64)
    save_camera(camera, tmp_path / "camera.json")
    out = tmp_path / "out.spz"
    assert splatview("convert", scene, out, "--target", "25dB", "--cameras", tmp_path / "camera.json")[0] == 0
    assert 0 < len(load_scene(out)) <= 60


def test_an_interrupted_search_leaves_nothing(splatview, scene, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()

    def interrupted(*_: object, **__: object) -> None:
        assert list((tmp_path / "temporary").iterdir())
        raise KeyboardInterrupt

    monkeypatch.setattr("splatview.renderers.rate_distortion.measure_curves", interrupted)
    code, out, _ = splatview("convert", scene, tmp_path / "out.spz", "--target", "30dB")
    assert code == 130 and out == "" and not (tmp_path / "out.spz").exists()
    assert not list((tmp_path / "temporary").iterdir())


@pytest.fixture
def frames(tmp_path, random_gaussians):
    """Frames 2, 9 and 10, the second of them damaged."""
    folder = tmp_path / "frames"
    folder.mkdir()
    whole = random_gaussians(60, sh_degree=1)
    for i in (2, 9, 10):
        save_scene(whole.take(slice(0, 40 + i)), folder / f"f_{i}.ply")
    (folder / "f_9.ply").write_bytes((folder / "f_9.ply").read_bytes()[:1500])
    return folder


def test_frames_of_a_sequence_keep_their_names(splatview, frames, tmp_path):
    out = tmp_path / "out"
    code, text, err = splatview("convert", frames, out, "--format", "spz", "--turn", "over", "--json")
    assert code == 2 and "1 of 3 frames failed, the other 2 are written" in err and "f_9.ply" in err
    assert {path.name for path in out.iterdir()} == {"f_2.spz", "f_10.spz"}
    assert err.count("fewer bits") == 1  # what all of them lose is told once
    report = json.loads(text)
    assert [entry["splats"] for entry in report["frames"]] == [42, 50]
    for i, entry in zip((2, 10), report["frames"], strict=True):
        written, before = load_scene(out / f"f_{i}.spz"), load_scene(frames / f"f_{i}.ply")
        assert entry["bytes"] == (out / f"f_{i}.spz").stat().st_size and entry["psnr"] > 30
        flipped = written.means[:, 1:].sum(axis=0), -before.means[:, 1:].sum(axis=0)
        assert np.allclose(*flipped, atol=0.02)


def test_frames_by_a_glob_are_numbered_and_of_the_usual_format(splatview, frames, tmp_path):
    (frames / "f_9.ply").unlink()
    code, _, err = splatview("convert", f"{frames}/f_*.ply", tmp_path / "n_%03d.glb")
    assert code == 0 and "2 frames" in err and "every number as it was" in err
    assert [len(load_scene(tmp_path / f"n_{i:03}.glb")) for i in (1, 2)] == [42, 50]
    code, _, err = splatview("convert", frames, tmp_path / "sogs", "--target", "30dB")
    assert code == 0 and {path.name for path in (tmp_path / "sogs").iterdir()} == {"f_2.sog", "f_10.sog"}


@pytest.mark.parametrize(
    ("output", "options", "words"),
    [
        ("one.spz", (), "one_%04d.spz"),
        ("frames", ("--format", "ply"), "is a frame of the sequence itself"),
        ("out", ("--format", "ksplat"), "frames are written as sog, ply"),
        ("n_%d.spz", ("--format", "sog"), "files are written as .sog"),
        ("out", ("--target", "much"), "40dB"),
    ],
)
def test_what_cannot_be_of_a_sequence_is_one_line(splatview, frames, tmp_path, output, options, words):
    before = {path.name: path.read_bytes() for path in frames.iterdir()}
    code, text, err = splatview("convert", frames, tmp_path / output, *options)
    assert (code, text) == (2, "") and err.count("\n") == 1 and words in err
    assert {path.name: path.read_bytes() for path in frames.iterdir()} == before
    assert {path.name for path in tmp_path.iterdir()} == {"frames"}


def test_a_format_is_named_for_frames_only(splatview, scene, tmp_path):
    code, _, err = splatview("convert", scene, tmp_path / "out.spz", "--format", "spz")
    assert code == 2 and "OUT's suffix" in err and not (tmp_path / "out.spz").exists()


def test_who_interrupts_keeps_whole_frames(splatview, frames, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (frames / "f_9.ply").unlink()

    from splatview.renderers import conversion

    done = []
    place = conversion.place_copy

    def interrupted(*arguments: Any) -> None:
        if done:
            raise KeyboardInterrupt
        done.append(place(*arguments))

    monkeypatch.setattr(conversion, "place_copy", interrupted)
    code, _, err = splatview("convert", frames, tmp_path / "out", "--format", "splat")
    assert code == 130 and "stopped; 1 of 2 frames are written" in err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["f_2.splat"]
    assert not list((tmp_path / "temporary").iterdir())
