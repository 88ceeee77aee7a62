"""Splats from and to a .ply in the layout that the field's trainers write and every viewer opens.

Means in ``x y z``; ``f_dc_0..2``; ``f_rest_*`` channel by channel; ``opacity`` a logit; ``scale_*``
logarithms; ``rot_*`` wxyz (Kerbl et al. 2023, their released code). Properties may stand in any order.
"""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
from plyfile import PlyElement, PlyProperty

from splatview.scene.errors import InputError
from splatview.scene.formats.compressed_ply import read_compressed
from splatview.scene.formats.io import atomic_write
from splatview.scene.formats.ply_body import PlyBody, Target
from splatview.scene.formats.ply_header import Header, header_text, read_header, scalar_types
from splatview.scene.formats.point_cloud import read_point_cloud
from splatview.scene.gaussians import Gaussians
from splatview.scene.progress import Progress

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
REQUIRED = (
    *POSITION,
    *(f"f_dc_{i}" for i in range(3)),
    "opacity",
    *(f"scale_{i}" for i in range(2)),
    *(f"rot_{i}" for i in range(4)),
)
"""``scale_2`` may be missing: 2D Gaussian splatting writes two."""

REST_COUNTS = {0: 1, 9: 4, 24: 9, 45: 16}
"""Number of ``f_rest_*`` -> SH coefficients a channel, the constant one included."""

FLAT_RATIO = 1000.0
"""Splats stored with two scales get a third that is this much smaller than the smaller one: their normal is
the third axis (Huang et al. 2024, their released code), and drawn as ellipsoids they are thin."""

FLAT_TAG = "SplatRenderMode: 2dgs"
"""The comment by which a file says that its splats are discs."""


FILTER = "filter_3D"
"""The property in which Mip-Splatting keeps its smoothing filter: world units, a standard deviation."""

MIP_TAG = "SplatRenderMode: mip"
"""The comment by which a file says that it was trained with Mip-Splatting's kernel."""


def is_ply(start: bytes) -> bool:
    """Whether a file whose first bytes are `start` says that it is a .ply."""
    return start[:3] == b"ply" and start[3:].lstrip(b" \t").startswith((b"\n", b"\r\n"))


def read_ply(file: io.BufferedReader, path: Path, progress: Progress, room: float = math.inf) -> Gaussians:
    """Splats, or a point cloud as round splats; `room` bytes of memory at most. Raises InputError and
    Cancelled."""
    header = read_header(file, path)
    vertex = header.elements.get("vertex")
    _refuse_other_ply(header, path)
    if vertex is None:
        raise InputError(f"{path}: has no element vertex, so no splats")
    body = PlyBody(file, header, path, progress, room)
    if "packed_position" in scalar_types(vertex):
        return read_compressed(body, vertex, progress, room)
    splat_prefixes = ("f_dc_", "f_rest_", "opacity", "scale_", "rot_")
    if not any(name.startswith(splat_prefixes) for name in scalar_types(vertex)):
        return read_point_cloud(body, vertex)
    return _read_splats(body, vertex)


def _refuse_other_ply(header: Header, path: Path) -> None:
    """Raises InputError where the header is that of a mesh."""
    vertex = header.elements.get("vertex")
    names = {prop.name for prop in vertex.properties} if vertex else set()
    if names & {"opacity", "f_dc_0", "packed_position"}:
        return
    for element in header.elements.values():
        if element.name in ("face", "tristrips") and element.count > 0:
            raise InputError(
                f"{path}: is a mesh ({element.count:,} rows of {element.name}), not a splat scene; sample "
                "points on it, or train splats from pictures of it"
            )


def _read_splats(body: PlyBody, vertex: PlyElement) -> Gaussians:
    types, path = scalar_types(vertex), body.path
    rest = [name for name in types if name.startswith("f_rest_")]
    coefficients = REST_COUNTS.get(len(rest))
    rest_names = [f"f_rest_{i}" for i in range(len(rest))]
    missing = [name for name in REQUIRED if name not in types]
    for name in missing:
        if name in vertex:
            raise InputError(f"{path}: {name} is a list, not one number per splat; export the scene again")
    if missing:
        raise InputError(f"{path}: the splats have no {', '.join(missing)}; export the scene again with them")
    if coefficients is None or not set(rest_names) <= set(types):
        raise InputError(
            f"{path}: {len(rest)} properties f_rest_* make no whole SH bands; degrees 0 to 3 have 0, 9, 24 "
            "and 45, numbered from f_rest_0; export the scene again"
        )
    scale_names = ("scale_0", "scale_1", "scale_2" if "scale_2" in types else "scale_1")
    per_channel = coefficients - 1
    sh_names = [f"f_dc_{c}" for c in range(3)]
    sh_names += [f"f_rest_{c * per_channel + k}" for k in range(per_channel) for c in range(3)]
    used = [*POSITION, *sh_names, *scale_names, "opacity", *(f"rot_{i}" for i in range(4))]
    for name in used:
        if types[name].kind != "f":
            raise InputError(
                f"{path}: {name} is {types[name].name}, but must be a float; export the scene again"
            )
    body.check_size(vertex)

    n = vertex.count
    precise = any(types[name].itemsize == 8 for name in POSITION)
    means = np.empty((n, 3), dtype=np.float64 if precise else np.float32)
    quats = np.empty((n, 4), dtype=np.float32)
    log_scales = np.empty((n, 3), dtype=np.float32)
    opacity_logits = np.empty(n, dtype=np.float32)
    sh = np.empty((n, coefficients, 3), dtype=np.float32)
    extras = {name: np.empty(n, dtype) for name, dtype in types.items() if name not in used}
    named: list[tuple[list[str], np.ndarray]] = [
        (list(POSITION), means),
        (sh_names, sh),
        (["opacity"], opacity_logits),
        (list(scale_names), log_scales),
        ([f"rot_{i}" for i in range(4)], quats),
        *(([name], values) for name, values in extras.items()),
    ]
    targets = [Target(names=names, array=array) for names, array in named]
    body.read_rows(vertex, targets)

    comments = body.header.comments
    if any(types[name].itemsize == 8 for name in used if name not in POSITION):
        comments += ("splatview: the file's doubles were rounded to float32, but for positions",)
    if "scale_2" not in types:
        log_scales[:, 2] = log_scales[:, :2].min(axis=1) - np.float32(math.log(FLAT_RATIO))
        comments += (
            FLAT_TAG,
            f"splatview: the file had two scales; the third is the smaller / {FLAT_RATIO:g}",
        )
    if FILTER in extras:
        fuse_filter(log_scales, opacity_logits, extras.pop(FILTER))
        # The file's own word on how it was trained comes later and counts more.
        comments = (MIP_TAG, *comments, f"splatview: the file's {FILTER} is part of the scales and opacities")
    if set(NORMAL) <= set(extras) and not any(_has_bits(extras[name]) for name in NORMAL):
        # The usual layout has normals of zeros that mean nothing; saving writes them again.
        extras = {name: values for name, values in extras.items() if name not in NORMAL}
    return Gaussians(
        means=means,
        quats=quats,
        log_scales=log_scales,
        opacity_logits=opacity_logits,
        sh=sh,
        comments=comments,
        extras=extras,
    )


