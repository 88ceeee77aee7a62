"""Editing commands by name: keys, menus, the palette and buttons all end here."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

from splatview.edit.detectors import DETECTORS
from splatview.edit.operations import OPERATIONS
from splatview.edit.operations.base import Operation
from splatview.edit.operations.crop import AddCrop
from splatview.edit.operations.select import Grow, Shrink
from splatview.scene.edits import Crop
from splatview.viewer.editing.cleanup import find
from splatview.viewer.editing.files import FILE_ACTIONS
from splatview.viewer.editing.session import Desk
from splatview.viewer.editing.tool_state import Depth, ToolName
from splatview.viewer.open import bounds
from splatview.viewer.training.live_edits import hold

if TYPE_CHECKING:
    from splatview.viewer.state import Core


# ---- A new crop, about where the scene is.


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


BRUSH_STEP = 1.25
"""Factor on the brush's radius for one press of a key."""

LEAST_BRUSH, MOST_BRUSH = 2.0, 600.0
"""px"""


NEIGHBOURS = 8
"""Growing and shrinking go by so many nearest splats: about one layer."""

SELECT_FIRST = "Select splats first: R for a rectangle, C for a brush, Ctrl+A for all"


def with_desk(command: Callable[..., None]) -> Callable[..., None]:
    """`command(core, desk, *args)` as `command(core, *args)`, which does nothing where no scene is open."""

    def run(core: Core, *args: object, **options: object) -> None:
        desk = hold(core)
        if desk is None:
            core.tell("Open a scene first")
        else:
            command(core, desk, *args, **options)

    return run


@with_desk
def undo(core: Core, desk: Desk) -> None:
    desk.undo()


@with_desk
def redo(core: Core, desk: Desk) -> None:
    desk.redo()


@with_desk
def jump(core: Core, desk: Desk, position: int) -> None:
    """Undoes or redoes until `position` steps are in force."""
    desk.jump(position)


@with_desk
def apply(core: Core, desk: Desk, operation: Operation) -> None:
    desk.apply(operation)


@with_desk
def apply_to_selection(core: Core, desk: Desk, operation: Operation) -> None:
    """As `apply`, for what would do nothing without a selection: says so instead."""
    if desk.document.counts.selected:
        desk.apply(operation)
    else:
        desk.news = SELECT_FIRST


@with_desk
def grow_or_shrink(core: Core, desk: Desk, operation: Grow | Shrink) -> None:
    """In a thread: it looks for the neighbours of every splat."""
    if desk.document.counts.selected:
        desk.apply_slowly(operation, "Grow" if isinstance(operation, Grow) else "Shrink")
    else:
        desk.news = SELECT_FIRST


@with_desk
def take_tool(core: Core, desk: Desk, tool: ToolName) -> None:
    """Takes a tool; the one in hand is put back by asking for it again."""
    desk.tool = "none" if desk.tool == tool else tool
    desk.stroke = None
    desk.picked.clear()


@with_desk
def next_depth(core: Core, desk: Desk) -> None:
    depths: tuple[Depth, ...] = get_args(Depth)
    desk.depth = depths[(depths.index(desk.depth) + 1) % len(depths)]
    text = "through everything" if desk.depth == "through" else "the front surface only"
    desk.news = f"Screen tools select {text}"


@with_desk
def scale_brush(core: Core, desk: Desk, factor: float) -> None:
    desk.brush_radius = min(max(desk.brush_radius * factor, LEAST_BRUSH), MOST_BRUSH)


@with_desk
def cancel_job(core: Core, desk: Desk) -> None:
    if desk.job is not None:
        desk.job.cancel()


def _operation(name: str, **fields: object) -> Operation:
    return OPERATIONS[name](**fields)


EDIT_ACTIONS: dict[str, Callable[[Core], None]] = {
    **FILE_ACTIONS,
    "undo": undo,
    "redo": redo,
    "duplicate": partial(apply_to_selection, operation=_operation("duplicate")),
    **{
        name: partial(apply, operation=_operation(name))
        for name in ("select_all", "select_none", "select_inverse", "show", "unlock")
    },
    **{
        name: partial(apply_to_selection, operation=_operation(name))
        for name in ("delete", "hide", "lock", "isolate")
    },
    **{
        f"tool_{name}": partial(take_tool, tool=name)
        for name in ("rectangle", "lasso", "polygon", "brush", "flood", "colour", "measure")
    },
    "tool_ground": partial(take_tool, tool="ground"),
    "grow": partial(grow_or_shrink, operation=Grow(neighbours=NEIGHBOURS)),
    "shrink": partial(grow_or_shrink, operation=Shrink(neighbours=NEIGHBOURS)),
    "add_box": partial(add_crop, shape="box"),
    "add_sphere": partial(add_crop, shape="sphere"),
    "delete_cropped": partial(apply, operation=_operation("delete_cropped")),
    **{f"find_{name}": partial(find, detector=name) for name in DETECTORS},
    "next_depth": next_depth,
    "larger_brush": partial(scale_brush, factor=BRUSH_STEP),
    "smaller_brush": partial(scale_brush, factor=1 / BRUSH_STEP),
}
"""Every editing action that has a name in `shortcuts.SHORTCUTS`."""
