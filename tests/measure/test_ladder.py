"""The ladder's arithmetic, with renderers whose speed and errors are known."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator

import numpy as np
import pytest

from splatview.measure import ladder as ladder_module
from splatview.measure.knobs import Plan
from splatview.measure.ladder import (
    JITTERED,
    Ladder,
    Measured,
    is_clear,
    mark_front,
    noise_floor,
    noise_of,
    run_ladder,
    rungs_for,
)
from splatview.measure.ladder_plot import plot
from splatview.measure.ladder_report import COLUMNS, as_json, bargains, cells, left_out_text, ratio_text
from splatview.scene import Camera, RenderSettings

SIZE = (24, 16)
CAMERA = Camera(width=24, height=16, fx=20, fy=20, cx=12, cy=8, world_to_camera=np.eye(4))
TRUTH = np.full((16, 24, 4), 0.5)


class Clock:
    """Goes on only while pretenders draw: what they take is known, however busy the machine is."""

    seconds = 0.0

    def perf_counter(self) -> float:
        return self.seconds


CLOCK = Clock()


@pytest.fixture(scope="module", autouse=True)
def clock() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(ladder_module, "time", CLOCK)
        yield


class Pretender:
    """Takes so many ms, and is off by `error`, more with each SH degree that is left out."""

    def __init__(self, name: str, milliseconds: float, error: float):
        self.name, self.milliseconds, self.error = name, milliseconds, error
        self.cameras: list[bytes] = []

    def supports(self, plan: Plan) -> bool:
        return True

    def turned(self, camera: Camera, degrees: float) -> Camera:
        return camera

    def prepare(self, plan: Plan) -> None:
        self.prepared = plan

    def draw(self, camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
        assert self.prepared == plan
        degree = 3 if plan.settings.sh_degree is None else plan.settings.sh_degree
        milliseconds = (self.milliseconds - 2 * (3 - degree)) * plan.resolution
        CLOCK.seconds += milliseconds / 1e3
        self.cameras.append(camera.world_to_camera.tobytes())
        return TRUTH + self.error + 0.01 * (3 - degree), milliseconds

    def memory(self) -> int:
        return 1 << 20


def moved(view: int, number: int) -> Camera:
    matrix = np.eye(4)
    matrix[0, 3] = view + 1e-6 * (number + 1)
    return Camera(width=24, height=16, fx=20, fy=20, cx=12, cy=8, world_to_camera=matrix)


@pytest.fixture(scope="module")
def ladder():
    renderers = [Pretender("cpu", 12, 1e-6), Pretender("quads", 30, 1e-3)]
    rungs = rungs_for(renderers, Plan(), used_sh_degree=3, knobs=["sh-degree", "resolution"])
    made = run_ladder(rungs, [CAMERA] * 2, [TRUTH] * 2, moved=moved, seconds=60, rounds=4)
    return made, renderers


def found(made, knob: str, value: str) -> Measured:
    return next(one for one in made.rungs if (one.rung.knob, one.rung.value) == (knob, value))


def test_each_renderer_has_its_defaults_and_each_value_that_differs(ladder):
    made, _ = ladder
    names = [(one.rung.renderer.name, one.rung.knob, one.rung.value) for one in made.rungs]
    knobs = [
        ("sh-degree", "2"),
        ("sh-degree", "1"),
        ("sh-degree", "0"),
        ("resolution", "1/2"),
        ("resolution", "1/4"),
    ]
    expected = [(name, *knob) for name in ("cpu", "quads") for knob in [("renderer", name), *knobs]]
    assert names == expected
    assert found(made, "sh-degree", "1").rung.options == ("--renderer", "cpu", "--sh-degree", "1")


def test_degrees_that_the_scene_does_not_use_are_no_rungs():
    plan = Plan(settings=RenderSettings(sh_degree=1))
    rungs = rungs_for([Pretender("cpu", 1, 0)], plan, used_sh_degree=1, knobs=["sh-degree"])
    assert [rung.value for rung in rungs] == ["cpu", "0"]


def test_errors_are_those_against_the_truth(ladder):
    made, _ = ladder
    assert made.baseline.psnr == pytest.approx(120, abs=0.1)
    assert found(made, "renderer", "quads").psnr == pytest.approx(60, abs=0.1)
    assert found(made, "sh-degree", "0").max_error == pytest.approx(0.03, rel=1e-3)


def test_popping_is_the_largest_change_under_a_tiny_turn(ladder):
    class Popper(Pretender):
        def draw(self, camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
            picture, milliseconds = super().draw(camera, plan)
            if camera.world_to_camera.tobytes() == moved(0, JITTERED).world_to_camera.tobytes():
                picture[3, 4, 1] += 0.125
            return picture, milliseconds

    made, _ = ladder
    assert made.baseline.popping == 0
    popper = run_ladder(
        rungs_for([Popper("cpu", 1, 0)], Plan(), used_sh_degree=0, knobs=["blend"]),
        [CAMERA] * 2,
        [TRUTH] * 2,
        moved=moved,
        seconds=1,
        rounds=0,
    )
    assert popper.baseline.popping == pytest.approx(0.125)
    assert as_json(popper, {})["rungs"][0]["popping"] == pytest.approx(0.125)


def test_times_are_ratios_to_the_baseline_beside(ladder):
    made, _ = ladder
    assert made.baseline.ratio == 1
    assert found(made, "renderer", "quads").ratio > 1.5
    assert found(made, "resolution", "1/4").ratio < 0.8
    assert all(len(one.ratios) == 4 for one in made.rungs[1:])
    assert 0.01 <= made.noise < 1


def test_no_timed_frame_is_drawn_twice(ladder):
    _, renderers = ladder
    still = {
        CAMERA.world_to_camera.tobytes(),
        *(moved(v, JITTERED).world_to_camera.tobytes() for v in range(2)),
    }
    for renderer in renderers:
        timed = [camera for camera in renderer.cameras if camera not in still]
        assert len(set(timed)) == len(timed) > 0


def rung(ratio: float, psnr: float, noise: float = 0.0) -> Measured:
    return Measured(rung=None, psnr=psnr, ratios=[ratio] * 3, noise=noise)  # type: ignore[arg-type]


def test_the_front_has_no_rung_that_another_beats():
    measured = [
        rung(1, math.inf),
        rung(0.5, 60),
        rung(0.2, 30),
        rung(0.6, 60),
        rung(1.1, 90),
    ]
    mark_front(measured)
    assert [one.pareto for one in measured] == [True, True, True, False, False]


def test_what_is_no_faster_beyond_the_noise_is_not_on_the_front():
    base, tie, faster, chain = rung(1, 100), rung(0.97, 90, 0.04), rung(0.9, 80, 0.04), rung(0.88, 70, 0.04)
    mark_front([chain, faster, tie, base])
    assert [one.pareto for one in (base, tie, faster, chain)] == [True, False, True, False]
    # A rung that was measured so badly that nothing can be said is no better either.
    vague = rung(0.3, 60, math.inf)
    mark_front([base, vague])
    assert base.pareto and not vague.pareto


@pytest.mark.parametrize("pairs", [3, 12])
def test_among_many_rungs_that_are_equally_fast_chance_puts_none_on_the_front(pairs):
    rng = np.random.default_rng(0)
    won = found = 0
    for _ in range(60):
        scatter = np.exp(rng.normal(0, 0.05, (21, pairs)))
        scatter[1:, 0] *= np.where(rng.random(20) < 0.1, 1.5, 1)  # some stall
        selves, *others = scatter.tolist()
        others.append((0.6 * scatter[1]).tolist())
        rungs = [
            Measured(rung=None, psnr=90 - place, ratios=ratios, noise=noise_of(ratios, selves, others))  # type: ignore[arg-type]
            for place, ratios in enumerate(others)
        ]
        mark_front([rung(1, 100), *rungs])
        won += any(one.pareto for one in rungs[:-1])
        found += rungs[-1].pareto
    assert won <= 6, "19 times out of 20 none does"
    assert found >= 50, "what is much faster is found all the same"


def test_a_rung_that_is_called_the_same_as_the_baseline_is_not_on_the_front_beside_it():
    base = rung(1, 100)
    scattered = Measured(rung=None, psnr=80, ratios=[0.6, 0.9, 0.9, 1.2, 1.3], noise=0.05)  # type: ignore[arg-type]
    mark_front([base, scattered])
    assert not is_clear(scattered) and not scattered.pareto


def test_the_noise_floor_follows_scatter_and_number():
    rng = np.random.default_rng(1)
    ratios = rng.normal(1, 0.1, 400).tolist()
    assert noise_floor(ratios[:2]) == math.inf
    assert noise_floor([1.0] * 9) == 0.01
    assert noise_floor(ratios) < noise_floor(ratios[:20])
    # What one run of 25 pairs says of the noise holds for the medians of others, nearly always.
    runs = rng.normal(1, 0.1, (200, 25))
    floors = np.array([noise_floor(run.tolist()) for run in runs])
    medians = np.abs(np.median(runs, axis=1) - 1)
    assert 0.85 < np.mean(medians[:, None] <= floors[None]) < 1


def test_few_pairs_that_agree_by_chance_are_as_noisy_as_the_machine():
    selves = np.random.default_rng(1).normal(1, 0.1, 100).tolist()
    assert noise_of([0.8, 0.8, 0.8], selves) > 0.1 > noise_of([0.8] * 100, selves)
    scattered = np.random.default_rng(2).normal(5, 2, 100).tolist()
    assert noise_of(scattered, selves) > 2 * noise_of([5.0] * 100, selves)
    assert noise_of([0.8] * 2, selves) == math.inf


def test_differences_within_the_noise_are_no_claim(ladder):
    made, _ = ladder
    close = Measured(rung=made.baseline.rung, ratios=[1.02] * 5, noise=0.04)
    far = Measured(rung=made.baseline.rung, ratios=[1.08] * 5, noise=0.04)
    assert ratio_text(close, made).startswith("same")
    assert not ratio_text(far, made).startswith("same")


def test_a_cancelled_ladder_says_so():
    calls = iter(range(100))
    rungs = rungs_for([Pretender("cpu", 8, 0)], Plan(), used_sh_degree=3)
    made = run_ladder(
        rungs, [CAMERA], [TRUTH], moved=moved, seconds=60, rounds=9, cancelled=lambda: next(calls) > 8
    )
    assert not made.complete
    assert made.rounds < 9


def test_a_ladder_is_over_in_time_and_names_what_it_left_out():
    renderers = [Pretender("cpu", 10, 1e-6), Pretender("quads", 300, 1e-3)]
    rungs = rungs_for(renderers, Plan(), used_sh_degree=0, knobs=["resolution", "blend", "keep"])
    begun = CLOCK.seconds
    made = run_ladder(rungs, [CAMERA], [TRUTH], moved=moved, seconds=4)
    assert CLOCK.seconds - begun < 8, "it was promised half of that"
    shown = [(one.rung.renderer.name, one.rung.value) for one in made.rungs]
    assert ("cpu", "1/4") in shown and ("quads", "quads") in shown
    assert made.left_out and len(made.rungs) + len(made.left_out) == len(rungs)
    assert {rung.renderer.name for rung in made.left_out} == {"quads"}
    assert all(len(one.ratios) >= 3 for one in made.rungs[1:]) and made.needed > 4
    text = left_out_text(made)
    assert "quads: " in text and "--seconds" in text
    assert as_json(made, {})["left_out"]


def test_the_best_buys_are_said_in_words():
    renderer = Pretender("cpu", 1, 0)
    rungs = rungs_for([renderer], Plan(), used_sh_degree=3, knobs=["sh-degree"])
    prices = ((1.0, 120.0), (0.8, 70.0), (0.6, 45.0), (0.3, 25.0))
    measured = tuple(
        Measured(rung=each, ratios=[ratio] * 3, noise=0.02, psnr=psnr)
        for each, (ratio, psnr) in zip(rungs, prices, strict=True)
    )
    mark_front(measured)
    made = Ladder(baseline=measured[0], rungs=measured, noise=0.02, views=1, rounds=3, complete=True)
    fine, fair = bargains(made)
    assert "sh-degree 2 takes 20% less time" in fine and "70 dB" in fine
    assert "sh-degree 1 takes 40% less time" in fair
    none = Ladder(baseline=measured[0], rungs=measured[:1], noise=0.02, views=1, rounds=3, complete=True)
    assert bargains(none)[0].startswith("No shortcut here saves time")


def test_json_has_what_scripts_rely_on_and_no_infinities(ladder):
    made, _ = ladder
    text = json.dumps(as_json(made, {"scene": "x"}), allow_nan=False)
    data = json.loads(text)
    assert {"machine", "baseline", "noise", "rungs"} <= set(data)
    keys = {"knob", "value", "renderer", "options", "ms", "ratio", "psnr", "ssim", "max_error", "pareto"}
    assert all(keys <= set(rung) for rung in data["rungs"])


def test_the_plot_is_a_picture(ladder, tmp_path):
    made, _ = ladder
    plot(made, tmp_path / "ladder.png", title="test")
    assert (tmp_path / "ladder.png").read_bytes().startswith(b"\x89PNG")
    assert len(cells(made.rungs[1], made)) == len(COLUMNS)
