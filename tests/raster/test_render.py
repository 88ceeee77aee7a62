"""The CPU rasteriser's picture against the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview import raster
from splatview.scene import TEXTBOOK, Gaussians, ImageModel, RenderSettings, look_at, reference
from splatview.scene.formats import load_scene
from splatview.scene.projection import project

BOUND = 1e-4
NEAR_CUT = 1e-6


def one_splat(**changes) -> Gaussians:
    arrays = {
        "means": np.zeros((1, 3), np.float32),
        "quats": np.array([[1, 0, 0, 0]], np.float32),
        "log_scales": np.full((1, 3), -2.0, np.float32),
        "opacity_logits": np.full(1, 2.0, np.float32),
        "sh": np.full((1, 1, 3), 0.7, np.float32),
    }
    for name, value in changes.items():
        arrays[name] = np.array(value, np.float32).reshape(arrays[name].shape)
    return Gaussians(**arrays)


def errors(gaussians, camera, settings=None, **options) -> np.ndarray:
    """(H, W): largest difference to the reference over a pixel's channels."""
    settings = settings or RenderSettings()
    image = raster.render(gaussians, camera, settings, **options)
    assert image.dtype == np.float32
    assert image.shape == (camera.height, camera.width, 4)
    return np.abs(image - reference.render(gaussians, camera, settings)).max(axis=2)


def beside_a_cut(gaussians, camera, settings, rows, columns) -> np.ndarray:
    """Which of the pixels have an alpha within NEAR_CUT of the cut, by the reference's own numbers."""
    uncut = replace(settings, model=replace(settings.model, alpha_cut=0.0))
    footprints = project(gaussians, camera, settings)
    alphas = reference.alphas(
        footprints, np.arange(len(footprints.indices)), columns + 0.5, rows + 0.5, uncut
    )
    return (np.abs(alphas - settings.model.alpha_cut) <= NEAR_CUT).any(axis=0)


def assert_close(gaussians, camera, settings=None) -> None:
    settings = settings or RenderSettings()
    error = errors(gaussians, camera, settings)
    rows, columns = np.nonzero(~(error <= BOUND))
    if len(rows):
        excused = beside_a_cut(gaussians, camera, settings, rows, columns)
        print(f"{excused.sum()} pixels with an alpha within {NEAR_CUT} of the cut")
        assert excused.all(), f"{(~excused).sum()} pixels wrong, worst by {error.max()}"


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
@pytest.mark.parametrize("size", [(64, 48), (17, 9), (1, 1), (33, 70)])
def test_random_scene(random_gaussians, size, sh_degree):
    camera = look_at((0.4, 0.6, -2.5), (0, 0, 0), width=size[0], height=size[1])
    assert_close(random_gaussians(300, sh_degree=sh_degree, seed=sh_degree), camera)


@pytest.mark.parametrize("used", [0, 1, 2])
def test_lower_degree_than_stored(random_gaussians, used):
    camera = look_at((0, 0, -3), (0, 0, 0), width=40, height=40)
    scene = random_gaussians(100)
    assert_close(scene, camera, RenderSettings(sh_degree=used))
    full = raster.render(scene, camera)
    assert np.abs(full - raster.render(scene, camera, RenderSettings(sh_degree=used))).max() > 0.01


@pytest.mark.parametrize(
    "model",
    [
        ImageModel(antialiased=True),
        ImageModel(antialiased=True, blur=0.1),
        ImageModel(blur=0.0),
        ImageModel(jacobian_margin=None),
        ImageModel(alpha_cut=0.0),
        ImageModel(alpha_cut=0.1, max_alpha=0.6),
        ImageModel(near=1.5),
        TEXTBOOK,
    ],
)
def test_every_setting_of_the_model(random_gaussians, model):
    camera = look_at((0.4, 0.2, -1.5), (0, 0, 0), width=50, height=40)
    settings = RenderSettings(model=model, background=(0.3, 0.9, 0.1))
    assert_close(random_gaussians(150, seed=7), camera, settings)


def test_inside_the_scene(random_gaussians):
    """Splats all around the eye: on the near plane, behind it, and far outside the view."""
    assert_close(random_gaussians(400, seed=3), look_at((0, 0, 0), (0, 0.3, 1), width=80, height=45))


