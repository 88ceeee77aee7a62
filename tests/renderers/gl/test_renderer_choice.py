"""Which renderer a GPU gets: tried once, remembered, and never a reason to fail."""

from __future__ import annotations

import json
from pathlib import Path

import moderngl
import pytest

from splatview import renderers
from splatview.renderers.gl import context
from splatview.renderers.gl import renderer_choice as choice
from splatview.renderers.headless import make_headless
from splatview.viewer import picture


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", str(tmp_path / "cache"))


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """One entry a trial; `tiles` wins each."""
    trials: list[int] = []

    def milliseconds(ctx: moderngl.Context) -> dict[str, float]:
        trials.append(1)
        return {"quads": 9.0, "tiles": 3.0}

    monkeypatch.setattr(choice, "milliseconds", milliseconds)
    return trials


def test_both_draw_and_leave_no_error(ctx: moderngl.Context, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(choice, "SPLATS", 500)
    monkeypatch.setattr(choice, "SIZE", (96, 64))
    found = choice.milliseconds(ctx)
    assert found.keys() == {"quads", "tiles"}
    assert all(0 < ms < 1e5 for ms in found.values())


def test_the_answer_is_remembered_by_driver(ctx: moderngl.Context, tried: list[int]):
    assert choice.faster(ctx)[0] == "tiles"
    name, why = choice.faster(ctx)
    assert name == "tiles"
    assert "quads 9.0 ms, tiles 3.0 ms" in why
    assert len(tried) == 1
    known = json.loads(choice.memory().read_text())
    choice.memory().write_text(json.dumps({"another driver": known.popitem()[1]}))
    choice.faster(ctx)
    assert len(tried) == 2
    assert len(json.loads(choice.memory().read_text())) == 2


@pytest.mark.parametrize("text", ["", "[]", "{", '{"driver": 3}', '{"driver": {"quads": 1}}'])
def test_a_memory_that_cannot_be_read_costs_a_trial(ctx: moderngl.Context, tried: list[int], text: str):
    choice.memory().parent.mkdir(parents=True)
    choice.memory().write_text(text)
    assert choice.faster(ctx)[0] == "tiles"
    assert len(tried) == 1
    assert len(choice.remembered(choice.memory())) == 1


def test_numbers_that_are_none_are_not_remembered(tmp_path: Path):
    path = tmp_path / "renderers.json"
    path.write_text('{"a": {"quads": "fast", "tiles": null}, "b": {"quads": 2, "tiles": 1}, "c": {}}')
    assert choice.remembered(path) == {"b": {"quads": 2.0, "tiles": 1.0}}


def test_a_cache_that_may_not_be_written_costs_a_trial(ctx, tried, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SPLATVIEW_CACHE_DIR", str(tmp_path / "file" / "cache"))
    assert choice.faster(ctx)[0] == choice.faster(ctx)[0] == "tiles"
    assert len(tried) == 2


def test_without_compute_shaders_nothing_is_tried(ctx, tried, monkeypatch):
    monkeypatch.setattr(choice, "missing_compute", lambda ctx: "OpenGL is 3.3, 4.3 is needed")
    assert choice.faster(ctx) == ("quads", "OpenGL is 3.3, 4.3 is needed")
    assert not tried


def test_a_gpu_gets_the_faster_one_with_and_without_a_window(ctx, tried, monkeypatch):
    monkeypatch.setattr(context, "SOFTWARE_RENDERERS", ())
    name, why = renderers.automatic_choice()
    assert name == "tiles"
    assert "tiles 3.0 ms" in why
    chosen = [
        make_headless("auto"),
        make_headless("auto", mode="points"),
        make_headless("auto", knobs={"order": "weighted"}),
        make_headless("auto", knobs={"blend": "float16", "keep": "75"}),
        make_headless("auto", mode="normals", knobs={"order": "16-bit", "keep": "75"}),
    ]
    assert [each.name for each in chosen] == ["tiles", "quads", "quads", "quads", "tiles"]
    for each in chosen:
        each.close()
    with ctx:
        made = picture.choose_picture(ctx, "auto")
        assert made.backend == "tiles"
        made.close()
