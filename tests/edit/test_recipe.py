"""Recipes: saved and loaded to the bit, refused in one line, replayed to the same file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.document import Document, export
from splatview.edit.operations import Transform, operation_from_json
from splatview.edit.recipe import Recipe, check_scene, load_recipe, recipe_of, replay, save_recipe
from splatview.scene import InputError
from splatview.scene.formats import load_scene
from splatview.scene.progress import Cancelled, Progress

STEPS: list[dict[str, Any]] = [
    {"op": "select", "by": {"kind": "sphere", "centre": [0.1, 0, 0], "radius": 0.7}},
    {"op": "transform", "rotation": [0.9, 0.1, 0.2, 0.3], "translation": [0.1, 0.2, 0.3], "scale": 1.1},
    {"op": "select", "by": {"kind": "runs", "runs": [[0, 5], [20, 3]]}, "mode": "add"},
    {"op": "delete"},
    {"op": "add_crop", "crop": {"half_extents": [0.9, 0.8, 0.9], "name": "the room"}},
    {"op": "grade", "grade": {"contrast": 1.2}},
]


def written(path: Path, content: Any) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def edited(path: Path, **options: Any) -> Document:
    document = Document(load_scene(path), name=path.name, **options)
    for step in STEPS:
        document.apply(operation_from_json(step))
    return document


def test_a_recorded_recipe_replayed_gives_the_same_bytes(scene_file, tmp_path):
    path = scene_file()
    by_hand = edited(path)
    document = edited(path)
    document.undo()
    document.undo()
    document.redo()
    for steps in (by_hand, document):
        save_recipe(recipe_of(steps), tmp_path / "r.json")
        export(steps, tmp_path / "window.ply")
        again = Document(load_scene(path), name=path.name)
        recipe = load_recipe(tmp_path / "r.json")
        check_scene(recipe, again)
        replay(recipe, again)
        export(again, tmp_path / "headless.ply")
        assert (tmp_path / "headless.ply").read_bytes() == (tmp_path / "window.ply").read_bytes()
        assert [step.title for step in again.history.done] == [step.title for step in steps.history.done]


finite = st.floats(-1e9, 1e9)


@settings(max_examples=50, deadline=None)
@given(st.tuples(finite, finite, finite), st.floats(1e-9, 1e9))
def test_floats_come_back_to_the_bit(tmp_path_factory, translation, scale):
    path = tmp_path_factory.mktemp("recipe") / "r.json"
    step = Transform(translation=translation, scale=scale)
    save_recipe(Recipe(steps=(step,), scene={}), path)
    assert load_recipe(path).steps == (step,)


def test_a_recipe_is_a_file_that_people_can_read(scene_file, tmp_path):
    save_recipe(recipe_of(edited(scene_file())), tmp_path / "r.json")
    lines = (tmp_path / "r.json").read_text().splitlines()
    assert len(lines) == 6 + len(STEPS)
    data = json.loads("".join(lines))
    assert data["splatview_recipe"] == 1
    assert data["scene"]["name"] == "scene.ply"
    assert data["scene"]["count"] == 50
    assert data["steps"][4]["crop"]["name"] == "the room"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is no recipe: not JSON"),
        ([], 'the key "splatview_recipe" is missing'),
        ({"splatview_recipe": 2, "steps": []}, "version 2; this program knows 1"),
        ({"splatview_recipe": 1}, "steps must be a list"),
        ({"splatview_recipe": 1, "steps": [], "more": 1}, 'unknown key "more"'),
        ({"splatview_recipe": 1, "steps": [], "scene": 3}, "scene must be an object"),
        (
            {"splatview_recipe": 1, "steps": [{"op": "delete"}, {"op": "transform", "scale": 0}]},
            r"r\.json: step 2 \(transform\): scale must be above 0",
        ),
        (
            '{"splatview_recipe": 1, "steps": [{"op": "size", "value": NaN}]}',
            r"step 1 \(size\): value must be a finite number, not NaN",
        ),
        ({"splatview_recipe": 1, "steps": [{"op": "explode"}]}, r"step 1 \(explode\): unknown operation"),
        ({"splatview_recipe": 1, "steps": [5]}, "step 1: a step must be an object"),
    ],
)
def test_bad_recipes_are_refused_in_one_line(tmp_path, content, message):
    with pytest.raises(InputError, match=message) as error:
        load_recipe(written(tmp_path / "r.json", content))
    assert "\n" not in str(error.value)


def test_recipes_for_other_scenes(scene_file):
    recipe = recipe_of(edited(scene_file()))
    other = Document(load_scene(scene_file("other.ply", seed=1)))
    with pytest.raises(InputError, match=r'made for another scene, "scene\.ply".*--any-scene'):
        check_scene(recipe, other)
    with pytest.raises(InputError, match=r"step 3 \(select\): names splats by their numbers"):
        check_scene(recipe, other, any_scene=True)
    without = Recipe(steps=recipe.steps[:2], scene=recipe.scene)
    check_scene(without, other, any_scene=True)
    replay(without, other)
    assert other.history.position == 2
    check_scene(Recipe(steps=recipe.steps, scene={}), other)


def test_one_value_makes_another_scene(scene_file):
    gaussians = load_scene(scene_file())
    identity = Document(gaussians).identity
    sh = gaussians.sh.copy()
    sh[7, 2, 1] = np.nextafter(sh[7, 2, 1], np.float32(math.inf))
    from dataclasses import replace

    assert Document(replace(gaussians, sh=sh)).identity["fingerprint"] != identity["fingerprint"]
    assert Document(replace(gaussians, comments=())).identity["fingerprint"] == identity["fingerprint"]


def test_a_step_that_fails_takes_back_those_before(scene_file, edit_helpers):
    document = Document(load_scene(scene_file()))
    document.apply(operation_from_json({"op": "select_all"}))
    before = edit_helpers.everything(document)
    steps = (*STEPS, {"op": "remove_crop", "index": 5})
    recipe = Recipe(steps=tuple(map(operation_from_json, steps)), scene={})
    with pytest.raises(InputError, match=r"step 7 \(remove_crop\): index 5: there are 1 crops"):
        replay(recipe, document)
    assert edit_helpers.everything(document) == before
    assert document.history.position == 1


def test_replaying_tells_how_far_it_is_and_can_be_stopped(scene_file):
    shares: list[float] = []
    recipe = Recipe(steps=tuple(map(operation_from_json, STEPS)), scene={})
    document = Document(load_scene(scene_file()))
    replay(recipe, document, progress=Progress(report=shares.append))
    assert shares == sorted(shares)
    assert len(shares) > 0
    stopped = Document(load_scene(scene_file()))
    with pytest.raises(Cancelled):
        replay(recipe, stopped, progress=Progress(cancelled=lambda: stopped.history.position == 2))
    assert stopped.history.position == 0


def test_recipes_are_saved_as_json_only(scene_file, tmp_path):
    with pytest.raises(InputError, match=r"saved as \.json"):
        save_recipe(recipe_of(edited(scene_file())), tmp_path / "r.txt")
