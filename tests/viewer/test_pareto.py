"""The plot of the Accuracy page: its axes."""

from __future__ import annotations

import math

import pytest

from splatview.viewer.panels.pareto import MOST_TICKS, limits, ticks


class Place:
    def __init__(self, ms: float, db: float):
        self.ms, self.db = ms, db


def test_one_slow_shortcut_does_not_press_the_others_together():
    places = [Place(ms, 40) for ms in (5, 10, 20, 400)]
    left, right, bottom, top = limits(places)  # pyright: ignore[reportArgumentType]
    assert left < 5 and right > 400 and bottom < 40 < top
    share = (math.log(20) - math.log(5)) / (math.log(right) - math.log(left))
    assert share > 0.2, "on an even axis they would share 4 % of the width"


def test_one_mark_alone_has_room():
    left, right, bottom, top = limits([Place(16, 60)])  # pyright: ignore[reportArgumentType]
    assert left < 16 < right and bottom < 60 < top


@pytest.mark.parametrize(("left", "right"), [(14, 19), (3, 60), (0.002, 900), (9.9, 10.1), (41, 58)])
def test_numbers_on_the_axis_are_few_and_within(left, right):
    found = ticks(left, right)
    assert len(found) <= MOST_TICKS and found == sorted(found)
    assert all(left <= value <= right for value in found)
    assert found, (left, right)
