"""Each kind of trouble is found, on the splats that have it and on no others."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.formats import load_scene
from splatview.scene.health import Finding, check, sh_bound
from splatview.scene.projection import project
from splatview.scene.sh import sh_basis

N = 60


@pytest.fixture
def healthy(random_gaussians) -> Gaussians:
    scene = random_gaussians(N)
    return replace(
        scene,
        sh=np.clip(scene.sh, -1, 1),
        log_scales=np.clip(scene.log_scales, -5, -2),
        opacity_logits=np.clip(scene.opacity_logits, -3, 3),
    )


def found(scene: Gaussians) -> dict[str, Finding]:
    findings = check(scene)
    assert len({finding.name for finding in findings}) == len(findings)
    for finding in findings:
        assert finding.count == len(finding.indices) and finding.indices.dtype == np.int64
        assert finding.what.endswith(".")
    return {finding.name: finding for finding in findings if finding.count}


def spoiled(scene: Gaussians, attribute: str, where: object, value: object) -> Gaussians:
    array = getattr(scene, attribute).copy()
    array[where] = value
    return replace(scene, **{attribute: array})


def test_a_healthy_scene_has_no_findings(healthy):
    assert found(healthy) == {}


@pytest.mark.parametrize(
    ("attribute", "where", "value", "name"),
    [
        ("means", (7, 1), np.nan, "non-finite means"),
        ("means", (7, 1), -np.inf, "non-finite means"),
        ("quats", (7, 3), np.nan, "non-finite quaternions"),
        ("quats", (7, 0), np.inf, "non-finite quaternions"),
        ("quats", 7, 0, "zero quaternions"),
        ("quats", 7, 1e-31, "zero quaternions"),
        ("log_scales", (7, 2), np.nan, "non-finite scales"),
        ("log_scales", 7, 89, "non-finite scales"),
        ("opacity_logits", 7, np.nan, "NaN opacities"),
        ("opacity_logits", 7, -np.inf, "invisible"),
        ("opacity_logits", 7, -5.6, "invisible"),
        ("opacity_logits", 7, np.inf, "opacity at its limit"),
        ("opacity_logits", 7, 20, "opacity at its limit"),
        ("sh", (7, 15, 2), np.nan, "non-finite SH"),
        ("sh", (7, 0, 0), np.inf, "non-finite SH"),
        ("sh", (7, 0, 0), 20, "SH out of range"),
        ("log_scales", 7, -25, "extreme scales"),
        ("log_scales", 7, (-3, -3, -8), "needles"),
        ("log_scales", 7, 1.0, "giants"),
    ],
)
def test_one_ill_splat_is_found_alone(healthy, attribute, where, value, name):
    findings = found(spoiled(healthy, attribute, where, value))
    assert findings[name].indices.tolist() == [7]
    # A giant is a giant; nothing healthy is ever named beside it.
    assert all(finding.indices.tolist() == [7] for finding in findings.values())
    if name not in ("non-finite scales",):
        assert set(findings) == {name}


def test_what_is_culled_is_what_the_reference_culls(healthy):
    """`culled` is the image model's rule: exactly those splats never reach a picture."""
    scene = healthy
    changes = [
        ("means", (0, 1), np.nan),
        ("quats", (1, 3), np.inf),
        ("quats", 2, 0),
        ("quats", 3, 1e-29),
        ("log_scales", (4, 2), 89),
        ("log_scales", 5, -40),
        ("opacity_logits", 6, np.nan),
        ("opacity_logits", 7, np.inf),
        ("opacity_logits", 8, -np.inf),
        ("opacity_logits", 9, -5.5),
        ("sh", (10, 15, 2), np.nan),
        ("sh", (11, 15, 2), 100),
    ]
    for attribute, where, value in changes:
        scene = spoiled(scene, attribute, where, value)
    culled = np.unique(np.concatenate([finding.indices for finding in check(scene) if finding.culled]))
    assert culled.tolist() == [0, 1, 2, 4, 6, 8, 10]
    camera = look_at((0, 0, -4), (0, 0, 0), width=64, height=64)
    drawn = project(scene, camera, RenderSettings()).indices
    assert sorted([*drawn.tolist(), *culled.tolist()]) == list(range(N))


