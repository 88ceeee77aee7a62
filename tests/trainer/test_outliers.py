"""Photos that disagree with the others: told from those that agree, left out, and never too many of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.raster import draw_frame
from splatview.scene import InputError
from splatview.scene.camera import look_at
from splatview.scene.effects.effect import Effect, Saving
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.effects import OUTLIERS
from splatview.trainer.evaluate import evaluate
from splatview.trainer.outliers import (
    FEWEST_PHOTOS,
    LEAST_DIFFERENCE,
    LEAST_RATIO,
    LEAST_UNMET,
    Outliers,
    apart,
    correlation,
    disagreeing,
    unmet,
    window_sums,
)
from splatview.trainer.run import Outputs, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews

EXTENT = 3.0
make_settings: Any = TrainSettings


def turned(view: TrainView, degrees: float) -> TrainView:
    """The same photo, whose camera is said to look elsewhere."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])
    return replace(view, camera=replace(view.camera, world_to_camera=turn @ view.camera.world_to_camera))


def make_trainer(views: list[TrainView], start, **settings) -> Trainer:
    options = {"iterations": 4000, "max_splats": 300, "background": (0.2, 0.2, 0.2), "minutes": None}
    return Trainer(TrainViews(views, 0), start, EXTENT, make_settings(**options | settings), threads=2)


def after(trainer: Trainer, steps: int) -> Trainer:
    while not trainer.done and trainer.counters.iteration < steps:
        trainer.step()
    return trainer


