"""Recipes: the steps of an edit as a file, to be replayed on this scene or another one.

``{"splatview_recipe": 1, "scene": {"name", "count", "fingerprint"}, "steps": [{"op": ...}, ...]}``
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatview.edit.changes import Change
from splatview.edit.document import Document
from splatview.edit.operations import Operation, Select, operation_from_json
from splatview.edit.selectors import IndexRuns
from splatview.edit.serialization import quoted
from splatview.scene import InputError
from splatview.scene.formats.io import atomic_write, read_json
from splatview.scene.progress import NO_PROGRESS, Progress

FORMAT = "splatview_recipe"
VERSION = 1


@dataclass(frozen=True, eq=False, kw_only=True)
class Recipe:
    steps: tuple[Operation, ...]
    scene: Mapping[str, Any]
    """`Document.identity` of the scene that the recipe was made for; empty: any."""
    folder: Path | None = None
    """Folder of relative paths in the steps."""

    def to_json(self) -> dict[str, Any]:
        return {
            FORMAT: VERSION,
            "scene": dict(self.scene),
            "steps": [step.to_json() for step in self.steps],
        }


def recipe_of(document: Document) -> Recipe:
    """The steps in force in `document`."""
    steps = tuple(step.operation for step in document.history.done)
    return Recipe(steps=steps, scene=document.identity, folder=document.folder)


def save_recipe(recipe: Recipe, path: Path) -> None:
    """Writes a recipe, wholly or not at all, one step per line. Raises InputError."""
    if path.suffix.lower() != ".json":
        raise InputError(f"{path}: recipes are saved as .json; give it that suffix")
    with atomic_write(path) as file:
        file.write(as_text(recipe).encode())


def as_text(recipe: Recipe) -> str:
    """The text of a recipe's file."""
    data = recipe.to_json()
    steps = ",\n".join(f"  {json.dumps(step, allow_nan=False)}" for step in data["steps"])
    scene = json.dumps(data["scene"])
    return f'{{\n "{FORMAT}": {VERSION},\n "scene": {scene},\n "steps": [\n{steps}\n ]\n}}\n'


def load_recipe(path: str | os.PathLike[str]) -> Recipe:
    """The recipe in a file.

    Raises:
        InputError: it cannot be read, or is no recipe; for a wrong step with its number and operation.
    """
    path = Path(path)
    data = read_json(path, what="recipe")
    if not isinstance(data, dict) or FORMAT not in data:
        raise InputError(f'{path}: is no recipe: the key "{FORMAT}" is missing')
    if data[FORMAT] != VERSION:
        raise InputError(
            f"{path}: is a recipe of version {quoted(data[FORMAT])}; this program knows {VERSION}"
        )
    unknown = set(data) - {FORMAT, "scene", "steps"}
    if unknown:
        raise InputError(f"{path}: unknown key {quoted(min(unknown))}; known here: scene, steps")
    scene, steps = data.get("scene", {}), data.get("steps")
    if not isinstance(scene, dict):
        raise InputError(f"{path}: scene must be an object in braces, not {quoted(scene)}")
    if not isinstance(steps, list):
        raise InputError(f"{path}: steps must be a list in brackets, not {quoted(steps)}")
    return Recipe(steps=steps_from_json(steps, str(path)), scene=scene, folder=path.absolute().parent)


def steps_from_json(steps: Sequence[Any], where: str) -> tuple[Operation, ...]:
    """The operations of a recipe's steps. Raises InputError that begins with `where` and names the step."""
    operations = []
    for number, step in enumerate(steps, start=1):
        try:
            operations.append(operation_from_json(step))
        except InputError as error:
            raise InputError(f"{where}: {step_name(number, step)}: {error}") from None
    return tuple(operations)


def step_name(number: int, step: Any) -> str:
    """``step 3 (transform)``."""
    name = step.op if isinstance(step, Operation) else step.get("op") if isinstance(step, dict) else None
    return f"step {number} ({name})" if isinstance(name, str) else f"step {number}"


def check_scene(recipe: Recipe, document: Document, *, any_scene: bool = False) -> None:
    """Checks that `recipe` was made for the scene of `document`, which has no edits yet.

    With `any_scene` other scenes are accepted, except for steps that name splats by their numbers.

    Raises:
        InputError: it was made for another scene.
    """
    own = document.identity
    differences = [
        f"{key} {quoted(recipe.scene[key])} instead of {quoted(own[key])}"
        for key in ("count", "fingerprint")
        if key in recipe.scene and recipe.scene[key] != own[key]
    ]
    if not differences:
        return
    made_for = quoted(recipe.scene.get("name", "a scene"))
    if not any_scene:
        raise InputError(
            f"the recipe was made for another scene, {made_for} ({differences[0]}); "
            "--any-scene applies it all the same"
        )
    for number, step in enumerate(recipe.steps, start=1):
        if isinstance(step, Select) and isinstance(step.by, IndexRuns):
            raise InputError(
                f"{step_name(number, step)}: names splats by their numbers in another scene, {made_for}; "
                "it cannot be applied to this one"
            )


def replay(
    recipe: Recipe,
    document: Document,
    *,
    on_step: Callable[[int, Operation, Change], None] | None = None,
    progress: Progress = NO_PROGRESS,
    undo: bool = True,
) -> None:
    """Applies all steps; if one cannot be applied, those before it are undone. Without `undo` they are not,
    nor can they be: a document that is given up then needs no memory for them.

    Raises:
        InputError: with the step's number and operation.
        Cancelled: nobody waits for it any more.
    """
    position = document.history.position
    try:
        # Numbers of a recipe may be out of all bounds: their results are then infinite, or beyond every
        # limit.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for number, operation in enumerate(recipe.steps, start=1):
                part = progress.part((number - 1) / len(recipe.steps), number / len(recipe.steps))
                part.step(0.0)
                try:
                    planned = document.plan(operation, progress=part)
                    if undo:
                        document.require_room(planned.change.nbytes)
                    change = document.apply(planned, keep=position + number)
                    if not undo:
                        document.history.trim(0, keep=0)
                except InputError as error:
                    raise InputError(f"{step_name(number, operation)}: {error}") from None
                if on_step is not None:
                    on_step(number, operation, change)
        document.history.trim(document.budget / 2, keep=1)
    except BaseException:
        if undo:
            document.jump(position)
        raise
