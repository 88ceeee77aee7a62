"""Whatever changes a picture visibly is on, and what is left out changes no pixel by more than is said.

Each test adds an effect of random strength and asks the float64 reference what it changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from splatview.edit.operations.appearance import Grade
from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, look_at, reference
from splatview.scene.edits import (
    DELETED,
    HIDDEN,
    IDENTITY,
    PALETTE_SHIFT,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    _four,
    bake,
)
from splatview.scene.effects.appearance import LEAST_LIGHT, early_stop_for
from splatview.scene.effects.effect import GREY_LEVEL, VISIBLE, Effect
from splatview.scene.effects.overrides import settings_for
from splatview.scene.effects.report import effects_report, largest_displacement
from splatview.scene.effects.sh_bands import colour_reach, sh_degrees, visible_degrees
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.scene.lens import Lens
from splatview.scene.projection import project

ROUNDING = 1e-9
"""Of float64 sums; bounds that are counted in float32 have their own reserve."""

SEEDS = st.integers(0, 2**32 - 1)

STRENGTHS = st.floats(-7, 0).map(lambda exponent: 10.0**exponent)
"""From what nobody sees to what nobody overlooks."""

brief = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def camera_at(seed: int) -> Camera:
    eye = np.random.default_rng(seed).normal(size=3)
    return look_at(eye / np.linalg.norm(eye) * 3, (0, 0, 0), width=20, height=14)


def picture(scene: Gaussians, camera: Camera, wanted: RenderSettings | None = None) -> np.ndarray:
    return reference.render(scene, camera, wanted)


def receipt(scene: Gaussians, **known) -> dict[str, Effect]:
    effects = effects_report(scene, **known)
    for effect in effects:
        # Only effects, not economies like skipping what is invisible, have anything to lose.
        assert effect.on or effect.bound <= VISIBLE, effect
    return {effect.name: effect for effect in effects}


def cut(scene: Gaussians, degrees: np.ndarray) -> Gaussians:
    kept = np.arange(scene.sh.shape[1]) < np.array(SH_COEFFICIENTS)[degrees][:, None]
    return replace(scene, sh=np.where(kept[..., None], scene.sh, np.float32(0)))


def assert_told(effect: Effect, changed: np.ndarray, unchanged: np.ndarray) -> None:
    """`unchanged` is the picture with the effect left out."""
    difference = float(np.abs(changed - unchanged).max())
    assert difference <= effect.bound + ROUNDING
    assert effect.on or difference <= GREY_LEVEL


@given(seed=SEEDS, strengths=st.tuples(STRENGTHS, STRENGTHS, STRENGTHS))
@example(seed=0, strengths=(1e-3, 1e-3, 1e-3))
@brief
def test_bands(random_gaussians, seed, strengths):
    scene = random_gaussians(12, seed=seed)
    sh = scene.sh.copy()
    for band, strength in enumerate(strengths, start=1):
        sh[:, band * band : (band + 1) ** 2] *= np.float32(strength / 0.15)
    scene, camera = replace(scene, sh=sh), camera_at(seed)
    whole, effects = picture(scene, camera), receipt(scene)
    for band in (1, 2, 3):
        without = settings_for(scene, {f"SH band {band}": False})
        assert without.sh_degree is not None and without.sh_degree < band
        assert_told(
            effects[f"SH band {band}"], whole, picture(scene, camera, RenderSettings(sh_degree=band - 1))
        )
    # All that are off, together.
    assert np.abs(whole - picture(scene, camera, settings_for(scene))).max() <= VISIBLE + ROUNDING


@given(seed=SEEDS, data=st.data())
@brief
def test_bands_splat_by_splat(random_gaussians, seed, data):
    scene = random_gaussians(12, seed=seed)
    strengths = 10.0 ** np.random.default_rng(seed).uniform(-7, 0, size=(12, 3))
    sh = scene.sh.copy()
    for band in (1, 2, 3):
        sh[:, band * band : (band + 1) ** 2] *= strengths[:, band - 1, None, None] / 0.15
    scene, camera = replace(scene, sh=sh.astype(np.float32)), camera_at(seed)
    scene = cut(scene, np.array(data.draw(st.lists(st.integers(0, 3), min_size=12, max_size=12))))
    whole = picture(scene, camera)
    assert np.array_equal(whole, picture(cut(scene, sh_degrees(scene.sh)), camera))
    degrees = visible_degrees(scene.sh)
    assert (degrees <= sh_degrees(scene.sh)).all()
    assert np.abs(whole - picture(cut(scene, degrees), camera)).max() <= VISIBLE + ROUNDING


@given(seed=SEEDS, strength=st.floats(-1, 4).map(lambda exponent: 10.0**exponent))
@example(seed=0, strength=40.0)
@brief
def test_light_behind_opaque_pixels(random_gaussians, seed, strength):
    """A dull wall, and something bright behind it."""
    scene = random_gaussians(12, seed=seed)
    sh = scene.sh.copy()
    sh[6:] *= np.float32(strength)
    means = scene.means * np.float32(0.1)
    means[:, 2] += np.linspace(0, 1, 12, dtype=np.float32)
    scene = replace(
        scene,
        sh=sh,
        means=means,
        log_scales=np.zeros_like(scene.log_scales),
        opacity_logits=np.full(12, 4, np.float32),
    )
    camera = look_at((0, 0, -3), (0, 0, 0), width=10, height=7)
    whole, effect = picture(scene, camera), receipt(scene)["light behind opaque pixels"]
    assert_told(effect, whole, ended(scene, camera, LEAST_LIGHT))
    brightest = colour_reach(scene).brightest
    assert float(project(scene, camera, RenderSettings()).colours.max()) <= brightest * (1 + 1e-5)
    # What settings say then is enough.
    stop = early_stop_for(scene)
    assert (stop is not None) == effect.on
    assert stop == settings_for(scene).early_stop
    stopped = ended(scene, camera, LEAST_LIGHT if stop is None else stop)
    assert np.abs(whole - stopped).max() <= VISIBLE * (1 + 1e-5)


def ended(scene: Gaussians, camera: Camera, least_light: float) -> np.ndarray:
    """The reference's picture, each pixel ending where less light is left; the rest of it is black."""
    footprints = project(scene, camera, RenderSettings())
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    every = np.arange(len(footprints.indices))
    alpha = reference.alphas(footprints, every, x.ravel(), y.ravel(), RenderSettings())
    light = np.cumprod(1 - alpha, axis=0)
    before = np.vstack([np.ones((1, alpha.shape[1])), light[:-1]])
    weights = np.where(before >= least_light, alpha * before, 0)
    colour = (weights.T @ footprints.colours).reshape(camera.height, camera.width, 3)
    return np.concatenate([colour, picture(scene, camera)[..., 3:]], axis=2)


