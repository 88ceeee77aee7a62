"""RECIPES.md: the format of recipes with every operation, written from the classes themselves.

``python tools/recipe_docs.py`` writes it anew; a test says when that is due.
"""

from __future__ import annotations

import ast
import inspect
import json
import textwrap
import types
from dataclasses import MISSING, Field, fields
from functools import cache
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from splatview.edit.detectors import DETECTORS
from splatview.edit.operations import OPERATIONS
from splatview.edit.operations.appearance import Grade
from splatview.edit.operations.cleanup import REPAIRS
from splatview.edit.recipe import FORMAT, VERSION
from splatview.edit.selectors import ATTRIBUTES, SELECTORS
from splatview.edit.selectors.region_growing import REACH
from splatview.edit.serialization import to_json
from splatview.scene import Camera
from splatview.scene.edits import Crop

PAGE = Path(__file__).parents[1] / "RECIPES.md"

EXAMPLE: tuple[dict[str, Any], ...] = (
    {"op": "prune", "by": {"kind": "clusters"}, "threshold": 300.0},
    {"op": "select", "by": {"kind": "sphere", "centre": [0, 1, 0], "radius": 0.5}},
    {"op": "delete"},
    {"op": "add_crop", "crop": {"name": "table", "half_extents": [2, 1, 2]}},
    {"op": "orient", "up": [0, 0, 1]},
)

INTRODUCTION = """\
# Recipes

A recipe is what was done to a scene, as a JSON file that does it again: to the same file with the same
result to the bit, or to another scene. The window saves the steps of its history (Ctrl+S) and replays files
(Ctrl+R); without a window:

```
splatview edit SCENE --recipe RECIPE.json -o OUT.ply
```

One can also be written by hand:

```json
{example}
```

- `splatview_recipe` is the version of the format.
- `scene` says which scene the recipe was made for: its `name`, `count` and `fingerprint`. Another one is
  refused unless `--any-scene` is given. Left out, the recipe is for any scene.
- `steps` are done in order, each an object with `op` and the fields of that operation. Fields that are left
  out have the values given here; unknown ones are errors, which name the step. If a step cannot be done,
  nothing is written.

Lengths are world units, camera axes x right, y down, z forward; rotations are quaternions w, x, y, z of
length 1; a camera is an object as in camera files. Relative paths start from the recipe's folder. A selected
splat is never hidden, deleted or locked, and operations pass over deleted and locked splats.

*This page is written by `python tools/recipe_docs.py`.*
"""

NAMES = {float: "number", int: "whole number", str: "text", bool: "true or false", type(None): "null"}
"""Of types, as people say them."""

IN_THE_SOURCE = {
    "One of SELECTORS: says": "Says",
    "One of DETECTORS.": "What is looked for, see below.",
    "A name in ATTRIBUTES.": "One of the attributes below.",
    "A key of REPAIRS.": "One of the findings below.",
    "None: ": "null: ",
    "REACH times": f"{REACH:g} times",
}
"""Words for readers of the source, and for those of the page."""

COUNTED = {2: "two", 3: "three", 4: "four"}


def page() -> str:
    """The page's text."""
    steps = ",\n".join(f"    {json.dumps(step)}" for step in EXAMPLE)
    text = f'{{\n  "{FORMAT}": {VERSION},\n  "steps": [\n{steps}\n  ]\n}}'
    parts = [INTRODUCTION.replace("{example}", text), "## Operations\n"]
    parts += [_section(f"`{name}`", cls.summary, cls) for name, cls in OPERATIONS.items()]
    parts.append("## What `select` selects by\n\n`by` has a `kind` and the fields of that kind.\n")
    parts += [_section(f"`{name}`", _first_line(cls), cls) for name, cls in SELECTORS.items()]
    parts.append(
        "## What `prune` prunes by\n\n`by` has a `kind` and the fields of that kind; what scores above the"
        " step's `threshold` is deleted.\n"
    )
    for name, cls in DETECTORS.items():
        summary = f"{cls.what.rstrip('.')}. Scores in {cls.unit}; {cls.threshold:g} is a sensible threshold"
        parts.append(_section(f"`{name}`", summary, cls))
    parts.append("## Attributes\n\nOf `range`.\n\n| name | unit | |\n|---|---|---|")
    parts += [f"| `{name}` | {one.unit} | {one.what} |" for name, one in ATTRIBUTES.items()]
    parts.append("\n## Findings\n\nOf `repair`; `health` also selects what cannot be repaired.\n")
    parts += [f"- `{name}`: {what}" for name, what in REPAIRS.items()]
    parts.append("\n## Objects in fields\n")
    parts += [_section(f"`{cls.__name__}`", _first_line(cls), cls) for cls in (Crop, Grade)]
    return "\n".join(parts)


def _first_line(cls: type) -> str:
    return (inspect.getdoc(cls) or "").partition("\n\n")[0]


def _section(title: str, summary: str, cls: type) -> str:
    ended = summary if summary.endswith(".") else f"{summary}."
    lines = [f"### {title}", "", textwrap.fill(" ".join(ended.split()), 110), ""]
    hints = get_type_hints(cls)
    rows = [_row(cls, field, hints[field.name]) for field in fields(cls) if field.init]
    if rows:
        lines += ["| field | type | if left out | |", "|---|---|---|---|", *rows, ""]
    return "\n".join(lines)


def _row(cls: type, field: Field[Any], hint: Any) -> str:
    notes = next((_notes(owner)[field.name] for owner in cls.__mro__ if field.name in _notes(owner)), "")
    text = " ".join(notes.split()).replace("|", "\\|")
    for old, new in IN_THE_SOURCE.items():
        text = text.replace(old, new)
    return f"| `{field.name}` | {kind(hint)} | {_default(field)} | {text} |"


def kind(hint: Any) -> str:
    """What a field of this type takes, in words."""
    origin, of = get_origin(hint), get_args(hint)
    if hint in NAMES:
        return NAMES[hint]
    if origin is Literal:
        return ", ".join(f"`{json.dumps(value)}`" for value in of)
    if origin in (Union, types.UnionType):
        return " or ".join(kind(part) for part in of)
    if origin is tuple and of[-1] is Ellipsis:
        return f"list of {_several(of[0])}"
    if origin is tuple:
        return f"{COUNTED[len(of)]} {_several(of[0])}"
    if hint is Any:
        return "object with `kind`"
    return "camera" if hint is Camera else f"[{hint.__name__}](#{hint.__name__.lower()})"


def _several(hint: Any) -> str:
    return {"number": "numbers", "whole number": "whole numbers", "camera": "cameras"}.get(
        kind(hint), f"[{kind(hint)}]"
    )


def _default(field: Field[Any]) -> str:
    if field.default is not MISSING:
        return f"`{json.dumps(to_json(field.default))}`"
    if field.default_factory is not MISSING:
        return f"`{json.dumps(to_json(field.default_factory()))}`"
    return "must be given"


@cache
def _notes(cls: type) -> dict[str, str]:
    """What the source says below each field of a class."""
    if cls.__module__ == "builtins" or cls.__module__.startswith(("abc", "typing")):
        return {}
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
    assert isinstance(body, ast.ClassDef)
    found = {}
    for this, following in zip(body.body, body.body[1:], strict=False):
        if (
            isinstance(this, ast.AnnAssign)
            and isinstance(this.target, ast.Name)
            and isinstance(following, ast.Expr)
            and isinstance(following.value, ast.Constant)
            and isinstance(following.value.value, str)
        ):
            found[this.target.id] = following.value.value
    return found


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
