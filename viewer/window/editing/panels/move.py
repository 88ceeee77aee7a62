"""Moving, turning and scaling by numbers or by handles on the picture; setting the scene upright."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, imgui

from .....edit.loops.places import positions_of
from .....edit.operations.moving import Orient, Transform
from .....scene import Camera
from .....scene.framing import robust_bounds
from ...bounds import bounds
from ...panels import widgets
from .. import commands, gizmos
from ..desk import Desk
from ..forms import MoveForm
from ..tool_names import Place
from ..turning import angles_of, quat_from_matrix, quat_of
from . import scope

if TYPE_CHECKING:
    from ...core import Core

SECTION = "move"

SAMPLE = 200_000
"""Splats that the pivot is the middle of."""

UPS: tuple[tuple[str, Place], ...] = (
    ("+X", (1, 0, 0)),
    ("-X", (-1, 0, 0)),
    ("+Y", (0, 1, 0)),
    ("-Y", (0, -1, 0)),
    ("+Z", (0, 0, 1)),
    ("-Z", (0, 0, -1)),
)


def show(core: Core, desk: Desk) -> None:
    if scope.choose_scope(desk):
        desk.forms.move = MoveForm(gizmo=desk.forms.move.gizmo)
        core.post(lambda core: core.desk.cancel_preview() if core.desk else None)
    if not scope.nothing_to_change(desk):
        by_numbers(core, desk)
    widgets.section("Upright")
    upright(core, desk)


def by_numbers(core: Core, desk: Desk) -> None:
    form = desk.forms.move
    speed = max(core.scene.radius if core.scene else 1.0, 1e-6) / 300
    changed = False
    moved = widgets.vector("Move", form.translation, speed, "World units along x, y, z.")
    if moved is not None:
        form.translation, changed = moved, True
    tip = "Degrees about x, y, z through the middle; colours that depend on the view turn too."
    turned = widgets.vector("Turn", form.rotation, 0.25, tip, form="%.2f")
    if turned is not None:
        form.rotation, changed = turned, True
    scale = widgets.slider(
        "Scale", form.scale, 0.05, 20.0, "About the middle.", form="%.3f", logarithmic=True
    )
    if scale is not None:
        form.scale, changed = scale, True
    shown = widgets.checkbox("Handles", form.gizmo, "Handles on the picture to move and turn by.")
    form.gizmo = form.gizmo if shown is None else shown
    if form.gizmo:
        turning = widgets.checkbox("Turn by them", form.turning, "The handles turn rather than move.")
        form.turning = form.turning if turning is None else turning
    if changed:
        preview(desk)
    if scope.keep_or_cancel(core, desk, SECTION) is not None:
        desk.forms.move = MoveForm(gizmo=form.gizmo, turning=form.turning)


def preview(desk: Desk) -> None:
    form = desk.forms.move
    if any(not np.isfinite(v) for v in (*form.translation, *form.rotation)) or not form.scale > 0:
        return
    operation = Transform(
        scope=desk.forms.scope,
        translation=form.translation,
        rotation=quat_of(form.rotation),
        scale=form.scale,
        pivot=pivot(desk),
    )
    desk.preview(SECTION, operation)


def pivot(desk: Desk) -> Place:
    """The middle of what is to be moved, as it is without the preview; kept while one is in force."""
    key = (desk.forms.scope, desk.document.versions)
    if desk.pivot is None or (desk.forms.previewing != SECTION and desk.pivot[0] != key):
        document = desk.document
        splats = (
            document.selected.indices if desk.forms.scope == "selection" else np.arange(len(document.marks))
        )
        chosen = splats[:: max(1, len(splats) // SAMPLE)]
        places = positions_of(document.gaussians, document.edits)[chosen]
        x, y, z = (float(value) for value in robust_bounds(places)[0])
        desk.pivot = (key, (x, y, z))
    return desk.pivot[1]


def handles(core: Core, desk: Desk, camera: Camera, corner: ImVec2) -> None:
    """Over the picture; what they do is the same as typing the numbers."""
    form = desk.forms.move
    if not form.gizmo or (desk.forms.scope == "selection" and not desk.document.counts.selected):
        return
    centre = np.array(pivot(desk))
    matrix = np.eye(4)
    matrix[:3, 3] = centre + form.translation
    if form.turning:
        from .....scene.adjustment import Adjustment

        matrix[:3, :3] = Adjustment(rotation=quat_of(form.rotation)).R
    new = gizmos.handles("move", camera, corner, matrix, "turn" if form.turning else "move", local=False)
    if new is None:
        return
    if form.turning:
        form.rotation = angles_of(quat_from_matrix(new[:3, :3]))
    else:
        x, y, z = (new[:3, 3] - centre).tolist()
        form.translation = (x, y, z)
    core.post(lambda core: preview(core.desk) if core.desk else None)


def upright(core: Core, desk: Desk) -> None:
    """The whole scene turned so that it stands: by an axis, by the view, or by three points on the ground."""
    widgets.note("What points up in the scene now?")
    for number, (name, axis) in enumerate(UPS):
        if number:
            widgets.beside(name)
        tip = f"Turns the scene: its {name} becomes up (-Y)."
        widgets.button(f"{name}##up", tip, partial(core.post, orient, axis))
    if imgui.button("The view's up"):
        up = -core.view.R_camera_world[1]
        core.post(orient, (float(up[0]), float(up[1]), float(up[2])))
    widgets.tooltip("Turns the scene so that what is up in the picture now is up (-Y).")
    chosen = desk.tool == "ground"
    text = f"Pick {3 - len(desk.picked)} more..." if chosen else "Three points on the ground"
    widgets.beside(text)
    if imgui.button(f"{text}###ground"):
        core.post(commands.take_tool, "ground")
    widgets.tooltip("Click three points of the floor: it becomes level, at y = 0.")


def orient(core: Core, up: Place) -> None:
    """Turns what is shown about its middle until `up` points up."""
    found = bounds(core)
    if core.desk is not None and found is not None:
        x, y, z = found[0].tolist()
        core.desk.apply(Orient(up=up, pivot=(x, y, z)))
