"""What the tests of editing share: small scenes, and operations drawn by hypothesis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatview.edit.document import Document
from splatview.scene import Camera, Gaussians, RenderSettings, reference
from splatview.scene.edits import (
    DELETED,
    HIDDEN,
    IDENTITY,
    LOCKED,
    PALETTE_SHIFT,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    bake,
    shown,
)
from splatview.scene.projection import project


def make_scene(count: int, *, degree: int = 1, seed: int = 0) -> Gaussians:
    """Splats in a cube of edge 2, with an extra property and a comment."""
    rng = np.random.default_rng(seed)
    return Gaussians(
        means=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(-2, 0.5, (count, 3)).astype(np.float32),
        opacity_logits=rng.normal(size=count).astype(np.float32),
        sh=rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)).astype(np.float32),
        comments=("made for a test",),
        extras={"label": np.arange(count, dtype=np.int32)},
    )


def scene_bytes(gaussians: Gaussians) -> tuple[Any, ...]:
    arrays = [getattr(gaussians, n) for n in ("means", "quats", "log_scales", "opacity_logits", "sh")]
    return (
        *((a.dtype.str, a.shape, a.tobytes()) for a in arrays),
        tuple((name, values.tobytes()) for name, values in gaussians.extras.items()),
        gaussians.comments,
    )


def everything(document: Document) -> tuple[Any, ...]:
    """All that a document is at a moment, comparable: its state, and what it would export."""
    return (
        document.marks.tobytes(),
        document.palette,
        document.crops,
        document.files,
        document.owners.tobytes(),
        document.file_counts,
        scene_bytes(document.gaussians),
        scene_bytes(bake(document.gaussians, document.edits, hidden=True)),
        scene_bytes(bake(document.gaussians, document.edits)),
        document.counts,
    )


@pytest.fixture(scope="session")
def edit_helpers() -> SimpleNamespace:
    return SimpleNamespace(make_scene=make_scene, scene_bytes=scene_bytes, everything=everything)


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """`scene_file("a.ply", count=50)`: the path of a scene that it has written."""
    from splatview.scene.formats import save_scene

    def make(name: str = "scene.ply", *, count: int = 50, degree: int = 1, seed: int = 0) -> Path:
        path = tmp_path / name
        save_scene(make_scene(count, degree=degree, seed=seed), path)
        return path

    return make


class ReferenceTools:
    """`splatview.edit.tools.Tools` by the float64 reference: for pictures of a few thousand pixels."""

    def _weights(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits):
        """Indices (V,) of the scene and what each adds to each pixel, (V, H·W)."""
        kept = np.flatnonzero(shown(gaussians, edits))
        footprints = project(bake(gaussians, edits), camera, RenderSettings())
        x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        order = np.arange(len(footprints.indices))
        alpha = reference.alphas(footprints, order, x.ravel(), y.ravel(), RenderSettings())
        before = np.cumprod(np.vstack([np.ones((1, x.size)), 1 - alpha]), axis=0)[:-1]
        return kept[footprints.indices], alpha * before

    def dominant_splats(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        indices, weights = self._weights(gaussians, camera, edits)
        front = np.full(camera.width * camera.height, -1, np.int32)
        if len(indices):
            seen = weights.max(axis=0) > 0
            front[seen] = indices[weights.argmax(axis=0)[seen]]
        return front.reshape(camera.height, camera.width)

    def contributions(self, gaussians: Gaussians, cameras: Sequence[Camera], edits: SceneEdits) -> np.ndarray:
        total = np.zeros(len(gaussians))
        for camera in cameras:
            indices, weights = self._weights(gaussians, camera, edits)
            total[indices] += weights.sum(axis=1)
        return total

    def picture(self, gaussians: Gaussians, camera: Camera, edits: SceneEdits) -> np.ndarray:
        return reference.render(bake(gaussians, edits), camera).astype(np.float32)


@pytest.fixture(scope="session")
def reference_tools() -> ReferenceTools:
    return ReferenceTools()


def make_edits(count: int, *, seed: int = 0) -> SceneEdits:
    """Edits of a scene of `count` splats: some hidden, deleted, moved, faded and coloured; one crop."""
    rng = np.random.default_rng(seed)
    turn = np.array([0.9, 0.1, -0.3, 0.2])
    w, x, y, z = (float(value) for value in turn / np.linalg.norm(turn))
    moved = Adjustment(
        rotation=(w, x, y, z),
        scale=1.4,
        translation=(0.3, -0.2, 0.1),
        size=0.8,
        opacity=(0.7, 0.05, 0.0, 0.9),
        colour=((0.8, 0.1, 0.0, 0.05), (0.0, 0.9, 0.1, -0.02), (0.2, 0.0, 0.7, 0.1)),
    )
    flags = rng.choice([0, 0, 0, 0, HIDDEN, DELETED, SELECTED, LOCKED], count)
    marks = (flags | (rng.integers(0, 2, count) << PALETTE_SHIFT)).astype(np.uint32)
    return SceneEdits(
        marks=marks,
        palette=(IDENTITY, moved),
        crops=(Crop(half_extents=(1.2, 1.0, 1.1), centre=(0.1, 0.0, 0.0)),),
        flags=SELECTED | HIDDEN | DELETED | LOCKED,
    )


def no_edits(count: int) -> SceneEdits:
    return SceneEdits(marks=np.zeros(count, np.uint32))


@pytest.fixture(scope="session")
def edited() -> SimpleNamespace:
    """`edited.some(count, seed=0)`, `edited.none(count)`: edits of a scene of so many splats."""
    return SimpleNamespace(some=make_edits, none=no_edits)
