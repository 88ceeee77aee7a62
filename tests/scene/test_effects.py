"""The receipt: what is on and off is right, and what it says in numbers is true."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from splatview.scene import Gaussians, ImageModel, RenderSettings, look_at
from splatview.scene.effects.appearance import antialiasing
from splatview.scene.effects.effect import VISIBLE, Effect
from splatview.scene.effects.overrides import settings_for
from splatview.scene.effects.report import effects_report
from splatview.scene.effects.sh_bands import own_degrees, used_sh_degree
from splatview.scene.formats import load_scene
from splatview.scene.health import check
from splatview.scene.reference import render
from splatview.scene.sh import sh_basis


def receipt(scene: Gaussians) -> dict[str, Effect]:
    effects = effects_report(scene)
    assert len({effect.name for effect in effects}) == len(effects)
    for effect in effects:
        assert type(effect.on) is bool and effect.why and "\n" not in effect.why
    return {effect.name: effect for effect in effects}


def with_bands(scene: Gaussians, *magnitudes: float) -> Gaussians:
    """Band l scaled so that its largest coefficient is magnitudes[l - 1]."""
    sh = scene.sh.copy()
    for band, magnitude in enumerate(magnitudes, start=1):
        which = slice(band * band, (band + 1) ** 2)
        sh[:, which] *= np.float32(magnitude / np.abs(sh[:, which]).max(initial=1e-30))
    return replace(scene, sh=sh)


def test_bands_by_their_size(random_gaussians):
    scene = random_gaussians(50)
    for magnitudes, degree in (
        ((0.1, 0.1, 0.1), 3),
        ((0.1, 0.1, 1e-5), 2),
        ((0.1, 0, 0), 1),
        ((0, 0, 0), 0),
        ((0, 0, 0.1), 3),  # an empty band below a full one is still part of the evaluation
        ((1e-5, 1e-5, 1e-5), 0),
    ):
        changed = with_bands(scene, *magnitudes)
        assert used_sh_degree(changed) == degree
        on = [receipt(changed)[f"SH band {band}"].on for band in (1, 2, 3)]
        assert on == [band <= degree for band in (1, 2, 3)]
        assert settings_for(changed).sh_degree == (None if degree == 3 else degree)


def test_only_stored_bands_are_listed(random_gaussians):
    for degree in range(4):
        names = [
            name for name in receipt(random_gaussians(5, sh_degree=degree)) if name.startswith("SH band")
        ]
        assert names == [f"SH band {band}" for band in range(1, degree + 1)]


@given(
    seed=st.integers(0, 2**32 - 1),
    magnitudes=st.tuples(*[st.sampled_from([0.0, 3e-4, 1e-3, 2e-3, 5e-3])] * 3),
)
@example(seed=0, magnitudes=(1e-3, 5e-4, 3e-4))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_bands_judged_off_change_no_pixel_visibly(random_gaussians, seed, magnitudes):
    scene = with_bands(random_gaussians(30, seed=seed), *magnitudes)
    eye = np.random.default_rng(seed).normal(size=3)
    camera = look_at(eye / np.linalg.norm(eye) * 3, (0, 0, 0), width=24, height=16)
    full, used = (render(scene, camera, each) for each in (RenderSettings(), settings_for(scene)))
    assert np.abs(full - used).max() <= VISIBLE


def test_the_largest_change_is_true_and_named(random_gaussians):
    """The splat with the largest coefficients, seen from the worst side, changes by just what is said."""
    sh = np.zeros((3, 4, 3), np.float32)
    sh[:, 1] = [[0.1, 0.2, 0.3], [0.1, 0.5, 0.2], [0, 0, 0]]
    why = receipt(replace(random_gaussians(3), sh=sh))["SH band 1"].why
    stated = re.search(r"at most (\S+) \(62 grey levels\)", why)
    assert stated and float(stated[1]) == pytest.approx(0.4886025 * 0.5, abs=0.01)


def test_nan_in_a_band_keeps_what_it_decides(random_gaussians):
    """A splat that a NaN in band 3 culls must not come back because band 3 is small elsewhere."""
    scene = with_bands(random_gaussians(20), 0.1, 0, 0)
    camera = look_at((0, 0, -3), (0, 0, 0), width=24, height=16)
    for coefficients, degree in (([0], 1), ([2], 1), ([6], 2), ([12], 3), ([6, 12], 2), ([0, 6, 12], 1)):
        sh = scene.sh.copy()
        sh[4, coefficients, 1] = np.nan
        ill = replace(scene, sh=sh)
        assert used_sh_degree(ill) == degree
        full, used = (render(ill, camera, each) for each in (RenderSettings(), settings_for(ill)))
        assert np.abs(full - used).max() <= VISIBLE
        assert receipt(ill)["skip invalid splats"].on


@pytest.mark.parametrize(
    ("comments", "on", "blur"),
    [
        ((), False, 0.3),
        (("SplatRenderMode: mip",), True, 0.1),
        (("splatrendermode: MIP",), True, 0.1),
        (("SplatRenderMode: default",), False, 0.3),
        (("SplatRenderMode: 2dgs",), False, 0.5),
        (("antialiased 1",), True, 0.3),
        (("antialiased: true",), True, 0.3),
        (("antialiased 0",), False, 0.3),
        (("not antialiased 1",), False, 0.3),
        (("antialiased photos, 12 of them",), False, 0.3),
        (("Generated by X", "antialiased 1", "y"), True, 0.3),
        (("antialiased 1", "SplatRenderMode: default"), False, 0.3),
        (("rasterize_mode antialiased",), True, 0.3),
        (("Rasterize_Mode: antialiased",), True, 0.3),
        (("antialiased 1", "rasterize_mode classic"), False, 0.3),
        (("antialiasing: true",), True, 0.3),
    ],
)
def test_antialiased_only_where_the_file_says_so(random_gaussians, comments, on, blur):
    scene = replace(random_gaussians(3), comments=comments)
    effect = receipt(scene)["antialiased opacity"]
    assert effect.on == on and antialiasing(comments)[0] == on
    assert f"kernel {blur:g} px²" in effect.why
    told = "means that" in effect.why
    assert told == (not antialiasing(comments)[2] and "antialiased" in str(comments))
    footprint = "disc" if "2dgs" in str(comments) else "ellipsoid"
    assert settings_for(scene).model == ImageModel(blur=blur, antialiased=on, footprint=footprint)


def test_flat_scenes(random_gaussians):
    scene = random_gaussians(1000)
    assert not receipt(scene)["flat 2D splats"].on
    assert receipt(replace(scene, comments=("SplatRenderMode: 2dgs",)))["flat 2D splats"].on
    log_scales = scene.log_scales.copy()
    log_scales[:, 1] = -16
    # Flat all of them, but nobody said that they were trained as discs.
    flat = receipt(replace(scene, log_scales=log_scales))["flat 2D splats"]
    assert not flat.on and "1,000 of 1,000" in flat.why and "does not say" in flat.why
    assert settings_for(replace(scene, log_scales=log_scales)).model.footprint == "ellipsoid"
    forced = settings_for(replace(scene, log_scales=log_scales), {"flat 2D splats": True})
    assert forced.model == ImageModel().with_footprint("disc")


def test_centred_positions_where_float32_is_too_coarse(random_gaussians):
    scene = random_gaussians(100)
    assert not receipt(scene)["float64-centred positions"].on
    far = receipt(replace(scene, means=scene.means + np.float32(4e6)))["float64-centred positions"]
    assert far.on and "steps of 0.25" in far.why
    wide = replace(scene, means=scene.means.astype(np.float64))
    assert not receipt(wide)["float64-centred positions"].on  # what float32 holds too
    finer = receipt(replace(wide, means=wide.means + 1e-9))["float64-centred positions"]
    assert finer.on and "100 of 100 are no numbers of float32" in finer.why


def test_counts_are_true(random_gaussians):
    logits = np.full(200, 10, np.float32)
    logits[:30] = 0
    logits[:7] = -6
    logits[7] = np.nan
    effects = receipt(replace(random_gaussians(200), opacity_logits=logits))
    assert "29 of 200 splats have an opacity below 0.99" in effects["transparency"].why
    assert effects["skip faint splats"].on and "7 of 200" in effects["skip faint splats"].why
    assert effects["skip invalid splats"].on and "1 of 200" in effects["skip invalid splats"].why
    assert "1 NaN opacities" in effects["skip invalid splats"].why


def test_findings_that_are_known_are_not_searched_again(random_gaussians, monkeypatch):
    scene = random_gaussians(30)
    expected = effects_report(scene)
    findings = check(scene)
    monkeypatch.setattr("splatview.scene.effects.report.check", None)
    assert effects_report(scene, findings=findings) == expected


def test_none_and_one(random_gaussians):
    for count in (0, 1):
        effects = receipt(random_gaussians(count))
        assert not effects["sorting"].on and not effects["skip invalid splats"].on
        assert effects["transparency"].on == (count > 0)
        assert settings_for(random_gaussians(count)).model == ImageModel()
    assert receipt(random_gaussians(2))["sorting"].on


def test_own_degrees_where_counted_bytes_say_so(random_gaussians):
    """Of 100 splats some have no higher bands: 16 and 1 coefficients of 12 bytes, a place of 4."""
    for plain, on in ((0, False), (12, False), (15, True), (90, True), (100, False)):
        scene = random_gaussians(100)
        sh = scene.sh.copy()
        sh[:plain, 1:] = 0
        effect = receipt(replace(scene, sh=sh))["own SH degree a splat"]
        apart = (100 - plain) * 16 * 12 + plain * 12 + 100 * 4
        alike = 100 * 16 * 12 if plain < 100 else 100 * 12
        assert effect.on == on == (apart < 0.9 * alike) and effect.bound == 0
        assert (own_degrees(sh) is not None) == on
        assert f"{apart:,}" in effect.why and f"{alike:,}" in effect.why
        if 0 < plain < 100:
            assert f"{plain} of degree 0, {100 - plain} of degree 3" in effect.why


def test_what_bands_take_is_counted(random_gaussians):
    effects = receipt(random_gaussians(100))
    assert [effects[f"SH band {band}"].saving.bytes for band in (1, 2, 3)] == [
        100 * coefficients * 3 * 4 for coefficients in (15, 12, 7)
    ]
    # A sum of three colours is two operations a coefficient each; the basis takes 41 at degree 3, 17 at 2.
    assert effects["SH band 3"].saving.operations == 100 * (7 * 6 + 41 - 17)
    assert effects["SH band 3"].leaving_out.startswith(
        "leaving it out saves 8,400 bytes, 6,600 operations a "
    )


@pytest.mark.parametrize("name", ["skull", "playbot_lod0", "train-1000"])
def test_receipts_of_trained_scenes_can_be_checked_by_hand(data_file, name):
    """What is said of the highest band, from the worst splat seen from 4,000 sides."""
    scene = load_scene(data_file(f"scenes/{name}.ply"))
    degree = scene.sh_degree
    effects = receipt(scene)
    effect = effects[f"SH band {degree}"]
    first = degree * degree
    worst = np.unravel_index((scene.sh[:, first:] ** 2).sum(axis=1).argmax(), (len(scene), 3))
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    changes = sh_basis(directions, degree)[:, first:] @ scene.sh[worst[0], first:, worst[1]]
    assert effect.on and effect.saving.bytes == len(scene) * (2 * degree + 1) * 12
    assert VISIBLE < 0.5 * effect.bound < np.abs(changes).max() <= effect.bound
    assert not effects["own SH degree a splat"].on
