"""`splatview ladder` and `splatview bill` as they are typed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.scene.formats import save_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory, random_gaussians) -> Path:
    path = tmp_path_factory.mktemp("ladder") / "ball.ply"
    save_scene(random_gaussians(400, seed=2), path)
    return path


SMALL = ("--size", "48x32", "--renderers", "cpu", "--views", "1", "--rounds", "3")


def test_a_ladder_as_json_and_as_a_plot(scene, tmp_path, capsys):
    plot = tmp_path / "ladder.png"
    assert (
        main(["ladder", str(scene), *SMALL, "--knobs", "sh-degree,early-stop", "--json", "--plot", str(plot)])
        == 0
    )
    made = json.loads(capsys.readouterr().out)
    assert made["size"] == [48, 32] and made["splats"] == 400 and made["complete"]
    assert {rung["knob"] for rung in made["rungs"]} == {"renderer", "sh-degree", "early-stop"}
    assert made["rungs"][0]["options"] == ["--renderer", "cpu"] and made["noise"] > 0
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_the_table_fits_a_terminal_and_says_what_its_words_mean(scene, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["ladder", str(scene), *SMALL, "--knobs", "resolution"]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80 and "…" not in out, "no name is cut short"
    for word in ("48x32, 1 view", "resolution 1/2", "PSNR (dB)", "largest", "Noise floor", "same"):
        assert word.lower() in " ".join(out.split()).lower()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--knobs", "speed"], "there is no knob 'speed'; there are sh-degree"),
        (["--renderers", "cpu,abacus"], "--renderers abacus: choose from"),
        (["--plot", "plot.txt"], "plot.txt: pictures are written as .png or .svg or .pdf"),
        (["--plot", "nowhere/plot.png"], "does not exist; make it first"),
        (["--thorough", "--seconds", "3"], "--thorough and --seconds all say how long"),
        (["--views", "0"], "--views"),
        (["--seconds", "-1"], "--seconds"),
        (["--size", "wide"], "--size"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_what_is_mistyped_is_one_line(scene, tmp_path, monkeypatch, capsys, options, complaint):
    monkeypatch.chdir(tmp_path)
    assert main(["ladder", str(scene), *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and err.startswith("splatview: ")
    assert complaint in err and not list(tmp_path.iterdir())


def test_a_bill_and_its_heat_map(scene, tmp_path, capsys):
    picture = tmp_path / "heat.npy"
    given = ["bill", str(scene), "--size", "48x32", "--heatmap", str(picture)]
    assert main([*given, "--json"]) == 0
    bill = json.loads(capsys.readouterr().out)
    assert bill["splats"] == 400 and bill["evaluations"] > 0 and bill["nerf_samples"] == 192
    heat = np.load(picture)
    assert heat.shape == (32, 48, 4) and heat[..., :3].max() > 0.9 > heat[..., :3].min()
    assert main(given) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "593,408" in out and "99th percentile" in out and "times the arithmetic" in out


@pytest.mark.parametrize(
    ("options", "complaint"),
    [(["--heatmap", "heat.jpg"], "heat.jpg: pictures are written as"), (["--size", "0x4"], "--size")],
)
def test_a_mistyped_bill_is_one_line(scene, tmp_path, monkeypatch, capsys, options, complaint):
    monkeypatch.chdir(tmp_path)
    assert main(["bill", str(scene), *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and complaint in err


def test_a_plot_without_matplotlib_is_told_before_anything_is_measured(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("splatview.cli.ladder.find_spec", lambda name: None)
    monkeypatch.setattr("splatview.cli.ladder.load_scene", None)  # nothing is even read
    code = main(["ladder", str(tmp_path / "scene.ply"), "--plot", str(tmp_path / "p.png")])
    assert (code, capsys.readouterr().err) == (
        2,
        "splatview: --plot needs matplotlib: pip install 'splatview[plot]'\n",
    )
