"""The impact of an edit by pictures compared by hand, and the sample views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.edit.impact import NO_LOSS, Impact, compare, frozen, measure_impact, with_deleted
from splatview.edit.sample_views import sample_cameras
from splatview.measure.metrics import psnr
from splatview.scene import look_at
from splatview.scene.edits import DELETED, HIDDEN, shown
from splatview.scene.framing import robust_bounds
from splatview.scene.progress import Cancelled, Progress

CAMERAS = [
    look_at((0, 0, -3), (0, 0, 0), width=24, height=18),
    look_at((3, -1, 0), (0, 0, 0), width=20, height=20),
    look_at((0, 0, -3), (0, 0, -9), width=16, height=16),  # sees nothing
]


def test_the_impact_is_that_of_the_pictures(edit_helpers, edited, reference_tools):
    scene, before = edit_helpers.make_scene(80), edited.some(80)
    mask = np.arange(80) % 3 == 0
    after = with_deleted(before, mask)
    found = measure_impact(scene, before, after, reference_tools, CAMERAS)
    expected, worst = [], 0.0
    for camera in CAMERAS:
        pictures = [reference_tools.picture(scene, camera, edits) for edits in (before, after)]
        expected.append(min(NO_LOSS, psnr(pictures[1], pictures[0])))
        clipped = [np.clip(picture[..., :3], 0, 1) for picture in pictures]
        worst = max(worst, float(np.abs(clipped[0] - clipped[1]).max()))
    assert found.mean == pytest.approx(np.mean(expected), abs=1e-4)
    assert found.worst == pytest.approx(min(expected), abs=1e-4)
    assert found.worst < found.mean < NO_LOSS
    assert found.largest_error == pytest.approx(worst)
    assert found.count == (shown(scene, before) & mask).sum() > 0
    assert found.views == 3
    assert expected[2] == NO_LOSS


def test_an_edit_of_nothing_costs_nothing(edit_helpers, edited, reference_tools):
    scene, edits = edit_helpers.make_scene(30), edited.some(30)
    found = measure_impact(scene, edits, with_deleted(edits, np.zeros(30, bool)), reference_tools, CAMERAS)
    assert (found.count, found.mean, found.worst, found.largest_error) == (0, NO_LOSS, NO_LOSS, 0.0)
    assert Impact.of((scene, edits), (scene, edits), []).mean == NO_LOSS


def test_nan_is_not_taken_for_no_impact(edit_helpers, edited):
    scene = edit_helpers.make_scene(1), edited.none(1)
    picture = np.zeros((2, 2, 4), np.float32)
    broken = picture.copy()
    broken[0, 0, 0] = np.nan
    views = [compare(CAMERAS[0], picture, other) for other in (picture, broken)]
    found = Impact.of(scene, scene, views)
    assert np.isnan([found.mean, found.worst, found.largest_error]).all()


def test_it_tells_how_far_it_is_and_can_be_stopped(edit_helpers, edited, reference_tools):
    scene, before = edit_helpers.make_scene(30), edited.none(30)
    after = with_deleted(before, np.arange(30) < 10)
    shares: list[float] = []
    measure_impact(scene, before, after, reference_tools, CAMERAS, progress=Progress(report=shares.append))
    assert len(shares) > len(CAMERAS)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    with pytest.raises(Cancelled):
        measure_impact(
            scene, before, after, reference_tools, CAMERAS, progress=Progress(cancelled=lambda: True)
        )


def test_trial_edits_share_nothing_that_changes(edited):
    edits = edited.some(20)
    trial, copy = with_deleted(edits, np.arange(20) < 5), frozen(edits)
    marks = edits.marks.copy()
    assert ((trial.marks & DELETED) != 0)[:5].all()
    assert trial.flags & DELETED
    assert trial.marks_version != edits.marks_version
    assert (edits.marks == marks).all()
    edits.marks[:] = 0
    assert (copy.marks == marks).all()
    assert (trial.marks[5:] == marks[5:]).all()


def test_sample_views_look_at_what_is_shown_from_all_around(edit_helpers, edited):
    scene = edit_helpers.make_scene(400)
    scene = replace(scene, means=scene.means + np.array((5, -7, 100), np.float32))
    edits = edited.none(400)
    cameras = sample_cameras(scene, edits, 12, size=64)
    assert len(cameras) == 12
    centre, radius = robust_bounds(scene.means)
    eyes = np.array([camera.eye for camera in cameras]) - centre
    for camera, eye in zip(cameras, eyes, strict=True):
        point = camera.R_camera_world @ centre + camera.t_camera_world
        assert np.abs(point[:2]).max() < 1e-6 * radius
        assert point[2] > radius
        assert (camera.width, camera.height) == (64, 64)
        assert -eye[1] > -0.2 * np.linalg.norm(eye), "hardly any from below; -y is up"
    assert {tuple(row) for row in np.sign(eyes[:, [0, 2]]).tolist()} >= {(1, 1), (1, -1), (-1, 1), (-1, -1)}
    # Far splats that are hidden do not pull the views away.
    far = scene.means.copy()
    far[:200] += 1000
    marks = np.where(np.arange(400) < 200, HIDDEN, 0).astype(np.uint32)
    again = sample_cameras(replace(scene, means=far), replace(edits, marks=marks, flags=HIDDEN), 1, size=64)
    assert np.linalg.norm(again[0].eye - centre) < 5 * radius


def test_sample_views_of_nothing_and_of_one_point(edit_helpers, edited):
    assert len(sample_cameras(edit_helpers.make_scene(0), edited.none(0), 3)) == 3
    assert len(sample_cameras(edit_helpers.make_scene(1), edited.none(1), 3)) == 3
    with pytest.raises(ValueError, match="count"):
        sample_cameras(edit_helpers.make_scene(1), edited.none(1), 0)
