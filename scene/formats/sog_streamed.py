"""Scenes from folders of .sog, and from streamed SOG: levels of detail in chunks of space.

Streamed SOG is a lod-meta.json whose tree names, for each leaf and level, a run of one of several such
folders; the finest level of each leaf is read. Source: playcanvas/splat-transform, read-lod.ts (MIT), read
for facts.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.formats.io import excerpt
from splatview.scene.formats.packing import check_expansion, check_room, empty_arrays, scene_of
from splatview.scene.formats.sog import BYTES, META, SogFolder, SogUnit, described, meta_of, plain, read_unit
from splatview.scene.gaussians import Gaussians
from splatview.scene.progress import Progress

LOD_META = "lod-meta.json"

MOST_CHUNKS = 1 << 16
"""Files that a streamed scene may name."""


def is_sog_folder(path: Path) -> bool:
    """Whether `path` is such a folder, or the file in it that describes the others."""
    if path.name in (META, LOD_META):
        return os.path.isfile(path)
    # os.path: unlike Path's, its questions have an answer for every name.
    return os.path.isdir(path) and any(os.path.isfile(path / name) for name in (META, LOD_META))


def read_sog_folder(path: Path, progress: Progress, room: float) -> Gaussians:
    """Splats of a folder, or of the finest level of a streamed scene. Raises InputError and Cancelled."""
    folder = path if path.is_dir() else path.parent
    streamed = path.name == LOD_META or not os.path.isfile(folder / META)
    try:
        return (_read_streamed if streamed else read_unit)(SogFolder(folder), progress, room)
    except MemoryError:
        raise InputError(f"{folder}: does not fit in this machine's memory") from None


def _read_streamed(source: SogFolder, progress: Progress, room: float) -> Gaussians:
    """Every leaf of the tree at its finest level: levels show the same things, and are never put together.

    Chunks are decoded one by one into the scene's arrays, for which all their descriptions are read first."""
    folder, meta = source.name, meta_of(source, LOD_META)
    with described(source):
        if meta.get("version", 1) != 1:
            raise InputError(
                f"{folder}: is version {excerpt(str(meta['version']))} of streamed SOG; 1 is read"
            )
        names = meta["filenames"]
        if not isinstance(names, list) or len(names) > MOST_CHUNKS:
            raise InputError(f"{folder}: its {LOD_META} names no files, or too many")
        parts = _finest(meta["tree"], len(names), folder)
        if isinstance(meta.get("environment"), str):
            names, parts = [*names, meta["environment"]], {**parts, len(names): None}
        if len({str(names[number]) for number in parts}) < len(parts):
            raise InputError(f"{folder}: its {LOD_META} names a file twice: it is damaged")
    chunks, comments, all_splats, held = [], {}, 0, 0
    for number, ranges in sorted(parts.items()):
        progress.check()
        unit = SogUnit.of(_unit_folder(folder, names[number]))
        comments |= dict.fromkeys(unit.comments)
        all_splats, held = all_splats + unit.count, held + unit.source.held
        # Not the unit itself: of thousands, their descriptions take memory.
        chunks.append((names[number], unit.count, unit.degree, _taken(unit, ranges)))
    if not chunks:
        raise InputError(f"{folder}: its {LOD_META} names no splats")
    check_expansion(folder, BYTES * all_splats, held)
    counts = [count if taken is None else int(np.count_nonzero(taken)) for _, count, _, taken in chunks]
    degree = max(degree for _, _, degree, _ in chunks)
    check_room(folder, sum(counts), degree, room)
    arrays, start = empty_arrays(sum(counts), degree), 0
    for done, ((name, count, own_degree, taken), kept) in enumerate(zip(chunks, counts, strict=True)):
        unit = SogUnit.of(_unit_folder(folder, name))
        if (unit.count, unit.degree) != (count, own_degree):
            raise InputError(f"{unit.source.name}: was changed while it was read; open it again")
        part = {key: values[start : start + kept] for key, values in arrays.items()}
        piece, start = progress.part(done / len(chunks), (done + 1) / len(chunks)), start + kept
        whole = part if taken is None else empty_arrays(count, degree)
        unit.decode(whole, piece)
        if taken is not None:
            at = np.flatnonzero(taken)
            for key, values in part.items():
                # With mode="clip" numpy writes to `out` itself, not to a copy first.
                np.take(whole[key], at, axis=0, out=values, mode="clip")
    levels = meta.get("lodLevels")
    if isinstance(levels, int) and levels != 1:
        said = f"splatview: the finest of {levels} levels of detail, from {len(chunks)} files"
        comments[said] = None
    return scene_of(arrays, tuple(comments))


def _taken(unit: SogUnit, ranges: list[tuple[int, int]] | None) -> np.ndarray | None:
    """(N,) bool: splats of a chunk that the tree asks for; None: all. Raises InputError."""
    if ranges is None:
        return None
    if any(stop > unit.count for _, stop in ranges):
        raise InputError(
            f"{unit.source.name}: has {unit.count:,} splats, and {LOD_META} asks for more: damaged"
        )
    taken, reached = np.zeros(unit.count, bool), 0
    for start, stop in sorted(ranges):
        # Nothing twice: thousands of runs of the same millions take a while.
        taken[max(start, reached) : stop] = True
        reached = max(reached, stop)
    return None if taken.all() else taken


def _finest(tree: Any, files: int, folder: Path) -> dict[int, list[tuple[int, int]] | None]:
    """Ranges of splats by number of the file."""
    found: dict[int, list[tuple[int, int]] | None] = {}
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        levels = {int(level): part for level, part in (node.get("lods") or {}).items()}
        if levels:
            part = levels[min(levels)]
            number, start, count = (part[key] for key in ("file", "offset", "count"))
            if any(isinstance(x, bool) or not isinstance(x, int) or x < 0 for x in (number, start, count)):
                raise ValueError("file, offset and count must be whole numbers")
            if number >= files:
                raise InputError(f"{folder}: its tree asks for file {number}, and there are {files}: damaged")
            ranges = found.setdefault(number, [])
            assert ranges is not None
            ranges.append((start, start + count))
        waiting += node.get("children") or []
    return found


def _unit_folder(folder: Path, name: Any) -> SogFolder:
    """The folder of a meta.json one level down; no other path is followed. Raises InputError."""
    parts = name.split("/") if isinstance(name, str) else []
    if len(parts) != 2 or parts[1] != META:
        raise InputError(f"{folder}: names {excerpt(str(name))}, and only FOLDER/{META} below it is read")
    return SogFolder(folder / plain(parts[0], folder))
