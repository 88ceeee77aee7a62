"""Files that cannot be written, or that others change: nothing is half written or lost in silence."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.cli import train_setup
from splatview.cli.main import main
from splatview.cli.render import write_picture
from splatview.edit import journal as journals
from splatview.edit.document import Document
from splatview.edit.journal import Journal, find_abandoned_journals
from splatview.edit.operations import Delete, SelectAll, operation_from_json
from splatview.scene import Gaussians, InputError
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.formats.io import take_lock
from splatview.viewer import camera
from splatview.viewer import open as opening
from splatview.viewer.app import window_state
from splatview.viewer.editing import files, saving
from splatview.viewer.editing.files import Restoring
from splatview.viewer.editing.session import Editing, session_of
from splatview.viewer.preferences import Preferences, beside, load_bookmarks
from splatview.viewer.state import AppState

STEPS = ({"op": "select_all"}, {"op": "hide"}, {"op": "show"}, {"op": "select_all"}, {"op": "lock"})


@pytest.fixture
def scene(tmp_path: Path, random_gaussians: Callable[..., Gaussians]) -> Path:
    path = tmp_path / "scene.ply"
    save_scene(random_gaussians(60, sh_degree=1), path)
    return path


@pytest.fixture
def app(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene: Path) -> AppState:
    """A window's state with `scene` open, and without a picture."""
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(tmp_path / "config"))
    made = window_state(preferences=Preferences(smooth=False))
    opening.open_paths(made, [scene])
    run(made, lambda: made.loading is None)
    return made


def run(app: AppState, until: Callable[[], bool]) -> None:
    """The part of the frame loop that files need."""
    limit = time.monotonic() + 200
    while not until():
        assert time.monotonic() < limit
        opening.continue_loading(app)
        app.run_posted()
        app.feature(Editing).before_frame(app)
        time.sleep(0.002)


def save(app: AppState, path: Path) -> None:
    saving.write(app, path)
    run(app, lambda: (session := session_of(app)) is not None and session.job is None)
    app.feature(Editing).before_frame(app)


class FullDisk:
    """A file on a disk with so many bytes of room: a write may be cut short, and the next is refused."""

    def __init__(self, file: Any, room: int):
        self._file, self.room = file, room

    def write(self, data: bytes) -> int:
        if self.room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = self._file.write(data[: self.room])
        self.room -= written
        return written

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@pytest.mark.parametrize("room", [1, 40, 200, 260, 300, 350])
def test_a_disk_that_fills_up_under_the_journal(tmp_path, scene, monkeypatch, room) -> None:
    """What was written before is whole, and the user is told once that the rest is not autosaved."""
    document = Document(load_scene(scene), name=scene.name)
    journal = Journal(document, tmp_path / "journals", scenes=[scene])
    begin = journal._begin

    def begin_on_a_full_disk(done: int) -> None:
        open_file = open

        def limited(*arguments: Any, **options: Any) -> Any:
            return FullDisk(open_file(*arguments, **options), room)

        monkeypatch.setattr(journals, "take_lock", lambda file: True)
        monkeypatch.setattr("builtins.open", limited)
        try:
            begin(done)
        finally:
            monkeypatch.setattr("builtins.open", open_file)

    journal._begin = begin_on_a_full_disk
    done = []
    for step in STEPS:
        document.apply(operation_from_json(step))
        done.append(step["op"])
    assert journal.problem is not None and "No space left" in journal.problem and "\n" not in journal.problem
    assert document.history.position == len(STEPS), "editing goes on"
    (path,) = (tmp_path / "journals").iterdir()
    lines = path.read_bytes().split(b"\n")
    assert lines[-1] == b"", "no line is cut short"
    written = [json.loads(line)["do"]["op"] for line in lines[1:-1]]
    assert written == done[: len(written)] and len(written) < len(done)


def test_a_full_disk_while_saving_is_one_line_and_the_old_file_stays(app, tmp_path, monkeypatch) -> None:
    out = tmp_path / "out.ply"
    out.write_bytes(b"as it was")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        save(app, out)
    assert app.problem == f"{out}: cannot be written: No space left on device"
    assert out.read_bytes() == b"as it was"
    session = session_of(app)
    assert session is not None and session.document.history.modified is False
    assert not list(tmp_path.glob(".*.tmp"))
    app.problem = None
    save(app, out)
    assert app.problem is None and len(load_scene(out)) == 60


