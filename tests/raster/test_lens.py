"""Lenses and parallel rays on the CPU: against a pinhole's picture resampled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.metrics import psnr
from splatview.raster import render
from splatview.raster.camera_models import atan_lanes
from splatview.raster.compiling import kernel
from splatview.raster.contributions import contributions, dominant_splats
from splatview.raster.simd import LANES, load, store
from splatview.scene import Gaussians, Lens, RenderSettings, look_at, reference
from splatview.scene.lens import undistort

PINHOLE = look_at((0.2, 0.1, -1.3), (0, 0, 0), up=(0, -1, 0), fov_y=75, width=75, height=51)
LENSES = {
    "OPENCV": (-0.2, 0.05, 0.01, -0.02),
    "OPENCV_FISHEYE": (0.05, -0.02, 0.01, 0.003),
}
CAMERAS = {
    **{name: replace(PINHOLE, lens=Lens(model=name, parameters=LENSES[name])) for name in LENSES},
    "parallel": replace(PINHOLE, orthographic=True, fx=24.0, fy=21.0),
}


@kernel
def _angles(x, out):
    for start in range(0, len(x), LANES):
        store(out, start, atan_lanes(load(x, start)))


def test_angles_are_right_to_the_last_places():
    edges = [0.0, 1e-300, 1e-8, 0.4142, 0.4143, 2.414, 2.415, 1e8, np.inf]
    x = np.concatenate([edges, np.geomspace(1e-3, 1e3, 103)])
    out = np.empty_like(x)
    _angles(x, out)
    np.testing.assert_allclose(out, np.arctan(x), rtol=2e-15, atol=0)
    _angles(np.full(LANES, np.nan), out)
    assert np.isnan(out[:LANES]).all()


@pytest.mark.parametrize("kind", ["OPENCV", "parallel"])
def test_per_pixel_order_contributions_and_ids(random_gaussians, kind):
    """What else takes a camera: a single splat is the same in any order, and the dominant one is what
    covers."""
    one = random_gaussians(1, seed=3)
    one.opacity_logits[:] = 4.0
    one.means[:] = (0.1, 0.1, 0.2)
    image = render(one, CAMERAS[kind], RenderSettings(order="per-pixel"))
    truth = reference.render(one, CAMERAS[kind])
    assert np.abs(image - truth).max() < 2e-3
    np.testing.assert_array_equal(dominant_splats(one, CAMERAS[kind]) == 0, truth[..., 3] >= 0.5)
    assert contributions(one, [CAMERAS[kind]])[0] == pytest.approx(truth[..., 3].sum(), rel=1e-4)


def small_splats(count: int = 40_000) -> Gaussians:
    """A bumpy wall of splats below a pixel's size, in a smooth pattern of colours."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-4, 4, size=(2, count))
    z = 0.3 * np.sin(2 * x) * np.cos(1.5 * y)
    colours = np.stack([np.sin(2 * x + 1), np.cos(3 * y), np.sin(x - 2 * y)], axis=1)
    return Gaussians(
        means=np.stack([x, y, z], axis=1).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(0.03), np.float32),
        opacity_logits=np.full(count, 3.0, np.float32),
        sh=colours[:, None, :].astype(np.float32),
    )


@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_small_splats_are_seen_where_the_lens_puts_a_pinhole_s_picture(model):
    """Each pixel through the lens is the pinhole's where its ray goes, of a picture three times as fine:
    40 dB, and 25 to 27 dB where the lens is left out."""
    scene = small_splats()
    camera = replace(look_at((0, 0, -2), (0, 0, 0), up=(0, -1, 0), fov_y=60, width=160, height=120))
    lens = Lens(model=model, parameters=LENSES[model])
    image = render(scene, replace(camera, lens=lens))[..., :3]
    fine = replace(camera, width=960, height=720, fx=3 * camera.fx, fy=3 * camera.fy, cx=480.0, cy=360.0)
    wide = render(scene, fine)[..., :3]
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    rays = undistort(np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy], axis=-1), lens)
    u, v = np.rint(rays * (fine.fx, fine.fy) + (fine.cx, fine.cy) - 0.5).transpose(2, 0, 1).astype(int)
    inside = (u >= 1) & (u < 959) & (v >= 1) & (v < 719)
    assert inside.mean() > 0.9
    # The mean of 3x3 fine pixels is about one of the coarse picture.
    resampled = np.mean([wide[v[inside] + j, u[inside] + i] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)
    assert psnr(image[inside][None], resampled[None]) > 38
    assert psnr(image[inside][None], render(scene, camera)[..., :3][inside][None]) < 29
