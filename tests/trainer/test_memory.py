"""Memory of a run: stated before it begins, bounded by a setting, and told apart from what does not fit."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from splatview.cli.main import main
from splatview.scene import InputError
from splatview.scene.captures import load_capture
from splatview.trainer import memory as memories
from splatview.trainer.checkpoint import load_checkpoint
from splatview.trainer.memory import (
    Bound,
    Machine,
    PhotoSizes,
    RunMemory,
    check_fits,
    plan,
    run_memory,
    sizes_of_capture,
)
from splatview.trainer.recipe import LEAST_LIMIT
from splatview.trainer.settings import TrainSettings
from splatview.trainer.setup import settings_for
from splatview.trainer.views import TrainViews, train_views

SIZES = PhotoSizes(pixels=10_000_000, trained=9_000_000, largest=200_000, stored=800_000)
MACHINE = Machine(left=8 << 30, threads=2, compiles=False)


def estimate(sizes: PhotoSizes = SIZES, machine: Machine = MACHINE, **options: Any) -> RunMemory:
    return run_memory(sizes, **{"resolution": TrainSettings.resolution, "machine": machine, **options})


def test_more_of_anything_takes_more_memory() -> None:
    counts = [0, 1, 2000, 50_000, 200_000, 2_000_000]
    peaks = [estimate().peak(count) for count in counts]
    assert peaks == sorted(set(peaks))
    base = estimate().peak(50_000)
    for larger in ({"pixels": 20_000_000}, {"trained": 20_000_000}, {"largest": 400_000}, {"planes": 4}):
        assert estimate(replace(SIZES, **larger)).peak(50_000) > base, larger
    runs: list[dict[str, Any]] = [{"window": True}, {"batch": 2}, {"stereo": True}]
    for options in runs:
        assert estimate(**options).peak(50_000) > base, options
    machines: list[dict[str, Any]] = [{"compiles": True}, {"threads": 64}]
    for other in machines:
        assert estimate(machine=replace(MACHINE, **other)).peak(50_000) > base, other
    assert estimate(sh_degree=0).peak(50_000) < base
    assert estimate(resolution=()).peak(50_000) < base < estimate(resolution=[(0.5, 1.5)]).peak(50_000)


def test_what_is_counted_of_photos_and_splats_is_what_they_are() -> None:
    added = estimate(replace(SIZES, pixels=11_000_000)).photos - estimate().photos
    assert added == 3e6, "three bytes of each pixel"
    added = estimate().peak(1_000_001) - estimate().peak(1_000_000)
    assert added > 4 * 59 * 4, "parameters, two averages and a gradient of 59 numbers"


@pytest.mark.parametrize("bound", [0.7e9, 1e9, 3.5e9, 1e12])
def test_the_most_splats_are_those_that_just_fit(bound: float) -> None:
    memory = estimate()
    most = memory.most_splats(bound)
    assert memory.peak(most) <= bound < memory.peak(most + 1)


def test_where_nothing_fits_there_is_one_clear_line() -> None:
    memory = estimate()
    check_fits(memory, Bound(bytes=memory.peak(LEAST_LIMIT), asked=True), LEAST_LIMIT, "they", "{}")
    for bytes_ in (memory.peak(LEAST_LIMIT) - 1, 1):
        with pytest.raises(InputError, match=r"photos need about .* MiB of memory, .* allows .*; with 5"):
            bound = Bound(bytes=bytes_, asked=True)
            check_fits(memory, bound, LEAST_LIMIT, "the photos", "with 5, or {}")
    assert memory.most_splats(1) == 0


def test_a_plan_says_what_the_bound_changes_and_nothing_else() -> None:
    memory = estimate()
    free = plan(memory, Bound(bytes=8 << 30, asked=False), 50_000)
    assert free.splats == 50_000 and free.peak == memory.peak(50_000)
    assert "become" not in free.line and "allow" not in free.line and "50,000 splats" in free.line
    bound = Bound(bytes=memory.peak(20_000), asked=True)
    bounded = plan(memory, bound, 50_000)
    assert bounded.splats == bounded.most == 20_000
    assert "--memory allows" in bounded.line and "50,000 splats become 20,000" in bounded.line
    left = plan(memory, replace(bound, asked=False), 50_000)
    assert "this machine has" in left.line and "50,000 splats become 20,000" in left.line


def test_processes_of_a_run_go_by_the_least_of_their_machines() -> None:
    small = Machine(left=1 << 30, threads=1, compiles=False)
    many = Machine(left=4 << 30, threads=16, compiles=True)
    assert Machine.least([small, many]) == Machine(left=1 << 30, threads=16, compiles=True)
    here, shared = Machine.here(), Machine.here(processes=4)
    assert 0 < shared.left < here.left


def test_a_machine_that_tells_nothing_has_some_memory(monkeypatch) -> None:
    monkeypatch.setattr(memories, "resident_memory", lambda: None)
    monkeypatch.setattr(memories, "free_memory", lambda: 4 << 30)
    assert Machine.here(threads=3).left == int(0.9 * (4 << 30)) and Machine.here(threads=3).threads == 3


@pytest.fixture
def needed(capture_folder: Path) -> Callable[[int], int]:
    """Megabytes that a run on the toy with so many splats takes, rounded up."""
    sizes = sizes_of_capture(load_capture(capture_folder))

    def megabytes(splats: int) -> int:
        return -(-estimate(sizes, Machine.here(threads=2)).peak(splats) // 1_000_000)

    return megabytes


def train(capture: Path, output: Path, *options: str) -> int:
    given = ["--headless", "--threads", "2", "-o", str(output), "--metrics", f"{output}.jsonl"]
    return main(["train", str(capture), *given, *options])


def test_a_recipe_of_ones_own_is_bounded_alike(capture_folder: Path, needed) -> None:
    capture = load_capture(capture_folder)
    views = TrainViews(train_views(capture.train), 0)
    free = settings_for(capture, views, max_splats=100_000)
    assert free.max_splats == 100_000
    bounded = settings_for(capture, views, max_splats=100_000, memory=1_000_000 * needed(5000))
    assert 5000 <= bounded.max_splats < 5500 and replace(bounded, max_splats=100_000) == free
    with pytest.raises(InputError, match=r"give it .*MB or more"):
        settings_for(capture, views, memory=1000)


def test_a_run_stays_within_its_bound_when_resumed_too(
    capture_folder: Path, tmp_path: Path, capsys, needed, monkeypatch
) -> None:
    monkeypatch.setattr("splatview.cli.train_setup.LEAST_LIMIT", 50)
    output, checkpoint = tmp_path / "toy.ply", str(tmp_path / "toy.checkpoint.safetensors")
    options = ("--iterations", "400", "--max-splats", "100000", "--memory", f"{needed(100)}MB")
    assert train(capture_folder, output, *options) == 0
    lines = [json.loads(line) for line in Path(f"{output}.jsonl").read_text().splitlines()]
    most = lines[0]["memory"]["splats"]
    assert 100 <= most < 500 and lines[0]["memory"]["bytes"] <= lines[0]["memory"]["bound"]
    counts = [line["gaussians"] for line in lines if "gaussians" in line]
    # Up to some that had no splat to share with, see `LEAST_SHARED`.
    assert 0.9 * most < max(counts) <= most, "it grows as far as it may, and no farther"
    printed = capsys.readouterr().err
    assert printed.count("memory: about") == 1 and f"100,000 splats become {most:,} at most" in printed

    more = ("--resume", checkpoint, "--iterations", "410")
    assert train(capture_folder, output, *more) == 0, "the bound is the checkpoint's"
    assert load_checkpoint(Path(checkpoint)).settings.max_splats == most
    assert "--memory allows" in capsys.readouterr().err


def test_a_checkpoint_that_does_not_fit_is_refused(
    capture_folder: Path, tmp_path: Path, capsys, needed
) -> None:
    output, checkpoint = tmp_path / "toy.ply", str(tmp_path / "toy.checkpoint.safetensors")
    assert train(capture_folder, output, "--iterations", "3") == 0
    before = Path(checkpoint).read_bytes()
    capsys.readouterr()
    resume = ("--resume", checkpoint, "--iterations", "6", "--memory")
    assert train(capture_folder, output, *resume, "100MB") == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"{checkpoint}: its photos and 60 splats need about" in line and "resume with --memory" in line
    assert Path(checkpoint).read_bytes() == before
    assert train(capture_folder, output, *resume, f"{needed(60)}MB") == 0


def test_too_little_memory_ends_in_one_line_before_photos_are_read(
    capture_folder: Path, tmp_path: Path, capsys, needed
) -> None:
    for photo in (capture_folder / "images").iterdir():
        photo.write_bytes(b"nobody reads this")
    least = needed(LEAST_LIMIT)
    assert train(capture_folder, tmp_path / "toy.ply", "--iterations", "5", "--memory", "0.2GB") == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "need about" in line and "--memory allows 190.7 MiB" in line
    found = re.search(r"use a larger --downscale, or --memory (\d+)MB or more$", line)
    assert found and least - 1 <= int(found[1]) <= least, "smaller copies are not known yet"
    assert not list(tmp_path.glob("*.ply*"))


@pytest.mark.parametrize("size", ["2", "0GB", "-1GB", "many", "nanGB", "2 dB"])
def test_sizes_that_are_none_are_refused(capture_folder: Path, tmp_path: Path, capsys, size: str) -> None:
    assert train(capture_folder, tmp_path / "toy.ply", "--memory", size) == 2
    assert "must be a size such as 2GB" in capsys.readouterr().err


def test_splats_beyond_the_memory_cannot_be_asked_for_on_the_way(make_trainer) -> None:
    trainer = make_trainer()
    trainer.most_splats = 400
    trainer.change(max_splats=400)
    for wrong in (401, 10**9):
        with pytest.raises(ValueError, match="max_splats must be at most 400"):
            trainer.change(max_splats=wrong)
    assert trainer.settings.max_splats == 400
