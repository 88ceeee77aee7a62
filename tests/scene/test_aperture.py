"""Depth of field against what a thin lens does: sharp at the focus, discs of known size elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.measure.metrics import largest_error, psnr
from splatview.scene import Camera, InputError, RenderSettings, reference
from splatview.scene.background import Gradient, background_colours
from splatview.scene.depth_of_field import Aperture, camera_at, disc_point, mean_picture
from splatview.scene.lens import Lens

LENS = Aperture(diameter=0.5, focus=4.0)


@pytest.fixture(scope="module")
def camera(identity_camera) -> Camera:
    return identity_camera(61, 61, 100.0)


def test_points_cover_the_disc_evenly():
    points = np.array([disc_point(index) for index in range(4096)])
    assert points[0].tolist() == [0, 0]
    radius, angle = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    assert radius.max() <= 1
    for count in (64, 1000, 4096):
        # Rings and sectors of equal area hold equally many; at random some were off by 30 of 4096.
        rings, _ = np.histogram(radius[:count] ** 2, bins=4, range=(0, 1))
        sectors, _ = np.histogram(angle[:count], bins=8, range=(-np.pi, np.pi))
        assert np.abs(rings - count / 4).max() <= 8
        assert np.abs(sectors - count / 8).max() <= 8


def test_points_in_focus_stay_on_their_pixels_and_others_move_in_proportion(camera):
    points = np.array([[0.3, -0.2, 4.0], [0.3, -0.2, 2.0], [-0.1, 0.4, 40.0]])
    centre = camera.image_points(points)
    for index in (1, 7, 20):
        moved = camera_at(camera, LENS, index)
        seen_at = moved.image_points(points + moved.t_camera_world) - centre
        expected = np.outer([0.0, *(100 * 0.25 * (1 / 4 - 1 / z) for z in (2.0, 40.0))], disc_point(index))
        np.testing.assert_allclose(seen_at, expected, atol=1e-12)


def test_a_splat_in_focus_stays_sharp(camera, flat_gaussians):
    flat = flat_gaussians([0.02, -0.03, 4.0], (0.06, 0.03, 1e-5), opacity_logits=3.0)
    settings = RenderSettings()

    def draw(pinhole: Camera) -> np.ndarray:
        return reference.render(flat, pinhole, settings)

    through = mean_picture(draw, camera, LENS, 16)
    assert psnr(through, draw(camera)) > 80
    # Farther away it is not, by any measure.
    assert psnr(mean_picture(draw, camera, replace(LENS, focus=2.0), 16), draw(camera)) < 40


@pytest.mark.parametrize("depth", [2.5, 8.0])
def test_a_splat_out_of_focus_is_a_disc_of_the_lenses_size(camera, flat_gaussians, depth):
    """Of a point's light, which a small splat is, the mean squared distance from the centre is that of a
    disc, d²/8, and of the splat's own footprint."""
    point = flat_gaussians([0, 0, depth], 1e-4, opacity_logits=-1.0)

    def draw(pinhole: Camera) -> np.ndarray:
        return reference.render(point, pinhole, RenderSettings())[..., 3]

    def spread(light: np.ndarray) -> float:
        y, x = np.mgrid[:61, :61] + 0.5 - 30.5
        return float((light * (x * x + y * y)).sum() / light.sum())

    sharp, through = draw(camera), mean_picture(draw, camera, LENS, 256)
    diameter = LENS.diameter * camera.fx * abs(1 / LENS.focus - 1 / depth)
    assert diameter > 5
    assert 8 * (spread(through) - spread(sharp)) == pytest.approx(diameter**2, rel=0.02)
    assert through.sum() == pytest.approx(sharp.sum(), rel=0.03)  # pixels sample the footprint
    # A disc: as bright half way out as in the middle, and dark beyond.
    y, x = np.mgrid[:61, :61] + 0.5 - 30.5
    share = np.hypot(x, y) / (diameter / 2)
    level = through.sum() / (np.pi / 4 * diameter**2)
    assert through[share < 0.7].mean() == pytest.approx(level, rel=0.1)
    assert through[share > 1.6].max() < 0.02 * level


def test_more_samples_come_nearer(camera, random_gaussians):
    """Of discs of some 10 px."""
    scene = random_gaussians(40, sh_degree=0)
    scene = replace(scene, means=scene.means + np.array([0, 0, 4], np.float32))
    camera, settings = camera.resized(24, 24), RenderSettings(background=(0.2, 0.3, 0.4))

    def error(samples: int) -> tuple[float, float]:
        picture = mean_picture(
            lambda pinhole: reference.render(scene, pinhole, settings), camera, wide, samples
        )
        return largest_error(picture, truth), psnr(picture, truth)

    wide = Aperture(diameter=1.5, focus=4.0)
    truth = mean_picture(lambda pinhole: reference.render(scene, pinhole, settings), camera, wide, 1024)
    errors = [error(samples) for samples in (16, 64, 256)]
    assert [quality > least for (_, quality), least in zip(errors, (40, 50, 60), strict=True)] == [True] * 3
    assert errors[0][0] > errors[1][0] > errors[2][0]


def test_the_background_is_out_of_focus_too(camera):
    sky = Gradient(top=(1, 1, 1), bottom=(0, 0, 0))
    lens = Aperture(diameter=1.0, focus=1.0)
    through = mean_picture(lambda pinhole: background_colours(sky, pinhole), camera, lens, 64)
    pinholes = [background_colours(sky, camera_at(camera, lens, index)) for index in range(64)]
    np.testing.assert_allclose(through, np.mean(pinholes, axis=0))
    assert np.ptp(pinholes, axis=0).max() > 0.2


def test_cameras_that_are_no_pinholes_are_refused(camera):
    for other in (
        replace(camera, lens=Lens(model="SIMPLE_RADIAL", parameters=(0.1,))),
        replace(camera, orthographic=True),
    ):
        with pytest.raises(InputError, match="needs a pinhole camera"):
            mean_picture(lambda pinhole: np.zeros(1), other, LENS, 4)


@pytest.mark.parametrize("values", [(0.0, 1.0), (1.0, -1.0), (float("nan"), 1.0), (1.0, float("inf"))])
def test_apertures_that_make_no_sense(values):
    with pytest.raises(ValueError, match="must be positive and finite"):
        Aperture(diameter=values[0], focus=values[1])
