"""Pictures of edited scenes against pictures of the scene that the edits make."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatview import raster
from splatview.raster.gradients import differentiate
from splatview.scene import RenderSettings, look_at
from splatview.scene.edits import (
    DELETED,
    HIDDEN,
    IDENTITY,
    LOCKED,
    PALETTE_SHIFT,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    bake,
)
from splatview.scene.projection import project

CAMERA = look_at((0.3, 0.2, -2.6), (0, 0, 0), width=37, height=29)
COUNT = 120
BOUND = 1e-4
NEAR_CUT = 2e-6
"""Baked parameters are rounded to float32 once more: an alpha so near the cut may fall to its other side."""

numbers = st.floats(-1, 1, allow_nan=False, width=32)
quaternions = st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: np.linalg.norm(q) > 0.1)


def unit(quat) -> tuple[float, float, float, float]:
    w, x, y, z = np.array(quat) / np.linalg.norm(quat)
    return float(w), float(x), float(y), float(z)


def vectors(low: float, high: float):
    return st.tuples(*[st.floats(low, high)] * 3)


adjustments = st.builds(
    lambda quat, scale, translation, size, opacity, colour: Adjustment(
        rotation=unit(quat),
        scale=math.exp(scale),
        translation=translation,
        size=math.exp(size),
        opacity=(opacity[0], opacity[1], min(opacity[2:]), max(opacity[2:])),
        colour=colour,
    ),
    st.one_of(st.just((1, 0, 0, 0)), quaternions),
    st.floats(-0.7, 0.7),
    vectors(-0.5, 0.5),
    st.floats(-1, 1),
    st.one_of(
        st.just(IDENTITY.opacity), st.tuples(st.floats(0, 2), numbers, st.floats(0, 1), st.floats(0, 1))
    ),
    st.one_of(st.just(IDENTITY.colour), st.tuples(*[st.tuples(*[numbers] * 4)] * 3)),
)
crops = st.builds(
    lambda shape, centre, extents, quat, keep, enabled: Crop(
        shape=shape,
        centre=centre,
        half_extents=extents,
        rotation=unit(quat),
        keep=keep,
        enabled=enabled,
    ),
    st.sampled_from(["box", "sphere"]),
    vectors(-0.6, 0.6),
    vectors(0.1, 1.2),
    quaternions,
    st.sampled_from(["inside", "outside"]),
    st.booleans(),
)


def edits_of(marks, palette=(), crops=()) -> SceneEdits:
    marks = np.asarray(marks, np.uint32)
    flags = int(np.bitwise_or.reduce(marks, initial=0)) & 255
    return SceneEdits(marks=marks, palette=(IDENTITY, *palette), crops=tuple(crops), flags=flags)


def assert_as_baked(scene, edits, chosen=None, camera=CAMERA) -> None:
    chosen = chosen or RenderSettings(background=(0.2, 0.5, 0.8))
    baked = bake(scene, edits)
    expected = raster.render(baked, camera, chosen)
    error = np.abs(raster.render(scene, camera, chosen, edits=edits) - expected).max(axis=2)
    rows, columns = np.nonzero(~(error <= BOUND * max(1.0, float(np.abs(expected).max()))))
    if len(rows):
        alphas = uncut_alphas(baked, camera, chosen, rows, columns)
        cut = chosen.model.alpha_cut
        assert (np.abs(alphas - cut) <= NEAR_CUT).any(axis=0).all(), f"worst by {error.max()}"


def uncut_alphas(scene, camera, chosen, rows, columns) -> np.ndarray:
    """(V, P) alphas at pixels, the cut left away."""
    uncut = replace(chosen, model=replace(chosen.model, alpha_cut=0.0))
    footprints = project(scene, camera, uncut)
    dx, dy = (
        axis[None] + 0.5 - footprints.means2d[:, index, None] for index, axis in enumerate((columns, rows))
    )
    a, b, c = footprints.conic_factors.T[:, :, None]
    with np.errstate(over="ignore"):
        return footprints.opacities[:, None] * np.exp(-((a * dx + b * dy) ** 2 + (c * dy) ** 2) / 2)


@given(
    seed=st.integers(0, 2**31),
    palette=st.lists(adjustments, max_size=4),
    found=st.lists(crops, max_size=3),
    sh_degree=st.integers(0, 3),
)
@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_edits_show_as_if_baked(random_gaussians, seed, palette, found, sh_degree):
    rng = np.random.default_rng(seed)
    scene = random_gaussians(COUNT, sh_degree=sh_degree, seed=seed)
    flags = rng.choice([0, SELECTED, HIDDEN, DELETED, LOCKED, SELECTED | LOCKED, HIDDEN | SELECTED], COUNT)
    entries = rng.integers(0, len(palette) + 1, COUNT)
    marks = flags.astype(np.uint32) | (entries << PALETTE_SHIFT).astype(np.uint32)
    assert_as_baked(scene, edits_of(marks, palette, found))


def test_lower_degree_and_antialiasing(random_gaussians):
    scene = random_gaussians(COUNT, seed=3)
    turn = Adjustment(rotation=unit((1, 2, -1, 0.5)), scale=1.3, translation=(0.1, 0.2, 0))
    edits = edits_of(np.full(COUNT, 1 << PALETTE_SHIFT), [turn])
    for degree in range(4):
        assert_as_baked(scene, edits, RenderSettings(sh_degree=degree))
    model = replace(RenderSettings().model, antialiased=True)
    assert_as_baked(scene, edits, RenderSettings(model=model))


def test_far_from_the_origin(random_gaussians):
    """Turned about a place at 10⁷ m: the means are float64, and so is what moves them."""
    near = random_gaussians(COUNT, sh_degree=1, seed=4)
    place = np.array([1e7, -2e7, 3e6])
    scene = replace(near, means=near.means.astype(np.float64) + place)
    rotation = unit((1, 0.2, 0.1, 0))
    about = Adjustment(rotation=rotation)
    x, y, z = place - about.R @ place
    edits = edits_of(
        np.full(COUNT, 1 << PALETTE_SHIFT), [Adjustment(rotation=rotation, translation=(x, y, z))]
    )
    camera = look_at(tuple(place + np.array([0.3, 0.2, -2.6])), tuple(place), width=37, height=29)
    assert_as_baked(scene, edits, camera=camera)
    assert raster.render(scene, camera, edits=edits)[..., 3].max() > 0.5


def test_nothing_in_force_is_the_scene_itself(random_gaussians):
    scene = random_gaussians(COUNT)
    plain = raster.render(scene, CAMERA)
    for marks in (np.zeros(COUNT), np.full(COUNT, SELECTED | LOCKED)):
        edits = edits_of(marks, crops=[Crop(enabled=False)])
        assert not edits.in_force
        assert np.array_equal(raster.render(scene, CAMERA, edits=edits), plain)


def test_scene_is_left_alone(random_gaussians):
    scene = random_gaussians(COUNT)
    before = [array.copy() for array in raster.parameters_of(scene)]
    edits = edits_of(np.full(COUNT, 1 << PALETTE_SHIFT), [Adjustment(size=2.0, translation=(1, 0, 0))])
    assert np.abs(raster.render(scene, CAMERA, edits=edits) - raster.render(scene, CAMERA)).max() > 0.1
    for array, copy in zip(raster.parameters_of(scene), before, strict=True):
        assert np.array_equal(array, copy)


def test_bad_values_stay_culled(random_gaussians):
    """No adjustment makes a splat of NaN show."""
    scene = random_gaussians(20, sh_degree=1)
    means, logits, sh = scene.means.copy(), scene.opacity_logits.copy(), scene.sh.copy()
    means[0, 1], logits[1], sh[2, 0, 0] = np.nan, np.nan, np.inf
    bad = replace(scene, means=means, opacity_logits=logits, sh=sh)
    white = (0.0, 0.0, 0.0, 1.0)
    change = Adjustment(opacity=(0.0, 0.9, 0.1, 1.0), translation=(0.1, 0, 0), colour=(white, white, white))
    edits = edits_of(np.full(20, 1 << PALETTE_SHIFT), [change])
    image = raster.render(bad, CAMERA, edits=edits)
    assert np.isfinite(image).all()
    good = bad.take(np.arange(3, 20))
    rest = edits_of(edits.marks[3:], [change])
    assert np.array_equal(image, raster.render(good, CAMERA, edits=rest))


def test_wrong_marks_are_named(random_gaussians):
    scene = random_gaussians(20)
    for marks in (np.full(19, HIDDEN, np.uint32), np.full(20, HIDDEN, np.int64)):
        with pytest.raises(ValueError, match=r"edits\.marks"):
            raster.render(scene, CAMERA, edits=SceneEdits(marks=marks, flags=HIDDEN))
    with pytest.raises(ValueError, match=r"edits\.palette"):
        raster.render(scene, CAMERA, edits=edits_of(np.full(20, 2 << PALETTE_SHIFT), [Adjustment(size=2)]))


def test_edited_picture_has_no_gradients(random_gaussians):
    splats = raster.parameters_of(random_gaussians(20))
    edits = edits_of(np.full(20, HIDDEN))
    frame = raster.draw_frame(splats, CAMERA, RenderSettings(), raster.Workspace(), edits=edits)
    assert frame.image.max() == 0
    with pytest.raises(ValueError, match="edits"):
        differentiate(splats, frame, np.ones_like(frame.image))
