"""Exporting: what is written, and that the old file or the new one is there whatever happens."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from splatview.edit.document import Document, export
from splatview.edit.operations import operation_from_json
from splatview.scene import InputError
from splatview.scene.formats import load_scene


def do(document: Document, *steps: dict) -> None:
    for step in steps:
        document.apply(operation_from_json(step))


def test_only_deleted_and_cropped_splats_are_missing(scene_file, tmp_path, edit_helpers):
    path = scene_file()
    before = load_scene(path)
    document = Document(before)
    runs = {"kind": "runs", "runs": [[0, 5]]}
    do(document, {"op": "select", "by": runs}, {"op": "delete"})
    do(document, {"op": "select", "by": {"kind": "runs", "runs": [[5, 5]]}}, {"op": "hide"})
    do(document, {"op": "select", "by": {"kind": "runs", "runs": [[10, 5]]}}, {"op": "lock"})
    do(document, {"op": "add_crop", "crop": {"half_extents": [0.9, 9, 9]}})
    assert document.history.modified
    count = export(document, path)
    assert not document.history.modified
    kept = np.flatnonzero((np.arange(50) >= 5) & (np.abs(before.means[:, 0]) <= 0.9))
    assert count == len(kept)
    assert edit_helpers.scene_bytes(load_scene(path)) == edit_helpers.scene_bytes(before.take(kept))
    document.undo()
    assert document.history.modified


def test_what_counts_as_unsaved(scene_file, tmp_path):
    document = Document(load_scene(scene_file()))
    history, runs = document.history, {"kind": "runs", "runs": [[0, 5]]}
    do(document, {"op": "select", "by": runs}, {"op": "hide"})
    assert history.modified and not history.unsaved, "nothing that a file would show"
    do(document, {"op": "select", "by": {"kind": "runs", "runs": [[5, 5]]}}, {"op": "delete"})
    assert history.unsaved
    export(document, tmp_path / "rounded.splat")
    assert history.unsaved, "the file has less than the scene"
    export(document, tmp_path / "out.ply")
    assert not history.unsaved
    document.undo()
    assert history.unsaved, "the file has not what is seen"
    document.redo()
    assert not history.unsaved
    document.undo()
    do(document, {"op": "select_none"})
    assert history.unsaved, "the saved step is gone"


def test_an_unedited_scene_is_exported_as_it_is(scene_file, tmp_path, edit_helpers):
    path = scene_file()
    export(Document(load_scene(path)), tmp_path / "out.ply")
    assert (tmp_path / "out.ply").read_bytes() == path.read_bytes()


def test_nothing_is_no_scene(scene_file, tmp_path):
    document = Document(load_scene(scene_file()))
    do(document, {"op": "select_all"}, {"op": "delete"})
    with pytest.raises(InputError, match="nothing to export"):
        export(document, tmp_path / "out.ply")
    assert not (tmp_path / "out.ply").exists()
    assert document.history.modified


def test_a_preview_is_not_exported(scene_file, tmp_path):
    path = scene_file()
    document = Document(load_scene(path))
    document.preview(operation_from_json({"op": "transform", "scope": "scene", "scale": 2}))
    export(document, tmp_path / "out.ply")
    assert (tmp_path / "out.ply").read_bytes() == path.read_bytes()


def test_a_read_only_folder_keeps_the_old_file(scene_file, tmp_path, monkeypatch):
    path = scene_file()
    old = path.read_bytes()
    document = Document(load_scene(path))
    do(document, {"op": "transform", "scope": "scene", "scale": 2})
    if os.name == "posix" and os.geteuid() != 0:
        tmp_path.chmod(0o500)
    else:
        # Permissions do not bind root.
        def refuse(self: Path, target: Path) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(Path, "replace", refuse)
    try:
        with pytest.raises(InputError, match=r"scene\.ply: cannot be written: Permission denied"):
            export(document, path)
    finally:
        tmp_path.chmod(0o700)
    assert path.read_bytes() == old
    assert [file.name for file in tmp_path.iterdir()] == ["scene.ply"]
    assert document.history.modified


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from splatview.edit.document import Document
from splatview.edit.document import export
from splatview.edit.operations import operation_from_json
from splatview.scene import InputError
from splatview.scene.formats import load_scene

path = Path(sys.argv[1])
document = Document(load_scene(path))
document.apply(operation_from_json({"op": "transform", "scope": "scene", "scale": 2}))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
try:
    export(document, path)
except InputError as error:
    print(error)
"""


