"""The demo capture: what it shows is the truth, and its points lie on it."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.raster import render
from splatview.scene import InputError
from splatview.scene.captures.demo import OUTLIERS, demo_capture, demo_truth
from splatview.scene.progress import Progress

SPLATS = 20_000


@pytest.fixture(scope="module")
def capture():
    return demo_capture(render, photos=10, width=96, height=72, splats=SPLATS)


def test_photos_are_the_truth_from_their_cameras(capture):
    truth = demo_truth(SPLATS)
    for photo in capture.photos[::4]:
        picture = np.clip(render(truth, photo.camera)[..., :3], 0, 1)
        assert np.abs(photo.image() / 255 - picture).max() < 0.003
        # A scene, not a wall before the lens.
        assert photo.image().std() > 25
    assert [photo.held_out for photo in capture.photos] == [i % 8 == 0 for i in range(10)]
    assert [photo.camera.name for photo in capture.photos] == sorted(photo.name for photo in capture.photos)


def test_equal_arguments_give_equal_captures(capture):
    again = demo_capture(render, photos=10, width=96, height=72, splats=SPLATS)
    np.testing.assert_array_equal(capture.points, again.points)
    np.testing.assert_array_equal(capture.photos[5].image(), again.photos[5].image())
    other = demo_capture(render, photos=2, width=16, height=12, splats=SPLATS, seed=1)
    assert not np.array_equal(capture.points, other.points)


def test_points_lie_on_the_truth(capture):
    """All but the wrong matches."""
    assert 3000 < len(capture.points) <= 6000
    assert np.isfinite(capture.points).all()
    truth = demo_truth(SPLATS).means
    some = capture.points[::40]
    nearest = np.array([np.linalg.norm(truth - point, axis=1).min() for point in some])
    depth = np.linalg.norm(some - capture.photos[5].camera.eye, axis=1)
    assert (nearest < 0.02 * depth).mean() > 0.97 - OUTLIERS


def test_one_photo_is_refused():
    with pytest.raises(InputError, match="two photos"):
        demo_capture(render, photos=1)


def test_progress():
    shares: list[float] = []
    demo_capture(render, photos=4, width=16, height=12, splats=2000, progress=Progress(report=shares.append))
    assert shares == [0.25, 0.5, 0.75, 1.0]
