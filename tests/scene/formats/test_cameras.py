"""Camera lists: our JSON, the trainer's cameras.json, COLMAP in binary and text."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from splatview.scene import Camera, InputError, Lens, look_at
from splatview.scene.formats import load_cameras, save_camera
from splatview.scene.formats.io import read_json


def some_camera(seed: int = 0) -> Camera:
    rng = np.random.default_rng(seed)
    return look_at(rng.normal(size=3), rng.normal(size=3), up=rng.normal(size=3), width=97, height=53)


def quat_of(R: np.ndarray) -> np.ndarray:
    """wxyz by the eigenvector of Bar-Itzhack's matrix: independent of the reader's formulas."""
    K = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], 0, 0, 0],
            [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0, 0],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], np.trace(R)],
        ]
    )
    return np.linalg.eigh(K / 3)[1][:, -1][[3, 0, 1, 2]]


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_cameras(path)
    assert "\n" not in str(caught.value) and str(path.parent) in str(caught.value)
    return str(caught.value)


# --- our JSON ---------------------------------------------------------------------------------------------


def test_own_json_round_trip(tmp_path):
    camera = some_camera()
    save_camera(camera, tmp_path / "cam.json")
    (loaded,) = load_cameras(tmp_path / "cam.json")
    assert loaded.same_view(camera)
    assert set(json.loads((tmp_path / "cam.json").read_text())) == {
        *("width", "height", "fx", "fy", "cx", "cy", "world_to_camera")
    }
    assert os.listdir(tmp_path) == ["cam.json"]


@pytest.mark.parametrize(
    "change",
    [
        {"lens": Lens(model="OPENCV", parameters=(0.1, -0.2, 0.001, 0.002))},
        {"lens": Lens(model="FOV", parameters=(0.9,))},
        {"orthographic": True},
    ],
)
def test_own_json_keeps_lens_and_parallel_rays(tmp_path, change):
    camera = replace(some_camera(), **change)
    save_camera(camera, tmp_path / "cam.json")
    (loaded,) = load_cameras(tmp_path / "cam.json")
    assert loaded.same_view(camera) and not loaded.same_view(some_camera())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lens": "OPENCV"}, "'lens' must be an object with the keys model, parameters"),
        ({"lens": {"model": "OPENCV", "parameters": [1, 2]}}, "a OPENCV lens has 4 parameters, got 2"),
        ({"lens": {"model": "OPENCV", "parameters": "0,0,0,0"}}, "must be a list of numbers"),
        ({"lens": {"model": "BOTTLE", "parameters": []}}, "unknown lens model 'BOTTLE'"),
        ({"orthographic": 1}, "'orthographic' must be true or false"),
        (
            {"orthographic": True, "lens": {"model": "FOV", "parameters": [0.9]}},
            "an orthographic camera has no lens",
        ),
    ],
)
def test_lenses_that_are_none(tmp_path, change, message):
    save_camera(some_camera(), tmp_path / "cam.json")
    values = {**json.loads((tmp_path / "cam.json").read_text()), **change}
    (tmp_path / "cam.json").write_text(json.dumps(values))
    assert message in refused(tmp_path / "cam.json")


def test_own_json_list(tmp_path):
    entries = []
    for i in range(3):
        save_camera(some_camera(i), tmp_path / "cam.json")
        entries.append(json.loads((tmp_path / "cam.json").read_text()) | {"name": f"view {i}"})
    (tmp_path / "list.json").write_text(json.dumps(entries))
    cameras = load_cameras(tmp_path / "list.json")
    assert all(camera.same_view(some_camera(i)) for i, camera in enumerate(cameras))
    assert [camera.name for camera in cameras] == ["view 0", "view 1", "view 2"]


@pytest.fixture
def entry(tmp_path) -> dict:
    save_camera(some_camera(), tmp_path / "cam.json")
    return json.loads((tmp_path / "cam.json").read_text())


@pytest.mark.parametrize("key", ["width", "height", "fx", "fy", "cx", "cy", "world_to_camera"])
def test_missing_key_is_named(tmp_path, entry, key):
    del entry[key]
    (tmp_path / "bad.json").write_text(json.dumps(entry))
    assert f"the key '{key}' is missing" in refused(tmp_path / "bad.json")
    (tmp_path / "bad.json").write_text(json.dumps([entry]))
    assert f"camera 0: the key '{key}' is missing" in refused(tmp_path / "bad.json")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("width", "1", "must be a number"),
        ("width", True, "must be a number"),
        ("width", 0, "at least 1x1"),
        ("width", 1.5, "whole number"),
        ("width", float("nan"), "whole number"),
        ("width", 10**400, "too large"),
        ("height", 10**7, "pixels large"),
        ("fx", -1, "fx must be positive"),
        ("cx", float("inf"), "cx must be finite"),
        ("world_to_camera", [1, 2, 3], "4 x 4 numbers"),
        ("world_to_camera", [[1, 2, 3]] * 4, "4 x 4 numbers"),
        ("world_to_camera", [["1"] * 4] * 4, "4 x 4 numbers"),
        ("world_to_camera", (2 * np.eye(4)).tolist(), "last row"),
        ("world_to_camera", np.diag([1.0, 1, -1, 1]).tolist(), "rotation"),
        ("world_to_camera", np.full((4, 4), np.nan).tolist(), "finite"),
    ],
)
def test_ill_values_are_named(tmp_path, entry, key, value, message):
    (tmp_path / "bad.json").write_text(json.dumps(entry | {key: value}))
    assert message in refused(tmp_path / "bad.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[]", "holds no cameras"),
        ("7", "must be an object"),
        ("[[1]]", "must be an object"),
        ('{"frames": []}', "transforms.json"),
    ],
)
def test_json_that_is_no_camera(tmp_path, text, message):
    (tmp_path / "bad.json").write_text(text)
    assert message in refused(tmp_path / "bad.json")


def test_missing_file_and_wrong_suffix(tmp_path):
    assert "no such file" in refused(tmp_path / "nix.json")
    assert "no such file" in refused(tmp_path / "images.bin")
    with pytest.raises(InputError, match=r"\.json"):
        save_camera(some_camera(), tmp_path / "cam.txt")
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe\xff")
    assert "not JSON" in refused(tmp_path / "bytes.json")


# --- cameras.json of the 3DGS trainer -----------------------------------------------------------------------


def trainer_entry(camera: Camera, name: str) -> dict:
    return {
        "id": 0,
        "img_name": name,
        "width": camera.width,
        "height": camera.height,
        "position": camera.eye.tolist(),
        "rotation": camera.R_camera_world.T.tolist(),
        "fy": camera.fy,
        "fx": camera.fx,
    }


def test_trainer_json(tmp_path):
    made = [some_camera(i) for i in range(4)]
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([trainer_entry(camera, f"{i}.jpg") for i, camera in enumerate(made)]))
    for i, (camera, loaded) in enumerate(zip(made, load_cameras(path), strict=True)):
        assert np.allclose(loaded.world_to_camera, camera.world_to_camera, atol=1e-12)
        assert (loaded.width, loaded.fx, loaded.cx, loaded.cy) == (97, camera.fx, 48.5, 26.5)
        assert loaded.name == f"{i}.jpg"


def test_trainer_json_missing_key(tmp_path):
    entry = trainer_entry(some_camera(), "a")
    for key in ("width", "height", "position", "fx", "fy"):
        (tmp_path / "cameras.json").write_text(json.dumps([{k: v for k, v in entry.items() if k != key}]))
        assert f"camera 0: the key '{key}' is missing" in refused(tmp_path / "cameras.json")


# --- COLMAP -------------------------------------------------------------------------------------------------

MODELS = {
    "SIMPLE_PINHOLE": (0, (70.0, 40.0, 30.0)),
    "PINHOLE": (1, (70.0, 80.0, 40.0, 30.0)),
    "SIMPLE_RADIAL": (2, (70.0, 40.0, 30.0, 0.1)),
    "RADIAL": (3, (70.0, 40.0, 30.0, 0.1, 0.2)),
    "OPENCV": (4, (70.0, 80.0, 40.0, 30.0, 0.1, 0.2, 0.3, 0.4)),
    "OPENCV_FISHEYE": (5, (70.0, 80.0, 40.0, 30.0, 0.1, 0.2, 0.3, 0.4)),
    "FULL_OPENCV": (6, (70.0, 80.0, 40.0, 30.0, *(0.1,) * 8)),
    "FOV": (7, (70.0, 80.0, 40.0, 30.0, 0.9)),
    "SIMPLE_RADIAL_FISHEYE": (8, (70.0, 40.0, 30.0, 0.1)),
    "RADIAL_FISHEYE": (9, (70.0, 40.0, 30.0, 0.1, 0.2)),
    "THIN_PRISM_FISHEYE": (10, (70.0, 80.0, 40.0, 30.0, *(0.1,) * 8)),
    "RAD_TAN_THIN_PRISM_FISHEYE": (11, (70.0, 80.0, 40.0, 30.0, *(0.01,) * 12)),
    "SIMPLE_DIVISION": (12, (70.0, 40.0, 30.0, -0.1)),
    "DIVISION": (13, (70.0, 80.0, 40.0, 30.0, -0.1)),
    "SIMPLE_FISHEYE": (14, (70.0, 40.0, 30.0)),
    "FISHEYE": (15, (70.0, 80.0, 40.0, 30.0)),
    "EUCM": (16, (70.0, 80.0, 40.0, 30.0, 0.6, 1.1)),
}

PANORAMA = "EQUIRECTANGULAR"

Image = tuple[str, int, Camera]


def write_model(
    folder: Path,
    lenses: Sequence[tuple[int, str]],
    images: Sequence[Image],
    *,
    text: bool,
    size: tuple[int, int] = (97, 53),
) -> None:
    """A COLMAP model of cameras of one size; images have some 2D points, the second none."""
    folder.mkdir(parents=True, exist_ok=True)
    if text:
        rows = [
            f"{number} {name} {size[0]} {size[1]} {' '.join(map(str, MODELS[name][1]))}\n"
            for number, name in lenses
        ]
        (folder / "cameras.txt").write_text("# cameras\n" + "".join(rows))
        lines = ["# images\n"]
        for i, (name, lens, camera) in enumerate(images):
            pose = [*quat_of(camera.R_camera_world), *camera.t_camera_world]
            lines.append(f"{i} {' '.join(map(repr, map(float, pose)))} {lens} {name}\n")
            lines.append("1.5 2.5 -1 3.5 4.5 7\n" if i != 1 else "\n")
        (folder / "images.txt").write_text("".join(lines))
        return
    data = struct.pack("<Q", len(lenses))
    for number, name in lenses:
        model, params = MODELS[name]
        data += struct.pack(f"<IiQQ{len(params)}d", number, model, *size, *params)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for i, (name, lens, camera) in enumerate(images):
        data += struct.pack("<I7dI", i, *quat_of(camera.R_camera_world), *camera.t_camera_world, lens)
        points = 2 if i != 1 else 0
        data += name.encode() + b"\0" + struct.pack("<Q", points) + bytes(24 * points)
    (folder / "images.bin").write_bytes(data)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("model", MODELS)
def test_colmap_models(tmp_path, text, model):
    images = [(f"{name} ü.jpg", 7, some_camera(i)) for i, name in enumerate("cab")]
    write_model(tmp_path, [(3, "PINHOLE"), (7, model)], images, text=text)
    notes: list[str] = []
    cameras = load_cameras(tmp_path, on_note=notes.append)
    assert [camera.name for camera in cameras] == ["a ü.jpg", "b ü.jpg", "c ü.jpg"]
    two_focals = MODELS[model][1][1] == 80
    for camera, seed in zip(cameras, (1, 2, 0), strict=True):
        assert np.allclose(camera.world_to_camera, some_camera(seed).world_to_camera, atol=1e-9)
        expected = (97, 53, 70, 80 if two_focals else 70, 40, 30)
        assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == expected
    if model.endswith("PINHOLE"):
        assert notes == []
        assert [camera.lens for camera in cameras] == [None] * 3
    else:
        assert len(notes) == 1 and "camera 7" in notes[0] and model in notes[0]
        parameters = MODELS[model][1][4 if two_focals else 3 :]
        assert [camera.lens for camera in cameras] == [Lens(model=model, parameters=parameters)] * 3


@pytest.mark.parametrize("text", [False, True])
def test_of_panoramas_what_is_ahead_is_a_view(tmp_path, monkeypatch, text):
    monkeypatch.setitem(MODELS, PANORAMA, (17, (98.0, 49.0)))
    write_model(tmp_path, [(1, PANORAMA)], [("a.jpg", 1, some_camera())], text=text, size=(98, 49))
    notes: list[str] = []
    (camera,) = load_cameras(tmp_path, on_note=notes.append)
    # 98 px are 360 degrees: 31 are what 90 degrees have, at as many to an angle in the middle.
    assert (camera.width, camera.height, camera.lens) == (31, 31, None)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (15.5, 15.5, 15.5, 15.5)
    assert np.allclose(camera.world_to_camera, some_camera().world_to_camera, atol=1e-9)
    assert len(notes) == 1 and "camera 1 is panoramic" in notes[0]


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("size", [(97, 53), (49, 98), (0, 0)])
def test_a_panorama_of_another_shape_is_refused(tmp_path, monkeypatch, size, text):
    monkeypatch.setitem(MODELS, PANORAMA, (17, (98.0, 49.0)))
    write_model(tmp_path, [(1, PANORAMA)], [("a.jpg", 1, some_camera())], text=text, size=size)
    assert "twice as wide as it is high" in refused(tmp_path)


@pytest.mark.parametrize(("name", "count"), [("SPHERICAL", 2), ("SPHERE", 3)])
def test_other_programs_names_of_panoramas(tmp_path, name, count):
    write_model(tmp_path, [(1, "PINHOLE")], [("a.jpg", 1, some_camera())], text=True)
    for numbers in range(1, 5):
        (tmp_path / "cameras.txt").write_text(f"1 {name} 98 49 {'1 ' * numbers}\n")
        if numbers == count:
            assert load_cameras(tmp_path)[0].width == 31
        else:
            assert f"is no {name} camera" in refused(tmp_path)


def test_colmap_by_any_of_its_paths(tmp_path):
    images = [("a", 1, some_camera())]
    write_model(tmp_path / "sparse" / "0", [(1, "PINHOLE")], images, text=False)
    write_model(tmp_path / "text", [(1, "PINHOLE")], images, text=True)
    model = tmp_path / "sparse" / "0"
    for path in (
        tmp_path,
        model,
        model / "images.bin",
        model / "cameras.bin",
        tmp_path / "text" / "images.txt",
    ):
        assert [camera.name for camera in load_cameras(path)] == ["a"]


@pytest.mark.parametrize("text", [False, True])
def test_of_several_colmap_models_the_largest_is_taken(tmp_path, text):
    lens = [(1, "PINHOLE")]
    for number, names in ((0, "ab"), (1, "cdef"), (10, "ghij")):
        images = [(name, 1, some_camera(i)) for i, name in enumerate(names)]
        write_model(tmp_path / "sparse" / str(number), lens, images, text=text)
    assert [camera.name for camera in load_cameras(tmp_path)] == list("cdef")
    images_file = tmp_path / "sparse" / "1" / ("images.txt" if text else "images.bin")
    images_file.rename(images_file.with_stem("other"))
    assert [camera.name for camera in load_cameras(tmp_path)] == list("ghij")
    assert [camera.name for camera in load_cameras(tmp_path / "sparse" / "0")] == list("ab")


def test_colmap_parts_missing(tmp_path):
    assert "holds no COLMAP model" in refused(tmp_path)
    write_model(tmp_path, [(1, "PINHOLE")], [("a", 2, some_camera())], text=False)
    assert "'a' has camera 2, which is not in cameras.bin" in refused(tmp_path)
    (tmp_path / "points3D.bin").write_bytes(b"")
    assert "is no camera file" in refused(tmp_path / "points3D.bin")
    (tmp_path / "cameras.bin").unlink()
    assert "needs cameras.bin" in refused(tmp_path / "images.bin")


def test_colmap_unknown_model_and_no_images(tmp_path):
    write_model(tmp_path, [(1, "PINHOLE")], [("a", 1, some_camera())], text=False)
    lens = (tmp_path / "cameras.bin").read_bytes()
    for number in (-1, 18, 99):
        (tmp_path / "cameras.bin").write_bytes(lens[:12] + struct.pack("<i", number) + lens[16:])
        assert f"unknown model {number}" in refused(tmp_path)
    write_model(tmp_path, [(1, "PINHOLE")], [], text=False)
    assert "holds no cameras" in refused(tmp_path)
    write_model(tmp_path / "t", [(1, "PINHOLE")], [("a", 1, some_camera())], text=True)
    for line, message in (
        ("1 WIDE 9 9 1 1 1 1", "unknown camera model"),
        ("1", "unknown camera model"),
        ("1 PINHOLE 9 9 1 1 1", "is no PINHOLE camera"),
        ("1 PINHOLE 9 x 1 1 1 1", "is no PINHOLE camera"),
        ("1 PINHOLE 9 9 1 nan 1 1", "not finite"),
    ):
        (tmp_path / "t" / "cameras.txt").write_text(line + "\n")
        assert message in refused(tmp_path / "t")


def test_colmap_zero_quaternion(tmp_path):
    write_model(tmp_path, [(1, "PINHOLE")], [("a", 1, some_camera())], text=False)
    data = (tmp_path / "images.bin").read_bytes()
    (tmp_path / "images.bin").write_bytes(data[:12] + bytes(32) + data[44:])
    assert "image 'a': camera world_to_camera must be a finite" in refused(tmp_path)


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "cameras.txt", "images.txt"])
def test_colmap_truncated_anywhere(tmp_path, file):
    images = [(name, 1, some_camera()) for name in "ab"]
    write_model(tmp_path, [(1, "PINHOLE")], images, text=file.endswith("txt"))
    data = (tmp_path / file).read_bytes()
    for cut in range(0, len(data) if file.endswith("bin") else data.rindex(b"0"), 3):
        (tmp_path / file).write_bytes(data[:cut])
        try:
            cameras = load_cameras(tmp_path / file)
        except InputError as error:
            assert "\n" not in str(error)
        else:
            # A text file cut between lines is a shorter list, and cannot be told from one.
            assert file.endswith("txt") and len(cameras) <= 2


@given(
    text=st.booleans(),
    which=st.booleans(),
    changes=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4),
)
@example(text=False, which=True, changes=[(0.0, 255), (0.05, 255)])
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_colmap_opens_or_is_refused(tmp_path, text, which, changes):
    write_model(tmp_path / str(text), [(1, "OPENCV")], [(n, 1, some_camera()) for n in "ab"], text=text)
    path = tmp_path / str(text) / (("cameras" if which else "images") + (".txt" if text else ".bin"))
    data = bytearray(path.read_bytes())
    for at, byte in changes:
        data[min(int(at * len(data)), len(data) - 1)] = byte
    path.write_bytes(data)
    try:
        assert all(isinstance(camera, Camera) for camera in load_cameras(path))
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("capture", ["banana", "miku"])
def test_real_captures_see_their_points(data_file, capture):
    """Every 2D observation of the model lies where the camera projects its 3D point."""
    folder = data_file(f"captures/{capture}") / "sparse" / "0"
    cameras = {camera.name: camera for camera in load_cameras(folder)}
    points = {}
    with open(folder / "points3D.bin", "rb") as file:
        for _ in range(struct.unpack("<Q", file.read(8))[0]):
            number, *position = struct.unpack("<Q3d", file.read(32))
            points[number] = position
            (track,) = struct.unpack("<Q", file.read(19)[-8:])
            file.seek(8 * track, 1)
    errors = []
    with open(folder / "images.bin", "rb") as file:
        for _ in range(struct.unpack("<Q", file.read(8))[0]):
            file.seek(64, 1)
            name = b"".join(iter(lambda: file.read(1), b"\0")).decode()
            (count,) = struct.unpack("<Q", file.read(8))
            seen = np.frombuffer(file.read(24 * count), dtype=[("uv", "<f8", 2), ("point", "<i8")])
            seen = seen[seen["point"] >= 0]
            camera = cameras[name]
            xyz = np.array([points[number] for number in seen["point"].tolist()])
            t = xyz @ camera.R_camera_world.T + camera.t_camera_world
            assert (t[:, 2] > 0).all()
            uv = t[:, :2] / t[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
            errors.append(np.linalg.norm(uv - seen["uv"], axis=1))
    assert len(errors) == len(cameras)
    assert np.median(np.concatenate(errors)) < 1.0


@pytest.mark.parametrize(
    "text",
    [
        *(
            "[]",
            "[ ]",
            " [1, 2 ,3]\n",
            '[[1],{"a": 2}] ',
            '{"a": [1]}',
            "\ufeff[1]",
            "[NaN, 1e999]",
            '["\\ud800"]',
        ),
        *("[1,]", "[1 2]", "[1", "[1]x", "nul", "", "[1,2]]", "[1,,2]", "[,1]", "["),
    ],
)
def test_lists_that_are_read_entry_by_entry_are_those_of_json(tmp_path, text):
    path = tmp_path / "list.json"
    path.write_text(text, encoding="utf-8")
    try:
        expected = repr(json.loads(path.read_bytes()))
    except ValueError as error:
        with pytest.raises(InputError) as refused:
            read_json(path, what="list")
        assert str(error) in str(refused.value)
    else:
        assert repr(read_json(path, what="list")) == expected
