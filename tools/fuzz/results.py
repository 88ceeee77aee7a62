"""The JSON file that both fuzzers add to, and the table in it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splatview.measure.machine import write_results

FAMILIES = {
    "scenes and points, .ply": ("ply", "ply_info", "capture_points_ply"),
    "cameras, JSON and COLMAP": ("cameras_json", "colmap_", "clipboard"),
    "packed scenes": ("scene_",),
    "captures, COLMAP and transforms": (
        *("capture_cameras", "capture_points_bin", "capture_points_txt", "capture_held_out"),
        *("capture_transforms", "capture_camera_list", "capture_poses_bounds"),
    ),
    "photos, masks and panoramas": ("capture_photo", "capture_mask", "panorama"),
    "recipes, replayed too, and journals": ("recipe", "journal"),
    "checkpoints": ("checkpoint",),
    "preferences and bookmarks": ("preferences", "bookmarks"),
}
"""Rows of the table -> what the names of their loaders begin with."""


def read(path: Path | None) -> dict[str, Any]:
    """What the file holds; nothing where there is none."""
    return json.loads(path.read_text()) if path is not None and path.is_file() else {}


def add_to(path: Path, entry: Mapping[str, Any]) -> None:
    """Puts the keys of `entry` in the place of those that the file has, and makes its table anew."""
    kept = {key: value for key, value in read(path).items() if key not in ("machine", "table")}
    kept |= entry
    write_results(path, {**kept, "table": table(kept)})


def table(results: Mapping[str, Any]) -> dict[str, Any]:
    """Rows of loaders, by family, and of projections."""
    rows: list[list[str]] = []
    loaders: Mapping[str, Mapping[str, int]] = results.get("loaders", {})
    for family, beginnings in FAMILIES.items():
        mine = [entry for name, entry in loaders.items() if name.startswith(beginnings)]
        if mine:
            keys = ("inputs", "loaded", "refused", "failed")
            rows.append([family, *(f"{sum(entry[key] for entry in mine):,}" for key in keys)])
    for name, counts in results.get("projections", {}).items():
        numbers = (counts["splats"], counts["must_show"], counts["must_cull"], sum(counts["wrong"].values()))
        rows.append([f"splats through `{name}`", *(f"{number:,}" for number in numbers)])
    most = max((entry["largest_growth"] for entry in loaders.values()), default=0)
    return {
        "columns": ["what was put in", "inputs", "loaded, or seen", "refused, or culled", "anything else"],
        "rows": rows,
        "note": note(most, results.get("found_and_fixed", 0)),
    }


def note(growth: int, fixed: int) -> str:
    """Below the table; `growth` in bytes."""
    found = f"{fixed} inputs failed when they were first tried; what made them is mended. " if fixed else ""
    return (
        "Damaged files end in a scene or in one line that says what is wrong; the process grew by "
        f"{growth / 2**20:.1f} MiB at most. {found}Splats have any bits in any attribute, and must be seen "
        "or culled as in float64, with the same footprint and colour; of those between, rounding decides, "
        "or they lie beside the picture."
    )
