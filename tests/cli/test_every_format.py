"""Every command that takes or gives a scene takes and gives every format."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from splatview.cli.main import main
from splatview.scene import InputError
from splatview.scene.formats import FORMATS, check_opening, load_scene, save_scene
from splatview.trainer.run import Outputs

COUNT = 40


def place(folder: Path, name: str) -> Path:
    known = FORMATS[name]
    return folder / name / known.suffix[1:] if known.folder else folder / f"scene{known.suffix}"


@pytest.fixture(scope="module")
def scenes(tmp_path_factory, random_gaussians) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("scenes")
    paths = {name: place(folder, name) for name, known in FORMATS.items() if known.write}
    for path in paths.values():
        save_scene(random_gaussians(COUNT, sh_degree=1, seed=2), path)
    return paths


@pytest.mark.parametrize("name", [name for name, known in FORMATS.items() if known.write])
def test_edit_merges_one_and_writes_one_and_the_rest_read_it(scenes, tmp_path, name, capsys):
    recipe, out = tmp_path / "recipe.json", place(tmp_path / "out", name)
    (tmp_path / "out").mkdir()
    steps = [
        {"op": "merge", "path": str(scenes[name])},
        {"op": "delete"},
        {"op": "merge", "path": str(scenes[name])},
    ]
    recipe.write_text(json.dumps({"splatview_recipe": 1, "steps": steps}))
    assert main(["edit", str(scenes[name]), "--recipe", str(recipe), "-o", str(out)]) == 0
    assert len(load_scene(out)) == 2 * COUNT
    check_opening(out)
    assert main(["info", str(out)]) == 0
    assert f"{2 * COUNT} splats" in capsys.readouterr().out
    assert (
        main(["render", str(out), "-o", str(tmp_path / "p.png"), "--size", "32x32", "--renderer", "cpu"]) == 0
    )
    assert main(["convert", str(out), str(tmp_path / "back.ply")]) == 0
    assert len(load_scene(tmp_path / "back.ply")) == 2 * COUNT


@pytest.mark.parametrize("name", [name for name, known in FORMATS.items() if known.write])
def test_a_training_is_told_at_once_whether_it_can_be_saved_so(tmp_path, name):
    scene = place(tmp_path, name)
    outputs = Outputs(
        scene=scene, checkpoint=tmp_path / "c.safetensors", metrics=None, pictures=tmp_path / "pictures"
    )
    outputs.check()
    if FORMATS[name].folder:
        scene.parent.mkdir()
        (scene.parent / "diary.txt").write_text("mine")
        with pytest.raises(InputError, match=r"holds 'diary\.txt"):
            outputs.check()
    else:
        scene.mkdir()
        with pytest.raises(InputError, match="is a folder"):
            outputs.check()
