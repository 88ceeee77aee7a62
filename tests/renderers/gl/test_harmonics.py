"""Spherical harmonics on the GPU: only what is not zero takes memory, and no picture can tell."""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl import scene_buffers, scene_textures
from splatview.renderers.gl.context import held_bytes
from splatview.renderers.gl.quads import EARLY_STOP, QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.renderer import GLRenderer
from splatview.renderers.gl.scene_buffers import DEGREE_BITS, own_words, places, sh_words, stored_harmonics
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings, concatenate, look_at, reference
from splatview.scene.attribute_formats import FORMATS
from splatview.scene.effects.effect import VISIBLE
from splatview.scene.effects.overrides import settings_for
from splatview.scene.gaussians import SH_COEFFICIENTS

CAMERA = look_at((0, 0, 2.5), (0, 0, 0), width=64, height=48)

EXACT = RenderSettings(blend="float32")

RENDERERS = (QuadsRenderer, TilesRenderer, QuadsGL33Renderer)


def cut(scene: Gaussians, degrees: np.ndarray) -> Gaussians:
    """With zeros beyond each splat's degree."""
    kept = np.arange(scene.sh.shape[1]) < np.array(SH_COEFFICIENTS)[degrees][:, None]
    return replace(scene, sh=np.where(kept[..., None], scene.sh, np.float32(0)))


def padded(scene: Gaussians, degree: int = 3) -> Gaussians:
    missing = SH_COEFFICIENTS[degree] - scene.sh.shape[1]
    return replace(scene, sh=np.pad(scene.sh, ((0, 0), (0, missing), (0, 0))))


@pytest.fixture
def mixed(random_gaussians) -> Gaussians:
    """Splats of all four degrees, most of them low."""
    scene = random_gaussians(2500)
    return cut(scene, np.random.default_rng(4).choice(4, len(scene), p=(0.6, 0.2, 0.1, 0.1)))


def alike(monkeypatch) -> None:
    """Has all splats stored alike from here on."""
    monkeypatch.setattr(scene_buffers, "own_degrees", lambda sh: None)
    monkeypatch.setattr(scene_buffers, "_plans", WeakKeyDictionary())  # those made before know own degrees


def picture(make: type[GLRenderer], ctx, scene: Gaussians, settings=EXACT, **loading):
    """The picture, and how many bytes the renderer held after it."""
    renderer = make(ctx)
    renderer.load(scene, **loading)
    image = renderer.render(FrameRequest(scene, CAMERA, settings))
    held = held_bytes(renderer)
    renderer.close()
    return image, held


@pytest.mark.parametrize("make", RENDERERS)
@pytest.mark.parametrize("degree", [0, 1])
def test_bands_of_zeros_take_no_memory_and_change_no_bit(ctx, random_gaussians, make, degree):
    scene = random_gaussians(2500, sh_degree=degree)
    for settings in (EXACT, settings_for(scene)):
        image, held = picture(make, ctx, scene, settings)
        same, as_many = picture(make, ctx, padded(scene), settings)
        assert np.array_equal(same, image)
        assert as_many == held


@pytest.mark.parametrize("make", RENDERERS)
def test_splats_of_low_degree_take_less_and_change_no_bit(ctx, mixed, make, monkeypatch):
    image, held = picture(make, ctx, mixed)
    assert np.abs(image - reference.render(mixed, CAMERA)).max() < 1e-3
    lower, _ = picture(make, ctx, mixed, replace(EXACT, sh_degree=1))
    alike(monkeypatch)
    expected, more = picture(make, ctx, mixed)
    # What the compiler fuses may differ between the two programs by the last bit of a colour.
    assert np.abs(image - expected).max() <= 1e-6
    assert held < more - 2500 * 12 * 8
    expected, _ = picture(make, ctx, mixed, replace(EXACT, sh_degree=1))
    assert np.abs(lower - expected).max() <= 1e-6


@pytest.mark.parametrize("attributes", FORMATS)
def test_own_degrees_in_fewer_bits(ctx, mixed, attributes, monkeypatch):
    image, _ = picture(QuadsRenderer, ctx, mixed, attributes=attributes)
    alike(monkeypatch)
    expected, _ = picture(QuadsRenderer, ctx, mixed, attributes=attributes)
    assert np.abs(image - expected).max() <= 1e-6


