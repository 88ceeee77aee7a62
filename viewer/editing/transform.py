"""Moving, rotating and scaling splats: by numbers, as a preview, and by handles on the picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2

from splatview.edit.kernels.marks import positions_of
from splatview.edit.operations.transform import Transform
from splatview.scene import Camera
from splatview.scene.edits import Adjustment
from splatview.scene.framing import robust_bounds
from splatview.viewer.editing import gizmos
from splatview.viewer.editing.gizmos import angles_of, quat_from_matrix, quat_of
from splatview.viewer.editing.session import TRANSFORM, EditSession, post_edit
from splatview.viewer.editing.tool_state import MoveForm, Place

if TYPE_CHECKING:
    from splatview.viewer.state import AppState

SAMPLE = 200_000
"""Splats that the pivot is the middle of."""


def preview(session: EditSession) -> None:
    """Shows what the numbers of the form would do."""
    form = session.forms.move
    if any(not np.isfinite(v) for v in (*form.translation, *form.rotation)) or not form.scale > 0:
        return
    operation = Transform(
        scope=session.scope,
        translation=form.translation,
        rotation=quat_of(form.rotation),
        scale=form.scale,
        pivot=pivot(session),
    )
    session.preview(TRANSFORM, operation)


def pivot(session: EditSession) -> Place:
    """The middle of what is to be moved, as it is without the preview; kept while one is in force."""
    key = (session.scope, session.document.versions)
    if session.pivot is None or (session.forms.previewing != TRANSFORM and session.pivot[0] != key):
        document = session.document
        splats = document.selected.indices if session.scope == "selection" else np.arange(len(document.marks))
        chosen = splats[:: max(1, len(splats) // SAMPLE)]
        places = positions_of(document.gaussians, document.edits)[chosen]
        x, y, z = (float(value) for value in robust_bounds(places)[0])
        session.pivot = (key, (x, y, z))
    return session.pivot[1]


def handles(app: AppState, session: EditSession, camera: Camera, corner: ImVec2) -> None:
    """Handles of the tool in hand, over the picture. Each drag is a step of the history, together with what
    was typed before it."""
    form = session.forms.move
    if session.handles != TRANSFORM:
        return
    kind = session.tool
    centre = np.array(pivot(session))
    rotation = Adjustment(rotation=quat_of(form.rotation)).R
    sizes = (form.scale, form.scale, form.scale)
    matrix = gizmos.placed(
        centre + form.translation,
        rotation if kind != "move" else np.eye(3),
        sizes if kind == "scale" else (1, 1, 1),
    )
    new = gizmos.handles("transform", camera, corner, matrix, kind, local=kind == "scale")
    if new is None:
        if form.dragged and not gizmos.dragging():
            form.dragged = False
            post_edit(app, finish)
        return
    if not form.dragged:
        form.dragged, form.scale_before = True, form.scale
    if kind == "rotate":
        form.rotation = angles_of(quat_from_matrix(new[:3, :3]))
    elif kind == "scale":
        # Splats are scaled evenly: by the axis that was dragged most.
        ratios = np.maximum(np.linalg.norm(new[:3, :3], axis=0) / form.scale_before, 1e-9)
        form.scale = form.scale_before * float(ratios[np.argmax(np.abs(np.log(ratios)))])
    else:
        x, y, z = (new[:3, 3] - centre).tolist()
        form.translation = (x, y, z)
    post_edit(app, preview)


def finish(session: EditSession) -> None:
    """Makes the preview a step of the history; the numbers begin anew."""
    session.commit_preview()
    session.forms.move = MoveForm()
