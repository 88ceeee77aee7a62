"""What is wrong with a capture is said in one line that names the file."""

from __future__ import annotations

import json
import subprocess
import tracemalloc
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from splatview.scene import InputError, look_at
from splatview.scene.captures import load_capture
from splatview.scene.captures.photos import _decode
from splatview.scene.formats.panorama import load_panorama


def refused(path: Path, **options) -> str:
    with pytest.raises(InputError) as caught:
        load_capture(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_no_capture(tmp_path):
    assert "no such folder" in refused(tmp_path / "none")
    assert "holds no capture" in refused(tmp_path)
    (tmp_path / "a.txt").write_text("")
    assert "name its folder" in refused(tmp_path / "a.txt")


def test_a_model_whose_poses_were_not_copied(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    (poses,) = tmp_path.rglob("images.bin")
    poses.unlink()
    assert f"{poses.parent}: lacks images.bin or images.txt" in refused(tmp_path)


def test_no_images_in_the_model(tmp_path, colmap_capture):
    colmap_capture(tmp_path, cameras=[])
    assert "holds no images" in refused(tmp_path)


def test_poses_without_photos(tmp_path, colmap_capture):
    colmap_capture(tmp_path, photos=False)
    message = refused(tmp_path)
    assert "none of its 9 photos is in" in message
    assert "p00.png" in message


def test_one_photo(tmp_path, colmap_capture, cameras_of):
    colmap_capture(tmp_path, cameras=cameras_of(1))
    assert "only one photo (p00.png)" in refused(tmp_path)


def test_another_size(tmp_path, colmap_capture, png, pixels_of):
    colmap_capture(tmp_path)
    png(tmp_path / "images/p03.png", pixels_of(0, 41, 30))
    message = refused(tmp_path)
    assert "p03.png: is 41x30 pixels, but its camera says 40x30" in message


def test_mask_of_another_shape(tmp_path, colmap_capture, png):
    colmap_capture(tmp_path)
    png(tmp_path / "masks/p03.png", np.zeros((20, 20), np.uint8))
    assert "masks/p03.png: is 20x20" in refused(tmp_path)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF")
@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tiff"])
@pytest.mark.parametrize("keep", [0, 3, 40, 0.6])
def test_photos_cut_short(tmp_path, colmap_capture, cameras_of, pixels_of, suffix, keep):
    names = [f"p{i}.{suffix}" for i in range(3)]
    colmap_capture(tmp_path, cameras=cameras_of(3), names=names)
    path = tmp_path / "images" / names[1]
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * keep) if isinstance(keep, float) else keep])
    assert names[1] in refused(tmp_path)


