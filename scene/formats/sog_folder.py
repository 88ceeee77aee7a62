"""Scenes to folders of .sog, and to streamed SOG: several levels of detail in chunks of space.

Streamed SOG is a lod-meta.json with a tree over space. Each leaf names, for every level that has splats
there, a run of one of the chunks, which are folders of .sog of one level each; LOD 0 is the scene itself.
Source: playcanvas/splat-transform, write-lod.ts (MIT), read for facts.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.formats.folders import atomic_folder
from splatview.scene.formats.packing import in_z_order, storable, unit_quats
from splatview.scene.formats.sog import LOD_META, META
from splatview.scene.formats.sog_write import SogKnobs, sog_files
from splatview.scene.gaussians import Gaussians
from splatview.scene.lod import levels_and_cells
from splatview.scene.progress import Progress
from splatview.scene.projection import covariances_3d

COARSER_LEVELS = 4
"""Levels besides the scene itself, each of at most 85 % of the splats before."""

CHUNK = 1 << 19
"""Splats of one chunk, about: what a player loads at once."""

LEAF = 1 << 15
"""Splats of a leaf at most, of the finest level: what a player chooses a level for."""

MOST_LOG_SCALE = 60.0
"""Log-scales are taken to be within ± this for the boxes of leaves."""


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
    """A box of space; `children`, or the splats of a leaf by level."""

    axis: int = 0
    middle: float = 0.0
    children: tuple[_Node, _Node] | None = None
    parts: dict[int, np.ndarray] = field(default_factory=dict)
    """Level -> indices of its splats."""
    places: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Level -> number of the chunk, and offset in it."""


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
    levels = [gaussians.take(storable(gaussians))]
    if len(levels[0]):
        coarser = levels_and_cells(levels[0], levels=COARSER_LEVELS)
        levels += [fewer.take(storable(fewer)) for fewer, _ in coarser]
    progress.step(0.15)
    tree = _split(levels[0].means, np.arange(len(levels[0])), leaf)
    for number, level in enumerate(levels[1:], 1):
        _sort_in(tree, level.means, np.arange(len(level)), number)
    leaves = _leaves(tree)
    chunks = _chunks(leaves, levels, chunk)
    splats = sum(sum(map(len, parts)) for _, parts in chunks.values())
    whole = max(splats, 1)
    names, done = list(chunks), 0
    with atomic_folder(path, foreign_name) as folder:
        for name, (number, parts) in chunks.items():
            order = np.concatenate(parts)
            start, done = done, done + len(order)
            piece = progress.part(0.2 + 0.8 * start / whole, 0.2 + 0.8 * done / whole)
            files = sog_files(levels[number].take(order), piece, SogKnobs(**knobs), ordered=True)
            _write(files, folder / name)
        meta = {
            "version": 1,
            "asset": {"generator": "splatview"},
            "count": splats,
            "counts": [len(level) for level in levels],
            "lodLevels": len(levels),
            "filenames": [f"{name}/{META}" for name in names],
            "tree": _described(tree, levels)[0],
        }
        (folder / LOD_META).write_text(json.dumps(meta, separators=(",", ":")), encoding="utf-8")


def _split(means: np.ndarray, members: np.ndarray, leaf: int) -> _Node:
    """Halves space along the longest side until a box has at most `leaf` splats."""
    if len(members) <= leaf:
        return _Node(parts={0: members})
    places = means[members]
    axis = int(np.argmax(places.max(axis=0) - places.min(axis=0)))
    middle = float(np.median(places[:, axis]))
    above = places[:, axis] > middle
    if not above.any():  # half of them in one place
        return _Node(parts={0: members})
    children = _split(means, members[~above], leaf), _split(means, members[above], leaf)
    return _Node(axis=axis, middle=middle, children=children)


def _sort_in(node: _Node, means: np.ndarray, members: np.ndarray, level: int) -> None:
    """Gives the leaves the splats of a coarser level that lie in them. Each leaf has splats of the finest."""
    if not len(members):
        return
    if node.children is None:
        node.parts[level] = members
        return
    above = means[members, node.axis] > node.middle
    _sort_in(node.children[0], means, members[~above], level)
    _sort_in(node.children[1], means, members[above], level)


def _leaves(node: _Node) -> list[_Node]:
    if node.children is None:
        return [node]
    return [leaf for child in node.children for leaf in _leaves(child)]


def _chunks(
    leaves: list[_Node], levels: list[Gaussians], chunk: int
) -> dict[str, tuple[int, list[np.ndarray]]]:
    """Name of each chunk -> its level, and the splats of its leaves one after another. Leaves get places."""
    chunks: dict[str, tuple[int, list[np.ndarray]]] = {}
    for number, level in enumerate(levels):
        name, filled, count = "", chunk, 0
        for leaf in leaves:
            if number not in leaf.parts:
                continue
            members = leaf.parts[number]
            if filled >= chunk:
                name, filled, count = f"{number}_{count}", 0, count + 1
                chunks[name] = number, []
            leaf.places[number] = len(chunks) - 1, filled
            if len(members):
                places = level.means[members]
                bounds = (edge(axis=0).astype(np.float64) for edge in (places.min, places.max))
                members = in_z_order(level.means, members, *bounds)
            chunks[name][1].append(members)
            filled += len(members)
    return chunks


def _described(node: _Node, levels: list[Gaussians]) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """A node as JSON, with the corners of the box about its splats."""
    if node.children is not None:
        parts = [_described(child, levels) for child in node.children]
        low = np.minimum(parts[0][1], parts[1][1])
        high = np.maximum(parts[0][2], parts[1][2])
        return {"bound": _bound(low, high), "children": [part[0] for part in parts]}, low, high
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    lods = {}
    for number, members in node.parts.items():
        level = levels[number].take(members)
        scales = np.clip(level.log_scales.astype(np.float64), -MOST_LOG_SCALE, MOST_LOG_SCALE)
        spread = covariances_3d(unit_quats(level.quats).astype(np.float64), scales)
        # Half the sides of the box about an ellipsoid of one standard deviation.
        reach = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
        if len(level):
            low = np.minimum(low, (level.means - reach).min(axis=0))
            high = np.maximum(high, (level.means + reach).max(axis=0))
        if number in node.places:
            file, offset = node.places[number]
            lods[str(number)] = {"file": file, "offset": offset, "count": len(members)}
    return {"bound": _bound(low, high), "lods": lods}, low, high


def _bound(low: np.ndarray, high: np.ndarray) -> dict[str, list[float]]:
    if not (low <= high).all():
        low = high = np.zeros(3)
    return {"min": low.tolist(), "max": high.tolist()}
