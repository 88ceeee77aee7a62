"""Editing commands by name: keys, menus, the palette and buttons all end here."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, get_args

from ....edit.detecting import DETECTORS
from ....edit.operations import OPERATIONS
from ....edit.operations.growing import Grow, Shrink
from ....edit.operations.operation import Operation
from ..training.held import hold
from .cleaning import find
from .cropping import add_crop
from .desk import Desk
from .files import FILE_ACTIONS
from .tool_names import Depth, ToolName

if TYPE_CHECKING:
    from ..core import Core

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
