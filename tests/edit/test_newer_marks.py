"""Splats are measured in threads that edits do not wait for: new marks name what an older palette lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from splatview.edit.detectors import FaintSplats
from splatview.edit.document import Document
from splatview.edit.kernels.marks import Places, in_volume
from splatview.edit.operations.appearance import Opacity
from splatview.edit.tools import NoTools
from splatview.scene import look_at
from splatview.scene.edits import PALETTE_SHIFT, SceneEdits


def edit_and_check(document: Document, edits: SceneEdits) -> None:
    """What the user does while `edits` are being read, and that these stay whole."""
    document.apply(Opacity(value=0.5, scope="scene"))
    assert (document.marks >> PALETTE_SHIFT).max() == 1
    assert (edits.marks >> PALETTE_SHIFT).max() < len(edits.palette) == 1


def test_scores_are_of_the_edits_that_they_began_with(edit_helpers, monkeypatch: pytest.MonkeyPatch) -> None:
    document, of_all = Document(edit_helpers.make_scene(20)), FaintSplats._scores

    def scores(detector: FaintSplats, query: Any) -> np.ndarray:
        edit_and_check(document, query.edits)
        return of_all(detector, query)

    monkeypatch.setattr(FaintSplats, "_scores", scores)
    assert len(document.scores(FaintSplats())) == 20


def test_so_are_contributions(edit_helpers) -> None:
    class Tools(NoTools):
        def contributions(self, gaussians, cameras, edits):
            edit_and_check(document, edits)
            return np.zeros(len(gaussians))

    camera = look_at((0, 0, -4), (0, 0, 0), width=8, height=8)
    document = Document(edit_helpers.make_scene(20), tools=Tools())
    assert len(document.contributions((camera,))) == 20


def test_what_the_palette_lacks_moves_nothing() -> None:
    beyond = np.full((2, 12), 7.0)
    places = Places(np.zeros((1, 3), np.float32), np.array([1 << PALETTE_SHIFT], np.uint32), beyond[:1])
    inside = np.zeros(1, bool)
    in_volume(0, 1, places, np.eye(3, 4), False, inside)
    assert inside[0]