@given(seed=SEEDS, magnitude=st.floats(0, 7))
@brief
def test_positions_of_float64(random_gaussians, seed, magnitude):
    scene = random_gaussians(12, seed=seed)
    offset = 10.0**magnitude
    far = replace(scene, means=scene.means.astype(np.float64) + offset)
    near = camera_at(seed)
    matrix = near.world_to_camera.copy()
    matrix[:3, 3] -= matrix[:3, :3] @ np.full(3, offset)
    camera = replace(near, world_to_camera=matrix)
    effect = receipt(far)["float64-centred positions"]
    rounded = replace(far, means=far.means.astype(np.float32))
    assert_told(effect, picture(far, camera), picture(rounded, camera))


@given(seed=SEEDS, faint=st.floats(-12, 2))
@brief
def test_splats_that_are_never_seen(random_gaussians, seed, faint):
    scene = random_gaussians(12, seed=seed)
    logits = scene.opacity_logits.copy()
    logits[:8] = np.linspace(faint - 1, faint + 1, 8)
    scene = replace(scene, opacity_logits=logits)
    effect, camera = receipt(scene)["skip faint splats"], camera_at(seed)
    visible = 1 / (1 + np.exp(-logits.astype(np.float64))) >= 1 / 255
    assert effect.on == (not visible.all()) and f"{(~visible).sum()} of 12" in effect.why
    assert np.array_equal(picture(scene, camera), picture(scene.take(visible), camera))


