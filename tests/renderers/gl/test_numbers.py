"""common/numbers.glsl on a GPU that divides by reciprocals, as NVIDIA's do: played by software."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import moderngl
import pytest

from splatview.measure.hard_cases import find_case
from splatview.measure.hard_cases.run import CaseRenderer, run_case
from splatview.renderers.gl import programs
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest

EXACT = "return (a * unit) / (b * unit);"
RECIPROCAL = "return abs(b * unit) >= 8.5070592e37 ? a * 0.0 : (a * unit) * (1.0 / (b * unit));"
"""From 2^126 on the reciprocal is subnormal, which counts as 0."""

SHRINKS = "abs(b) > GREAT_DIVISOR"

CASES = ("huge quaternion", "means at the end of float32", "largest footprint, from beside")


@pytest.fixture
def reread(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[dict[str, str]], None]]:
    """`reread({old: new})`: numbers.glsl is read with these texts replaced, each of which it has once."""
    read = programs._read

    def change(changes: dict[str, str]) -> None:
        def changed(name: str) -> str:
            text = read(name)
            for old, new in changes.items() if name == "common/numbers.glsl" else ():
                assert text.count(old) == 1
                text = text.replace(old, new)
            return text

        monkeypatch.setattr(programs, "_read", changed)
        programs._lines.cache_clear()

    yield change
    monkeypatch.undo()
    programs._lines.cache_clear()


def passes(ctx: moderngl.Context, name: str) -> bool:
    renderer = QuadsRenderer(ctx)
    draw = CaseRenderer(
        name="quads",
        blend="float32",
        draw=lambda scene, camera, settings: renderer.render(FrameRequest(scene, camera, settings)),
    )
    results = run_case(find_case(name), draw)
    renderer.close()
    return all(result.passed for result in results)


@pytest.mark.parametrize("name", CASES)
def test_huge_divisors_are_no_zeros(ctx: moderngl.Context, reread, name: str):
    reread({EXACT: RECIPROCAL})
    assert passes(ctx, name)
    reread({EXACT: RECIPROCAL, SHRINKS: "false"})
    assert not passes(ctx, name)
