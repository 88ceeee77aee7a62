"""NeRF-synthetic, nerfstudio and instant-ngp captures, and the 3DGS trainer's list of cameras."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from splatview.scene import Gaussians, InputError
from splatview.scene.captures import load_capture
from splatview.scene.formats import save_scene
from splatview.scene.sh import rgb_to_sh

INTRINSICS = {"w": 40, "h": 30, "fl_x": 36.2, "fl_y": 36.3, "cx": 19.5, "cy": 15.5}


@pytest.fixture
def frames(cameras_of, to_opengl):
    return [
        {"file_path": f"images/{i}.png", "transform_matrix": to_opengl(camera)}
        for i, camera in enumerate(cameras_of(9))
    ]


@pytest.fixture
def photos(tmp_path, png, pixels_of):
    for i in range(9):
        png(tmp_path / f"images/{i}.png", pixels_of(i))


def test_photos_one_folder_deeper_are_told(tmp_path, png, pixels_of, frames, transforms):
    """A render's passes may each have a folder of photos by the same names: none is taken."""
    for i in range(9):
        png(tmp_path / f"rgb/train/r_{i}.png", pixels_of(i))
    listed = [frame | {"file_path": f"./train/r_{i}"} for i, frame in enumerate(frames)]
    transforms(tmp_path / "transforms_train.json", listed, **INTRINSICS)
    with pytest.raises(InputError) as caught:
        load_capture(tmp_path)
    assert f"{tmp_path / 'rgb'} has one of that name: move what is in it there" in str(caught.value)


def test_nerf_synthetic(tmp_path, png, pixels_of, cameras_of, transforms, to_opengl):
    cameras = cameras_of(6)
    for part, chosen in (("train", cameras[:4]), ("test", cameras[4:]), ("val", cameras)):
        listed = []
        for i, camera in enumerate(chosen):
            png(tmp_path / part / f"r_{i}.png", pixels_of(i, channels=4))
            listed.append({"file_path": f"./{part}/r_{i}", "transform_matrix": to_opengl(camera)})
        transforms(tmp_path / f"transforms_{part}.json", listed, camera_angle_x=0.7)
    capture = load_capture(tmp_path, background=(1.0, 0.5, 0.0))
    assert [photo.name for photo in capture.train] == [f"train/r_{i}" for i in range(4)]
    assert [photo.name for photo in capture.held_out] == ["test/r_0", "test/r_1"]
    assert capture.background == (1.0, 0.5, 0.0)
    photo = capture.train[2]
    np.testing.assert_allclose(photo.camera.world_to_camera, cameras[2].world_to_camera, atol=1e-12)
    assert photo.camera.fx == photo.camera.fy == pytest.approx(20 / math.tan(0.35))
    assert (photo.camera.cx, photo.camera.cy) == (20, 15)
    rgba = pixels_of(2, channels=4).astype(float)
    alpha = rgba[..., 3:] / 255
    over = rgba[..., :3] * alpha + np.array([255, 127.5, 0]) * (1 - alpha)
    assert np.abs(photo.image() - over).max() <= 0.51


@pytest.mark.parametrize("held_out", [9, 3])
def test_photos_that_are_held_out_and_trained_on_are_trained_on(
    tmp_path, photos, frames, transforms, png, pixels_of, cameras_of, to_opengl, held_out
):
    """All that is held out, so that the usual split decides, or some; others from the same place stay."""
    transforms(tmp_path / "transforms_train.json", frames, **INTRINSICS)
    listed = []
    for i, camera in enumerate(cameras_of(9)[:held_out]):
        png(tmp_path / f"test/{i}.png", pixels_of(i))
        listed.append({"file_path": f"test/{i}.png", "transform_matrix": to_opengl(camera)})
    if held_out == 3:
        png(tmp_path / "test/later.png", pixels_of(20))
        listed.append({"file_path": "test/later.png", "transform_matrix": to_opengl(cameras_of(9)[0])})
    transforms(tmp_path / "transforms_test.json", listed, **INTRINSICS)
    capture = load_capture(tmp_path)
    (warning,) = [line for line in capture.warnings if "duplicates" in line]
    assert (
        warning.startswith(f"{held_out} photos are duplicates of others, with their pose")
        and "test/0" in warning
    )
    by_rule = ["images/0.png", "images/8.png"]
    assert [photo.name for photo in capture.held_out] == (["test/later.png"] if held_out == 3 else by_rule)
    assert len(capture.train) == (9 if held_out == 3 else 7)