def test_photo_that_is_a_folder_or_text(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    (tmp_path / "images/p02.png").write_text("<html>not found</html>")
    assert "p02.png: is no readable image" in refused(tmp_path)


def test_enormous_photo(tmp_path, colmap_capture, monkeypatch):
    colmap_capture(tmp_path)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    assert "is no readable image" in refused(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("text", [False, True])
def test_poses_that_are_not_finite(tmp_path, colmap_capture, cameras_of, value, text):
    colmap_capture(tmp_path, text=text)
    path = tmp_path / "sparse/0" / ("images.txt" if text else "images.bin")
    raw = path.read_bytes()
    if text:
        lines = raw.decode().split("\n")
        words = lines[3].split()
        lines[3] = " ".join([*words[:6], str(value), *words[7:]])
        path.write_text("\n".join(lines))
    else:
        path.write_bytes(raw[: 8 + 4 + 32] + np.float64(value).tobytes() + raw[8 + 4 + 40 :])
    assert "images" in refused(tmp_path)


@pytest.mark.parametrize("downscale", [0, -1, 1.5, float("nan")])
def test_downscale(tmp_path, downscale):
    with pytest.raises(InputError, match="downscaled by a whole number"):
        load_capture(tmp_path, downscale=downscale)


def test_downscaled_to_nothing(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    assert "nothing is left" in refused(tmp_path, downscale=31)


def test_all_held_out(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    (tmp_path / "sparse/0/test.txt").write_text("\n".join(f"p{i:02d}.png" for i in range(9)))
    assert "all photos are held out" in refused(tmp_path)


def test_a_list_of_photos_that_is_none(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    with open(tmp_path / "sparse/0/test.txt", "wb") as file:
        file.truncate(1 << 40)  # sparse
    assert "test.txt: is too large for a list of photos" in refused(tmp_path)


@pytest.fixture
def good(tmp_path, cameras_of, to_opengl, png, pixels_of) -> dict:
    frames = []
    for i, camera in enumerate(cameras_of(3)):
        png(tmp_path / f"{i}.png", pixels_of(i))
        frames.append({"file_path": f"{i}.png", "transform_matrix": to_opengl(camera)})
    return {"w": 40, "h": 30, "fl_x": 36.0, "frames": frames}


def nan_pose(content: dict) -> None:
    content["frames"][1]["transform_matrix"][0][3] = float("nan")


def mirror(content: dict) -> None:
    content["frames"][1]["transform_matrix"][0] = [-x for x in content["frames"][1]["transform_matrix"][0]]


def set_top(key: str, value) -> Callable[[dict], None]:
    return lambda content: content.update({key: value})


def set_frame(key: str, value) -> Callable[[dict], None]:
    return lambda content: content["frames"][1].update({key: value})


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (nan_pose, "frame 1"),
        (mirror, "frame 1"),
        (lambda content: content.pop("frames"), "the list 'frames' is missing"),
        (lambda content: content.pop("fl_x"), "focal length is unknown"),
        (set_top("frames", []), "names no photos"),
        (set_top("frames", [3]), "frame 0"),
        (set_top("fl_x", "36"), "'fl_x' must be a number"),
        (set_top("fl_x", -3), "fx must be positive"),
        (set_top("fl_x", 0), "fx must be positive"),
        (set_top("w", 40.5), "whole number of pixels"),
        (set_top("w", 41), "its camera says 41x30"),
        (set_top("camera_model", "EQUIRECTANGULAR"), "is 40x30 pixels, but a panorama that goes all the way"),
        (set_top("camera_model", "THIN_PRISM_FISHEYE"), "undistort the photos"),
        (set_top("k1", float("nan")), "distortion must be finite"),
        (set_top("k4", "0.1"), "'k4' must be a number"),
        (set_top("camera_model", "equirectangular"), "cut it into views of a pinhole camera"),
        (set_top("camera_model", "thin_prism"), "lenses of the kind 'THIN_PRISM' cannot be used"),
        (set_top("test_filenames", "all"), "list of file names"),
        (set_frame("transform_matrix", [[1, 0], [0, 1]]), "'transform_matrix' must be 4 x 4"),
        (set_frame("transform_matrix", None), "'transform_matrix' must be 4 x 4"),
        (set_frame("mask_path", "none.png"), "mask 'none.png' is not in"),
        (set_frame("fl_x", None), "'fl_x' must be a number"),
    ],
)
def test_transforms(tmp_path, good, damage, message):
    assert load_fine(tmp_path, good)
    damage(good)
    (tmp_path / "transforms.json").write_text(json.dumps(good))
    assert message in refused(tmp_path)


def load_fine(folder: Path, content: dict) -> bool:
    (folder / "transforms.json").write_text(json.dumps(content))
    return len(load_capture(folder).photos) == 3


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ([[36, 0, 20], [0, 36, 15]], "'K' must be 3 x 3"),
        ([36, 0, 20, 0, 36, 15, 0, 0, 1], "'K' must be 3 x 3"),
        ([[36, 5, 20], [0, 36, 15], [0, 0, 1]], "must be a matrix [[fx, 0, cx]"),
        ([[36, 0, 0], [0, 36, 0], [20, 15, 1]], "must be a matrix [[fx, 0, cx]"),
        ([[36, 0, float("nan")], [0, 36, 15], [0, 0, 1]], "frame 0"),
        ([[-36, 0, 20], [0, 36, 15], [0, 0, 1]], "frame 0"),
        ("36", "'K' must be 3 x 3"),
    ],
)
def test_intrinsics_as_a_matrix(tmp_path, good, matrix, message):
    del good["fl_x"]
    good["K"] = matrix
    (tmp_path / "transforms.json").write_text(json.dumps(good))
    assert message in refused(tmp_path)


def test_angle_of_view(tmp_path, good):
    del good["fl_x"]
    good["camera_angle_x"] = 45
    (tmp_path / "transforms.json").write_text(json.dumps(good))
    assert "radians" in refused(tmp_path)


def test_json_cut_short(tmp_path, good):
    text = json.dumps(good)
    for size in range(0, len(text), 60):
        (tmp_path / "transforms.json").write_text(text[:size])
        assert "transforms.json" in refused(tmp_path)


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "points3D.bin"])
def test_binary_models_cut_short_anywhere(tmp_path, colmap_capture, cameras_of, file):
    colmap_capture(tmp_path, cameras=cameras_of(2), points=np.ones((5, 3)))
    path = tmp_path / "sparse/0" / file
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        message = refused(tmp_path)
        assert f"{file}: is truncated" in message or (size < 8 and file in message), (size, message)


