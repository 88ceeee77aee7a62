"""Guards are taken out of a copy of the package one at a time: each time a hard case must turn red.

A guard is marked in its source by a comment at the end of its line, or on the line before:

    if (!(t.z >= u_near)) return false;  // guard: near plane
    centre = centre if far else np.zeros(3)  # guard: relative positions := centre = np.zeros(3)

Without the guard the line is gone or, after `:=`, another stands in its place. Some guards stand behind
others: what is not finite in a splat's values makes its footprint so as well, and either test would do. Those
have one name in their file and are taken out together.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from splatview.measure.hard_cases import find_case

ROOT = Path(__file__).parents[2]
PACKAGES = ("cli", "edit", "measure", "raster", "renderers", "scene", "shaders", "trainer", "viewer")

MARKER = re.compile(r"(?P<guard>.*?) *(?://|#) guard: (?P<name>[^:]+?)(?: := (?P<without>.*))?")
"""A line of source with a marker."""

PROJECTION, TRUTH, RASTER = "shaders/common/projection.glsl", "scene/projection.py", "raster/project.py"
PROJECT, FRAGMENT = "shaders/quads/project.comp.glsl", "shaders/quads/draw.frag.glsl"
SURFEL, SURFELS = "shaders/common/surfel.glsl", "shaders/common/surfel_projection.glsl"
BUFFERS, OPTICS = "renderers/gl/scene_buffers.py", "raster/camera_models.py"

FOLDED = "a lens that folds back"

CASES = {
    (PROJECTION, "near plane"): ("quads", "at and behind the eye"),
    (PROJECTION, "zero quaternions"): ("quads", "quaternion below the least"),
    (PROJECTION, "opacity"): ("quads", "NaN opacity logits"),
    (PROJECTION, "finite footprints"): ("quads", "footprint beyond float32"),
    (PROJECTION, "largest component first"): ("quads", "tiny quaternion"),
    (PROJECTION, "slope clamp"): ("quads", "grazing splat"),
    (PROJECTION, "spread"): ("quads", "largest footprint"),
    (PROJECTION, "huge extents"): ("quads", "largest footprint, from beside"),
    (PROJECTION, "determinant as a sum"): ("quads", "needle of 10⁴ px"),
    (PROJECTION, "largest offset first"): ("quads", "star at 10²⁵"),
    (PROJECTION, "fold of the lens"): ("quads", FOLDED),
    (PROJECT, "finite colours"): ("quads", "NaN SH"),
    (PROJECT, "colours at least 0"): ("quads", "SH far below 0"),
    (FRAGMENT, "cap of alpha"): ("quads", "capped alpha"),
    (SURFEL, "least slope"): ("quads", "disc edge-on along a column"),
    (SURFEL, "near plane"): ("quads", "disc through the near plane"),
    (SURFELS, "least width"): ("quads", "needle of a disc"),
    (SURFELS, "widest ellipse"): ("quads", "largest disc"),
    (BUFFERS, "relative positions"): ("quads", "10⁷ m from the origin"),
    (BUFFERS, "digits beyond float32"): ("quads", "two towns 20 km apart"),
    (TRUTH, "near plane"): ("reference", "at and behind the eye"),
    (TRUTH, "zero quaternions"): ("reference", "quaternion below the least"),
    (TRUTH, "finite footprints"): ("reference", "footprint beyond float32"),
    (TRUTH, "finite SH"): ("reference", "infinite SH"),
    (TRUTH, "finite colours"): ("reference", "SH sum beyond float32"),
    (TRUTH, "largest component first"): ("reference", "tiny quaternion"),
    (TRUTH, "largest offset first"): ("reference", "star at 10²⁵"),
    (TRUTH, "fold of the lens"): ("reference", FOLDED),
    (TRUTH, "slope clamp"): ("quads", "grazing splat"),
    (TRUTH, "order of ties"): ("quads", "depth tie"),
    ("scene/reference.py", "cap of alpha"): ("quads", "capped alpha"),
    (RASTER, "near plane"): ("cpu", "at and behind the eye"),
    (RASTER, "zero quaternions"): ("cpu", "quaternion below the least"),
    (RASTER, "finite colours"): ("cpu", "NaN SH"),
    (RASTER, "colours at least 0"): ("cpu", "SH far below 0"),
    (OPTICS, "slope clamp"): ("cpu", "grazing splat"),
    (OPTICS, "fold of the lens"): ("cpu", FOLDED),
    ("raster/surfels.py", "near plane"): ("cpu", "disc through the near plane"),
    ("raster/surfels.py", "least slope"): ("cpu", "disc edge-on along a column"),
}
"""File and name of each guard -> renderer and hard case that turns red without it."""

ALSO = {(BUFFERS, "relative positions"): "digits beyond float32"}
"""A guard of the same file that would do instead and is taken out with it."""

RUN = """
import sys
import splatview.scene
from splatview.cli.main import main
assert splatview.scene.__file__.startswith(sys.argv[1]), splatview.scene.__file__
sys.exit(main(["stability", "--json", *sys.argv[2:]]))
"""


def guards_in(text: str) -> list[tuple[str, int, str]]:
    """Name, line (from 0) and what is to stand in the line's place without the guard ("": nothing)."""
    found = []
    for number, line in enumerate(text.splitlines()):
        if marked := MARKER.fullmatch(line):
            alone = not marked["guard"].strip()
            found.append((marked["name"], number + alone, marked["without"] or ""))
    return found


