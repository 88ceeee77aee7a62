"""Export of the edited scene, for the window and for scripts."""

from __future__ import annotations

from pathlib import Path

from splatview.edit.document import Document
from splatview.scene import Gaussians, InputError
from splatview.scene.edits import bake
from splatview.scene.formats import save_scene


def exported(document: Document) -> Gaussians:
    """The edited scene: deleted and cropped splats left out, hidden ones kept, adjustments applied to the
    values, comments and extras as they were. A preview is cancelled.

    Raises:
        InputError: no splats would be left.
    """
    document.cancel_preview()
    scene = bake(document.gaussians, document.edits, hidden=True)
    if not len(scene):
        raise InputError("everything is deleted or cropped away; there is nothing to export")
    return scene


def export(document: Document, path: Path) -> int:
    """Writes the edited scene to `path`, wholly or not at all, in the format of the suffix; it may be the
    very file that the scene came from. Returns the number of splats.

    Raises:
        InputError: no splats would be left, or the file cannot be written; an older file is still whole.
    """
    scene = exported(document)
    save_scene(scene, path)
    document.history.mark_saved()
    return len(scene)
