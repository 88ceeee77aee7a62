"""Every loader keeps its promise on whole files, on files that once failed, and on a few damaged ones."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from fuzz_loaders import Counts, Failures, fuzz, minimised, read_counts, report  # isort: skip
from loaders import BY_NAME, CORPUS, LOADERS, Loader  # isort: skip
from trials import Trial, damaged_file  # isort: skip

NAMES = [loader.name for loader in LOADERS]

FEW = 60
"""Damaged files for each loader, of those that the fuzzer draws by the first numbers."""

REFUSED_WHOLE = {"ply": 1, "ply_info": 1, "capture_points_ply": 1, "recipe_replay": 2}
"""Files of other kinds among the whole ones, and steps that a scene without crops or renderer refuses."""


@pytest.fixture(autouse=True)
def _own_config(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATVIEW_CONFIG_DIR", os.devnull)


@pytest.fixture(params=NAMES)
def trial(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Trial]:
    yield Trial(BY_NAME[request.param], tmp_path)


def test_whole_files_load(trial: Trial) -> None:
    seeds = list(trial.loader.seeds())
    for data in seeds:
        trial(data)  # what is compiled or imported once takes memory and time, which are not the file's
    results = [trial(data) for data in seeds]
    refused = [result.what for result in results if result.outcome == "refused"]
    assert [result.what for result in results if result.outcome == "failed"] == []
    assert len(refused) == REFUSED_WHOLE.get(trial.loader.name, 0), refused


def test_what_once_failed_and_a_few_damaged_files(trial: Trial) -> None:
    corpus = trial.loader.corpus()
    files = corpus + [damaged_file(trial.loader, corpus, seed) for seed in range(FEW)]
    for data in corpus:
        trial(data)
    wrong = [(data[:200], result.what) for data in files if (result := trial(data)).outcome == "failed"]
    assert wrong == []


def test_corpus_belongs_to_loaders() -> None:
    folders = {path.name for path in CORPUS.iterdir()}
    assert folders <= set(NAMES)
    assert sum(path.stat().st_size for path in CORPUS.rglob("*")) < 1 << 20


def _call(folder: Path) -> bool:
    data = (folder / "x").read_bytes()
    if b"\xff" in data:
        raise KeyError("a defect")
    if b"\xfe" in data:
        os._exit(3)
    if b"\xfd" in data:
        return len(bytearray(b"x") * (200 << 20)) < 0
    return b"\xfc" not in data


DEFECTIVE = Loader(name="defective", file="x", seeds=lambda: [b"abcdefgh" * 4], call=_call)


def test_a_defect_is_found_and_kept_and_a_crash_ends_nothing(tmp_path: Path) -> None:
    counts, failures = Counts(), Failures(tmp_path)
    fuzz(DEFECTIVE, counts, 60, failures, 400)
    assert counts.inputs == 400 == counts.next_seed
    assert counts.failed > 0 and counts.loaded > 300
    kinds = {path.read_text().strip().splitlines()[-1][:50] for path in tmp_path.rglob("*.why")}
    assert any("KeyError" in kind for kind in kinds), kinds
    assert any("exit code 3" in kind for kind in kinds), kinds


@pytest.mark.parametrize(("data", "what"), [(b"aa\xffbb", "defect"), (b"\xfd", "took"), (b"\xfc", "")])
def test_a_trial_tells_what_is_wrong(tmp_path: Path, data: bytes, what: str) -> None:
    result = Trial(DEFECTIVE, tmp_path)(data)
    assert result.outcome == ("failed" if what else "refused")
    assert what in result.what


def test_minimised_files_fail_in_the_same_way() -> None:
    assert minimised(DEFECTIVE, b"some long \xff file " * 20) == b"\xff"


def test_counts_add_up_over_runs(tmp_path: Path) -> None:
    path = tmp_path / "fuzz.json"
    path.write_text(json.dumps(report({"ply": Counts(next_seed=7, loaded=3, refused=4)})))
    table = read_counts(path)
    fuzz(BY_NAME["ply"], table["ply"], 60, Failures(tmp_path), 5)
    assert report(table)["inputs"] == 12
    assert table["ply"].next_seed == 12
