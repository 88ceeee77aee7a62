"""A desk for each scene that is opened, and what of it the frame loop does."""

from __future__ import annotations

import threading
from functools import cache
from typing import TYPE_CHECKING

from ....edit.document import Document
from ....edit.journal import Journal
from ....edit.warm_up import warm_up
from ....scene import InputError
from ...commands.edit_tools import RasterTools
from ...folders import config_folder
from .changed_scene import continue_examining, load_changed_scene
from .desk import Desk

if TYPE_CHECKING:
    from ..core import Core
    from ..loading import LoadedScene


JOURNALS = "journals"
"""Folder beside the settings: steps of windows that run, and of those that did not end well."""


@cache
def compile_ahead() -> None:
    """Once, in a thread: what the first edits need is there before the first click."""
    threading.Thread(target=warm_up, name="splatview-warm-up", daemon=True).start()


def take_up(core: Core, scene: LoadedScene) -> None:
    """Puts `scene`, just opened, on a desk of its own; edits of the one before end with it."""
    compile_ahead()
    if core.desk is not None:
        core.desk.close()
    folder = scene.paths[0].parent if scene.paths else None
    try:
        document = Document(scene.gaussians, name=scene.name, folder=folder, tools=RasterTools())
    except InputError as error:
        core.desk = None
        core.tell(f"{error}; it can be looked at")
        return
    core.desk = Desk(document=document, stamps=dict(scene.stamps))
    core.desk.journal = Journal(
        document, config_folder() / JOURNALS, scene=scene.paths[0] if len(scene.paths) == 1 else None
    )


def continue_editing(core: Core) -> None:
    """Called every frame: ends jobs, tells what they and the user's edits came to."""
    continue_examining(core)
    desk = core.desk
    if desk is None:
        return
    desk.advance()
    load_changed_scene(core, desk)
    if desk.journal is not None and desk.journal.problem is not None:
        core.tell(desk.journal.problem)
        desk.journal.close(keep=True)
        desk.journal = None
    if desk.problem is not None:
        core.complain(desk.problem)
        desk.problem = None
    if desk.news is not None:
        core.tell(desk.news)
        desk.news = None


LEAVING_SECONDS = 60.0
"""For so long a window that closes waits for a file that is being written; other work is given up at once."""


def put_away(core: Core) -> str | None:
    """The window closes: a line for the user where edits are in no file."""
    desk, core.desk = core.desk, None
    if desk is None:
        return None
    if desk.job is not None:
        desk.job.cancel()
        desk.job.join(LEAVING_SECONDS)
    offered = core.scene is not None and len(core.scene.paths) == 1
    kept = offered and desk.journal is not None and desk.document.history.modified
    desk.close()
    return "the edits are in no file yet; the next start offers to restore them" if kept else None
