"""Every hard case on every renderer, and the command that shows it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.cli.main import main
from splatview.cli.stability import GL_NAMES, NAMES, case_renderers
from splatview.measure.hard_cases import CASES
from splatview.measure.hard_cases.run import CaseRenderer, run_case
from splatview.renderers import FrameRequest
from splatview.renderers.cpu import CpuRenderer
from splatview.scene import InputError

THEMES = sorted({case.theme for case in CASES})
RENDERERS = (
    *((name, blend) for name in ("quads", "quads-gl33") for blend in ("float32", "float16")),
    ("tiles", "float32"),
    ("cpu", "float32"),
)


@pytest.fixture(scope="module")
def made() -> Iterator[dict[tuple[str, str], CaseRenderer]]:
    """By name and precision."""
    try:
        with case_renderers(NAMES) as renderers:
            yield {(renderer.name, renderer.blend): renderer for renderer in renderers}
    except InputError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("theme", THEMES)
@pytest.mark.parametrize("name", RENDERERS, ids=" ".join)
def test_every_case(made, name, theme) -> None:
    if name not in made:
        pytest.skip(f"the OpenGL here is too old for {name[0]}")
    renderer = made[name]
    wrong = [
        f"{case.name} ({result.settings}): {'; '.join(result.failures)}"
        for case in CASES
        if case.theme == theme
        for result in run_case(case, renderer)
        if not result.passed
    ]
    assert not wrong, "\n".join(wrong)


def broken(self: CpuRenderer, request: FrameRequest) -> np.ndarray:
    image = np.zeros((request.camera.height, request.camera.width, 4), np.float32)
    image[0, 0, 0] = np.nan
    return image


@pytest.fixture
def broken_cpu(monkeypatch) -> None:
    """A CPU renderer that draws nothing, and one NaN."""
    monkeypatch.setattr(CpuRenderer, "render", broken)


def test_a_green_case_is_exit_code_0(capsys) -> None:
    assert main(["stability", "--renderer", "cpu", "--case", "zero quaternion"]) == 0
    out = capsys.readouterr().out
    assert "all passed" in out and "Failed" not in out and "A rotation of all zeros" in out


def test_json_is_all_that_is_printed_and_ascii(capsys, monkeypatch) -> None:
    monkeypatch.setattr("splatview.cli.stability.describe_machine", lambda: {"cpu": "größer"})
    assert main(["stability", "--json", "--renderer", "reference", "--case", "one row"]) == 0
    out = capsys.readouterr().out
    assert out.isascii()
    result = json.loads(out)
    assert result["failed"] == 0 and result["passed"] == len(result["cases"]) == 2
    first = result["cases"][0]
    assert first["case"] == "one row" and first["renderer"] == "reference float64"
    assert first["settings"] == "plain, float32" and first["passed"] is True
    assert first["error"] == 0 and first["bound"] == 2e-3


def test_a_red_case_is_exit_code_1_and_shown_first(broken_cpu, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["stability", "--renderer", "cpu", "--case", "huge quaternion"]) == 1
    out = capsys.readouterr().out
    assert out.lstrip().startswith("Failed")
    assert "NaN" in out and "does not show" in out and "2 of 2 failed" in out


def test_a_broken_renderer_in_json_has_no_numbers_that_json_lacks(broken_cpu, capsys) -> None:
    assert main(["stability", "--json", "--renderer", "cpu", "--case", "one row"]) == 1
    (row,) = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)["cases"]
    assert row["error"] is None and row["not_finite"] == 1 and row["failures"]


def test_pictures_of_a_case(broken_cpu, tmp_path: Path, capsys) -> None:
    folder = tmp_path / "new" / "folder"
    arguments = ["stability", "--renderer", "cpu", "--case", "16x16 picture", "--save", str(folder)]
    assert main(arguments) == 1
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "16x16-picture_plain_reference.png",
        "16x16-picture_plain_cpu_float32_result.png",
        "16x16-picture_plain_cpu_float32_difference.png",
    }
    difference = np.asarray(Image.open(folder / "16x16-picture_plain_cpu_float32_difference.png"))
    assert difference.shape == (480, 480, 3)
    assert (difference == 255).mean() > 0.9
    result = np.asarray(Image.open(folder / "16x16-picture_plain_cpu_float32_result.png"))
    assert (result[0, 0] == (255, 0, 255)).all() and not result[40:].any()
    assert "3 pictures" in capsys.readouterr().err


def test_save_without_a_case_writes_those_that_fail(broken_cpu, tmp_path: Path, monkeypatch, capsys) -> None:
    few = [case for case in CASES if case.name in ("nothing but NaN", "one row")]
    monkeypatch.setattr("splatview.cli.stability.CASES", few)
    assert main(["stability", "--renderer", "reference", "--save", str(tmp_path)]) == 0
    assert not list(tmp_path.iterdir())
    assert main(["stability", "--renderer", "cpu", "--save", str(tmp_path)]) == 1
    assert len(list(tmp_path.iterdir())) == 9  # one of them has two views
    capsys.readouterr()


def test_the_themes_are_a_line_each(monkeypatch, capsys) -> None:
    monkeypatch.setattr("splatview.cli.stability.CASES", CASES[:14])
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["stability", "--renderer", "reference"]) == 0
    out = capsys.readouterr().out
    assert "rotations" in out and "shapes" in out and "zero quaternion" not in out
    assert main(["stability", "--renderer", "reference", "--all"]) == 0
    assert "zero quaternion" in capsys.readouterr().out


def test_the_list_tells_what_is_hard(capsys) -> None:
    assert main(["stability", "--list", "--json"]) == 0
    out = capsys.readouterr().out
    assert out.isascii(), "whatever encoding standard output has"
    listed = json.loads(out)
    assert [case["case"] for case in listed] == [case.name for case in CASES]
    assert main(["stability", "--list", "--case", "depth tie"]) == 0
    assert "Equal depths go by index." in capsys.readouterr().out


def test_mistakes_are_one_line(tmp_path: Path, capsys) -> None:
    (tmp_path / "file").write_text("")
    for arguments in (
        ["--case", "no such thing"],
        ["--renderer", "gpu"],
        ["--case", "one row", "--renderer", "reference", "--save", str(tmp_path / "file" / "in")],
    ):
        assert main(["stability", *arguments]) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith("splatview: ") and captured.err.count("\n") == 1
        assert not captured.out


def test_without_opengl_the_others_are_tested(monkeypatch, capsys) -> None:
    def refuse(**options):
        raise InputError("no OpenGL here")

    monkeypatch.setattr("splatview.renderers.gl.context.create_headless_context", refuse)
    monkeypatch.setattr("splatview.cli.stability.CASES", CASES[:1])
    assert main(["stability", "--json"]) == 0
    captured = capsys.readouterr()
    assert "without OpenGL are tested: no OpenGL here" in captured.err
    rows = json.loads(captured.out)["cases"]
    assert {row["renderer"] for row in rows} == {"cpu", "reference float64", "reference float32"}
    for name in GL_NAMES:
        assert main(["stability", "--renderer", name]) == 2