@given(seed=SEEDS, strength=STRENGTHS, share=st.integers(0, 11))
@brief
def test_edits(random_gaussians, seed, strength, share):
    scene, camera = random_gaussians(12, seed=seed), camera_at(seed)
    before = picture(scene, camera)
    some = np.arange(12) < share
    grey = 1 + strength
    adjustments = {
        "adjusted splats": Adjustment(translation=(strength, 0, 0)),
        "colour grade": Adjustment(colour=((grey, 0, 0, 0), (0, grey, 0, 0), (0, 0, grey, 0))),
    }
    cases: dict[str, SceneEdits] = {
        name: SceneEdits(marks=(some << PALETTE_SHIFT).astype(np.uint32), palette=(IDENTITY, adjustment))
        for name, adjustment in adjustments.items()
    }
    flag = HIDDEN if seed % 2 else DELETED
    cases["hidden splats"] = SceneEdits(marks=(some * flag).astype(np.uint32), flags=flag)
    crop = Crop(half_extents=(2 * strength, 2.0, 2.0))
    cases["crop"] = SceneEdits(marks=np.zeros(12, np.uint32), crops=(crop,))
    for name, edits in cases.items():
        effects = receipt(scene, edits=edits)
        assert_told(effects[name], picture(bake(scene, edits), camera), before)
        others = set(cases) - {name}
        assert not any(effects[other].on for other in others)


@given(
    seed=SEEDS,
    strengths=st.tuples(STRENGTHS, STRENGTHS, STRENGTHS),
    contrast=st.floats(0, 10),
    saturation=st.floats(0, 10),
)
@example(seed=0, strengths=(1e-3, 1e-3, 1e-3), contrast=10, saturation=3)
@brief
def test_bands_and_light_of_graded_splats(random_gaussians, seed, strengths, contrast, saturation):
    """What a grade makes brighter is told, window and export leave out no more than is said."""
    scene, camera = random_gaussians(12, seed=seed), camera_at(seed)
    sh = scene.sh.copy()
    for band, strength in enumerate(strengths, start=1):
        sh[:, band * band : (band + 1) ** 2] *= np.float32(strength / 0.15)
    scene = replace(scene, sh=sh)
    red, green, blue = (_four(row) for row in Grade(contrast=contrast, saturation=saturation).matrix)
    adjustment = Adjustment(colour=(red, green, blue))
    marks = (np.arange(12) % 2 << PALETTE_SHIFT).astype(np.uint32)
    edits = SceneEdits(marks=marks, palette=(IDENTITY, adjustment))
    exported, effects = bake(scene, edits), receipt(scene, edits=edits)
    whole = picture(exported, camera)
    for band in (1, 2, 3):
        lower = picture(bake(cut(scene, np.full(12, band - 1)), edits), camera)
        assert_told(effects[f"SH band {band}"], whole, lower)
    assert float(np.abs(project(exported, camera, RenderSettings()).colours).max()) * LEAST_LIGHT <= (
        effects["light behind opaque pixels"].bound * (1 + 1e-5)
    )
    window, export = settings_for(scene, palette=edits.palette), settings_for(exported)
    for asked in (window, export):
        assert np.abs(whole - picture(exported, camera, asked)).max() <= VISIBLE + ROUNDING
    assert (window.sh_degree or 3) >= (export.sh_degree or 0)


@given(seed=SEEDS, strength=STRENGTHS)
@brief
def test_lenses(random_gaussians, seed, strength):
    scene, pinhole = random_gaussians(12, seed=seed), camera_at(seed)
    camera = replace(pinhole, lens=Lens(model="SIMPLE_RADIAL", parameters=(strength,)))
    effect = receipt(scene, camera=camera)["lens distortion"]
    assert_told(effect, picture(scene, camera), picture(scene, pinhole))
    assert effect.on and f"up to {largest_displacement(camera):.3g} px" in effect.why
    assert not receipt(scene, camera=pinhole)["lens distortion"].on


def test_how_far_a_lens_moves_things_is_true():
    camera = look_at((0, 0, -3), (0, 0, 0), width=200, height=100, fov_y=60)
    camera = replace(camera, lens=Lens(model="SIMPLE_RADIAL", parameters=(0.1,)))
    corner = camera.points_at((0.0, 0.0), 1.0)
    undistorted = corner[:2] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    assert np.allclose(camera.image_points(corner), 0)
    assert abs(largest_displacement(camera) - np.linalg.norm(undistorted)) < 1e-9


@given(seed=SEEDS, colour=st.tuples(STRENGTHS, STRENGTHS, STRENGTHS))
@brief
def test_backgrounds(random_gaussians, seed, colour):
    scene, camera = random_gaussians(12, seed=seed), camera_at(seed)
    wanted = RenderSettings(background=colour)
    effect = receipt(scene, settings=wanted)["background"]
    assert_told(effect, picture(scene, camera, wanted), picture(scene, camera))


