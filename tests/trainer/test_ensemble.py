"""Several scenes of few photos, and one that learns from them: trainer.ensemble."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatview.cli.training_ladder import TrainingRung, make_trainer
from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import InputError, look_at
from splatview.scene.captures import load_capture
from splatview.scene.formats import load_scene
from splatview.trainer import setup
from splatview.trainer.backdrop import standing_in
from splatview.trainer.background import BackgroundTraining
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.distributed import Alone
from splatview.trainer.effects import FEW_PHOTOS, SCENES, capture_effects
from splatview.trainer.ensemble import (
    OF_STUDENT,
    SPARE,
    EnsembleTrainer,
    begins_for_most,
    cameras_between,
    kind_of_trainer,
    neighbours,
)
from splatview.trainer.evaluate import evaluate
from splatview.trainer.free_space import GONE, block_of
from splatview.trainer.functional import Visibility
from splatview.trainer.memory import Machine, PhotoSizes, run_memory
from splatview.trainer.plugin import LossPlugin
from splatview.trainer.recipe import (
    FULL_REG_LOSS,
    MEMBERS,
    MET_OF_OBJECTS,
    PICTURES,
    automatic_met_loss,
    automatic_shorter,
    pictures_taught,
)
from splatview.trainer.run import Outputs, RunProgress, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.setup import settings_for, train
from splatview.trainer.trainer import CLEAR_STEPS, Trainer
from splatview.trainer.views import TrainView, TrainViews
from tests.trainer.conftest import EXTENT, capture_of

STEPS = 40

Make = Callable[..., EnsembleTrainer]


@pytest.fixture
def make(views: list[TrainView], start: Parameters) -> Make:
    """`make(minutes=.., **settings)`: a trainer of six photos."""

    def made(kind: type[Trainer] = EnsembleTrainer, **settings: Any) -> Any:
        options = {"iterations": STEPS, "minutes": 10.0, "ensemble": 3, "max_splats": 200}
        options |= {"exposure": "off"} | settings
        chosen = TrainSettings(background=(0.2, 0.2, 0.2), surround=(0.2, 0.2, 0.2), dropout=0.1, **options)
        return kind(TrainViews(views[::3], 0), start, EXTENT, chosen, threads=2)

    return made


def run(trainer: Trainer, until: Callable[[], object], each: float = 0.1) -> None:
    """Steps of so many seconds until something holds."""
    while not until():
        trainer.step(trainer.counters.seconds + each)


def whole(trainer: EnsembleTrainer, count: int) -> None:
    run(trainer, lambda: len(trainer.members) == count)


def saved(trainer: EnsembleTrainer, path: Path) -> Path:
    save_checkpoint(trainer, path)
    return path


def assert_same(one: Parameters, other: Parameters) -> None:
    for a, b in zip(one, other, strict=True):
        assert np.array_equal(a, b)


def resumed_from(path: Path, views: TrainViews) -> EnsembleTrainer:
    """A trainer that goes on where a checkpoint was written."""
    checkpoint = load_checkpoint(path)
    trainer = EnsembleTrainer(views, checkpoint.parameters, checkpoint.extent, checkpoint.settings, threads=2)
    restore(trainer, checkpoint)
    return trainer


def test_three_scenes_and_one_that_learns_from_them(make: Make) -> None:
    trainer = make()
    before, recipe = trainer.splats.ids, trainer.settings
    for count in (1, 2):
        whole(trainer, count)
        assert trainer.counters.iteration == count * STEPS and not trainer.done and trainer.taught is None
        assert trainer.scene_progress == 0 and trainer.progress == count / 4
        assert len(trainer.splats) == len(before) and not set(trainer.splats.ids) & set(before)
    assert trainer.settings == recipe
    whole(trainer, 3)
    assert trainer.taught is not None and trainer.settings == replace(recipe, **OF_STUDENT)
    run(trainer, lambda: trainer.done)
    assert trainer.counters.iteration == 4 * STEPS and trainer.progress == 1
    assert trainer.scene is trainer.splats and len(trainer.members) == 3


def test_the_last_scene_has_what_somebody_has_asked_for(make: Make, tmp_path: Path) -> None:
    trainer, path = make(), tmp_path / "run.safetensors"
    trainer.change(dropout=0.3)
    whole(trainer, 2)
    recipe = trainer.settings
    save_checkpoint(trainer, path)
    resumed = resumed_from(path, trainer.views)
    for one in (trainer, resumed):
        whole(one, 3)
        assert one.taught is not None
        assert one.settings == replace(recipe, **OF_STUDENT | {"dropout": 0.3})


@pytest.mark.parametrize(
    ("minutes", "scenes"), [(10.0, 4), (0.3, 4), (0.25, 3), (0.15, 1), (0.1, 1)]
)  # a scene takes 4 s
def test_progress_goes_by_the_scenes_that_there_is_time_for(make: Make, minutes: float, scenes: int) -> None:
    """From the middle of the first scene on, when it is known how long one takes."""
    trainer, shares = make(minutes=minutes), []
    while not trainer.done:
        trainer.step(trainer.counters.seconds + 0.1)
        shares.append(trainer.progress)
    assert trainer.counters.iteration == scenes * STEPS
    even = np.linspace(0, 1, scenes * STEPS + 1)[1:]
    assert shares[STEPS // 2 :] == pytest.approx(even[STEPS // 2 :], abs=0.02)


def test_a_scene_that_follows_is_as_one_of_its_own(make: Make) -> None:
    """Nothing of the scene before is left in it, but for the order of the photos. It may take its share of
    the rest of the minutes."""
    trainer = make()
    whole(trainer, 1)
    begun = trainer.begun / 60
    alone = make(Trainer, ensemble=1, minutes=begun + (10 - begun) / (2 * SPARE))
    alone.counters.iteration = alone.first = alone.state["refined_at"] = STEPS
    alone.counters.photos = alone.first_photo = STEPS  # one in each
    alone.counters.seconds = alone.begun = trainer.begun
    whole(trainer, 2)
    alone.outliers.is_decided = True
    run(alone, lambda: alone.done)
    assert_same(trainer.members[1], alone.splats.arrays)
    assert not np.array_equal(trainer.members[0].means[:9], trainer.members[1].means[:9])


@pytest.mark.parametrize("minutes", [0.05, 0.1])
def test_without_time_one_scene_is_all(make: Make, minutes: float) -> None:
    trainer, alone = make(minutes=minutes), make(Trainer, minutes=minutes, ensemble=1)
    for one in (trainer, alone):
        run(one, lambda one=one: one.done)
        assert one.counters.seconds <= 60 * minutes + 0.1
    assert_same(trainer.splats.arrays, alone.splats.arrays)
    assert trainer.scene is trainer.splats and trainer.taught is None


@pytest.mark.parametrize("minutes", [0.17, 0.18, 0.2])  # 10.2 s and more, where a scene takes 4
def test_where_little_time_lacks_scenes_that_follow_end_sooner(make: Make, minutes: float) -> None:
    """Two thirds of their length are better than one scene and idle minutes; both settle as a whole one."""
    trainer, lengths, shares = make(minutes=minutes), [], []
    while not trainer.done:
        first, before = trainer.first, len(trainer.members)
        trainer.step(trainer.counters.seconds + 0.1)
        shares.append(trainer.progress)
        if len(trainer.members) > before:
            lengths.append(trainer.counters.iteration - first)
    lengths.append(trainer.counters.iteration - trainer.first)
    assert lengths[0] == STEPS and len(lengths) == 3 and len(trainer.members) == 2
    assert STEPS * 0.66 <= lengths[1] <= lengths[2] <= STEPS and lengths[1] < STEPS
    assert 60 * minutes - 0.2 < trainer.counters.seconds <= 60 * minutes + 0.1 or lengths[2] == STEPS
    assert np.all(np.diff(shares) > -0.01) and shares[-1] == 1, np.diff(shares).min()


def test_what_was_begun_is_whole_when_the_minutes_end(make: Make) -> None:
    """Steps that become slower leave less time than was thought: scenes still settle, and the last one is."""
    for slow_from in (1, 3):
        trainer = make(minutes=0.3)  # 18 s, of which a scene takes 4
        whole(trainer, slow_from)
        run(trainer, lambda trainer=trainer: trainer.done, each=0.4)
        assert 17.5 < trainer.counters.seconds < 18.5
        assert trainer.counters.iteration < 4 * STEPS and trainer.scene_progress == 1
        assert trainer.taught is None and trainer.scene is trainer.splats
        assert not any(np.array_equal(trainer.splats.arrays.means, one.means) for one in trainer.members)


def test_the_first_scene_is_shown_and_saved_until_the_last_is_whole(make: Make) -> None:
    trainer = make()
    whole(trainer, 1)
    first = trainer.snapshot()
    ids = trainer.scene.ids
    trainer.step(trainer.counters.seconds)
    assert np.array_equal(trainer.snapshot().means, first.means) and trainer.scene.ids is ids
    assert_same(trainer.scene.arrays, trainer.members[0])
    whole(trainer, 3)
    trainer.step(trainer.counters.seconds)
    assert_same(trainer.scene.arrays, trainer.members[0])
    assert trainer.scene.ids is ids


def test_a_run_says_that_an_edit_ended_it(
    make: Make, tmp_path: Path, views: list[TrainView], points: Any
) -> None:
    """Whether it is of a whole scene, beside which another is trained, or of the first one."""
    for steps, members in ((STEPS + 3, 1), (3, 0)):
        trainer = make()
        effects = capture_effects(capture_of(views[::3], *points), trainer.settings, "auto")
        outputs = Outputs(
            scene=tmp_path / "a.ply",
            checkpoint=tmp_path / "a.safetensors",
            metrics=None,
            pictures=tmp_path / "p",
        )
        going = TrainingRun(trainer, [], outputs, started=time.perf_counter(), effects=effects)
        while trainer.counters.iteration < steps:
            going.step()
        assert len(trainer.members) == members
        trainer.delete(trainer.scene.ids[:3])
        assert going.run()
        told = next(one for one in going.effects if one.name == SCENES)
        assert not told.on and "edited" in told.why
        resumed = resumed_from(outputs.checkpoint, trainer.views)
        assert resumed.edited and resumed.done


def test_an_edit_keeps_the_scene_that_is_seen(make: Make) -> None:
    trainer = make()
    whole(trainer, 2)
    trainer.step(trainer.counters.seconds + 0.1)
    shown = trainer.scene
    gone = shown.ids[::7]
    kept = shown.arrays.means[~np.isin(shown.ids, gone)].copy()
    assert trainer.delete(gone) == len(gone)
    assert trainer.done and trainer.scene is trainer.splats
    assert np.array_equal(trainer.scene.arrays.means, kept)

    trainer = make()
    trainer.delete(trainer.splats.ids[:3])
    run(trainer, lambda: trainer.done)
    assert trainer.counters.iteration == STEPS  # of a scene that was edited no other is made


def test_what_is_a_sky_stays_one(make: Make, tmp_path: Path) -> None:
    """Its splats are the last of those that each scene begins with, and what is chosen at them is kept."""
    trainer, path = make(), tmp_path / "run.safetensors"
    count = len(trainer.splats)
    trainer.initial_sky = trainer.state["sky"] = (np.arange(count) >= count - 5).astype(np.uint8)
    far = trainer.splats.arrays.means[-5:].copy()
    whole(trainer, 1)
    trainer.step(trainer.counters.seconds + 0.1)
    assert np.array_equal(trainer.splats.arrays.means[trainer.state["sky"] > 0], far)
    save_checkpoint(trainer, path)
    resumed = resumed_from(path, trainer.views)
    for one in (trainer, resumed):
        one.delete(one.scene.ids[:3])
        assert len(one.state["sky"]) == len(one.splats) == len(one.members[0].means) - 3
        assert np.array_equal(one.splats.arrays.means[one.state["sky"] > 0], far)


def test_a_damaged_scene_is_refused(make: Make, tmp_path: Path) -> None:
    path = tmp_path / "run.safetensors"
    trainer = make()
    whole(trainer, 1)
    trainer.members[0] = trainer.members[0]._replace(quats=trainer.members[0].quats[:-1])
    save_checkpoint(trainer, path)
    with pytest.raises(InputError, match="damaged checkpoint"):
        load_checkpoint(path)


@pytest.mark.parametrize("steps", [STEPS // 2, STEPS + 7, 3 * STEPS + 11])
def test_a_resumed_run_goes_on_bit_for_bit(make: Make, tmp_path: Path, steps: int) -> None:
    path = tmp_path / "run.safetensors"
    straight, part = make(), make()
    run(part, lambda: part.counters.iteration == steps)
    save_checkpoint(part, path)
    resumed = resumed_from(path, part.views)
    assert_same(resumed.scene.arrays, part.scene.arrays)
    for one in (straight, resumed):
        run(one, lambda one=one: one.done)
    assert straight.counters.iteration == resumed.counters.iteration == 4 * STEPS
    assert_same(straight.splats.arrays, resumed.splats.arrays)


def test_a_run_resumed_for_other_steps_trains_one_scene(make: Make, tmp_path: Path) -> None:
    path = tmp_path / "run.safetensors"
    trainer = make()
    run(trainer, lambda: trainer.done)
    save_checkpoint(trainer, path)
    checkpoint = load_checkpoint(path)
    settings = replace(checkpoint.settings, iterations=4 * STEPS + 9, minutes=None)
    kind = kind_of_trainer(settings, None, None)
    resumed = kind(trainer.views, checkpoint.parameters, checkpoint.extent, settings, threads=2)
    restore(resumed, checkpoint)
    assert_same(resumed.scene.arrays, trainer.scene.arrays)
    run(resumed, lambda: resumed.done)
    assert resumed.counters.iteration == 4 * STEPS + 9


def test_pictures_are_the_mean_of_what_scenes_show(make: Make) -> None:
    """Colours and opacity, by which they stand in front of any colour."""
    trainer = make()
    whole(trainer, 3)
    taught = trainer.taught
    assert taught is not None and len(taught) == PICTURES == pictures_taught(6, 48 * 40)
    shown, other = trainer.shown_settings, (0.5, 0.1, 0.3)
    for view in taught.all[::40]:
        drawn = [draw_frame(member, view.camera, shown, Workspace()).image for member in trainer.members]
        mean = np.clip(drawn, 0, 1).mean(axis=0)
        assert view.alpha is not None
        found = np.dstack([view.pixels, view.alpha]) / 255
        assert np.abs(found - mean).max() <= 0.5 / 255 + 1e-6
        before = replace(shown, background=other)
        drawn = [draw_frame(member, view.camera, before, Workspace()).image for member in trainer.members]
        mean = np.clip(drawn, 0, 1).mean(axis=0)[..., :3]
        moved = standing_in(view, (0.2, 0.2, 0.2), np.array(other))
        assert (
            moved.alpha is None and np.abs(moved.pixels / 255 - mean).max() <= 2 / 255
        )  # of three roundings
        assert np.abs(moved.pixels.astype(int) - view.pixels).max() > 20
    looked = [trainer._view_at(place).camera.name for place in range(400)]
    share = sum(name.startswith("between") for name in looked) / len(looked)
    assert 0.72 < share < 0.88
    assert {view.camera.name for view in trainer.views.all} < set(looked)


@pytest.mark.parametrize("count", [2, 3, 4, 7, 8])
def test_one_scene_in_four_may_have_fog_of_its_own(count: int) -> None:
    """Before which nothing is free by the others; where two do, that is where it ends."""
    rng = np.random.default_rng(count)
    depths = rng.uniform(2.0, 3.0, (count, 3, 4)).astype(np.float32)
    foggy = depths.copy()
    foggy[0], depths[0] = 0.5, np.inf
    found = begins_for_most(foggy)
    assert found.shape == (3, 4)
    assert (found > 0.5).all() == (count >= 4)
    if 4 <= count < 8:
        np.testing.assert_array_equal(found, depths.min(axis=0))
    foggy[1] = 0.7
    np.testing.assert_array_equal(begins_for_most(foggy)[0, 0] <= 0.7, count < 8)


@pytest.mark.parametrize("share", [0.5, 0.0])
def test_nothing_stands_before_what_all_scenes_show(make: Make, tmp_path: Path, share: float) -> None:
    """In pictures taught, as by photos; with a share of 0 it may. A resumed run knows, too."""
    trainer, path = make(free_space=share), tmp_path / "run.safetensors"
    whole(trainer, 3)
    assert trainer.taught is not None and bool(trainer.taught_depths) == (share > 0)
    view = trainer.taught.all[0]
    camera = view.camera
    nearest = trainer.taught_depths.get(camera.name, np.eye(20, 24))
    row, column = np.unravel_index(nearest.argmax(), nearest.shape)
    pixel = (np.array([[column, row]]) + 0.5) * block_of(camera.height, camera.width)
    assert nearest.max() > 0, "all scenes show something there"
    for one in (trainer, resumed_from(saved(trainer, path), trainer.views)):
        arrays = one.splats.arrays
        for place, depth in enumerate((0.9 * share * nearest.max(), 1.1 * share * nearest.max())):
            local = camera.points_at(pixel, max(depth, 0.05))
            arrays.means[place] = (local - camera.t_camera_world) @ camera.R_camera_world
        arrays.log_scales[:2], arrays.opacity_logits[:2] = -3.0, 1.0
        rows = np.arange(2, dtype=np.int32)
        one._view_at = lambda place, factor=1: view
        one.counters.iteration -= one.counters.iteration % CLEAR_STEPS
        one._clear_free_space(Visibility([rows], len(arrays.means)), range(1))
        assert (arrays.opacity_logits[:2] == GONE).tolist() == [share > 0, False]


def test_of_transparent_photos_pictures_are_transparent(make: Make) -> None:
    trainer = make()
    alpha = np.full((40, 48), 255, np.uint8)
    trainer.views = trainer.views.changed([replace(view, alpha=alpha) for view in trainer.views.all])
    whole(trainer, 3)
    assert trainer.taught is not None
    for view in trainer.taught.all[::50]:
        drawn = [
            draw_frame(m, view.camera, trainer.shown_settings, Workspace()).image for m in trainer.members
        ]
        assert view.alpha is not None
        assert np.abs(view.alpha / 255 - np.mean(drawn, axis=0)[..., 3]).max() <= 0.5 / 255 + 1e-6


def test_the_last_scene_is_as_good_as_those_that_teach_it(make: Make, views: list[TrainView]) -> None:
    """On the average of these, which differ by 0.4 dB: processors that round otherwise have other ones."""
    trainer = make(iterations=300, minutes=30.0)
    run(trainer, lambda: trainer.done)
    held_out = [view for place, view in enumerate(views) if place % 3]
    scores = [
        evaluate(scene, held_out, trainer.render_settings).psnr
        for scene in (*trainer.members, trainer.splats.arrays)
    ]
    assert scores[-1] > np.mean(scores[:-1]) - 0.1, scores


def test_cameras_lie_between_neighbours() -> None:
    eyes = [(np.cos(angle), 0.2, np.sin(angle)) for angle in np.linspace(0, 2.5, 8)]
    cameras = [look_at(eye, (0, 0, 0), width=60, height=40) for eye in eyes]
    found = cameras_between(cameras, 200, seed=3)
    assert len({camera.name for camera in found}) == 200
    middles, around = np.array(eyes), np.array([camera.eye for camera in found])
    step = float(np.linalg.norm(middles[0] - middles[1]))
    nearest = np.linalg.norm(around[:, None] - middles, axis=-1).min(axis=1)
    assert 0.2 * step < np.median(nearest) < step and nearest.max() < 2.5 * step
    for camera in found:
        towards = -camera.eye / np.linalg.norm(camera.eye)
        assert camera.R_camera_world[2] @ towards > 0.9
        assert (camera.width, camera.height, camera.fx) == (60, 40, cameras[0].fx)
    for one, other in zip(found, cameras_between(cameras, 200, seed=3), strict=True):
        assert np.array_equal(one.world_to_camera, other.world_to_camera)


def test_cameras_at_one_place_stay_there() -> None:
    turned = [look_at((1, 2, 3), target, width=60, height=40) for target in ((0, 0, 0), (1, 0, 0), (0, 0, 1))]
    for camera in cameras_between(turned, 20, seed=0):
        assert np.allclose(camera.eye, (1, 2, 3))


def test_cameras_lie_between_places_where_several_photos_share_one() -> None:
    """As faces of panoramas do: from each to those of others that look the same way."""
    eyes = np.array([(0, 0, 0), (1, 0, 0), (2, 0.3, 0), (3, 0, 0.2)], np.float64)
    ways = np.array([(1, 0, 0.1), (-1, 0, 0.1), (0.1, 0, 1), (0.1, 0, -1)], np.float64)
    cameras = [look_at(eye, eye + way, width=60, height=40) for eye in eyes for way in ways]
    places, axes = np.repeat(eyes, len(ways), axis=0), np.array([camera.forward for camera in cameras])
    for row in range(len(cameras)):
        chosen = neighbours(row, places, axes)
        assert len({place // len(ways) for place in chosen} - {row // len(ways)}) == len(chosen) == 3
        assert (chosen % len(ways) == row % len(ways)).all()
    around = np.array([camera.eye for camera in cameras_between(cameras, 100, seed=0)])
    assert np.median(np.linalg.norm(around[:, None] - eyes, axis=-1).min(axis=1)) > 0.2


def test_of_two_photos_there_is_one_scene(make: Make, views: list[TrainView], start: Parameters) -> None:
    trainer = EnsembleTrainer(TrainViews(views[:2], 0), start, EXTENT, make().settings, threads=2)
    run(trainer, lambda: trainer.done)
    assert trainer.counters.iteration == STEPS


class Pair(Alone):
    size = 2


def test_who_trains_several(make: Make) -> None:
    settings = make().settings
    assert (
        kind_of_trainer(settings, Alone(), None) is kind_of_trainer(settings, None, None) is EnsembleTrainer
    )
    assert kind_of_trainer(settings, Pair(), None) is Trainer
    assert kind_of_trainer(settings, None, LossPlugin(lambda step: step.photo_loss)) is Trainer
    for fields in ({"minutes": None}, {"iterations": None}, {"ensemble": 1}):
        assert kind_of_trainer(replace(settings, **fields), None, None) is Trainer
    with pytest.raises(ValueError, match="ensemble must be at least 1"):
        replace(settings, ensemble=0)


def test_the_recipe_has_several_where_photos_are_few(views: list[TrainView], points: Any) -> None:
    def chosen(count: int, **fields: Any) -> TrainSettings:
        some = [views[place % len(views)] for place in range(count)]
        return settings_for(capture_of(some, *points), TrainViews(some, 0), **fields)

    assert chosen(6, minutes=5.0).trains_several and chosen(6, minutes=5.0).ensemble == MEMBERS
    for settings in (
        chosen(6),
        chosen(6, iterations=100),
        chosen(6, iterations=100, minutes=5.0),
        chosen(60, minutes=1.0),
        chosen(6, minutes=5.0, ensemble=1),
    ):
        assert not settings.trains_several


def test_a_run_says_what_it_does(make: Make, tmp_path: Path, views: list[TrainView], points: Any) -> None:
    trainer, notes = make(iterations=15), []
    capture = capture_of(views[::3], *points)
    effects = capture_effects(capture, trainer.settings, "auto")
    effect = next(one for one in effects if one.name == SCENES)
    assert effect.on and "15 steps end a scene" in effect.why
    shorter = replace(trainer.settings, shorter=(10, 100))
    effect = next(one for one in capture_effects(capture, shorter, "auto") if one.name == SCENES)
    assert "10 steps, or 15 steps where photos are met well, end a scene" in effect.why
    as_many = replace(shorter, shorter=(15, 100))
    effect = next(one for one in capture_effects(capture, as_many, "auto") if one.name == SCENES)
    assert effect.why.startswith("15 steps end a scene")
    outputs = Outputs(
        scene=tmp_path / "a.ply", checkpoint=tmp_path / "a.safetensors", metrics=None, pictures=tmp_path / "p"
    )
    going = TrainingRun(
        trainer, views[1:3], outputs, started=time.perf_counter(), effects=effects, on_note=notes.append
    )
    while len(trainer.members) < 2:
        going.step()
    shown = going.evaluate().psnr
    assert shown == pytest.approx(
        evaluate(trainer.members[0], views[1:3], trainer.shown_settings, threads=2).psnr, abs=1e-4
    )
    assert going.run()
    told = [note for note in notes if note.startswith(SCENES)]
    assert len(told) == 3 and "another one" in told[0] and "pictures of all 3" in told[2]
    told = {one.name: one for one in going.effects}
    assert told[SCENES].on and "3 from the same photos" in told[SCENES].why
    assert not told[FEW_PHOTOS].on and told[FEW_PHOTOS].why.endswith("the last scene needs none")


SHORT = {"shorter": (STEPS // 2, 150), "minutes": 0.15}
"""9 s: two whole scenes of 4 s, or three of 2 s and a last one, or as many that take 2.8 s at most."""


def test_scenes_are_shorter_where_there_is_no_time_for_several_long_ones(make: Make) -> None:
    trainer = make(**SHORT)
    assert trainer.strategy.settings.max_splats == 150 and trainer.settings.max_splats == 200
    run(trainer, lambda: trainer.done)
    assert trainer.counters.iteration == 4 * STEPS // 2 and len(trainer.members) == 3 and trainer.is_short
    assert trainer.progress == 1
    assert len(trainer.splats) <= 150


def test_photos_that_are_met_well_have_one_long_scene(make: Make) -> None:
    """More steps teach it more: nothing is learnt by heart for want of photos that contradict it."""
    trainer = make(**SHORT, met_loss=10.0)
    run(trainer, lambda: trainer.is_short_decided)
    assert not trainer.is_short and trainer.meets_photos
    assert trainer.strategy.settings.max_splats == 200
    # Of its own length less is over than when it was refined last, and it is refined again.
    assert trainer.state["refined_progress"] <= trainer.scene_progress < 0.5
    run(trainer, lambda: trainer.done)
    assert trainer.counters.iteration == STEPS and len(trainer.members) == 1


def test_scenes_are_shorter_still_where_steps_take_longer_than_thought(make: Make) -> None:
    trainer = make(**SHORT)
    run(trainer, lambda: trainer.done, each=0.16)  # 17 steps in 2.8 s, of 20
    assert trainer.is_short and len(trainer.members) == 2
    assert 3 * STEPS // 2 - 12 < trainer.counters.iteration < 3 * STEPS // 2

    trainer = make(**SHORT | {"shorter": (STEPS - 2, 150)})
    run(trainer, lambda: trainer.done, each=0.25)  # 12 steps are too few: all minutes are for one scene
    assert not trainer.is_short and trainer.scene_progress == 1
    assert trainer.counters.iteration == 36


def test_a_short_scene_that_is_edited_takes_its_time(make: Make) -> None:
    """No other follows it, so that it need not hurry."""
    trainer = make(**SHORT)
    run(trainer, lambda: trainer.counters.iteration == 5)
    trainer.delete(trainer.splats.ids[:3])
    run(trainer, lambda: trainer.done)
    assert trainer.counters.iteration == STEPS and not trainer.members
    assert trainer.strategy.settings.max_splats == 200 and trainer.progress == 1


def test_an_end_of_ones_own_is_that_of_every_scene(make: Make) -> None:
    trainer = make(**SHORT)
    trainer.change(max_splats=120)
    assert trainer.settings.shorter == (STEPS // 2, 120) and trainer.strategy.settings.max_splats == 120
    trainer.change(iterations=STEPS // 4)
    assert trainer.settings.shorter is None
    whole(trainer, 1)
    assert trainer.counters.iteration == STEPS // 4


def test_a_checkpoint_knows_how_long_scenes_are(make: Make, tmp_path: Path) -> None:
    for settings, steps in ((SHORT, 4 * STEPS // 2), (SHORT | {"met_loss": 10.0}, STEPS)):
        trainer = make(**settings)
        run(trainer, lambda trainer=trainer: trainer.is_short_decided)
        save_checkpoint(trainer, tmp_path / "a.safetensors")
        found = load_checkpoint(tmp_path / "a.safetensors")
        resumed = make(**settings)
        assert found.settings == trainer.settings
        restore(resumed, found)
        assert resumed.is_short == trainer.is_short
        assert resumed.strategy.settings == trainer.strategy.settings
        for one in (trainer, resumed):
            run(one, lambda one=one: one.done)
            assert one.counters.iteration == steps
        assert_same(resumed.splats.arrays, trainer.splats.arrays)


def test_how_short_scenes_are() -> None:
    """4,200 steps at most, where there seems to be time for two thirds of a long scene's; more photos
    go by some that are withheld."""
    assert automatic_shorter(12, 3_866, minutes=3, threads=2) == 3_866  # as many as there is time for
    assert automatic_shorter(12, 3_866, minutes=4.5, threads=2) is None  # several of all steps
    assert automatic_shorter(12, 3_866, minutes=1.5, threads=2) is None  # one alone
    assert automatic_shorter(15, 9_000, minutes=7, threads=2) == 4_200
    assert automatic_shorter(15, 9_000, minutes=3.5, threads=4) == 4_200
    assert automatic_shorter(10, 4_650, minutes=3, threads=2) is None
    for minutes in (3, 5, 10, 20):
        assert automatic_shorter(16, 9_600, minutes=minutes, threads=2) is None
        assert automatic_shorter(23, 13_800, minutes=minutes, threads=2) is None


def test_how_short_scenes_of_an_object_are() -> None:
    """As long as those of photos that show something everywhere, where there is time, and never so short that
    nobody has tried."""
    assert automatic_shorter(10, 6_000, minutes=1, threads=2, unmet=4_650) is None
    assert automatic_shorter(10, 6_000, minutes=3, threads=2, unmet=4_650) == 2_769
    assert automatic_shorter(10, 6_000, minutes=10, threads=2, unmet=4_650) == 4_200
    assert automatic_shorter(6, 3_600, minutes=1, threads=2, unmet=1_800) is None
    assert automatic_shorter(6, 3_600, minutes=3, threads=2, unmet=1_800) == 1_800
    assert automatic_shorter(23, 13_800, minutes=3, threads=2, unmet=13_800) == 2_769
    assert automatic_shorter(34, 20_400, minutes=3, threads=2, unmet=20_400) == 2_769
    assert automatic_shorter(35, 21_000, minutes=3, threads=2, unmet=21_000) is None  # 80 for each at least
    large = {"unmet": 20_400, "of_a_minute": 2_600}  # of photos of more pixels a minute has fewer steps
    assert automatic_shorter(28, 16_800, minutes=3, threads=2, **large) == 2_400
    assert automatic_shorter(31, 18_600, minutes=3, threads=2, **large) is None
    assert automatic_shorter(5, 3_000, minutes=10, threads=2, unmet=3_000) is None  # these are as few


def test_how_well_photos_of_an_object_are_to_be_met() -> None:
    """By the loss where they show something: what is empty is right at once."""
    assert automatic_met_loss(1.0, everywhere=True) == FULL_REG_LOSS
    assert automatic_met_loss(0.2, everywhere=False) == pytest.approx(MET_OF_OBJECTS / 5)


def test_photos_of_an_object_may_have_shorter_scenes(views: list[TrainView], start: Parameters) -> None:
    height, width = views[0].camera.height, views[0].camera.width
    alpha = np.zeros((height, width), np.uint8)
    alpha[:, : width // 4] = 255
    cut = [replace(view, alpha=alpha) for view in views[:10]]
    colours = np.full((len(start.means), 3), 128, np.uint8)
    capture = replace(capture_of(cut, start.means.astype(float), colours), background=(0.0, 0.0, 0.0))
    settings = settings_for(capture, TrainViews(cut, 0), minutes=3.0, threads=2)
    steps, splats = settings.shorter or (0, 0)
    assert steps == 2_769 and 0 < splats <= settings.max_splats
    assert settings.met_loss == pytest.approx(MET_OF_OBJECTS / 4, rel=0.1)
    whole = settings_for(capture, TrainViews(cut, 0), minutes=1.0, threads=2)
    assert whole.shorter is None and whole.iterations == settings.iterations


def test_large_photos_leave_no_time_for_several_scenes(start: Parameters) -> None:
    """Where most of a run is on smaller photos because there is no time for all pixels; but where photos are
    enough to withhold some, these may speak for several, if minutes are enough."""
    colours, rng = np.full((len(start.means), 3), 128, np.uint8), np.random.default_rng(5)
    large = 1000, 800
    for photos, (width, height), minutes, shorter, withheld in (
        *((12, (80, 60), 6.0, True, False), (12, large, 3.0, False, False), (12, large, 9.0, True, True)),
        *((21, (80, 60), 3.0, True, True), (21, large, 3.0, False, False), (21, large, 20.0, True, True)),
    ):
        ring = [(3 * np.sin(a), 0.5, 3 * np.cos(a)) for a in np.linspace(0, 6, photos)]
        cameras = [look_at(eye, (0, 0, 0), width=width, height=height) for eye in ring]
        pixels = [rng.integers(0, 256, (height, width, 3), np.uint8) for _ in ring]
        noise = [TrainView(camera, array) for camera, array in zip(cameras, pixels, strict=True)]
        capture = capture_of(noise, start.means.astype(float), colours)
        settings = settings_for(capture, TrainViews(noise, 0), minutes=minutes, threads=2)
        assert (settings.shorter is not None) == shorter
        assert (settings.withheld > 0) == withheld


def test_the_scene_that_waits_is_measured_once(
    make: Make, tmp_path: Path, views: list[TrainView], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splatview.trainer.run.EVALUATION_SHARE", np.inf)
    trainer, measured = make(), []
    trainer.initial = Parameters(*(array[:50] for array in trainer.initial))  # what the next one begins with

    def note(progress: RunProgress) -> None:
        if progress.evaluation is not None:
            measured.append((progress.step.iteration, progress.splats))

    outputs = Outputs(
        scene=tmp_path / "a.ply", checkpoint=tmp_path / "a.safetensors", metrics=None, pictures=tmp_path / "p"
    )
    going = TrainingRun(
        trainer, views[1:2], outputs, started=time.perf_counter(), eval_seconds=0.0, on_progress=note
    )
    assert going.run()
    steps = [iteration for iteration, _ in measured]
    assert steps == list(range(1, STEPS + 1))  # eval_seconds of 0 asks for it after every step
    assert measured[-1][1] == len(trainer.members[0].means) > 50  # while the next one is in training
    last = going.final_evaluation()
    assert last is going.evaluation is not None and going.evaluated_at == 4 * STEPS


def test_a_window_shows_the_first_scene_until_the_last_is_done(
    make: Make, tmp_path: Path, views: list[TrainView]
) -> None:
    trainer = make(iterations=20)
    outputs = Outputs(
        scene=tmp_path / "a.ply", checkpoint=tmp_path / "a.safetensors", metrics=None, pictures=tmp_path / "p"
    )
    going = TrainingRun(trainer, views[1:2], outputs, started=time.perf_counter())
    thread, seen = BackgroundTraining(going, snapshot_seconds=0.0), []
    try:
        thread.begin()
        while thread.status.saved_at != 80:
            snapshot = thread.take_snapshot()
            if snapshot is not None:
                seen.append(snapshot)
        last = thread.take_snapshot() or seen[-1]
    finally:
        thread.close()
    assert len(trainer.members) == 3 and last.iteration == 80
    assert not [one for one in seen if 20 < one.iteration < 80]
    for snapshot in seen:
        assert len(snapshot.ids) == len(snapshot.gaussians)
        if snapshot.iteration == 20:
            assert np.array_equal(snapshot.gaussians.means, trainer.members[0].means)
    assert np.array_equal(last.gaussians.means, trainer.splats.arrays.means)
    assert np.array_equal(load_scene(outputs.scene).means, last.gaussians.means)


def test_its_memory_is_stated() -> None:
    sizes = PhotoSizes(pixels=10 * 10**6, trained=8 * 10**6, largest=10**6, stored=10**6)
    machine = Machine(left=10**10, threads=2, compiles=False)
    one, several = (
        run_memory(sizes, resolution=((0.3, 2),), ensemble=count, machine=machine) for count in (1, 3)
    )
    taught = pictures_taught(8, 10**6)
    assert 16 <= taught < PICTURES
    assert several.photos - one.photos == pytest.approx(4 * taught * 10**6 * 1.25)
    assert several.splat - one.splat == pytest.approx(4 * 4 * 59)


def test_what_python_and_the_ladder_chose_is_handed_on(
    capture_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last scene, which else has settings of its own."""
    ladder = make_trainer(
        load_capture(capture_folder),
        TrainingRung(knob="dropout", value="none", changes={"dropout": 0.0}),
        1.0,
        0,
    )
    assert isinstance(ladder, EnsembleTrainer) and ladder.asked == {"dropout"}

    class Handed(Exception):
        pass

    def spy(*_: object, asked: dict[str, object], **__: object) -> None:
        raise Handed(*asked)

    monkeypatch.setattr(setup, "trainer_for", spy)
    with pytest.raises(Handed) as caught:
        train(capture_folder, minutes=1.0, max_aspect=3.0)
    assert caught.value.args == ("max_aspect",)