@pytest.mark.skipif(os.name != "posix", reason="limits of file sizes")
def test_a_full_disk_keeps_the_old_file(scene_file):
    path = scene_file()
    old = path.read_bytes()
    program = subprocess.run(
        [sys.executable, "-c", FULL_DISK, path], capture_output=True, text=True, timeout=60, check=True
    )
    assert "cannot be written" in program.stdout
    assert path.read_bytes() == old
    assert [file.name for file in path.parent.iterdir()] == [path.name]


EXPORTING = """
import os, sys
from pathlib import Path
from splatview.edit.document import Document
from splatview.edit.document import export
from splatview.edit.operations import operation_from_json
from splatview.scene.formats import load_scene

source, target = map(Path, sys.argv[1:])
document = Document(load_scene(source), name=source.name)
document.apply(operation_from_json({"op": "transform", "scope": "scene", "scale": 2}))
export(document, target)
print("ready", flush=True)
parent = os.getpid()
while True:
    pid = os.fork()
    if pid == 0:
        print(os.getpid(), flush=True)
        while os.getppid() == parent:
            export(document, target)
            document.undo() or document.redo()
        os._exit(0)
    os.waitpid(pid, 0)
"""


def kill_at_random(scene_file, tmp_path: Path, kills: int) -> None:
    """Kills a process that exports one scene and another in turn, at random moments of that."""
    source, target = scene_file("source.ply", count=3000, degree=3), tmp_path / "out.ply"
    twice = Document(load_scene(source))
    do(twice, {"op": "transform", "scope": "scene", "scale": 2})
    export(twice, tmp_path / "twice.ply")
    wanted = {source.read_bytes(), (tmp_path / "twice.ply").read_bytes()}
    rng = random.Random(5)
    program = subprocess.Popen(
        [sys.executable, "-c", EXPORTING, source, target], stdout=subprocess.PIPE, text=True
    )
    assert program.stdout is not None
    try:
        assert program.stdout.readline() == "ready\n"
        for _ in range(kills):
            child = int(program.stdout.readline())
            time.sleep(rng.uniform(0, 0.06))
            os.kill(child, signal.SIGKILL)
            assert target.read_bytes() in wanted
    finally:
        program.kill()
        program.wait()
        program.stdout.close()
    # Some were killed while they wrote.
    assert list(tmp_path.glob(".out.ply.*.tmp"))


@pytest.mark.skipif(sys.platform != "linux", reason="kills by signal")
def test_kills_leave_the_old_file_or_the_new_one(scene_file, tmp_path):
    kill_at_random(scene_file, tmp_path, 20)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="kills by signal")
def test_a_hundred_kills_leave_the_old_file_or_the_new_one(scene_file, tmp_path):
    kill_at_random(scene_file, tmp_path, 100)


def test_saved_scenes_share_no_memory_with_the_file(scene_file, tmp_path, edit_helpers):
    """Exporting over the file that is open must not change what is open."""
    path = scene_file()
    document = Document(load_scene(path))
    do(document, {"op": "select", "by": {"kind": "runs", "runs": [[0, 20]]}}, {"op": "delete"})
    before = edit_helpers.everything(document)
    export(document, path)
    assert edit_helpers.everything(document) == before
    document.undo()
    export(document, path)
    assert len(load_scene(path)) == 50