def test_a_scene_that_others_change_is_not_saved_over(app, scene, tmp_path, random_gaussians) -> None:
    before = app.scene.gaussians.means.copy()
    save_scene(random_gaussians(25, sh_degree=0), scene)
    theirs = scene.read_bytes()
    np.testing.assert_array_equal(app.scene.gaussians.means, before)
    session = session_of(app)
    assert session is not None
    session.apply(SelectAll())
    save(app, scene)
    assert "another program has changed it since it was opened here" in app.problem
    assert scene.read_bytes() == theirs
    app.problem = None
    save(app, tmp_path / "mine.ply")
    assert app.problem is None
    np.testing.assert_array_equal(load_scene(tmp_path / "mine.ply").means, before)
    # Opened again, it may be written over, also twice.
    opening.open_paths(app, [scene])
    run(app, lambda: app.loading is None)
    assert len(app.scene.gaussians) == 25
    for _ in range(2):
        save(app, scene)
        assert app.problem is None


def test_a_file_cut_off_in_place_hurts_nothing_that_is_open(app, scene, tmp_path) -> None:
    with open(scene, "r+b") as file:
        file.truncate(2000)
    assert np.isfinite(app.scene.gaussians.means).all()
    save(app, tmp_path / "mine.ply")
    assert len(load_scene(tmp_path / "mine.ply")) == 60
    opening.open_paths(app, [scene])
    run(app, lambda: app.loading is None)
    assert "truncated" in app.problem
    assert len(app.scene.gaussians) == 60, "the old scene stays"


def test_edits_of_a_scene_that_was_replaced_are_not_restored_onto_it(
    app, scene, random_gaussians, monkeypatch
) -> None:
    session = session_of(app)
    assert session is not None
    session.apply(SelectAll())
    session.apply(Delete())
    session.close()
    app.feature(Editing).session = None
    save_scene(random_gaussians(61, sh_degree=1, seed=9), scene)
    files.look_for_abandoned(app)
    (journal,) = app.feature(Restoring).abandoned
    files.restore(app, journal)
    run(app, lambda: app.loading is None)
    app.feature(Restoring).before_frame(app)
    assert "The scene has changed since it was edited" in app.problem
    session = session_of(app)
    assert session is not None and session.document.history.position == 0
    assert journal.file.exists(), "they may fit the file's backup"


CLAIMING = """
import sys, time
from pathlib import Path
from splatview.cli.train_setup import lock_run
lock_run(Path(sys.argv[1]))
print("mine", flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_two_runs_do_not_write_the_same_checkpoint(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(train_setup, "_held", {})
    ours = tmp_path / "toy.checkpoint.safetensors"
    other = subprocess.Popen([sys.executable, "-c", CLAIMING, str(ours)], stdout=subprocess.PIPE, text=True)
    assert other.stdout is not None and other.stdout.readline() == "mine\n"
    with pytest.raises(InputError, match=rf"process {other.pid}\) trains into it; wait for it, or name"):
        train_setup.lock_run(ours)
    train_setup.lock_run(tmp_path / "another.safetensors")
    other.kill()
    other.communicate()
    train_setup.lock_run(ours)
    train_setup.lock_run(ours)
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", "/proc/nowhere")
    train_setup.lock_run(tmp_path / "third.safetensors")
    for file in train_setup._held.values():
        file.close()


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_two_runs_do_not_write_the_same_scene_through_a_link(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(train_setup, "_held", {})
    ours = tmp_path / "toy.ply"
    (tmp_path / "link.ply").symlink_to(ours)
    with subprocess.Popen([sys.executable, "-c", CLAIMING, str(ours)], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline() == b"mine\n"
        assert main(["train", "nowhere", "--headless", "-o", str(tmp_path / "link.ply")]) == 2
        assert f"link.ply: another splatview (process {other.pid}) trains into it" in capsys.readouterr().err
        other.kill()
    for file in train_setup._held.values():
        file.close()


WRITING = """
import sys
from pathlib import Path
import numpy as np
from splatview.edit.document import Document
from splatview.edit.journal import Journal
from splatview.edit.operations import operation_from_json
from splatview.scene.formats import load_scene
from splatview.viewer.preferences import Bookmark, save_bookmarks
from splatview.viewer.navigation.view import look_from
from splatview.viewer.preferences import Preferences, save_preferences

