"""Paths that lead nowhere, in circles, into locked folders, or to what never ends: one line, at once."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from splatview.cli import train_setup
from splatview.cli.main import main
from splatview.edit.document import Document
from splatview.edit.journal import Journal, find_abandoned_journals
from splatview.edit.operations import SelectAll
from splatview.renderers import demo_cache
from splatview.scene import Gaussians, InputError
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.formats.io import atomic_write, open_image
from splatview.scene.user_dirs import config_folder
from splatview.viewer import camera
from splatview.viewer import open as opening
from splatview.viewer.app import window_state
from splatview.viewer.editing import files, saving
from splatview.viewer.editing.session import Editing, session_of
from splatview.viewer.preferences import (
    Preferences,
    beside,
    in_config,
    load_bookmarks,
    load_preferences,
    save_bookmarks,
    save_preferences,
)
from splatview.viewer.save import next_free, write_png
from splatview.viewer.state import AppState

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="kinds of files, and rights, as Linux has them"
)

LIMIT_SECONDS = 30
"""A wait without end is broken off then."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The working directory."""
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    yield tmp_path
    with contextlib.suppress(OSError):
        (tmp_path / "locked").chmod(0o700)


@pytest.fixture
def scene(place: Path, random_gaussians: Callable[..., Gaussians]) -> Path:
    save_scene(random_gaussians(20, sh_degree=0), place / "s.ply")
    (place / "r.json").write_text('{"splatview_recipe": 1, "steps": [{"op": "select_all"}]}')
    return place / "s.ply"


@contextlib.contextmanager
def ordinary_user() -> Iterator[None]:
    """Without root's right to read and write everything (capabilities DAC_OVERRIDE and DAC_READ_SEARCH)."""
    if os.geteuid() != 0:
        yield
        return
    libc = ctypes.CDLL(None)
    header, capabilities = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, capabilities) == 0
    effective = capabilities[0]
    capabilities[0] = effective & ~0b110
    assert libc.capset(header, capabilities) == 0
    try:
        yield
    finally:
        capabilities[0] = effective
        assert libc.capset(header, capabilities) == 0


