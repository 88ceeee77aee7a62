"""The table of the bench over many captures: whose mean is whose, and which rows more time makes worse."""

from __future__ import annotations

import pytest
from bench_generalisation import mean_of_splits, tables, worse_with_time


def run(split: int, minutes: float, seed: int, psnr: float) -> tuple:
    """A run of the checkout "now" on a capture that is measured as it is."""
    figures = {"capture": "biker front 24", "photos": 16, "psnr_plain": psnr, "haze": None}
    return ("now", "biker front 24", split, minutes, seed), figures


def test_a_split_of_more_seeds_does_not_weigh_more():
    assert mean_of_splits([(0, 0), (1, 0), (1, 1), (1, 2)], [30.0, 20.0, 21.0, 22.0]) == pytest.approx(25.5)


def test_row_and_loss_by_splits():
    runs = dict(
        [
            *(run(0, minutes, 0, psnr) for minutes, psnr in ((1, 30.0), (3, 31.0))),
            *(run(1, minutes, 0, psnr) for minutes, psnr in ((1, 20.0), (3, 18.0))),
            *(run(1, minutes, 1, psnr) for minutes, psnr in ((1, 21.0), (3, 20.0))),
        ]
    )
    (row,) = tables(runs, ["now"], by_marks=True)["rows"]
    assert row[3:] == ["2 (3 runs)", "25.25", "25.00", "-0.25", ""]
    (line,) = worse_with_time(runs, "now")
    assert line.startswith("now: biker front 24: -0.25 dB")
    only_first = {key: figures for key, figures in runs.items() if key[2] == 0}
    assert worse_with_time(only_first, "now") == []
