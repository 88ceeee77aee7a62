"""Flat splats in the reference: against rays that meet planes one by one, and against what is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.measure.hard_cases.case import about_axis, camera, splats
from splatview.scene import Camera, Gaussians, ImageModel, InputError, Lens, RenderSettings, reference
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits, bake
from splatview.scene.image_model import BLUR, DISC_BLUR, DISC_LEAST_SLOPE, DISC_LEAST_WIDTH
from splatview.scene.projection import rotation_matrices, sigmoid

DISC = ImageModel().with_footprint("disc")
DISCS = RenderSettings(model=DISC)
CAMERA = camera(24, 18, focal=20.0)
PARALLEL = replace(camera(24, 18, focal=7.0, turn=20.0), orthographic=True)

seeds = st.integers(0, 2**32 - 1)
angles = st.floats(0, 360)
axes = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1)


def of_all_kinds(seed: int, count: int = 12) -> Gaussians:
    """Discs before, about and behind the eye."""
    rng = np.random.default_rng(seed)
    scales = rng.normal(-1.3, 1.2, (count, 3))
    scales[np.arange(count), rng.integers(0, 3, count)] = -20
    return splats(
        rng.uniform((-1.5, -1.0, -0.2), (1.5, 1.0, 3.0), (count, 3)),
        log_scales=scales,
        quats=rng.normal(size=(count, 4)),
        logits=rng.normal(1.0, 2.0, count),
        rgb=rng.uniform(0, 1, (count, 3)),
    )


def by_rays(scene: Gaussians, view: Camera, model: ImageModel) -> np.ndarray:
    """The picture as the paper has it: a point of each plane for every ray, in world units, without boxes."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    pixels = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy], axis=-1)
    start, ray = np.zeros((*x.shape, 3)), np.ones((*x.shape, 3))
    (start if view.orthographic else ray)[..., :2] = pixels
    if view.orthographic:
        ray[..., :2] = 0
    t = (scene.means.astype(np.float64) - view.eye) @ view.R_camera_world.T
    turned = view.R_camera_world @ rotation_matrices(scene.quats.astype(np.float64))
    scales = np.exp(scene.log_scales.astype(np.float64))
    rgb = np.maximum(0.5 + 0.28209479177387814 * scene.sh[:, 0].astype(np.float64), 0)
    opacities = sigmoid(scene.opacity_logits.astype(np.float64))
    colour, light = np.zeros((*x.shape, 3)), np.ones(x.shape)
    for i in np.argsort(t[:, 2], kind="stable"):
        if not t[i, 2] >= model.near:
            continue
        thin, second, first = np.argsort(scales[i], kind="stable")
        normal = turned[i][:, thin]
        towards = np.array([0, 0, 1.0]) if view.orthographic else t[i]
        normal = normal if normal @ towards >= 0 else -normal
        least = DISC_LEAST_WIDTH / view.fx * (1 if view.orthographic else t[i, 2])
        slope = ray @ normal
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            met = start + ray * (((t[i] - start) @ normal) / slope)[..., None]
            u = (met - t[i]) @ turned[i][:, first] / max(scales[i, first], least)
            v = (met - t[i]) @ turned[i][:, second] / max(scales[i, second], least)
            on_plane = np.exp(-0.5 * (u * u + v * v))
        on_plane = np.where((slope >= DISC_LEAST_SLOPE) & (met[..., 2] >= model.near), on_plane, 0)
        d = np.stack([x, y], axis=-1) - view.image_points(t[i])
        on_screen = np.exp(-0.5 * (d * d).sum(axis=-1) / model.blur)
        alpha = np.minimum(model.max_alpha, opacities[i] * np.maximum(on_plane, on_screen))
        alpha = np.where(alpha >= model.alpha_cut, alpha, 0)
        colour += (alpha * light)[..., None] * rgb[i]
        light *= 1 - alpha
    return np.concatenate([colour, 1 - light[..., None]], axis=-1)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, parallel=st.booleans(), blur=st.sampled_from([0.01, 0.5, 3.0]))
