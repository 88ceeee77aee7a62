"""The float64 reference against worked answers and the laws of compositing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import TEXTBOOK, ImageModel, RenderSettings, look_at, reference
from splatview.scene.projection import project

RAMP = " .:-=+*#%@"
PICTURE = """\
           ....                    ....
         ........                ........
        ..::::::..              ....::....
       ..:------::.            ...::::::...
      ..:-==++==-:..          ...:::--:::...
      .:-=+****+=-:..         ..::------::..
     ..:-=**##**+-:..        ...:---==---:...
     ..:-+*#%%#*+=-:.        ..::--====--::..
     ..:-+*#%%#*+=-:..       ..::--====--::..
     ..:-=**##**+=-:..       ...:---==---:...
      .:-=+****+=-::...       ..::------::..
      ..:-==++==-::....       ...:::--:::...
       ..:------::......       ...::::::...
        ..::::::..........     .....::....
         .........   ......      ........
           ....       ......       ....
                       ......
                        .....
                         ...."""
"""Three splats under the textbook model, mean RGB v as character int(9 v) of the ramp; worked elsewhere."""


def test_worked_picture(flat_gaussians, identity_camera):
    gaussians = flat_gaussians(
        [(-0.8, 0, 3), (0.8, 0, 3), (0, 0.6, 3.5)],
        [(0.25, 0.25, 0.1), (0.3, 0.3, 0.1), (0.6, 0.2, 0.1)],
        [(1, 0, 0, 0), (1, 0, 0, 0), (0.92, 0, 0, 0.38)],
        opacity_logits=3.0,
        rgb=[(0.95,) * 3, (0.5,) * 3, (0.15,) * 3],
    )
    image = reference.render(gaussians, identity_camera(50, 22, 45.0), RenderSettings(model=TEXTBOOK))
    rows = ["".join(RAMP[int(v * 9)] for v in row).rstrip() for row in image[..., :3].mean(axis=-1)]
    assert "\n".join(row for row in rows if row) == PICTURE


def test_worked_compositing(flat_gaussians, identity_camera):
    """Opacity times Gaussian (.1·.9, .9·.95, .4·.5, 1·.99) on colours (.3, .8, .5, .1) gives 0.673."""
    alphas = np.array([0.1 * 0.9, 0.9 * 0.95, 0.4 * 0.5, 1 * 0.99])
    gaussians = flat_gaussians(
        [(0, 0, z) for z in (1, 2, 3, 4)],
        10.0,  # wide: the Gaussian is 1 at the centre pixel
        opacity_logits=np.log(alphas / (1 - alphas)),
        rgb=np.repeat([[0.3], [0.8], [0.5], [0.1]], 3, axis=1),
    )
    image = reference.render(gaussians, identity_camera(1, 1, 100.0), RenderSettings(model=TEXTBOOK))
    assert image[0, 0, 0] == pytest.approx(0.673, abs=5e-4)
    assert image[0, 0, 3] == pytest.approx(1 - np.prod(1 - alphas), abs=1e-6)


def slow_render(gaussians, camera, settings):
    """Pixel by pixel, splat by splat, as one would do it by hand."""
    model, f = settings.model, project(gaussians, camera, settings)
    image = np.zeros((camera.height, camera.width, 4))
    for row in range(camera.height):
        for column in range(camera.width):
            T = 1.0
            for i in range(len(f.indices)):
                d = np.array([column + 0.5, row + 0.5]) - f.means2d[i]
                xx, xy, yy = f.covariances[i]
                q = d @ np.linalg.inv([[xx, xy], [xy, yy]]) @ d
                alpha = min(model.max_alpha, f.opacities[i] * np.exp(-q / 2))
                if alpha < model.alpha_cut:
                    continue
                image[row, column, :3] += T * alpha * f.colours[i]
                T *= 1 - alpha
            image[row, column, :3] += T * np.array(settings.background)
            image[row, column, 3] = 1 - T
    return image


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("model", [ImageModel(), TEXTBOOK])
def test_equals_the_double_loop(random_gaussians, model, antialiased):
    settings = RenderSettings(model=replace(model, antialiased=antialiased), background=(0.2, 0.5, 0.9))
    camera = look_at((0, 0.2, 1.5), (0, 0, 0), width=17, height=19)
    gaussians = random_gaussians(60)
    np.testing.assert_allclose(
        reference.render(gaussians, camera, settings), slow_render(gaussians, camera, settings), atol=1e-12
    )


@pytest.mark.parametrize(("width", "height"), [(1, 1), (17, 9), (40, 40)])
def test_any_size_is_drawn_to_the_last_row(random_gaussians, width, height):
    camera = look_at((0, 0, 0.5), (0, 0, 0), width=width, height=height)
    image = reference.render(random_gaussians(300), camera)
    assert image.shape == (height, width, 4) and (image[..., 3] > 0).all()


def test_1080_rows_draw_the_last_half_tile(flat_gaussians, identity_camera):
    image = reference.render(
        flat_gaussians([(0, 0, 1)], 50.0, opacity_logits=2.0), identity_camera(8, 1080, 500)
    )
    assert (image[1072:, :, 3] > 0.8).all()


def test_empty_scene_is_background(random_gaussians):
    nothing = random_gaussians(3).take(np.zeros(0, dtype=int))
    settings = RenderSettings(background=(0.1, 0.2, 0.3))
    image = reference.render(nothing, look_at((0, 0, 1), (0, 0, 0), width=5, height=4), settings)
    np.testing.assert_array_equal(image, np.broadcast_to((0.1, 0.2, 0.3, 0.0), (4, 5, 4)))


def test_background_shows_through_what_is_left(random_gaussians):
    camera = look_at((0, 0.2, 2.0), (0, 0, 0), width=24, height=24)
    gaussians = random_gaussians(100)
    black = reference.render(gaussians, camera)
    white = reference.render(gaussians, camera, RenderSettings(background=(1, 1, 1)))
    np.testing.assert_allclose(white[..., :3] - black[..., :3], 1 - black[..., 3:] + np.zeros(3), atol=1e-12)


def test_one_dense_pixel_needs_many_chunks(flat_gaussians, identity_camera):
    """More splats on a block than are evaluated at once: transmittance carries over and may underflow."""
    n = reference.CHUNK * 2 + 5
    gaussians = flat_gaussians(
        [(0, 0, 1)] * n, 10.0, opacity_logits=np.log(0.02 / 0.98), rgb=(0.25, 0.5, 1.0)
    )
    image = reference.render(gaussians, identity_camera(2, 2, 50.0))
    np.testing.assert_allclose(image, np.broadcast_to((0.25, 0.5, 1.0, 1.0), (2, 2, 4)), atol=1e-6)


def test_float32_is_near(random_gaussians):
    camera = look_at((0, 0.2, 2.0), (0, 0, 0), width=48, height=48)
    gaussians = random_gaussians(400)
    single = reference.render(gaussians, camera, dtype=np.float32)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, reference.render(gaussians, camera), atol=2e-3)
