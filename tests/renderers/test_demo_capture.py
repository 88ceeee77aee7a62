"""`splatview train --demo`: photos that the program makes once, and a run on them."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np
import pytest

from splatview.cli import train_setup
from splatview.cli.main import main
from splatview.raster import render
from splatview.renderers import demo_cache as module
from splatview.scene import Gaussians, InputError
from splatview.scene.captures import load_capture
from splatview.scene.captures.demo import demo_capture, demo_truth
from splatview.scene.formats import load_scene
from splatview.scene.progress import Progress


@functools.cache
def small_truth() -> Gaussians:
    return demo_truth(3000)


@pytest.fixture
def small_demo(monkeypatch, tmp_path: Path) -> list[int]:
    """The demo with 3,000 splats and ten small photos, a cache of the test's own, and a count of makings."""
    made = []

    def make():
        made.append(1)
        return small_truth()

    monkeypatch.setattr(module, "cached_demo", make)
    monkeypatch.setattr(module, "PHOTOS", 10)
    monkeypatch.setattr(module, "WIDTH", 48)
    monkeypatch.setattr(module, "HEIGHT", 36)
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", str(tmp_path / "cache"))
    return made


def test_what_is_read_back_is_what_was_made(small_demo: list[int]) -> None:
    shares: list[float] = []
    folder = module.cached_demo_capture(progress=Progress(report=shares.append))
    assert shares == sorted(shares) and shares[-1] == 1
    made = demo_capture(render, photos=10, width=48, height=36, splats=3000)
    read = load_capture(folder)
    assert read.name == "demo" and read.warnings == ()
    assert [photo.held_out for photo in read.photos] == [photo.held_out for photo in made.photos]
    for ours, theirs in zip(read.photos, made.photos, strict=True):
        np.testing.assert_array_equal(ours.image(), theirs.image())
        np.testing.assert_allclose(
            ours.camera.world_to_camera, theirs.camera.world_to_camera, rtol=0, atol=1e-12
        )
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(ours.camera, name) == getattr(theirs.camera, name)
    np.testing.assert_allclose(read.points, made.points, atol=1e-6)
    np.testing.assert_array_equal(read.point_colours, made.point_colours)


def test_it_is_made_once_and_older_versions_go(small_demo: list[int], tmp_path: Path) -> None:
    old = tmp_path / "cache" / "demo-photos-0000000000000000"
    old.mkdir(parents=True)
    first = module.cached_demo_capture()
    assert module.cached_demo_capture() == first
    assert len(small_demo) == 1 and not old.exists()
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [first.parent.name]


def test_half_a_folder_is_made_again(small_demo: list[int]) -> None:
    folder = module.cached_demo_capture()
    (folder / "transforms.json").unlink()
    assert len(load_capture(module.cached_demo_capture()).photos) == 10
    assert len(small_demo) == 2


def test_two_processes_at_once(small_demo: list[int], monkeypatch) -> None:
    """Another makes the folder while this one renders."""
    save = module.save_capture

    def slower(capture, folder) -> None:
        save(capture, folder)
        with monkeypatch.context() as patch:
            patch.setattr(module, "save_capture", save)
            module.cached_demo_capture()

    monkeypatch.setattr(module, "save_capture", slower)
    assert len(load_capture(module.cached_demo_capture()).photos) == 10


def test_a_cache_that_cannot_be_written_is_one_line(small_demo: list[int], tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file in the way")
    with pytest.raises(InputError, match=r"cannot be written: .*SPLATVIEW_CACHE_DIR names another place"):
        module.cached_demo_capture()
    assert not small_demo, "told before half a minute's work"


def test_training_on_it(small_demo: list[int], tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["train", "--demo", "--headless", "--iterations", "150", "--metrics", "m.jsonl"]
    assert main(options) == 0
    assert len(load_scene("demo.ply")) > 500
    first, *_, last = map(json.loads, Path("m.jsonl").read_text().splitlines())
    assert last["iteration"] == 150 and last["loss"] < first["loss"]
    assert last["psnr"] > 18
    assert "demo: 8 photos to train on, 2 held out, 48x36 px" in capsys.readouterr().err
    goal = ["--resume", "demo.checkpoint.safetensors", "--iterations", "152"]
    assert main(["train", "--demo", "--headless", *goal]) == 0


def test_making_the_photos_counts_against_no_budget(
    small_demo: list[int], tmp_path: Path, monkeypatch, capsys
) -> None:
    """A budget of minutes is of training, on the first day too."""
    monkeypatch.chdir(tmp_path)
    clock = train_setup.time.perf_counter
    late = [0.0]
    make = module.cached_demo

    def slow():
        late[0] = 1000.0
        return make()

    monkeypatch.setattr(module, "cached_demo", slow)
    monkeypatch.setattr(train_setup.time, "perf_counter", lambda: clock() + late[0])
    monkeypatch.setattr("splatview.cli.train.process_age", lambda: 0.0)
    assert main(["train", "--demo", "--headless", "--minutes", "0.05", "--metrics", "m.jsonl"]) == 0
    last = json.loads(Path("m.jsonl").read_text().splitlines()[-1])
    assert last["seconds"] < 60
