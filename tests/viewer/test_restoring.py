"""Edits that a crash left: restored with the files as they were, whatever has been saved over them since."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from splatview.edit.journal import find_abandoned_journals
from splatview.edit.operations import operation_from_json
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.user_dirs import config_folder
from splatview.viewer.editing import saving
from splatview.viewer.editing.edit_session import EditSession
from splatview.viewer.editing.files import Restoring, described, look_for_abandoned, restore
from splatview.viewer.editing.saving import Saving, has_unsaved_edits
from splatview.viewer.editing.session import JOURNALS, Editing, session_of
from splatview.viewer.open import begin_demo, open_paths
from splatview.viewer.state import AppState

A, B = 40, 15


@pytest.fixture
def files(tmp_path, random_gaussians) -> list[Path]:
    paths = [tmp_path / "a.ply", tmp_path / "b.ply"]
    for seed, (path, count) in enumerate(zip(paths, (A, B), strict=True)):
        save_scene(random_gaussians(count, seed=seed), path)
    return paths


def settle(app: AppState) -> None:
    """Runs frames until nothing is under way."""
    limit = time.monotonic() + 200
    while True:
        app.run_posted()
        app.feature(Restoring).before_frame(app)
        app.feature(Editing).before_frame(app)
        session = session_of(app)
        if app.loading is None and (session is None or (session.job is None and session.loading is None)):
            return
        assert time.monotonic() < limit, "it does not end"
        time.sleep(0.002)


def do(session: EditSession, op: str, **fields) -> None:
    assert session.apply(operation_from_json({"op": op, **fields})), session.problem


def crash(app: AppState, tmp_path: Path) -> None:
    """Leaves the journal as a killed process does: its folder is put back after the session was closed."""
    folder = config_folder() / JOURNALS
    shutil.copytree(folder, tmp_path / "left")
    session = session_of(app)
    assert session is not None
    session.document.history.mark_saved()
    app.feature(Editing).leave()
    assert list(folder.iterdir()) == [], "what ends well leaves nothing"
    shutil.rmtree(folder)
    (tmp_path / "left").rename(folder)


def opened(app: AppState, paths: list[Path], wait_for_loading) -> EditSession:
    open_paths(app, paths)
    wait_for_loading(app)
    session = session_of(app)
    assert session is not None
    return session


def test_edits_after_saving_over_the_file_are_restored(app, files, tmp_path, wait_for_loading):
    session = opened(app, files[:1], wait_for_loading)
    path, before = files[0], load_scene(files[0])
    do(session, "select", by={"kind": "runs", "runs": [[3, 5]]})
    do(session, "delete")
    saving.save(app)
    saving.overwrite(app)
    settle(app)
    assert len(load_scene(path)) == A - 5 and not has_unsaved_edits(app)
    do(session, "transform", scope="scene", translation=[1, 0, 0])
    crash(app, tmp_path)

    look_for_abandoned(app)
    (journal,) = app.feature(Restoring).abandoned
    restore(app, journal)
    wait_for_loading(app)
    settle(app)
    session = session_of(app)
    assert session is not None and app.problem is None
    assert app.scene.paths == (path,) and app.scene.name == "a.ply"
    assert app.preferences.recent == (str(path),), "the copy is no file of the user's"
    assert session.document.counts.kept == A - 5 and has_unsaved_edits(app)
    session.undo()
    assert not has_unsaved_edits(app), "that is what the file holds"
    session.undo()
    assert has_unsaved_edits(app)
    np.testing.assert_array_equal(session.gaussians.means, before.means)
    session.redo()
    session.redo()
    app.feature(Saving).agreed = path
    saving.save(app)
    settle(app)
    np.testing.assert_allclose(load_scene(path).means[:3], before.means[:3] + np.array([1, 0, 0]), atol=1e-6)
    assert len(find_abandoned_journals(config_folder() / JOURNALS)) == 0
    app.feature(Editing).leave()
    assert list((config_folder() / JOURNALS).iterdir()) == []


def test_a_scene_of_several_files_is_restored(app, files, tmp_path, wait_for_loading):
    session = opened(app, files, wait_for_loading)
    assert session.document.file_counts == (A, B)
    do(session, "merge", path=str(files[1]))
    do(session, "place_file", file=1, translation=[0, 2, 0])
    do(session, "lock_file", file=0, locked=True)
    files_then, journal_path = session.document.files, files[1]
    session.before_writing(journal_path)
    save_scene(load_scene(files[0]), journal_path)  # both the second file and the third
    crash(app, tmp_path)

    look_for_abandoned(app)
    (journal,) = app.feature(Restoring).abandoned
    restore(app, journal)
    wait_for_loading(app)
    settle(app)
    session = session_of(app)
    assert session is not None and app.problem is None
    assert session.document.file_counts == (A, B, B)
    assert [file.placement for file in session.document.files] == [file.placement for file in files_then]
    assert [file.name for file in session.document.files] == [file.name for file in files_then]
    assert session.document.files[0].locked
    assert app.scene.paths == tuple(files)


def test_edits_of_the_demo_are_restored_after_the_question_about_others(
    app, files, tmp_path, wait_for_loading, random_gaussians, monkeypatch
):
    monkeypatch.setattr("splatview.viewer.loading.cached_demo", lambda **_: random_gaussians(A, seed=7))
    begin_demo(app)
    wait_for_loading(app)
    session = session_of(app)
    assert session is not None and app.scene.name == "Demo"
    do(session, "select", by={"kind": "runs", "runs": [[3, 5]]})
    do(session, "delete")
    crash(app, tmp_path)

    other = opened(app, files[:1], wait_for_loading)
    do(other, "transform", scope="scene", translation=[1, 0, 0])
    look_for_abandoned(app)
    (journal,) = app.feature(Restoring).abandoned
    assert described(journal).startswith("Demo: 2 steps")
    restore(app, journal)
    assert app.feature(Saving).question == "leave" and app.loading is None
    saving.leave_unsaved(app)
    app.run_posted()
    wait_for_loading(app)
    settle(app)
    session = session_of(app)
    assert session is not None and app.problem is None
    assert app.scene.name == "Demo" and session.document.counts.kept == A - 5 and has_unsaved_edits(app)
    assert not journal.file.exists(), "its steps are in the journal of this session"
    session.undo()
    assert session.document.counts.kept == A
