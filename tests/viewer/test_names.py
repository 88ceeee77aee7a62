"""Names that others gave, in every panel that shows them: as they are, whatever they hold.

The panels are drawn by ImGui without a window.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from splatview.edit.journal import AbandonedJournal
from splatview.edit.operations import operation_from_json
from splatview.edit.recipe import Recipe
from splatview.scene import look_at
from splatview.scene.formats import save_scene
from splatview.scene.formats.cameras import camera_values
from splatview.viewer import layout, menus
from splatview.viewer import open as opening
from splatview.viewer.camera import CameraLists, go_to_bookmark
from splatview.viewer.dialogs import FileDialogs
from splatview.viewer.dialogs import loading as loading_dialog
from splatview.viewer.dialogs import problem as problem_dialog
from splatview.viewer.editing.files import Restoring
from splatview.viewer.editing.session import session_of
from splatview.viewer.panels import camera, crops, history, scene, statistics
from splatview.viewer.preferences import beside, with_recent
from splatview.viewer.state import AppState

NAME = "%s%n [b]##a###b \x1b[31m\u202e"
"""For printf, for ImGui's ids, for terminals, and for readers of text."""

BROKEN = NAME + "\udce9\0"
"""And what no text can hold."""


@pytest.fixture
def frame() -> Iterator[Callable[[Callable[[], object]], None]]:
    """`frame(draw)`: calls `draw` in a window of a frame that nobody sees."""
    context = imgui.create_context()
    io = imgui.get_io()
    io.display_size = imgui.ImVec2(900, 4000)
    io.set_ini_filename("")
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures

    def show(draw: Callable[[], object]) -> None:
        for _ in range(2):
            imgui.new_frame()
            imgui.set_next_window_size((800, 3900))
            imgui.begin("all")
            draw()
            imgui.end()
            imgui.render()

    yield show
    imgui.destroy_context(context)


@pytest.fixture
def opened(app, tmp_path, random_gaussians, wait_for_loading) -> AppState:
    path = tmp_path / f"{NAME}\udce9.ply"
    save_scene(replace(random_gaussians(50), comments=(BROKEN,)), path)
    bookmark = {"target": [0, 0, 0], "distance": 4, "rotation": np.eye(3).tolist(), "up": [0, -1, 0]}
    bookmark |= {"fov_y": 50, "shift": [0, 0], "squeeze": 1, "name": BROKEN}
    beside(path).write_text(json.dumps({"version": 1, "bookmarks": [bookmark, bookmark]}))
    opening.open_paths(app, [path])
    wait_for_loading(app)
    view = camera_values(look_at((0, 0, -4), (0, 0, 0), width=64, height=48)) | {"name": BROKEN}
    (tmp_path / "cameras.json").write_text(json.dumps([view, view]))
    lists = app.feature(CameraLists)
    lists.open(tmp_path / "cameras.json")
    while lists.busy(app):
        lists.before_frame(app)
    session = session_of(app)
    assert session is not None
    for _ in range(2):
        crop = {"name": NAME, "half_extents": [9, 9, 9]}
        assert session.apply(operation_from_json({"op": "add_crop", "crop": crop}))
    session.forms.crop = 0
    return app


def test_names_are_shown_as_they_are(opened, frame, tmp_path, monkeypatch):
    app, session = opened, session_of(opened)
    assert session is not None
    path = app.scene.paths[0]
    monkeypatch.setattr(menus.imgui, "begin_menu", lambda *_: True)
    monkeypatch.setattr(menus.imgui, "end_menu", lambda: None)
    app.preferences = with_recent(app.preferences, path)
    journal = AbandonedJournal(
        file=tmp_path / "j\udce9", scenes=(path,), recipe=Recipe(steps=(), scene={}), time=0.0, kept={}
    )
    app.feature(Restoring).abandoned = [journal]
    app.dialog = "restore"
    go_to_bookmark(app, 0)
    app.complain(f"{path}: {BROKEN}")
    for draw in (
        camera.show_bookmarks,
        camera.cameras,
        lambda app: crops.show(app, session),
        history.show,
        history.show_restore,
        scene.show,
        statistics.show_messages,
        problem_dialog,
        menus.recent_files,
    ):
        frame(lambda draw=draw: draw(app))
    assert (
        app.problem is not None
        and app.problem.isprintable()
        and "\\x1b[31m\\u202e\\udce9\\x00" in app.problem
    )
    assert layout.title(app) == "• %s%n [b]##a###b \\x1b[31m\\u202e\\udce9.ply - splatview"
    assert all(message.text.isprintable() for message in app.messages)
    assert Path(path).exists()


def test_a_load_and_a_dialog_of_such_files(app, frame, tmp_path):
    broken = tmp_path / f"{BROKEN[:-1]}.ply"
    broken.write_bytes(b"ply")
    opening.open_paths(app, [broken])
    assert app.loading is not None
    app.loading.began -= 100
    frame(lambda: loading_dialog(app))
    dialogs = FileDialogs(tmp_path / "caf\udce9")
    dialogs.ask("Save", lambda paths: None, kind="save_scene", name="a.ply")
    frame(dialogs.show)
    assert dialogs.open
    dialogs.close()