def test_the_reference_is_what_rays_say(seed, parallel, blur):
    scene, view = of_all_kinds(seed), PARALLEL if parallel else CAMERA
    model = replace(DISC, blur=blur)
    picture = reference.render(scene, view, RenderSettings(model=model))
    np.testing.assert_allclose(picture, by_rays(scene, view, model), atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, parallel=st.booleans())
def test_float32_stays_close(seed, parallel):
    scene, view = of_all_kinds(seed), PARALLEL if parallel else CAMERA
    truth = reference.render(scene, view, DISCS)
    single = reference.render(scene, view, DISCS, dtype=np.float32)
    assert single.dtype == np.float32
    beyond = np.abs(single - truth).max(axis=-1) > 2e-3
    # An alpha may sit on its cut, or a ray on the least slope.
    assert beyond.sum() <= 1


def test_a_disc_at_45_degrees_by_hand():
    """Its plane is z = 2 + x: the ray (q, 0, 1) meets it at z = 2 / (1 - q), sqrt(2)·2q / (1 - q) from the
    mean, which is u = sqrt(8)·q / (1 - q) with a scale of 1. Far pixels see more of it than near ones."""
    scene = splats([(0, 0, 2)], scale=(1.0, 0.5, 1e-6), quats=about_axis((0, 1, 0), -45), logits=0.0, rgb=1)
    view = camera(101, 11, focal=100.0, cx=50.5, cy=5.5)
    picture = reference.render(scene, view, RenderSettings(model=replace(DISC, blur=0.0)))
    for column, row in ((0, 5), (30, 5), (50, 5), (70, 5), (100, 5), (60, 1), (40, 10)):
        q, p = (column - 50) / 100, (row - 5) / 100
        z = 2 / (1 - q)
        u, v = math.sqrt(2) * (z - 2), p * z / 0.5
        assert picture[row, column, 3] == pytest.approx(0.5 * math.exp(-0.5 * (u * u + v * v)), rel=1e-6)
    # 0.5·exp(-4·q²/(1 - q)²): worked out once, for a quarter.
    assert picture[5, 75, 3] == pytest.approx(0.5 * math.exp(-4 / 9), rel=1e-6)


@settings(max_examples=20, deadline=None)
@given(
    mean=st.tuples(st.floats(-1, 1), st.floats(-0.7, 0.7), st.floats(0.5, 4)),
    scales=st.tuples(st.floats(-3, 0.5), st.floats(-3, 0.5)),
    turn=angles,
)
def test_a_disc_that_faces_the_camera_is_an_ellipsoid_without_thickness(mean, scales, turn):
    """Both are the same ellipse then. Without blur, which each has in its own way."""
    scene = splats([mean], log_scales=(*scales, -30), quats=about_axis((0, 0, 1), turn), logits=2.0)
    for view in (CAMERA, replace(CAMERA, fx=8.0, fy=9.0, orthographic=True)):
        solid, flat = (
            reference.render(
                scene,
                view,
                RenderSettings(
                    model=ImageModel(blur=0.0, alpha_cut=0.0, jacobian_margin=None, footprint=kind)
                ),
            )
            for kind in ("ellipsoid", "disc")
        )
        # The least width is in units of 1/64 px: none of these is as thin.
        np.testing.assert_allclose(flat, solid, atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, axis=axes, turn=angles, shift=st.tuples(*[st.floats(-3, 3)] * 3))
