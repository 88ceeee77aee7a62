"""Enlarging is what a GPU's linear filter does."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.measure.metrics import enlarged, reduced_size


def test_a_ramp_stays_a_ramp_but_for_the_border():
    ramp = np.broadcast_to(np.arange(8, dtype=np.float32)[None, :, None], (4, 8, 4))
    big = enlarged(ramp, 24, 12)
    assert big.shape == (12, 24, 4) and big.dtype == np.float32
    expected = np.clip((np.arange(24) + 0.5) / 3 - 0.5, 0, 7)
    np.testing.assert_allclose(big[5, :, 0], expected, atol=1e-6)


def test_the_same_size_is_the_same_picture():
    picture = np.random.default_rng(0).random((5, 7, 4)).astype(np.float32)
    assert enlarged(picture, 7, 5) is picture


def test_a_single_pixel_fills_everything():
    assert (enlarged(np.full((1, 1, 4), 0.25, np.float32), 9, 3) == 0.25).all()


@pytest.mark.parametrize(("share", "size"), [(0.5, (320, 180)), (0.25, (160, 90)), (1e-6, (1, 1))])
def test_reduced_sizes(share, size):
    assert reduced_size(640, 360, share) == size
