"""Tables in README.md and docs/ are made from the committed JSON and agree with it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bench_ladder import ladder_table, training_table
from benchmark_docs import fill, main

from splatview.measure.knobs import KNOBS
from splatview.measure.machine import FOLDER, write_results

ROOT = Path(__file__).parents[2]
RESULTS = {"table": {"columns": ["what", "ms"], "rows": [["sort", 1.5], ["draw", 20]], "note": "Medians."}}


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))], ids=lambda p: p.name)
def test_pages_agree_with_their_json(page):
    assert main(["--check", str(page)]) == 0, "run `make tables`"


def test_every_measured_table_is_on_a_page():
    pages = "".join(page.read_text() for page in ROOT.glob("docs/*.md"))
    for path in sorted((ROOT / FOLDER).glob("*.json")):
        if "table" in json.loads(path.read_text()):
            assert f"<!-- table: {path.stem} -->" in pages, f"{path.name} is on no page in full"


@pytest.mark.parametrize("name", ["skull", "playbot"])
def test_the_tables_of_accuracy_are_those_of_the_measurements(name):
    ladder = json.loads((ROOT / FOLDER / f"ladder_{name}.json").read_text())
    assert ladder["table"] == ladder_table(ladder), "the table is not of this measurement"
    bill = json.loads((ROOT / FOLDER / f"bill_{name}.json").read_text())
    assert bill["table"]["rows"] == bill["rows"]
    page = (ROOT / "docs" / "accuracy.md").read_text()
    assert f"(../assets/benchmarks/ladder_{name}.png)" in page
    assert (ROOT / FOLDER / f"ladder_{name}.png").read_bytes().startswith(b"\x89PNG")


def test_every_knob_is_on_the_page():
    section = fill("<!-- table: knobs -->\nold\n<!-- end of table -->", ROOT / FOLDER)
    for knob in KNOBS:
        line = next(line for line in section.splitlines() if line.startswith(f"| `{knob.option}` "))
        assert knob.changes in line and all(value.text in line for value in knob.values)


def test_figures_have_the_noise_floor_beside_them():
    rung = {
        "knob": "cut",
        "value": "3-sigma",
        "renderer": "cpu",
        "ms": 20.0,
        "ms_quartiles": [18.0, 24.0],
        "ratio": 0.8,
        "noise": 0.06,
        "psnr": 61.23,
        "ssim": None,
        "max_error": 0.0123,
        "popping": 0.002,
        "memory": 3 << 20,
        "clear": True,
        "pareto": True,
    }
    results = {
        "scene": "x.ply",
        "splats": 1000,
        "size": [64, 48],
        "baseline": {"renderer": "cpu"},
        "noise": 0.05,
        "views": 2,
        "rounds": 9,
        "truth": {"largest_difference_from_reference": 2e-15},
        "rungs": [rung, {**rung, "clear": False}],
        "left_out": [],
    }
    header, row, same = ladder_table(results)["rows"]
    assert header[0] == "**drawn by `cpu`**"
    assert row == [
        "`--cut 3-sigma`",
        "20.0 ±3.0",
        "0.80 ±6%",
        "61.2",
        "-",
        "0.012",
        "0.002",
        "3",
        "yes",
    ]
    assert same[2] == "same ±6%"


def test_fill_replaces_only_its_section(tmp_path):
    write_results(tmp_path / "frames.json", RESULTS)
    text = "before\n<!-- table: frames -->\nold\n<!-- end of table -->\nafter\n"
    filled = fill(text, tmp_path)
    assert filled.startswith(
        "before\n<!-- table: frames -->\n| what | ms |\n| --- | ---: |\n| sort | 1.5 |\n"
    )
    assert filled.endswith("<!-- end of table -->\nafter\n") and "old" not in filled and "Medians. " in filled
    assert fill(filled, tmp_path) == filled


def test_a_part_of_a_table_is_chosen_by_name(tmp_path):
    table = {**RESULTS["table"], "note": "Medians. More of it."}
    write_results(tmp_path / "frames.json", {"table": table})
    marker = "<!-- table: frames\ncolumns: ms; what\nrows: draw\n-->\n"
    filled = fill(f"{marker}old\n<!-- end of table -->", tmp_path)
    assert filled.startswith(f"{marker}| ms | what |\n| --- | ---: |\n| 20 | draw |\n\nMedians. Measured on")
    assert fill(filled, tmp_path) == filled
    for wrong in ("columns: s", "rows: sleep"):
        with pytest.raises(ValueError, match="not in list"):
            fill(f"<!-- table: frames\n{wrong}\n-->\n<!-- end of table -->", tmp_path)


def test_a_page_finds_the_results_from_its_folder(tmp_path):
    page = tmp_path / "docs" / "page.md"
    page.parent.mkdir()
    page.write_text("<!-- table: frames -->\n<!-- end of table -->\n")
    write_results(tmp_path / FOLDER / "frames.json", RESULTS)
    assert main([str(page)]) == 0 and "| sort | 1.5 |" in page.read_text()


def test_check_sees_a_stale_table(tmp_path):
    page = tmp_path / "PAGE.md"
    page.write_text("<!-- table: frames -->\n<!-- end of table -->\n")
    write_results(tmp_path / FOLDER / "frames.json", RESULTS)
    assert main(["--check", str(page)]) == 1
    assert main([str(page)]) == 0 and main(["--check", str(page)]) == 0


def test_a_table_without_json_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing\.json"):
        fill("<!-- table: missing -->\n<!-- end of table -->", tmp_path)


def test_a_gain_is_sure_where_its_interval_has_no_zero():
    def rung(knob: str, finals: list[float], gain: float, half_width: float | None, equal: float | None):
        runs = [{"seconds": [30.0], "psnr": [final], "steps": 900, "gaussians": 1500} for final in finals]
        return {
            "knob": knob,
            "value": "other",
            "psnr": sum(finals) / len(finals),
            "gain": gain,
            "gain_half_width": half_width,
            "seconds_to_equal": equal,
            "runs": runs,
        }

    results = {
        "capture": "photos",
        "minutes": 0.5,
        "seeds": 2,
        "exposures_fitted": False,
        "without_effect": ["sky: off is left out: the capture has not a sky"],
        "rungs": [
            rung("recipe", [20.0, 21.0], 0.0, 0.0, 30.0),
            rung("splats", [21.0, 22.0], 1.0, 0.5, 22.4),
            rung("dropout", [19.0, 21.5], -0.25, None, None),
        ],
    }
    table = training_table(results)
    assert table["rows"] == [
        ["the recipe", "20.50", "", "", "", "900", "1,500"],
        ["splats: other", "21.50", "+1.00 (+1.00 to +1.00)", "yes", "22", "900", "1,500"],
        ["dropout: other", "20.25", "-0.25 (-1.00 to +0.50)", "", "never", "900", "1,500"],
    ]
    assert "30 seconds of the clock a run, 2 seeds" in table["note"]
    assert "Without effect on this capture: sky: off." in table["note"]