def test_needles_rods_and_discs(healthy):
    log_scales = np.full((N, 3), -3, np.float32)
    ratio = math.log(100)
    log_scales[1, 0] += ratio * 1.01  # rod
    log_scales[2, 1] -= ratio * 1.01  # disc
    log_scales[3] += (0, ratio * 0.6, ratio * 1.2)  # blade: neither step alone is large
    log_scales[4, 2] += ratio * 0.99
    log_scales[5, 2] = -np.inf
    findings = found(replace(healthy, log_scales=log_scales))
    assert findings["needles"].indices.tolist() == [1, 2, 3, 5]
    assert findings["rods"].indices.tolist() == [1]
    assert findings["extreme scales"].indices.tolist() == [5]


def test_positions_stored_too_coarsely(healthy):
    far = replace(healthy, means=healthy.means + np.float32(1e6))
    assert found(far)["coarse positions"].count == N
    # The same place in float64 is fine.
    assert "coarse positions" not in found(replace(healthy, means=healthy.means.astype(np.float64) + 1e6))


def test_duplicates_are_the_later_copies_in_every_bit(healthy):
    indices = np.r_[np.arange(N), 5, 9, 5]
    scene = healthy.take(indices)
    assert found(scene)["duplicates"].indices.tolist() == [N, N + 1, N + 2]
    for attribute in ("quats", "log_scales", "opacity_logits", "sh"):
        where = (N, 0) if attribute != "opacity_logits" else N
        value = getattr(scene, attribute)[where] * np.float32(1.0000001)
        assert N not in found(spoiled(scene, attribute, where, value))["duplicates"].indices


def test_thousands_in_one_place(random_gaussians):
    scene = random_gaussians(5000)
    same_place = replace(scene, means=np.zeros((5000, 3), np.float32))
    assert "duplicates" not in found(same_place)
    same = scene.take(np.zeros(5000, int))
    assert found(same)["duplicates"].indices.tolist() == list(range(1, 5000))


@pytest.mark.parametrize("means_type", [np.float32, np.float64])
@pytest.mark.parametrize("degree", range(4))
def test_none_and_one(random_gaussians, degree, means_type):
    for count in (0, 1):
        scene = random_gaussians(count, sh_degree=degree)
        check(replace(scene, means=scene.means.astype(means_type)))
    assert not found(random_gaussians(0))


@given(seed=st.integers(0, 2**32 - 1), magnitude=st.sampled_from([1e-3, 1.0, 50.0]))
@settings(max_examples=40, deadline=None)
def test_sh_reach_bounds_each_band(seed, magnitude):
    rng = np.random.default_rng(seed)
    sh = rng.normal(scale=magnitude, size=(8, 16, 3)).astype(np.float32)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis = sh_basis(directions, 3)
    reach = sh_bound(sh)
    for band in range(4):
        which = slice(band * band, (band + 1) ** 2)
        colours = np.abs(np.einsum("dk,nkc->dnc", basis[:, which], sh[:, which])).max(axis=0)
        assert (colours <= reach[:, band] * (1 + 1e-5)).all()


def test_sh_reach_is_attained():
    """The bound is no larger than need be: coefficients like the basis at a direction reach it there."""
    direction = np.array([[0.48, -0.6, 0.64]])
    basis = sh_basis(direction, 3)[0]
    sh = np.repeat(basis[None, :, None], 3, axis=2).astype(np.float32)
    for band in range(4):
        which = slice(band * band, (band + 1) ** 2)
        assert sh_bound(sh)[0, band, 0] == pytest.approx((basis[which] ** 2).sum(), rel=1e-5)


def test_skull_is_mostly_needles(data_file):
    findings = found(load_scene(data_file("scenes/skull.ply")))
    assert findings["needles"].count == 72_772
    assert not any(finding.culled for finding in findings.values())