@contextlib.contextmanager
def no_endless_wait() -> Iterator[None]:
    def ended(*_: object) -> None:
        raise AssertionError("it waits without end")

    before = signal.signal(signal.SIGALRM, ended)
    signal.alarm(LIMIT_SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


BAD = ("long", "in a long one", "loop", "in a loop", "locked", "pipe", "/dev/zero", "/dev/stdin")


def bad_path(place: Path, kind: str, suffix: str) -> str:
    """A path with which nothing can be done, for reading nor writing."""
    if kind == "locked":
        folder = place / "locked"
        folder.mkdir(exist_ok=True)
        folder.chmod(0o000)
        return str(folder / f"file{suffix}")
    if kind in ("loop", "in a loop"):
        (place / f"loop{suffix}").symlink_to(f"loop{suffix}")
        return str(place / f"loop{suffix}" / ("" if kind == "loop" else f"file{suffix}"))
    if kind == "pipe":
        os.mkfifo(place / f"pipe{suffix}")
        return str(place / f"pipe{suffix}")
    return {"long": "x" * 300 + suffix, "in a long one": "x" * 300 + "/file" + suffix}.get(kind, kind)


INPUTS = {
    "info": (".ply", ["info", "BAD"]),
    "convert": (".ply", ["convert", "BAD", "o.ply"]),
    "scene of edit": (".ply", ["edit", "BAD", "--recipe", "r.json", "-o", "o.ply"]),
    "recipe": (".json", ["edit", "s.ply", "--recipe", "BAD", "-o", "o.ply"]),
    "scene of render": (".ply", ["render", "BAD", "-o", "o.png"]),
    "camera": (".json", ["render", "s.ply", "-o", "o.png", "--camera", "BAD"]),
    "COLMAP": (".bin", ["render", "s.ply", "-o", "o.png", "--camera", "BAD"]),
    "background": (".png", ["render", "s.ply", "-o", "o.png", "--background", "BAD"]),
    "ladder": (".ply", ["ladder", "BAD", "--renderers", "cpu"]),
    "capture": ("", ["train", "BAD", "--headless", "-o", "o.ply"]),
    "capture by its file": (".json", ["train", "BAD", "--headless", "-o", "o.ply"]),
    "window": (".ply", ["BAD"]),
}
OUTPUTS = {
    "picture": (".png", ["render", "nix.ply", "-o", "BAD"]),
    "array": (".npy", ["render", "nix.ply", "-o", "BAD"]),
    "edited": (".ply", ["edit", "nix.ply", "--recipe", "r.json", "-o", "BAD"]),
    "converted": (".ply", ["convert", "nix.ply", "BAD"]),
    "plot": (".png", ["ladder", "nix.ply", "--plot", "BAD"]),
    "trained": (".ply", ["train", "nix", "--headless", "-o", "BAD"]),
    "preview": (".png", ["nix.ply", "s.ply", "-o", "BAD"]),
}


@pytest.mark.parametrize("kind", BAD)
@pytest.mark.parametrize("name", [*INPUTS, *OUTPUTS])
def test_a_bad_path_is_one_line_at_once(scene, place, capsys, name, kind):
    suffix, argv = {**INPUTS, **OUTPUTS}[name]
    if name in OUTPUTS and kind.startswith("/dev"):
        pytest.skip("has no suffix of a file to be written")
    if name == "preview":
        shutil.copy(scene, place / "nix.ply")
    path = bad_path(place, kind, suffix)
    with ordinary_user(), no_endless_wait():
        code = main([path if argument == "BAD" else argument for argument in argv])
    out, err = capsys.readouterr()
    line = err.removesuffix("\n").rpartition("\n")[2] if name == "ladder" else err.removesuffix("\n")
    assert (code, out) == (2, "")
    assert line.startswith("splatview: ") and "\n" not in line
    # It is the path that is at fault, not what comes after it.
    assert any(part in line for part in (path.rstrip("/")[:80], "file name too long"))
    assert "nix" not in line
    assert not (place / "o.ply").exists() and not (place / "o.png").exists()


def test_a_redirected_file_can_be_read_as_standard_input(scene, capsys):
    saved = os.dup(0)
    try:
        with open(scene, "rb") as file:
            os.dup2(file.fileno(), 0)
        assert main(["info", "/dev/stdin"]) == 0
    finally:
        os.dup2(saved, 0)
        os.close(saved)
    assert "20 splats" in capsys.readouterr().out


def test_names_that_are_no_text_are_names_as_any(scene, place, capsys):
    """Bytes that are not UTF-8 are written and read, and shown as escapes."""
    name = "caf\udce9.ply"
    assert main(["convert", "s.ply", name]) == 0
    assert "caf\\udce9.ply" in capsys.readouterr().err.encode("ascii", "backslashreplace").decode()
    assert main(["info", name, "--json"]) == 0
    assert capsys.readouterr().out.isascii()
    assert os.path.exists(os.fsencode(place) + b"/caf\xe9.ply")
    save_bookmarks(Path(name), [])
    assert load_bookmarks(Path(name)) == []
    assert main(["info", "caf\udce8.ply"]) == 2
    assert capsys.readouterr().err == "splatview: caf\\udce8.ply: no such file\n"


@pytest.mark.parametrize("name", ["é" * 125 + ".ply", "𓆏" * 62 + ".ply", "x" * 251 + ".ply"])
def test_the_longest_names_are_written_and_keep_bookmarks(scene, place, monkeypatch, name):
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(place / "config"))
    long = place / name
    save_scene(load_scene(scene), long)
    assert load_bookmarks(long) == []
    assert save_bookmarks(long, []) == in_config(long)
    assert load_bookmarks(long) == []
    assert sorted(place.glob("*.tmp")) == []


def test_pictures_and_bookmarks_are_as_open_as_other_files(place, random_gaussians):
    before = os.umask(0o027)
    try:
        import numpy as np

        write_png(place / "p.png", np.zeros((2, 2, 4), np.float32))
        save_scene(random_gaussians(2), place / "s.ply")
        save_bookmarks(place / "s.ply", [])
    finally:
        os.umask(before)
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in place.iterdir()}
    assert modes == {"p.png": 0o640, "s.ply": 0o640, "s.ply.bookmarks.json": 0o640}


