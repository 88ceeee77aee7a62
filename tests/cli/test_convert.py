"""`splatview convert`: what a format costs is said before it is written."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.scene.formats import load_scene, save_scene

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
        ("glb", None, ["tag that it was trained antialiased", "2 comments", "own: label"]),
        ("compressed.ply", 40, ["fewer bits", "own: label"]),
        ("sog", 40, ["fewer bits", "kernel of 0.1 px", "2 comments", "own: label"]),
        ("spz", 30, ["fewer bits", "kernel of 0.1 px", "2 comments", "own: label"]),
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


def test_nothing_is_written_where_the_scene_does_not_fit(splatview, tmp_path, random_gaussians):
    far = random_gaussians(5)
    save_scene(replace(far, means=far.means + np.float32(1e8)), tmp_path / "far.ply")
    (tmp_path / "out.spz").write_bytes(b"older")
    code, _, err = splatview("convert", tmp_path / "far.ply", tmp_path / "out.spz")
    assert code == 2 and "move the scene to the origin" in err
    assert (tmp_path / "out.spz").read_bytes() == b"older"
