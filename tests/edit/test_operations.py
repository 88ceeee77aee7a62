"""What operations do: to whom, with which numbers, and what they refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from splatview.edit.document import Document, exported
from splatview.edit.operations import OPERATIONS, operation_from_json
from splatview.edit.operations.appearance import LUMINANCE, Grade
from splatview.scene import Gaussians, InputError
from splatview.scene.edits import DELETED, HIDDEN, LOCKED, PREVIEW, SELECTED
from splatview.scene.projection import rotation_matrices


@pytest.fixture
def scene(edit_helpers) -> Gaussians:
    return edit_helpers.make_scene(30)


@pytest.fixture
def document(scene: Gaussians) -> Document:
    return Document(scene)


def do(document: Document, op: str, **fields: Any):
    return document.apply(operation_from_json({"op": op, **fields}))


def select(document: Document, *runs: tuple[int, int], mode: str = "set"):
    return do(document, "select", by={"kind": "runs", "runs": [list(run) for run in runs]}, mode=mode)


def having(document: Document, flag: int) -> list[int]:
    return np.flatnonzero(document.marks & flag).tolist()


def test_selections_combine(document):
    select(document, (0, 6))
    assert having(document, SELECTED) == [0, 1, 2, 3, 4, 5]
    select(document, (4, 4), mode="add")
    select(document, (0, 2), mode="remove")
    assert having(document, SELECTED) == [2, 3, 4, 5, 6, 7]
    select(document, (6, 10), mode="intersect")
    assert having(document, SELECTED) == [6, 7]
    do(document, "select_inverse")
    assert len(having(document, SELECTED)) == 28
    do(document, "select_none")
    assert having(document, SELECTED) == []
    assert do(document, "select_all").title == "Select all: 30 selected"


def test_hidden_deleted_and_locked_splats_are_left_alone(document):
    for run, op in (((0, 3), "hide"), ((3, 3), "delete"), ((6, 3), "lock")):
        select(document, run)
        do(document, op)
        assert having(document, SELECTED) == []
    do(document, "select_all")
    assert having(document, SELECTED) == list(range(9, 30))
    do(document, "select_inverse")
    assert having(document, SELECTED) == []
    do(document, "opacity", value=0, how="set", scope="scene")
    untouched = np.flatnonzero(document.marks >> 8 == 0).tolist()
    assert untouched == [3, 4, 5, 6, 7, 8]
    do(document, "show")
    do(document, "unlock")
    assert having(document, HIDDEN | LOCKED) == []
    assert having(document, DELETED) == [3, 4, 5]


def test_isolating_hides_all_else(document):
    select(document, (5, 2))
    do(document, "isolate")
    assert np.flatnonzero((document.marks & HIDDEN) == 0).tolist() == [5, 6]
    assert document.counts.shown == 2
    assert len(exported(document)) == 30


def test_what_alters_nothing_is_no_step(document):
    for op in ("delete", "hide", "show", "select_none", "duplicate"):
        assert do(document, op).parts == ()
    assert document.history.steps == []


def test_doing_something_new_forgets_what_could_be_redone(document):
    select(document, (0, 3))
    do(document, "delete")
    document.undo()
    do(document, "hide")
    assert document.redo() is None
    assert [step.title for step in document.history.steps] == [
        "Select by runs: 3 selected",
        "Hide 3 splats",
    ]


def test_transforms_of_a_selection_share_one_entry(document):
    turn = {"rotation": [0.9, 0.1, 0.2, 0.3], "translation": [1, 2, 3], "scale": 1.5, "pivot": [0, 1, 0]}
    select(document, (0, 10))
    for _ in range(20):
        do(document, "transform", **turn)
    assert len(document.palette) == 2
    do(document, "transform", scope="scene", scale=2)
    assert len(document.palette) == 3
    do(document, "select_all")
    do(document, "opacity", value=0.5)
    assert len(document.palette) == 3
    document.jump(0)
    assert len(document.palette) == 1


def test_equal_adjustments_meet_again(document):
    for start in (0, 10):
        select(document, (start, 5))
        do(document, "size", value=2)
    assert len(document.palette) == 2
    assert document.palette[1].size == 2
    select(document, (0, 5))
    do(document, "size", value=0.5)
    assert len(document.palette) == 2
    assert (document.marks[:5] >> 8 == 0).all()


def test_entries_that_become_one_come_apart_again(document):
    for start, value in ((0, 0.5), (10, 0.25)):
        select(document, (start, 5))
        do(document, "opacity", value=value)
    before = document.marks.copy()
    do(document, "opacity", value=1, how="set", scope="scene")
    # What was halved keeps its own ceiling of a half, and all else becomes opaque.
    document.undo()
    assert (document.marks == before).all()


def test_a_transform_goes_about_its_pivot(document, scene):
    pivot = np.array([0.5, -1.0, 2.0])
    quat = np.array([0.8, 0.0, 0.6, 0.0])
    do(
        document,
        "transform",
        scope="scene",
        rotation=(2 * quat).tolist(),
        translation=[0.25, 0, 0],
        scale=3,
        pivot=pivot.tolist(),
    )
    R = rotation_matrices(quat[None])[0]
    expected = pivot + [0.25, 0, 0] + 3 * (scene.means - pivot) @ R.T
    np.testing.assert_allclose(exported(document).means, expected, atol=1e-5)


def test_crops_move_with_the_scene(document, edit_helpers):
    do(document, "add_crop", crop={"half_extents": [0.6, 0.5, 0.7], "rotation": [0.8, 0, 0.6, 0]})
    do(document, "add_crop", crop={"shape": "sphere", "centre": [0.3, 0, 0], "keep": "outside"})
    do(
        document,
        "change_crop",
        index=1,
        crop={"shape": "sphere", "half_extents": [0.2, 0.2, 0.2], "keep": "outside"},
    )
    labels = exported(document).extras["label"].tolist()
    assert 0 < len(labels) < 30
    do(document, "transform", scope="scene", rotation=[1, 2, 3, 4], translation=[5, 6, 7], scale=0.3)
    assert exported(document).extras["label"].tolist() == labels
    do(document, "orient", up=[1, 1, 0])
    assert exported(document).extras["label"].tolist() == labels


def test_cropping_deselects_what_it_takes_from_sight(document):
    do(document, "select_all")
    do(document, "add_crop", crop={"half_extents": [0.5, 0.5, 0.5]})
    inside = np.flatnonzero((np.abs(document.gaussians.means) <= 0.5).all(axis=1)).tolist()
    assert having(document, SELECTED) == inside
    do(document, "select_none")
    do(document, "select_all")
    assert having(document, SELECTED) == inside


def test_making_a_crop_permanent_leaves_the_same_file(document, edit_helpers):
    select(document, (0, 5))
    do(document, "lock")
    do(document, "add_crop", crop={"half_extents": [0.8, 0.8, 0.8]})
    outside_locked = int((np.abs(document.gaussians.means[:5]) > 0.8).any(axis=1).sum())
    kept = len(exported(document))
    change = do(document, "delete_cropped")
    assert document.crops == ()
    assert len(exported(document)) == kept + outside_locked
    assert outside_locked > 0
    assert "locked" in change.notes[0]
    with pytest.raises(InputError, match="no crop"):
        do(document, "delete_cropped")


@pytest.mark.parametrize("up", [[0, -1, 0], [0, 1, 0], [1, 0, 0], [0.3, 0.5, -2]])
def test_orienting_turns_that_direction_up(document, scene, up):
    do(document, "orient", up=up)
    unit = np.array(up) / np.linalg.norm(up)
    before, after = scene.means @ unit, -exported(document).means[:, 1]
    np.testing.assert_allclose(after, before, atol=1e-6)


@pytest.mark.parametrize("flip", [False, True])
def test_the_ground_is_level_and_the_scene_above_it(edit_helpers, flip):
    scene = edit_helpers.make_scene(200)
    points = [[-1.0, 1.3, -1.0], [1.0, 1.1, -1.0], [0.0, 1.2, 1.0]]
    if flip:
        points.reverse()
    document = Document(scene)
    do(document, "ground", points=points)
    adjustment = document.palette[1]
    on_ground = np.array(points) @ adjustment.linear.T + np.array(adjustment.translation)
    np.testing.assert_allclose(on_ground[:, 1], 0, atol=1e-12)
    assert (exported(document).means[:, 1] < 0).mean() > 0.9


def test_sizes_are_set_whatever_was_done_before(document):
    select(document, (0, 10))
    do(document, "size", value=3)
    do(document, "transform", scale=2)
    do(document, "size", value=0.05, how="set")
    scales = exported(document).log_scales[:10]
    np.testing.assert_allclose(np.exp(scales.mean(axis=1)), 0.05, rtol=1e-5)
    assert np.ptp(scales, axis=1).min() > 0.01


def test_opacities_are_set_and_scaled(document):
    do(document, "opacity", value=0.25, how="set", scope="scene")
    select(document, (0, 5))
    do(document, "opacity", value=2)
    opacities = 1 / (1 + np.exp(-exported(document).opacity_logits))
    np.testing.assert_allclose(opacities[:5], 0.5, rtol=1e-5)
    np.testing.assert_allclose(opacities[5:], 0.25, rtol=1e-5)


def test_grades_do_what_their_names_say():
    grey, orange = np.full(3, 0.4), np.array([0.9, 0.5, 0.1])

    def graded(colour: np.ndarray, **fields: Any) -> np.ndarray:
        matrix = Grade(**fields).matrix
        return matrix[:, :3] @ colour + matrix[:, 3]

    np.testing.assert_allclose(Grade().matrix, np.eye(3, 4), atol=1e-15)
    np.testing.assert_allclose(graded(orange, brightness=0.1), orange + 0.1)
    np.testing.assert_allclose(graded(np.full(3, 0.5), contrast=3), 0.5)
    np.testing.assert_allclose(graded(orange, saturation=0), LUMINANCE @ orange)
    warm, magenta = graded(grey, temperature=0.5), graded(grey, tint=0.5)
    assert warm[0] > warm[1] > warm[2]
    assert magenta[1] < magenta[0] == magenta[2]
    assert LUMINANCE @ warm == pytest.approx(0.4)
    assert LUMINANCE @ magenta == pytest.approx(0.4)
    np.testing.assert_allclose(graded(np.full(3, 0.1), black=0.1, white=0.9), 0, atol=1e-15)
    np.testing.assert_allclose(graded(np.full(3, 0.9), black=0.1, white=0.9), 1)


def test_growing_and_shrinking(document, scene):
    select(document, (0, 1))
    do(document, "grow", distance=0.8)
    near = np.linalg.norm(scene.means - scene.means[0], axis=1) <= 0.8
    assert having(document, SELECTED) == np.flatnonzero(near).tolist()
    do(document, "select_all")
    do(document, "select_inverse")
    assert do(document, "shrink", distance=0.5).parts == ()


def test_pruning_takes_what_scores_above_the_threshold(document, scene):
    change = do(document, "prune", by={"kind": "faint"}, threshold=2.0)
    opacities = 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))
    assert having(document, DELETED) == np.flatnonzero(opacities < 0.5).tolist()
    assert change.title.startswith(f"Prune {change.count} splats by faint")


def test_what_a_detector_finds_is_selected_by_the_same_threshold(document):
    do(document, "select_detected", by={"kind": "faint"}, threshold=2.0)
    found = having(document, SELECTED)
    select(document, (0, 5))
    change = do(document, "select_detected", by={"kind": "faint"}, threshold=2.0, mode="add")
    both = having(document, SELECTED)
    assert both == sorted({0, 1, 2, 3, 4, *found})
    assert change.title == f"Add by faint: {len(both)} selected"
    do(document, "select_none")
    do(document, "prune", by={"kind": "faint"}, threshold=2.0)
    assert having(document, DELETED) == found


def test_selection_steps_are_named_by_what_is_selected_afterwards(document):
    titles = [
        select(document, (0, 20)).title,
        select(document, (18, 6)).title,
        select(document, (0, 3), mode="add").title,
        select(document, (0, 1), mode="remove").title,
        select(document, (1, 3), mode="intersect").title,
        do(document, "select_inverse").title,
        do(document, "grow", neighbours=30).title,
    ]
    counts = [20, 6, 9, 8, 2, 28, 30]
    assert [title.rpartition(": ")[2] for title in titles] == [f"{count} selected" for count in counts]


def test_decimating_keeps_the_splats_that_matter(scene):
    class Tools:
        def contributions(self, gaussians, cameras, edits):
            return np.arange(len(gaussians), dtype=np.float64)

    document = Document(scene, tools=Tools())  # pyright: ignore[reportArgumentType]
    select(document, (0, 2))
    do(document, "lock")
    do(document, "decimate", keep=20)
    assert having(document, DELETED) == list(range(2, 12))
    with pytest.raises(InputError, match="cannot be deleted"):
        do(document, "decimate", keep=1)


def test_highlights_are_no_edits(document, edit_helpers):
    select(document, (0, 3))
    do(document, "lock")
    planned = document.plan(operation_from_json({"op": "select_all"}))
    mask = np.zeros(30, bool)
    mask[2:6] = True
    assert document.highlight(mask) == 3
    assert having(document, PREVIEW) == [3, 4, 5]
    assert document.edits.flags & PREVIEW
    assert len(exported(document)) == 30
    document.apply(planned)
    assert having(document, PREVIEW) == []
    assert not document.edits.flags & PREVIEW


def test_what_was_planned_before_an_edit_is_refused(document):
    planned = document.plan(operation_from_json({"op": "select_all"}))
    select(document, (0, 3))
    with pytest.raises(InputError, match="in the meantime"):
        document.apply(planned)


def test_renderers_learn_what_changed(document):
    version = document.edits.marks_version
    select(document, (4, 2), (10, 3))
    assert document.edits.changed_since(version) == (4, 13)
    assert document.edits is document.edits
    do(document, "hide")
    document.undo()
    assert document.edits.changed_since(version) == (4, 13)
    crops = document.edits.crops_version
    do(document, "add_crop", crop={"half_extents": [9, 9, 9]})
    assert document.edits.crops_version > crops
    do(document, "duplicate")
    assert document.edits.changed_since(version) is None


def test_numbers_out_of_range_are_refused_with_what_came_before(document):
    with pytest.raises(InputError, match="range of numbers"):
        for _ in range(40):
            do(document, "transform", scope="scene", scale=1e9, translation=[1e15, 0, 0])
    assert len(document.history.steps) > 10
    assert all(np.isfinite(entry.translation).all() for entry in document.palette)


def test_every_operation_says_what_it_is():
    for name, cls in OPERATIONS.items():
        assert cls.op == name
        assert 10 < len(cls.summary) < 100
