"""The size that photos are trained on where nobody says, by time, memory and what is looked at."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from splatview.cli.main import main
from splatview.scene import InputError
from splatview.scene.captures import load_capture
from splatview.scene.progress import NO_PROGRESS
from splatview.trainer.checkpoint import load_checkpoint
from splatview.trainer.memory import PhotoSizes
from splatview.trainer.photo_size import (
    HALF_THE_SIZE,
    LARGEST_SIDE,
    SMALLEST_SIDE,
    SizeChoice,
    automatic_downscale,
    automatic_levels,
    pixels_for,
)

PHONE, MIKU, BANANA = (4032, 3024), (981, 735), (750, 498)

SIZES = st.lists(st.tuples(st.integers(8, 12_000), st.integers(8, 12_000)), min_size=1, max_size=4)
MINUTES = st.floats(0.01, 1000) | st.none()


@given(sizes=SIZES, minutes=MINUTES, threads=st.integers(1, 64))
def test_photos_are_neither_larger_than_looked_at_nor_too_small_to_learn_from(sizes, minutes, threads):
    factor = automatic_downscale(sizes, minutes, threads)
    assert factor >= 1
    if factor > 1:
        assert min(map(min, sizes)) // factor >= SMALLEST_SIDE
    no_smaller = min(map(min, sizes)) // (factor + 1) < SMALLEST_SIDE
    assert max(map(max, sizes)) / factor <= LARGEST_SIDE or no_smaller
    smaller = [(w // factor, h // factor) for w, h in sizes]
    levels = automatic_levels(smaller, minutes, threads)
    shares, factors = zip(*levels, strict=True)
    assert list(shares) == sorted(shares) and shares[0] > 0 and shares[-1] < 1
    assert list(factors) == sorted(factors, reverse=True) and factors[-1] > 1
    if levels != HALF_THE_SIZE:
        assert min(map(min, smaller)) // factors[0] >= SMALLEST_SIDE


@given(sizes=SIZES, minutes=st.floats(0.01, 1000), more=st.floats(1, 100), threads=st.integers(1, 64))
def test_more_time_or_cores_make_photos_no_smaller(sizes, minutes, more, threads):
    now = automatic_downscale(sizes, minutes, threads)
    assert automatic_downscale(sizes, minutes * more, threads) <= now
    assert automatic_downscale(sizes, minutes, threads + 1) <= now
    assert automatic_downscale(sizes, None, threads) <= now


@given(
    width=st.integers(400, 12_000),
    ratio=st.floats(0.7, 1),
    minutes=st.floats(1, 1000),
    threads=st.integers(1, 8),
)
def test_most_of_a_run_is_on_photos_that_there_is_time_for(width, ratio, minutes, threads):
    size = width, round(width * ratio)
    factor = automatic_downscale([size], minutes, threads)
    smaller = size[0] // factor, size[1] // factor
    of_the_main = dict(automatic_levels([smaller], minutes, threads)).get(0.8, 1)
    side = math.sqrt(math.prod(smaller)) / of_the_main
    # Factors are whole: one and a half are one.
    assert side <= 1.51 * math.sqrt(pixels_for(minutes, threads))


def test_photos_of_the_bench_are_as_they_were_chosen_for():
    """Two cores; photos that minutes have steps enough for are trained on as ever."""
    assert automatic_downscale([MIKU], 1, 2) == automatic_downscale([BANANA], 1, 2) == 1
    assert automatic_levels([(245, 183)], 1, 2) == automatic_levels([(375, 249)], 1, 2) == HALF_THE_SIZE
    assert automatic_levels([MIKU], 1, 2) == ((0.3, 6), (0.8, 3))
    assert automatic_levels([BANANA], 1, 2) == ((0.3, 4), (0.8, 2))
    assert automatic_levels([MIKU], None, 2) == HALF_THE_SIZE
    assert automatic_downscale([PHONE], 1, 2) == 4 and automatic_downscale([PHONE], None, 2) == 3


def pretend_room(pixels: int):
    """Room for so many pixels of photos."""

    def room_for(sizes: PhotoSizes, *, points: int) -> None:
        if sizes.pixels > pixels:
            raise InputError("no room")

    return room_for


@pytest.fixture
def phone_capture(capture_folder: Path, tmp_path: Path) -> Path:
    """The capture with photos of 4 megapixels, as JPEG in part: not as they are, but as they may come."""
    folder = tmp_path / "phone"
    shutil.copytree(capture_folder, folder)
    text = folder / "sparse" / "0" / "cameras.txt"
    lines = [line.split() for line in text.read_text().splitlines() if not line.startswith("#")]
    grown = []
    for number, model, *rest in lines:
        grown.append(" ".join([number, model, *(str(48 * float(x)).removesuffix(".0") for x in rest)]))
    text.write_text("\n".join(grown) + "\n")
    for path in (folder / "images").iterdir():
        with Image.open(path) as image:
            large = image.resize((48 * image.width, 48 * image.height), Image.Resampling.BICUBIC)
        large.save(path, compress_level=1)
    return folder


def posed(folder: Path):
    from splatview.scene.captures import read_poses

    return read_poses(folder, NO_PROGRESS)[1]


def test_memory_makes_photos_smaller_than_time_does(phone_capture: Path):
    capture = posed(phone_capture)
    width, height = capture.entries[0].camera.width, capture.entries[0].camera.height
    assert max(width, height) == 2304
    plenty = SizeChoice(None, None, 2, pretend_room(10**9))
    assert plenty(capture) == 2 and "1600 px are the most" in plenty.line
    tight = SizeChoice(None, None, 2, pretend_room(len(capture.entries) * (width // 5) * (height // 5)))
    assert tight(capture) == 5 and "memory for no more" in tight.line
    asked = SizeChoice(2, None, 2, pretend_room(10**6))
    with pytest.raises(InputError, match="no room"):
        asked(capture)
    with pytest.raises(InputError, match="no room"):
        SizeChoice(None, None, 2, pretend_room(10))(capture)


def test_a_short_run_on_large_photos(phone_capture: Path, tmp_path: Path, capsys):
    """Photos of 4 megapixels on which a step would take half a second: said, kept by the checkpoint, and the
    end of the run is on larger ones than its beginning."""
    output, metrics = tmp_path / "toy.ply", tmp_path / "m.jsonl"
    begin = ["train", str(phone_capture), "--headless", "-o", str(output), "--metrics", str(metrics)]
    assert main([*begin, "--minutes", "0.5", "--iterations", "12", "--threads", "2"]) == 0
    printed = capsys.readouterr()
    said = " ".join((printed.out + printed.err).split())
    checkpoint = load_checkpoint(tmp_path / "toy.checkpoint.safetensors")
    factor = checkpoint.notes["downscale"]
    size = f"{2304 // factor}x{1920 // factor}"
    assert (
        factor == 3 and f"photos of 2304x1920 px are trained on at {size}: --minutes 0.5 has no time" in said
    )
    assert checkpoint.settings.resolution == ((0.3, 6), (0.8, 3))
    steps = [json.loads(line)["iteration"] for line in metrics.read_text().splitlines()]
    with Image.open(next((tmp_path / "toy-held-out").glob("*.png"))) as picture:
        assert picture.size == (3 * (2304 // factor), 1920 // factor)
    resume = ["--resume", str(tmp_path / "toy.checkpoint.safetensors"), "--iterations", str(steps[-1] + 2)]
    assert main([*begin, *resume]) == 0
    assert load_checkpoint(tmp_path / "toy.checkpoint.safetensors").notes["downscale"] == factor


def test_a_capture_of_its_own_size_is_left_alone(capture_folder: Path):
    capture = posed(capture_folder)
    choice = SizeChoice(None, 0.5, 1, pretend_room(10**9))
    assert choice(capture) == 1 and choice.line == ""
    photos = load_capture(capture_folder, downscale=choice).photos
    assert {(p.camera.width, p.camera.height) for p in photos} == {(48, 40)}
