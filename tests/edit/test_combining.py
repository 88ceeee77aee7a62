"""Splats brought in and taken elsewhere: merging, duplicating, splitting."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from splatview.edit.document import Document, exported
from splatview.edit.operations import operation_from_json
from splatview.scene import Gaussians, InputError
from splatview.scene.edits import SELECTED


@pytest.fixture
def scene(edit_helpers) -> Gaussians:
    return edit_helpers.make_scene(30)


def do(document: Document, op: str, **fields: Any):
    return document.apply(operation_from_json({"op": op, **fields}))


def select(document: Document, start: int, count: int):
    return do(document, "select", by={"kind": "runs", "runs": [[start, count]]})


def test_duplicates_lie_upon_their_originals_and_are_selected(scene):
    document = Document(scene)
    select(document, 3, 4)
    do(document, "transform", translation=[1, 0, 0])
    do(document, "duplicate")
    assert np.flatnonzero(document.marks & SELECTED).tolist() == [30, 31, 32, 33]
    baked = exported(document)
    assert baked.means[30:].tobytes() == baked.means[3:7].tobytes()
    assert baked.extras["label"][30:].tolist() == [3, 4, 5, 6]
    do(document, "delete")
    assert len(exported(document)) == 30


def test_merging_adds_a_file(edit_helpers, scene, scene_file):
    path = scene_file("other.ply", count=7, degree=3)
    document = Document(scene, folder=path.parent)
    change = do(document, "merge", path="other.ply")
    assert change.title == "Merge 7 splats of other.ply"
    assert len(document.gaussians) == 37
    assert document.gaussians.sh_degree == 3
    assert np.flatnonzero(document.marks & SELECTED).tolist() == list(range(30, 37))
    document.undo()
    assert edit_helpers.scene_bytes(document.gaussians) == edit_helpers.scene_bytes(scene)
    with pytest.raises(InputError, match=r"nowhere\.ply"):
        do(document, "merge", path="nowhere.ply")


def test_merging_keeps_one_scene_in_memory(scene, scene_file):
    path = scene_file("other.ply", count=7, degree=1)
    document = Document(scene, folder=path.parent)
    do(document, "merge", path="other.ply")
    whole = document.gaussians
    document.undo()
    assert np.shares_memory(document.gaussians.sh, whole.sh)


def test_splitting_writes_the_part_once(scene, tmp_path, edit_helpers):
    from splatview.scene.formats import load_scene

    document = Document(scene, folder=tmp_path)
    select(document, 2, 5)
    do(document, "transform", translation=[1, 0, 0])
    operation = operation_from_json({"op": "split", "path": "part.ply"})
    planned = document.plan(operation)
    assert list(tmp_path.iterdir()) == []
    document.apply(planned)
    part = load_scene(tmp_path / "part.ply")
    np.testing.assert_allclose(part.means, scene.means[2:7] + np.array([1, 0, 0], np.float32), atol=1e-6)
    assert part.comments == scene.comments
    assert len(exported(document)) == 25
    document.undo()
    (tmp_path / "part.ply").unlink()
    document.redo()
    assert list(tmp_path.iterdir()) == []


def test_a_part_that_cannot_be_saved_leaves_the_selection(scene, tmp_path, edit_helpers):
    document = Document(scene, folder=tmp_path / "nowhere")
    select(document, 2, 5)
    before = edit_helpers.everything(document)
    with pytest.raises(InputError, match="does not exist"):
        do(document, "split", path="part.ply")
    assert edit_helpers.everything(document) == before
    assert document.history.position == 1
