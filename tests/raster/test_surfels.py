"""Flat splats on the CPU against the reference, in every order, edited, weighed, and where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview import raster
from splatview.measure.hard_cases.case import about_axis, camera, splats
from splatview.raster import Workspace, draw_frame, parameters_of
from splatview.raster.contributions import contributions, count_work, dominant_splats
from splatview.raster.gradients import differentiate
from splatview.scene import Gaussians, ImageModel, RenderSettings, reference

DISCS = RenderSettings(model=ImageModel().with_footprint("disc"), background=(0.1, 0.3, 0.2))
CAMERA = camera(45, 37, focal=33.0)
PARALLEL = replace(camera(45, 37, focal=14.0, turn=20.0), orthographic=True)


def of_all_kinds(seed: int, count: int = 40) -> Gaussians:
    rng = np.random.default_rng(seed)
    scales = rng.normal(-1.5, 1.2, (count, 3))
    scales[np.arange(count), rng.integers(0, 3, count)] = -20
    return splats(
        rng.uniform((-1.5, -1.0, -0.2), (1.5, 1.0, 3.0), (count, 3)),
        log_scales=scales,
        quats=rng.normal(size=(count, 4)),
        logits=rng.normal(1.0, 2.0, count),
        rgb=rng.uniform(0, 1, (count, 3)),
    )


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), parallel=st.booleans(), blur=st.sampled_from([0.0, 0.5, 3.0]))
def test_pictures_are_the_references(seed, parallel, blur):
    scene, view = of_all_kinds(seed), PARALLEL if parallel else CAMERA
    chosen = replace(DISCS, model=replace(DISCS.model, blur=blur))
    truth = reference.render(scene, view, chosen)
    error = np.abs(raster.render(scene, view, chosen) - truth).max(axis=-1)
    # An alpha may sit on its cut, or a ray on the least slope.
    assert (error > 2e-4).sum() <= 1


def test_walls_beside_the_eye_keep_their_edge_tiles():
    """Surfels that reach into the picture from beside the eye, where a box bounds them: made for a larger
    reach than the one that tiles go by, it lost tiles at its edges (10 of 400 such, by up to 0.96)."""
    rng = np.random.default_rng(2)
    worst = []
    for _ in range(160):
        tilt = about_axis(tuple(rng.normal(size=3)), rng.uniform(0, 180))
        beside = rng.choice([-1, 1]) * rng.uniform(0.3, 6), rng.uniform(-3, 3), rng.uniform(0.011, 0.4)
        sizes = rng.uniform(-1, 3), rng.uniform(-1, 3), -20
        wall = splats(
            [beside], log_scales=[sizes], quats=[tilt], logits=rng.uniform(0, 6), rgb=[(1, 0.5, 0.2)]
        )
        view = camera(200, 150, focal=rng.uniform(60, 200))
        chosen = replace(DISCS, background=(0.0, 0.0, 0.0))
        worst.append(np.abs(raster.render(wall, view, chosen) - reference.render(wall, view, chosen)).max())
    assert max(worst) <= 1.01 / 255, "more than an alpha on its cut"


@pytest.mark.slow  # to compile, the pictures are small
def test_pictures_in_float64_are_the_references_to_rounding():
    for view in (CAMERA, PARALLEL):
        scene = of_all_kinds(8)
        drawn = draw_frame(parameters_of(scene), view, DISCS, Workspace(), dtype=np.float64, early_stop=0.0)
        np.testing.assert_allclose(drawn.image, reference.render(scene, view, DISCS), atol=1e-11)


def test_without_a_cut_every_disc_reaches_every_pixel():
    chosen = replace(DISCS, model=replace(DISCS.model, alpha_cut=0.0))
    for view in (CAMERA, PARALLEL):
        truth = reference.render(of_all_kinds(3), view, chosen)
        np.testing.assert_allclose(raster.render(of_all_kinds(3), view, chosen), truth, atol=2e-4)


def test_in_per_pixel_order_planes_cross():
    """Two opaque planes through each other: by means one hides the other, by pixels each hides a half."""
    quats = [about_axis((0, 1, 0), 45), about_axis((0, 1, 0), -45)]
    scene = splats(
        [(0, 0, 2), (0, 0, 2.01)], scale=(1, 1, 0), quats=quats, logits=9, rgb=[(1, 0, 0), (0, 0, 1)]
    )
    for view in (CAMERA, replace(CAMERA, fx=12.0, fy=12.0, orthographic=True)):
        one, both = (
            raster.render(scene, view, replace(DISCS, order=order))[18] for order in ("32-bit", "per-pixel")
        )
        # The plane of the red one is z = 2 - x: it is nearer on the right.
        assert (one[17:29, 0] > one[17:29, 2]).all()
        assert (both[13:20, 2] > both[13:20, 0]).all() and (both[25:32, 0] > both[25:32, 2]).all()


def test_contributions_ids_and_counts_of_discs():
    scene = of_all_kinds(6)
    model = replace(DISCS.model, alpha_cut=1 / 255)
    chosen = RenderSettings(model=model, background=(0.0, 0.0, 0.0))
    total = contributions(scene, [CAMERA], chosen)
    picture = reference.render(scene, CAMERA, chosen)
    assert total.sum() == pytest.approx(picture[..., 3].sum(), rel=1e-4)
    # Contributions times colours are the picture's sums.
    rgb = np.maximum(0.5 + 0.28209479177387814 * scene.sh[:, 0].astype(np.float64), 0)
    np.testing.assert_allclose(total @ rgb, picture[..., :3].sum(axis=(0, 1)), rtol=1e-4)
    ids = dominant_splats(scene, CAMERA, chosen)
    assert (ids >= 0).any() and not np.array_equal(ids, dominant_splats(scene, CAMERA))
    counted = count_work(parameters_of(scene), CAMERA, chosen, Workspace())
    ellipsoids = count_work(parameters_of(scene), CAMERA, RenderSettings(), Workspace())
    evaluated = counted.evaluations > 0
    assert np.array_equal(evaluated, picture[..., 3] > 0)
    assert not np.array_equal(counted.evaluations, ellipsoids.evaluations)


def test_discs_have_no_gradients():
    scene = of_all_kinds(1)
    splats_of, workspace = parameters_of(scene), Workspace()
    frame = draw_frame(splats_of, CAMERA, DISCS, workspace)
    with pytest.raises(ValueError, match="discs has no gradients: draw it with ellipsoids"):
        differentiate(splats_of, frame, np.ones_like(frame.image))


def test_ellipsoids_have_no_rows_of_discs():
    scene, workspace = of_all_kinds(2), Workspace()
    frame = draw_frame(parameters_of(scene), CAMERA, RenderSettings(), workspace)
    before = workspace.nbytes
    assert frame.surfels is None
    frame = draw_frame(parameters_of(scene), CAMERA, DISCS, workspace)
    assert frame.surfels is not None and frame.surfels.rows.nbytes == 32 * len(scene)
    assert workspace.nbytes >= before + frame.surfels.rows.nbytes
