"""Exporting the edited scene, and saving, replaying and restoring what was done to it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from splatview.edit.export import export
from splatview.edit.journal import AbandonedJournal, find_abandoned_journals
from splatview.edit.operations.merge_split import Merge, Split
from splatview.edit.progress import Watch
from splatview.edit.recipe import Recipe, check_scene, load_recipe, recipe_of, replay, save_recipe
from splatview.scene import InputError
from splatview.scene.user_dirs import config_folder
from splatview.viewer.editing.session import JOURNALS, Desk
from splatview.viewer.loading import stamp_of, stamps_of
from splatview.viewer.training.live import export as export_training
from splatview.viewer.training.live_edits import AT_REST

if TYPE_CHECKING:
    from splatview.viewer.state import Core


def at_rest(core: Core) -> bool:
    """Whether a scene is open that no trainer changes; says so where not."""
    if not core.at_rest:
        core.tell(AT_REST if core.can_edit else "Open a scene first")
    return core.at_rest


def choose_export(core: Core) -> None:
    """Asks where the edited scene goes."""
    if core.can_edit and not core.at_rest:
        export_training(core)
        return
    if not at_rest(core):
        return
    core.choose_files(
        "Export the edited scene",
        lambda paths: core.post(export_to, paths[0]),
        kind="save_scene",
        name=f"{_stem(core)}-edited.ply",
    )


def export_to(core: Core, path: Path) -> None:
    """Writes the edited scene, whole or not at all, in a thread."""
    desk = core.desk
    if desk is None:
        return
    target = path if path.suffix else path.with_suffix(".ply")
    read = desk.stamps.get(target.resolve())
    if read is not None and stamp_of(target) not in (read, None):
        core.complain(
            f"{target}: another program has changed it since it was opened here; export under another name,"
            " or open it again"
        )
        return
    desk.document.cancel_preview()
    document = desk.document

    def work(watch: Watch) -> int:
        return export(document, target)

    def done(count: int) -> None:
        if read is not None:
            desk.stamps.update(stamps_of([target]))
        desk.news = f"Exported {count:,} splats to {target}"

    desk.start(f"Exporting {target.name}", work, done)


def choose_recipe_to_save(core: Core) -> None:
    if not at_rest(core):
        return
    if core.desk is None or not core.desk.document.history.position:
        core.tell("Nothing has been done yet that a recipe could hold")
        return
    core.choose_files(
        "Save what was done as a recipe",
        lambda paths: core.post(save_recipe_to, paths[0]),
        kind="save_recipe",
        name=f"{_stem(core)}-recipe.json",
    )


def save_recipe_to(core: Core, path: Path) -> None:
    if core.desk is None:
        return
    target = path if path.suffix else path.with_suffix(".json")
    try:
        save_recipe(recipe_of(core.desk.document), target)
    except InputError as error:
        core.complain(str(error))
        return
    core.tell(f"{target}: {core.desk.document.history.position} steps; splatview edit replays them on a file")


def choose_recipe_to_replay(core: Core) -> None:
    if not at_rest(core):
        return
    core.choose_files("Replay a recipe", lambda paths: core.post(replay_file, paths[0]), kind="recipe")


def replay_file(core: Core, path: Path) -> None:
    desk = core.desk
    if desk is None:
        return
    try:
        recipe = load_recipe(path)
        check_scene(recipe, desk.document, any_scene=True)
    except InputError as error:
        core.complain(str(error))
        return
    replay_on(core, desk, recipe, f"Replaying {path.name}")


def replay_on(core: Core, desk: Desk, recipe: Recipe, title: str) -> None:
    """Does every step again, as steps of this history. The document waits for it: nothing else may edit."""
    desk.cancel_preview()
    folder, desk.document.folder = desk.document.folder, recipe.folder or desk.document.folder

    def work(watch: Watch) -> None:
        try:
            replay(recipe, desk.document, watch=watch)
        finally:
            desk.document.folder = folder

    def done(_: None) -> None:
        desk.news = f"{len(recipe.steps)} steps done again"

    desk.start(title, work, done, edits=True)


def choose_merge(core: Core) -> None:
    """Adds a file's splats as an edit, which can be undone and replayed."""
    if not at_rest(core):
        return
    core.choose_files("Merge another scene", lambda paths: core.post(merge_files, paths), kind="scene")


