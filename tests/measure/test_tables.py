"""README tables are made from the committed JSON and agree with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from splatview.measure.tables import FOLDER, fill, main, write_results

ROOT = Path(__file__).parents[2]
RESULTS = {"table": {"columns": ["what", "ms"], "rows": [["sort", 1.5], ["draw", 20]], "note": "Medians."}}


def test_readme_agrees_with_its_json():
    assert main(["--check", str(ROOT / "README.md")]) == 0, "run `make tables`"


def test_fill_replaces_only_its_section(tmp_path):
    write_results(tmp_path / "frames.json", RESULTS)
    text = "before\n<!-- table: frames -->\nold\n<!-- end of table -->\nafter\n"
    filled = fill(text, tmp_path)
    assert filled.startswith(
        "before\n<!-- table: frames -->\n| what | ms |\n| --- | ---: |\n| sort | 1.5 |\n"
    )
    assert filled.endswith("<!-- end of table -->\nafter\n") and "old" not in filled and "Medians. " in filled
    assert fill(filled, tmp_path) == filled


def test_check_sees_a_stale_table(tmp_path):
    page = tmp_path / "PAGE.md"
    page.write_text("<!-- table: frames -->\n<!-- end of table -->\n")
    write_results(tmp_path / FOLDER / "frames.json", RESULTS)
    assert main(["--check", str(page)]) == 1
    assert main([str(page)]) == 0 and main(["--check", str(page)]) == 0


def test_a_table_without_json_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing\.json"):
        fill("<!-- table: missing -->\n<!-- end of table -->", tmp_path)