def test_pipes_among_the_files_of_others_are_not_waited_for(scene, place, monkeypatch):
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(place / "config"))
    (place / "config").mkdir()
    os.mkfifo(place / "s.ply.bookmarks.json")
    os.mkfifo(place / "photo.png")
    os.mkfifo(place / "config" / "preferences.json")
    os.mkfifo(place / "config" / "a.journal.jsonl")
    with no_endless_wait():
        with pytest.raises(InputError, match=r"s\.ply\.bookmarks\.json: is a device or a pipe, not a file"):
            load_bookmarks(scene)
        with pytest.raises(InputError, match="is a device or a pipe"), open_image(place / "photo.png"):
            pass
        with pytest.raises(InputError, match="is a device or a pipe"), atomic_write(place / "photo.png"):
            pass
        assert find_abandoned_journals(place / "config") == []


@pytest.mark.parametrize("kind", BAD)
def test_the_window_complains_of_bad_paths(scene, place, monkeypatch, kind):
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", str(place / "config"))
    app = window_state(preferences=Preferences(smooth=False))
    opening.open_paths(app, [scene])
    run(app)
    session = session_of(app)
    assert session is not None
    ply, json = Path(bad_path(place, kind, ".ply")), Path(bad_path(place, kind, ".json"))
    written = [lambda: saving.write(app, ply), lambda: files.save_recipe_to(app, json)]
    actions: list[Callable[[], object]] = [
        lambda: opening.open_paths(app, [ply]),
        lambda: opening.open_paths(app, [json]),
        lambda: files.import_files(app, [ply]),
        lambda: files.replay_file(app, json),
        *([] if kind.startswith("/dev") else written),
        lambda: camera.keep_bookmarks(app),
    ]
    for action in actions:
        app.problem = None
        with ordinary_user(), no_endless_wait():
            app.post(lambda _, action=action: action())
            run(app)
        if action is not actions[-1]:
            problem = str(app.problem)
            assert "inside the program" not in problem and "Error" not in problem, problem
            assert problem != "None"
    assert app.is_open and session_of(app) is session
    assert next_free(place / ("x" * 300)).name == "x" * 300


def run(app: AppState) -> None:
    """The part of the frame loop that files need, until nothing is under way."""
    features = [app.feature(Editing), app.feature(camera.CameraLists)]
    app.run_posted()
    while app.loading is not None or any(feature.busy(app) for feature in features[1:]) or editing(app):
        opening.continue_loading(app)
        app.run_posted()
        for feature in features:
            feature.before_frame(app)
    features[0].before_frame(app)


def editing(app: AppState) -> bool:
    session = session_of(app)
    return session is not None and session.job is not None


@pytest.mark.parametrize("kind", ["long", "loop", "locked", "pipe", "no home"])
def test_where_nothing_can_be_kept_everything_else_works(scene, place, monkeypatch, kind):
    """The folders of settings and caches may be anything."""
    for name in ("SPLATVIEW_CONFIG_DIR", "SPLATVIEW_CACHE_DIR"):
        if kind == "no home":
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, str(place / bad_path(place, kind, name)))
    for name in ("HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", dict[int, object]().__getitem__)
    monkeypatch.setattr(demo_cache, "demo_scene", lambda: load_scene(scene))
    with ordinary_user(), no_endless_wait():
        assert load_preferences()[0] == Preferences()
        with pytest.raises(InputError, match=r"preferences\.json: (cannot be written|.*does not exist)"):
            save_preferences(Preferences())
        assert find_abandoned_journals(config_folder() / "journals") == []
        assert len(demo_cache.cached_demo()) == 20
        document = Document(load_scene(scene))
        journal = Journal(document, config_folder() / "journals")
        document.apply(SelectAll())
        assert journal.problem is not None and "steps are not autosaved" in journal.problem
        assert save_bookmarks(scene, []) == beside(scene)
        train_setup.lock_run(scene)
