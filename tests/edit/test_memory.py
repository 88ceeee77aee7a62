"""What edits and their history may take of the memory: refused before it is taken, and nothing is lost."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from splatview.edit.document import Document
from splatview.edit.operations import operation_from_json
from splatview.edit.recipe import Recipe, recipe_of, replay, steps_from_json
from splatview.scene import InputError
from splatview.scene.formats import save_scene

MIB = 1 << 20


def do(document: Document, *steps: dict[str, Any]) -> None:
    for step in steps:
        document.apply(operation_from_json(step))


def peak(work: Callable[[], object]) -> int:
    """Most bytes that `work` held beyond those from before, of arrays too."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_duplicating_over_and_over_is_refused_before_memory_is_taken(edit_helpers):
    def again(document: Document) -> None:
        do(document, {"op": "select_all"})
        with pytest.raises(
            InputError, match=r"takes 4.7 MiB of memory, and editing has 1.2 MiB left: select fewer"
        ):
            for _ in range(16):
                do(document, {"op": "duplicate"}, {"op": "select_all"})

    again(Document(edit_helpers.make_scene(1000), budget=4 * MIB))  # compiling takes memory too
    document = Document(edit_helpers.make_scene(1000), budget=4 * MIB)
    assert peak(lambda: again(document)) < 4 * MIB
    before = edit_helpers.everything(document)
    assert len(document.gaussians) == 16_000
    with pytest.raises(InputError, match=r"takes 4\.7 MiB"):
        do(document, {"op": "duplicate"})
    assert edit_helpers.everything(document) == before
    document.jump(0)
    assert len(document.gaussians) == 1000


def test_steps_that_add_few_splats_keep_no_scenes(edit_helpers):
    document = Document(edit_helpers.make_scene(20_000))
    do(document, {"op": "select", "by": {"kind": "runs", "runs": [[3, 2]]}})

    def some() -> None:
        for _ in range(20):
            do(document, {"op": "duplicate"})

    assert peak(some) < 4 * document.gaussians.nbytes
    assert document.history.nbytes < document.gaussians.nbytes / 10
    grown = edit_helpers.everything(document)
    document.jump(0)
    document.jump(21)
    assert edit_helpers.everything(document) == grown


def test_merging_a_scene_of_other_types_is_undone_to_the_bit(edit_helpers):
    """Degree, precision and extras of the longer scene are others: what was there before is kept."""
    other = edit_helpers.make_scene(7, degree=2, seed=3)
    other.extras.clear()
    vars(other)["means"] = other.means.astype("f8")
    document = Document(edit_helpers.make_scene(30), load=lambda path, room: other)
    before = edit_helpers.everything(document)
    do(document, {"op": "merge", "path": "other.ply"})
    assert (document.gaussians.sh.shape[1], document.gaussians.means.dtype, document.gaussians.extras) == (
        9,
        "f8",
        {},
    )
    after = edit_helpers.everything(document)
    document.undo()
    assert edit_helpers.everything(document) == before
    document.redo()
    assert edit_helpers.everything(document) == after


def test_the_oldest_steps_become_final_when_undo_has_used_up_its_memory(edit_helpers):
    document = Document(edit_helpers.make_scene(5000), budget=MIB)
    for value in range(1, 7):
        do(document, {"op": "size", "value": value, "how": "set", "scope": "scene"})
    history = document.history
    assert (history.floor, history.position) == (2, 6)
    assert history.nbytes <= 0.5 * MIB
    assert [step["value"] for step in recipe_of(document).to_json()["steps"]] == [1, 2, 3, 4, 5, 6]
    with pytest.raises(InputError, match=r"the oldest steps \(2\) can no longer be undone"):
        document.jump(1)
    while document.undo():
        pass
    assert history.position == 2 and history.modified
    while document.redo():
        pass
    assert history.position == 6


def test_the_last_step_can_be_undone_whatever_it_takes(edit_helpers):
    document = Document(edit_helpers.make_scene(5000), budget=0.5 * MIB)
    document.budget = 1000
    do(document, {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 0.9}})
    document.budget = 10
    do(document, {"op": "hide"}, {"op": "show"})
    assert document.history.floor == 2
    assert document.undo() is not None


def test_a_recipe_that_has_no_room_is_taken_back_whole(edit_helpers):
    document = Document(edit_helpers.make_scene(5000), budget=1.0 * MIB)
    do(document, {"op": "select_all"})
    before, position = edit_helpers.everything(document), document.history.position
    steps = [{"op": "size", "value": 0.1 * (1 + i % 3), "how": "set", "scope": "scene"} for i in range(40)]
    with pytest.raises(InputError, match=r"step \d+ \(size\): this takes"):
        replay(Recipe(steps=steps_from_json(steps, "r"), scene={}), document)
    assert edit_helpers.everything(document) == before
    assert (document.history.position, document.history.floor) == (position, 0)
    # Where nothing is to be undone the same steps need no memory.
    replay(Recipe(steps=steps_from_json(steps, "r"), scene={}), document, undo=False)
    assert (document.history.nbytes, document.history.floor) == (0, 41)


def test_a_scene_too_large_to_merge_is_refused_by_its_header(edit_helpers, tmp_path: Path):
    large = tmp_path / "large.ply"
    save_scene(edit_helpers.make_scene(10), large)
    start = large.read_bytes().replace(b"element vertex 10\n", b"element vertex 9000000\n")
    with open(large, "wb") as file:
        file.write(start)
        file.truncate(3 << 30)  # sparse
    document = Document(edit_helpers.make_scene(10), budget=10 * MIB, folder=tmp_path)

    def merge() -> None:
        with pytest.raises(InputError, match=r"large.ply: 9,000,000 rows of vertex need 927.0 MiB of memory"):
            do(document, {"op": "merge", "path": "large.ply"})

    assert peak(merge) < 2 * MIB


@pytest.mark.parametrize(
    "step", [{"op": "split", "path": "part.ply"}, {"op": "repair", "finding": "quaternion lengths"}]
)
def test_other_steps_that_make_arrays_are_refused_too(edit_helpers, step):
    document = Document(edit_helpers.make_scene(5000), budget=0.2 * MIB)
    do(document, {"op": "select_all"})
    with pytest.raises(InputError, match="KiB of memory, and editing has 205 KiB left"):
        do(document, step)
    assert document.history.position == 1


def test_free_memory_is_what_the_system_says_or_a_guess(monkeypatch):
    from splatview.scene.formats import ply_body

    assert MIB < ply_body.free_memory() <= ply_body.physical_memory()
    files = {"meminfo": "MemTotal: 7 kB\nMemAvailable:   2048 kB\n", "memory.max": "max\n"}
    monkeypatch.setattr(Path, "read_text", lambda path: files.get(path.name, ""))
    assert ply_body.free_memory() == 2 * MIB
    files["memory.max"] = f"{MIB}\n"
    assert ply_body.free_memory() == ply_body.physical_memory() == MIB
    files.clear()
    monkeypatch.setattr(ply_body, "physical_memory", lambda: float("inf"))
    assert ply_body.free_memory() == 4 << 30
