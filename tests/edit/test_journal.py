"""Autosave: what a crash leaves can be restored; what ended well leaves nothing."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from splatview.edit.document import Document
from splatview.edit.journal import Journal, find_abandoned_journals
from splatview.edit.operations import operation_from_json
from splatview.edit.recipe import check_scene, replay

SELECT = {"op": "select", "by": {"kind": "sphere", "centre": [0.1, 0, 0], "radius": 0.7}}
TURN = {"op": "transform", "rotation": [0.9, 0.1, 0.2, 0.3], "translation": [0.1, 0.2, 0.3], "scale": 1.1}

PROGRAM = """
import os, signal, sys
from pathlib import Path
from splatview.edit.document import Document
from splatview.edit.journal import Journal
from splatview.edit.operations import operation_from_json
from splatview.scene.formats import load_scene

scene, folder = map(Path, sys.argv[1:])
document = Document(load_scene(scene), name=scene.name)
journal = Journal(document, folder, scenes=[scene])
for step in (%r, %r, {"op": "select_all"}, {"op": "delete"}):
    document.apply(operation_from_json(step))
document.undo()
document.undo()
print("ready", flush=True)
sys.stdin.readline()
os.kill(os.getpid(), signal.SIGKILL)
""" % (SELECT, TURN)  # noqa: UP031, the program is full of braces


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_what_a_killed_program_did_comes_back(tmp_path: Path, scene_file, edit_helpers):
    from splatview.scene.formats import load_scene

    scene, folder = scene_file(), tmp_path / "cache" / "journals"
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, scene, folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert program.stdin is not None and program.stdout is not None
    assert program.stdout.readline() == "ready\n"
    assert find_abandoned_journals(folder) == []
    program.communicate("now\n")
    assert program.returncode == -signal.SIGKILL

    (journal,) = find_abandoned_journals(folder)
    assert journal.scene == scene
    document = Document(load_scene(scene), name=scene.name)
    check_scene(journal.recipe, document)
    replay(journal.recipe, document)
    by_hand = Document(load_scene(scene), name=scene.name)
    for step in (SELECT, TURN):
        by_hand.apply(operation_from_json(step))
    assert edit_helpers.everything(document) == edit_helpers.everything(by_hand)
    journal.discard()
    assert find_abandoned_journals(folder) == []


SAVES = """
import os, signal, sys
from pathlib import Path
from splatview.edit.document import Document, export
from splatview.edit.journal import Journal
from splatview.edit.operations import operation_from_json
from splatview.scene.formats import load_scene

scene, folder, after = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
document = Document(load_scene(scene), name=scene.name)
journal = Journal(document, folder, scenes=[scene])
for step in (SELECT, {"op": "delete"}, {"op": "add_crop", "crop": {"half_extents": [0.6, 0.6, 0.6]}}):
    document.apply(operation_from_json(step))
journal.keep(scene)
export(document, scene)
journal.saved(scene)
if after == "edits":
    for step in ({"op": "remove_crop", "index": 0}, {"op": "transform", "scope": "scene", "scale": 2}):
        document.apply(operation_from_json(step))
elif after == "undo":
    document.undo()
elif after == "select":
    document.apply(operation_from_json({"op": "select_all"}))