def test_principal_point_off_centre(random_gaussians):
    camera = look_at((0, 0, -2), (0, 0, 0), width=61, height=47)
    for cx, cy in ((5.0, 40.0), (-30.0, 20.0), (90.0, 80.0)):
        assert_close(random_gaussians(200, seed=5), replace(camera, cx=cx, cy=cy, fx=30.0))


def test_needles(random_gaussians):
    scene = random_gaussians(200, seed=8)
    scales = scene.log_scales.copy()
    scales[:, 0], scales[:, 1:] = -0.5, -14.0
    camera = look_at((0.3, 0.1, -2.5), (0, 0, 0), width=300, height=200)
    assert_close(replace(scene, log_scales=scales), camera)


def test_far_from_the_origin(random_gaussians):
    """Float64 means at 10⁷ m: offsets from the eye keep their digits."""
    near = random_gaussians(200, seed=9)
    shift = np.array([1e7, -2e7, 3e6])
    far = replace(near, means=near.means.astype(np.float64) + shift)
    eye = np.array([0.5, 0.2, -2.5])
    here = raster.render(near, look_at(tuple(eye), (0, 0, 0), width=90, height=60))
    camera = look_at(tuple(eye + shift), tuple(shift), width=90, height=60)
    assert np.abs(raster.render(far, camera) - here).max() < 1e-4
    assert_close(far, camera)


def test_wide_background_colour_and_transparent_scene():
    camera = look_at((0, 0, -3), (0, 0, 0), width=20, height=20)
    settings = RenderSettings(background=(0.25, 2.0, -1.0))
    image = raster.render(one_splat(opacity_logits=-20.0), camera, settings)
    assert np.array_equal(image, np.broadcast_to(np.array([0.25, 2.0, -1.0, 0.0], np.float32), image.shape))


def test_no_splats(random_gaussians):
    camera = look_at((0, 0, -3), (0, 0, 0), width=35, height=18)
    empty = random_gaussians(5).take(np.zeros(0, np.int64))
    image = raster.render(empty, camera, RenderSettings(background=(0.1, 0.2, 0.3)))
    assert np.array_equal(image, np.broadcast_to(np.array([0.1, 0.2, 0.3, 0.0], np.float32), image.shape))


def test_last_half_tile_is_drawn():
    """1080 rows are 67.5 tiles: the last 8 rows show the same splat as any others."""
    camera = replace(look_at((0, 0, -4), (0, 0, 0), width=24, height=1080), cy=1076.0)
    error = errors(one_splat(), camera)
    assert raster.render(one_splat(), camera)[1072:].max() > 0.3
    assert error.max() <= BOUND


def test_opaque_layers_end_early_and_stay_within_the_bound(random_gaussians):
    scene = random_gaussians(3000, sh_degree=0, seed=11)
    scene = replace(
        scene, opacity_logits=np.full(3000, 6, np.float32), log_scales=np.full((3000, 3), -1.5, np.float32)
    )
    camera = look_at((0, 0, -3), (0, 0, 0), width=100, height=70)
    settings = RenderSettings(background=(5.0, 5.0, 5.0))
    workspace = raster.Workspace()
    exact = raster.draw_frame(raster.parameters_of(scene), camera, settings, workspace, early_stop=0.0).image
    assert np.abs(raster.render(scene, camera, settings) - exact).max() <= 5e-5
    assert_close(scene, camera)


def test_equal_depths_go_by_index(random_gaussians):
    scene = random_gaussians(2, sh_degree=0)
    scene = replace(scene, means=np.zeros((2, 3), np.float32), opacity_logits=np.full(2, 5, np.float32))
    camera = look_at((0, 0, -3), (0, 0, 0), width=32, height=32)
    assert_close(scene, camera)
    swapped = scene.take(np.array([1, 0]))
    assert_close(swapped, camera)
    assert np.abs(raster.render(scene, camera) - raster.render(swapped, camera)).max() > 0.1


