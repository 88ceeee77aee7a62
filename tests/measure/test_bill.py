"""The bill against pictures whose work can be counted by hand."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from splatview.measure.work import (
    EVALUATION_OPERATIONS,
    PROJECTION_OPERATIONS,
    as_json,
    bill_of,
    multiply_adds,
    rows,
    short,
    sums,
    weights,
)
from splatview.raster import Workspace, parameters_of
from splatview.raster.contributions import count_work
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.projection import project

CAMERA = Camera(width=33, height=21, fx=30, fy=30, cx=16.5, cy=10.5, world_to_camera=np.eye(4))


def ball(*places: tuple[float, float, float], size: float = 0.1, logit: float = 0.0) -> Gaussians:
    count = len(places)
    return Gaussians(
        means=np.array(places, np.float32).reshape(-1, 3),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), math.log(size), np.float32),
        opacity_logits=np.full(count, logit, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def counted(gaussians: Gaussians, settings: RenderSettings | None = None):
    return count_work(parameters_of(gaussians), CAMERA, settings or RenderSettings(), Workspace())


def by_hand(gaussians: Gaussians, sigmas: float = math.inf) -> np.ndarray:
    """Pixels where each splat's alpha is not cut, summed, nothing being hidden."""
    footprints = project(gaussians, CAMERA, RenderSettings(), dtype=np.float64)
    y, x = np.indices((CAMERA.height, CAMERA.width)) + 0.5
    counts = np.zeros((CAMERA.height, CAMERA.width), int)
    parts = (footprints.means2d, footprints.conic_factors, footprints.opacities)
    for mean, (a, b, c), opacity in zip(*parts, strict=True):
        dx, dy = x - mean[0], y - mean[1]
        q = (a * dx + b * dy) ** 2 + (c * dy) ** 2
        counts += (opacity * np.exp(-0.5 * q) >= 1 / 255) & (q <= sigmas**2)
    return counts


def test_evaluations_are_the_pixels_that_splats_reach():
    scene = ball((0, 0, 2), (0.3, 0.1, 3), (-2, 0, 4))
    work = counted(scene)
    assert (work.evaluations == by_hand(scene)).all()
    assert work.visible == 3 and work.sh_degree == 0
    assert work.pixel_splats >= work.evaluations.sum() > 0 and work.pairs >= 3


@pytest.mark.parametrize("sigmas", [2.0, 1.1])
def test_what_a_nearer_cut_leaves_out_is_not_counted(sigmas):
    scene = ball((0, 0, 2), (0.3, 0.1, 3), (-0.4, 0.2, 2.5), logit=3.0)
    work = counted(scene, RenderSettings(sigma_cut=sigmas))
    assert (work.evaluations == by_hand(scene, sigmas)).all()
    assert work.evaluations.sum() < by_hand(scene).sum()


def test_what_lies_behind_an_opaque_wall_costs_nothing():
    wall = [(0.0, 0.0, 1.0 + 0.01 * k) for k in range(6)]
    thick = counted(ball(*wall, (0.0, 0.0, 5.0), size=3, logit=8), RenderSettings(early_stop=1e-4))
    assert thick.evaluations.max() <= 3, "0.01 of the light comes through each"
    all_of_it = counted(ball(*wall, (0.0, 0.0, 5.0), size=3, logit=8), RenderSettings(early_stop=0.0))
    assert all_of_it.evaluations.min() == 7


def test_an_empty_scene_costs_its_pixels_only():
    empty = ball()
    bill = bill_of(empty, counted(empty))
    assert (bill.evaluations, bill.mean, bill.operations, bill.stored) == (0, 0, 0, 0)
    assert bill.moved == 16 * CAMERA.width * CAMERA.height


def test_the_sums():
    scene = ball((0, 0, 2), (0.3, 0.1, 3))
    work = counted(scene)
    bill = bill_of(scene, work)
    total = int(by_hand(scene).sum())
    assert bill.evaluations == total and bill.mean == pytest.approx(total / (33 * 21))
    assert bill.percentile == pytest.approx(np.percentile(by_hand(scene), 99))
    splat = sum(PROJECTION_OPERATIONS.values()) + 6  # colour: three multiply-adds
    assert bill.operations == total * sum(EVALUATION_OPERATIONS.values()) + 2 * splat
    assert bill.moved == 2 * (4 * 14 + 64 + 64) + work.pairs * 72 + 16 * 33 * 21
    assert bill.stored == scene.nbytes == 2 * 4 * 14


def test_the_network_by_hand():
    """63 inputs, seven further layers of 256 of which one sees the inputs again, then density and colour."""
    body = 63 * 256 + 6 * 256 * 256 + (256 + 63) * 256
    head = 256 * 1 + 256 * 256 + (256 + 27) * 128 + 128 * 3
    assert multiply_adds() == body + head == 593_408
    assert weights() == 593_408 + 8 * 256 + 1 + 256 + 128 + 3
    bill = bill_of(ball(), counted(ball()))
    assert bill.nerf_operations == 2 * 593_408 * 192 * 33 * 21
    assert 2e6 < bill.nerf_weights < 3e6, "a few megabytes"


def test_it_can_be_read_by_people_and_programs():
    scene = ball((0, 0, 2))
    bill = bill_of(scene, counted(scene))
    assert ("storage", "56 B", "2.38 MB") in rows(bill)
    assert any("= 593,408" in line for line in sums(bill))
    data = json.loads(json.dumps(as_json(bill)))
    assert data["nerf_multiply_adds"] == 593_408 and data["evaluations"] == bill.evaluations
    assert [short(n) for n in (0, 999, 1234567, 5.2e13)] == ["0 ", "999 ", "1.23 M", "52 T"]
