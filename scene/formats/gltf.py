"""Scenes from and to glTF with KHR_gaussian_splatting: .glb read and written, .gltf read.

Every number is a float32, so nothing is lost but comments and extras. The frame is LUF: y up, and what faces
the viewer of an upright scene looks along +z. Source: KhronosGroup/glTF, the extension's README and the
specification of glTF 2.0, section 3.6 and 4.4.
"""

from __future__ import annotations

import base64
import io
import json
import math
import os
import re
import struct
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from splatview.scene.edits import quat_product
from splatview.scene.errors import InputError
from splatview.scene.formats.io import atomic_write, excerpt, open_regular
from splatview.scene.formats.packing import (
    SLICE,
    check_expansion,
    check_room,
    empty_arrays,
    logits_of,
    parsed_json,
    scene_of,
    slices,
    too_short,
    unit_quats,
)
from splatview.scene.frames import OURS, axis_flips, frame_matrix, turn_in_place
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians
from splatview.scene.progress import Progress
from splatview.scene.projection import sigmoid

EXTENSION = "KHR_gaussian_splatting"
FRAME = "LUF"

GLB, JSON_CHUNK, BINARY_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942

POINTS, FLOAT, ARRAY_BUFFER = 0, 5126, 34962

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", FLOAT: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

MAX_JSON_BYTES = 1 << 26

MOST_STRIDE = 252
"""Bytes of interleaved numbers of one splat that the specification allows."""

LINEAR = "lin_rec709_display"

MOST_PRIMITIVES = 1 << 12

MOST_DEPTH = 64
"""Nodes below one another."""


def is_glb(start: bytes) -> bool:
    return start.startswith(GLB)


