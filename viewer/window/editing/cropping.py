"""A new crop, about where the scene is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from ....edit.operations.cropping import AddCrop
from ....scene.crop import Crop
from ..bounds import bounds
from .desk import Desk

if TYPE_CHECKING:
    from ..core import Core

Shape = Literal["box", "sphere"]


def add_crop(core: Core, shape: Shape) -> None:
    """Adds a box or sphere that fits the scene, and gives it the handles."""
    desk = core.desk
    if desk is None:
        core.tell("Open a scene first")
    elif desk.apply(AddCrop(crop=fitting(core, desk, shape))):
        desk.forms.crop = len(desk.document.crops) - 1
        desk.forms.open_section = "Crop"


def fitting(core: Core, desk: Desk, shape: Shape) -> Crop:
    """A first crop: about the bulk of what is shown."""
    number = 1 + len(desk.document.crops)
    if core.training is not None and desk.trainee is not None:
        settings = core.training.status.settings
        number += len(settings.cut) + len(settings.no_growth)
    found = bounds(core)
    if found is None:
        return Crop(name=f"crop {number}", shape=shape)
    (x, y, z), half = found[0].tolist(), found[1]
    return Crop(name=f"crop {number}", shape=shape, centre=(x, y, z), half_extents=(half, half, half))