def test_opaque_photos_need_no_background(tmp_path, frames, png, transforms, pixels_of):
    for i in range(9):
        rgba = pixels_of(i, channels=4)
        rgba[..., 3] = 255
        png(tmp_path / f"images/{i}.png", rgba)
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    capture = load_capture(tmp_path)
    assert capture.background is None
    np.testing.assert_array_equal(capture.photos[3].image(), pixels_of(3, channels=4)[..., :3])


def test_nerfstudio(tmp_path, frames, photos, transforms, cameras_of, rng):
    frames[3] |= {"fl_x": 50.0, "cx": 21.0}
    positions, colours = rng.normal(size=(7, 3)), rng.uniform(size=(7, 3))
    cloud = Gaussians(
        means=positions.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (7, 1)),
        log_scales=np.zeros((7, 3), np.float32),
        opacity_logits=np.zeros(7, np.float32),
        sh=rgb_to_sh(colours).astype(np.float32)[:, None],
    )
    save_scene(cloud, tmp_path / "points.ply")
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS, ply_file_path="points.ply", k1=0.0)
    capture = load_capture(tmp_path)
    assert capture.warnings == ()
    assert [photo.name for photo in capture.held_out] == ["images/0.png", "images/8.png"]
    for photo, camera in zip(capture.photos, cameras_of(9), strict=True):
        np.testing.assert_allclose(photo.camera.world_to_camera, camera.world_to_camera, atol=1e-12)
        assert photo.mask() is None
    assert (capture.photos[2].camera.fx, capture.photos[2].camera.cx) == (36.2, 19.5)
    assert (capture.photos[3].camera.fx, capture.photos[3].camera.cx) == (50.0, 21.0)
    np.testing.assert_allclose(capture.points, positions, atol=1e-6)
    assert np.abs(capture.point_colours - colours * 255).max() <= 0.51


@pytest.mark.parametrize("key", ["K", "intrinsics", "intrinsic_matrix"])
@pytest.mark.parametrize("size", [3, 4])
def test_intrinsics_as_a_matrix(tmp_path, frames, photos, transforms, key, size):
    """As programs of research write them: of each frame, or of all."""
    own = np.eye(size)
    own[:2, :3] = (50.0, 0, 21.0), (0, 51.0, 16.0)
    shared = own + 0
    shared[:2, :3] = (36.2, 0, 19.5), (0, 36.3, 15.5)
    frames[3] |= {key: own.tolist()}
    transforms(tmp_path / "transforms.json", frames, w=40, h=30, **{key: shared.tolist()})
    for i, values in ((2, (36.2, 36.3, 19.5, 15.5)), (3, (50.0, 51.0, 21.0, 16.0))):
        camera = load_capture(tmp_path).photos[i].camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == values
    transforms(tmp_path / "transforms.json", frames, w=40, h=30, fl_x=36.0, **{key: shared.tolist()})
    camera = load_capture(tmp_path).photos[3].camera
    assert (camera.fx, camera.cx) == (36.0, 20.0), "a matrix is for want of a focal length"


def test_point_cloud_with_byte_colours(tmp_path, frames, photos, transforms):
    lines = ["ply", "format ascii 1.0", "element vertex 5"]
    lines += [f"property float {name}" for name in "xyz"]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines += ["end_header", *(f"{i} 1 2 {i * 50} 0 255" for i in range(5))]
    (tmp_path / "sparse_pc.ply").write_text("\n".join(lines) + "\n")
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    capture = load_capture(tmp_path)
    np.testing.assert_array_equal(capture.points, [(i, 1, 2) for i in range(5)])
    np.testing.assert_array_equal(capture.point_colours, [(i * 50, 0, 255) for i in range(5)])


@pytest.mark.parametrize(
    "lens",
    [
        {"k1": 0.2, "k2": 0.02, "p1": 0.01, "p2": 0.01},
        {"camera_model": "OPENCV", "k1": 0.2, "k3": 0.01},
        {"camera_model": "OPENCV_FISHEYE", "k1": 0.01, "k4": 0.001},
        {"is_fisheye": True, "k1": 0.4},
    ],
)
def test_distortion_changes_the_photos(tmp_path, frames, photos, transforms, pixels_of, lens):
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS, **lens)
    image = load_capture(tmp_path, lens="undistort").photos[0].image()
    assert not np.array_equal(image, pixels_of(0))


FISHEYE = {"k1": 0.05, "k2": -0.02, "k3": 0.01, "k4": -0.003}
BROWN = {"k1": 0.08, "k2": -0.05, "k3": 0.03, "k4": -0.02, "p1": 0.01, "p2": -0.02}


