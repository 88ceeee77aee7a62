"""Which files are frames of a sequence, and in which order."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from splatview.scene import InputError
from splatview.scene.formats import save_scene
from splatview.scene.formats.sequence import (
    SceneSequence,
    in_natural_order,
    natural_key,
    read_ahead,
    resolve,
    resolve_all,
)


def touch(folder: Path, *names: str) -> list[Path]:
    paths = [folder / name for name in names]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return paths


def frames(found: object) -> list[str]:
    assert isinstance(found, SceneSequence)
    return list(found.labels)


def test_people_count_so():
    names = [
        "frame_10.ply",
        "frame_2.ply",
        "Frame_1.ply",
        "frame.ply",
        "frame_02.ply",
        "a1b2",
        "a1b10",
        "a",
        "1",
    ]
    assert sorted(names, key=natural_key) == [
        *("1", "a", "a1b2", "a1b10", "frame.ply"),
        *("Frame_1.ply", "frame_02.ply", "frame_2.ply", "frame_10.ply"),
    ]
    paths = [Path("t10/a.ply"), Path("t9/b.ply"), Path("t9/a.ply")]
    assert in_natural_order(paths) == [paths[2], paths[1], paths[0]]


def test_a_folder_of_numbered_scenes_is_a_sequence(tmp_path):
    touch(tmp_path, "f10.spz", "f9.spz", "f1.spz", "notes.txt", ".f2.spz", "preview.png")
    found = resolve(tmp_path)
    assert frames(found) == ["f1.spz", "f9.spz", "f10.spz"]
    assert isinstance(found, SceneSequence)
    assert (found.name, found.folder, found.left_out) == (tmp_path.name, tmp_path, 0)
    assert found.in_words == "3 frames from f1.spz to f10.spz"


def test_one_scene_in_a_folder_is_that_scene_and_none_is_one_line(tmp_path):
    (only,) = touch(tmp_path / "one", "scene.compressed.ply")
    assert resolve(tmp_path / "one") == only
    touch(tmp_path / "photos", "a.JPG", "b.JPG")
    with pytest.raises(InputError, match=r"photos: holds no scene .*\.spz.* splatview train"):
        resolve(tmp_path / "photos")
    touch(tmp_path / "nested", "t1/cloud.ply", "t2/cloud.ply")
    with pytest.raises(InputError, match=r"'.*nested/\*/\*\.ply'"):
        resolve(tmp_path / "nested")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: holds no scene \([^\n]*\) and no cameras$"):
        resolve(tmp_path / "empty")


def test_what_is_not_numbered_like_the_most_is_left_out(tmp_path):
    touch(tmp_path, *(f"frame_{i}.ply" for i in range(12)), "background.ply", "mean.spz")
    found = resolve(tmp_path)
    assert isinstance(found, SceneSequence)
    assert len(found) == 12 and found.left_out == 2 and found.alike
    assert found.in_words.endswith("frame_11.ply; 2 other scenes are left out")


def test_the_same_frames_in_two_formats_play_once(tmp_path):
    touch(tmp_path, *(f"{i}.{suffix}" for i in range(5) for suffix in ("spz", "ply")))
    assert frames(resolve(tmp_path)) == [f"{i}.ply" for i in range(5)]


def test_unrelated_scenes_are_frames_by_their_names(tmp_path):
    touch(tmp_path, "skull.ply", "biker.spz", "guitar.sog", "train-1000.ply")
    found = resolve(tmp_path)
    assert frames(found) == ["biker.spz", "guitar.sog", "skull.ply", "train-1000.ply"]
    assert isinstance(found, SceneSequence)
    assert found.in_words.startswith("4 scenes that are not numbered alike")
    assert found.in_words.endswith("from biker.spz")


def test_folders_that_are_scenes_or_captures_are_no_sequences(tmp_path):
    touch(tmp_path / "sog", "meta.json", "1.ply", "2.ply")
    touch(tmp_path / "colmap", "sparse/0/cameras.bin", "sparse/0/images.bin", "1.ply", "2.ply")
    touch(tmp_path / "nerf", "transforms.json", "1.ply", "2.ply")
    for name in ("sog", "colmap", "nerf"):
        assert resolve(tmp_path / name) == tmp_path / name
    touch(tmp_path / "frames", *(f"t{i}/meta.json" for i in (10, 9)))
    assert frames(resolve(tmp_path / "frames")) == ["t9", "t10"], "folders of SOG are frames as well"


def test_globs(tmp_path):
    touch(tmp_path, *(f"t{i}/cloud.ply" for i in (10, 9, 1)), "t1/other.txt", "[1].ply")
    found = resolve(tmp_path / "t*" / "cloud.ply")
    assert frames(found) == [str(Path(f"t{i}") / "cloud.ply") for i in (1, 9, 10)]
    assert frames(resolve(tmp_path / "**" / "cloud.ply")) == frames(found)
    assert len(frames(resolve(tmp_path / "t?" / "*.ply"))) == 2
    assert resolve(tmp_path / "[1].ply") == tmp_path / "[1].ply", "a file of that very name"
    assert resolve(tmp_path / "t10" / "*") == tmp_path / "t10" / "cloud.ply"
    assert resolve(tmp_path / "x*.ply") == tmp_path / "x*.ply"
    with pytest.raises(InputError, match=r"none of the 1 that match is a scene"):
        resolve(tmp_path / "t1" / "*.txt")


def test_files_named_one_by_one(tmp_path):
    numbered = touch(tmp_path, *(f"f{i}.ply" for i in (10, 2, 1)))
    named = touch(tmp_path, "a.ply", "b.ply", "c.ply")
    assert frames(resolve_all(numbered)) == ["f1.ply", "f2.ply", "f10.ply"]
    assert resolve_all(numbered, merge=True) == numbered
    assert resolve_all(numbered[:2]) == numbered[:2], "two may be parts"
    assert resolve_all(named) == named
    assert resolve_all([*numbered, tmp_path / "cameras.json"]) == [*numbered, tmp_path / "cameras.json"]
    assert resolve_all([numbered[0]] * 3) == [numbered[0]] * 3
    assert resolve_all([named[0]]) == [named[0]]
    assert resolve_all([tmp_path / "f*.ply"], merge=True) == in_natural_order(numbered)
    assert resolve_all([tmp_path / "f*.ply", named[0]]) == [*in_natural_order(numbered), named[0]]


def test_a_sequence_read_again_has_what_has_come(tmp_path):
    touch(tmp_path, "f1.ply", "f2.ply")
    found = resolve(tmp_path)
    assert isinstance(found, SceneSequence)
    touch(tmp_path, "f3.ply")
    assert len(found.again()) == 3


def test_reading_ahead_goes_on_behind_a_damaged_frame(tmp_path, random_gaussians):
    for i in range(4):
        save_scene(random_gaussians(10 + i, seed=i), tmp_path / f"{i}.splat")
    (tmp_path / "1.splat").write_bytes(json.dumps({}).encode() * 9)
    found = resolve(tmp_path)
    assert isinstance(found, SceneSequence)
    read = [(path.name, got) for path, got in read_ahead(found.paths)]
    assert [name for name, _ in read] == ["0.splat", "1.splat", "2.splat", "3.splat"]
    assert [len(got) for _, got in read if not isinstance(got, InputError)] == [10, 12, 13]
    assert isinstance(read[1][1], InputError) and "1.splat" in str(read[1][1])