def test_own_degrees_in_pages_and_slices(ctx, mixed, monkeypatch):
    expected, _ = picture(QuadsRenderer, ctx, mixed)
    monkeypatch.setattr(scene_buffers, "storage_limit", lambda _: 2500 * 16)
    monkeypatch.setattr(scene_buffers, "UPLOAD_SLICE", 100)
    *_, scene = scene_buffers.upload_steps(ctx, mixed)
    assert isinstance(scene, scene_buffers.SceneBuffers)
    assert len(scene.pages) > 8
    for page in scene.pages:
        part = slice(page.first, page.first + page.count)
        degrees = scene.harmonics.of(part)
        coefficients = int(np.array(SH_COEFFICIENTS)[degrees].sum())
        assert page.sh.size == page.count * 4 + coefficients * 12 <= 2500 * 16
    scene.release()
    assert np.array_equal(picture(QuadsRenderer, ctx, mixed)[0], expected)


def test_own_degrees_in_rows_and_layers_of_textures(ctx, random_gaussians, monkeypatch):
    """More coefficients than a layer has texels, and uploads that end amid a row."""
    scene = random_gaussians(9000)
    scene = cut(scene, np.random.default_rng(5).choice(4, len(scene), p=(0.5, 0.2, 0.1, 0.2)))
    monkeypatch.setattr(scene_textures, "ROWS_AT_ONCE", 1)
    *_, textures = scene_textures.upload_steps(ctx, scene)
    assert isinstance(textures, scene_textures.SceneTextures)
    assert textures.places is not None and textures.sh.layers > 2
    textures.release()
    image, _ = picture(QuadsGL33Renderer, ctx, scene)
    alike(monkeypatch)
    assert np.abs(image - picture(QuadsGL33Renderer, ctx, scene)[0]).max() <= 1e-6


def test_scenes_of_one_degree_keep_one_layout(ctx, random_gaussians):
    scene = random_gaussians(3000)
    assert stored_harmonics(scene, every_band=True).own_degrees is None
    nearly = cut(scene, np.where(np.arange(3000) % 25, 3, 0))
    assert stored_harmonics(nearly, every_band=True).own_degrees is None


def test_words_lie_where_places_say(mixed):
    degrees = np.array([0, 3, 1, 0, 2], np.uint8)
    sh = cut(mixed.take(np.arange(5)), degrees).sh
    for attributes in FORMATS:
        words = own_words(sh, degrees, attributes)
        whole = places(degrees, attributes, 7)
        starts = (whole >> DEGREE_BITS) - 7
        assert starts[0] == 0 and starts[-1] == len(words)
        for splat, degree in enumerate(degrees):
            assert whole[splat] & 3 == degree
            own = sh_words(sh[splat : splat + 1, : SH_COEFFICIENTS[degree]], attributes)
            assert np.array_equal(words[starts[splat] : starts[splat + 1]], own[0])


@pytest.mark.parametrize("make", RENDERERS)
def test_invisible_bands_come_when_they_are_asked_for(ctx, random_gaussians, make):
    scene = random_gaussians(600)
    sh = scene.sh.copy()
    sh[:, 9:] *= np.float32(1e-3)
    scene = replace(scene, sh=sh)
    renderer = make(ctx)
    renderer.load(scene)
    seen = renderer.render(
        FrameRequest(scene, CAMERA, replace(EXACT, sh_degree=settings_for(scene).sh_degree))
    )
    held = held_bytes(renderer)
    every = renderer.render(FrameRequest(scene, CAMERA, EXACT))
    assert held_bytes(renderer) - held >= 600 * 7 * 12
    assert 0 < np.abs(every - seen).max() <= VISIBLE
    assert np.abs(every - reference.render(scene, CAMERA)).max() < 1e-4 + EARLY_STOP
    assert renderer.every_band  # and so from now on: a training shows one scene after the other
    again = replace(scene)
    renderer.load(again)
    assert np.array_equal(renderer.render(FrameRequest(again, CAMERA, EXACT)), every)
    assert renderer.stats().drawn == 3
    renderer.close()


def test_a_merged_scene_pays_for_the_bands_of_its_parts(ctx, random_gaussians):
    plain, full = random_gaussians(2000, sh_degree=0), random_gaussians(500, seed=1)
    scene = concatenate([plain, full])
    *_, merged = scene_buffers.upload_steps(ctx, scene)
    assert isinstance(merged, scene_buffers.SceneBuffers)
    assert sum(page.sh.size for page in merged.pages) == 2500 * 4 + (2000 + 500 * 16) * 12
    merged.release()


def test_textures_in_layers_are_counted_as_memory(ctx):
    array = ctx.texture_array((8, 4, 3), 3, dtype="f4")
    assert held_bytes([array]) == 8 * 4 * 3 * 3 * 4
    assert isinstance(array, moderngl.TextureArray)
    array.release()
