"""A scene whose values or number of splats an edit has changed: picture, census and panels follow.

Marks, colours and crops need none of this; they are drawn over the scene that the picture holds.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from ....scene import Gaussians, InputError, RenderSettings
from ..loading import Examination
from .desk import Desk

if TYPE_CHECKING:
    from ..core import Core

LOAD_SECONDS = 0.012
"""Of each frame, for giving the picture the changed scene."""


def load_changed_scene(core: Core, desk: Desk) -> None:
    """Gives the picture a scene whose values or number of splats an edit has changed, some at each frame."""
    wanted = desk.document.gaussians
    if desk.loaded is None:
        desk.loaded = wanted
    if desk.job is not None or core.loading is not None or core.picture is None:
        return
    if desk.loading is not None and desk.loading[0] is not wanted:
        desk.loading[1].close()
        desk.loading = None
    if desk.loaded is wanted:
        return
    if desk.loading is None:
        desk.loading = (wanted, core.picture.load_steps(wanted))
    until = time.perf_counter() + LOAD_SECONDS
    try:
        while time.perf_counter() < until:
            next(desk.loading[1])
    except StopIteration:
        desk.loaded, desk.loading = wanted, None
        take_over(core, wanted)
    except InputError as error:
        desk.loading = None
        desk.problem = f"{error}; the last step is taken back"
        desk.undo()


def take_over(core: Core, gaussians: Gaussians) -> None:
    """The picture holds these splats of the open scene now: so does whatever else looks at them."""
    if core.scene is not None:
        core.scene = replace(core.scene, gaussians=gaussians)
        # One at a time: of many steps undone in a row only the last state is looked through.
        core.examining = core.examining or Examination(gaussians)


def continue_examining(core: Core) -> None:
    """Called every frame: takes over what has been found out about changed splats. Settings follow what they
    call for, where the user has not set them otherwise."""
    found = core.examining
    if found is None or not found.done:
        return
    core.examining = None
    scene = core.scene
    if scene is None or scene.gaussians is not found.gaussians:
        if scene is not None and core.desk is not None and core.desk.loaded is scene.gaussians:
            core.examining = Examination(scene.gaussians)
        return
    core.examination = found
    if found.settings is not None:
        core.settings = followed(core.settings, scene.settings, found.settings)
        core.scene = replace(scene, settings=found.settings)


def followed(settings: RenderSettings, before: RenderSettings, after: RenderSettings) -> RenderSettings:
    """`settings` with what was as a scene called for `before` as it calls for `after`."""
    near = settings.model.near
    if settings.model == replace(before.model, near=near):
        settings = replace(settings, model=replace(after.model, near=near))
    if settings.sh_degree == before.sh_degree:
        settings = replace(settings, sh_degree=after.sh_degree)
    if settings.early_stop == before.early_stop:
        settings = replace(settings, early_stop=after.early_stop)
    return settings
