"""What a click on the picture means to the tools that pick a splat: magic wand, eyedropper, measure."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ....edit.operations import Select
from ....edit.operations.moving import Ground
from ....edit.selecting import Flood, SimilarColour, picked
from ....edit.selecting.adjusted import base_colours
from ....scene import Camera, Gaussians
from ....scene.edits import SceneEdits, adjusted_means
from .desk import Desk
from .measuring import Measured
from .tool_names import Mode, Place, ToolName

if TYPE_CHECKING:
    from ..core import Core


class Hit(NamedTuple):
    """The splat that makes the surface at a pixel."""

    splat: int
    place: Place
    """Its mean as edited, world units."""


def hit(desk: Desk, camera: Camera, x: float, y: float) -> Hit | None:
    """What is at pixel (x, y) of what `camera` sees; None: the background. Raises InputError."""
    document = desk.document
    splat = picked(document.gaussians, document.edits, document.tools, camera, x, y)
    return None if splat is None else Hit(splat, place_of(document.gaussians, document.edits, splat))


def place_of(gaussians: Gaussians, edits: SceneEdits, splat: int) -> Place:
    """Where splat `splat` is after its adjustments."""
    one = np.array([splat])
    alone = SceneEdits(marks=edits.marks[one], palette=edits.palette)
    x, y, z = (float(value) for value in adjusted_means(gaussians.take(one), alone)[0])
    return x, y, z


def click(core: Core, desk: Desk, tool: ToolName, mode: Mode, camera: Camera, x: float, y: float) -> None:
    """A click at (x, y) px of what `camera` sees, with a tool that picks."""
    found = hit(desk, camera, x, y)
    if found is None:
        desk.news = "Nothing there: the pixel shows the background"
        return
    if tool == "flood":
        by = Flood(seed=found.splat, tolerance=desk.tolerance)
        desk.apply_slowly(Select(by=by, mode=mode), "Magic wand")
    elif tool == "colour":
        alone = SceneEdits(
            marks=desk.document.edits.marks[[found.splat]], palette=desk.document.edits.palette
        )
        red, green, blue = (
            float(v) for v in base_colours(desk.gaussians.take(np.array([found.splat])), alone)[0]
        )
        by = SimilarColour(rgb=(red, green, blue), tolerance=desk.tolerance)
        desk.apply(Select(by=by, mode=mode))
    else:
        pick_point(desk, tool, found.place)


def pick_point(desk: Desk, tool: ToolName, place: Place) -> None:
    """One more point for the tape measure (two) or the ground (three)."""
    desk.picked.append(place)
    if tool == "measure" and len(desk.picked) == 2:
        desk.measured = Measured(start=desk.picked[0], end=desk.picked[1])
        desk.news = f"Distance: {desk.measured.length:.6g} units"
        desk.picked.clear()
    elif tool == "ground" and len(desk.picked) == 3:
        first, second, third = desk.picked
        desk.picked.clear()
        desk.tool = "none"
        desk.apply(Ground(points=(first, second, third)))
    else:
        desk.news = f"Point {len(desk.picked)} of {2 if tool == 'measure' else 3}"
