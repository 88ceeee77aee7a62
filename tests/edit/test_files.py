"""The files of a scene: each shown, locked, placed and removed as a whole."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from splatview.edit.document import Document, exported
from splatview.edit.operations import operation_from_json
from splatview.edit.recipe import recipe_of, replay
from splatview.scene import Gaussians, InputError, RenderSettings, concatenate, look_at, reference
from splatview.scene.edits import DELETED, IDENTITY, SELECTED, Adjustment, bake, shown

A, B = 30, 12

TURN = {"rotation": [0.9, 0.1, -0.3, 0.2], "translation": [0.5, -0.25, 2.0], "scale": 1.5}


def do(document: Document, op: str, **fields: Any):
    return document.apply(operation_from_json({"op": op, **fields}))


@pytest.fixture
def parts(edit_helpers) -> tuple[Gaussians, Gaussians]:
    return edit_helpers.make_scene(A, seed=1), edit_helpers.make_scene(B, seed=2)


@pytest.fixture
def document(parts) -> Document:
    return Document(
        concatenate([*parts]), files=(("a.ply", A), ("b.ply", B)), load=lambda path, room: parts[1]
    )


def selected(document: Document) -> list[int]:
    return np.flatnonzero(document.marks & SELECTED).tolist()


def test_a_document_of_no_named_files_is_one(parts):
    document = Document(parts[0], name="a.ply")
    assert [file.name for file in document.files] == ["a.ply"]
    assert document.file_counts == (A,)
    with pytest.raises(ValueError, match="files must have 30 splats together"):
        Document(parts[0], files=(("a.ply", 7),))


def test_a_hidden_file_is_hidden_whatever_else_is(document):
    do(document, "select", by={"kind": "runs", "runs": [[0, 3], [A, 3]]})
    do(document, "hide")
    do(document, "select_all")
    do(document, "show_file", file=1, shown=False)
    assert document.counts.hidden == 3 + B
    assert document.counts.selected == A - 3, "its splats are deselected"
    assert shown(document.gaussians, document.edits).sum() == A - 3
    do(document, "select_all")
    assert max(selected(document)) < A
    do(document, "show")
    assert document.counts.hidden == B, "showing hidden splats opens no eye"
    assert len(exported(document)) == A + B, "everything is exported"
    assert len(bake(document.gaussians, document.edits)) == A, "only what is visible"
    do(document, "show_file", file=1, shown=True)
    assert document.counts.hidden == 0
    assert not do(document, "show_file", file=1, shown=True).parts
    document.undo()
    document.undo()
    do(document, "show_file", file=1, shown=True)
    assert document.counts.hidden == 6, "those that were hidden one by one still are"


def test_a_locked_file_is_left_alone(document):
    do(document, "lock_file", file=1, locked=True)
    assert not document.history.unsaved
    do(document, "select_all")
    assert selected(document) == list(range(A))
    do(document, "transform", scope="scene", translation=[1, 0, 0])
    do(document, "prune", by={"kind": "faint"}, threshold=0)
    do(document, "opacity", value=0.5, scope="scene")
    own = document.marks[A:]
    assert not (own & (SELECTED | DELETED)).any() and not (own >> 8).any()
    assert document.files[1].placement == IDENTITY
    assert document.files[0].placement.translation == (1.0, 0.0, 0.0)
    for op, fields in (("place_file", {"scale": 2}), ("remove_file", {})):
        with pytest.raises(InputError, match=r"b\.ply is locked; unlock it first"):
            do(document, op, file=1, **fields)


def test_crops_pass_over_a_locked_file(document):
    from splatview.renderers.cpu import CpuRenderer

    crop = {"half_extents": [0.7, 0.7, 0.7]}
    do(document, "add_crop", crop=crop)
    inside = shown(document.gaussians, document.edits)
    assert 0 < inside.sum() < A
    do(document, "lock_file", file=1, locked=True)
    assert document.history.unsaved, "what is exported has changed"
    now = shown(document.gaussians, document.edits)
    assert now[A:].all() and (now[:A] == inside[:A]).all()
    assert document.cropped_in().tolist() == now.tolist()
    camera = look_at((0, 0, -6), (0, 0, 0), width=48, height=32)
    truth = reference.render(bake(document.gaussians, document.edits), camera, RenderSettings())
    drawn = CpuRenderer().picture(document.gaussians, camera, document.edits)
    assert np.abs(drawn - truth).max() < 1e-3
    do(document, "delete_cropped")
    assert document.file_counts == (inside[:A].sum(), B)


def test_a_file_is_placed_as_a_whole(document, parts, edit_helpers):
    do(document, "place_file", file=1, **TURN)
    placement = document.files[1].placement
    assert len(document.palette) == 2
    of_file = Document(parts[1])
    do(of_file, "transform", scope="scene", **TURN)
    scene = exported(document)
    alone = exported(of_file)
    for name in ("means", "quats", "log_scales", "sh"):
        np.testing.assert_array_equal(getattr(scene, name)[A:], getattr(alone, name), err_msg=name)
    assert scene.means[:A].tobytes() == parts[0].means.tobytes()

    do(document, "select", by={"kind": "runs", "runs": [[A, 4]]})
    do(document, "transform", translation=[0, 1, 0])
    moved = exported(document).means[A : A + 4]
    do(document, "place_file", file=1)
    assert document.files[1].placement == IDENTITY
    back = exported(document)
    assert back.means[A + 4 :].tobytes() == parts[1].means[4:].tobytes(), "to the byte where it was"
    inverse = placement.linear.T / placement.scale**2
    want = (moved - np.array(placement.translation)) @ inverse.T
    np.testing.assert_allclose(back.means[A : A + 4], want, atol=1e-6)


def test_the_whole_scene_takes_its_files_along(document):
    do(document, "place_file", file=1, **TURN)
    before = document.files[1].placement
    do(document, "transform", scope="scene", rotation=[0, 1, 0, 0], pivot=[0, 0, 1])
    do(document, "grade", scope="scene", grade={"brightness": 0.2})
    later = Adjustment(rotation=(0.0, 1.0, 0.0, 0.0), translation=(0.0, 0.0, 2.0))
    for file, own in zip(document.files, (IDENTITY, before), strict=True):
        np.testing.assert_allclose(file.placement.linear, own.then(later).linear, atol=1e-12)
        np.testing.assert_allclose(file.placement.translation, own.then(later).translation, atol=1e-12)


def test_new_splats_belong_to_the_file_that_they_come_from(document, tmp_path):
    do(document, "select", by={"kind": "runs", "runs": [[A - 2, 5]]})
    do(document, "duplicate")
    assert document.owners[A + B :].tolist() == [0, 0, 1, 1, 1]
    assert document.file_counts == (A + 2, B + 3)
    do(document, "merge", path="c.ply")
    assert [file.name for file in document.files] == ["a.ply", "b.ply", "c.ply"]
    assert document.file_counts == (A + 2, B + 3, B)
    do(document, "show_file", file=1, shown=False)
    assert document.counts.shown == A + 2 + B
    document.jump(1)
    assert len(document.files) == 2 and len(document.owners) == A + B


def test_a_file_is_removed_and_brought_back(document, edit_helpers):
    do(document, "select_all")
    before = edit_helpers.everything(document)
    change = do(document, "remove_file", file=0)
    assert change.title == f"Remove a.ply, {A} splats"
    assert len(exported(document)) == B and document.counts.selected == B
    with pytest.raises(InputError, match=r"file 0 \(a\.ply\) was removed"):
        do(document, "show_file", file=0, shown=False)
    with pytest.raises(InputError, match=r"b\.ply is the only file"):
        do(document, "remove_file", file=1)
    with pytest.raises(InputError, match="file 2: there are 2 files, counted from 0"):
        do(document, "remove_file", file=2)
    document.undo()
    assert edit_helpers.everything(document) == before


def test_a_name_is_changed_and_a_file_selected(document):
    do(document, "rename_file", file=1, name="chair")
    assert document.files[1].name == "chair" and not document.history.unsaved
    change = do(document, "select_file", file=1)
    assert change.title == f"Select chair: {B} selected"
    assert selected(document) == list(range(A, A + B))
    do(document, "select_file", file=0, mode="add")
    assert len(selected(document)) == A + B


def test_a_recipe_repeats_it(document, parts, edit_helpers):
    do(document, "merge", path="c.ply")
    do(document, "place_file", file=2, **TURN)
    do(document, "lock_file", file=0, locked=True)
    do(document, "show_file", file=2, shown=False)
    do(document, "select_all")
    do(document, "duplicate")
    do(document, "remove_file", file=1)
    again = Document(
        concatenate([*parts]), files=(("a.ply", A), ("b.ply", B)), load=lambda path, room: parts[1]
    )
    replay(replace(recipe_of(document), folder=None), again)
    assert edit_helpers.everything(again) == edit_helpers.everything(document)
