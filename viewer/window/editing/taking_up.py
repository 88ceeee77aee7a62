"""A desk for each scene that is opened, and what of it the frame loop does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....edit.document import Document
from ....scene import InputError
from .desk import Desk

if TYPE_CHECKING:
    from ..core import Core
    from ..loading import LoadedScene


def take_up(core: Core, scene: LoadedScene) -> None:
    """Puts `scene`, just opened, on a desk of its own; edits of the one before end with it."""
    if core.desk is not None:
        core.desk.close()
    folder = scene.paths[0].parent if scene.paths else None
    try:
        core.desk = Desk(document=Document(scene.gaussians, name=scene.name, folder=folder))
    except InputError as error:
        core.desk = None
        core.tell(f"{error}; it can be looked at")


def continue_editing(core: Core) -> None:
    """Called every frame: ends jobs, tells what they and the user's edits came to."""
    desk = core.desk
    if desk is None:
        return
    desk.advance()
    if desk.problem is not None:
        core.complain(desk.problem)
        desk.problem = None
    if desk.news is not None:
        core.tell(desk.news)
        desk.news = None