def fuse_filter(log_scales: np.ndarray, opacity_logits: np.ndarray, sigmas: np.ndarray) -> None:
    """Widens splats (N, 3) by filters of standard deviations `sigmas` (N,) and fades (N,) them as much, in
    place: s' = sqrt(s² + σ²), o' = o·sqrt(Πs² / Πs'²) (Yu et al. 2024, eq. 9 and their released code)."""
    for start in range(0, len(sigmas), FUSED):
        part = slice(start, start + FUSED)
        filtered = np.flatnonzero(sigmas[part]) + start  # NaN too: it culls, as it does there
        before = log_scales[filtered].astype(np.float64)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            squares = 2 * np.log(np.abs(sigmas[filtered].astype(np.float64)))
            after = np.logaddexp(2 * before, squares[:, None]) / 2
            log_opacity = (before - after).sum(axis=1)
            log_opacity -= np.logaddexp(0, -opacity_logits[filtered].astype(np.float64))
            opacity_logits[filtered] = log_opacity - np.log(-np.expm1(log_opacity))
        log_scales[filtered] = after


FUSED = 1 << 16
"""Splats at once, so that no second copy of the scene is made."""


def _has_bits(values: np.ndarray) -> bool:
    """Whether any bit is set: -0.0 counts."""
    return bool(values.view(f"u{values.itemsize}").any())


CHUNK_BYTES = 1 << 20
"""Put together at once; no second copy of the scene is made."""


def save_ply(gaussians: Gaussians, path: Path, progress: Progress) -> None:
    """Writes x y z, nx ny nz, f_dc, f_rest, opacity, scale, rot, then the extras; comments in the header.

    Normals are zeros unless the extras have them. float64 means are written as doubles.

    Raises:
        InputError: an extra has a name or type that .ply cannot hold, or the file cannot be written.
        Cancelled: nobody waits for it any more.
    """
    columns = _columns(gaussians, path)
    dtype = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    n = len(gaussians)
    chunk = max(1, CHUNK_BYTES // dtype.itemsize)
    properties = [PlyProperty(name, dtype[name].str[1:]) for name in columns]
    header = header_text([PlyElement("vertex", properties, n)], gaussians.comments, path)
    with atomic_write(path) as file:
        file.write(header)
        for start in range(0, n, chunk):
            stop = min(start + chunk, n)
            rows = np.empty(stop - start, dtype=dtype)
            for name, values in columns.items():
                rows[name] = values[start:stop]
            file.write(rows.data)
            progress.step(stop / n)


def _columns(gaussians: Gaussians, path: Path) -> dict[str, np.ndarray]:
    """Property name -> values (N,), in the order of the file."""
    zeros = np.broadcast_to(np.float32(0), (len(gaussians),))
    extras = dict(gaussians.extras)
    columns = {name: gaussians.means[:, i] for i, name in enumerate("xyz")}
    columns |= {name: extras.pop(name, zeros) for name in NORMAL}
    columns |= {f"f_dc_{c}": gaussians.sh[:, 0, c] for c in range(3)}
    rest = gaussians.sh[:, 1:].shape[1]
    columns |= {f"f_rest_{c * rest + k}": gaussians.sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns["opacity"] = gaussians.opacity_logits
    columns |= {f"scale_{i}": gaussians.log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": gaussians.quats[:, i] for i in range(4)}
    for name, values in extras.items():
        if name in columns or name.startswith("f_rest_"):
            raise InputError(
                f"{path}: cannot be written: the extra property {name!r} has the name of a splat's own"
            )
        if name.split() != [name] or not name.isascii() or not name.isprintable():
            raise InputError(
                f"{path}: cannot be written: {name!r} is no name for a .ply property (one ASCII word)"
            )
        columns[name] = values
    for name, values in columns.items():
        try:
            PlyProperty(name, values.dtype.str[1:])
        except ValueError:
            raise InputError(
                f"{path}: cannot be written: .ply has no type {values.dtype} (property {name}); "
                "give it as float32, float64 or an integer of at most 32 bits"
            ) from None
    return columns
