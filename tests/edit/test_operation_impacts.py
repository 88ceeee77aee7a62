"""The impact of any step by pictures compared by hand, without the step being done."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.edit.document import Document
from splatview.edit.impact import NO_LOSS, StepImpacts, after, in_words, operation_impacts
from splatview.edit.operations import (
    AddCrop,
    ColourGrade,
    Delete,
    Duplicate,
    Repair,
    SelectAll,
    Split,
    Transform,
)
from splatview.edit.operations.appearance import Grade
from splatview.edit.sample_views import sample_cameras
from splatview.measure.metrics import psnr
from splatview.scene import Gaussians, InputError, look_at
from splatview.scene.edits import Crop

CAMERAS = [
    look_at((0, 0, -3), (0, 0, 0), width=24, height=18),
    look_at((3, -1, 0), (0, 0, 0), width=20, height=20),
]


@pytest.fixture
def invalid(edit_helpers) -> Gaussians:
    """Needles, a colour far too bright, and quaternions of any length."""
    scene = edit_helpers.make_scene(60)
    scales, sh = scene.log_scales.copy(), scene.sh.copy()
    scales[:6, 0], scales[:6, 1:] = 0.0, -7.0
    sh[6:9, 0] = 40.0
    return replace(scene, log_scales=scales, sh=sh)


OPERATIONS = {
    "needles": Repair(finding="needles"),
    "bright": Repair(finding="SH out of range"),
    "unit": Repair(finding="quaternion lengths"),
    "none": Repair(finding="giants"),
    "move": Transform(scope="scene", translation=(0.2, 0.0, 0.0)),
    "grade": ColourGrade(grade=Grade(brightness=0.2)),
    "crop": AddCrop(crop=Crop(half_extents=(0.5, 0.5, 0.5))),
    "copy": Duplicate(),
    "delete": Delete(),
}


def test_each_impact_is_that_of_the_pictures_of_the_step_done(invalid, reference_tools, edit_helpers):
    document = Document(invalid, tools=reference_tools)
    document.apply(SelectAll())
    before = edit_helpers.everything(document)
    impacts = operation_impacts(document, OPERATIONS, CAMERAS)
    assert edit_helpers.everything(document) == before
    first = [reference_tools.picture(document.gaussians, camera, document.edits) for camera in CAMERAS]
    for name, operation in OPERATIONS.items():
        document.apply(operation)
        done = [reference_tools.picture(document.gaussians, camera, document.edits) for camera in CAMERAS]
        expected = [min(NO_LOSS, psnr(b, a)) for a, b in zip(first, done, strict=True)]
        assert impacts[name].mean == pytest.approx(np.mean(expected), abs=1e-4), name
        assert impacts[name].worst == pytest.approx(min(expected), abs=1e-4), name
        assert impacts[name].views == 2
        if document.history.position > 1:
            document.undo()
    assert impacts["needles"].mean < 90
    assert impacts["bright"].mean < 60
    assert impacts["none"].mean == NO_LOSS
    assert impacts["delete"].count == 60
    assert impacts["needles"].count == impacts["copy"].count == 0
    # Unit quaternions turn nothing: what is left is rounding.
    assert impacts["unit"].mean > 90


def test_impacts_of_steps_are_of_each_by_itself(invalid, reference_tools):
    document = Document(invalid, tools=reference_tools)
    alone = operation_impacts(document, {"needles": OPERATIONS["needles"]}, CAMERAS)["needles"]
    steps = StepImpacts(document, CAMERAS)
    document.apply(OPERATIONS["needles"])
    assert steps.after_step() == alone
    assert steps.after_step().mean == NO_LOSS
    document.apply(OPERATIONS["bright"])
    assert steps.after_step().mean < 60


def test_no_file_is_written_for_an_impact(invalid, tmp_path: Path, reference_tools):
    saved = []
    document = Document(
        invalid, tools=reference_tools, folder=tmp_path, save=lambda scene, path: saved.append(path)
    )
    document.apply(SelectAll())
    change = document.plan(Split(path="part.ply")).change
    _, edits = after(document, change)
    assert (edits.marks != document.marks).any()
    assert saved == []
    operation_impacts(document, {"split": Split(path="part.ply")}, CAMERAS)
    assert saved == []


def test_without_a_renderer_it_says_so(invalid):
    with pytest.raises(InputError, match="renderer"):
        operation_impacts(Document(invalid), {"needles": OPERATIONS["needles"]}, CAMERAS)


def test_in_words(invalid, reference_tools):
    document = Document(invalid, tools=reference_tools)
    views = sample_cameras(invalid, document.edits, 2, size=24)
    impacts = operation_impacts(document, {n: OPERATIONS[n] for n in ("needles", "none")}, views)
    assert in_words(impacts["none"]) == "no pixel of 2 views changes"
    assert f"{impacts['needles'].worst:.1f} dB at worst, over 2 views" in in_words(impacts["needles"])
