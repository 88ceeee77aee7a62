"""Whole files of every format that the program reads, as other programs and it itself write them."""

from __future__ import annotations

import base64
import gzip
import io
import json
import struct
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from safetensors.numpy import save

from splatview.edit.operations.cleanup import REPAIRS
from splatview.raster import Parameters
from splatview.scene import Camera, Gaussians, look_at
from splatview.scene.edits import Crop
from splatview.scene.formats import save_scene
from splatview.scene.formats.sog_write import sog_files
from splatview.scene.progress import NO_PROGRESS
from splatview.trainer.checkpoint import FORMAT
from splatview.trainer.counters import Counters
from splatview.trainer.settings import TrainSettings, recorded
from splatview.viewer.camera import camera_text
from splatview.viewer.preferences import Preferences

SIDE = 8
"""Pixels of the photos."""


def splats(count: int, degree: int) -> Gaussians:
    rng = np.random.default_rng(degree)
    return Gaussians(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(-3, 1, size=(count, 3)).astype(np.float32),
        opacity_logits=rng.normal(size=count).astype(np.float32),
        sh=rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def splat_columns(gaussians: Gaussians, *, scales: int = 3) -> dict[str, np.ndarray]:
    rest = gaussians.sh.shape[1] - 1
    columns = {name: gaussians.means[:, i] for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{c}": gaussians.sh[:, 0, c] for c in range(3)}
    columns |= {f"f_rest_{c * rest + k}": gaussians.sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns["opacity"] = gaussians.opacity_logits
    columns |= {f"scale_{i}": gaussians.log_scales[:, i] for i in range(scales)}
    return columns | {f"rot_{i}": gaussians.quats[:, i] for i in range(4)}


_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int", "u2": "ushort"}


def _ply(columns: dict[str, np.ndarray], form: str = "binary_little_endian", lists: bool = False) -> bytes:
    count = len(columns["x"])
    lines = ["ply", f"format {form} 1.0", "comment made for a test"]
    body = b""
    if lists:
        lines += ["element face 2", "property list uchar int vertex_indices", "property uchar flag"]
        body = b"3 0 1 2 7\n0 9\n" if form == "ascii" else struct.pack("<B3iBBB", 3, 0, 1, 2, 7, 0, 9)
    lines.append(f"element vertex {count}")
    lines += [f"property {_TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    if form == "ascii":
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        body += "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    else:
        order = ">" if "big" in form else "<"
        table = np.empty(count, [(name, order + values.dtype.str[1:]) for name, values in columns.items()])
        for name, values in columns.items():
            table[name] = values
        body += table.tobytes()
    return "\n".join([*lines, "end_header", ""]).encode() + body


def plys() -> list[bytes]:
    none, third = splat_columns(splats(3, 0)), splat_columns(splats(2, 3))
    wide = {name: values.astype(np.float64) for name, values in none.items()}
    mixed = {**none, "x": none["x"].astype(np.float64), "label": np.arange(3, dtype=np.int32)}
    normals = {**none, **{name: np.zeros(3, np.float32) for name in ("nx", "ny", "nz")}}
    points = {name: none[name] for name in "xyz"}
    bytes_rgb = {name: np.array([0, 128, 255], np.uint8) for name in ("red", "green", "blue")}
    floats_rgb = {name: np.array([0, 0.5, 1], np.float32) for name in ("r", "g", "b")}
    return [
        _ply(none),
        _ply(third),
        _ply(splat_columns(splats(2, 1)), "binary_big_endian"),
        _ply(none, "ascii"),
        _ply(splat_columns(splats(3, 0), scales=2)),
        _ply(wide, "binary_big_endian"),
        _ply(mixed),
        _ply(mixed, "ascii"),
        _ply(normals),
        _ply(none, lists=True),
        _ply(none, "ascii", lists=True),
        _ply({**points, **bytes_rgb}),
        _ply({**points, **floats_rgb}, "ascii"),
        _ply(points, "binary_big_endian"),
        _ply({name: values[:0] for name, values in none.items()}),
        b"ply\nformat ascii 1.0\nelement chunk 1\nproperty float min_x\nelement vertex 1\n"
        b"property uint packed_position\nend_header\n0\n1\n",
    ]


PLY_WORDS = (
    *(b"ascii", b"binary_little_endian", b"binary_big_endian", b"element", b"property", b"list", b"vertex"),
    *(b"float", b"double", b"uchar", b"int", b"uint", b"short", b"end_header", b"obj_info", b"comment"),
    *(b"x", b"y", b"z", b"scale_2", b"f_rest_0", b"f_rest_44", b"opacity", b"rot_3", b"red", b"nx"),
    b"comment SplatRenderMode: mip",
)


def _camera(angle: float, side: int = SIDE) -> Camera:
    eye = (4 * np.cos(angle), -1.0, 4 * np.sin(angle))
    return look_at(eye, (0, 0, 0), up=(0, -1, 0), width=side, height=side, fov_y=45)


CAMERAS = [_camera(angle) for angle in (0.0, 0.7, 1.4)]


def _own_json(camera: Camera) -> dict[str, Any]:
    values: dict[str, Any] = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx")}
    return {**values, "cy": camera.cy, "world_to_camera": camera.world_to_camera.tolist(), "name": "a"}


def _trainer_json(i: int, camera: Camera) -> dict[str, Any]:
    return {
        "id": i,
        "img_name": f"p{i}",
        "width": SIDE,
        "height": SIDE,
        "fx": camera.fx,
        "fy": camera.fy,
        "position": camera.eye.tolist(),
        "rotation": camera.R_camera_world.T.tolist(),
    }


COMPRESSED_WORDS = (
    *(b"packed_position", b"packed_color", b"min_x", b"max_scale_z", b"min_r", b"chunk", b"sh"),
    *(
        b"element chunk 0",
        b"element chunk 2",
        b"element sh 19",
        b"element vertex 257",
        b"property uchar f_rest_0",
    ),
)


@cache
def packed(suffix: str) -> list[bytes]:
    """Scenes of SH degree 0 and 2 in a packed format; .spz in versions 2 and 3, too."""
    if suffix == "ksplat":
        return [ksplat(level) for level in range(3)]
    found = []
    for degree in (0, 2):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"scene.{suffix}"
            save_scene(splats(20, degree), path)
            found.append(path.read_bytes())
    if suffix == "spz":
        for version, rotation in ((2, 3), (3, 4)):
            head = struct.pack("<4sIIBBBB", b"NGSP", version, 20, 0, 12, 1, 0)
            body = np.random.default_rng(version).integers(0, 256, 20 * (16 + rotation), np.uint8)
            found.append(gzip.compress(head + body.tobytes(), mtime=0))
    return found


def gltfs() -> list[bytes]:
    """Descriptions of `packed("glb")`, with numbers beside them and within."""
    found = []
    for data in packed("glb"):
        (length,) = struct.unpack_from("<I", data, 12)
        description = json.loads(data[20 : 20 + length])
        inner = base64.b64encode(data[28 + length :]).decode()
        for uri in ("scene.bin", f"data:application/octet-stream;base64,{inner}"):
            description["buffers"][0]["uri"] = uri
            found.append(json.dumps(description).encode())
    return found


def gltf_buffer() -> dict[str, bytes]:
    """What lies beside: enough for each of them."""
    return {
        "scene.bin": max(
            (data[28 + struct.unpack_from("<I", data, 12)[0] :] for data in packed("glb")), key=len
        )
    }


def ksplat(level: int) -> bytes:
    """Six splats in two buckets, the second of which is not full."""
    rng = np.random.default_rng(level)
    row = 44 if level == 0 else 24
    header = struct.pack("<BBxxIIIIHxx", 0, 1, 1, 1, 6, 6, level).ljust(4096, b"\0")
    section = struct.pack("<4IfH2xI4x2IH", 6, 6, 4, 2, 5.0, 12, 32767, 1, 1, 0).ljust(1024, b"\0")
    data = struct.pack("<I6f", 2, 0, 0, 0, 5, 0, 0) + rng.integers(0, 200, 6 * row, np.uint8).tobytes()
    return header + section + data


def sog_folder() -> dict[str, bytes]:
    """Files of a scene by name."""
    return sog_files(splats(20, 1), NO_PROGRESS)


def lod_meta() -> bytes:
    """Two leaves, one of which has the coarser level alone, of which it takes a part."""
    finest, coarser = {"file": 0, "offset": 0, "count": 20}, {"file": 1, "offset": 0, "count": 5}
    leaves = [{"lods": {"0": finest, "1": coarser}}, {"lods": {"1": {**coarser, "offset": 8}}}]
    names = ["0_0/meta.json", "1_0/meta.json"]
    return json.dumps({"lodLevels": 2, "filenames": names, "tree": {"children": leaves}}).encode()


def camera_lists() -> list[bytes]:
    own, listed = _own_json(CAMERAS[0]), [_own_json(camera) for camera in CAMERAS]
    return [json.dumps(value).encode() for value in (own, listed, trainer_list())]


def trainer_list() -> list[dict[str, Any]]:
    return [_trainer_json(i, camera) for i, camera in enumerate(CAMERAS)]


def _lens_params(model: int) -> tuple[int, list[float]]:
    counts = {0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4, 9: 5, 10: 12, 11: 16}
    two = model in (1, 4, 5, 6, 7, 10, 11)
    start = [9.66, 9.66, SIDE / 2, SIDE / 2] if two else [9.66, SIDE / 2, SIDE / 2]
    return model, [*start, *([0.01] * (counts[model] - len(start)))]


LENS_NAMES = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV"),
    *("FOV", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"),
)


def cameras_bin(models: Sequence[int]) -> bytes:
    raw = struct.pack("<Q", len(models))
    for number, model in enumerate(models, start=1):
        params = _lens_params(model)[1]
        raw += struct.pack(f"<IiQQ{len(params)}d", number, model, SIDE, SIDE, *params)
    return raw


def cameras_txt(models: Sequence[int]) -> bytes:
    lines = ["# cameras"]
    for number, model in enumerate(models, start=1):
        lines.append(
            f"{number} {LENS_NAMES[model]} {SIDE} {SIDE} {' '.join(map(str, _lens_params(model)[1]))}"
        )
    return "\n".join(lines).encode() + b"\n"


def _poses() -> list[list[float]]:
    return [[0.5, 0.5, -0.5, 0.5, 0.1 * i, 0.2, 4.0] for i in range(3)]


def images_bin() -> bytes:
    raw = struct.pack("<Q", 3)
    for i, pose in enumerate(_poses()):
        raw += struct.pack("<I7dI", i + 1, *pose, i + 1) + f"p{i}.png".encode() + b"\0"
        raw += struct.pack("<QddQ", 1, 1.5, 2.5, 2**64 - 1)
    return raw


def images_txt() -> bytes:
    lines = [
        f"{i + 1} {' '.join(map(str, pose))} {i + 1} p{i}.png\n1.5 2.5 -1" for i, pose in enumerate(_poses())
    ]
    return "\n".join(["# images", *lines, ""]).encode()


def points_bin() -> bytes:
    raw = struct.pack("<Q", 6)
    for i in range(6):
        raw += struct.pack(
            f"<Q3d3BdQ{2 * (i % 3)}I", i, i, -i, 0.5 * i, i, 9, 250, 0.5, i % 3, *range(2 * (i % 3))
        )
    return raw


def points_txt() -> bytes:
    return b"# points\n" + b"".join(b"%d %d.5 -%d 1e-1 %d 10 250 0.5 1 0\n" % (i, i, i, i) for i in range(6))


def photo(seed: int, *, mode: str = "RGB", form: str = "PNG", side: int = SIDE) -> bytes:
    shape = (side, side) if mode == "L" else (side, side, len(mode))
    pixels = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels, mode=None).save(file, form)
    return file.getvalue()


def transforms(**more: Any) -> bytes:
    frames = []
    for i, camera in enumerate(CAMERAS):
        to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"images/p{i}.png", "transform_matrix": to_world.tolist()})
    return json.dumps({"camera_angle_x": 0.78, **more, "frames": frames}).encode()


def transforms_files() -> list[bytes]:
    size = {"w": SIDE, "h": SIDE, "fl_x": 9.66, "fl_y": 9.66, "cx": 4.0, "cy": 4.0}
    return [
        transforms(),
        transforms(**size),
        transforms(**size, k1=0.01, k2=0.02, p1=0.001, p2=0.001, camera_model="OPENCV"),
        transforms(**size, k1=0.01, k2=0.02, k3=0.03, k4=0.01, camera_model="OPENCV_FISHEYE"),
        transforms(**size, k1=0.01, k6=0.01, camera_model="FULL_OPENCV"),
        transforms(**size, test_filenames=["images/p1.png"], ply_file_path="points.ply"),
    ]


def poses_bounds() -> list[bytes]:
    """Of three photos, in the dtypes and byte orders that numpy writes."""
    rows = np.zeros((3, 17))
    rows[:, :15] = np.c_[np.diag([-1.0, 1, 1])[[1, 0, 2]].T, [0, 0, 4], [SIDE, SIDE, 9.66]].ravel()
    rows[:, 3] = 0, 0.1, 0.2
    rows[:, 15:] = 1, 9
    files = []
    for array in (rows, rows.astype(">f8"), rows.astype(np.float32), np.asfortranarray(rows)):
        file = io.BytesIO()
        np.save(file, array)
        files.append(file.getvalue())
    return files


def photos() -> list[bytes]:
    forms = [
        ("RGB", "PNG"),
        ("RGBA", "PNG"),
        ("L", "PNG"),
        ("RGB", "JPEG"),
        ("RGBA", "WEBP"),
        ("RGB", "TIFF"),
    ]
    exif = Image.Exif()
    exif[0x0112] = 6
    turned = io.BytesIO()
    Image.new("RGB", (SIDE, SIDE)).save(turned, "JPEG", exif=exif)
    return [
        *(photo(1, mode=mode, form=form) for mode, form in forms),
        photo(2, form="BMP"),
        turned.getvalue(),
    ]


CROP = {"name": "table", "half_extents": [2.0, 1.0, 2.0]}

STEPS: tuple[dict[str, Any], ...] = (
    {"op": "select_all"},
    {"op": "select_none"},
    {"op": "select_inverse"},
    {"op": "grow", "distance": 0.5},
    {"op": "shrink", "neighbours": 3},
    {"op": "delete"},
    {"op": "hide"},
    {"op": "show"},
    {"op": "lock"},
    {"op": "unlock"},
    {"op": "isolate"},
    {"op": "add_crop", "crop": {**CROP, "shape": "sphere", "keep": "outside"}},
    {"op": "delete_cropped"},
    {"op": "transform", "rotation": [1, 0, 0.5, 0], "translation": [1, 0, 0], "scale": 2.0, "scope": "scene"},
    {"op": "orient", "up": [0, 0, 1]},
    {"op": "ground", "points": [[0, 0, 0], [1, 0, 0], [0, 0, 1]]},
    {"op": "size", "value": 2.0, "scope": "scene"},
    {"op": "opacity", "value": 0.5, "how": "set", "scope": "scene"},
    {"op": "grade", "grade": {"brightness": 0.1, "contrast": 1.2, "temperature": -0.1}},
    {"op": "prune", "by": {"kind": "needles", "discs": True}, "threshold": 5.0},
    {"op": "prune", "by": {"kind": "broken"}, "threshold": 0.5},
    {"op": "merge", "path": "other.ply"},
    {"op": "duplicate"},
    {"op": "split", "path": "part.ply"},
)

SELECTORS: tuple[dict[str, Any], ...] = (
    {"kind": "polygon", "points": [[0, 0], [8, 0], [8, 8]]},
    {"kind": "brush", "points": [[4, 4], [5, 5]], "radius": 2.0, "depth": "front"},
    {"kind": "rectangle", "x0": 0, "y0": 0, "x1": 5, "y1": 5.5},
    {"kind": "sphere", "centre": [0, 1, 0], "radius": 0.5},
    {"kind": "box", "centre": [0, 1, 0], "half_extents": [1, 1, 2]},
    {"kind": "flood", "seed": 1},
    {"kind": "colour", "rgb": [0.5, 0.5, 0.5]},
    {"kind": "range", "attribute": "opacity", "low": 0.1},
    {"kind": "health", "finding": "needles"},
    {"kind": "runs", "runs": [[0, 3], [7, 2]]},
    {"kind": "all"},
)


def recipes() -> list[bytes]:
    """A file for each step and selector, and one with crops that change."""
    camera = {name: value for name, value in _own_json(CAMERAS[0]).items() if name != "name"}
    groups: list[list[dict[str, Any]]] = [[step] for step in STEPS]
    for by in SELECTORS:
        seen = {"camera": camera} if by["kind"] in ("polygon", "brush", "rectangle") else {}
        groups.append([{"op": "select", "by": {**by, **seen}, "mode": "add"}, {"op": "delete"}])
    groups.append([{"op": "repair", "finding": finding} for finding in REPAIRS])
    crops = [{"op": "add_crop", "crop": CROP}, {"op": "enable_crop", "index": 0, "enabled": False}]
    groups.append(
        [*crops, {"op": "change_crop", "index": 0, "crop": CROP}, {"op": "remove_crop", "index": 0}]
    )
    scene = {"name": "x.ply", "count": 12, "fingerprint": "abc"}
    return [json.dumps({"splatview_recipe": 1, "scene": scene, "steps": steps}).encode() for steps in groups]


def journals() -> list[bytes]:
    head = {"splatview_journal": 1, "scene": {}, "path": "/x.ply", "folder": "/", "time": 1.5}
    lines = [
        head,
        {"do": {"op": "select_all"}},
        {"do": {"op": "delete"}},
        {"position": 1},
        {"do": {"op": "hide"}},
    ]
    return ["".join(json.dumps(line) + "\n" for line in lines).encode()]


def preferences() -> list[bytes]:
    return [json.dumps(asdict(replace(Preferences(), recent=("/x.ply",)))).encode(), b"{}"]


def bookmarks() -> list[bytes]:
    mark = {
        "name": "one",
        "target": [0, 0, 0],
        "distance": 2.0,
        "rotation": np.eye(3).tolist(),
        "up": [0, -1, 0],
        "fov_y": 50.0,
        "shift": [0, 0],
        "squeeze": 1.0,
    }
    return [json.dumps({"version": 1, "bookmarks": [mark, mark]}).encode()]


def checkpoints() -> list[bytes]:

    scene = splats(4, 1)
    parameters = Parameters(*(getattr(scene, name) for name in Parameters._fields))
    arrays: dict[str, np.ndarray] = {
        f"{group}.{name}": np.ascontiguousarray(array)
        for group in ("parameters", "first", "second")
        for name, array in parameters._asdict().items()
    }
    arrays["ids"] = np.arange(4)
    seeds = []
    for crops in ((), (Crop(),)):
        run = {
            "settings": recorded(TrainSettings(cut=(crops,) if crops else (), no_growth=crops)),
            "counters": asdict(Counters()),
            "extent": 1.0,
            "next_id": 4,
            "photos": [["p0", SIDE, SIDE]],
            "notes": {},
        }
        seeds.append(save(arrays, metadata={"format": FORMAT, "run": json.dumps(run)}))
    return seeds


def clipboard() -> bytes:
    return camera_text(CAMERAS[0]).encode()
