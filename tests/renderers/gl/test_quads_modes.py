"""What each visual mode shows, on scenes whose answer is known."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.sh import rgb_to_sh

CAMERA = look_at((0, 0, -4), (0, 0, 0), width=65, height=49)
SETTINGS = RenderSettings(blend="float32", background=(0.0, 0.0, 1.0))
RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


@pytest.fixture
def renderer(ctx: moderngl.Context) -> Iterator[QuadsRenderer]:
    made = QuadsRenderer(ctx)
    yield made
    made.close()


def splats(places: list, colours: list, scales: tuple = (0.5, 0.5, 0.5), logit: float = 9.0) -> Gaussians:
    n = len(places)
    return Gaussians(
        means=np.array(places, dtype=np.float32).reshape(n, 3),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.log(np.tile(np.array(scales, np.float32), (n, 1))),
        opacity_logits=np.full(n, logit, dtype=np.float32),
        sh=rgb_to_sh(np.array(colours, dtype=np.float32)).reshape(n, 1, 3),
    )


def picture(renderer: QuadsRenderer, scene: Gaussians, mode, settings: RenderSettings = SETTINGS):
    renderer.load(scene)
    renderer.draw(FrameRequest(None, CAMERA, settings, mode=mode))
    return renderer.read()


def test_points_are_small_discs_of_one_size_with_the_nearest_in_front(renderer):
    scene = splats([(0, 0, 1), (0, 0, 0)], [RED, GREEN], scales=(2, 2, 2))
    image = picture(renderer, scene, "points")
    assert np.allclose(image[24, 32], (0, 1, 0, 1), atol=1e-3)
    covered = image[..., 3] > 0.5
    assert 4 <= covered.sum() <= 13
    assert np.allclose(image[0, 0], (0, 0, 1, 0))


def test_ellipsoids_hide_by_the_pixels_depth_and_are_lit_from_the_eye(renderer):
    scene = splats([(0, 0, 0)], [GREEN])
    image = picture(renderer, scene, "ellipsoids")
    centre, rim = image[24, 32], image[24, 32 + 9]
    assert np.allclose(centre, (0, 1, 0, 1), atol=0.03)
    assert 0.3 <= rim[1] < 0.85
    # The silhouette of a sphere of 1.5 sigma at distance 4: asin(0.75 / 4) about the axis.
    radius = CAMERA.fx * np.tan(np.arcsin(0.75 / 4))
    assert abs(np.sqrt((image[..., 3] > 0.5).sum() / np.pi) - radius) < 0.6

    # Red's centre is farther, yet its long axis reaches in front of green's middle.
    crossing = splats([(0, 0, 0), (0, 0, 0.2)], [GREEN, RED], scales=(0.5, 0.1, 0.1))
    crossing.log_scales[1] = np.log(np.array([0.1, 0.1, 0.5], np.float32))
    image = picture(renderer, crossing, "ellipsoids")
    assert image[24, 32, 0] > 0.8  # red reaches in front at the middle
    assert image[24, 32 + 8, 1] > 0.3  # green beside it


def test_thin_and_faint_ellipsoids(renderer):
    disc = splats([(0, 0, 0)], [GREEN], scales=(0.6, 0.6, 1e-7))
    image = picture(renderer, disc, "ellipsoids")
    assert np.allclose(image[24, 32], (0, 1, 0, 1), atol=0.05)
    faint = picture(renderer, splats([(0, 0, 0)], [GREEN], logit=-3.0), "ellipsoids")
    assert (faint[..., 3] == 0).all()


def test_an_ellipsoid_around_the_eye_does_not_hide_the_scene(renderer):
    scene = splats([(0, 0, -4), (0, 0, 0)], [RED, GREEN])
    image = picture(renderer, scene, "ellipsoids")
    assert np.allclose(image[24, 32], (0, 1, 0, 1), atol=0.03)


def test_depth_is_bright_when_near_and_the_same_for_any_opacity(renderer):
    # This camera looks along +z with y up, so +x is on its left.
    scene = splats([(1, 0, -0.5), (-1, 0, 0.5)], [RED, GREEN], scales=(0.3, 0.3, 0.3))
    black = RenderSettings(blend="float32")
    image = picture(renderer, scene, "depth", black)
    left, right = image[24, 32 - 13], image[24, 32 + 12]
    assert left[1] / left[3] > right[1] / right[3] + 0.1  # viridis: more green is nearer
    faint = splats([(1, 0, -0.5), (-1, 0, 0.5)], [RED, GREEN], scales=(0.3, 0.3, 0.3), logit=0.0)
    shown = picture(renderer, faint, "depth", black)[24, 32 - 13]
    assert np.allclose(shown[:3] / shown[3], left[:3] / left[3], atol=0.06)


def test_overdraw_counts_splats_on_a_logarithmic_scale(renderer):
    def brightness(n: int) -> float:
        scene = splats([(0, 0, 0)] * n, [GREEN] * n, logit=0.0)
        return float(picture(renderer, scene, "overdraw")[24, 32, :3].sum())

    levels = [brightness(n) for n in (1, 7, 63, 511)]
    assert levels == sorted(levels)
    assert levels[0] < 0.5 < 1.5 < levels[-1]
    image = picture(renderer, splats([(0, 0, 0)], [GREEN], scales=(0.01,) * 3), "overdraw")
    assert np.allclose(image[0, 0], (0, 0, 0, 1), atol=0.02)  # nothing there: the map's black


@pytest.mark.parametrize("mode", ["points", "ellipsoids", "depth", "overdraw"])
def test_modes_draw_empty_scenes(renderer, mode):
    image = picture(renderer, splats([], []), mode)
    assert np.isfinite(image).all()
