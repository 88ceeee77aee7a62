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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.edits import quat_product
from splatview.scene.errors import InputError
from splatview.scene.formats.io import atomic_write, excerpt, open_regular
from splatview.scene.formats.packing import check_room, logits_of, too_short, unit_quats
from splatview.scene.frames import OURS, reframed, turned
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians, concatenate
from splatview.scene.progress import Progress
from splatview.scene.projection import sigmoid

EXTENSION = "KHR_gaussian_splatting"
FRAME = "LUF"

GLB, JSON_CHUNK, BINARY_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942

POINTS, FLOAT, ARRAY_BUFFER = 0, 5126, 34962

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", FLOAT: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

MAX_JSON_BYTES = 1 << 26

LINEAR = "lin_rec709_display"

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
    text, binary = file.read(length), b""
    chunk = file.read(8)
    if len(chunk) == 8 and struct.unpack("<2I", chunk)[1] == BINARY_CHUNK:
        binary = file.read(min(struct.unpack("<2I", chunk)[0], size))
    return _Document(text, binary, path).read(progress, room)


def read_gltf(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    """As `read_glb`, with numbers in files beside it or within its text."""
    text = file.read(MAX_JSON_BYTES + 1)
    if len(text) > MAX_JSON_BYTES:
        raise InputError(f"{path}: is too large for the text of a scene")
    return _Document(text, b"", path).read(progress, room)


@dataclass(frozen=True, kw_only=True)
class _Placed:
    primitive: dict[str, Any]
    matrix: np.ndarray
    """(4, 4), primitive to scene."""


class _Document:
    def __init__(self, text: bytes, binary: bytes, path: Path) -> None:
        self.path, self._binary = path, binary
        self._buffers: dict[int, bytes] = {}
        try:
            self.json = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: its description is no JSON ({error}); export it again") from None

    def read(self, progress: Progress, room: float) -> Gaussians:
        try:
            placed = self._placed()
            if not placed:
                raise InputError(f"{self.path}: has no splats ({EXTENSION}): it is a scene of something else")
            parts = []
            for one in placed:
                count = self.json["accessors"][_index(one.primitive["attributes"]["POSITION"])]["count"]
                check_room(self.path, sum(map(len, parts)) + _index(count), 3, room)
                parts.append(self._moved(self._splats(one.primitive), one.matrix))
                progress.step(len(parts) / len(placed))
            return reframed(concatenate(parts), FRAME)
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

    def _splats(self, primitive: dict[str, Any]) -> Gaussians:
        extension, attributes = primitive["extensions"][EXTENSION], primitive["attributes"]
        kernel = extension.get("kernel", "ellipse")
        if kernel != "ellipse":
            raise InputError(
                f"{self.path}: its splats have the kernel {excerpt(str(kernel))}; ellipse is read"
            )
        means = self._values(attributes["POSITION"], 3)
        n = len(means)
        comments: tuple[str, ...] = ()
        if extension.get("colorSpace") == LINEAR:
            comments = ("splatview: the file's colours are linear light, and shown as they are",)

        def values(name: str, width: int) -> np.ndarray:
            found = self._values(attributes[f"{EXTENSION}:{name}"], width)
            if len(found) != n:
                raise InputError(
                    f"{self.path}: {name} of {len(found):,} splats, and there are {n:,}: damaged"
                )
            return found

        sh = [values("SH_DEGREE_0_COEF_0", 3)]
        for degree in range(1, 4):
            names = [f"SH_DEGREE_{degree}_COEF_{i}" for i in range(2 * degree + 1)]
            if f"{EXTENSION}:{names[0]}" not in attributes:
                break
            sh += [values(name, 3) for name in names]
        with np.errstate(divide="ignore", invalid="ignore"):
            log_scales = np.log(values("SCALE", 3))
        return Gaussians(
            means=means,
            quats=values("ROTATION", 4)[:, [3, 0, 1, 2]],
            log_scales=log_scales,
            opacity_logits=logits_of(values("OPACITY", 1)[:, 0]),
            sh=np.stack(sh, axis=1),
            comments=comments,
        )

    def _moved(self, gaussians: Gaussians, matrix: np.ndarray) -> Gaussians:
        if np.array_equal(matrix, np.eye(4)):
            return gaussians
        linear, offset = matrix[:3, :3], matrix[:3, 3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        if not scale != 0 or not np.allclose(linear @ linear.T, scale**2 * np.eye(3), atol=1e-5 * scale**2):
            raise InputError(f"{self.path}: a node is stretched, which splats cannot be; apply it first")
        gaussians = turned(gaussians, linear / scale)
        return replace(
            gaussians,
            means=(gaussians.means * scale + offset).astype(np.float32),
            log_scales=gaussians.log_scales + np.float32(math.log(abs(scale))),
        )

    def _values(self, number: int, width: int) -> np.ndarray:
        """(N, width) float32 of an accessor. Raises InputError where it is outside of its buffer."""
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
        view = self.json["bufferViews"][_index(accessor["bufferView"])]
        data = self._buffer(_index(view.get("buffer", 0)))
        start = _index(view.get("byteOffset", 0)) + _index(accessor.get("byteOffset", 0))
        stride = _index(view.get("byteStride", 0)) or dtype.itemsize * width
        if stride < dtype.itemsize * width or (
            count and start + stride * (count - 1) + dtype.itemsize * width > len(data)
        ):
            raise too_short(self.path, f"{count:,} values of an accessor")
        rows = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize))
        if dtype.kind == "f":
            return rows.astype(np.float32)
        if not accessor.get("normalized"):
            raise InputError(
                f"{self.path}: whole numbers that are not normalised are not read; export it again"
            )
        return np.maximum(rows / np.float32(np.iinfo(dtype).max), -1).astype(np.float32)

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            uri = self.json["buffers"][number].get("uri")
            if uri is None:
                content = self._binary
            elif embedded := re.match(r"data:[^,]*;base64,", uri):
                content = base64.b64decode(uri[embedded.end() :], validate=True)
            elif re.search(r"[/\\:%\0]", uri) or uri in ("", ".", ".."):
                raise InputError(f"{self.path}: names {excerpt(uri)}: only files beside it are read")
            else:
                with open_regular(self.path.parent / uri) as file:
                    content = file.read()
            self._buffers[number] = content
        return self._buffers[number]


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
    gaussians = reframed(gaussians, OURS, FRAME)
    with np.errstate(over="ignore"):
        arrays = {
            "POSITION": gaussians.means,
            "ROTATION": unit_quats(gaussians.quats)[:, [1, 2, 3, 0]],
            "SCALE": np.exp(gaussians.log_scales),
            "OPACITY": sigmoid(gaussians.opacity_logits),
        }
    for degree in range(gaussians.sh_degree + 1):
        first = SH_COEFFICIENTS[degree - 1] if degree else 0
        for i in range(2 * degree + 1):
            arrays[f"SH_DEGREE_{degree}_COEF_{i}"] = gaussians.sh[:, first + i]
    views, accessors, attributes, at = [], [], {}, 0
    for name, array in arrays.items():
        width = 1 if array.ndim == 1 else array.shape[1]
        accessor = {
            "bufferView": len(views),
            "componentType": FLOAT,
            "count": len(array),
            "type": {count: kind for kind, count in WIDTHS.items()}[width],
        }
        if name == "POSITION" and len(array):
            stored = array.astype(np.float32)
            accessor |= {"min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist()}
        attributes[name if name == "POSITION" else f"{EXTENSION}:{name}"] = len(views)
        views.append({"buffer": 0, "byteOffset": at, "byteLength": 4 * array.size, "target": ARRAY_BUFFER})
        accessors.append(accessor)
        at += 4 * array.size
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
        for done, array in enumerate(arrays.values()):
            file.write(np.ascontiguousarray(array, "<f4").data)
            progress.step((done + 1) / len(arrays))
