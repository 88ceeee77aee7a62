"""`import splatview`: lazy names, and the blocks of docs/python.md run in order."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import splatview
from splatview.renderers.scripting import apply_recipe
from splatview.scene import InputError
from splatview.scene.demo import demo_scene
from splatview.scene.formats import save_scene

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "python.md"
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def fresh_python(code: str) -> str:
    """What a new interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_names_are_imported_when_used():
    loaded = "sorted({'numpy', 'numba', 'torch', 'moderngl', 'imgui_bundle'} & set(sys.modules))"
    code = f"import sys, splatview; print({loaded}); splatview.load_scene; print({loaded})"
    assert fresh_python(code).split("\n")[:2] == ["[]", "['numpy']"]


def test_every_name_is_there_for_people_and_for_type_checkers():
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    typed = {
        alias.name: node.module.removeprefix("splatview.")
        for node in block.body
        if isinstance(node, ast.ImportFrom) and node.module and node.module != "typing"
        for alias in node.names
    }
    assert typed == splatview.MODULE_OF
    assert set(splatview.MODULE_OF) <= set(dir(splatview))
    for name in splatview.MODULE_OF:
        assert getattr(splatview, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'lode_scene'"):
        splatview.lode_scene  # noqa: B018


@pytest.fixture(scope="module")
def scene():
    return demo_scene("landscape", splats=3000)


def test_the_page_runs(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_scene(scene, "scene.ply")
    # tests/trainer/test_python_docs.py runs the section on training.
    blocks = BLOCK.findall(PAGE.read_text(encoding="utf-8").partition("\n## Train\n")[0])
    assert len(blocks) >= 6
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    assert (tmp_path / "larger.spz").exists()
    picture, cleaned = names["picture"], names["cleaned"]
    assert isinstance(picture, np.ndarray) and picture.shape == (240, 320, 4) and picture[..., 3].max() > 0.5
    assert isinstance(cleaned, splatview.Gaussians) and 0 < len(cleaned) < len(scene)
    truth, flat = names["truth"], names["flat"]
    assert isinstance(truth, np.ndarray) and isinstance(flat, np.ndarray) and abs(flat - truth).max() < 1e-2


def test_recipes_are_files_steps_or_operations(scene, tmp_path):
    steps = [{"op": "decimate", "keep": 100}]
    path = tmp_path / "recipe.json"
    path.write_text('{"splatview_recipe": 1, "steps": [{"op": "decimate", "keep": 100}]}')
    by_steps = apply_recipe(scene, steps)
    assert len(by_steps) == 100
    for other in (path, str(path), splatview.load_recipe(path), splatview.load_recipe(path).steps):
        np.testing.assert_array_equal(apply_recipe(scene, other).means, by_steps.means)


def test_a_wrong_step_is_named_and_the_scene_stays(scene):
    before = scene.means.copy()
    with pytest.raises(InputError, match=r"step 2 \(prune\): unknown key"):
        apply_recipe(scene, [{"op": "select_all"}, {"op": "prune", "detector": "floaters"}])
    with pytest.raises(InputError, match="nothing to export"):
        apply_recipe(scene, [{"op": "select_all"}, {"op": "delete"}])
    np.testing.assert_array_equal(scene.means, before)


def test_what_is_split_off_needs_a_taker(scene):
    steps = [
        {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 1}},
        {"op": "split", "path": "part.ply"},
    ]
    with pytest.raises(InputError, match=r"part\.ply; give on_split"):
        apply_recipe(scene, steps)
    parts = []
    rest = apply_recipe(scene, steps, on_split=lambda part, path: parts.append((part, path.name)))
    ((part, name),) = parts
    assert name == "part.ply" and len(part) + len(rest) == len(scene)
