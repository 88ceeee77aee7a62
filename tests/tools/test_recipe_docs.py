"""The page on recipes is as the classes are, and its example works."""

from __future__ import annotations

import json

from recipe_docs import PAGE, filled, reference

from splatview.edit.document import Document
from splatview.edit.operations import OPERATIONS
from splatview.edit.recipe import load_recipe, replay


def test_the_page_is_current():
    page = PAGE.read_text(encoding="utf-8")
    assert page == filled(page), "run python tools/recipe_docs.py"


def test_every_operation_and_field_is_on_it():
    text = PAGE.read_text(encoding="utf-8")
    assert reference() in text
    for name, cls in OPERATIONS.items():
        assert f"#### `{name}`\n" in text
        assert cls.summary.split(";")[0].split()[0] in text
    assert "| `threshold` | number | must be given | Splats that score above it are meant. |" in text


def test_its_example_is_a_recipe(tmp_path, random_gaussians):
    block = PAGE.read_text(encoding="utf-8").partition("```json\n")[2].partition("```")[0]
    path = tmp_path / "example.json"
    path.write_text(block)
    recipe = load_recipe(path)
    assert [step.op for step in recipe.steps] == [step["op"] for step in json.loads(block)["steps"]]
    document = Document(random_gaussians(200, seed=1))
    replay(recipe, document)
    assert "add_crop" in [step.operation.op for step in document.history.done]
