"""Guards are taken out of a copy of the package one at a time: each time a hard case must turn red.

Some guards stand behind others: what is not finite in a splat's values makes its footprint so as well, and
either test would do. Those are taken out together.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("edit", "measure", "raster", "scene", "shaders", "trainer", "viewer")


@dataclass(frozen=True)
class Removal:
    """One guard less."""

    what: str
    file: str
    renderer: str
    case: str
    """One that turns red."""
    changes: dict[str, str]
    """Text as it stands in the file, once, to what stands in its place."""


PROJECTION, PROJECT = "shaders/common/projection.glsl", "shaders/quads/project.comp.glsl"

SHADERS = (
    Removal("near plane", PROJECTION, "quads", "at and behind the eye", {"!(t.z >= u_near) || ": ""}),
    Removal(
        "zero quaternions",
        PROJECTION,
        "quads",
        "quaternion below the least",
        {" || !(largest >= MIN_QUAT_COMPONENT)": ""},
    ),
    Removal(
        "opacity",
        PROJECTION,
        "quads",
        "NaN opacity logits",
        {"(!(opacity >= u_alpha_cut) || !(opacity > 0.0)) return false;": "(false) return false;"},
    ),
    Removal(
        "finite values and footprints",
        PROJECTION,
        "quads",
        "footprint beyond float32",
        {
            "!is_finite(offset) || !is_finite(t) || !is_finite(quat) || !is_finite(scale)": "false",
            "    if (!is_finite(m0) || !is_finite(m1)) return false;\n": "",
            "!is_finite(f.conic) || !is_finite(f.mean) || ": "",
            "!is_finite(vec2(xx, yy) * spread * spread)": "false",
        },
    ),
    Removal("largest quaternion first", PROJECTION, "quads", "tiny quaternion", {"quat / largest)": "quat)"}),
    Removal(
        "clamp", PROJECTION, "quads", "grazing splat", {"clamp(ray, u_ray_limits.xy, u_ray_limits.zw)": "ray"}
    ),
    Removal(
        "spread",
        PROJECTION,
        "quads",
        "largest footprint",
        {"max(max(max(entries.x, entries.y), entries.z), 1.0);": "1.0;"},
    ),
    Removal(
        "determinant as a sum",
        PROJECTION,
        "quads",
        "needle of 10⁴ px",
        {"float det_unblurred = dot(area, area);": "float det_unblurred = m00 * m11 - xy * xy;"},
    ),
    Removal(
        "direction by its largest component",
        PROJECTION,
        "quads",
        "star at 10²⁵",
        {"normalize(offset / max(max(abs(offset.x), abs(offset.y)), abs(offset.z)))": "normalize(offset)"},
    ),
    Removal("finite colours", PROJECT, "quads", "NaN SH", {"    if (!is_finite(colour)) return;\n": ""}),
    Removal("colours at least 0", PROJECT, "quads", "SH far below 0", {"max(colour, vec3(0.0))": "colour"}),
    Removal(
        "cap of alpha", "shaders/quads/draw.frag.glsl", "quads", "capped alpha", {"u_max_alpha);": "1.0);"}
    ),
    Removal(
        "relative positions",
        "viewer/gl/placement.py",
        "quads",
        "10⁷ m from the origin",
        {"centre = centre if far else np.zeros(3)": "centre = np.zeros(3)", "wide=wide)": "wide=False)"},
    ),
    Removal(
        "what float32 leaves over of positions",
        "viewer/gl/placement.py",
        "quads",
        "two towns 20 km apart",
        {"wide=wide)": "wide=False)"},
    ),
)

TRUTH = "scene/projection.py"

REFERENCE = (
    Removal(
        "near plane",
        TRUTH,
        "reference",
        "at and behind the eye",
        {"t[:, 2] >= model.near": "t[:, 2] > -np.inf"},
    ),
    Removal(
        "zero quaternions",
        TRUTH,
        "reference",
        "quaternion below the least",
        {"np.abs(quats).max(axis=1) >= MIN_QUAT_COMPONENT": "True"},
    ),
    Removal(
        "finite footprints",
        TRUTH,
        "reference",
        "footprint beyond float32",
        {" & _finite(real_covariances)": ""},
    ),
    Removal("finite SH", TRUTH, "reference", "infinite SH", {", used_sh):": "):"}),
    Removal(
        "finite colours", TRUTH, "reference", "SH sum beyond float32", {"    drawn &= _finite(colours)\n": ""}
    ),
    Removal(
        "largest quaternion first",
        TRUTH,
        "reference",
        "tiny quaternion",
        {"quats / np.abs(quats).max(axis=1, keepdims=True)": "quats"},
    ),
    Removal(
        "direction by its largest component",
        TRUTH,
        "reference",
        "star at 10²⁵",
        {"offsets / np.abs(offsets).max(axis=1, keepdims=True, initial=0)": "offsets * 1.0"},
    ),
    Removal(
        "clamp",
        TRUTH,
        "quads",
        "grazing splat",
        {"np.clip(x / z, u_min, u_max), np.clip(y / z, v_min, v_max)": "x / z, y / z"},
    ),
    Removal(
        "order of ties",
        TRUTH,
        "quads",
        "depth tie",
        {'np.argsort(t[indices, 2], kind="stable")': 'np.argsort(t[indices, 2], kind="stable")[::-1]'},
    ),
    Removal(
        "cap of alpha", "scene/reference.py", "quads", "capped alpha", {"settings.model.max_alpha, ": "1, "}
    ),
)

RASTER = "raster/project.py"

CPU = (
    Removal(
        "near plane",
        RASTER,
        "cpu",
        "at and behind the eye",
        {"keep_if_at_least(one, tz, fill(tz, view.near))": "one"},
    ),
    Removal(
        "zero quaternions",
        RASTER,
        "cpu",
        "quaternion below the least",
        {"keep_if_at_least(drawn, largest, fill(largest, MIN_QUAT_COMPONENT))": "drawn"},
    ),
    Removal(
        "finite colours",
        RASTER,
        "cpu",
        "NaN SH",
        {
            "if not (abs(red) < np.inf and abs(green) < np.inf and abs(blue) < np.inf):": "if False:",
            "if not (is_finite(red) and is_finite(green) and is_finite(blue)):": "if False:",
        },
    ),
    Removal(
        "clamp",
        "raster/optics.py",
        "cpu",
        "grazing splat",
        {"min(max(x_by_z, view.min_u), view.max_u)": "x_by_z"},
    ),
    Removal(
        "colours at least 0",
        RASTER,
        "cpu",
        "SH far below 0",
        {"max(red, 0.0), max(green, 0.0), max(blue, 0.0)": "red, green, blue"},
    ),
)

DISC = "shaders/common/disc.glsl"

DISCS = (
    Removal(
        "least slope",
        DISC,
        "quads",
        "disc edge-on along a column",
        {"slope >= DISC_LEAST_SLOPE": "slope >= -1.0"},
    ),
    Removal("near plane of discs", DISC, "quads", "disc through the near plane", {" && lean <= plane.w": ""}),
    Removal(
        "least width",
        "shaders/common/disc_projection.glsl",
        "quads",
        "needle of a disc",
        {"    s = max(s, DISC_LEAST_WIDTH * away / u_focal.x);\n": ""},
    ),
    Removal(
        "widest ellipse",
        "shaders/common/disc_projection.glsl",
        "quads",
        "largest disc",
        {" || !(max(entries.x, entries.y) <= WIDEST)": "", "!is_finite(m0) || !is_finite(m1)": "false"},
    ),
    Removal(
        "near plane of discs",
        "raster/discs.py",
        "cpu",
        "disc through the near plane",
        {"    slope = keep_if_at_least(slope, most_lean, lean)\n": ""},
    ),
    Removal(
        "least slope",
        "raster/discs.py",
        "cpu",
        "disc edge-on along a column",
        {"slope = keep_if_at_least(slope, slope, fill(slope, DISC_LEAST_SLOPE))": "pass"},
    ),
)

FOLDED = "a lens that folds back"

RAYS = (
    Removal(
        "reach of the lens",
        PROJECTION,
        "quads",
        FOLDED,
        {"        if (!(dot(ray, ray) < u_lens_reach)) return false;\n": ""},
    ),
    Removal(
        "reach of the lens",
        TRUTH,
        "reference",
        FOLDED,
        {"(axis=1) < camera.lens.form.valid_radius_squared": "(axis=1) < np.inf"},
    ),
    Removal(
        "reach of the lens",
        "raster/optics.py",
        "cpu",
        FOLDED,
        {"keep_if_below(drawn, tx * tx + ty * ty, tz * tz * lens.valid_radius_squared)": "drawn"},
    ),
)

EVERYTHING = (*SHADERS, *REFERENCE, *CPU, *DISCS, *RAYS)

RUN = """
import sys
import splatview.scene
from splatview.cli.main import main
assert splatview.scene.__file__.startswith(sys.argv[1]), splatview.scene.__file__
sys.exit(main(["stability", "--json", *sys.argv[2:]]))
"""


def package_without(removal: Removal, folder: Path) -> None:
    """A copy of the package in `folder`, less the guard."""
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, folder / "splatview" / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    path = folder / "splatview" / removal.file
    text = path.read_text(encoding="utf8")
    for guard, without in removal.changes.items():
        assert text.count(guard) == 1, f"{removal.file} has {text.count(guard)} times: {guard}"
        text = text.replace(guard, without)
    path.write_text(text, encoding="utf8")


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
@pytest.mark.parametrize("removal", EVERYTHING, ids=lambda removal: f"{removal.what} in {removal.file}")
def test_without_a_guard_a_case_turns_red(removal: Removal, tmp_path: Path) -> None:
    package_without(removal, tmp_path)
    code, rows = stability(tmp_path, removal.renderer, removal.case)
    assert code == 1
    assert any(row["failures"] for row in rows)


def test_guards_are_where_this_file_says(tmp_path: Path) -> None:
    """Quick: so that a guard that is written anew is noticed at once, and its case is a case."""
    from splatview.measure.hard_cases import find_case

    for removal in EVERYTHING:
        text = (ROOT / removal.file).read_text(encoding="utf8")
        assert all(text.count(guard) == 1 for guard in removal.changes), removal
        find_case(removal.case)


def test_with_all_guards_the_copy_is_green(tmp_path: Path) -> None:
    package_without(Removal("nothing", PROJECTION, "", "", {}), tmp_path)
    assert stability(tmp_path, "reference", "NaN means")[0] == 0
