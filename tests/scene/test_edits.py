"""Adjustments compose, crops cut where they say, and baking is what a turned camera would see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.scene import Camera, Gaussians, RenderSettings, look_at_matrix
from splatview.scene.edits import (
    DELETED,
    HIDDEN,
    IDENTITY,
    PALETTE_SHIFT,
    Adjustment,
    Crop,
    SceneEdits,
    adjustment_rows,
    bake,
    crop_rows,
    cropped_in,
    shown,
)
from splatview.scene.reference import render
from splatview.scene.sh import sh_basis, sh_rotation

finite = st.floats(-2, 2, allow_nan=False)
fours = st.tuples(finite, finite, finite, finite)


@st.composite
def adjustments(draw) -> Adjustment:
    quat = np.array([3 + draw(finite), draw(finite), draw(finite), draw(finite)])
    quat /= np.linalg.norm(quat)
    low, high = sorted((draw(st.floats(0, 1)), draw(st.floats(0, 1))))
    return Adjustment(
        rotation=tuple(quat),
        scale=draw(st.floats(0.2, 5)),
        translation=tuple(draw(finite) for _ in range(3)),
        size=draw(st.floats(0.2, 5)),
        opacity=(draw(st.floats(0, 2)), draw(st.floats(-1, 1)), low, high),
        colour=(draw(fours), draw(fours), draw(fours)),
    )


def scene(count: int, degree: int, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    return Gaussians(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(-2, 0.5, (count, 3)).astype(np.float32),
        opacity_logits=rng.normal(size=count).astype(np.float32),
        sh=rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def effect(adjustment: Adjustment, opacities: np.ndarray, points: np.ndarray, colours: np.ndarray):
    gain, offset, low, high = adjustment.opacity
    colour = np.array(adjustment.colour)
    return (
        np.clip(gain * opacities + offset, low, high),
        points @ adjustment.linear.T + np.array(adjustment.translation),
        colours @ colour[:, :3].T + colour[:, 3],
    )


@settings(max_examples=50, deadline=None)
@given(adjustments(), adjustments())
def test_then_is_one_after_the_other(first, second):
    rng = np.random.default_rng(0)
    values = (rng.uniform(0, 1, 20), rng.normal(size=(20, 3)), rng.uniform(0, 1, (20, 3)))
    step_by_step = effect(second, *effect(first, *values))
    for one, two in zip(effect(first.then(second), *values), step_by_step, strict=True):
        np.testing.assert_allclose(one, two, atol=1e-9, rtol=1e-9)


@settings(max_examples=25, deadline=None)
@given(adjustments())
def test_rows_say_what_the_adjustment_does_about_any_centre(adjustment):
    centre, points = np.array([1e6, -2e5, 30.0]), np.random.default_rng(1).normal(size=(5, 3))
    row = adjustment_rows((IDENTITY, adjustment), centre)[1]
    relative = points @ row[:12].reshape(3, 4)[:, :3].T + row[:12].reshape(3, 4)[:, 3]
    expected = (points + centre) @ adjustment.linear.T + np.array(adjustment.translation)
    np.testing.assert_allclose(relative + centre, expected, rtol=1e-9)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_sh_turn_with_the_splat(degree):
    rng = np.random.default_rng(degree)
    quat = rng.normal(size=4)
    R = Adjustment(rotation=tuple(quat / np.linalg.norm(quat))).R
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    coefficients = rng.normal(size=(degree + 1) ** 2)
    turned = sh_basis(directions @ R.T, degree) @ (sh_rotation(R, degree) @ coefficients)
    np.testing.assert_allclose(turned, sh_basis(directions, degree) @ coefficients, atol=1e-13)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_turned_scene_seen_by_the_turned_camera_is_the_same_picture(degree):
    gaussians = scene(40, degree)
    quat = np.array([0.8, 0.3, -0.4, 0.1])
    turn = Adjustment(rotation=tuple(quat / np.linalg.norm(quat)), translation=(0.5, -2.0, 1.0))
    world_to_camera = look_at_matrix((0, 0, -5), (0, 0, 0), (0, 1, 0))
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = turn.R, turn.translation
    cameras = [
        Camera(width=48, height=32, fx=40, fy=40, cx=24, cy=16, world_to_camera=matrix)
        for matrix in (world_to_camera, world_to_camera @ np.linalg.inv(moved))
    ]
    marks = np.full(40, 1 << PALETTE_SHIFT, np.uint32)
    baked = bake(gaussians, SceneEdits(marks=marks, palette=(IDENTITY, turn)))
    before = render(gaussians, cameras[0], RenderSettings())
    after = render(baked, cameras[1], RenderSettings())
    assert np.abs(before - after).max() <= 1e-4
    assert before[..., 3].max() > 0.5


def test_a_scene_of_another_scale_has_no_near_plane(random_gaussians):
    gaussians = replace(random_gaussians(6), comments=("near plane 1.5", "by hand"))
    marks = np.zeros(6, np.uint32)
    marks[:2] = 1 << PALETTE_SHIFT
    for adjustment, kept in ((Adjustment(scale=0.5), 1), (Adjustment(size=0.5), 2)):
        baked = bake(gaussians, SceneEdits(marks=marks, palette=(IDENTITY, adjustment)))
        assert baked.comments == gaussians.comments[-kept:]


def test_baking_leaves_untouched_splats_to_the_byte():
    gaussians = scene(10, 2)
    marks = np.zeros(10, np.uint32)
    marks[3], marks[4], marks[5] = DELETED, HIDDEN, 1 << PALETTE_SHIFT
    edits = SceneEdits(marks=marks, palette=(IDENTITY, Adjustment(size=2.0)), flags=DELETED | HIDDEN)
    baked = bake(gaussians, edits, hidden=True)
    kept = np.array([0, 1, 2, 4, 6, 7, 8, 9])
    rows = np.array([0, 1, 2, 3, 5, 6, 7, 8])
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        assert getattr(baked, name)[rows].tobytes() == getattr(gaussians, name)[kept].tobytes()
    np.testing.assert_allclose(baked.log_scales[4], gaussians.log_scales[5] + np.log(2), rtol=1e-6)
    assert len(bake(gaussians, edits)) == 8


def test_edited_opacities_stay_finite():
    gaussians = scene(2, 0)
    marks = np.array([1, 2], np.uint32) << PALETTE_SHIFT
    opaque, clear = Adjustment(opacity=(0, 1, 0, 1)), Adjustment(opacity=(0, 0, 0, 1))
    baked = bake(gaussians, SceneEdits(marks=marks, palette=(IDENTITY, opaque, clear)))
    np.testing.assert_array_equal(baked.opacity_logits, [16, -16])


def test_colours_are_graded_as_the_map_says():
    gaussians = scene(6, 3)
    colour = ((0.5, 0.2, 0.0, 0.1), (0.0, 0.9, 0.1, -0.05), (0.3, 0.0, 0.4, 0.2))
    marks = np.full(6, 1 << PALETTE_SHIFT, np.uint32)
    baked = bake(gaussians, SceneEdits(marks=marks, palette=(IDENTITY, Adjustment(colour=colour))))
    basis = sh_basis(np.array([[0.6, 0.0, 0.8]]), 3)[0]
    before = 0.5 + np.einsum("k,nkc->nc", basis, gaussians.sh)
    after = 0.5 + np.einsum("k,nkc->nc", basis, baked.sh)
    np.testing.assert_allclose(after, before @ np.array(colour)[:, :3].T + np.array(colour)[:, 3], atol=1e-6)


def test_crops_keep_the_union_of_insides_less_the_outsides():
    points = np.array([[0, 0, 0], [3, 0, 0], [0.9, 0.9, 0], [5, 5, 5], [np.nan, 0, 0]], np.float32)
    box = Crop(half_extents=(1, 1, 1))
    ball = Crop(shape="sphere", centre=(3, 0, 0))
    hole = Crop(shape="sphere", half_extents=(0.5, 0.5, 0.5), keep="outside")
    assert cropped_in((), points).tolist() == [True] * 5
    assert cropped_in((box, ball), points).tolist() == [True, True, True, False, False]
    assert cropped_in((box, ball, hole), points).tolist() == [False, True, True, False, False]
    assert cropped_in((hole,), points).tolist() == [False, True, True, True, True]


def test_a_crop_turned_by_45_degrees_cuts_where_its_rows_say():
    half = np.pi / 8
    box = Crop(half_extents=(2, 0.5, 0.5), rotation=(float(np.cos(half)), 0, 0, float(np.sin(half))))
    assert box.contains(np.array([[1.3, 1.3, 0], [1.3, -1.3, 0]])).tolist() == [True, False]
    centre = np.array([100.0, 0, 0])
    row = crop_rows((box,), centre)[0][:12].reshape(3, 4)
    own = (np.array([1.3, 1.3, 0]) - centre) @ row[:, :3].T + row[:, 3]
    assert np.abs(own).max() <= 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"half_extents": (1, 0, 1)},
        {"rotation": (2, 0, 0, 0)},
        {"centre": (np.nan, 0, 0)},
        {"shape": "cone"},
        {"keep": "some"},
    ],
)
def test_wrong_crops_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Crop(**wrong)


@pytest.mark.parametrize(
    "wrong", [{"scale": 0}, {"size": np.nan}, {"opacity": (1, 0, 0.5, 0.4)}, {"rotation": (0, 0, 0, 0)}]
)
def test_wrong_adjustments_are_named(wrong):
    with pytest.raises(
        ValueError, match="finite" if np.isnan(next(iter(wrong.values()))).any() else next(iter(wrong))
    ):
        Adjustment(**wrong)


def test_changes_are_known_since_a_version():
    edits = SceneEdits(
        marks=np.zeros(9, np.uint32), marks_version=5, changes=((3, 1, 2), (4, 5, 7), (5, 4, 5))
    )
    assert edits.changed_since(5) == (0, 0)
    assert edits.changed_since(3) == (4, 7)
    assert edits.changed_since(2) == (1, 7)
    assert edits.changed_since(1) is None
    assert shown(scene(9, 0), edits).all()
