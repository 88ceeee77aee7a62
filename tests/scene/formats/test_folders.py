"""Folders of .sog and streamed SOG: whole or not at all, nothing but their own, every level once."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from splatview.scene import Gaussians, InputError
from splatview.scene.formats import load_scene, named_output, place_copy, save_scene, stored_bytes
from splatview.scene.formats.sog_folder import save_streamed
from splatview.scene.progress import NO_PROGRESS, Cancelled, Progress

LEAF, CHUNK = 40, 150


@pytest.fixture(scope="module")
def scene(random_gaussians) -> Gaussians:
    return random_gaussians(500, sh_degree=1, seed=8)


@pytest.fixture(scope="module")
def streamed(scene, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("streamed") / "s" / "lod-meta.json"
    save_streamed(scene, path, NO_PROGRESS, chunk=CHUNK, leaf=LEAF)
    return path


def test_a_folder_holds_what_the_zip_holds(scene, tmp_path):
    save_scene(scene, tmp_path / "zip.sog")
    save_scene(scene, tmp_path / "folder" / "meta.json")
    zipped, read = load_scene(tmp_path / "zip.sog"), load_scene(tmp_path / "folder")
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        assert np.array_equal(getattr(zipped, name), getattr(read, name)), name
    files = list((tmp_path / "folder").iterdir())
    assert stored_bytes(tmp_path / "folder" / "meta.json") == sum(file.stat().st_size for file in files)


def leaves(node: dict) -> list[dict]:
    return [leaf for child in node["children"] for leaf in leaves(child)] if "children" in node else [node]


def test_the_finest_level_is_the_scene_and_no_other_is_read(scene, streamed):
    meta = json.loads(streamed.read_text())
    assert meta["lodLevels"] == len(meta["counts"]) > 2 and meta["count"] == sum(meta["counts"]) > len(scene)
    assert all(after < before for before, after in zip(meta["counts"], meta["counts"][1:], strict=False))
    read = load_scene(streamed)
    assert len(read) == len(scene) and len(load_scene(streamed.parent)) == len(scene)
    steps = 2 * np.ptp(np.sign(scene.means) * np.log1p(np.abs(scene.means))) / 65535 * 3
    for axis in range(3):
        assert np.abs(np.sort(read.means[:, axis]) - np.sort(scene.means[:, axis])).max() < steps


def test_every_splat_of_every_level_is_in_one_run_of_one_chunk(streamed):
    meta = json.loads(streamed.read_text())
    units = [load_scene(streamed.parent / name) for name in meta["filenames"]]
    assert len(units) > meta["lodLevels"] and max(map(len, units)) <= CHUNK + LEAF
    taken = [np.zeros(len(unit), int) for unit in units]
    levels: dict[str, int] = {}
    for leaf in leaves(meta["tree"]):
        assert "0" in leaf["lods"], "or a player would show two levels at once"
        for level, part in leaf["lods"].items():
            run = slice(part["offset"], part["offset"] + part["count"])
            taken[part["file"]][run] += 1
            levels[level] = levels.get(level, 0) + part["count"]
            assert meta["filenames"][part["file"]].startswith(f"{level}_")
            inside = units[part["file"]].means[run]
            assert (inside >= np.array(leaf["bound"]["min"]) - 1e-3).all()
            assert (inside <= np.array(leaf["bound"]["max"]) + 1e-3).all()
    assert all((counts == 1).all() for counts in taken)
    assert [levels[str(level)] for level in range(meta["lodLevels"])] == meta["counts"]


def test_merged_levels_keep_the_place_of_the_scene(scene, streamed):
    meta = json.loads(streamed.read_text())
    names = [name for name in meta["filenames"] if name.startswith(f"{meta['lodLevels'] - 1}_")]
    coarsest = np.concatenate([load_scene(streamed.parent / name).means for name in names])
    assert np.abs(np.median(coarsest, axis=0) - np.median(scene.means, axis=0)).max() < 0.3


@pytest.mark.parametrize("name", ["meta.json", "lod-meta.json"])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_the_smallest_scenes(random_gaussians, tmp_path, count, name):
    save_scene(random_gaussians(count), tmp_path / "s" / name)
    assert len(load_scene(tmp_path / "s")) == count


@pytest.mark.parametrize("name", ["meta.json", "lod-meta.json"])
def test_a_folder_of_something_else_is_left_alone(scene, tmp_path, name):
    folder = tmp_path / "holiday"
    (folder / "more").mkdir(parents=True)
    (folder / "more" / "photo.jpg").write_bytes(b"dear")
    with pytest.raises(InputError, match=r"holds 'more'.*name another folder"):
        save_scene(scene, folder / name)
    (folder / "more" / "photo.jpg").rename(folder / "photo.jpg")
    with pytest.raises(InputError, match="name another folder"):
        save_scene(scene, folder / name)
    assert (folder / "photo.jpg").read_bytes() == b"dear" and len(list(tmp_path.iterdir())) == 1


def test_the_folder_of_the_process_is_left_alone(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"NAME/meta\.json"):
        save_scene(scene, Path("meta.json"))


def test_an_older_scene_is_replaced_as_a_whole(scene, streamed, tmp_path):
    save_scene(scene, tmp_path / "s" / "meta.json")
    place_copy(streamed, tmp_path / "s" / "lod-meta.json")
    assert not (tmp_path / "s" / "meta.json").exists()
    assert len(load_scene(tmp_path / "s")) == len(scene) and [*tmp_path.iterdir()] == [tmp_path / "s"]


def test_what_is_cancelled_leaves_the_older_one(scene, tmp_path):
    path = tmp_path / "s" / "lod-meta.json"
    save_scene(scene.take(slice(0, 20)), path)
    shares: list[float] = []
    with pytest.raises(Cancelled):
        progress = Progress(report=shares.append, cancelled=lambda: bool(shares) and shares[-1] > 0.5)
        save_scene(scene, path, progress=progress)
    assert len(load_scene(path)) == 20 and [*tmp_path.iterdir()] == [tmp_path / "s"]


@pytest.mark.skipif(os.name != "posix", reason="folders are locked on POSIX alone")
def test_what_a_kill_left_is_removed_by_the_next_write(scene, tmp_path):
    left, other = tmp_path / ".s.0123abcd.tmp", tmp_path / ".t.0123abcd.tmp"
    for folder in (left, other):
        folder.mkdir()
        (folder / "quats.webp").write_bytes(b"half")
        before = time.time() - 60
        os.utime(folder, (before, before))
    save_scene(scene, tmp_path / "s" / "meta.json")
    assert not left.exists() and other.exists()


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("out.spz", "out.spz"),
        ("out/", "out/meta.json"),
        ("out", "out/meta.json"),
        ("out.d/", "out.d/meta.json"),
        ("there.d", "there.d/meta.json"),
        ("out/lod-meta.json", "out/lod-meta.json"),
    ],
)
def test_names_of_folders(tmp_path, monkeypatch, text, wanted):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.d").mkdir()
    assert named_output(text) == Path(wanted)
