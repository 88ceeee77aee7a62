"""Captures of the bench: which photos are held out, and what is a part of what."""

from __future__ import annotations

import numpy as np
import pytest
from capture_set import DRIFTING, EVERY, NAMES, PARTS, REAL, SPLITS, part_of, split_of, use_of
from public_captures import PUBLIC

from splatview.scene.captures.capture import Capture
from splatview.scene.captures.demo import demo_capture, demo_truth


@pytest.fixture(scope="module")
def capture() -> Capture:
    """21 photos, one after another on a way around the demo."""
    grey = np.full((12, 16, 4), 0.5, np.float32)
    return demo_capture(lambda *_: grey, photos=21, width=16, height=12, truth=demo_truth(500))


def test_one_of_8_photos_is_held_out_as_by_the_command(capture: Capture):
    as_the_command_does = [photo.held_out for photo in capture.photos]
    assert [photo.held_out for photo in split_of(capture, 0, EVERY).photos] == as_the_command_does
    for split in range(SPLITS):
        held = [row for row, photo in enumerate(split_of(capture, split, EVERY).photos) if photo.held_out]
        assert held == list(range(split, 21, 8))


def test_each_photo_is_held_out_in_one_of_three_thirds(capture: Capture):
    thirds = [{photo.name for photo in split_of(capture, split).held_out} for split in range(SPLITS)]
    assert [len(third) for third in thirds] == [7, 7, 7] and len(set.union(*thirds)) == 21


def test_a_part_is_of_photos_near_one_another_or_far_apart(capture: Capture):
    def least_distances(part: Capture) -> np.ndarray:
        eyes = np.array([photo.camera.eye for photo in part.photos])
        apart = np.linalg.norm(eyes[:, None] - eyes, axis=2) + np.diag(np.full(len(eyes), np.inf))
        return apart.min(axis=1)

    far, near = (part_of(capture, 6, spread) for spread in ("far", "near"))
    assert len(far.photos) == len(near.photos) == 6
    assert least_distances(far).min() > 2 * np.median(least_distances(near))
    for part in (far, near):
        assert [photo.name for photo in part.photos] == sorted(photo.name for photo in part.photos)


def test_parts_are_of_captures_that_there_are():
    for name, part in PARTS.items():
        assert part.whole in REAL or part.whole in PUBLIC
        assert use_of(name) == part.use and name in NAMES
        assert (name in DRIFTING) == (part.whole != "banana")
    assert "demo drift 40" in DRIFTING and not {"lego", "banana", "demo lens 40"} & set(DRIFTING)
