"""Scenes from and to folders of .sog, and streamed SOG: several levels of detail in chunks of space.

Streamed SOG is a lod-meta.json with a tree over space. Each leaf names, for every level that has splats
there, a run of one of the chunks, which are folders of .sog of one level each; LOD 0 is the scene itself, and
what is read. Source: playcanvas/splat-transform, read-lod.ts and write-lod.ts (MIT), read for facts.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.formats.folders import atomic_folder
from splatview.scene.formats.io import excerpt
from splatview.scene.formats.packing import (
    check_expansion,
    check_room,
    empty_arrays,
    in_z_order,
    scene_of,
    storable,
    unit_quats,
)
from splatview.scene.formats.sog import BYTES, META, SogFolder, SogUnit, described, meta_of, plain, read_unit
from splatview.scene.formats.sog_write import SogKnobs, sog_files
from splatview.scene.gaussians import Gaussians
from splatview.scene.lod import levels_and_cells
from splatview.scene.progress import Progress
from splatview.scene.projection import covariances_3d

LOD_META = "lod-meta.json"

MOST_CHUNKS = 1 << 16
"""Files that a streamed scene may name."""

COARSER_LEVELS = 4
"""Levels besides the scene itself, each of at most 85 % of the splats before."""

CHUNK = 1 << 19
"""Splats of one chunk, about: what a player loads at once."""

LEAF = 1 << 15
"""Splats of a leaf at most, of the finest level: what a player chooses a level for."""

MOST_LOG_SCALE = 60.0
"""Log-scales are taken to be within ± this for the boxes of leaves."""


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


def foreign_name(folder: Path) -> str | None:
    """The name of something in `folder` that neither .sog nor streamed SOG has; None where there is none."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                with os.scandir(entry.path) as inner:
                    if not all(_is_part(one) for one in inner):
                        return entry.name
            elif not _is_part(entry):
                return entry.name
    return None


def _is_part(entry: os.DirEntry[str]) -> bool:
    return entry.is_file(follow_symlinks=False) and (
        entry.name in (META, LOD_META) or entry.name.endswith(".webp")
    )


def save_sog_folder(gaussians: Gaussians, path: Path, progress: Progress, **knobs: int) -> None:
    """Writes meta.json and its pictures into the folder of `path`, which they are all of.

    Raises:
        InputError: the folder holds something else, or the system refuses.
        Cancelled: nobody waits for it any more.
    """
    with atomic_folder(path, foreign_name) as folder:
        _write(sog_files(gaussians, progress, SogKnobs(**knobs)), folder)