def merge_files(core: Core, paths: Sequence[Path]) -> None:
    """Each is a step of its own; one that cannot be read ends it."""
    if core.desk is not None and paths:
        merge = Merge(path=str(paths[0].absolute()))
        core.desk.apply_slowly(merge, f"Reading {paths[0].name}", then=lambda: merge_files(core, paths[1:]))


def choose_addition(core: Core) -> None:
    core.choose_files("Add a scene", lambda paths: core.post(add_files, paths), kind="scene")


def add_files(core: Core, paths: Sequence[Path]) -> None:
    """Opens the scene that is open again with those of `paths` besides. Where it is edited that would leave
    the edits behind, so there each file is a step of editing."""
    from splatview.viewer import open as opening

    if core.desk is not None and core.desk.document.history.can_undo:
        merge_files(core, paths)
    else:
        opening.begin(core, paths, add=True)


def choose_split(core: Core) -> None:
    """Moves the selection to a file of its own."""
    if not at_rest(core):
        return
    if core.desk is None or not core.desk.document.counts.selected:
        core.tell("Select the splats that are to go to a file of their own")
        return
    core.choose_files(
        "Split the selection to a scene of its own",
        lambda paths: core.post(split_to, paths[0]),
        kind="save_scene",
        name=f"{_stem(core)}-part.ply",
    )


def split_to(core: Core, path: Path) -> None:
    if core.desk is not None:
        target = path if path.suffix else path.with_suffix(".ply")
        core.desk.apply_slowly(Split(path=str(target.absolute())), f"Writing {target.name}")


def _stem(core: Core) -> str:
    return core.scene_path.stem if core.scene_path else "scene"


# ---- after a crash


def look_for_abandoned(core: Core) -> None:
    """At the start: offers what a window that did not end well, or with unsaved edits, was doing."""
    core.abandoned = [
        journal
        for journal in find_abandoned_journals(config_folder() / JOURNALS)
        if journal.scene is not None
    ]
    if core.abandoned:
        core.dialog = "restore"


def restore(core: Core, journal: AbandonedJournal) -> None:
    """Opens the journal's scene; its steps follow when that is loaded."""
    from splatview.viewer import open as opening

    if journal.scene is None or not journal.scene.exists():
        core.complain(f"{journal.scene}: is no longer there, so its edits cannot be restored")
        return
    core.restoring = journal
    opening.open_paths(core, [journal.scene])


def continue_restoring(core: Core) -> None:
    """Called every frame: replays the steps once their scene is on the desk."""
    journal, desk = core.restoring, core.desk
    if journal is None or desk is None or core.loading is not None or core.scene_path != journal.scene:
        return
    core.restoring = None
    try:
        check_scene(journal.recipe, desk.document)
    except InputError as error:
        core.complain(f"The scene has changed since it was edited: {error}")
        return
    journal.discard()
    replay_on(core, desk, journal.recipe, "Restoring")


def described(journal: AbandonedJournal) -> str:
    """One line for the list."""
    name = journal.scene.name if journal.scene else "?"
    when = time.strftime("%d %b %H:%M", time.localtime(journal.time))
    return f"{name}: {len(journal.recipe.steps)} steps of {when}"


FILE_ACTIONS = {
    "export": choose_export,
    "save_recipe": choose_recipe_to_save,
    "replay_recipe": choose_recipe_to_replay,
    "add": choose_addition,
    "merge": choose_merge,
    "split": choose_split,
}
"""Every file action that has a name in `shortcuts.SHORTCUTS`."""