os.kill(os.getpid(), signal.SIGKILL)
""".replace("SELECT", repr(SELECT))

NO_LINKS = """
import os
def fail(*_): raise OSError(1, "no links")
os.link = fail
"""


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
@pytest.mark.parametrize(
    ("after", "before"), [("edits", ""), ("edits", NO_LINKS), ("undo", ""), ("select", ""), ("nothing", "")]
)
def test_a_kill_after_saving_over_the_file_costs_no_edit(
    tmp_path: Path, scene_file, edit_helpers, after, before
):
    from splatview.scene.formats import load_scene

    scene, folder = scene_file(), tmp_path / "journals"
    original = scene.read_bytes()
    done = subprocess.run([sys.executable, "-c", before + SAVES, scene, folder, after], check=False)
    assert done.returncode == -signal.SIGKILL
    assert scene.read_bytes() != original, "saved"
    left = find_abandoned_journals(folder)
    if after in ("nothing", "select"):
        assert left == [] and list(folder.iterdir()) == [], "all of it is in the file"
        return
    (journal,) = left
    (opened,) = journal.opened
    assert opened.read_bytes() == original
    assert (journal.saved, journal.saved_at) == (scene, 3)
    document = Document(load_scene(opened), name=scene.name)
    check_scene(journal.recipe, document)
    replay(journal.recipe, document)
    by_hand = Document(load_scene(opened), name=scene.name)
    steps = [SELECT, {"op": "delete"}, {"op": "add_crop", "crop": {"half_extents": [0.6, 0.6, 0.6]}}]
    steps += [{"op": "remove_crop", "index": 0}, {"op": "transform", "scope": "scene", "scale": 2}]
    for step in steps if after == "edits" else steps[:2]:
        by_hand.apply(operation_from_json(step))
    assert edit_helpers.everything(document) == edit_helpers.everything(by_hand)
    journal.discard()
    assert list(folder.iterdir()) == []


def test_a_merged_file_that_is_written_over_is_kept_too(document, tmp_path, scene_file):
    other = scene_file("other.ply", count=7)
    content = other.read_bytes()
    journal = Journal(document, tmp_path / "journals")
    document.apply(operation_from_json({"op": "merge", "path": str(other)}))
    journal.keep(tmp_path / "elsewhere.ply")
    journal.keep(other)
    other.unlink()
    other.write_bytes(b"something else")
    forget(journal)
    (found,) = find_abandoned_journals(tmp_path / "journals")
    assert found.source(other).read_bytes() == content
    assert found.source(tmp_path / "elsewhere.ply") == tmp_path / "elsewhere.ply"
    journal.close()
    assert list((tmp_path / "journals").iterdir()) == []


def test_a_journal_of_before_there_were_several_files_is_read(document, tmp_path):
    journal = Journal(document, tmp_path, scenes=[tmp_path / "a.ply"])
    document.apply(operation_from_json(SELECT))
    forget(journal)
    (path,) = tmp_path.iterdir()
    lines = path.read_text().splitlines(keepends=True)
    head = json.loads(lines[0])
    head["path"] = head.pop("paths")[0]
    path.write_text("".join([json.dumps(head) + "\n", *lines[1:]]))
    (found,) = find_abandoned_journals(tmp_path)
    assert found.scenes == (tmp_path / "a.ply",) and len(found.recipe.steps) == 1


@pytest.fixture
def document(edit_helpers) -> Document:
    return Document(edit_helpers.make_scene(20), folder=Path("somewhere"))


def steps_left(tmp_path: Path) -> list[str]:
    (journal,) = find_abandoned_journals(tmp_path)
    return [step.op for step in journal.recipe.steps]


def forget(journal: Journal) -> None:
    """Lets go of the file as a crash does."""
    assert journal._file is not None and journal._syncing is not None
    journal._syncing.join()
    journal._file.close()


def test_closing_leaves_nothing(document, tmp_path):
    journal = Journal(document, tmp_path / "journals")
    assert not (tmp_path / "journals").exists()
    document.apply(operation_from_json(SELECT))
    assert len(list((tmp_path / "journals").iterdir())) == 1
    journal.close()
    assert list((tmp_path / "journals").iterdir()) == []
    document.apply(operation_from_json(TURN))
    assert list((tmp_path / "journals").iterdir()) == []


def test_previews_are_no_steps_until_committed(document, tmp_path):
    journal = Journal(document, tmp_path)
    document.apply(operation_from_json(SELECT))
    document.preview(operation_from_json(TURN))
    document.preview(operation_from_json(TURN))
    document.cancel_preview()
    document.preview(operation_from_json({**TURN, "scale": 2}))
    document.commit_preview()
    forget(journal)
    assert steps_left(tmp_path) == ["select", "transform"]
    assert find_abandoned_journals(tmp_path)[0].recipe.folder == Path("somewhere").absolute()


def test_what_was_undone_and_done_otherwise(document, tmp_path):
    document.apply(operation_from_json({"op": "select_all"}))
    journal = Journal(document, tmp_path)
    document.apply(operation_from_json(TURN))
    document.apply(operation_from_json({"op": "hide"}))
    document.jump(1)
    document.apply(operation_from_json({"op": "delete"}))
    forget(journal)
    assert steps_left(tmp_path) == ["select_all", "delete"]


def test_nothing_in_force_is_nothing_to_restore(document, tmp_path):
    journal = Journal(document, tmp_path)
    document.apply(operation_from_json(SELECT))
    document.undo()
    forget(journal)
    assert find_abandoned_journals(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("cut", range(1, 60, 7))
def test_a_line_cut_short_costs_only_itself(document, tmp_path, cut):
    journal = Journal(document, tmp_path)
    document.apply(operation_from_json(SELECT))
    document.apply(operation_from_json(TURN))
    forget(journal)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-cut])
    assert steps_left(tmp_path) == ["select"]


@pytest.mark.parametrize(
    "content", [b"", b"\n", b"{}\n", b"\x00\xff\n{}\n", b"[1]\n", b'{"splatview_journal": 9}\n']
)
def test_other_files_are_passed_over(document, tmp_path, content):
    (tmp_path / "x.journal.jsonl").write_bytes(content)
    (tmp_path / "y.journal.jsonl").mkdir()
    assert find_abandoned_journals(tmp_path) == []
    assert find_abandoned_journals(tmp_path / "nowhere") == []


def test_a_place_that_cannot_be_written_to_is_no_obstacle(document, tmp_path):
    (tmp_path / "file").write_bytes(b"")
    journal = Journal(document, tmp_path / "file" / "journals")
    document.apply(operation_from_json(SELECT))
    document.apply(operation_from_json(TURN))
    assert document.history.position == 2
    assert journal.problem is not None and "not autosaved" in journal.problem
    journal.close()