@pytest.mark.parametrize(
    ("lens", "is_fisheye"),
    [
        ({"camera_model": "OPENCV_FISHEYE", **FISHEYE}, True),
        ({"is_fisheye": True, **FISHEYE}, True),
        ({"camera_model": "OPENCV", **BROWN}, False),
        (BROWN, False),
    ],
)
def test_every_coefficient_has_its_place(tmp_path, frames, png, transforms, lens, is_fisheye):
    """The undistorted photo shows at each pixel what the lens had put elsewhere, by the formulas."""
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    places = np.stack([x * 6, y * 8, np.zeros_like(x)], axis=-1).astype(np.uint8)
    for i in range(9):
        png(tmp_path / f"images/{i}.png", places)
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS, **lens)
    photo = load_capture(tmp_path, lens="undistort").photos[1]
    u, v = (x - 19.5) / 36.2, (y - 15.5) / 36.3
    r = np.hypot(u, v)
    angle = np.arctan(r) if is_fisheye else r
    radial = 1 + sum(lens[f"k{i}"] * angle ** (2 * i) for i in range(1, 5))
    radial *= angle / np.maximum(r, 1e-12)
    p1, p2 = lens.get("p1", 0.0), lens.get("p2", 0.0)
    seen_x = 36.2 * (u * radial + 2 * p1 * u * v + p2 * (r * r + 2 * u * u)) + 19.5
    seen_y = 36.3 * (v * radial + 2 * p2 * u * v + p1 * (r * r + 2 * v * v)) + 15.5
    mask = photo.mask()
    used = np.ones_like(x, bool) if mask is None else mask
    assert used.mean() > 0.7
    # Levels are rounded when stored and again when read: 1.5 levels are a fifth of a pixel.
    np.testing.assert_allclose(photo.image()[used][:, 0], seen_x[used] * 6, atol=1.5)
    np.testing.assert_allclose(photo.image()[used][:, 1], seen_y[used] * 8, atol=1.5)
    assert np.abs(seen_x - x).max() > 0.5


def test_size_and_focal_length_where_the_file_does_not_say(tmp_path, frames, photos, transforms):
    transforms(tmp_path / "transforms.json", frames, camera_angle_x=0.8, camera_angle_y=0.6)
    camera = load_capture(tmp_path).photos[0].camera
    assert (camera.width, camera.height) == (40, 30)
    assert camera.fx == pytest.approx(20 / math.tan(0.4))
    assert camera.fy == pytest.approx(15 / math.tan(0.3))


def test_resized_poses(tmp_path, frames, photos, transforms, cameras_of):
    for frame in frames:
        frame["transform_matrix"] = (np.array(frame["transform_matrix"])[:3] * ([[0.25] * 3 + [1]])).tolist()
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    for photo, camera in zip(load_capture(tmp_path).photos, cameras_of(9), strict=True):
        np.testing.assert_allclose(photo.camera.world_to_camera, camera.world_to_camera, atol=1e-12)


def test_held_out_by_list(tmp_path, frames, photos, transforms):
    names = [frame["file_path"] for frame in frames]
    transforms(
        tmp_path / "transforms.json",
        frames,
        **INTRINSICS,
        train_filenames=names[:7],
        test_filenames=names[7:],
    )
    assert [photo.name for photo in load_capture(tmp_path).held_out] == names[7:]


def test_masks_by_path_and_by_folder(tmp_path, frames, photos, transforms, png):
    black_top = np.repeat(np.array([0, 255], np.uint8), 15 * 40).reshape(30, 40)
    png(tmp_path / "other/m.png", black_top)
    png(tmp_path / "masks/2.png", black_top)
    frames[1]["mask_path"] = "other/m.png"
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    photos_read = load_capture(tmp_path).photos
    for i in (1, 2):
        mask = photos_read[i].mask()
        assert mask is not None
        np.testing.assert_array_equal(mask, black_top > 0)
    assert photos_read[0].mask() is None


def test_the_3dgs_trainers_list(tmp_path, cameras_of, png, pixels_of):
    entries = []
    for i, camera in enumerate(cameras_of(5)):
        png(tmp_path / f"images/v{i}.png", pixels_of(i))
        entries.append(
            {
                "id": i,
                "img_name": f"v{i}",
                "width": 40,
                "height": 30,
                "position": camera.eye.tolist(),
                "rotation": camera.R_camera_world.T.tolist(),
                "fx": camera.fx,
                "fy": camera.fy,
            }
        )
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    capture = load_capture(tmp_path)
    assert [photo.name for photo in capture.photos] == [f"v{i}" for i in range(5)]
    for i, (photo, camera) in enumerate(zip(capture.photos, cameras_of(5), strict=True)):
        np.testing.assert_allclose(photo.camera.world_to_camera, camera.world_to_camera, atol=1e-9)
        np.testing.assert_array_equal(photo.image(), pixels_of(i))