@given(seed=SEEDS, near=st.floats(0.02, 4.0), obeyed=st.booleans())
@brief
def test_near_planes(random_gaussians, seed, near, obeyed):
    scene, camera = random_gaussians(12, seed=seed), camera_at(seed)
    assert not receipt(scene)["near plane"].on
    scene = replace(scene, comments=(f"near plane {near!r}",))
    wanted = settings_for(scene) if obeyed else RenderSettings()
    assert wanted.model.near == (near if obeyed else RenderSettings().model.near)
    effect = receipt(scene, settings=wanted)["near plane"]
    assert_told(effect, picture(scene, camera, wanted), picture(scene, camera))
    assert effect.on == obeyed and f"{near:g}" in effect.why
    assert receipt(scene)["near plane"].on, "where nobody says otherwise the file does"


@given(seed=SEEDS, strength=STRENGTHS)
@brief
def test_views_that_are_not_drawn_again(random_gaussians, seed, strength):
    scene, camera = random_gaussians(12, seed=seed), camera_at(seed)
    matrix = camera.world_to_camera.copy()
    matrix[0, 3] += strength
    moved = replace(camera, world_to_camera=matrix)
    for previous in (moved, replace(camera, name="another name")):
        effect = receipt(scene, camera=camera, previous=previous)["redrawing"]
        assert_told(effect, picture(scene, camera), picture(scene, previous))
    assert not effect.on
    assert receipt(scene, camera=camera)["redrawing"].on


@given(
    seed=SEEDS,
    comment=st.sampled_from(["", "SplatRenderMode: mip", "antialiased 1", "SplatRenderMode: 2dgs"]),
)
@brief
def test_what_the_file_asks_for(random_gaussians, seed, comment):
    scene, camera = replace(random_gaussians(12, seed=seed), comments=(comment,)), camera_at(seed)
    effects, asked = receipt(scene), settings_for(scene)
    plain = picture(scene, camera, RenderSettings(model=ImageModel(blur=asked.model.blur)))
    difference = np.abs(picture(scene, camera, asked) - plain).max()
    assert (difference > GREY_LEVEL) <= (effects["antialiased opacity"].on or effects["flat 2D splats"].on)
    assert effects["antialiased opacity"].on == asked.model.antialiased
    assert effects["flat 2D splats"].on == (asked.model.footprint == "disc")


def test_what_is_only_lit_up(random_gaussians):
    marks = np.zeros(12, np.uint32)
    marks[3:5] = SELECTED
    effects = receipt(random_gaussians(12), edits=SceneEdits(marks=marks, flags=SELECTED))
    assert effects["selection"].on and "2 of 12" in effects["selection"].why
    assert not any(effects[name].on for name in ("hidden splats", "crop", "adjusted splats", "colour grade"))


def test_the_users_word_counts(random_gaussians):
    scene = random_gaussians(12)
    assert settings_for(scene, {"SH band 2": False}).sh_degree == 1
    assert settings_for(scene, {"SH band 2": False, "SH band 3": True}).sh_degree == 1
    assert settings_for(scene, {"SH band 2": None}) == settings_for(scene)
    assert settings_for(scene, {"antialiased opacity": True}).model.antialiased
    flat = settings_for(scene, {"flat 2D splats": True})
    assert flat.model == ImageModel().with_footprint("disc")
    low = cut(scene, np.zeros(12, np.uint8))
    assert settings_for(low).sh_degree == 0 and settings_for(low, {"SH band 3": True}).sh_degree is None
    effects = {effect.name: effect for effect in effects_report(low, overrides={"SH band 3": True})}
    assert effects["SH band 3"].in_force and not effects["SH band 3"].on
    assert effects["SH band 2"].forced is None and effects["SH band 2"].error == 0
    effects = {effect.name: effect for effect in effects_report(scene, overrides={"SH band 3": False})}
    assert effects["SH band 3"].error == effects["SH band 3"].bound > VISIBLE
    try:
        settings_for(scene, {"sorting": False})
    except ValueError as error:
        assert "'sorting' cannot be switched" in str(error) and "SH band 1" in str(error)
    else:
        raise AssertionError("an effect that cannot be switched was taken")