def picture(width: int = 60, height: int = 44) -> np.ndarray:
    """(H, W, 3) uint8 with detail."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    grey = 120 + 50 * np.sin(x / 3) * np.cos(y / 4) + 30 * np.sin(x * y / 200)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def photo_of(pixels: np.ndarray, mask: np.ndarray | None = None) -> TrainView:
    height, width = pixels.shape[:2]
    camera = replace(look_at((0, 0, -2), (0, 0, 0), width=width, height=height), name="photo.png")
    return TrainView(camera, pixels, mask)


def test_window_sums_are_those_of_loops() -> None:
    values = np.random.default_rng(0).normal(size=(7, 5))
    truth = np.array(
        [
            [values[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3].sum() for x in range(values.shape[1])]
            for y in range(values.shape[0])
        ]
    )
    np.testing.assert_allclose(window_sums(values, 2), truth, atol=1e-12)
    np.testing.assert_allclose(window_sums(values, 50), values.sum(), atol=1e-12)


def test_exposure_colour_and_shade_do_not_count_but_places_do() -> None:
    pixels = picture()
    shown, photo = pixels / 255, photo_of(pixels)
    assert correlation(shown, photo) == pytest.approx(1, abs=1e-9)
    assert correlation(0.5 * shown * [1.2, 0.9, 0.7] + 0.1, photo) == pytest.approx(1, abs=1e-3)
    shaded = shown + np.linspace(-0.2, 0.2, shown.shape[1])[None, :, None]
    assert correlation(shaded, photo) > 0.97
    assert correlation(np.roll(shown, 5, axis=1), photo) < 0.6
    assert correlation(1 - shown, photo) == pytest.approx(-1, abs=1e-3)


def test_what_is_blurred_is_met_better_than_what_is_elsewhere() -> None:
    pixels = picture()
    shown, photo = pixels / 255, photo_of(pixels)
    mean = shown.mean(axis=(0, 1))
    assert unmet(shown, photo) == pytest.approx(0, abs=1e-9)
    assert unmet(0 * shown, photo) == pytest.approx(1)
    assert unmet(0.5 * (shown + mean), photo) == pytest.approx(0.25, abs=1e-3)
    blurred = (shown + sum(np.roll(shown, by, axis=1) for by in (-2, -1, 1, 2))) / 5
    elsewhere = np.roll(shown, 5, axis=1)
    assert correlation(blurred, photo) < 1 and unmet(blurred, photo) < LEAST_UNMET < unmet(elsewhere, photo)
    mask = np.ones(pixels.shape[:2], np.bool_)
    assert np.isnan(unmet(shown, photo_of(pixels, ~mask)))
    assert np.isnan(unmet(shown, photo_of(np.full_like(pixels, 9))))
    mask[:, :30] = False
    shown[:, :30] = 0
    assert unmet(shown, photo_of(pixels, mask)) == pytest.approx(0, abs=1e-9)


def test_photos_that_are_learnt_late_are_not_left_out() -> None:
    lacking = np.concatenate([np.full(20, 0.1), [0.5, 0.45]])
    late = np.concatenate([np.full(20, 0.2), [LEAST_UNMET - 0.01, 0.9]])
    assert np.flatnonzero(disagreeing(1 - lacking, late)).tolist() == [21]
    assert np.flatnonzero(apart(1 - lacking, late)).tolist() == [21], (
        "however near it is to one that is right"
    )
    assert not apart(1 - lacking, np.full(22, LEAST_UNMET - 0.01)).any()
    assert not apart(1 - lacking, np.full(22, np.nan)).any()
    outliers = Outliers([f"{row}.png" for row in range(22)])
    outliers.correlations, outliers.unmet = 1 - lacking, np.full(22, 0.5)
    outliers.decide(apart(outliers.correlations, outliers.unmet))
    assert outliers.evidence.startswith(
        "2 of 22 photos are learnt late, and nothing speaks against them: the"
    )


def test_what_is_masked_does_not_count() -> None:
    pixels, mask = picture(), np.ones((44, 60), np.bool_)
    mask[:, :30] = False
    shown = pixels / 255
    shown[:, :30] = np.random.default_rng(0).uniform(size=(44, 30, 3))
    assert correlation(shown, photo_of(pixels, mask)) == pytest.approx(1, abs=1e-9)
    assert correlation(shown, photo_of(pixels)) < 0.8
    assert np.isnan(correlation(shown, photo_of(pixels, np.zeros_like(mask))))


def test_what_is_the_same_all_over_is_not_known() -> None:
    pixels = picture()
    assert np.isnan(correlation(np.full(pixels.shape, 0.5), photo_of(pixels)))
    assert np.isnan(correlation(pixels / 255, photo_of(np.full_like(pixels, 9))))


def test_photos_far_below_the_others_disagree() -> None:
    lacking = np.full(12, 0.1)
    lacking[3] = max(LEAST_RATIO * 0.1, 0.1 + LEAST_DIFFERENCE) + 0.01
    lacking[4] = LEAST_RATIO * 0.1 - 0.01  # too little of a ratio, or of a difference
    lacking[5] = np.nan
    assert np.flatnonzero(disagreeing(1 - lacking)).tolist() == [3]
    assert not disagreeing(np.full(9, np.nan)).any()
    # Where the scene meets all photos very well, many times as little is still little.
    assert not disagreeing(1 - np.array([0.01] * 9 + [0.1])).any()


def test_a_group_of_photos_is_not_cut_in_two() -> None:
    # Those of `beach`, where trees are slow to learn and lawns are not: two of four would be left out.
    trees = np.array([0.57, 0.56, 0.52, 0.45])
    lacking = np.concatenate([trees, np.full(8, 0.16)])
    assert disagreeing(1 - lacking).sum() == 2 and not apart(1 - lacking).any()
    # One that is apart from a group is left out without it; one that is hardly less wrong goes with others.
    assert np.flatnonzero(apart(1 - np.concatenate([lacking, [0.75]]))).tolist() == [12]
    three = np.concatenate([np.full(20, 0.1), [0.5, 0.44, 0.39], [np.nan]])
    assert disagreeing(1 - three).sum() == 2
    assert np.flatnonzero(apart(1 - three)).tolist() == [20, 21, 22]
    assert not apart(np.full(9, 0.5)).any() and not apart(np.full(9, np.nan)).any()


def test_a_photo_of_a_wrong_pose_is_left_out_and_the_scene_gains(views, start) -> None:
    wrong = {3, 11}
    photos = [turned(view, 12) if i in wrong else view for i, view in enumerate(views) if i % 5]
    names = {view.camera.name for i, view in enumerate(views) if i in wrong}
    with_it, without = (after(make_trainer(photos, start, outliers=mode), 1200) for mode in ("auto", "off"))
    assert with_it.outliers.is_decided and with_it.outliers.names_left_out == names
    assert "2 of 16 photos disagree with the others" in with_it.outliers.evidence
    assert "view_3.png by" in with_it.outliers.evidence
    assert not without.outliers.is_decided and not without.outliers.left_out.any()
    assert len(with_it.views) == 16 and len(with_it.views.taken) == 14
    taken = {with_it.views.at(step).camera.name for step in range(40)}
    assert len(taken) == 14 and not taken & names
    ours, theirs = (
        evaluate(trainer.splats.arrays, views[::5], trainer.render_settings, threads=1).psnr
        for trainer in (with_it, without)
    )
    assert ours > theirs + 1


def test_photos_that_agree_are_all_trained_on(views, start) -> None:
    trainer = after(make_trainer(views, start, iterations=400), 80)
    assert trainer.outliers.is_decided and not trainer.outliers.left_out.any()
    assert trainer.outliers.evidence.startswith("all agree: the median photo correlates with the scene by 0.")
    assert len(trainer.views.taken) == len(views)


def test_nobody_says_which_of_a_few_are_wrong(views, start) -> None:
    few = [turned(view, 12) if i == 2 else view for i, view in enumerate(views[: FEWEST_PHOTOS - 1])]
    trainer = after(make_trainer(few, start, iterations=200), 200)
    assert not trainer.outliers.is_decided and not trainer.outliers.left_out.any()


def test_a_run_too_short_to_tell_says_so(views, start, tmp_path: Path) -> None:
    photos = [turned(view, 12) if i == 3 else view for i, view in enumerate(views)]
    trainer = make_trainer(photos, start, iterations=60)  # 0.3 of it is less than a round of all photos
    lines, effect = noted(trainer, tmp_path)
    assert trainer.outliers.is_decided and not trainer.outliers.left_out.any()
    assert not lines and not effect.on and "looked at too seldom to tell" in effect.why


def test_more_than_a_quarter_are_not_left_out() -> None:
    outliers = Outliers([f"{i}" for i in range(8)])
    outliers.decide(np.arange(8) < 3)
    assert outliers.is_decided and not outliers.left_out.any()
    other = Outliers([f"{i}" for i in range(8)])
    other.decide(np.arange(8) < 2)
    assert other.names_left_out == {"0", "1"}


def noted(trainer: Trainer, folder: Path) -> tuple[list[str], Effect]:
    """Lines for the user about photos left out, once that is decided, and what the report says of them."""
    notes, effect = told(trainer, folder)
    return [note for note in notes if OUTLIERS in note], effect


def told(trainer: Trainer, folder: Path) -> tuple[list[str], Effect]:
    """All lines for the user until then, and the same."""
    outputs = Outputs(
        scene=folder / "s.ply", checkpoint=folder / "s.safetensors", metrics=None, pictures=folder / "p"
    )
    effect, notes = Effect(name=OUTLIERS, on=False, why="", saving=Saving()), []
    run = TrainingRun(trainer, [], outputs, started=0.0, effects=(effect,), on_note=notes.append)
    while not trainer.outliers.is_decided:
        run.step()
    return notes, run.effects[0]


def test_the_user_is_told_which_and_why(views, start, tmp_path: Path) -> None:
    photos = [turned(view, 12) if i == 3 else view for i, view in enumerate(views)]
    (line,), effect = noted(make_trainer(photos, start), tmp_path)
    assert line.startswith("photos left out: 1 of 20 photos disagree with the others: the median photo")
    assert "view_3.png by" in line and line.endswith("--outliers off trains on them")
    assert effect.on and "view_3.png by" in effect.why
    lines, effect = noted(make_trainer(views, start, iterations=400), tmp_path)
    assert not lines and not effect.on and effect.why.startswith("all agree")


def test_too_many_that_disagree_are_told_of(views, start, tmp_path: Path, monkeypatch) -> None:
    trainer = make_trainer(views, start, iterations=400)
    found = np.array([0.2] * 6 + [0.9] * 14)
    monkeypatch.setattr("splatview.trainer.outliers.correlation", lambda picture, view: found[len(seen) - 1])
    monkeypatch.setattr("splatview.trainer.outliers.unmet", lambda picture, view: 1.0)
    seen: list[int] = []
    monkeypatch.setattr(
        "splatview.trainer.outliers.draw_frame",
        lambda *args, **options: seen.append(1) or draw_frame(*args, **options),
    )
    (line,), effect = noted(trainer, tmp_path)
    assert "none; 6 of 20 photos agree less with the scene, too many or too near others to leave out" in line
    assert not effect.on and not trainer.outliers.left_out.any()


def test_photos_whose_poses_are_all_wrong_are_doubted(views, start, tmp_path: Path) -> None:
    order = np.random.default_rng(3).permutation(len(views))
    photos = [
        replace(view, camera=replace(views[k].camera, name=view.camera.name))
        for view, k in zip(views, order, strict=True)
    ]
    notes = told(make_trainer(photos, start), tmp_path)[0]
    (line,) = [note for note in notes if "photos agree little" in note]
    assert "poses may be wrong, things may move" in line
    assert not [note for note in told(make_trainer(views, start), tmp_path)[0] if "agree little" in note]


def test_a_resumed_run_leaves_out_the_same(views, start, tmp_path: Path) -> None:
    photos = [turned(view, 12) if i == 3 else view for i, view in enumerate(views)]
    whole, part, resumed = (make_trainer(photos, start) for _ in range(3))
    after(part, 450)
    assert part.outliers.names_left_out == {"view_3.png"}
    path = tmp_path / "run.checkpoint.safetensors"
    save_checkpoint(part, path)
    restore(resumed, load_checkpoint(path))
    assert resumed.outliers.names_left_out == {"view_3.png"} and len(resumed.views.taken) == len(views) - 1
    for one, other in zip(after(whole, 520).splats.arrays, after(resumed, 520).splats.arrays, strict=True):
        np.testing.assert_array_equal(one, other)


def test_damaged_states_are_refused(views, start) -> None:
    outliers = Outliers([view.camera.name for view in views])
    for flags in (np.zeros(3, np.bool_), np.ones(21, np.bool_), np.zeros(21)):
        with pytest.raises(ValueError, match="left out are not those of its photos"):
            outliers.restore({"outliers": flags})
    trainer = make_trainer(views, start)
    with pytest.raises(InputError, match="no photo would be left"):
        trainer.leave_out(np.ones(len(views), np.bool_))
    assert not trainer.outliers.left_out.any() and len(trainer.views.taken) == len(views)


def test_a_run_keeps_its_choice(views, start) -> None:
    with pytest.raises(ValueError, match="outliers cannot be changed in a run"):
        make_trainer(views, start).change(outliers="off")
    with pytest.raises(ValueError, match="outliers must be auto or off"):
        make_settings(outliers="maybe")