def test_any_number_of_threads_gives_the_same_bits(random_gaussians):
    scene = random_gaussians(5000, sh_degree=1)
    camera = look_at((0, 0, -3), (0, 0, 0), width=150, height=111)
    pictures = [raster.render(scene, camera, threads=threads) for threads in (1, 2, 3, 8)]
    assert all(np.array_equal(picture, pictures[0]) for picture in pictures)


def test_bands_do_not_show(random_gaussians, monkeypatch):
    """A picture of more pairs than fit is drawn band by band."""
    scene = random_gaussians(2000, sh_degree=0)
    camera = look_at((0, 0, -3), (0, 0, 0), width=150, height=111)
    whole = raster.render(scene, camera)
    monkeypatch.setattr("splatview.raster.frame.MAX_LISTED_PAIRS", 500)
    frame = raster.draw_frame(
        raster.parameters_of(scene), camera, RenderSettings(), raster.Workspace(), threads=2
    )
    assert len(frame.bins.bands) > 5
    assert np.array_equal(frame.image, whole)


@pytest.mark.parametrize(
    "changes",
    [
        {"means": [np.nan, 0, 0]},
        {"means": [0, np.inf, 0]},
        {"means": [0, 0, -3]},
        {"quats": [0, 0, 0, 0]},
        {"quats": [1e-31, 0, 0, 0]},
        {"quats": [np.nan, 0, 0, 1]},
        {"quats": [np.inf, 0, 0, 1]},
        {"log_scales": [np.nan, 0, 0]},
        {"log_scales": [100, 0, 0]},
        {"log_scales": [44, 44, 44]},
        {"opacity_logits": np.nan},
        {"opacity_logits": -np.inf},
        {"opacity_logits": -100},
        {"sh": [np.nan, 0, 0]},
        {"sh": [0, np.inf, 0]},
        {"sh": [0, 0, -np.inf]},
    ],
)
def test_bad_splat_is_culled(random_gaussians, changes):
    """It leaves no trace, and its neighbours stay."""
    camera = look_at((0, 0, -3), (0, 0, 0), width=40, height=30)
    bad = one_splat(**changes)
    assert np.array_equal(raster.render(bad, camera), np.zeros((30, 40, 4), np.float32))
    assert_close(bad, camera)


@pytest.mark.parametrize(
    "changes",
    [
        {"quats": [1e-29, 0, 1e-29, 0]},
        {"quats": [3e38, 3e38, 3e38, 3e38]},
        {"log_scales": [-30, -30, -30]},
        {"log_scales": [30, -30, 0]},
        {"log_scales": [-np.inf, -1, -1]},
        {"opacity_logits": np.inf},
        {"opacity_logits": 100},
        {"sh": [1e30, -1e30, 0]},
        {"means": [0, 0, -2.98]},
    ],
)
def test_valid_extreme_stays_visible(changes):
    camera = look_at((0, 0, -3), (0, 0, 0), width=40, height=31)
    image = raster.render(one_splat(**changes), camera)
    assert image[..., 3].max() > 0.1
    expected = reference.render(one_splat(**changes), camera)
    assert np.abs(image - expected).max() <= BOUND * max(1.0, float(np.abs(expected).max()))


def test_footprint_reaches_in_from_outside():
    """Mean far outside the view: the clamp of the Jacobian and the extent decide."""
    splat = one_splat(means=[6.0, 0, 0], log_scales=[0.8, 0.8, 0.8])
    camera = look_at((0, 0, -3), (0, 0, 0), width=64, height=48)
    assert raster.render(splat, camera)[..., 3].max() > 0.05
    assert_close(splat, camera)


@pytest.mark.parametrize("name", ["train-1000.ply", "skull.ply", "playbot_lod0.ply"])
def test_trained_scene(data_file, name):
    scene = load_scene(data_file(f"scenes/{name}"))
    centre = np.median(scene.means, axis=0).astype(np.float64)
    radius = float(np.percentile(np.linalg.norm(scene.means - centre, axis=1), 90))
    eye = centre + radius * np.array([0.6, -0.5, -1.9])
    camera = look_at(tuple(eye), tuple(centre), up=(0, -1, 0), width=160, height=91)
    assert_close(scene, camera, RenderSettings(background=(0.2, 0.4, 0.6)))
