"""Doing and undoing: whatever was done, taking it back leaves every byte as it was, and so does redoing."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.document import Document
from splatview.edit.operations import OPERATIONS, operation_from_json
from splatview.scene import Camera, Gaussians, InputError, look_at
from splatview.scene.edits import DELETED, FILE_HIDDEN, FILE_LOCKED, HIDDEN, LOCKED, SELECTED

COUNT = 40

coordinates = st.floats(-1.5, 1.5, width=32)
vectors = st.tuples(coordinates, coordinates, coordinates).map(list)
factors = st.floats(0.25, 4, width=32)
file_numbers = st.integers(0, 2)
scopes = st.sampled_from(["selection", "scene"])
quats = st.lists(st.floats(-1, 1, width=32), min_size=4, max_size=4).filter(lambda q: max(map(abs, q)) > 0.1)


def unit(quat: list[float]) -> list[float]:
    return (np.array(quat) / np.linalg.norm(quat)).tolist()


crops = st.fixed_dictionaries(
    {
        "shape": st.sampled_from(["box", "sphere"]),
        "centre": vectors,
        "half_extents": st.lists(st.floats(0.3, 1.5), min_size=3, max_size=3),
        "rotation": quats.map(unit),
        "keep": st.sampled_from(["inside", "outside"]),
        "enabled": st.booleans(),
    }
)
cameras = vectors.map(
    lambda eye: {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(look_at([0.1 + eye[0], eye[1], eye[2] - 4], eye, width=32, height=24)).items()
    }
)
selectors = st.one_of(
    st.fixed_dictionaries({"kind": st.just("sphere"), "centre": vectors, "radius": st.floats(0.1, 1.5)}),
    st.fixed_dictionaries(
        {
            "kind": st.just("box"),
            "centre": vectors,
            "half_extents": st.lists(st.floats(0.2, 1), min_size=3, max_size=3),
        }
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("runs"),
            "runs": st.lists(
                st.tuples(st.integers(0, COUNT // 2), st.integers(0, COUNT // 2)).map(list), max_size=5
            ),
        }
    ),
)


def steps(op: str, **fields: Any) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({"op": st.just(op), **fields})


OPERATION_STEPS = {
    "select": steps("select", by=selectors, mode=st.sampled_from(["set", "add", "remove", "intersect"])),
    **{
        op: steps(op)
        for op in (
            "select_all",
            "select_none",
            "select_inverse",
            "delete",
            "hide",
            "show",
            "lock",
            "unlock",
            "isolate",
            "delete_cropped",
            "duplicate",
        )
    },
    "grow": steps("grow", distance=st.floats(0.01, 1)),
    "shrink": steps("shrink", neighbours=st.integers(1, 5)),
    "add_crop": steps("add_crop", crop=crops),
    "change_crop": steps("change_crop", index=st.integers(0, 1), crop=crops),
    "enable_crop": steps("enable_crop", index=st.integers(0, 1), enabled=st.booleans()),
    "remove_crop": steps("remove_crop", index=st.integers(0, 1)),
    "transform": steps(
        "transform", scope=scopes, rotation=quats, translation=vectors, scale=factors, pivot=vectors
    ),
    "orient": steps("orient", up=vectors.filter(any), pivot=vectors),
    "ground": steps("ground", points=st.just([[0.0, 0.5, 0.0], [1.0, 0.25, 0.0], [0.0, 0.5, 1.0]])),
    "size": steps("size", value=factors, how=st.sampled_from(["scale", "set"]), scope=scopes),
    "opacity": steps(
        "opacity", value=st.floats(0, 1, width=32), how=st.sampled_from(["scale", "set"]), scope=scopes
    ),
    "grade": steps(
        "grade",
        grade=st.fixed_dictionaries(
            {
                "brightness": st.floats(-0.5, 0.5),
                "contrast": st.floats(0, 2),
                "saturation": st.floats(0, 2),
                "temperature": st.floats(-1, 1),
                "tint": st.floats(-1, 1),
                "black": st.floats(-0.2, 0.2),
                "white": st.floats(0.8, 1.2),
            }
        ),
        scope=scopes,
    ),
    "repair": steps(
        "repair", finding=st.sampled_from(["quaternion lengths", "needles", "rods", "duplicates", "giants"])
    ),
    "decimate": steps(
        "decimate", keep=st.integers(1, COUNT), cameras=st.lists(cameras, min_size=1, max_size=2)
    ),
    "merge": steps("merge", path=st.just("other.ply")),
    "split": steps("split", path=st.just("part.ply")),
    "show_file": steps("show_file", file=file_numbers, shown=st.booleans()),
    "lock_file": steps("lock_file", file=file_numbers, locked=st.booleans()),
    "place_file": steps("place_file", file=file_numbers, rotation=quats, translation=vectors, scale=factors),
    "rename_file": steps("rename_file", file=file_numbers, name=st.sampled_from(["a", "c"])),
    "remove_file": steps("remove_file", file=file_numbers),
    "select_file": steps("select_file", file=file_numbers, mode=st.sampled_from(["set", "add"])),
    "select_detected": steps(
        "select_detected",
        by=st.fixed_dictionaries({"kind": st.just("faint")}),
        threshold=st.floats(0, 1),
        mode=st.sampled_from(["set", "add", "remove", "intersect"]),
    ),
    "prune": steps(
        "prune",
        by=st.fixed_dictionaries({"kind": st.just("faint")}),
        threshold=st.floats(0, 1),
        cameras=st.builds(list),
    ),
}


class MadeUpTools:
    """Contributions that depend on no renderer."""

    def dominant_splats(self, gaussians: Gaussians, camera: Camera, edits: Any) -> np.ndarray:
        return np.arange(camera.width * camera.height, dtype=np.int32).reshape(camera.height, -1) % len(
            gaussians
        )

    def contributions(self, gaussians: Gaussians, cameras: Any, edits: Any) -> np.ndarray:
        return np.sin(np.arange(len(gaussians), dtype=np.float64)) ** 2

    def picture(self, gaussians: Gaussians, camera: Camera, edits: Any) -> np.ndarray:
        return np.zeros((camera.height, camera.width, 4), np.float32)


@pytest.fixture(scope="module")
def make_document(edit_helpers):
    scene = edit_helpers.make_scene(COUNT)
    other = edit_helpers.make_scene(7, degree=2, seed=3)

    def make(saved: list[Any] | None = None) -> Document:
        return Document(
            scene,
            files=(("a", COUNT - 9), ("b", 9)),
            tools=MadeUpTools(),
            load=lambda path, room: other,
            save=lambda part, path: None if saved is None else saved.append((part, path)),
        )

    return make


def apply(document: Document, step: dict[str, Any]) -> bool:
    """Whether it could be done: an index of a crop that there is not, say, is refused."""
    try:
        document.apply(operation_from_json(step))
    except InputError:
        return False
    return True


def invariants(document: Document) -> None:
    marks = document.marks
    hidden, locked = HIDDEN | FILE_HIDDEN, LOCKED | FILE_LOCKED
    assert not ((marks & SELECTED) != 0)[(marks & (hidden | DELETED | locked)) != 0].any()
    for number, file in enumerate(document.files):
        own = marks[document.owners == number]
        assert (((own & FILE_HIDDEN) != 0) == file.hidden).all()
        assert (((own & FILE_LOCKED) != 0) == file.locked).all()
        assert document.file_counts[number] == int(((own & DELETED) == 0).sum())
        assert not (file.removed and document.file_counts[number])
    assert len(document.owners) == len(marks)
    assert (marks >> 8).max(initial=0) < len(document.palette)
    flags = np.bitwise_or.reduce(marks & 255, initial=0)
    assert int(flags) & ~document.edits.flags == 0
    assert len(marks) == len(document.gaussians)
    counts = document.counts
    for flag, count in ((SELECTED, counts.selected), (DELETED, counts.deleted)):
        assert count == int(((marks & flag) != 0).sum())
    kept = marks[(marks & DELETED) == 0]
    assert counts.hidden == int(((kept & hidden) != 0).sum())
    assert counts.locked == int(((kept & locked) != 0).sum())
    assert counts.shown == int(((kept & hidden) == 0).sum())
    assert counts.selectable == int(((kept & (hidden | locked)) == 0).sum())


def test_every_operation_is_drawn():
    assert set(OPERATION_STEPS) == set(OPERATIONS)


@pytest.mark.parametrize("op", OPERATIONS)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_one_step_and_back_and_again(make_document, edit_helpers, op, data):
    document = make_document()
    before_steps = (
        *("select", "add_crop", "transform", "hide", "lock", "select", "duplicate"),
        *("show_file", "lock_file", "place_file", "merge"),
    )
    for before in data.draw(st.lists(st.sampled_from(before_steps), max_size=4)):
        apply(document, data.draw(OPERATION_STEPS[before]))
    if data.draw(st.booleans()):
        apply(document, {"op": "select_all"})
    before = edit_helpers.everything(document)
    position = document.history.position
    step = data.draw(OPERATION_STEPS[op])
    if not apply(document, step):
        assert edit_helpers.everything(document) == before
        return
    invariants(document)
    after = edit_helpers.everything(document)
    if document.history.position > position:
        document.undo()
        assert edit_helpers.everything(document) == before
        invariants(document)
        document.redo()
        assert edit_helpers.everything(document) == after


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_sequences_and_jumps(make_document, edit_helpers, data):
    document = make_document()
    seen = [edit_helpers.everything(document)]
    for op in data.draw(st.lists(st.sampled_from(sorted(OPERATIONS)), min_size=1, max_size=10)):
        position = document.history.position
        apply(document, data.draw(OPERATION_STEPS[op]))
        invariants(document)
        if document.history.position > position:
            seen.append(edit_helpers.everything(document))
    assert len(seen) == document.history.position + 1
    for position in data.draw(st.lists(st.integers(0, len(seen) - 1), max_size=5)):
        document.jump(position)
        assert edit_helpers.everything(document) == seen[position]
    document.jump(0)
    assert edit_helpers.everything(document) == seen[0]
    document.jump(len(seen) - 1)
    assert edit_helpers.everything(document) == seen[-1]


@pytest.mark.parametrize("op", OPERATIONS)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_json_there_and_back(op, data):
    step = data.draw(OPERATION_STEPS[op])
    operation = operation_from_json(step)
    text = json.dumps(operation.to_json(), allow_nan=False)
    again = operation_from_json(json.loads(text))
    assert json.dumps(again.to_json()) == text
    for key, value in step.items():
        if not isinstance(value, (dict, list)):
            assert json.loads(text)[key] == value


json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_damaged_steps_are_refused_or_done_and_nothing_else(make_document, edit_helpers, data):
    step = data.draw(OPERATION_STEPS[data.draw(st.sampled_from(sorted(OPERATIONS)))])
    place = step
    while True:
        key = data.draw(st.sampled_from(sorted(place)))
        if isinstance(place[key], dict) and place[key] and data.draw(st.booleans()):
            place = place[key]
            continue
        break
    place[key] = data.draw(json_values)
    document = make_document()
    document.apply(operation_from_json({"op": "select_all"}))
    before = edit_helpers.everything(document)
    try:
        document.apply(operation_from_json(step))
    except InputError as error:
        assert "\n" not in str(error)
        assert edit_helpers.everything(document) == before
    else:
        invariants(document)


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_previews_leave_no_trace(make_document, edit_helpers, data):
    document = make_document()
    apply(document, {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 1}})
    before = edit_helpers.everything(document)
    steps_shown = data.draw(
        st.lists(st.sampled_from(["transform", "add_crop", "opacity", "size"]), min_size=1)
    )
    last = {}
    for op in steps_shown:
        last = data.draw(OPERATION_STEPS[op])
        document.preview(operation_from_json(last))
    shown = edit_helpers.everything(document)
    assert document.history.position == 1
    if data.draw(st.booleans()):
        document.cancel_preview()
        assert edit_helpers.everything(document) == before
        apply(document, last)
    else:
        document.commit_preview()
    assert edit_helpers.everything(document) == shown
    document.jump(1)
    assert edit_helpers.everything(document) == before
