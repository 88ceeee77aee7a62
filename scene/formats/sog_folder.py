"""Scenes to folders of .sog, and to streamed SOG: several levels of detail in chunks of space.

Streamed SOG is a lod-meta.json with a tree over space. Each leaf names, for every level that has splats
there, a run of one of the chunks, which are folders of .sog of one level each; LOD 0 is the scene itself.
Source: playcanvas/splat-transform, write-lod.ts (MIT), read for facts.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.formats.folders import atomic_folder
from splatview.scene.formats.packing import in_z_order, storable, unit_quats
from splatview.scene.formats.sog import META
from splatview.scene.formats.sog_streamed import LOD_META
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