def test_pictures_do_not_change_as_world_and_camera_move_together(seed, axis, turn, shift):
    scene = of_all_kinds(seed)
    w, x, y, z = about_axis(axis, turn).tolist()
    moved = Adjustment(rotation=(w, x, y, z), translation=shift)
    marks = np.full(len(scene), 1 << PALETTE_SHIFT, np.uint32)
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = moved.R, shift
    view = replace(CAMERA, world_to_camera=CAMERA.world_to_camera @ np.linalg.inv(world))
    edits = SceneEdits(marks=marks, palette=(IDENTITY, moved))
    precise = replace(scene, means=scene.means.astype(np.float64))
    there = reference.render(bake(precise, edits), view, DISCS)
    # Baked quaternions are float32.
    assert (np.abs(there - reference.render(scene, CAMERA, DISCS)).max(axis=-1) > 2e-3).sum() <= 1


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_axes_by_other_names_are_the_same_disc(seed):
    """A quarter turn about an axis of its own, with the other two scales exchanged."""
    scene = of_all_kinds(seed, count=6)
    half = math.sqrt(0.5)
    w, x, y, z = scene.quats.astype(np.float64).T
    # times (half, 0, 0, half): about its own z
    turned = np.stack([w - z, x + y, y - x, z + w], axis=1) * half
    exchanged = replace(
        scene,
        quats=turned.astype(np.float32),
        log_scales=np.ascontiguousarray(scene.log_scales[:, [1, 0, 2]]),
    )
    one, other = (reference.render(scene, CAMERA, DISCS) for scene in (scene, exchanged))
    assert (np.abs(one - other).max(axis=-1) > 2e-3).sum() <= 1


def test_edge_on_a_dot_is_left():
    scene = splats([(0, 0, 2)], scale=(0.5, 0.5, 0), quats=about_axis((0, 1, 0), 90), logits=1.0)
    picture = reference.render(scene, CAMERA, DISCS)
    x, y = np.meshgrid(np.arange(24) + 0.5 - 12, np.arange(18) + 0.5 - 9)
    dot = sigmoid(np.array(1.0)) * np.exp(-0.5 * (x * x + y * y) / DISC_BLUR)
    np.testing.assert_allclose(picture[..., 3], np.where(dot >= 1 / 255, dot, 0), atol=1e-6)
    bare = RenderSettings(model=replace(DISC, blur=0.0))
    assert not reference.render(scene, CAMERA, bare)[..., 3].any()


def test_what_is_nearer_than_the_near_plane_is_not_seen():
    """A floor below the eye, about 2 units ahead: the lower a row, the nearer it sees it."""
    scene = splats([(0, 0.5, 2)], scale=(3, 3, 0), quats=about_axis((1, 0, 0), 90), logits=3.0)
    depth = 0.5 * 20 / np.maximum(np.arange(18) + 0.5 - 9, 1e-9)
    for near in (0.01, 1.2):
        seen = reference.render(scene, CAMERA, RenderSettings(model=replace(DISC, near=near)))[:, 12, 3] > 0
        # From 3 scales behind the mean down to the near plane; the mean's own row is among them.
        assert (seen == (depth >= near) & (depth < 11)).all()
        assert seen.sum() == (8 if near == 0.01 else 7)


def test_antialiasing_says_nothing_of_discs():
    scene = of_all_kinds(5)
    flagged = RenderSettings(model=replace(DISC, antialiased=True))
    assert (reference.render(scene, CAMERA, flagged) == reference.render(scene, CAMERA, DISCS)).all()


def test_the_blur_comes_and_goes_with_the_footprint():
    assert (DISC.footprint, DISC.blur) == ("disc", DISC_BLUR)
    assert DISC.with_footprint("ellipsoid") == ImageModel() and ImageModel().blur == BLUR
    own = replace(DISC, blur=1.0)
    assert own.with_footprint("disc") is own


def test_discs_are_not_seen_through_a_lens():
    bent = replace(CAMERA, name="photo 7", lens=Lens(model="SIMPLE_RADIAL", parameters=(0.1,)))
    with pytest.raises(InputError, match=r"'photo 7' has a lens.*--footprint ellipsoid"):
        reference.render(of_all_kinds(1), bent, DISCS)