@pytest.mark.parametrize("file", ["cameras.txt", "images.txt", "points3D.txt"])
def test_text_models_cut_short_anywhere(tmp_path, colmap_capture, cameras_of, file):
    """Text cut between lines is whole text, and a number cut in the middle is a number: either it loads, with
    what there is, or one line says what is wrong."""
    colmap_capture(tmp_path, cameras=cameras_of(3), points=np.full((5, 3), 1.25), text=True)
    path = tmp_path / "sparse/0" / file
    whole = path.read_bytes()
    refusals = 0
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        try:
            capture = load_capture(tmp_path)
        except InputError as error:
            assert "\n" not in str(error) and str(tmp_path) in str(error)
            refusals += 1
        else:
            assert len(capture.photos) >= 2
            assert np.isfinite(capture.points).all() and len(capture.points) >= 4
    assert refusals > len(whole) / 4


def test_masks_that_hide_all_of_a_photo(tmp_path, colmap_capture, png):
    colmap_capture(tmp_path)
    png(tmp_path / "masks/p03.png", np.zeros((30, 40), np.uint8))
    capture = load_capture(tmp_path)
    assert [photo.name for photo in capture.photos] == [f"p{i:02d}.png" for i in range(9) if i != 3]
    assert "1 photos are left out, for their masks hide all of them: p03.png" in capture.warnings
    for i in range(9):
        png(tmp_path / f"masks/p{i:02d}.png", np.zeros((30, 40), np.uint8))
    assert "masks leave nothing" in refused(tmp_path)
    assert len(load_capture(tmp_path, masks="cut-out").photos) == 9, "photos of nothing at all are photos"


def test_photos_that_no_mask_cuts_out(tmp_path, colmap_capture, png):
    colmap_capture(tmp_path)
    with pytest.raises(InputError, match="none of its photos has a mask to be cut out by, nor is one"):
        load_capture(tmp_path, masks="cut-out")
    white = np.full((30, 40), 255, np.uint8)
    png(tmp_path / "masks/p03.png", white)
    with pytest.raises(InputError, match=r"only one photo \(p03\.png\) is left to learn from"):
        load_capture(tmp_path, masks="cut-out")
    half = np.where(np.arange(40) < 20, white, 0)
    transparent = np.dstack([np.full((30, 40, 3), 128, np.uint8), half])
    png(tmp_path / "images/p04.png", transparent.astype(np.uint8))
    png(tmp_path / "masks/p05.png", half)
    capture = load_capture(tmp_path, masks="cut-out")
    assert [photo.name for photo in capture.photos] == ["p03.png", "p04.png", "p05.png"]
    (warning,) = (one for one in capture.warnings if "mask" in one)
    assert warning.startswith("6 photos are left out, for they have no mask to be cut out by: p00.png, p01")
    assert capture.statistics.cut_out and capture.statistics.masks == 2
    assert len(load_capture(tmp_path).photos) == 9, "where masks are to be ignored, nothing is left out"
    png(tmp_path / "masks/p00.png", white)
    for name in ("masks/p03.png", "masks/p05.png"):
        (tmp_path / name).unlink()
    png(tmp_path / "images/p04.png", np.full((30, 40, 3), 128, np.uint8))
    assert "masks leave nothing of the photos to train on: p01.png" in refused(tmp_path, masks="cut-out")


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    file=st.sampled_from(["cameras.bin", "images.bin", "points3D.bin"]),
    at=st.integers(0, 2000),
    value=st.integers(0, 255),
)
def test_damaged_models_load_or_are_refused(tmp_path, colmap_capture, file, at, value):
    if not (tmp_path / "sparse").exists():
        colmap_capture(tmp_path)
    path = tmp_path / "sparse/0" / file
    whole = path.read_bytes()
    path.write_bytes(whole[: at % len(whole)] + bytes([value]) + whole[at % len(whole) + 1 :])
    try:
        assert len(load_capture(tmp_path).photos) >= 2
    except InputError as error:
        assert "\n" not in str(error)
    finally:
        path.write_bytes(whole)


ODD = [
    None,
    True,
    -1,
    0,
    2.5,
    1e300,
    10**400,
    float("nan"),
    float("inf"),
    "",
    "x",
    "\0",
    "../..",
    [],
    [[]],
    {},
]
"""What has no business in most places of a capture's JSON."""


