"""What the tests of editing share: small scenes, and operations drawn by hypothesis."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatview.edit.document import Document
from splatview.scene import Gaussians
from splatview.scene.edits import bake


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
    from splatview.scene.files import save_scene

    def make(name: str = "scene.ply", *, count: int = 50, degree: int = 1, seed: int = 0) -> Path:
        path = tmp_path / name
        save_scene(make_scene(count, degree=degree, seed=seed), path)
        return path

    return make
