"""Backgrounds: which way is which, and how they are blended."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import Camera, InputError, RenderSettings, look_at, reference
from splatview.scene.background import Gradient, Panorama, background_colours, composite_over
from splatview.scene.formats.panorama import LARGEST_SIDE, load_panorama
from splatview.scene.lens import Lens

BLUE, BROWN = (0.2, 0.4, 1.0), (0.5, 0.3, 0.1)


def colour_towards(background: Gradient | Panorama, direction: tuple[float, float, float]) -> np.ndarray:
    """By a camera of one pixel that looks there."""
    camera = look_at((5, 6, 7), np.add((5, 6, 7), direction), width=1, height=1, fov_y=1)
    return background_colours(background, camera)[0, 0]


def panorama(width: int = 8, height: int = 4) -> Panorama:
    """Red is the column, green the row."""
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[..., 0], pixels[..., 1] = np.meshgrid(np.arange(width) * 10, np.arange(height) * 10)
    return Panorama(pixels=pixels)


def test_a_gradient_is_sky_above_and_ground_below():
    sky = Gradient(top=BLUE, bottom=BROWN)
    assert colour_towards(sky, (0, -1, 0)) == pytest.approx(BLUE)
    assert colour_towards(sky, (0, 1, 0)) == pytest.approx(BROWN)
    assert colour_towards(sky, (1, 0, 2)) == pytest.approx(np.add(BLUE, BROWN) / 2)
    up = math.sin(math.radians(30))
    expected = np.add(np.multiply(BLUE, 0.75), np.multiply(BROWN, 0.25))
    assert colour_towards(sky, (math.sqrt(1 - up * up), -up, 0)) == pytest.approx(expected)
    assert colour_towards(replace(sky, up=(0, 0, 3)), (0, 0, 1)) == pytest.approx(BLUE)


def test_the_middle_of_a_panorama_is_in_front_and_its_right_is_right():
    # The border of columns 3 and 4, and of rows 1 and 2.
    assert colour_towards(panorama(), (0, 0, 1)) == pytest.approx([35 / 255, 15 / 255, 0], abs=1e-6)
    # A quarter turn is two columns: to the right, +x; behind is where the sides meet, of columns 7 and 0.
    assert colour_towards(panorama(), (1, 0, 0))[0] == pytest.approx(55 / 255, abs=1e-6)
    assert colour_towards(panorama(), (-1, 0, 0))[0] == pytest.approx(15 / 255, abs=1e-6)
    assert colour_towards(panorama(), (0, 0, -1))[0] == pytest.approx(35 / 255, abs=1e-6)
    # 45 degrees up is the border of rows 0 and 1; straight up and down the rows end.
    assert colour_towards(panorama(), (0, -1, 1))[1] == pytest.approx(5 / 255, abs=1e-6)
    assert colour_towards(panorama(), (0, -1, 0))[1] == 0
    assert colour_towards(panorama(), (0, 1, 0))[1] == pytest.approx(30 / 255)


@pytest.mark.parametrize(
    ("up", "front", "right"),
    [
        ((0, -1, 0), (0, 0, 1), (1, 0, 0)),
        ((0, 2, 0), (0, 0, 1), (-1, 0, 0)),
        ((0, 0, 1), (1, 0, 0), (0, -1, 0)),
        ((0, 0, -1), (1, 0, 0), (0, 1, 0)),
        ((1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ],
)
def test_a_panorama_by_other_axes(up, front, right):
    picture = replace(panorama(), up=up)
    assert colour_towards(picture, front)[0] == pytest.approx(35 / 255, abs=1e-6)
    assert colour_towards(picture, right)[0] == pytest.approx(55 / 255, abs=1e-6)
    assert colour_towards(picture, np.add(front, up))[1] < 10 / 255


def test_the_sides_of_a_panorama_meet_without_a_seam():
    ramp = np.abs(np.linspace(-1, 1, 256, endpoint=False))  # goes round: black in front, white behind
    pixels = np.repeat((ramp * 255).astype(np.uint8)[None, :, None], 128, axis=0).repeat(3, axis=2)
    behind = look_at((0, 0, 0), (0, 0, -1), up=(0, -1, 0), width=200, height=20, fov_y=8)
    row = background_colours(Panorama(pixels=pixels), behind)[10, :, 0]
    assert row.min() > 0.7
    assert np.abs(np.diff(row)).max() < 2 / 255


def test_float32_is_float64_to_a_grey_level_of_a_hard_picture(rng):
    noise = Panorama(pixels=rng.integers(0, 256, (512, 1024, 3), dtype=np.uint8))
    camera = look_at((0, 0, 0), (1, -2, -1), up=(0, -1, 0.3), width=160, height=90, fov_y=80)
    error = np.abs(background_colours(noise, camera, np.float32) - background_colours(noise, camera))
    assert error.max() < 1e-3  # rounding moves a ray by up to 1e-6 of a turn: 1e-3 of this picture's pixels


def test_pixels_of_all_cameras_look_where_points_are_seen():
    pinhole = look_at((1, 2, 3), (0, 0, 0), width=40, height=30, fov_y=70)
    fisheye = replace(pinhole, lens=Lens(model="OPENCV_FISHEYE", parameters=(0.1, -0.05, 0.02, 0.0)))
    parallel = replace(pinhole, orthographic=True)
    sky = Gradient(top=BLUE, bottom=BROWN)
    for camera in (pinhole, fisheye):
        point = camera.R_camera_world.T @ camera.points_at((7.5, 21.5), 2.0)
        assert background_colours(sky, camera)[21, 7] == pytest.approx(
            colour_towards(sky, tuple(point)), abs=1e-7
        )
    assert not np.allclose(
        background_colours(sky, pinhole)[0, 0], background_colours(sky, fisheye)[0, 0], atol=1e-3
    )
    assert np.ptp(background_colours(sky, parallel).reshape(-1, 3), axis=0).max() == 0
    assert background_colours(sky, parallel)[0, 0] == pytest.approx(
        colour_towards(sky, tuple(pinhole.forward))
    )


def test_where_a_lens_shows_nothing_it_is_black():
    camera = look_at((0, 0, 0), (0, 0, 1), width=60, height=40, fov_y=100)
    camera = replace(camera, lens=Lens(model="FOV", parameters=(1.2,)))
    for background in (Gradient(top=BLUE, bottom=BROWN), replace(panorama(), pixels=panorama().pixels + 1)):
        picture = background_colours(background, camera)
        nothing = ~np.isfinite(camera.points_at(np.mgrid[:40, :60][::-1].transpose(1, 2, 0) + 0.5, 1)).all(
            axis=2
        )
        assert 0 < nothing.sum() < nothing.size
        assert (picture[nothing] == 0).all()
        assert (picture[~nothing].max(axis=1) > 0).all()


def test_light_that_comes_through_is_the_backgrounds(random_gaussians):
    camera = look_at((0, 0, -3), (0, 0, 0), width=37, height=23)
    scene = random_gaussians(20)
    for background in (Gradient(top=BLUE, bottom=BROWN), panorama(64, 32)):
        image = reference.render(scene, camera, RenderSettings(background=background))
        black = reference.render(scene, camera, RenderSettings())
        expected = black[..., :3] + (1 - black[..., 3:]) * background_colours(background, camera)
        np.testing.assert_allclose(image[..., :3], expected, atol=1e-15)
        np.testing.assert_array_equal(image[..., 3], black[..., 3])
        composite_over(black, background, camera)
        np.testing.assert_allclose(black, image, atol=1e-15)


def test_pictures_are_read_and_made_smaller(tmp_path):
    from PIL import Image

    Image.new("RGBA", (8, 4), (200, 100, 50, 128)).save(tmp_path / "half.png")
    assert load_panorama(tmp_path / "half.png").pixels[0, 0].tolist() == [100, 50, 25]
    Image.new("L", (2 * LARGEST_SIDE, 10), 7).save(tmp_path / "wide.png")
    assert load_panorama(tmp_path / "wide.png").pixels.shape == (5, LARGEST_SIDE, 3)
    assert (load_panorama(tmp_path / "wide.png").pixels == 7).all()


def test_pictures_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(InputError, match=r"sky\.jpg: no such picture"):
        load_panorama(tmp_path / "sky.jpg")
    (tmp_path / "text.jpg").write_text("no picture")
    with pytest.raises(InputError, match=r"text\.jpg: is no picture that can be read \(cannot identify"):
        load_panorama(tmp_path / "text.jpg")
    with pytest.raises(InputError, match="is a folder"):
        load_panorama(tmp_path)


def test_a_short_file_cannot_claim_all_memory(tmp_path):
    """A damaged header: 64 million rows that are not there."""
    from PIL import Image

    Image.new("RGB", (8, 8), (9, 9, 9)).save(tmp_path / "sky.bmp")
    data = bytearray((tmp_path / "sky.bmp").read_bytes())
    data[22:26] = (8 << 20).to_bytes(4, "little")
    (tmp_path / "sky.bmp").write_bytes(data)
    with pytest.raises(InputError, match=r"sky\.bmp: says it has 8x8388608 pixels, more than so short"):
        load_panorama(tmp_path / "sky.bmp")


def test_what_compresses_best_is_not_refused(tmp_path):
    from PIL import Image

    Image.new("RGB", (4000, 2000), (90, 120, 200)).save(tmp_path / "blue.png", compress_level=9)
    assert load_panorama(tmp_path / "blue.png").pixels.shape == (2000, 4000, 3)


def test_a_background_knows_its_camera():
    camera = Camera(width=3, height=2, fx=1, fy=1, cx=0, cy=0, world_to_camera=np.eye(4))
    assert background_colours((0.1, 0.2, 0.3), camera).tolist() == [0.1, 0.2, 0.3]
    assert background_colours(panorama(), camera, np.float32).shape == (2, 3, 3)
