"""`splatview edit` and `splatview convert`, as a script would use them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.cli.main import main
from splatview.edit.document import Document, export
from splatview.edit.operations import operation_from_json
from splatview.edit.recipe import recipe_of, save_recipe
from splatview.renderers.cpu import CpuRenderer
from splatview.scene import Gaussians, look_at
from splatview.scene.formats import load_scene, save_scene

CAMERA = look_at((0, 0, -4), (0, 0, 0), width=64, height=48)
REGION = {
    "camera": {
        "width": 64,
        "height": 48,
        "fx": CAMERA.fx,
        "fy": CAMERA.fy,
        "cx": CAMERA.cx,
        "cy": CAMERA.cy,
        "world_to_camera": CAMERA.world_to_camera.tolist(),
    },
    "x0": 10,
    "y0": 5,
    "x1": 40,
    "y1": 40,
}


@pytest.fixture
def scene(tmp_path: Path, random_gaussians: Callable[..., Gaussians]) -> Path:
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(300, sh_degree=2), path)
    return path


@pytest.fixture
def splatview(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """`splatview(argv...)`: exit code, standard output, standard error."""

    def run(*argv: object) -> tuple[int, str, str]:
        code = main([str(argument) for argument in argv])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def recipe(path: Path, *steps: dict[str, Any]) -> Path:
    path.write_text(json.dumps({"splatview_recipe": 1, "steps": steps}))
    return path


def test_a_recorded_recipe_gives_the_bytes_of_the_export(scene, splatview, tmp_path):
    document = Document(load_scene(scene), name=scene.name, tools=CpuRenderer())
    for step in (
        {"op": "select", "by": {"kind": "rectangle", **REGION, "depth": "front"}},
        {"op": "grow", "distance": 0.2},
        {"op": "delete"},
        {"op": "transform", "scope": "scene", "rotation": [0.9, 0.1, 0.2, 0], "scale": 1.3},
        {"op": "decimate", "keep": 150},
        {"op": "add_crop", "crop": {"shape": "sphere", "half_extents": [1.2, 1.2, 1.2]}},
        {"op": "grade", "grade": {"saturation": 0.5}},
    ):
        assert document.apply(operation_from_json(step)).parts
    save_recipe(recipe_of(document), tmp_path / "r.json")
    export(document, tmp_path / "window.ply")
    code, out, err = splatview("edit", scene, "--recipe", tmp_path / "r.json", "-o", tmp_path / "out.ply")
    assert (code, out) == (0, "")
    assert "step 3 of 7: Delete" in err
    assert (tmp_path / "out.ply").read_bytes() == (tmp_path / "window.ply").read_bytes()


def test_a_dry_run_tells_and_writes_nothing(scene, splatview, tmp_path):
    steps = ({"op": "select_all"}, {"op": "split", "path": "part.ply"})
    path = recipe(tmp_path / "r.json", {"op": "select", "by": {"kind": "runs", "runs": [[0, 9]]}}, steps[1])
    before = sorted(tmp_path.iterdir())
    code, out, _ = splatview("edit", scene, "--recipe", path, "--dry-run")
    assert code == 0
    assert out.splitlines() == [
        "step 1 of 2: Select by runs: 9 selected",
        "step 2 of 2: Split 9 splats to part.ply",
        "291 of 300 splats would be written",
    ]
    assert sorted(tmp_path.iterdir()) == before
    code, out, _ = splatview("edit", scene, "--recipe", path, "--dry-run", "--json")
    report = json.loads(out)
    assert (report["count"], report["kept"]) == (300, 291)
    assert [step["count"] for step in report["steps"]] == [9, 9]


def test_steps_with_their_prices(scene, splatview, tmp_path):
    steps = recipe(
        tmp_path / "r.json",
        {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 0.5}},
        {"op": "delete"},
    )
    code, out, err = splatview("edit", scene, "--recipe", steps, "--dry-run", "--prices")
    assert (code, err) == (0, "")
    assert out.count("no pixel of 8 views changes") == 1
    assert out.count("dB at worst, over 8 views") == 1
    code, out, _ = splatview("edit", scene, "--recipe", steps, "--dry-run", "--prices", "--json")
    prices = [step["price"] for step in json.loads(out)["steps"]]
    assert prices[0]["mean"] == 100.0 > prices[1]["mean"] >= prices[1]["worst"] > 0
    assert prices[1]["count"] > 0 < prices[1]["largest_error"]


def test_files_beside_the_recipe(scene, splatview, tmp_path):
    folder = tmp_path / "recipes"
    folder.mkdir()
    save_scene(load_scene(scene).take(np.arange(20)), folder / "more.ply")
    path = recipe(folder / "r.json", {"op": "merge", "path": "more.ply"}, {"op": "split", "path": "part.ply"})
    code, _, err = splatview("edit", scene, "--recipe", path, "-o", tmp_path / "out.ply")
    assert code == 0, err
    assert (tmp_path / "out.ply").read_bytes() == scene.read_bytes()
    assert (tmp_path / "part.ply").read_bytes() == (folder / "more.ply").read_bytes()
    assert "20 splats split off" in err


SPLIT = {"op": "select", "by": {"kind": "runs", "runs": [[0, 9]]}}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../part.ply", "is outside"),
        ("sub/../../part.ply", "is outside"),
        ("ABSOLUTE", "is outside"),
        ("link/part.ply", "is outside"),
        ("scene.ply", "is SCENE itself"),
        ("linked.ply", "is SCENE itself"),
        ("there.ply", "exists already"),
    ],
)
def test_a_recipe_of_a_stranger_writes_nowhere_else_and_over_nothing(
    scene, splatview, tmp_path, name, message
):
    folder, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    here = folder / "scene.ply"
    here.write_bytes(scene.read_bytes())
    (folder / "link").symlink_to(elsewhere)
    (folder / "linked.ply").hardlink_to(here)
    (folder / "there.ply").write_bytes(b"precious")
    name = str(elsewhere / "part.ply") if name == "ABSOLUTE" else name
    path = recipe(tmp_path / "r.json", SPLIT, {"op": "split", "path": name})
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    code, out, err = splatview("edit", here, "--recipe", path, "-o", folder / "out.ply")
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert f"step 2 (split): {name}: {message}" in err
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before
    code, _, err = splatview("edit", here, "--recipe", path, "-o", folder / "out.ply", "--force")
    assert code == (0 if name == "there.ply" else 2), err
    assert here.read_bytes() == scene.read_bytes()


def test_the_scene_itself_may_be_written_over(scene, splatview, tmp_path):
    path = recipe(tmp_path / "r.json", {"op": "select_all"}, {"op": "duplicate"})
    assert splatview("edit", scene, "--recipe", path, "-o", scene)[0] == 0
    assert len(load_scene(scene)) == 600


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (({"op": "explode"},), 'r.json: step 1 (explode): unknown operation "explode"'),
        (
            ({"op": "delete"}, {"op": "transform", "scale": 0}),
            "r.json: step 2 (transform): scale must be above 0",
        ),
        (({"op": "remove_crop", "index": 1},), "r.json: step 1 (remove_crop): index 1: there are 0 crops"),
        (({"op": "merge", "path": "nowhere.ply"},), "r.json: step 1 (merge): "),
        (({"op": "select_all"}, {"op": "delete"}), "r.json: everything is deleted or cropped away"),
        (
            (
                {"op": "select", "by": {"kind": "runs", "runs": [[0, 9]]}},
                {"op": "split", "path": "part.ply"},
                {"op": "size", "value": -1},
            ),
            "r.json: step 3 (size): value must be in 1e-9 to 1e9, got -1",
        ),
        (
            (
                {"op": "select", "by": {"kind": "runs", "runs": [[0, 9]]}},
                {"op": "split", "path": "part.ply"},
                {"op": "select", "by": {"kind": "runs", "runs": [[300, 1]]}},
            ),
            "r.json: step 3 (select): runs[0] ends at splat 301",
        ),
        (
            (
                {"op": "select", "by": {"kind": "runs", "runs": [[0, 9]]}},
                {"op": "split", "path": "out.ply"},
            ),
            "out.ply: two of the recipe's files would have one name",
        ),
        (
            (
                {"op": "select", "by": {"kind": "runs", "runs": [[0, 9]]}},
                {"op": "split", "path": "nowhere/part.ply"},
            ),
            "does not exist",
        ),
    ],
)
def test_bad_recipes_write_nothing(scene, splatview, tmp_path, steps, message):
    path = recipe(tmp_path / "r.json", *steps)
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    code, out, err = splatview("edit", scene, "--recipe", path, "-o", tmp_path / "out.ply")
    assert (code, out) == (2, "")
    errors = [line for line in err.splitlines() if line.startswith("splatview:")]
    assert len(errors) == 1
    assert message in errors[0]
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_recipes_for_other_scenes(scene, splatview, tmp_path, random_gaussians):
    document = Document(load_scene(scene), name="scene.ply")
    document.apply(operation_from_json({"op": "transform", "scope": "scene", "scale": 2}))
    save_recipe(recipe_of(document), tmp_path / "r.json")
    save_scene(random_gaussians(40, sh_degree=1), tmp_path / "other.ply")
    arguments = ("edit", tmp_path / "other.ply", "--recipe", tmp_path / "r.json", "-o", tmp_path / "out.ply")
    code, _, err = splatview(*arguments)
    assert code == 2
    assert 'made for another scene, "scene.ply" (count 300 instead of 40)' in err
    assert not (tmp_path / "out.ply").exists()
    assert splatview(*arguments, "--any-scene")[0] == 0
    assert len(load_scene(tmp_path / "out.ply")) == 40


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("edit", "SCENE"), "--recipe"),
        (("edit", "SCENE", "--recipe", "R"), "give -o OUT or --dry-run"),
        (("edit", "SCENE", "--recipe", "R", "-o", "DIR/nowhere/out.ply"), "does not exist"),
        (("edit", "SCENE", "--recipe", "R", "-o", "DIR/out.xyz"), "saved as .ply"),
        (("edit", "SCENE", "--recipe", "R", "-o", "DIR"), "saved as .ply"),
        (("edit", "SCENE", "--recipe", "DIR/none.json", "-o", "DIR/out.ply"), "none.json: no such file"),
        (("edit", "DIR/none.ply", "--recipe", "R", "-o", "DIR/out.ply"), "none.ply"),
        (("convert", "SCENE"), "OUT"),
        (("convert", "SCENE", "DIR/out.png"), "saved as .ply"),
        (("convert", "R", "DIR/out.ply"), "r.json"),
        (("convert", "DIR/none.ply", "DIR/out.ply"), "none.ply"),
    ],
)
def test_bad_usage(scene, splatview, tmp_path, argv, message):
    names = {"SCENE": str(scene), "R": str(recipe(tmp_path / "r.json", {"op": "delete"}))}
    code, out, err = splatview(*(names.get(word, word.replace("DIR", str(tmp_path))) for word in argv))
    assert (code, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "out.ply").exists()


def test_converting_keeps_every_byte(scene, splatview, tmp_path):
    code, out, err = splatview("convert", scene, tmp_path / "out.ply")
    assert (code, out) == (0, "")
    assert "300 splats" in err
    assert (tmp_path / "out.ply").read_bytes() == scene.read_bytes()
    assert splatview("convert", scene, scene)[0] == 0
    assert (tmp_path / "out.ply").read_bytes() == scene.read_bytes()


def test_help_lists_the_operations(splatview):
    code, out, _ = splatview("edit", "--help")
    assert code == 0
    assert "delete_cropped" in out and "splatview_recipe" in out


def test_steps_that_would_take_too_much_memory_are_refused_in_one_line(scene, splatview, tmp_path):
    doubled = recipe(tmp_path / "r.json", *[{"op": "select_all"}, {"op": "duplicate"}] * 16)
    out = tmp_path / "out.ply"
    code, _, err = splatview("edit", scene, "--recipe", doubled, "-o", out, "--memory", "0.001")
    assert code == 2 and not out.exists()
    last = err.splitlines()[-1]
    assert last.startswith(f"splatview: {doubled}: step 8 (duplicate): this takes 1.1 MiB of memory, and ")
    assert "--memory" in last
    code, _, err = splatview("edit", scene, "--recipe", doubled, "--dry-run", "--memory", "0")
    assert (code, err.count("\n")) == (2, 1)
