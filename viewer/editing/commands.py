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
from splatview.viewer.editing.session import EditSession
from splatview.viewer.editing.tool_state import Depth, ToolName
from splatview.viewer.open import bounds
from splatview.viewer.training.live_edits import hold

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


# ---- A new crop, about where the scene is.


Shape = Literal["box", "sphere"]


def add_crop(app: AppState, shape: Shape) -> None:
    """Adds a box or sphere that fits the scene, and gives it the handles."""
    session = app.session
    if session is None:
        app.tell("Open a scene first")
    elif session.apply(AddCrop(crop=fitting(app, session, shape))):
        session.forms.crop = len(session.document.crops) - 1
        session.forms.open_section = "Crop"


def fitting(app: AppState, session: EditSession, shape: Shape) -> Crop:
    """A first crop: about the bulk of what is shown."""
    number = 1 + len(session.document.crops)
    if app.training is not None and session.target is not None:
        settings = app.training.status.settings
        number += len(settings.cut) + len(settings.no_growth)
    found = bounds(app)
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
    """`command(app, session, *args)` as `command(app, *args)`, which does nothing where no scene is open."""

    def run(app: AppState, *args: object, **options: object) -> None:
        session = hold(app)
        if session is None:
            app.tell("Open a scene first")
        else:
            command(app, session, *args, **options)

    return run


@with_desk
def undo(app: AppState, session: EditSession) -> None:
    session.undo()


@with_desk
def redo(app: AppState, session: EditSession) -> None:
    session.redo()


@with_desk
def jump(app: AppState, session: EditSession, position: int) -> None:
    """Undoes or redoes until `position` steps are in force."""
    session.jump(position)


@with_desk
def apply(app: AppState, session: EditSession, operation: Operation) -> None:
    session.apply(operation)


@with_desk
def apply_to_selection(app: AppState, session: EditSession, operation: Operation) -> None:
    """As `apply`, for what would do nothing without a selection: says so instead."""
    if session.document.counts.selected:
        session.apply(operation)
    else:
        session.news = SELECT_FIRST


@with_desk
def grow_or_shrink(app: AppState, session: EditSession, operation: Grow | Shrink) -> None:
    """In a thread: it looks for the neighbours of every splat."""
    if session.document.counts.selected:
        session.apply_slowly(operation, "Grow" if isinstance(operation, Grow) else "Shrink")
    else:
        session.news = SELECT_FIRST


@with_desk
def take_tool(app: AppState, session: EditSession, tool: ToolName) -> None:
    """Takes a tool; the one in hand is put back by asking for it again."""
    session.tool = "none" if session.tool == tool else tool
    session.stroke = None
    session.picked.clear()


@with_desk
def next_depth(app: AppState, session: EditSession) -> None:
    depths: tuple[Depth, ...] = get_args(Depth)
    session.depth = depths[(depths.index(session.depth) + 1) % len(depths)]
    text = "through everything" if session.depth == "through" else "the front surface only"
    session.news = f"Screen tools select {text}"


@with_desk
def scale_brush(app: AppState, session: EditSession, factor: float) -> None:
    session.brush_radius = min(max(session.brush_radius * factor, LEAST_BRUSH), MOST_BRUSH)


@with_desk
def cancel_job(app: AppState, session: EditSession) -> None:
    if session.job is not None:
        session.job.cancel()


def _operation(name: str, **fields: object) -> Operation:
    return OPERATIONS[name](**fields)


EDIT_ACTIONS: dict[str, Callable[[AppState], None]] = {
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