def without(text: str, name: str) -> str:
    """The source less the guards of that name."""
    lines = text.splitlines()
    places = [(number, other) for marked, number, other in guards_in(text) if marked == name]
    assert places, f'no comment "guard: {name}"'
    for number, other in places:
        line = lines[number]
        marked = MARKER.fullmatch(line)
        guard = (marked["guard"] if marked else line).strip()
        assert guard and guard != other, f"line {number + 1} is its own replacement"
        lines[number] = line[: len(line) - len(line.lstrip())] + other
    return "\n".join(lines) + "\n"


def copied_package(folder: Path) -> Path:
    """The package in `folder`, less compiled files."""
    package = folder / "splatview"
    for name in PACKAGES:
        shutil.copytree(ROOT / name, package / name, ignore=shutil.ignore_patterns("__pycache__"))
    return package


def stability(folder: Path, renderer: str, case: str) -> tuple[int, list[dict]]:
    """Exit code and rows of the command in the copy."""
    process = subprocess.run(
        check=False,
        args=[sys.executable, "-c", RUN, str(folder), "--renderer", renderer, "--case", case],
        env={**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")},
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert process.returncode in (0, 1), process.stderr
    return process.returncode, json.loads(process.stdout)["cases"]


@pytest.mark.slow
@pytest.mark.parametrize(("file", "name"), CASES)
def test_without_a_guard_a_case_turns_red(file: str, name: str, tmp_path: Path) -> None:
    path = copied_package(tmp_path) / file
    text = without(path.read_text(encoding="utf8"), name)
    if (file, name) in ALSO:
        text = without(text, ALSO[file, name])
    path.write_text(text, encoding="utf8")
    code, rows = stability(tmp_path, *CASES[file, name])
    assert code == 1
    assert any(row["failures"] for row in rows)


def test_every_guard_has_a_case_and_every_case_a_guard() -> None:
    sources = [
        path for name in PACKAGES for path in (ROOT / name).rglob("*") if path.suffix in (".py", ".glsl")
    ]
    texts = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf8") for path in sources}
    found = {(file, name) for file, text in texts.items() for name, _, _ in guards_in(text)}
    assert found == set(CASES)
    for _, case in CASES.values():
        find_case(case)
    for file, name in CASES:
        if file.endswith(".py"):
            compile(without(texts[file], name), file, "exec")


def test_with_all_guards_the_copy_is_green(tmp_path: Path) -> None:
    copied_package(tmp_path)
    assert stability(tmp_path, "reference", "NaN means")[0] == 0


def test_a_line_is_removed_or_replaced() -> None:
    text = "a = 1  # guard: one\n    # guard: two := b = 0\n    b = max(c, 0)\nd = 2  # guard: two := d = 3\n"
    assert without(text, "one") == "\n" + text.partition("\n")[2]
    assert without(text, "two").splitlines()[2:] == ["    b = 0", "d = 3"]
    with pytest.raises(AssertionError, match="three"):
        without(text, "three")
    with pytest.raises(AssertionError, match="its own replacement"):
        without("a = 1  # guard: one := a = 1\n", "one")
