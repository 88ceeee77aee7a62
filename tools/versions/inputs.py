"""Input files that the script makes itself: scenes, cameras, recipes, pictures and damaged files.

All values come from seeded generators, so two recordings read the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

Columns = dict[str, np.ndarray]
"""Property name -> (N,) values, in the order of the file."""

TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
"""numpy dtype -> type in a .ply header."""


def make_inputs(folder: Path, captures: Path | None) -> None:
    """Writes all input files into `folder`; `captures`: shared data of which one capture is made."""
    make_scenes(folder)
    make_damaged_scenes(folder)
    make_cameras(folder)
    make_recipes(folder)
    make_captures(folder)
    if captures is not None:
        make_lensed_capture(folder / "lensed", captures / "banana")
    rng = np.random.default_rng(5)
    Image.fromarray(rng.integers(0, 256, (24, 48, 3), np.uint8)).save(folder / "panorama.png")


def splats(count: int, degree: int, seed: int) -> Columns:
    """Splats of many shapes in a ball of radius 1, in the usual layout; SH up to `degree`."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    means = direction * rng.uniform(size=(count, 1)) ** (1 / 3)
    columns = {axis: means[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"n{axis}": np.zeros(count) for axis in "xyz"}
    columns |= {f"f_dc_{i}": rng.normal(size=count) for i in range(3)}
    rest = 3 * ((degree + 1) ** 2 - 1)
    columns |= {f"f_rest_{i}": rng.normal(scale=0.15, size=count) for i in range(rest)}
    columns["opacity"] = rng.normal(0.5, 2.0, size=count)
    columns |= {f"scale_{i}": rng.normal(-2.8, 0.8, size=count) for i in range(3)}
    columns |= {f"rot_{i}": rng.normal(size=count) for i in range(4)}
    return {name: values.astype("<f4") for name, values in columns.items()}


def write_ply(
    path: Path, columns: Mapping[str, np.ndarray], *, layout: str = "binary_little_endian", comments=()
) -> None:
    count = len(next(iter(columns.values())))
    lines = ["ply", f"format {layout} 1.0", *(f"comment {text}" for text in comments)]
    lines += [f"element vertex {count}"]
    lines += [f"property {TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    header = "\n".join([*lines, "end_header\n"]).encode()
    if layout == "ascii":
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        path.write_bytes(header + "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode())
        return
    order = ">" if layout == "binary_big_endian" else "<"
    table = np.empty(count, [(name, order + values.dtype.str[1:]) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    path.write_bytes(header + table.tobytes())


SCENES = (
    "random",
    "sh0",
    "sh1",
    "sh2",
    "zero-bands",
    "hard",
    "discs",
    "two-scales",
    "mip",
    "far",
    "ascii",
    "big-endian",
    "doubles",
    "extras",
    "shuffled",
    "points",
    "points-grey",
    "groups",
    "one",
)
"""Names of the scenes that `make_scenes` writes and that can be drawn."""


def make_scenes(folder: Path) -> None:
    write_ply(folder / "random.ply", splats(1500, 3, 1))
    for degree in (0, 1, 2):
        write_ply(folder / f"sh{degree}.ply", splats(300, degree, 10 + degree))
    padded = splats(300, 3, 20)
    padded |= {name: values * 0 for name, values in padded.items() if name.startswith("f_rest_")}
    write_ply(folder / "zero-bands.ply", padded)
    write_ply(folder / "hard.ply", hard_splats())
    flat = splats(300, 1, 21)
    flat["scale_2"] = np.minimum(flat["scale_0"], flat["scale_1"]) - np.float32(7)
    write_ply(folder / "discs.ply", flat, comments=["SplatRenderMode: 2dgs"])
    write_ply(folder / "two-scales.ply", {name: v for name, v in flat.items() if name != "scale_2"})
    write_ply(folder / "mip.ply", splats(300, 1, 22), comments=["SplatRenderMode: mip", "made for a test"])
    far = {name: values.astype("<f8") if name in "xyz" else values for name, values in flat.items()}
    far["x"], far["z"] = far["x"] + 3e6, far["z"] - 7e6
    write_ply(folder / "far.ply", far)
    few = splats(200, 1, 23)
    write_ply(folder / "ascii.ply", few, layout="ascii", comments=["by hand"])
    write_ply(folder / "big-endian.ply", few, layout="binary_big_endian")
    write_ply(folder / "doubles.ply", {name: values.astype("<f8") for name, values in few.items()})
    rng = np.random.default_rng(24)
    extras = {"label": rng.integers(0, 256, 200).astype("u1"), "weight": rng.normal(size=200)}
    normals = {f"n{axis}": rng.normal(size=200).astype("<f4") for axis in "xyz"}
    write_ply(folder / "extras.ply", few | normals | extras)
    write_ply(folder / "shuffled.ply", {name: few[name] for name in sorted(few)})
    cloud = {axis: rng.normal(size=200).astype("<f4") for axis in "xyz"}
    colours = {name: rng.integers(0, 256, 200).astype("u1") for name in ("red", "green", "blue")}
    write_ply(folder / "points.ply", cloud | colours)
    write_ply(folder / "points-grey.ply", cloud)
    write_ply(folder / "groups.ply", grouped_splats())
    write_ply(folder / "one.ply", {name: values[:1] for name, values in few.items()})
    write_ply(folder / "more.ply", splats(40, 2, 25))


def hard_splats() -> Columns:
    """400 splats; some have values that the health report finds."""
    columns = splats(400, 1, 30)
    nan, inf = np.nan, np.inf
    for row, changes in enumerate(
        [
            {"x": nan},
            {"y": inf},
            {"rot_0": nan},
            {"rot_0": 0, "rot_1": 0, "rot_2": 0, "rot_3": 0},
            {"scale_0": nan},
            {"scale_1": inf},
            {"scale_0": 30},
            {"scale_0": -30, "scale_1": -30, "scale_2": -30},
            {"scale_0": -1, "scale_1": -9, "scale_2": -9},
            {"scale_0": 1, "scale_1": -12, "scale_2": -12.5},
            {"scale_0": 2, "scale_1": 2, "scale_2": 2, "opacity": -3},
            {"opacity": inf},
            {"opacity": -inf},
            {"opacity": nan},
            {"opacity": 100},
            {"opacity": -100},
            {"f_dc_0": nan},
            {"f_rest_3": inf},
            {"f_dc_1": 60},
            {"f_dc_2": -60, "f_rest_0": 40},
            {"x": 0, "y": 0, "z": -3.2},
            {"x": 0, "y": 0, "z": -3.19},
            {"x": 1e7, "y": -1e7},
            {"rot_0": 1e-20, "rot_1": 1e-20, "rot_2": 0, "rot_3": 0},
            {"rot_0": 1e20, "rot_1": 1e20, "rot_2": 0, "rot_3": 0},
        ]
    ):
        for name, value in changes.items():
            columns[name][row] = value
    for values in columns.values():
        values[100:110] = values[90:100]
    return columns


def grouped_splats() -> Columns:
    """A dense ball of 800 splats, with 12 floaters and 3 small groups far outside of it."""
    columns = splats(830, 1, 26)
    rng = np.random.default_rng(27)
    for axis in "xyz":
        columns[axis][:800] *= np.float32(0.5)
        columns[axis][800:812] *= np.float32(3)
        columns[axis][812:] = np.repeat(rng.uniform(2, 4, 3), 6) + rng.normal(0, 0.02, 18)
    for i in range(3):
        columns[f"scale_{i}"] -= np.float32(0.7)
    return columns


HEADER = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n"


def make_damaged_scenes(folder: Path) -> None:
    """Files that are refused, each for another reason."""
    whole = (folder / "sh0.ply").read_bytes()
    few = splats(5, 0, 40)
    without = {name: values for name, values in few.items() if name != "opacity"}
    write_ply(folder / "no-opacity.ply", without)
    write_ply(folder / "odd-bands.ply", few | {"f_rest_0": few["x"]})
    write_ply(folder / "whole-numbers.ply", few | {"opacity": few["opacity"].astype("<i4")})
    mesh = (
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    contents = {
        "empty.ply": b"",
        "text.ply": b"hello world\n",
        "cut.ply": whole[: len(whole) - 100],
        "cut-header.ply": whole[:90],
        "promises.ply": whole.replace(b"vertex 300", b"vertex 300000000000", 1),
        "negative.ply": whole.replace(b"vertex 300", b"vertex -1", 1),
        "no-number.ply": whole.replace(b"vertex 300", b"vertex many", 1),
        "wrong-type.ply": whole.replace(b"float x", b"string x", 1),
        "twice.ply": whole.replace(b"float y", b"float x", 1),
        "no-format.ply": whole.replace(b"format binary_little_endian 1.0\n", b"", 1),
        "other-format.ply": whole.replace(b"binary_little_endian", b"binary_middle_endian", 1),
        "no-vertex.ply": whole.replace(b"element vertex", b"element corner", 1),
        "mesh.ply": mesh,
        "compressed.ply": HEADER % 1 + b"property uint packed_position\nend_header\n\0\0\0\0",
        "ascii-cut.ply": (folder / "ascii.ply").read_bytes()[:-200],
        "ascii-word.ply": (folder / "ascii.ply").read_bytes()[:-20] + b"word\n",
        "scene.spz": b"\x1f\x8b\x08\x00 something",
        "scene.sog": b"PK\x03\x04 something",
        "scene.splat": bytes(32),
        "scene.ksplat": bytes(64),
        "picture.ply": b"\x89PNG\r\n\x1a\n something",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    write_ply(folder / "no-splats.ply", {name: values[:0] for name, values in few.items()})


def camera(eye: Sequence[float], target: Sequence[float], **changes: Any) -> dict[str, Any]:
    """A camera as camera files have it: looks from `eye` at `target`, y down; `changes` to its keys."""
    position, forward = np.array(eye, float), np.subtract(target, eye).astype(float)
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ position
    values = {"width": 75, "height": 53, "fx": 60.0, "fy": 60.0, "cx": 37.5, "cy": 26.5}
    return values | {"world_to_camera": matrix.tolist()} | changes


FRONT = camera([0, 0, -3.2], [0, 0, 0])

LENS = {"model": "OPENCV", "parameters": [-0.1, 0.02, 0.003, -0.002]}

CAMERAS = (
    FRONT | {"name": "front"},
    camera([2, -1.5, -2], [0, 0.1, 0], cx=20.0, cy=40.0, name="off-centre"),
    camera([0.2, 0.1, -0.1], [1, 0.3, 0.5], fx=18.0, fy=24.0, name="inside, wide"),
    camera([-3, 0.5, 1], [0, 0, 0], name="lens", lens=LENS),
    camera([1, -2, -2], [0, 0, 0], fx=22.0, fy=22.0, name="parallel", orthographic=True),
)


def make_cameras(folder: Path) -> None:
    write_json(folder / "cameras.json", CAMERAS)
    matrix = np.array(FRONT["world_to_camera"])
    trained = {"id": 0, "img_name": "photo", "width": 75, "height": 53, "fx": 60.0, "fy": 60.0}
    trained |= {"rotation": matrix[:3, :3].T.tolist(), "position": [0, 0, -3.2]}
    write_json(folder / "trained-cameras.json", [trained])
    write_json(folder / "one-camera.json", FRONT)
    write_json(folder / "no-camera.json", [])
    write_json(folder / "wrong-camera.json", [{"width": 3}])
    write_json(folder / "wrong-lens.json", [FRONT | {"lens": {"model": "MIRROR", "parameters": []}}])
    (folder / "no-json.json").write_text("{")


def write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1))


def make_captures(folder: Path) -> None:
    """Folders that are no capture, or a damaged one."""
    (folder / "empty-capture").mkdir()
    for name, text in {
        "no-frames": '{"frames": []}',
        "no-json": '{"frames": [{',
        "no-photos": json.dumps({"fl_x": 9, "w": 9, "h": 9, "frames": [{"file_path": "a.png"}]}),
    }.items():
        (folder / name).mkdir()
        (folder / name / "transforms.json").write_text(text)
    colmap = folder / "damaged-colmap" / "sparse" / "0"
    colmap.mkdir(parents=True)
    (colmap / "cameras.txt").write_text("1 SPHERE 9 9 9\n")
    (colmap / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    (colmap / "points3D.txt").write_text("")


def make_lensed_capture(folder: Path, capture: Path) -> None:
    """`capture` as if its photos had been taken through a lens; nothing where it is absent."""
    if not (capture / "transforms.json").exists():
        return
    folder.mkdir()
    (folder / "images").symlink_to((capture / "images").resolve())
    values = json.loads((capture / "transforms.json").read_text())
    lens = {"camera_model": "OPENCV", "k1": -0.08, "k2": 0.02, "p1": 0.001, "p2": -0.001}
    write_json(folder / "transforms.json", values | lens)


VIEW = {"camera": FRONT}

SELECTORS: tuple[dict[str, Any], ...] = (
    {"kind": "rectangle", **VIEW, "x0": 10, "y0": 5, "x1": 40, "y1": 40},
    {"kind": "rectangle", **VIEW, "depth": "front", "x0": 30, "y0": 45, "x1": 60, "y1": 5},
    {"kind": "polygon", **VIEW, "points": [[5, 5], [70, 10], [30, 50]]},
    {"kind": "polygon", **VIEW, "depth": "front", "points": [[5, 5], [70, 40], [70, 5], [5, 40]]},
    {"kind": "lasso", **VIEW, "points": [[20, 20], [50, 22], [48, 44], [22, 40]]},
    {"kind": "lasso", **VIEW, "depth": "front", "points": [[20, 20], [50, 22], [48, 44], [22, 40]]},
    {"kind": "brush", **VIEW, "points": [[10, 10], [40, 30]], "radius": 6},
    {"kind": "brush", **VIEW, "depth": "front", "points": [[60, 10]], "radius": 8},
    {"kind": "sphere", "centre": [0.3, 0, 0], "radius": 0.5},
    {
        "kind": "box",
        "centre": [0, 0.2, 0],
        "half_extents": [0.6, 0.3, 0.5],
        "rotation": [0.8, 0.6, 0.0, 0.0],
    },
    {"kind": "flood", "seed": 7, "tolerance": 0.4},
    {"kind": "flood", "seed": 9, "tolerance": 1, "reach": 0.12, "limit": 0.6},
    {"kind": "colour", "rgb": [0.8, 0.3, 0.2], "tolerance": 0.2},
    {"kind": "health", "finding": "needles"},
    {"kind": "runs", "runs": [[3, 40], [30, 50]]},
    {"kind": "all"},
)

RANGES = {
    "x": (-0.2, 0.3),
    "y": (None, 0.0),
    "z": (0.1, None),
    "distance": (0.2, 0.6),
    "largest scale": (0.05, 0.2),
    "smallest scale": (0.001, 0.03),
    "volume": (None, 1e-4),
    "anisotropy": (3, 10),
    "elongation": (1, 2),
    "opacity": (0.3, 0.7),
    "red": (0.2, 0.8),
    "green": (0.2, 0.8),
    "blue": (0.2, 0.8),
    "luminance": (0.3, 0.6),
    "hue": (60, 200),
    "saturation": (0.2, 0.7),
    "sh energy": (0.2, 0.9),
    "contribution": (0.5, None),
}
"""Attribute -> low and high."""

DETECTORS: tuple[tuple[dict[str, Any], float], ...] = (
    ({"kind": "sparse", "neighbours": 6}, 2.5),
    ({"kind": "clusters"}, 20),
    ({"kind": "needles"}, 9),
    ({"kind": "needles", "discs": True}, 25),
    ({"kind": "giants"}, 6),
    ({"kind": "giants", "against": "scene"}, 30),
    ({"kind": "faint"}, 20),
    ({"kind": "unseen"}, 3),
    ({"kind": "broken"}, 0.5),
    ({"kind": "duplicates"}, 0.5),
)
"""Detector and threshold of `prune`."""

REPAIRS = (
    "quaternion lengths",
    "non-finite quaternions",
    "zero quaternions",
    "non-finite scales",
    "extreme scales",
    "opacity at its limit",
    "rods",
    "needles",
    "non-finite SH",
    "SH out of range",
    "non-finite means",
    "NaN opacities",
    "invisible",
    "giants",
    "duplicates",
)

BOX = {"name": "table", "half_extents": [0.8, 0.9, 0.7], "rotation": [0.8, 0.0, 0.6, 0.0]}
BALL = {"shape": "sphere", "centre": [0.2, 0, 0], "half_extents": [0.3, 0.4, 0.5], "keep": "outside"}
GRADE = {"brightness": 0.1, "contrast": 1.2, "saturation": 0.6, "temperature": 0.3, "tint": -0.2}


def sphere(x: float, radius: float = 0.4) -> dict[str, Any]:
    return {"op": "select", "by": {"kind": "sphere", "centre": [x, 0, 0], "radius": radius}}


ALL_OPERATIONS: tuple[dict[str, Any], ...] = (
    sphere(0.5),
    {"op": "grow", "distance": 0.1},
    {"op": "grow", "neighbours": 3},
    {"op": "shrink", "neighbours": 4},
    {"op": "shrink", "distance": 0.02},
    {"op": "hide"},
    sphere(-0.5),
    {"op": "lock"},
    {"op": "select_all"},
    {"op": "size", "value": 1.1},
    {"op": "show"},
    {"op": "unlock"},
    {"op": "select_none"},
    {"op": "select_inverse"},
    {"op": "opacity", "value": 0.95},
    sphere(0.0, 0.9),
    {"op": "isolate"},
    {"op": "size", "value": 0.05, "how": "set"},
    {"op": "show"},
    sphere(0.3, 0.2),
    {"op": "opacity", "value": 0.5, "how": "set"},
    {"op": "grade", "grade": GRADE, "scope": "selection"},
    {"op": "grade", "grade": {"black": 0.05, "white": 0.9}},
    {"op": "transform", "rotation": [0.9, 0.1, 0.2, 0.3], "scale": 1.3, "pivot": [0.3, 0, 0]},
    {"op": "duplicate"},
    {"op": "transform", "translation": [0.1, 0.2, 0.3]},
    {"op": "split", "path": "part.ply"},
    {"op": "merge", "path": "more.ply"},
    {"op": "transform", "scope": "scene", "rotation": [1, 0.5, 0, 0], "translation": [0, 1, 0]},
    {"op": "orient", "up": [0, 0.3, 1]},
    {"op": "ground", "points": [[0, 0, 0], [1, 0.1, 0], [0.2, 0, 1]]},
    {"op": "transform", "scope": "scene", "translation": [0, 0.5, 0.2]},
    sphere(0.0, 0.8),
    {"op": "delete"},
    {"op": "select_detected", "by": {"kind": "faint"}, "threshold": 30},
    {"op": "prune", "by": {"kind": "faint"}, "threshold": 30},
    {"op": "repair", "finding": "needles"},
    {"op": "add_crop", "crop": BALL},
    {"op": "change_crop", "index": 0, "crop": BALL | {"keep": "inside", "half_extents": [2, 2, 2]}},
    {"op": "add_crop", "crop": BOX},
    {"op": "enable_crop", "index": 1, "enabled": False},
    {"op": "delete_cropped"},
    {"op": "add_crop", "crop": BOX | {"centre": [5, 5, 5]}},
    {"op": "remove_crop", "index": 1},
    {"op": "decimate", "keep": 700},
    {"op": "add_crop", "crop": BALL | {"centre": [0, 0.4, 0]}},
)
"""Each operation of recipes at least once; the last crop is applied by the export."""

RECIPES = {
    "all-operations": ("random", ALL_OPERATIONS),
    "selectors": (
        "random",
        (
            *(
                step
                for i, by in enumerate(SELECTORS)
                for step in (
                    {"op": "select", "by": by},
                    {"op": "size", "value": 1 + (i + 1) / 1000},
                )
            ),
            *(
                {"op": "select", "by": SELECTORS[i], "mode": mode}
                for i, mode in ((0, "set"), (8, "add"), (9, "remove"), (13, "add"), (2, "intersect"))
            ),
            {"op": "opacity", "value": 0.9},
        ),
    ),
    "ranges": (
        "random",
        tuple(
            step
            for i, (attribute, (low, high)) in enumerate(RANGES.items())
            for step in (
                {"op": "select", "by": {"kind": "range", "attribute": attribute, "low": low, "high": high}},
                {"op": "opacity", "value": 1 - (i + 1) / 1000},
            )
        ),
    ),
    "detectors": ("groups", tuple({"op": "prune", "by": b, "threshold": t} for b, t in DETECTORS)),
    "detectors-hard": ("hard", tuple({"op": "prune", "by": b, "threshold": t} for b, t in DETECTORS[::-1])),
    "repairs": ("hard", tuple({"op": "repair", "finding": finding} for finding in REPAIRS)),
    "nothing": ("extras", ()),
}
"""Name -> the scene that it is applied to, and its steps."""

WRONG_STEPS: dict[str, Any] = {
    "unknown-op": [{"op": "explode"}],
    "no-op": [{}],
    "no-object": [[]],
    "scale": [{"op": "delete"}, {"op": "transform", "scale": 0}],
    "rotation": [{"op": "transform", "rotation": [0, 0, 0, 0]}],
    "unknown-key": [{"op": "transform", "speed": 1}],
    "selector": [{"op": "select", "by": {"kind": "cone"}}],
    "radius": [{"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": -1}}],
    "selector-key": [{"op": "select", "by": {"kind": "sphere", "radius": 1}}],
    "attribute": [{"op": "select", "by": {"kind": "range", "attribute": "charm"}}],
    "detector": [{"op": "prune", "by": {"kind": "ghosts"}, "threshold": 1}],
    "crop": [{"op": "remove_crop", "index": 1}],
    "crop-shape": [{"op": "add_crop", "crop": {"shape": "cone"}}],
    "finding": [{"op": "repair", "finding": "ennui"}],
    "merge": [{"op": "merge", "path": "nowhere.ply"}],
    "grade": [{"op": "grade", "grade": {"contrast": -1}}],
    "ground": [{"op": "ground", "points": [[0, 0, 0], [1, 1, 1], [2, 2, 2]]}],
    "keep": [{"op": "decimate", "keep": 0}],
    "all-deleted": [{"op": "select_all"}, {"op": "delete"}],
    "runs": [{"op": "select", "by": {"kind": "runs", "runs": [[300, 1]]}}],
}
"""Recipes that cannot be applied to the scene "sh0"."""


def make_recipes(folder: Path) -> None:
    for name, (_, steps) in RECIPES.items():
        write_json(folder / f"{name}.json", {"splatview_recipe": 1, "steps": steps})
    for name, steps in WRONG_STEPS.items():
        write_json(folder / f"wrong-{name}.json", {"splatview_recipe": 1, "steps": steps})
    split = [sphere(0.3), {"op": "split", "path": "both.ply"}]
    write_json(folder / "one-name-twice.json", {"splatview_recipe": 1, "steps": split})
    other = {"name": "other.ply", "count": 40, "fingerprint": "0" * 64}
    write_json(folder / "for-another-scene.json", {"splatview_recipe": 1, "scene": other, "steps": []})
    write_json(folder / "other-version.json", {"splatview_recipe": 99, "steps": []})
