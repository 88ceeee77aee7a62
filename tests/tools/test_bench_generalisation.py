"""The table of the bench over many captures: whose mean is whose, and which rows more time makes worse."""

from __future__ import annotations

import pytest
from bench_generalisation import mean_of_splits, table_by_marks, table_of_fits, worse_with_time


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
    (row,) = table_by_marks(runs, ["now"])["rows"]
    assert row[3:] == ["2 (3 runs)", "25.25", "25.00", "-0.25", ""]
    (line,) = worse_with_time(runs, "now")
    assert line.startswith("now: biker front 24: -0.25 dB")
    only_first = {key: figures for key, figures in runs.items() if key[2] == 0}
    assert worse_with_time(only_first, "now") == []


def test_fits_of_checkouts_with_other_seeds():
    """Each checkout by its own runs; a mark that one of them has not run has no row."""
    runs = dict([run(0, 1, 0, 30.0), run(1, 1, 0, 20.0), run(1, 1, 1, 22.0), run(0, 3, 0, 31.0)])
    for figures in runs.values():
        figures["psnr_fitted"] = figures["psnr_plain"] + 1
    before = run(0, 1, 0, 24.0)[1] | {"psnr_fitted": 24.5}
    runs["first", "biker front 24", 0, 1, 0] = before
    (row,) = table_of_fits(runs, ["first", "now"])["rows"]
    assert row[3:] == ["1", "1, 2 (3 runs)", "24.50, 24.00", "26.50, 25.50", "+2.00, +1.50"]