scene, config, number = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
document = Document(load_scene(scene), name=scene.name)
journal = Journal(document, config / "journals", scenes=[scene])
view = look_from(*map(np.array, ((0.0, 0, 3), (0.0, 0, 0), (0.0, 1, 0))))
print("ready", flush=True)
while True:
    document.apply(operation_from_json({"op": "select_all"}))
    document.apply(operation_from_json({"op": "select_none"}))
    save_preferences(Preferences(fly_speed=float(number), recent=tuple("x" * 200 for _ in range(number))))
    save_bookmarks(scene, [Bookmark(name=f"{number}", view=view)] * number)
"""


def has_steps(folder: Path, *, count: int) -> list[bool]:
    """Of each journal, whether more than a step is in it; `count` there are to be."""
    sizes = [len(path.read_bytes().split(b"\n")) for path in folder.glob("*")]
    return [size > 5 for size in sizes] if len(sizes) == count else [False]


@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_programs_side_by_side_do_not_spoil_each_others_files(scene, tmp_path) -> None:
    config = tmp_path / "config"
    environment = dict(os.environ, SPLATVIEW_CONFIG_DIR=str(config))
    programs = [
        subprocess.Popen(
            [sys.executable, "-c", WRITING, scene, config, str(number)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in (1, 9)
    ]
    try:
        for program in programs:
            assert program.stdout is not None and program.stdout.readline() == "ready\n"
        marks = scene.with_name("scene.ply.bookmarks.json")
        limit = time.monotonic() + 200
        while not (marks.exists() and all(has_steps(config / "journals", count=2))):
            assert time.monotonic() < limit
            time.sleep(0.01)
        for _ in range(150):
            number = json.loads((config / "preferences.json").read_text())["fly_speed"]
            assert number in (1, 9)
            assert len(json.loads(marks.read_text())["bookmarks"]) in (1, 9)
        assert find_abandoned_journals(config / "journals") == [], "none is taken for a crashed one's"
        programs[0].kill()
        programs[0].wait()
        (left,) = find_abandoned_journals(config / "journals")
        assert left.scene == scene and len(left.recipe.steps) > 1
    finally:
        for program in programs:
            program.kill()
            program.wait()
            if program.stdout is not None:
                program.stdout.close()
    assert len(find_abandoned_journals(config / "journals")) == 2


def test_bookmarks_of_another_window_on_the_scene_stay(app, scene) -> None:
    camera.add_bookmark(app)
    other = window_state(preferences=Preferences(smooth=False))
    opening.open_paths(other, [scene])
    run(other, lambda: other.loading is None)
    camera.rename_bookmark(other, 0, "Door")
    camera.add_bookmark(other)
    camera.add_bookmark(app)
    names = sorted(bookmark.name for bookmark in load_bookmarks(scene))
    assert names == ["Door", "View 1", "View 2"], "theirs and ours, equal ones once"
    for _ in range(len(app.bookmarks)):
        camera.delete_bookmark(app, 0)
    assert load_bookmarks(scene) == [], "what is deleted does not come back"
    beside(scene).write_text("{ damaged")
    camera.add_bookmark(app)
    assert "is no bookmarks file" in (app.problem or "")
    assert beside(scene).read_text() == "{ damaged"


def test_a_journal_that_another_program_looks_at_as_it_begins_is_locked_all_the_same(
    tmp_path, scene, monkeypatch
) -> None:
    tries: list[bool] = []

    def taken(file: Any) -> bool:
        tries.append(len(tries) >= 3)
        return tries[-1] and take_lock(file)

    monkeypatch.setattr(journals, "take_lock", taken)
    document = Document(load_scene(scene), name=scene.name)
    journal = Journal(document, tmp_path / "journals", scenes=[scene])
    document.apply(SelectAll())
    monkeypatch.setattr(journals, "take_lock", take_lock)
    assert tries == [False, False, False, True]
    assert find_abandoned_journals(tmp_path / "journals") == []
    journal.close(keep=True)
    assert len(find_abandoned_journals(tmp_path / "journals")) == 1


def test_a_picture_that_has_no_room_is_one_line(tmp_path) -> None:
    """Arrays too: numpy says how many numbers went missing, and not why."""
    resource = pytest.importorskip("resource")
    picture = np.linspace(-1, 1, 64 * 64 * 4, dtype=np.float32).reshape(64, 64, 4)
    write_picture(picture, tmp_path / "whole.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "whole.npy"), picture)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        for name in ("p.npy", "p.png"):
            with pytest.raises(InputError, match=rf"{name}: cannot be written: File too large$"):
                write_picture(picture, tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == ["whole.npy"]
