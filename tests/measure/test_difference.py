"""Maps of differences: what must hold whatever the pictures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from splatview.measure.metrics import FARTHEST, blurred, heat, lab, perceptual_map, signed_map

PICTURES = arrays(np.float64, (6, 7, 3), elements=st.floats(0, 1, width=32))


def flat(*rgb: float, size: tuple[int, int] = (24, 24)) -> np.ndarray:
    return np.broadcast_to(np.array(rgb, np.float64), (*size, 3)).copy()


@settings(max_examples=40, deadline=None)
@given(PICTURES, PICTURES)
def test_equal_pictures_differ_nowhere_and_order_does_not_matter(x, y):
    assert perceptual_map(x, x).max() == 0
    assert (signed_map(x, x) == 0.5).all()
    forth, back = perceptual_map(x, y), perceptual_map(y, x)
    np.testing.assert_allclose(forth, back, atol=1e-12)
    assert forth.min() >= 0 and forth.max() <= 1
    np.testing.assert_allclose(signed_map(x, y) + signed_map(y, x), 1, atol=1e-12)


def test_the_signed_map_is_brighter_where_the_picture_is_too_bright():
    made = signed_map(flat(0.6, 0.5, 0.4), flat(0.5, 0.5, 0.5), gain=2)
    np.testing.assert_allclose(made, flat(0.6, 0.5, 0.4))
    assert signed_map(flat(1, 1, 1), flat(0, 0, 0), gain=50).max() == 1


def test_a_greater_difference_is_noticed_more():
    grey = flat(0.5, 0.5, 0.5)
    noticed = [perceptual_map(grey + step, grey).mean() for step in (0, 0.01, 0.05, 0.2, 0.5)]
    assert noticed == sorted(noticed) and noticed[1] > 0


def test_blue_against_green_is_the_farthest():
    assert perceptual_map(flat(0, 0, 1), flat(0, 1, 0)) == pytest.approx(1)
    assert perceptual_map(flat(0, 0, 0), flat(1, 1, 1)).max() < 1


def test_black_against_white_by_hand():
    """Lightness differs by 100 and colour not at all."""
    assert perceptual_map(flat(0, 0, 0), flat(1, 1, 1)) == pytest.approx((100 / FARTHEST) ** 0.7, abs=1e-6)


def test_what_is_too_fine_to_see_is_noticed_less():
    grey = flat(0.5, 0.5, 0.5, size=(48, 48))
    rows, columns = np.indices((48, 48))
    fine = grey + 0.2 * np.where((rows + columns) % 2, 1, -1)[..., None]
    broad = grey + 0.2 * np.where((columns // 24) % 2, 1, -1)[..., None]
    assert perceptual_map(fine, grey).mean() < 0.6 * perceptual_map(broad, grey).mean()
    nearer = perceptual_map(fine, grey, pixels_per_degree=20).mean()
    assert nearer > perceptual_map(fine, grey).mean(), "seen from near, it can be resolved"


def test_white_is_white():
    np.testing.assert_allclose(lab(np.ones(3)), [100, 0, 0], atol=1e-9)


def test_blurring_keeps_what_is_even_and_the_sum_of_a_point():
    np.testing.assert_allclose(blurred(np.full((9, 5), 0.3), 1.7), 0.3)
    point = np.zeros((21, 21))
    point[10, 10] = 1
    assert blurred(point, 1.5).sum() == pytest.approx(1) and blurred(point, 1.5)[10, 10] < 0.1


def test_heat_grows_brighter_and_marks_what_is_no_number():
    ramp = heat(np.linspace(0, 1, 50)[None])[0]
    assert (np.diff(ramp @ [0.2126, 0.7152, 0.0722]) > 0).all()
    assert (heat(np.array([[np.nan]])) == 1).all()


def test_pictures_of_two_sizes_are_refused():
    with pytest.raises(ValueError, match="differ in size: 2x3 and 3x2"):
        perceptual_map(np.zeros((3, 2, 3)), np.zeros((2, 3, 3)))
