"""Layers over a picture: outlines lie where projection says, lines behind what the picture covers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl import overlay
from splatview.renderers.gl.overlay import LineLayer, Lines, SplatLayer
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Camera, Gaussians, Lens, RenderSettings, look_at
from splatview.scene.camera import with_parallel_rays
from splatview.scene.edits import DELETED, PALETTE_SHIFT, SELECTED, Adjustment, SceneEdits, bake
from splatview.scene.projection import project

Make = Callable[..., Gaussians]

CAMERA = look_at((0.4, -0.5, -3.0), (0, 0, 0), up=(0, -1, 0), width=160, height=120)
SETTINGS = RenderSettings()


@pytest.fixture
def layer(ctx: moderngl.Context) -> Iterator[SplatLayer]:
    made = SplatLayer(ctx)
    yield made
    made.close()


def drawn(layer: SplatLayer, request: FrameRequest, **options: bool) -> np.ndarray:
    """(H, W, 4) float."""
    layer.draw(request, **{"centres": False, "rings": False, **options})
    width, height = layer.texture.size
    return np.frombuffer(layer.texture.read(), np.uint8).reshape(height, width, 4) / 255


def few(random_gaussians: Make, count: int = 12) -> Gaussians:
    scene = random_gaussians(count, seed=2)
    return replace(scene, opacity_logits=np.full(count, 2.0, np.float32))


CAMERAS: dict[str, Camera] = {
    "pinhole": CAMERA,
    "lens": replace(CAMERA, lens=Lens(model="SIMPLE_RADIAL", parameters=(-0.2,))),
    "parallel": with_parallel_rays(CAMERA, 3.0),
}


@pytest.mark.parametrize("kind", CAMERAS)
def test_outlines_are_ellipses_of_one_standard_deviation(layer, random_gaussians: Make, kind):
    camera = CAMERAS[kind]
    for number in range(6):
        scene = few(random_gaussians).take(np.array([number]))
        image = drawn(layer, FrameRequest(scene, camera, SETTINGS), rings=True)
        footprints = project(scene, camera, SETTINGS)
        (mean,), (a, b, c) = footprints.means2d, footprints.conic_factors[0]
        rows, columns = np.nonzero(image[..., 3] > 0)
        d = np.stack([columns, rows], axis=1) + 0.5 - mean
        whitened = np.stack([a * d[:, 0] + b * d[:, 1], c * d[:, 1]], axis=1)
        length = np.linalg.norm(whitened, axis=1)
        gradient = np.stack([a * whitened[:, 0], b * whitened[:, 0] + c * whitened[:, 1]], axis=1)
        apart = np.abs(length - 1) * length / np.linalg.norm(gradient, axis=1)
        assert len(rows) > 8, "there is an outline"
        assert apart.max() < overlay.RING_HALF_WIDTH + 0.05
        # And all the way round, where it is in the picture.
        angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        v = np.sin(angles) / c
        around = np.stack([(np.cos(angles) - b * v) / a, v], axis=1) + mean
        inside = ((around > 1) & (around < (camera.width - 1, camera.height - 1))).all(axis=1)
        for x, y in around[inside].astype(int).tolist():
            assert image[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2, 3].any()


def test_centres_are_dots_at_the_means(layer, random_gaussians: Make):
    scene = few(random_gaussians)
    image = drawn(layer, FrameRequest(scene, CAMERA, SETTINGS), centres=True)
    means = project(scene, CAMERA, SETTINGS).means2d
    rows, columns = np.nonzero(image[..., 3] > 0)
    places = np.stack([columns, rows], axis=1) + 0.5
    apart = np.linalg.norm(places[:, None] - means, axis=2)
    assert apart.min(axis=1).max() <= overlay.LARGEST_CENTRE + 0.01
    assert apart.min(axis=0).max() <= 1.0, "each has one"
    np.testing.assert_allclose(image[rows, columns, :3].std(axis=0), 0, atol=1e-6)


def test_edits_and_selection_are_followed(layer, random_gaussians: Make):
    scene = few(random_gaussians)
    marks = np.zeros(len(scene), np.uint32)
    marks[0] = DELETED
    marks[1] = SELECTED
    marks[2] = 1 << PALETTE_SHIFT
    palette = (Adjustment(), Adjustment(translation=(0.1, 0.2, 0.0)))
    edits = SceneEdits(marks=marks, palette=palette, flags=DELETED | SELECTED)
    tint = (1.0, 0.0, 0.0, 1.0)
    request = FrameRequest(scene, CAMERA, SETTINGS, edits=edits, highlight=Highlight(selected=tint))
    image = drawn(layer, request, centres=True)
    baked = drawn(layer, FrameRequest(bake(scene, edits), CAMERA, SETTINGS), centres=True)
    np.testing.assert_array_equal(image[..., 3], baked[..., 3])
    x, y = project(scene.take(np.array([1])), CAMERA, SETTINGS).means2d[0].astype(int)
    np.testing.assert_allclose(image[y, x], (1, 0, 0, 1), atol=0.01)


def test_many_splats_are_drawn_in_several_frames(layer, random_gaussians: Make, monkeypatch):
    whole = drawn(layer, FrameRequest(random_gaussians(100), CAMERA, SETTINGS), rings=True, centres=True)
    monkeypatch.setattr(overlay, "PAGE", 16)
    request = FrameRequest(random_gaussians(100), CAMERA, SETTINGS)
    layer.draw(request, centres=True, rings=True, seconds=0.0)
    frames = 1
    while layer.busy:
        layer.draw(request, centres=True, rings=True, seconds=0.0)
        frames += 1
    assert frames == 14
    again = drawn(layer, request, centres=True, rings=True)
    assert (again != whole).any(axis=2).mean() < 2e-3, "equal depths may change places"


def test_lines_show_where_the_picture_lets_through(ctx):
    picture = ctx.texture((64, 32), 4, dtype="f4")
    alpha = np.zeros((32, 64, 4), np.float32)
    alpha[:, 32:, 3] = 1
    picture.write(alpha)
    picture.swizzle = "RGB1"
    ends = np.array([[[0, 8.5], [64, 8.5]]], np.float32)
    colours = np.broadcast_to(np.array([0, 1, 0, 0.8], np.float32), (1, 2, 4))
    layer = LineLayer(ctx)
    before = ctx.detect_framebuffer().glo
    layer.draw([Lines(ends, colours, 0.25)], picture, (64, 32))
    image = np.frombuffer(layer.texture.read(), np.uint8).reshape(32, 64, 4) / 255
    np.testing.assert_allclose(image[8, 2:30], np.broadcast_to((0, 1, 0, 0.8), (28, 4)), atol=0.01)
    np.testing.assert_allclose(image[8, 34:62, 3], 0.2, atol=0.01)
    assert not image[:6].any() and not image[11:].any()
    assert picture.swizzle == "RGB1" and ctx.detect_framebuffer().glo == before
    layer.close()
    picture.release()