def _write(files: dict[str, bytes], folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


@dataclass(eq=False, kw_only=True)
class _Node:
    """A box of space; `children`, or what a leaf has of each level."""

    axis: int = 0
    middle: float = 0.0
    children: tuple[_Node, _Node] | None = None
    members: np.ndarray | None = None
    """Indices of a leaf's splats, of the level that is being written; None: it has none there."""
    runs: dict[str, dict[str, int]] = field(default_factory=dict)
    """Level -> number of the chunk, offset in it, and count."""
    low: np.ndarray = field(default_factory=lambda: np.full(3, np.inf))
    high: np.ndarray = field(default_factory=lambda: np.full(3, -np.inf))
    """Corners of the box about the splats of a leaf, of all levels."""


def save_streamed(
    gaussians: Gaussians,
    path: Path,
    progress: Progress,
    *,
    chunk: int = CHUNK,
    leaf: int = LEAF,
    **knobs: int,
) -> None:
    """Writes lod-meta.json and its chunks into the folder of `path`, which they are all of.

    `chunk`, `leaf`: splats of a chunk, about, and of a leaf at most. Raises as `save_sog_folder`.
    """
    names: list[str] = []
    counts: list[int] = []
    tree = _Node()
    with atomic_folder(path, foreign_name) as folder:
        # Level by level: all of them are up to three scenes.
        for number, level in enumerate(_levels(gaussians)):
            kept = np.flatnonzero(storable(level))
            if number == 0:
                tree = _split(level.means, kept, leaf)
            else:
                _sort_in(tree, level.means, kept)
            counts.append(len(kept))
            del kept
            chunks, done = _chunks(_leaves(tree), level, number, chunk, len(names)), 0
            # Each level is about half of the one before.
            share = progress.part(1 - 0.5**number, 1 - 0.5 ** (number + 1))
            for name, parts in chunks.items():
                order = np.concatenate(parts)
                start, done = done / max(counts[-1], 1), done + len(order)
                piece = share.part(start, done / max(counts[-1], 1))
                _write(sog_files(level, piece, SogKnobs(**knobs), order), folder / name)
                names.append(name)
                del parts, order
            del chunks  # before the next level is made
        meta = {
            "version": 1,
            "asset": {"generator": "splatview"},
            "count": sum(counts),
            "counts": counts,
            "lodLevels": len(counts),
            "filenames": [f"{name}/{META}" for name in names],
            "tree": _described(tree)[0],
        }
        (folder / LOD_META).write_text(json.dumps(meta, separators=(",", ":")), encoding="utf-8")


def _levels(gaussians: Gaussians) -> Iterator[Gaussians]:
    """The scene and its coarser levels, each made when it is asked for."""
    yield gaussians
    for fewer, _ in levels_and_cells(gaussians, levels=COARSER_LEVELS):
        yield fewer


def _split(means: np.ndarray, members: np.ndarray, leaf: int) -> _Node:
    """Halves space along the longest side until a box has at most `leaf` splats."""
    if len(members) <= leaf:
        return _Node(members=members)
    places = means[members]
    axis = int(np.argmax(places.max(axis=0) - places.min(axis=0)))
    middle = float(np.median(places[:, axis]))
    above = places[:, axis] > middle
    if not above.any():  # half of them in one place
        return _Node(members=members)
    children = _split(means, members[~above], leaf), _split(means, members[above], leaf)
    return _Node(axis=axis, middle=middle, children=children)


def _sort_in(node: _Node, means: np.ndarray, members: np.ndarray) -> None:
    """Gives the leaves the splats of a coarser level that lie in them. Each leaf has splats of the finest."""
    if not len(members):
        return
    if node.children is None:
        node.members = members
        return
    above = means[members, node.axis] > node.middle
    _sort_in(node.children[0], means, members[~above])
    _sort_in(node.children[1], means, members[above])


def _leaves(node: _Node) -> list[_Node]:
    if node.children is None:
        return [node]
    return [leaf for child in node.children for leaf in _leaves(child)]


def _chunks(
    leaves: list[_Node], level: Gaussians, number: int, chunk: int, before: int
) -> dict[str, list[np.ndarray]]:
    """Name of each chunk of a level -> the splats of its leaves one after another; `before`: chunks of the
    levels before. Leaves get runs of them, and give their members away."""
    chunks: dict[str, list[np.ndarray]] = {}
    name, filled = "", chunk
    for leaf in leaves:
        if leaf.members is None:
            continue
        members, leaf.members = leaf.members, None
        if filled >= chunk:
            name, filled = f"{number}_{len(chunks)}", 0
            chunks[name] = []
        leaf.runs[str(number)] = {"file": before + len(chunks) - 1, "offset": filled, "count": len(members)}
        if len(members):
            places = level.means[members]
            bounds = (edge(axis=0).astype(np.float64) for edge in (places.min, places.max))
            members = in_z_order(level.means, members, *bounds)
            _stretch(leaf, level.take(members))
        chunks[name].append(members)
        filled += len(members)
    return chunks


def _stretch(leaf: _Node, splats: Gaussians) -> None:
    """Makes a leaf's box hold ellipsoids of one standard deviation."""
    scales = np.clip(splats.log_scales.astype(np.float64), -MOST_LOG_SCALE, MOST_LOG_SCALE)
    spread = covariances_3d(unit_quats(splats.quats).astype(np.float64), scales)
    reach = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    leaf.low = np.minimum(leaf.low, (splats.means - reach).min(axis=0))
    leaf.high = np.maximum(leaf.high, (splats.means + reach).max(axis=0))


def _described(node: _Node) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """A node as JSON, with the corners of the box about its splats."""
    if node.children is not None:
        parts = [_described(child) for child in node.children]
        low = np.minimum(parts[0][1], parts[1][1])
        high = np.maximum(parts[0][2], parts[1][2])
        return {"bound": _bound(low, high), "children": [part[0] for part in parts]}, low, high
    return {"bound": _bound(node.low, node.high), "lods": node.runs}, node.low, node.high


def _bound(low: np.ndarray, high: np.ndarray) -> dict[str, list[float]]:
    if not (low <= high).all():
        low = high = np.zeros(3)
    return {"min": low.tolist(), "max": high.tolist()}