def test_missing_photos_are_named(tmp_path, frames, photos, transforms):
    (tmp_path / "images/4.png").unlink()
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 8
    assert f"1 of 9 photos are not in {tmp_path} and are left out: images/4.png" in capture.warnings


@pytest.mark.parametrize(
    "named",
    [
        "/home/somebody/work/scene/images/{}.png",
        "C:\\Users\\somebody\\scene\\images\\{}.png",
        "../somewhere/{}.png",
        "{}.png",
        "./moved/here/{}",
    ],
)
def test_photos_named_from_where_they_no_longer_are(tmp_path, frames, photos, transforms, pixels_of, named):
    for i, frame in enumerate(frames):
        frame["file_path"] = named.format(i)
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS, test_filenames=[named.format(3)])
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 9
    assert [photo.name.removesuffix(".png")[-1] for photo in capture.held_out] == ["3"]
    np.testing.assert_array_equal(capture.photos[5].image(), pixels_of(5))


def test_masks_of_photos_named_so(tmp_path, frames, photos, transforms, png):
    for i, frame in enumerate(frames):
        png(tmp_path / f"masks/{i}.png", np.full((30, 40), 255 if i != 4 else 0, np.uint8))
        frame["file_path"] = f"/home/somebody/scene/images/{i}.png"
        if i == 4:
            frame["mask_path"] = f"/home/somebody/scene/masks/{i}.png"
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    capture = load_capture(tmp_path)
    assert [photo.name for photo in capture.photos] == [f"images/{i}.png" for i in range(9) if i != 4]
    assert capture.statistics.masks == 9


@pytest.mark.parametrize(
    "named", ["clouds/points.ply", "/home/somebody/scene/clouds/points.ply", "points.ply"]
)
def test_points_of_photos_named_so(tmp_path, frames, photos, transforms, named):
    lines = ["ply", "format ascii 1.0", "element vertex 5"]
    lines += [f"property float {name}" for name in "xyz"]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    there = tmp_path / ("clouds/points.ply" if "clouds" in named else named)
    there.parent.mkdir(exist_ok=True)
    there.write_text("\n".join([*lines, "end_header", *(f"{i} 1 2 9 0 255" for i in range(5))]) + "\n")
    for i, frame in enumerate(frames):
        frame["file_path"] = f"/home/somebody/scene/images/{i}.png"
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS, ply_file_path=named)
    capture = load_capture(tmp_path)
    assert capture.warnings == () and len(capture.points) == 5


@pytest.mark.parametrize("named", ["masks/{}.png", "/home/somebody/scene/cut/{}.png", "{}.png"])
def test_masks_of_photos_in_another_folder(tmp_path, frames, photos, transforms, png, named):
    """The photos are in images, where no name leads; masks are named from the capture, or by what is gone."""
    for i, frame in enumerate(frames):
        png(tmp_path / f"masks/{i}.png", np.full((30, 40), 255 if i != 4 else 0, np.uint8))
        frame |= {"file_path": f"/data/{i}.png", "mask_path": named.format(i)}
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    capture = load_capture(tmp_path)
    assert [photo.name for photo in capture.photos] == [f"{i}.png" for i in range(9) if i != 4]
    frames[2]["file_path"] = "images/2.png"
    frames[2]["mask_path"] = "masks/none.png"
    transforms(tmp_path / "transforms.json", frames[2:3] * 2, **INTRINSICS)
    with pytest.raises(InputError, match=r"the mask .*none\.png.* is not in"):
        load_capture(tmp_path)


def test_one_photo_for_two_frames_is_none(tmp_path, frames, photos, transforms):
    """Names that only their folders tell apart are not cut to what they have in common."""
    for i, frame in enumerate(frames):
        frame["file_path"] = f"/home/somebody/{'ab'[i % 2]}/{i // 2}.png"
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    with pytest.raises(InputError, match="none of its 9 photos is in"):
        load_capture(tmp_path)


def test_photos_that_are_where_they_say_come_first(tmp_path, frames, photos, transforms, png, pixels_of):
    png(tmp_path / "0.png", pixels_of(77))
    frames[1]["file_path"] = "/home/somebody/scene/images/1.png"
    transforms(tmp_path / "transforms.json", frames, **INTRINSICS)
    capture = load_capture(tmp_path)
    assert any("1 of 9 photos are not in" in warning for warning in capture.warnings)
    np.testing.assert_array_equal(capture.photos[0].image(), pixels_of(0))