def read_glb(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    """Splats of all primitives, moved as their nodes say. Raises InputError and Cancelled."""
    size = os.fstat(file.fileno()).st_size
    header = file.read(20)
    if len(header) < 20:
        raise too_short(path, "its header does")
    version, _, length, kind = struct.unpack_from("<4I", header, 4)
    if version != 2 or kind != JSON_CHUNK:
        raise InputError(f"{path}: is no .glb of version 2; export it again")
    if length > min(size - 20, MAX_JSON_BYTES):
        raise too_short(path, "its description does")
    text, chunk = file.read(length), file.read(8)
    binary = _Buffer(file, file.tell(), 0)
    if len(chunk) == 8 and struct.unpack("<2I", chunk)[1] == BINARY_CHUNK:
        binary = _Buffer(file, file.tell(), min(struct.unpack("<2I", chunk)[0], size - file.tell()))
    with ExitStack() as opened:
        return _Document(text, binary, path, opened).read(progress, room)


def read_gltf(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    """As `read_glb`, with numbers in files beside it or within its text."""
    text = file.read(MAX_JSON_BYTES + 1)
    if len(text) > MAX_JSON_BYTES:
        raise InputError(f"{path}: is too large for the text of a scene")
    with ExitStack() as opened:
        return _Document(text, _Buffer(file, 0, 0), path, opened).read(progress, room)


@dataclass(frozen=True)
class _Buffer:
    """A run of bytes of a file, read piece by piece."""

    file: IO[bytes]
    start: int
    size: int

    def read(self, start: int, size: int) -> bytes:
        self.file.seek(self.start + start)
        return self.file.read(size)


@dataclass(frozen=True, kw_only=True)
class _Accessor:
    """Where the numbers of an attribute lie."""

    buffer: _Buffer
    start: int
    stride: int
    dtype: np.dtype
    count: int
    width: int

    def fill(self, rows: np.ndarray, path: Path, progress: Progress) -> None:
        """Writes them to `rows` (count, width), float32. Raises InputError and Cancelled."""
        size = self.dtype.itemsize * self.width
        for start in range(0, self.count, SLICE):
            progress.check()
            count = min(SLICE, self.count - start)
            data = self.buffer.read(self.start + start * self.stride, (count - 1) * self.stride + size)
            if len(data) < (count - 1) * self.stride + size:
                raise InputError(f"{path}: became shorter while it was read")
            found = np.ndarray((count, self.width), self.dtype, data, 0, (self.stride, self.dtype.itemsize))
            if self.dtype.kind != "f":
                found = np.maximum(found / np.float32(np.iinfo(self.dtype).max), -1)
            rows[start : start + count] = found


@dataclass(frozen=True, kw_only=True)
class _Placed:
    primitive: dict[str, Any]
    matrix: np.ndarray
    """(4, 4), primitive to scene."""


class _Document:
    def __init__(self, text: bytes, binary: _Buffer, path: Path, opened: ExitStack) -> None:
        self.path, self._binary, self._opened = path, binary, opened
        self._buffers: dict[int, _Buffer] = {}
        self.json = parsed_json(text, path, "its description")

    def read(self, progress: Progress, room: float) -> Gaussians:
        try:
            placed = self._placed()
            if not placed:
                raise InputError(f"{self.path}: has no splats ({EXTENSION}): it is a scene of something else")
            if len(placed) > MOST_PRIMITIVES:
                raise InputError(
                    f"{self.path}: {len(placed):,} primitives of splats, and {MOST_PRIMITIVES:,} are read: "
                    "put them together elsewhere first"
                )
            found = [self._attributes(one.primitive) for one in placed]
            counts = [attributes["POSITION"].count for attributes in found]
            degree = max(map(_degree, found))
            # Primitives may share their numbers, so that a small file is many splats.
            check_expansion(self.path, 56 * sum(counts), sum(each.size for each in self._buffers.values()))
            check_room(self.path, sum(counts), degree, room)
            arrays, start = empty_arrays(sum(counts), degree), 0
            for one, attributes, count in zip(placed, found, counts, strict=True):
                part = {name: values[start : start + count] for name, values in arrays.items()}
                start += count
                self._fill(part, attributes, progress)
                self._move(part, one.matrix)
                progress.step(start / max(sum(counts), 1))
            turn_in_place(arrays, frame_matrix(FRAME))
            linear = any(one.primitive["extensions"][EXTENSION].get("colorSpace") == LINEAR for one in placed)
            note = "splatview: the file's colours are linear light, and shown as they are"
            return scene_of(arrays, (note,) if linear else ())
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise InputError(
                f"{self.path}: its description is not that of splats ({type(error).__name__}: "
                f"{excerpt(str(error))}); export it again"
            ) from None

    def _placed(self) -> list[_Placed]:
        """Primitives of splats with the way from them to the scene."""
        nodes, meshes = self.json.get("nodes", []), self.json.get("meshes", [])
        scenes = self.json.get("scenes", [])
        children = {child for node in nodes for child in node.get("children", [])}
        if scenes:
            roots = scenes[self.json.get("scene", 0)].get("nodes", [])
        else:
            roots = [number for number in range(len(nodes)) if number not in children]
        found, seen = [], set()
        waiting = [(number, np.eye(4), 0) for number in roots]
        while waiting:
            number, above, depth = waiting.pop()
            if number in seen or depth > MOST_DEPTH:
                raise InputError(f"{self.path}: its nodes make no tree: it is damaged")
            seen.add(number)
            node = nodes[number]
            matrix = above @ _matrix_of(node)
            if "mesh" in node:
                primitives = meshes[node["mesh"]]["primitives"]
                found += [
                    _Placed(primitive=primitive, matrix=matrix)
                    for primitive in primitives
                    if EXTENSION in primitive.get("extensions", {})
                ]
            waiting += [(child, matrix, depth + 1) for child in node.get("children", [])]
        return found

    def _attributes(self, primitive: dict[str, Any]) -> dict[str, _Accessor]:
        """Accessors by name, without the extension's own. Raises InputError, KeyError and ValueError."""
        kernel = primitive["extensions"][EXTENSION].get("kernel", "ellipse")
        if kernel != "ellipse":
            raise InputError(
                f"{self.path}: its splats have the kernel {excerpt(str(kernel))}; ellipse is read"
            )
        attributes = primitive["attributes"]
        found = {"POSITION": self._accessor(attributes["POSITION"], 3)}
        widths = {"SH_DEGREE_0_COEF_0": 3, "SCALE": 3, "ROTATION": 4, "OPACITY": 1}
        for degree in range(1, 4):
            if f"{EXTENSION}:SH_DEGREE_{degree}_COEF_0" not in attributes:
                break
            widths |= {f"SH_DEGREE_{degree}_COEF_{i}": 3 for i in range(2 * degree + 1)}
        for name, width in widths.items():
            found[name] = self._accessor(attributes[f"{EXTENSION}:{name}"], width)
        n = found["POSITION"].count
        for name, accessor in found.items():
            if accessor.count != n:
                raise InputError(
                    f"{self.path}: {name} of {accessor.count:,} splats, and there are {n:,}: damaged"
                )
        return found

    def _fill(
        self, arrays: dict[str, np.ndarray], attributes: dict[str, _Accessor], progress: Progress
    ) -> None:
        """Reads a primitive into its part of the scene's arrays."""
        attributes["POSITION"].fill(arrays["means"], self.path, progress)
        attributes["ROTATION"].fill(arrays["quats"], self.path, progress)
        attributes["SCALE"].fill(arrays["log_scales"], self.path, progress)
        attributes["OPACITY"].fill(arrays["opacity_logits"][:, None], self.path, progress)
        sh = arrays["sh"]
        for degree in range(_degree(attributes) + 1):
            for i in range(2 * degree + 1):
                accessor = attributes[f"SH_DEGREE_{degree}_COEF_{i}"]
                accessor.fill(sh[:, degree**2 + i], self.path, progress)
        sh[:, SH_COEFFICIENTS[_degree(attributes)] :] = 0
        for at in slices(len(sh)):
            progress.check()
            arrays["quats"][at] = arrays["quats"][at, [3, 0, 1, 2]]
            arrays["opacity_logits"][at] = logits_of(arrays["opacity_logits"][at])
            with np.errstate(divide="ignore", invalid="ignore"):
                np.log(arrays["log_scales"][at], out=arrays["log_scales"][at])

    def _move(self, arrays: dict[str, np.ndarray], matrix: np.ndarray) -> None:
        """Moves a primitive to where its node is. Raises InputError."""
        if np.array_equal(matrix, np.eye(4)):
            return
        linear, offset = matrix[:3, :3], matrix[:3, 3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        if not scale != 0 or not np.allclose(linear @ linear.T, scale**2 * np.eye(3), atol=1e-5 * scale**2):
            raise InputError(f"{self.path}: a node is stretched, which splats cannot be; apply it first")
        turn_in_place(arrays, linear / scale)
        for at in slices(len(arrays["means"])):
            arrays["means"][at] = arrays["means"][at] * scale + offset
        arrays["log_scales"] += np.float32(math.log(abs(scale)))

    def _accessor(self, number: int, width: int) -> _Accessor:
        """Raises InputError where it is outside of its buffer."""
        accessor = self.json["accessors"][_index(number)]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise InputError(
                f"{self.path}: numbers that are sparse or left out are not read; export it again"
            )
        dtype, count = np.dtype(COMPONENTS[accessor["componentType"]]), _index(accessor["count"])
        if WIDTHS[accessor["type"]] != width:
            raise InputError(
                f"{self.path}: {excerpt(str(accessor['type']))} where {width} numbers belong: damaged"
            )
        if dtype.kind != "f" and not accessor.get("normalized"):
            raise InputError(
                f"{self.path}: whole numbers that are not normalised are not read; export it again"
            )
        view = self.json["bufferViews"][_index(accessor["bufferView"])]
        buffer = self._buffer(_index(view.get("buffer", 0)))
        start = _index(view.get("byteOffset", 0)) + _index(accessor.get("byteOffset", 0))
        stride = _index(view.get("byteStride", 0)) or dtype.itemsize * width
        if stride > MOST_STRIDE:
            raise InputError(f"{self.path}: rows of {stride:,} bytes, and 252 are most: it is damaged")
        if stride < dtype.itemsize * width or (
            count and start + stride * (count - 1) + dtype.itemsize * width > buffer.size
        ):
            raise too_short(self.path, f"{count:,} values of an accessor")
        return _Accessor(buffer=buffer, start=start, stride=stride, dtype=dtype, count=count, width=width)

    def _buffer(self, number: int) -> _Buffer:
        if number not in self._buffers:
            uri = self.json["buffers"][number].get("uri")
            if uri is None:
                found = self._binary
            elif embedded := re.match(r"data:[^,]*;base64,", uri):
                content = base64.b64decode(uri[embedded.end() :], validate=True)
                found = _Buffer(io.BytesIO(content), 0, len(content))
            elif re.search(r"[/\\:%\0]", uri) or uri in ("", ".", ".."):
                raise InputError(f"{self.path}: names {excerpt(uri)}: only files beside it are read")
            else:
                file = self._opened.enter_context(open_regular(self.path.parent / uri))
                found = _Buffer(file, 0, os.fstat(file.fileno()).st_size)
            self._buffers[number] = found
        return self._buffers[number]


def _degree(attributes: Mapping[str, _Accessor]) -> int:
    """The highest SH degree of a primitive."""
    return max(degree for degree in range(4) if f"SH_DEGREE_{degree}_COEF_0" in attributes)


def _index(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} is no index")
    return value


def _matrix_of(node: dict[str, Any]) -> np.ndarray:
    """(4, 4) of a node to the one above."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
    else:
        x, y, z, w = node.get("rotation", (0, 0, 0, 1))
        columns = [
            quat_product(quat_product(np.array([w, x, y, z]), axis), np.array([w, -x, -y, -z]))[1:]
            for axis in np.eye(4)[1:]
        ]
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack(columns, axis=1) * np.array(node.get("scale", (1, 1, 1)), np.float64)
        matrix[:3, 3] = node.get("translation", (0, 0, 0))
    if not np.isfinite(matrix).all():
        raise ValueError("a node's matrix is not finite")
    return matrix


def save_glb(gaussians: Gaussians, path: Path, progress: Progress) -> None:
    """Writes one primitive of points. Raises InputError and Cancelled."""
    flips = axis_flips(OURS, FRAME)
    assert flips is not None
    axes, turn, signs = flips

    def turned_quats(at: slice) -> np.ndarray:
        quats = gaussians.quats[at]
        return unit_quats(quat_product(np.broadcast_to(turn, quats.shape), quats))[:, [1, 2, 3, 0]]

    columns: dict[str, tuple[int, Callable[[slice], np.ndarray]]] = {
        "POSITION": (3, lambda at: gaussians.means[at] * axes),
        "ROTATION": (4, turned_quats),
        "SCALE": (3, lambda at: np.exp(gaussians.log_scales[at])),
        "OPACITY": (1, lambda at: sigmoid(gaussians.opacity_logits[at])),
    }
    for degree in range(gaussians.sh_degree + 1):
        for i in range(2 * degree + 1):
            k = degree**2 + i
            columns[f"SH_DEGREE_{degree}_COEF_{i}"] = (3, lambda at, k=k: gaussians.sh[at, k] * signs[k])
    n = len(gaussians)
    views, accessors, attributes, at = [], [], {}, 0
    for name, (width, _) in columns.items():
        accessor = {
            "bufferView": len(views),
            "componentType": FLOAT,
            "count": n,
            "type": {count: kind for kind, count in WIDTHS.items()}[width],
        }
        if name == "POSITION" and n:
            accessor |= _bounds(gaussians.means, axes)
        attributes[name if name == "POSITION" else f"{EXTENSION}:{name}"] = len(views)
        views.append({"buffer": 0, "byteOffset": at, "byteLength": 4 * width * n, "target": ARRAY_BUFFER})
        accessors.append(accessor)
        at += 4 * width * n
    extension = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        # Splats are sorted along the viewing direction here, not by their distance.
        "sortingMethod": "zDepth",
        "projection": "perspective",
    }
    primitive = {"attributes": attributes, "mode": POINTS, "extensions": {EXTENSION: extension}}
    document = {
        "asset": {"version": "2.0", "generator": "splatview"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "buffers": [{"byteLength": at}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [primitive]}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + at
    if total >= 2**32:
        raise InputError(f"{path}: {total / 1e9:.1f} GB are more than a .glb can hold; take another format")
    with atomic_write(path) as file:
        file.write(struct.pack("<4s2I", GLB, 2, total) + struct.pack("<2I", len(text), JSON_CHUNK) + text)
        file.write(struct.pack("<2I", at, BINARY_CHUNK))
        for done, (_, values) in enumerate(columns.values()):
            for part in slices(n):
                with np.errstate(over="ignore", invalid="ignore"):
                    file.write(np.ascontiguousarray(values(part), "<f4").data)
                progress.step((done + part.stop / n) / len(columns))


def _bounds(means: np.ndarray, axes: np.ndarray) -> dict[str, list[float]]:
    """The least and the largest positions, as they are stored."""
    parts = [(means[part] * axes).astype(np.float32) for part in slices(len(means))]
    low, high = [part.min(axis=0) for part in parts], [part.max(axis=0) for part in parts]
    return {"min": np.min(low, axis=0).tolist(), "max": np.max(high, axis=0).tolist()}
