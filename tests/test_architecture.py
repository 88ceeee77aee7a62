"""The house's plan, checked on the sources: floors, circles, sizes, and what may be imported where.

Every import counts: those that run when a module is loaded, those inside functions, which are there to save
start-up time and not to get round the plan, and those for type checkers alone, for two modules that name each
other's types cannot be read apart either. Circles are looked for in these three steps, to tell them apart.
"""

from __future__ import annotations

import ast
import re
import tomllib
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]

FLOORS = (
    ("scene", "shaders"),
    ("raster", "edit", "measure"),
    ("trainer", "renderers"),
    ("viewer",),
    ("cli",),
)
"""Packages from the ground up; each may import its own floor and those below."""

FLOOR_OF = {package: floor for floor, packages in enumerate(FLOORS) for package in packages}

MOST_LINES = 600
MOST_MODULES = 348
"""Fewer than 250 when the house was renovated; every format, tool and strategy since is one more."""

AT_LOAD, IN_FUNCTION, FOR_TYPES = "when loaded", "in a function", "for type checkers"

WHERE_ALLOWED = {
    "torch": r"trainer/",
    "moderngl": r"renderers/|viewer/",
    "glcontext": r"renderers/gl/|viewer/",
    "OpenGL": r"renderers/gl/|viewer/",
    "imgui_bundle": r"viewer/|renderers/precompile\.py",  # which opens a window's context, unseen
    "glfw": r"viewer/|renderers/precompile\.py",
    "tools": r"(?!)",
}
"""Package -> pattern of the only paths that may import it."""


@dataclass(frozen=True)
class Import:
    target: str
    """Dotted name: a module of ours ("scene.camera"), or a package of others ("numpy")."""
    ours: bool
    when: str
    line: int
    relative: bool = False


@cache
def modules() -> dict[str, Path]:
    """Dotted name within splatview -> file; a package's name is that of its `__init__`."""
    found = {}
    for package in FLOOR_OF:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def tree_of(name: str) -> ast.Module:
    return ast.parse(modules()[name].read_text(encoding="utf8"))


@cache
def imports_of(name: str) -> tuple[Import, ...]:
    return tuple(_imports(tree_of(name), AT_LOAD))


def _imports(node: ast.AST, when: str) -> list[Import]:
    found = []
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            found += [_one(alias.name, when, child.lineno) for alias in child.names]
        elif isinstance(child, ast.ImportFrom):
            base = child.module or ""
            if child.level:
                found.append(Import(base, ours=True, when=when, line=child.lineno, relative=True))
                continue
            for alias in child.names:
                whole = f"{base}.{alias.name}"
                is_module = whole.removeprefix("splatview.") in modules()
                found.append(_one(whole if is_module else base, when, child.lineno))
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            found += [
                one
                for body, state in ((child.body, FOR_TYPES), (child.orelse, when))
                for statement in body
                for one in _imports(ast.Module([statement], []), state)
            ]
        else:
            is_function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            found += _imports(child, IN_FUNCTION if is_function and when == AT_LOAD else when)
    return found


def _one(target: str, when: str, line: int) -> Import:
    ours = target == "splatview" or target.startswith("splatview.")
    return Import(target.removeprefix("splatview."), ours=ours, when=when, line=line)


def place(name: str, one: Import) -> str:
    return f"{modules()[name].relative_to(ROOT)}:{one.line} imports {one.target} ({one.when})"


def edges(name: str, states: set[str]) -> set[str]:
    """Modules that `name` imports, and the packages that those are in."""
    found = set()
    for one in imports_of(name):
        if one.ours and one.when in states:
            # A module's own packages are being loaded already: they count where they are named.
            packages = {one.target[: dot.start()] for dot in re.finditer(r"\.", one.target)}
            found |= {one.target} | {
                package for package in packages if not f"{name}.".startswith(f"{package}.")
            }
    return found & modules().keys()


@pytest.mark.parametrize(
    "states",
    [{AT_LOAD}, {AT_LOAD, IN_FUNCTION}, {AT_LOAD, IN_FUNCTION, FOR_TYPES}],
    ids=["when loaded", "late ones too", "types too"],
)
def test_no_import_circle(states: set[str]) -> None:
    graph = {name: edges(name, states) for name in modules()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail("circle: " + " <- ".join(error.args[1]))


def test_no_import_up_the_floors() -> None:
    wrong = [
        place(name, one)
        for name in modules()
        for one in imports_of(name)
        if one.ours and FLOOR_OF[one.target.split(".")[0]] > FLOOR_OF[name.split(".")[0]]
    ]
    assert not wrong, "\n".join(wrong)


def test_what_is_imported_where() -> None:
    wrong = [
        place(name, one)
        for name, path in modules().items()
        for one in imports_of(name)
        if not one.ours
        and (pattern := WHERE_ALLOWED.get(one.target.split(".")[0])) is not None
        and not re.match(pattern, str(path.relative_to(ROOT)))
    ]
    assert not wrong, "\n".join(wrong)


def test_imports_are_absolute() -> None:
    wrong = [place(name, one) for name in modules() for one in imports_of(name) if one.relative]
    assert not wrong, "\n".join(wrong)


def test_imports_name_modules_that_exist() -> None:
    """Late ones as well, which nothing else runs at once."""
    wrong = [
        place(name, one)
        for name in modules()
        for one in imports_of(name)
        if one.ours and not one.relative and one.target not in modules()
    ]
    assert not wrong, "\n".join(wrong)


def test_modules_are_neither_long_nor_many() -> None:
    lengths = {path: len(path.read_text(encoding="utf8").splitlines()) for path in modules().values()}
    long = [f"{path.relative_to(ROOT)}: {length}" for path, length in lengths.items() if length > MOST_LINES]
    assert not long, "\n".join(long)
    assert len(lengths) <= MOST_MODULES


def test_shaders_are_files() -> None:
    """No GLSL in Python: editors and the compiler of the shaders' tests know `.glsl` alone."""
    wrong = [
        f"{modules()[name].relative_to(ROOT)}:{node.lineno}"
        for name in modules()
        for node in ast.walk(tree_of(name))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and re.search(r"#version \d|\bgl_Position\b", node.value)
    ]
    assert not wrong, "\n".join(wrong)


def test_every_dependency_is_imported() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf8"))["project"]
    extras = project["optional-dependencies"]
    needed = {
        canonicalize_name(Requirement(line).name)
        for line in (*project["dependencies"], *extras["train"], *extras["plot"], *extras["film"])
    }
    used = {one.target.split(".")[0] for name in modules() for one in imports_of(name) if not one.ours}
    distributions = packages_distributions()
    imported = {canonicalize_name(name) for package in used for name in distributions.get(package, ())}
    assert needed <= imported, f"never imported: {sorted(needed - imported)}"
