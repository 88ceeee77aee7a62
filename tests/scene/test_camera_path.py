"""Camera paths: through their keyframes, smooth, the same backwards, even in a turn; and their files."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.scene import InputError, look_at
from splatview.scene.camera_path import (
    MOTIONS,
    CameraPath,
    Keyframe,
    Pose,
    exponential,
    matrix_of,
    product,
    quaternion,
    roll_of,
    rotation_vector,
    turntable,
)
from splatview.scene.camera_path_files import load_camera_path, save_camera_path

UP = np.array((0.0, -1.0, 0.0))


def level_pose(rng: np.random.Generator) -> Pose:
    """Seen level from somewhere about the origin, not from straight above."""
    azimuth, elevation, distance = rng.uniform(-3, 3), rng.uniform(-1.2, 1.2), rng.uniform(1, 5)
    target = rng.normal(size=3)
    flat = np.array((math.cos(azimuth), 0, math.sin(azimuth)))
    eye = target + distance * (math.cos(elevation) * flat + math.sin(elevation) * UP)
    matrix = look_at(eye, target, up=UP).world_to_camera
    return Pose(
        target=target, distance=distance, R_camera_world=matrix[:3, :3], fov_y=float(rng.uniform(20, 90))
    )


def any_pose(rng: np.random.Generator) -> Pose:
    """Turned by anything."""
    return replace(level_pose(rng), R_camera_world=matrix_of(exponential(rng.normal(size=3))))


def path_of(poses: list[Pose], times: list[float], **options) -> CameraPath:
    keys = tuple(Keyframe(time=time, pose=pose) for time, pose in zip(times, poses, strict=True))
    return CameraPath(keyframes=keys, **{"duration": times[-1], "up": UP, **options})


def numbers(pose: Pose) -> np.ndarray:
    """All of a pose that a picture shows, without units."""
    return np.concatenate([pose.eye, pose.R_camera_world.ravel(), [math.radians(pose.fov_y)]])


TIMES = [0.0, 0.7, 2.5, 3.0, 4.2]


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("loop", [False, True])
@pytest.mark.parametrize("make", [level_pose, any_pose])
def test_it_goes_through_its_keyframes_smoothly(rng, motion, loop, make):
    poses = [make(rng) for _ in TIMES]
    path = path_of(poses, TIMES, motion=motion, loop=loop, duration=5.0 if loop else TIMES[-1])
    for time, pose in zip(TIMES, poses, strict=True):
        np.testing.assert_allclose(numbers(path.pose(time)), numbers(pose), atol=1e-9)
    # C1: the velocities on both sides of each keyframe inside agree.
    step = 1e-6
    for time in TIMES if loop else TIMES[1:-1]:
        before = (numbers(path.pose(time)) - numbers(path.pose(time - step))) / step
        after = (numbers(path.pose(time + step)) - numbers(path.pose(time))) / step
        np.testing.assert_allclose(before, after, atol=2e-4 * (1 + abs(before).max()))


@pytest.mark.parametrize("motion", MOTIONS)
def test_backwards_it_is_the_same_way(rng, motion):
    poses = [any_pose(rng) for _ in TIMES]
    path = path_of(poses, TIMES, motion=motion)
    back = path_of(poses[::-1], [TIMES[-1] - time for time in TIMES[::-1]], motion=motion)
    for time in np.linspace(0, TIMES[-1], 23):
        expected = numbers(path.pose(time))
        np.testing.assert_allclose(numbers(back.pose(TIMES[-1] - time)), expected, atol=1e-9)


def test_between_level_keyframes_the_horizon_stays_level(rng):
    path = path_of([level_pose(rng) for _ in TIMES], TIMES)
    rolls = [roll_of(path.pose(time).R_camera_world, UP) for time in np.linspace(0, 4.2, 50)]
    assert max(map(abs, rolls)) < 1e-9


def test_where_it_rests_it_does_not_overshoot(rng):
    a, b = level_pose(rng), level_pose(rng)
    path = path_of([a, a, b, b], [0, 1, 2, 3])
    for time in (0.3, 0.8, 2.2, 2.9):
        np.testing.assert_allclose(numbers(path.pose(time)), numbers(a if time < 1.5 else b), atol=1e-12)


def test_a_turntable_is_an_even_circle(rng):
    pose = level_pose(rng)
    path = turntable(pose, UP, 6.0)
    times = path.frame_times(30)
    assert len(times) == 180 and times[-1] < 6.0
    eyes = np.array([path.pose(time).eye for time in times])
    steps = np.linalg.norm(eyes - np.roll(eyes, 1, axis=0), axis=1)
    radius = np.linalg.norm(np.cross(pose.eye - pose.target, UP))
    np.testing.assert_allclose(np.linalg.norm(np.cross(eyes - pose.target, UP), axis=1), radius, rtol=1e-12)
    np.testing.assert_allclose(eyes @ UP, pose.eye @ UP, atol=1e-12)
    np.testing.assert_allclose(steps, 2 * radius * math.sin(math.pi / 180), rtol=1e-9)
    directions = np.array([path.pose(time).R_camera_world[2] for time in times])
    np.testing.assert_allclose(eyes + pose.distance * directions, np.tile(pose.target, (180, 1)), atol=1e-12)


def test_it_moves_with_its_world(rng):
    """Turned and moved as a whole, the way between the keyframes turns and moves along."""
    R, offset = matrix_of(exponential(rng.normal(size=3))), rng.normal(size=3)
    poses = [level_pose(rng) for _ in TIMES]
    moved = [
        replace(pose, target=R @ pose.target + offset, R_camera_world=pose.R_camera_world @ R.T)
        for pose in poses
    ]
    path, other = path_of(poses, TIMES), path_of(moved, TIMES, up=R @ UP)
    for time in (0.2, 1.9, 2.7, 4.0):
        here, there = path.pose(time), other.pose(time)
        np.testing.assert_allclose(there.eye, R @ here.eye + offset, atol=1e-9)
        np.testing.assert_allclose(there.R_camera_world @ R, here.R_camera_world, atol=1e-9)


def test_one_keyframe_is_held_and_ends_rest(rng):
    pose = level_pose(rng)
    path = CameraPath(keyframes=(Keyframe(time=1.0, pose=pose),), duration=3.0)
    assert all(path.pose(time) is pose for time in (0.0, 1.0, 3.0))
    assert len(path.frame_times(10)) == 31
    poses = [level_pose(rng), level_pose(rng)]
    two = path_of(poses, [1.0, 2.0], duration=3.0)
    for time, end in ((0.0, poses[0]), (2.5, poses[1])):
        np.testing.assert_allclose(numbers(two.pose(time)), numbers(end), atol=1e-12)
    other = two.lasting(1.5)
    np.testing.assert_allclose(numbers(other.pose(0.7)), numbers(two.pose(1.4)), atol=1e-9)


def test_what_is_no_path_is_refused_in_a_line(rng):
    pose = level_pose(rng)
    key = Keyframe(time=1.0, pose=pose)
    wrong = {
        "same time": {"keyframes": (key, key), "duration": 2.0},
        "at least one": {"keyframes": (), "duration": 2.0},
        "outside": {"keyframes": (key,), "duration": 0.5},
        "outside of": {"keyframes": (Keyframe(time=math.nan, pose=pose),), "duration": 0.5},
        "seconds, not": {"keyframes": (key,), "duration": math.nan},
        "a loop needs": {
            "keyframes": (Keyframe(time=0.0, pose=pose), key),
            "duration": 1.0,
            "loop": True,
        },
    }
    for text, options in wrong.items():
        with pytest.raises(ValueError, match=text):
            CameraPath(**options)
    for change in (
        {"distance": 0.0},
        {"distance": math.nan},
        {"fov_y": 180.0},
        {"target": np.array((0, math.inf, 0))},
        {"R_camera_world": -np.eye(3)},
    ):
        with pytest.raises(ValueError, match=r"must be|is none|not finite"):
            replace(pose, **change)


def test_quaternions_are_the_rotations(rng):
    for scale in (1e-9, 0.1, 1.0, 3.1, math.pi):
        vector = rng.normal(size=3)
        vector *= scale / np.linalg.norm(vector)
        R = matrix_of(exponential(vector))
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(R @ vector, vector, atol=1e-12)
        found = rotation_vector(quaternion(R))
        assert min(abs(found - vector).max(), abs(found + vector).max() if scale > 3 else 9) < 1e-9
        turned = matrix_of(product(exponential(vector), exponential(vector)))
        np.testing.assert_allclose(turned, R @ R, atol=1e-12)


# ---- Files.


def test_a_saved_path_comes_back_to_the_bit(rng, tmp_path):
    path = path_of([any_pose(rng) for _ in TIMES], TIMES, loop=True, duration=5.0, motion="fly")
    file = tmp_path / "way.json"
    save_camera_path(path, file, fps=12.0, size=(640, 360))
    found = load_camera_path(file)
    assert (found.fps, found.size) == (12.0, (640, 360))
    assert (found.path.loop, found.path.motion, found.path.duration) == (True, "fly", 5.0)
    for before, after in zip(path.keyframes, found.path.keyframes, strict=True):
        assert before.time == after.time
        np.testing.assert_array_equal(numbers(before.pose), numbers(after.pose))


def test_nerfstudio_reads_the_same_cameras(rng, tmp_path):
    """What its keys say, by hand, and read back without ours: one camera a frame."""
    path = path_of([level_pose(rng) for _ in TIMES], TIMES)
    file = tmp_path / "camera_path.json"
    save_camera_path(path, file, fps=10.0, size=(640, 360))
    content = json.loads(file.read_text())
    assert content["camera_type"] == "perspective" and content["render_width"] == 640
    assert len(content["camera_path"]) == len(path.frame_times(10.0)) == 43
    matrix = np.array(content["camera_path"][7]["camera_to_world"]).reshape(4, 4)
    pose = path.pose(0.7)
    np.testing.assert_allclose(matrix[:3, 3], pose.eye, atol=1e-12)
    np.testing.assert_allclose(-matrix[:3, 2], pose.R_camera_world[2], atol=1e-12)  # OpenGL looks along -z
    np.testing.assert_allclose(-matrix[:3, 1], pose.R_camera_world[1], atol=1e-12)
    assert content["camera_path"][7]["fov"] == pytest.approx(pose.fov_y)
    del content["splatview"]
    file.write_text(json.dumps(content))
    dense = load_camera_path(file).path
    for time in path.frame_times(10.0):
        np.testing.assert_allclose(numbers(dense.pose(time)), numbers(path.pose(time)), atol=1e-9)


def supersplat(**changes) -> dict:
    values = {"position": [0, 1, 5, 5, 1, 0], "target": [0, 0, 0, 0, 0, 0], "fov": [60, 40]}
    track = {
        "name": "one",
        "duration": 2,
        "frameRate": 30,
        "loopMode": "none",
        "interpolation": "spline",
        "keyframes": {"times": [0, 60], "values": values},
    }
    return {"version": 2, "animTracks": [{**track, **changes}]}


@pytest.mark.parametrize("mode", ["none", "repeat", "pingpong"])
def test_animations_of_supersplat_are_read(tmp_path, mode):
    file = tmp_path / "settings.json"
    file.write_text(json.dumps(supersplat(loopMode=mode)))
    path = load_camera_path(file, aspect=2.0).path
    first, second = path.keyframes[0].pose, path.keyframes[1].pose
    # Its world is the file's, turned by half a turn about z: what is up there is -y here.
    np.testing.assert_allclose(first.eye, (0, -1, 5), atol=1e-12)
    np.testing.assert_allclose(second.eye, (-5, -1, 0), atol=1e-12)
    assert -first.R_camera_world[1] @ UP > 0.9
    # Its angle is that of the longer side.
    assert math.tan(math.radians(first.fov_y) / 2) == pytest.approx(math.tan(math.radians(30)) / 2)
    assert path.keyframes[1].time == 2.0
    assert path.loop == (mode != "none")
    assert path.duration == pytest.approx({"none": 2, "repeat": 2 + 1 / 30, "pingpong": 4}[mode])
    if mode == "pingpong":
        np.testing.assert_allclose(numbers(path.pose(1.3)), numbers(path.pose(2.7)), atol=1e-9)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("[1, 2", "not JSON"),
        ({"cameras": []}, "is no camera path"),
        ([], "is no camera path"),
        ({"camera_path": []}, "at least one"),
        ({"camera_path": [{"fov": 50}]}, "camera 0: the key 'camera_to_world' is missing"),
        ({"camera_path": [{"camera_to_world": [0] * 16, "fov": 50}]}, "no rotation"),
        ({"camera_path": [{"camera_to_world": [math.nan] * 16, "fov": 50}]}, "no rotation"),
        ({"camera_path": [{}], "camera_type": "equirectangular"}, "only perspective"),
        ({"camera_path": [{}], "fps": 0}, "'fps' must be"),
        ({"animTracks": []}, "holds no track"),
        (supersplat(interpolation="step"), "not spline"),
        (supersplat(keyframes={"times": [0], "values": {"position": [1]}}), "'position' must be 3 numbers"),
        (supersplat(keyframes=None), "times and values"),
        (supersplat(frameRate=0), "'frameRate' must be"),
        ({"splatview": {"motion": "walk", "loop": False}}, "'motion' must be"),
        ({"splatview": {"motion": "fly", "loop": False, "keyframes": [1]}}, "list of objects"),
    ],
)
def test_a_file_that_is_no_path_is_told_of_in_a_line(tmp_path, content, told):
    file = tmp_path / "path.json"
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(InputError, match=told) as caught:
        load_camera_path(file)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


def test_two_supersplat_keyframes_at_one_time_are_refused(tmp_path):
    file = tmp_path / "settings.json"
    content = supersplat()
    content["animTracks"][0]["keyframes"]["times"] = [30, 30]
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match="same time, 1 s"):
        load_camera_path(file)


def test_a_path_is_saved_as_json_only(rng, tmp_path):
    with pytest.raises(InputError, match=r"saved as \.json"):
        save_camera_path(path_of([level_pose(rng)], [0.0]), Path(tmp_path / "p.txt"), fps=30.0, size=(64, 48))
