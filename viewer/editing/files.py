"""Importing and splitting scenes, and saving, replaying and restoring what was done to one."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from splatview.edit.journal import AbandonedJournal, find_abandoned_journals
from splatview.edit.operations.merge_split import Merge, Split
from splatview.edit.recipe import Recipe, check_scene, load_recipe, recipe_of, replay, save_recipe
from splatview.scene import InputError
from splatview.scene.progress import Progress
from splatview.scene.user_dirs import config_folder
from splatview.viewer import open as opening
from splatview.viewer.editing.session import (
    JOURNALS,
    EditSession,
    at_rest,
    can_edit,
    session_for_edit,
    session_of,
    with_session,
)
from splatview.viewer.editing.target import AT_REST
from splatview.viewer.loading import stamp_of, stamps_of
from splatview.viewer.preferences import with_recent
from splatview.viewer.state import Feature

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


def check_at_rest(app: AppState) -> bool:
    """Whether a scene is open that no trainer changes; says so where not."""
    if at_rest(app):
        session_for_edit(app)  # a sequence that plays is paused
        return True
    app.tell(AT_REST if can_edit(app) else "Open a scene first")
    return False


def changed_elsewhere(session: EditSession, target: Path) -> str:
    """What to say where another program has changed an open file that `target` is; "" where none has."""
    read = session.stamps.get(Path(os.path.realpath(target)))
    if read is None or stamp_of(target) in (read, None):
        return ""
    return (
        f"{target}: another program has changed it since it was opened here; export under another name, or "
        "open it again"
    )


def choose_recipe_to_save(app: AppState) -> None:
    if not check_at_rest(app):
        return
    session = session_of(app)
    if session is None or not session.document.history.position:
        app.tell("Nothing has been done yet that a recipe could hold")
        return
    app.choose_files(
        "Save what was done as a recipe",
        lambda paths: app.post(save_recipe_to, paths[0]),
        kind="save_recipe",
        name=f"{_stem(app)}-recipe.json",
    )


@with_session
def save_recipe_to(app: AppState, session: EditSession, path: Path) -> None:
    target = path if path.suffix else path.with_suffix(".json")
    try:
        save_recipe(recipe_of(session.document), target)
    except InputError as error:
        app.complain(str(error))
        return
    app.tell(f"{target}: {session.document.history.position} steps; splatview edit replays them on a file")


def choose_recipe_to_replay(app: AppState) -> None:
    if not check_at_rest(app):
        return
    app.choose_files("Replay a recipe", lambda paths: app.post(replay_file, paths[0]), kind="recipe")


@with_session
def replay_file(app: AppState, session: EditSession, path: Path) -> None:
    try:
        recipe = load_recipe(path)
        check_scene(recipe, session.document, any_scene=True)
    except InputError as error:
        app.complain(str(error))
        return
    replay_on(app, session, recipe, f"Replaying {path.name}")


def replay_on(
    app: AppState,
    session: EditSession,
    recipe: Recipe,
    title: str,
    *,
    source: Callable[[Path], Path] = lambda path: path,
    then: Callable[[], object] = lambda: None,
) -> None:
    """Does every step again, as steps of this history, and `then` what follows. The document waits for it:
    nothing else may edit. `source`: where what was in a file that steps name is now."""
    session.cancel_preview()
    document = session.document
    before = document.folder, document.load
    load = document.load
    document.folder = recipe.folder or document.folder
    document.load = lambda path, **options: load(source(path), **options)

    def work(progress: Progress) -> None:
        try:
            replay(recipe, document, progress=progress)
        finally:
            document.folder, document.load = before

    def done(_: None) -> None:
        session.news = f"{len(recipe.steps)} steps done again"
        then()

    session.start(title, work, done, edits=True)


def choose_import(app: AppState) -> None:
    """Adds files to the scene as an edit, which can be undone and replayed."""
    if not check_at_rest(app):
        return
    app.choose_files("Import scenes", lambda paths: app.post(import_files, paths), kind="scene")


@with_session
def import_files(app: AppState, session: EditSession, paths: Sequence[Path]) -> None:
    """Each is a step and a row of its own, the last one active; one that cannot be read ends it."""
    if not paths:
        return
    path = paths[0].absolute()

    def done() -> None:
        session.activate_file(len(session.document.files) - 1)
        app.preferences = with_recent(app.preferences, path)
        import_files(app, paths[1:])

    session.apply_slowly(Merge(path=str(path)), f"Reading {path.name}", then=done)


def choose_split(app: AppState) -> None:
    """Moves the selection to a file of its own."""
    if not check_at_rest(app):
        return
    session = session_of(app)
    if session is None or not session.document.counts.selected:
        app.tell("Select the splats that are to go to a file of their own")
        return
    app.choose_files(
        "Split the selection to a scene of its own",
        lambda paths: app.post(split_to, paths[0]),
        kind="save_scene",
        name=f"{_stem(app)}-part.ply",
    )


@with_session
def split_to(app: AppState, session: EditSession, path: Path) -> None:
    target = path if path.suffix else path.with_suffix(".ply")
    session.apply_slowly(Split(path=str(target.absolute())), f"Writing {target.name}")


def _stem(app: AppState) -> str:
    return app.scene_path.stem if app.scene_path else "scene"


def look_for_abandoned(app: AppState) -> None:
    """At the start: offers unsaved edits of windows that did not end well, or were closed with them."""
    restoring = app.feature(Restoring)
    restoring.abandoned = find_abandoned_journals(config_folder() / JOURNALS)
    if restoring.abandoned:
        app.dialog = "restore"


def restore(app: AppState, journal: AbandonedJournal) -> None:
    """Opens the journal's scene; its steps follow when that is loaded. Where the open scene has unsaved edits
    the user is asked first."""
    app.leave(partial(_restore, journal=journal))


def _restore(app: AppState, journal: AbandonedJournal) -> None:
    for path in journal.opened:
        if not os.path.lexists(path):
            app.complain(f"{path}: is no longer there, so its edits cannot be restored")
            return
    app.feature(Restoring).journal = journal
    if journal.scenes:
        opening.open_paths(app, journal.opened, merge=True)
    else:
        opening.begin_demo(app)


class Restoring(Feature):
    """Edits that earlier windows left unsaved: offered, and replayed once their scene is open."""

    def __init__(self) -> None:
        self.abandoned: list[AbandonedJournal] = []
        """Journals to be offered."""
        self.journal: AbandonedJournal | None = None
        """Journal whose scene is being loaded."""

    def before_frame(self, app: AppState) -> None:
        journal, session = self.journal, session_of(app)
        if journal is None or session is None or app.loading is not None:
            return
        if app.scene.paths != tuple(journal.opened):
            return
        self.journal = None
        try:
            check_scene(journal.recipe, session.document)
        except InputError as error:
            app.complain(f"The scene has changed since it was edited: {error}")
            return
        if journal.scenes:
            session.document.name_files(str(journal.recipe.scene["name"]), journal.scenes)
        if session.journal is not None:
            session.journal.continue_from(journal)
        replay_on(
            app,
            session,
            journal.recipe,
            "Restoring",
            source=journal.source,
            then=lambda: restored(app, session, journal),
        )


def restored(app: AppState, session: EditSession, journal: AbandonedJournal) -> None:
    """The steps of `journal` are done again: the scene is that of the files that were open."""
    paths = journal.scenes if journal.saved is None else (journal.saved,)
    if app.scene.paths != paths:
        name = paths[0].name if len(paths) == 1 else f"{paths[0].name} and {len(paths) - 1} more"
        copies = {str(copy) for copy in journal.kept.values()}
        app.scene = replace(app.scene, paths=paths, name=name)
        session.stamps.update(stamps_of(paths))
        app.prefer(recent=tuple(path for path in app.preferences.recent if path not in copies))
        for path in reversed(paths):
            app.preferences = with_recent(app.preferences, path)
    history = session.document.history
    if journal.saved is not None:
        if journal.saved_at is None or journal.saved_at > history.position:
            history.mark_changed()
        else:
            history.mark_saved(journal.saved_at)
    if session.journal is not None:
        session.journal.replace(journal)
    else:
        journal.discard()


def described(journal: AbandonedJournal) -> str:
    """One line for the list."""
    name = journal.scene.name if journal.scene else str(journal.recipe.scene.get("name", "Demo"))
    name += f" and {len(journal.scenes) - 1} more" if len(journal.scenes) > 1 else ""
    when = time.strftime("%d %b %H:%M", time.localtime(journal.time))
    return f"{name}: {len(journal.recipe.steps)} steps of {when}"
