"""Withheld photos: what a run does without, what they tell, and that they are given back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import RenderSettings
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.effects import SCENES, WITHHELD, capture_effects
from splatview.trainer.ensemble import GOES_ON_AT, EnsembleTrainer
from splatview.trainer.recipe import FEWEST_TO_GO_ON, MEMBERS, automatic_tried, most_scenes
from splatview.trainer.run import Outputs, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.setup import settings_for
from splatview.trainer.views import TrainView, TrainViews
from splatview.trainer.withheld import (
    COMPARED,
    ENOUGH_LOOKS,
    FEWEST,
    LEAST_GAP,
    LEAST_GAP_OF_FEW,
    MOST,
    SHARE,
    WITHHELD_FROM,
    WITHHELD_UNTIL,
    Withheld,
)
from tests.trainer.conftest import EXTENT, VIEWS, capture_of

SETTINGS = RenderSettings(background=(0.2, 0.2, 0.2))
STEPS, SPLATS, MORE_SPLATS = 200, 150, 400
ASKED_GAP = LEAST_GAP * math.sqrt(ENOUGH_LOOKS * VIEWS / STEPS)
"""dB that are asked for where scenes are as short."""
make_settings: Any = TrainSettings


def trainer_of(views: list[TrainView], start: Parameters, **settings: Any) -> EnsembleTrainer:
    """In a run of a minute several scenes of `STEPS` may be trained."""
    options = {
        "iterations": None,
        "minutes": 1.0,
        "ensemble": 4,
        "shorter": (STEPS, SPLATS),
        "withheld": SHARE,
    }
    options |= {"max_splats": MORE_SPLATS, "background": (0.2, 0.2, 0.2), "exposure": "off"}
    return EnsembleTrainer(
        TrainViews(views, 0), start, EXTENT, make_settings(**options | settings), threads=2
    )


def run(trainer: EnsembleTrainer, until: Callable[[], object], each: float = 0.06) -> EnsembleTrainer:
    """Steps of so many seconds until something holds: by 0.06 there is time for 1,000 in a minute."""
    while not until():
        trainer.step(trainer.counters.seconds + each)
    return trainer


def watching(trainer: EnsembleTrainer) -> EnsembleTrainer:
    return run(trainer, lambda: trainer.withheld.is_watching)


def decided(trainer: EnsembleTrainer) -> EnsembleTrainer:
    return run(trainer, lambda: trainer.is_short_decided)


def finds(monkeypatch: pytest.MonkeyPatch, gap: float) -> None:
    """Whatever is measured, this is the gap."""

    def end(self: Withheld, *_: Any) -> None:
        self.gap = gap
        self.give_back()

    monkeypatch.setattr(Withheld, "end", end)


def test_a_sixth_is_withheld_of_the_photos_that_are_not_left_out(
    views: list[TrainView], start: Parameters
) -> None:
    def begun(photos: int, seed: int = 0, left_out: int = 0) -> Withheld:
        found = Withheld(photos, SHARE, seed)
        some = [views[row % VIEWS] for row in range(photos)]
        found.begin(start, some, SETTINGS, np.arange(photos) < left_out, 2)
        return found

    for photos, count in ((8, FEWEST), (48, 8), (200, MOST)):
        found = begun(photos)
        assert found.rows.sum() == count and found.is_watching
        assert found.rows[found.compared[:count]].all() and not found.rows[found.compared[count:]].any()
        assert len(found.compared) == len(set(found.compared)) == min(count + COMPARED, photos)
    assert np.array_equal(begun(40).rows, begun(40).rows)
    assert not np.array_equal(begun(40).rows, begun(40, seed=1).rows)
    assert not begun(20, left_out=8).rows[:8].any()
    # Of two photos one stays; of one none can be withheld.
    assert begun(20, left_out=18).rows.sum() == 1 and not begun(20, left_out=19).is_watching


def test_when_photos_are_withheld() -> None:
    withheld = Withheld(20, SHARE, 0)
    assert not withheld.is_due(WITHHELD_FROM - 0.01, undecided=False)
    assert withheld.is_due(WITHHELD_FROM, undecided=False)
    assert not withheld.is_due(WITHHELD_FROM, undecided=True)
    assert not withheld.is_due((WITHHELD_FROM + WITHHELD_UNTIL) / 2, undecided=False), "too late to tell"
    withheld.compared = np.arange(3)
    assert not withheld.is_due(WITHHELD_FROM, undecided=False), "once"
    for share in (0.0, math.nan):
        assert not Withheld(20, share, 0).is_due(WITHHELD_FROM, undecided=False)


def test_the_gap_is_how_much_more_photos_trained_on_have_gained(
    views: list[TrainView], start: Parameters
) -> None:
    """Photos are what a scene shows, but for a constant: PSNR of each is known."""

    def differ(by: np.ndarray) -> list[TrainView]:
        found = []
        for view, levels in zip(views, by, strict=True):
            image = draw_frame(start, view.camera, SETTINGS, Workspace()).image[..., :3]
            pixels = np.clip(image * 255 + 0.5, 0, 255 - 40).astype(np.uint8)
            rows = np.add.outer(*map(np.arange, pixels.shape[:2])) % 2 == 0  # what no exposure explains
            found.append(
                replace(view, pixels=pixels + np.where(rows, 2 * levels, 0)[..., None].astype(np.uint8))
            )
        return found

    withheld = Withheld(VIEWS, SHARE, 0)
    nobody, hard = np.zeros(VIEWS, bool), np.random.default_rng(0).choice([8, 16], VIEWS)
    withheld.begin(start, differ(hard), SETTINGS, nobody, 2)
    gained = withheld.rows.copy()
    withheld.end(start, differ(np.where(gained, hard, hard // 4)), SETTINGS, 2)
    assert withheld.gap == pytest.approx(20 * math.log10(4), abs=0.7) and not withheld.is_watching
    assert withheld.are_learnt_by_heart
    was = withheld.gap
    withheld.end(start, differ(hard), SETTINGS, 2)
    assert withheld.gap == was, "nothing is withheld"
    # One photo that has become far worse decides nothing.
    withheld.rows = gained
    withheld.end(start, differ(np.where(np.arange(VIEWS) == withheld.compared[0], 20, hard)), SETTINGS, 2)
    assert withheld.gap == pytest.approx(0, abs=0.3)


def test_photos_that_a_mask_hides_tell_nothing(views: list[TrainView], start: Parameters) -> None:
    hidden = [replace(view, mask=np.zeros(view.pixels.shape[:2], np.bool_)) for view in views]
    withheld = Withheld(VIEWS, SHARE, 0)
    withheld.begin(start, hidden, SETTINGS, np.zeros(VIEWS, bool), 2)
    withheld.end(start, hidden, SETTINGS, 2)
    assert math.isnan(withheld.gap) and not withheld.is_watching and not withheld.are_learnt_by_heart


@pytest.mark.parametrize(
    ("steps", "least"),
    [
        (math.inf, LEAST_GAP),
        (20 * ENOUGH_LOOKS, LEAST_GAP),
        (5 * ENOUGH_LOOKS, 2 * LEAST_GAP),
        (19 * ENOUGH_LOOKS, LEAST_GAP * math.sqrt(20 / 19)),
    ],
)
def test_who_learns_by_heart(steps: float, least: float) -> None:
    withheld = Withheld(20, SHARE, 0, steps)
    for gap, expected in ((least, True), (least - 0.01, False), (math.nan, False)):
        withheld.gap = gap
        assert withheld.are_learnt_by_heart == expected


def test_steps_do_without_them_until_it_is_decided(views: list[TrainView], start: Parameters) -> None:
    trainer = watching(trainer_of(views, start))
    assert WITHHELD_FROM <= trainer.scene_progress < WITHHELD_UNTIL
    names = {views[row].camera.name for row in np.flatnonzero(trainer.withheld.rows)}
    assert len(names) == FEWEST == VIEWS - len(trainer.views.taken)
    assert not names & {view.camera.name for view in trainer.views.taken}
    assert not names & {trainer.views.at(place).camera.name for place in range(200)}
    decided(trainer)
    assert len(trainer.views.taken) == VIEWS
    assert math.isfinite(trainer.withheld.gap)
    run(trainer, lambda: trainer.done)
    assert not trainer.withheld.is_watching


def test_far_from_others_several_scenes_are_trained(
    views: list[TrainView], start: Parameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    finds(monkeypatch, ASKED_GAP)
    trainer = decided(trainer_of(views, start, batch=2))
    assert trainer.is_short and trainer.batch == 1
    # The first goes on from the share of the run at which that was decided, as one of `STEPS`.
    assert trainer.scene_progress == pytest.approx(WITHHELD_UNTIL, abs=0.01)
    first = trainer.counters.iteration + STEPS * (1 - WITHHELD_UNTIL)
    assert first > 1.5 * STEPS
    run(trainer, lambda: trainer.members)
    assert trainer.counters.iteration == pytest.approx(first, abs=2)
    assert len(start.means) < len(trainer.members[0].means) <= SPLATS
    run(trainer, lambda: len(trainer.members) > 1)
    assert trainer.counters.iteration == pytest.approx(first + STEPS, abs=2)
    assert trainer.scene is not trainer.splats
    run(trainer, lambda: trainer.taught is not None)
    count = len(trainer.members)
    assert count > 1 and trainer.counters.iteration == pytest.approx(first + (count - 1) * STEPS, abs=2)
    # The last one goes on from the one before it, until the minute is over, and is shown.
    assert trainer.scene_progress == pytest.approx(GOES_ON_AT, abs=0.02) and trainer.batch == 1
    assert np.array_equal(trainer.splats.arrays.means, trainer.members[-1].means)
    assert trainer.scene is trainer.splats
    left = 60 - trainer.counters.seconds
    run(trainer, lambda: trainer.counters.seconds > 60 - left / 2)
    assert trainer.scene_progress == pytest.approx(1 - (1 - GOES_ON_AT) / 2, abs=0.02)
    run(trainer, lambda: trainer.done)
    assert trainer.counters.seconds == pytest.approx(60, abs=0.1) and len(trainer.members) == count
    assert trainer.scene is trainer.splats and trainer.progress == 1


def test_of_few_photos_the_last_scene_begins_anew(
    views: list[TrainView], start: Parameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = views[: FEWEST_TO_GO_ON - 4]
    finds(monkeypatch, 100.0)
    trainer = decided(trainer_of(few, start, iterations=5 * STEPS))
    assert trainer.is_short and trainer.batch == 1
    run(trainer, lambda: trainer.taught is not None)
    count = len(trainer.members)
    assert count > 1 and not trainer.goes_on and trainer.scene_progress < 0.02
    assert len(trainer.splats) == len(start.means) and trainer.scene is not trainer.splats
    begun = trainer.counters.iteration
    run(trainer, lambda: trainer.done)
    assert trainer.counters.iteration == pytest.approx(begun + STEPS, abs=2)
    assert trainer.counters.seconds <= 60.1 and len(trainer.members) == count
    assert trainer.scene is trainer.splats and trainer.progress == 1


def test_more_is_asked_of_few_photos() -> None:
    for photos, least in ((FEWEST_TO_GO_ON - 1, LEAST_GAP_OF_FEW), (FEWEST_TO_GO_ON, LEAST_GAP)):
        assert Withheld(photos, SHARE, 0, ENOUGH_LOOKS * photos).least_gap == pytest.approx(least)


@pytest.mark.parametrize("gap", [ASKED_GAP - 0.01, math.nan])
def test_near_others_one_scene_goes_on_as_it_would(
    views: list[TrainView], start: Parameters, monkeypatch: pytest.MonkeyPatch, gap: float
) -> None:
    finds(monkeypatch, gap)
    trainer = decided(trainer_of(views, start, batch=2, least_shown=0.0, least_visibility=0.0))
    assert not trainer.is_short and trainer.batch == 2
    assert trainer.scene_progress == pytest.approx(WITHHELD_UNTIL, abs=0.01)
    run(trainer, lambda: trainer.done)
    assert len(trainer.splats) > 2 * SPLATS
    assert len(trainer.members) == 1 and trainer.taught is None and trainer.counters.iteration > 4 * STEPS


def test_an_edit_gives_them_back(views: list[TrainView], start: Parameters) -> None:
    trainer = watching(trainer_of(views, start))
    trainer.delete(trainer.splats.ids[:3])
    assert not trainer.withheld.is_watching and len(trainer.views.taken) == VIEWS
    assert not trainer.is_short and trainer.is_last


def test_an_edit_of_the_last_scene_stays(
    views: list[TrainView], start: Parameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is shown is edited, and trained on from photos alone: pictures would bring back what has gone."""
    finds(monkeypatch, ASKED_GAP)
    trainer = trainer_of(views, start)
    run(trainer, lambda: trainer.taught is not None)
    count = len(trainer.splats)
    gone = trainer.splats.ids[: count // 2]
    assert trainer.delete(gone) == count // 2
    assert trainer.taught is None and not trainer.done and len(trainer.splats) == count - count // 2
    at = trainer.scene_progress
    run(trainer, lambda: trainer.done)
    assert GOES_ON_AT <= at < 1 and trainer.counters.seconds == pytest.approx(60, abs=0.1)
    assert not np.isin(gone, trainer.splats.ids).any()


def test_who_says_how_long_a_scene_is_gets_them_back(views: list[TrainView], start: Parameters) -> None:
    trainer = watching(trainer_of(views, start))
    trainer.change(iterations=900)
    assert not trainer.withheld.is_watching and len(trainer.views.taken) == VIEWS
    decided(trainer)
    assert not trainer.is_short and math.isnan(trainer.withheld.gap)


def test_photos_that_are_left_out_are_not_all(views: list[TrainView], start: Parameters) -> None:
    trainer = watching(trainer_of(views, start))
    trainer.leave_out(~trainer.withheld.rows)
    assert not trainer.withheld.is_watching and len(trainer.views.taken) == FEWEST


def test_a_resumed_run_goes_on_alike(views: list[TrainView], start: Parameters, tmp_path: Path) -> None:
    trainer, path = watching(trainer_of(views, start)), tmp_path / "run.safetensors"
    other = trainer_of(views, start)
    for until in (lambda: True, lambda: trainer.is_short_decided):
        run(trainer, until)
        save_checkpoint(trainer, path)
        restore(other, load_checkpoint(path))
        assert np.array_equal(other.withheld.rows, trainer.withheld.rows)
        assert other.views.names() == trainer.views.names() and len(other.views.taken) == len(
            trainer.views.taken
        )
        assert np.array_equal([other.withheld.gap], [trainer.withheld.gap], equal_nan=True)
        for _ in range(90):
            for one in (trainer, other):
                one.step(one.counters.seconds + 0.06)
        assert trainer.is_short_decided
        assert np.array_equal(other.splats.arrays.means, trainer.splats.arrays.means)


def test_a_run_that_is_resumed_in_its_last_scene_goes_on_alike(
    views: list[TrainView], start: Parameters, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    finds(monkeypatch, ASKED_GAP)
    trainer, path = trainer_of(views, start), tmp_path / "run.safetensors"
    run(trainer, lambda: trainer.taught is not None and trainer.scene_progress > GOES_ON_AT + 0.1)
    save_checkpoint(trainer, path)
    checkpoint = load_checkpoint(path)
    other = EnsembleTrainer(
        TrainViews(views, 0), checkpoint.parameters, EXTENT, checkpoint.settings, threads=2
    )
    restore(other, checkpoint)
    assert other.learns_by_heart and other.scene_progress == trainer.scene_progress
    for one in (trainer, other):
        run(one, lambda one=one: one.done)
    assert other.counters.iteration == trainer.counters.iteration
    assert np.array_equal(other.splats.arrays.means, trainer.splats.arrays.means)


def test_what_is_damaged_is_refused() -> None:
    withheld = Withheld(9, SHARE, 0)
    good = withheld.state()
    for damage in (
        {"rows": np.zeros(8, bool)},
        {"rows": np.zeros(9)},
        {"compared": np.array([9]), "before": np.zeros(1)},
        {"compared": np.array([-1]), "before": np.zeros(1)},
        {"before": np.zeros(2)},
        {"gap": np.zeros(2)},
    ):
        with pytest.raises(ValueError, match="are not among its photos"):
            withheld.restore(good | damage)
    withheld.restore(good)


def test_it_cannot_be_changed_in_a_run(views: list[TrainView], start: Parameters) -> None:
    with pytest.raises(ValueError, match="withheld cannot be changed in a run"):
        trainer_of(views, start).change(withheld=0.0)


def test_the_recipe_withholds_where_photos_and_time_are_enough(
    views: list[TrainView], points: tuple[np.ndarray, np.ndarray]
) -> None:
    def chosen(count: int, **fields: Any) -> TrainSettings:
        some = [views[place % VIEWS] for place in range(count)]
        found: Callable[..., TrainSettings] = settings_for
        return found(capture_of(some, *points), TrainViews(some, 0), threads=2, **fields)

    long = chosen(60, minutes=3.0)
    assert (
        long.withheld == SHARE
        and long.trains_several
        and long.ensemble == MEMBERS
        and long.iterations is None
    )
    assert long.shorter is not None and long.shorter[0] == 3273 and long.shorter[1] <= long.max_splats
    assert chosen(40, minutes=3.0).withheld == SHARE and chosen(40, minutes=3.0).iterations == 24_000
    for settings in (
        *(chosen(60, minutes=1.0), chosen(60, iterations=3000), chosen(60), chosen(60, minutes=3.0, batch=2)),
        *(chosen(15, minutes=3.0), chosen(60, minutes=3.0, resolution=((0.3, 4), (0.5, 2)), iterations=900)),
    ):
        assert settings.withheld == 0
    assert not chosen(60, minutes=3.0, ensemble=1).trains_several
    for wrong in (math.nan, -0.1, 0.6):
        with pytest.raises(ValueError, match="withheld must be 0 to"):
            chosen(6, withheld=wrong)


def test_how_long_scenes_are_that_are_tried() -> None:
    assert automatic_tried(52, None, minutes=3, threads=2) == 3_273
    assert automatic_tried(52, None, minutes=2, threads=2) is None  # 2,182 steps are few
    assert automatic_tried(52, None, minutes=10, threads=2) == 4_200
    assert automatic_tried(52, None, minutes=30, threads=2) == 10_000  # eight, a last one, and some to spare
    assert automatic_tried(9, None, minutes=10, threads=2) is None
    assert automatic_tried(13, 7_800, minutes=3, threads=2) == 2_769  # the last one begins anew
    assert automatic_tried(13, 7_800, minutes=2, threads=2) is None
    assert automatic_tried(13, 7_800, minutes=5, threads=2) == 4_200
    assert automatic_tried(13, 7_800, minutes=10, threads=2) is None  # there is time for several long ones
    assert automatic_tried(10, 4_650, minutes=3, threads=2) == 2_769
    assert automatic_tried(26, 15_600, minutes=3, threads=2) == 3_273
    assert automatic_tried(26, 15_600, minutes=10, threads=2) == 4_200
    assert automatic_tried(26, 15_600, minutes=20, threads=2) == 6_667
    assert automatic_tried(16, 9_600, minutes=10, threads=2) == 4_200  # or several of all steps
    assert (
        automatic_tried(16, 9_600, minutes=30, threads=2) is None
    )  # as many of all steps as there are at most
    assert automatic_tried(52, None, minutes=3, threads=2, of_a_minute=1_000) is None
    assert automatic_tried(52, None, minutes=3, threads=2, large=True) is None
    assert automatic_tried(52, None, minutes=4, threads=2, large=True) == 4_200
    assert [most_scenes(photos, 3, 2) for photos in (6, 26, 52)] == [MEMBERS] * 3
    assert most_scenes(52, 1, 2) == 1


def test_a_run_says_what_they_have_told(
    views: list[TrainView],
    start: Parameters,
    points: tuple[np.ndarray, np.ndarray],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    outputs = Outputs(
        scene=tmp_path / "s.ply", checkpoint=tmp_path / "s.safetensors", metrics=None, pictures=tmp_path / "p"
    )
    for gap, told in (
        (5.25, "several scenes, as one learns single photos by heart"),
        (1.0, "one scene still learns"),
    ):
        finds(monkeypatch, gap)
        trainer, notes = trainer_of(views, start), []
        effects = capture_effects(capture_of(views, *points), trainer.settings, "auto")
        by_name = {effect.name: effect for effect in effects}
        assert by_name[WITHHELD].on and by_name[WITHHELD].why.startswith("16.7% of the photos for a while")
        assert not by_name[SCENES].on and by_name[SCENES].why.startswith(
            f"one is trained to the end, or, if withheld photos speak for it, {STEPS} steps end a scene"
        )
        training = TrainingRun(trainer, [], outputs, started=0.0, effects=effects, on_note=notes.append)
        monkeypatch.setattr(
            TrainingRun, "seconds", property(lambda self: self.trainer.counters.seconds + 0.06)
        )
        while not trainer.is_short_decided:
            training.step()
        line = next(note for note in notes if note.startswith(WITHHELD))
        assert f"have gained {gap:.1f} dB more than those withheld: {told}" in line
        assert next(effect.why for effect in training.effects if effect.name == WITHHELD) in line
        assert sum(note.startswith(WITHHELD) for note in notes) == 1
    unreported = trainer_of(views, start)
    training = TrainingRun(unreported, [], outputs, started=0.0)
    while not unreported.is_short_decided:
        training.step()
    assert unreported.withheld.gap == 1.0
    plain = capture_effects(capture_of(views, *points), make_settings(), "auto")
    assert next(effect for effect in plain if effect.name == WITHHELD).on is False
