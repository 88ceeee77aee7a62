"""The reference of recipes in docs/editing.md: every operation, written from the classes themselves.

``python tools/recipe_docs.py`` writes it anew; a test says when that is due.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import re
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
from splatview.edit.selectors import SELECTORS
from splatview.edit.selectors.attributes import ATTRIBUTES
from splatview.edit.selectors.region_growing import REACH
from splatview.edit.serialization import to_json
from splatview.scene import Camera
from splatview.scene.edits import Crop

PAGE = Path(__file__).parents[1] / "docs" / "editing.md"

SECTION = re.compile(r"(<!-- reference of recipes -->\n).*?(<!-- end of the reference -->)", re.DOTALL)
"""Of the page: what lies between the two markers is generated."""

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


def reference() -> str:
    """Every operation, selector, detector, attribute and repair, as Markdown."""
    parts = ["### Operations\n"]
    parts += [_section(f"`{name}`", cls.summary, cls) for name, cls in OPERATIONS.items()]
    parts.append("### What `select` selects by\n\n`by` has a `kind` and the fields of that kind.\n")
    parts += [_section(f"`{name}`", _first_line(cls), cls) for name, cls in SELECTORS.items()]
    parts.append(
        "### What `prune` and `select_detected` go by\n\n`by` has a `kind` and the fields of that kind; what"
        " scores above the step's `threshold` is deleted or selected.\n"
    )
    for name, cls in DETECTORS.items():
        summary = f"{cls.what.rstrip('.')}. Scores in {cls.unit}; {cls.threshold:g} is a sensible threshold"
        parts.append(_section(f"`{name}`", summary, cls))
    parts.append("### Attributes\n\nOf `range`.\n\n| name | unit | |\n|---|---|---|")
    parts += [f"| `{name}` | {one.unit} | {one.what} |" for name, one in ATTRIBUTES.items()]
    parts.append("\n### Findings\n\nOf `repair`; `health` also selects what cannot be repaired.\n")
    parts += [f"- `{name}`: {what}" for name, what in REPAIRS.items()]
    parts.append("\n### Objects in fields\n")
    parts += [_section(f"`{cls.__name__}`", _first_line(cls), cls) for cls in (Crop, Grade)]
    return "\n".join(parts)


def filled(page: str) -> str:
    """The text of the page with the reference made anew."""
    return SECTION.sub(lambda found: f"{found[1]}\n{reference()}\n{found[2]}", page)


def _first_line(cls: type) -> str:
    return (inspect.getdoc(cls) or "").partition("\n\n")[0]


def _section(title: str, summary: str, cls: type) -> str:
    ended = summary if summary.endswith(".") else f"{summary}."
    lines = [f"#### {title}", "", textwrap.fill(" ".join(ended.split()), 110), ""]
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
    argparse.ArgumentParser(description=__doc__).parse_args()
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
