"""The other detectors by splats of which one knows what they are, and what all have in common."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from splatview.edit.detectors import (
    DETECTORS,
    Duplicates,
    FaintSplats,
    Giants,
    IsolatedClusters,
    Needles,
    SparseSplats,
    Undrawable,
    UnseenSplats,
    contributions,
)
from splatview.edit.serialization import from_json, to_json
from splatview.edit.tools import NoTools
from splatview.scene import InputError, look_at
from splatview.scene.edits import DELETED, HIDDEN, IDENTITY, PALETTE_SHIFT, Adjustment
from splatview.scene.framing import robust_bounds
from splatview.scene.progress import Cancelled, Progress


def grid(edit_helpers, edge: int):
    """edge³ round splats of size 0.01, half a unit apart, of opacity a half."""
    count = edge**3
    scene = edit_helpers.make_scene(count)
    means = np.stack(np.meshgrid(*[np.arange(edge) * 0.5] * 3), axis=-1).reshape(count, 3)
    return replace(
        scene,
        means=means.astype(np.float32),
        log_scales=np.full((count, 3), np.log(0.01), np.float32),
        opacity_logits=np.zeros(count, np.float32),
    )


def changed(scene, splat: int, **values):
    arrays = {name: getattr(scene, name).copy() for name in values}
    for name, value in values.items():
        arrays[name][splat] = value
    return replace(scene, **arrays)


def test_needles_are_long_and_discs_are_not(edit_helpers, edited):
    scene = grid(edit_helpers, 3)
    scene = changed(scene, 4, log_scales=np.log((0.5, 0.01, 0.01)))
    scene = changed(scene, 5, log_scales=np.log((0.5, 0.001, 0.5)))
    scores = Needles().scores(scene, edited.none(27), NoTools())
    assert np.flatnonzero(Needles().mask(scores, Needles.threshold)).tolist() == [4]
    np.testing.assert_allclose(scores[[4, 5, 6]], [50, 1, 1], rtol=1e-5)
    scores = Needles(discs=True).scores(scene, edited.none(27), NoTools())
    np.testing.assert_allclose(scores[[4, 5, 6]], [50, 500, 1], rtol=1e-5)


def test_giants_stand_out_among_their_neighbours(edit_helpers, edited):
    scene = changed(grid(edit_helpers, 4), 30, log_scales=np.log((0.3, 0.01, 0.01)))
    scores = Giants().scores(scene, edited.none(64), NoTools())
    np.testing.assert_allclose(scores[30], 30, rtol=1e-4)
    np.testing.assert_allclose(np.delete(scores, 30), 1, rtol=1e-4)
    _, radius = robust_bounds(scene.means)
    scores = Giants(against="scene").scores(scene, edited.none(64), NoTools())
    np.testing.assert_allclose(scores[30], 0.3 / (0.01 * radius), rtol=1e-4)


def test_giants_are_measured_as_edited(edit_helpers, edited):
    scene, edits = grid(edit_helpers, 4), edited.none(64)
    marks = edits.marks.copy()
    marks[20] = 1 << PALETTE_SHIFT
    edits = replace(edits, marks=marks, palette=(IDENTITY, Adjustment(size=40.0)))
    np.testing.assert_allclose(Giants().scores(scene, edits, NoTools())[20], 40, rtol=1e-4)


def test_faint_splats_by_their_edited_opacity(edit_helpers, edited):
    scene, edits = grid(edit_helpers, 2), edited.none(8)
    scene = changed(scene, 1, opacity_logits=np.log(0.01 / 0.99))
    scene = changed(scene, 2, opacity_logits=-np.inf)
    scene = changed(scene, 3, opacity_logits=np.nan)
    marks = edits.marks.copy()
    marks[5] = 1 << PALETTE_SHIFT
    edits = replace(edits, marks=marks, palette=(IDENTITY, Adjustment(opacity=(0.02, 0.0, 0.0, 1.0))))
    scores = FaintSplats().scores(scene, edits, NoTools())
    np.testing.assert_allclose(scores[[0, 1, 2, 5]], [2, 100, np.inf, 100], rtol=1e-5)
    assert np.flatnonzero(FaintSplats().mask(scores, FaintSplats.threshold)).tolist() == [1, 2, 5]
    assert "0.02" in FaintSplats().meaning(50.0)


def test_unseen_are_those_behind_a_wall_and_beside_the_picture(edit_helpers, edited, reference_tools):
    scene = edit_helpers.make_scene(40)
    means = scene.means.copy() * 0.1
    means[:30, 2], means[30:, 2] = 0.0, 2.0  # thirty opaque splats in front of ten
    means[39] = (50, 0, 0)
    scene = replace(
        scene,
        means=means,
        log_scales=np.full((40, 3), -0.5, np.float32),
        opacity_logits=np.full(40, 9.0, np.float32),
    )
    cameras = [look_at((0, 0, -3), (0, 0, 0), fov_y=20, width=24, height=18)]
    edits = edited.none(40)
    detector = UnseenSplats()
    scores = detector.scores(scene, edits, reference_tools, cameras)
    assert scores[39] == np.inf
    assert np.flatnonzero(detector.mask(scores, detector.threshold)).tolist()[-10:] == list(range(30, 40))
    expected = reference_tools.contributions(scene, cameras * 2, edits)
    np.testing.assert_allclose(contributions(scene, edits, reference_tools, cameras * 2), expected)
    # Without the wall one sees what was behind it.
    opened = replace(edits, marks=np.where(np.arange(40) < 30, DELETED, 0).astype(np.uint32), flags=DELETED)
    scores = detector.scores(scene, opened, reference_tools, cameras)
    assert np.isnan(scores[:30]).all()
    assert not detector.mask(scores, detector.threshold)[30:33].any()


def test_unseen_makes_views_where_there_are_none(edit_helpers, edited, reference_tools, monkeypatch):
    from splatview.edit import detectors as visibility

    def few(gaussians, edits):
        return visibility_sample(gaussians, edits, 2, size=16)

    visibility_sample = visibility.sample_cameras
    monkeypatch.setattr(visibility, "sample_cameras", few)
    scene = edit_helpers.make_scene(30)
    scores = UnseenSplats().scores(scene, edited.none(30), reference_tools)
    assert (scores < UnseenSplats.threshold).sum() > 15


def test_unseen_needs_a_renderer(edit_helpers, edited):
    with pytest.raises(InputError, match="renderer"):
        UnseenSplats().scores(edit_helpers.make_scene(5), edited.none(5), NoTools())


def test_broken_and_duplicates_are_healths(edit_helpers, edited):
    scene = edit_helpers.make_scene(20)
    scene = changed(scene, 3, means=np.nan)
    scene = changed(scene, 5, quats=0)
    scene = changed(scene, 6, opacity_logits=-20.0)
    scene = replace(scene.take(np.append(np.arange(20), 7)), extras={})
    for detector, expected in ((Undrawable(), [3, 5, 6]), (Duplicates(), [20])):
        scores = detector.scores(scene, edited.none(21), NoTools())
        assert np.flatnonzero(detector.mask(scores, detector.threshold)).tolist() == expected


@pytest.mark.parametrize("kind", DETECTORS)
def test_what_all_have_in_common(edit_helpers, edited, reference_tools, kind):
    scene, edits = edit_helpers.make_scene(60), edited.some(60)
    cls = DETECTORS[kind]
    cameras = [look_at((0, 0, -3), (0, 0, 0), width=16, height=12)]
    detector = from_json(cls, json.loads(json.dumps(to_json(cls()))))
    assert detector == cls()
    scores = detector.scores(scene, edits, reference_tools, cameras, progress=Progress())
    assert scores.shape == (60,)
    assert scores.dtype == np.float32
    low, high = cls.slider
    assert low <= cls.threshold <= high
    assert low > 0 or not cls.log
    gone = (edits.marks & (HIDDEN | DELETED)) != 0
    assert np.isnan(scores[gone]).all()
    counts = [detector.mask(scores, threshold).sum() for threshold in np.geomspace(low, high, 9)]
    assert counts == sorted(counts, reverse=True)
    assert not detector.mask(scores, low)[gone].any()
    for text in (cls.label, cls.what, cls.unit, detector.meaning(cls.threshold)):
        assert text
        assert "\n" not in text
    with pytest.raises(Cancelled):
        detector.scores(scene, edits, reference_tools, cameras, progress=Progress(cancelled=lambda: True))


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: IsolatedClusters(reach=0), "reach"),
        (lambda: IsolatedClusters(reach=float("nan")), "reach"),
        (lambda: SparseSplats(neighbours=0), "neighbours"),
        (lambda: Giants(against="everything"), "against"),  # type: ignore[arg-type]
        (lambda: Needles(discs=1), "discs"),  # type: ignore[arg-type]
    ],
)
def test_a_bad_field_is_named(make, field):
    with pytest.raises(ValueError, match=f"^{field} "):
        make()
