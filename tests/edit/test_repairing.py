"""Repairs: what was found is found no more, and nothing else changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from splatview.edit.document import Document, exported
from splatview.edit.operations import operation_from_json
from splatview.edit.operations.cleanup import REPAIRS
from splatview.scene import Gaussians
from splatview.scene.health import check
from splatview.scene.projection import rotation_matrices


@pytest.fixture
def scene(edit_helpers) -> Gaussians:
    return edit_helpers.make_scene(30)


def do(document: Document, op: str, **fields: Any):
    return document.apply(operation_from_json({"op": op, **fields}))


def ill_scene(scene: Gaussians) -> Gaussians:
    scales, quats, means = scene.log_scales.copy(), scene.quats.copy(), scene.means.copy()
    logits, sh = scene.opacity_logits.copy(), scene.sh.copy()
    scales[0] = (0, -9, -9)
    scales[1] = (-2, -2, -12)
    scales[2] = (np.nan, 100, -3)
    scales[3] = (-25, -3, -3)
    scales[4] = (9, 9, 9)
    quats[5], quats[6] = 0, np.inf
    means[7, 0] = np.nan
    logits[8], logits[9], logits[10] = np.nan, np.inf, -20
    sh[11, 1], sh[12, 2] = np.inf, 30
    for values in (scales, quats, means, logits, sh):
        values[14] = values[13]
    return Gaussians(means=means, quats=quats, log_scales=scales, opacity_logits=logits, sh=sh)


@pytest.mark.parametrize("finding", REPAIRS)
def test_repaired_splats_are_found_no_more(scene, edit_helpers, finding):
    document = Document(ill_scene(scene))
    before = edit_helpers.everything(document)
    change = do(document, "repair", finding=finding)
    assert change.count > 0
    found = {each.name: each for each in check(exported(document))}
    if finding == "quaternion lengths":
        lengths = np.linalg.norm(document.gaussians.quats, axis=1)
        assert (np.abs(lengths - 1) < 1e-6).sum() == 28
        np.testing.assert_allclose(
            rotation_matrices(document.gaussians.quats[:5].astype(np.float64)),
            rotation_matrices(ill_scene(scene).quats[:5].astype(np.float64)),
            atol=1e-6,
        )
    else:
        assert found[finding].count == 0
    document.undo()
    assert edit_helpers.everything(document) == before


def test_repairs_leave_everybody_else(scene):
    ill = ill_scene(scene)
    document = Document(ill)
    do(document, "repair", finding="non-finite scales")
    others = np.arange(30) != 2
    assert document.gaussians.log_scales[others].tobytes() == ill.log_scales[others].tobytes()
    assert document.gaussians.sh is ill.sh
    assert document.gaussians.log_scales[2].tolist() == [-3, 20, -3]
