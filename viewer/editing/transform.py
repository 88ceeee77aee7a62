"""Moving, rotating and scaling splats: by numbers, as a preview, and by handles on the picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2

from splatview.edit.kernels.marks import positions_of
from splatview.edit.operations.files import PlaceFile
from splatview.edit.operations.transform import Transform
from splatview.scene import Camera
from splatview.scene.edits import DELETED, Adjustment
from splatview.scene.errors import printable
from splatview.scene.framing import robust_bounds
from splatview.viewer.editing import gizmos
from splatview.viewer.editing.edit_session import TRANSFORM, EditSession
from splatview.viewer.editing.gizmos import angles_of, quat_from_matrix, quat_of
from splatview.viewer.editing.session import post_edit
from splatview.viewer.editing.tool_state import MoveForm, Place, Subject

if TYPE_CHECKING:
    from splatview.viewer.state import AppState

SAMPLE = 200_000
"""Splats that the pivot is the middle of."""


def preview(session: EditSession) -> None:
    """Shows what the numbers of the form would do."""
    form = session.forms.move
    if any(not np.isfinite(v) for v in (*form.translation, *form.rotation)) or not form.scale > 0:
        return
    change = Transform(
        scope=session.scope,
        translation=form.translation,
        rotation=quat_of(form.rotation),
        scale=form.scale,
        pivot=pivot(session),
    )
    if session.subject != "file":
        session.preview(TRANSFORM, change)
        return
    session.cancel_preview()  # the file's place is that before it
    file = session.active_file
    if file is not None:
        try:
            operation = placed(session.forms.file, file.placement.then(change.adjustment))
        except ValueError as error:
            session.problem = f"{file.name}: {error}"
        else:
            session.preview(TRANSFORM, operation)


def placed(number: int, placement: Adjustment) -> PlaceFile:
    return PlaceFile(
        file=number,
        rotation=placement.rotation,
        translation=placement.translation,
        scale=placement.scale,
    )


def pivot(session: EditSession) -> Place:
    """The middle of what is to be moved, as it is without the preview; kept while one is in force."""
    key = (session.subject, session.forms.file, session.document.versions)
    if session.pivot is None or (session.forms.previewing != TRANSFORM and session.pivot[0] != key):
        document = session.document
        if session.subject == "file":
            splats = np.flatnonzero((document.owners == session.forms.file) & (document.marks & DELETED == 0))
        elif session.scope == "selection":
            splats = document.selected.indices
        else:
            splats = np.arange(len(document.marks))
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


def subjects_of(session: EditSession) -> list[tuple[Subject, str]]:
    """What a transform may be of now, with its name."""
    file, subjects = session.active_file, list[tuple[Subject, str]]()
    if file is not None:
        subjects.append(("file", printable(file.name)))
    if session.document.counts.selected:
        subjects.append(("selection", "Selection"))
    return [*subjects, ("scene", "Whole scene")]


def choose_subject(session: EditSession, subject: Subject) -> None:
    session.cancel_preview()
    session.forms.scope, session.forms.move = subject, MoveForm()


def finish(session: EditSession) -> None:
    """Makes the preview a step of the history; the numbers begin anew."""
    session.commit_preview()
    session.forms.move = MoveForm()
