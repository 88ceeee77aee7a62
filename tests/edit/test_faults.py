"""Whatever fails while a step is applied or taken back, the document is as it was before."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from splatview.edit import changes
from splatview.edit.document import Document
from splatview.edit.operations import OPERATIONS, operation_from_json
from splatview.edit.state import State
from splatview.scene import InputError

CAMERA = {
    "width": 16,
    "height": 16,
    "fx": 16,
    "fy": 16,
    "cx": 8,
    "cy": 8,
    "world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]],
}
FIELDS: dict[str, dict[str, Any]] = {
    "select": {"by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 0.9}},
    "grow": {"distance": 0.6},
    "shrink": {"distance": 0.6},
    "add_crop": {"crop": {"half_extents": [0.7, 0.7, 0.7]}},
    "change_crop": {"index": 0, "crop": {"half_extents": [0.5, 0.5, 0.5]}},
    "enable_crop": {"index": 0, "enabled": False},
    "remove_crop": {"index": 0},
    "transform": {"scope": "scene", "scale": 2},
    "orient": {"up": [1, 0, 0]},
    "ground": {"points": [[0, 1, 0], [1, 1, 0], [0, 1, 1]]},
    "size": {"value": 0.1, "how": "set", "scope": "scene"},
    "opacity": {"value": 0.5},
    "grade": {"grade": {"contrast": 2}},
    "select_detected": {"by": {"kind": "faint"}, "threshold": 3},
    "prune": {"by": {"kind": "faint"}, "threshold": 3},
    "decimate": {"keep": 25},
    "repair": {"finding": "quaternion lengths"},
    "merge": {"path": "other.ply"},
    "split": {"path": "part.ply"},
    "show_file": {"file": 0, "shown": False},
    "lock_file": {"file": 0, "locked": True},
    "place_file": {"file": 0, "rotation": [1, 2, 0, 0], "scale": 2},
    "rename_file": {"file": 0, "name": "other"},
    "remove_file": {"file": 0},
    "select_file": {"file": 1},
}


class Fault(Exception):
    pass


@pytest.fixture
def faults(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """`faults(k)`: the k-th alteration of the state from now on raises Fault."""
    left = [10**9]

    def failing(original: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            left[0] -= 1
            if left[0] == 0:
                raise Fault
            return original(*args, **kwargs)

        return call

    parts = (
        changes.Toggle,
        changes.Readjust,
        changes.Recrop,
        changes.Refile,
        changes.Rewrite,
        changes.Append,
        changes.SaveOnce,
    )
    for part in parts:
        for name in ("apply", "revert"):
            monkeypatch.setattr(part, name, failing(getattr(part, name)))

    def arm(after: int) -> None:
        left[0] = after

    yield arm


@pytest.fixture
def document(edit_helpers) -> Document:
    class Tools:
        def contributions(self, gaussians, cameras, edits):
            return np.arange(len(gaussians), dtype=np.float64)

    document = Document(
        edit_helpers.make_scene(30),
        files=(("a", 20), ("b", 10)),
        tools=Tools(),  # pyright: ignore[reportArgumentType]
        load=lambda path, room: edit_helpers.make_scene(5, seed=2),
        save=lambda scene, path: None,
    )
    for step in (
        {"op": "select", "by": {"kind": "runs", "runs": [[3, 3]]}},
        {"op": "hide"},
        {"op": "add_crop", "crop": {"half_extents": [0.8, 0.8, 0.8]}},
        {"op": "select", "by": {"kind": "runs", "runs": [[8, 15]]}},
        {"op": "transform", "translation": [0.1, 0, 0]},
    ):
        document.apply(operation_from_json(step))
    return document


@pytest.mark.parametrize("op", OPERATIONS)
def test_a_step_that_fails_leaves_no_trace(document, edit_helpers, faults, op):
    operation = operation_from_json({"op": op, **FIELDS.get(op, {})})
    before = edit_helpers.everything(document)
    parts = len(document.plan(operation).change.parts)
    position = document.history.position
    for k in range(1, parts + 1):
        faults(k)
        with pytest.raises(Fault):
            document.apply(operation)
        assert edit_helpers.everything(document) == before
        assert document.history.position == len(document.history.steps) == position
    faults(10**9)
    if not document.apply(operation).parts:
        return
    after = edit_helpers.everything(document)
    for k in range(1, parts + 1):
        faults(k)
        with pytest.raises(Fault):
            document.undo()
        assert edit_helpers.everything(document) == after
        assert document.history.position == position + 1
    faults(10**9)
    document.undo()
    for k in range(1, parts + 1):
        faults(k)
        with pytest.raises(Fault):
            document.redo()
        assert edit_helpers.everything(document) == before
        assert document.history.position == position


def test_memory_that_runs_out_while_splats_are_added(document, edit_helpers, monkeypatch):
    before = edit_helpers.everything(document)

    def exhausted(self: State, gaussians: Any, marks: Any = None) -> None:
        raise MemoryError

    monkeypatch.setattr(State, "set_scene", exhausted)
    with pytest.raises(MemoryError):
        document.apply(operation_from_json({"op": "duplicate"}))
    assert edit_helpers.everything(document) == before


def test_a_selector_that_fails_changes_nothing(document, edit_helpers):
    before = edit_helpers.everything(document)
    region = {"x0": 0, "y0": 0, "x1": 9, "y1": 9, "depth": "front", "camera": CAMERA}
    without_tools = Document(document.gaussians)
    for each in (without_tools,):
        with pytest.raises(InputError, match="needs a renderer"):
            each.apply(operation_from_json({"op": "select", "by": {"kind": "rectangle", **region}}))
        assert each.history.steps == []
    runs = {"kind": "runs", "runs": [[20, 20]]}
    with pytest.raises(InputError, match="another scene"):
        document.apply(operation_from_json({"op": "select", "by": runs}))
    assert edit_helpers.everything(document) == before