def places(value, at=()) -> list[tuple]:
    """The paths to every value in a tree of JSON, the root left out."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [found for key, child in inside for found in ((*at, key), *places(child, (*at, key)))]


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), value=st.sampled_from(ODD))
@pytest.mark.parametrize("name", ["transforms.json", "cameras.json"])
def test_odd_values_in_json_load_or_are_refused(tmp_path, good, name, data, value):
    good |= {"h": 30, "cx": 20.0, "cy": 15.0, "k1": 0.01, "p1": 0.001, "camera_model": "OPENCV"}
    good |= {"ply_file_path": "points.ply", "test_filenames": ["0.png"]}
    content = good
    if name == "cameras.json":
        content = [
            {
                "id": i,
                "img_name": f"{i}.png",
                "width": 40,
                "height": 30,
                "position": [0.0, 0.0, float(i)],
                "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                "fx": 36.0,
                "fy": 36.0,
            }
            for i in range(3)
        ]
    content = json.loads(json.dumps(content))
    *way, key = data.draw(st.sampled_from(places(content)))
    owner = content
    for step in way:
        owner = owner[step]
    owner[key] = value
    (tmp_path / name).write_text(json.dumps(content))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            capture = load_capture(tmp_path / name)
    except InputError as error:
        assert "\n" not in str(error) and str(tmp_path) in str(error)
    else:
        assert len(capture.photos) >= 2
        assert np.isfinite(capture.points).all() and 0 < capture.scene_radius < np.inf


@pytest.mark.parametrize("far", [1e20, 1e300])
def test_a_camera_out_of_the_world(tmp_path, good, far):
    good["frames"][1]["transform_matrix"][0][3] = far
    (tmp_path / "transforms.json").write_text(json.dumps(good))
    assert "look for a pose that is far from the others" in refused(tmp_path)


def test_everything_in_one_place(tmp_path, colmap_capture, cameras_of):
    camera = cameras_of(1)[0]
    colmap_capture(tmp_path, cameras=[camera] * 3, points=np.tile(camera.eye, (5, 1)))
    assert "spread over" in refused(tmp_path)


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 40 30\n%%EndComments\nshowpage\n"


def test_postscript_that_is_called_png_starts_no_interpreter(tmp_path, colmap_capture, monkeypatch):
    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda *args, **options: started.append(args))
    monkeypatch.setattr(subprocess, "check_call", lambda *args, **options: started.append(args))
    colmap_capture(tmp_path)
    (tmp_path / "images/p00.png").write_bytes(POSTSCRIPT)
    assert "is no readable image" in refused(tmp_path)
    panorama = tmp_path / "sky.png"
    panorama.write_bytes(POSTSCRIPT)
    with pytest.raises(InputError, match="is no picture that can be read"):
        load_panorama(panorama)
    assert not started


def test_large_transparent_photos_take_memory_by_rows(tmp_path, colmap_capture, png):
    """The float32 of a whole photo would be 28 bytes per pixel; a bomb of 169 megapixels took 12 GiB."""
    width, height = 1500, 3000
    camera = look_at((0, 0, -4), (0, 0, 0), width=width, height=height)
    colmap_capture(tmp_path, cameras=[camera, camera], photos=False)
    for name in ("p00.png", "p01.png"):
        png(tmp_path / "images" / name, np.full((height, width, 4), (200, 100, 50, 128), np.uint8))
    shot_size = width, height
    tracemalloc.start()
    decoded = _decode(tmp_path / "images/p00.png", shot_size, (0.0, 0.0, 0.0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 13 * width * height, f"{peak / width / height:.1f} bytes per pixel"
    assert decoded.alpha is not None and (decoded.rgb == (100, 50, 25)).all()


def test_float_photos_in_shares_of_white_are_not_black(tmp_path, colmap_capture, cameras_of):
    cameras = cameras_of(2)
    colmap_capture(tmp_path, cameras=cameras, names=["a.tif", "b.tif"], photos=False)
    (tmp_path / "images").mkdir()
    for name, level in (("a.tif", 0.5), ("b.tif", 1.0)):
        pixels = np.full((cameras[0].height, cameras[0].width), level, np.float32)
        Image.fromarray(pixels).save(tmp_path / "images" / name)
    capture = load_capture(tmp_path)
    levels = sorted(int(photo.image()[0, 0, 0]) for photo in (*capture.train, *capture.held_out))
    assert levels == [128, 255]
