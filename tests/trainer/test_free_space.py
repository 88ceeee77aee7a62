"""Free space before cameras: what stands there goes, and nothing else."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import ImageModel
from splatview.scene.captures import Capture
from splatview.scene.captures.capture import LONG_LENS
from splatview.scene.effects.effect import Effect, Saving
from splatview.scene.effects.overrides import settings_for as scene_settings
from splatview.scene.formats import load_scene, save_scene
from splatview.trainer import free_space
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.effects import PASSING
from splatview.trainer.free_space import (
    ABOUT,
    GONE,
    MAX_SIZE,
    MAX_SIZE_OF_OBJECTS,
    block_of,
    change,
    limit_sizes,
    nearest_by_blocks,
    nearest_depths,
    passing,
    standing_before,
    worth_keeping,
)
from splatview.trainer.run import Outputs, TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.setup import settings_for, trainer_for
from splatview.trainer.trainer import CLEAR_STEPS, Trainer
from splatview.trainer.views import TrainView, TrainViews

from .conftest import capture_of


def before(view: TrainView, depth: float, aside: float = 0.0) -> np.ndarray:
    """(3,): a place at a depth before a camera, `aside` halves of its picture from the middle."""
    camera = view.camera
    local = np.array([aside * depth * camera.width / 2 / camera.fx, 0.0, depth])
    return (local - camera.t_camera_world) @ camera.R_camera_world


def test_where_a_scene_begins_is_where_points_do(views: list[TrainView]) -> None:
    view = views[0]
    points = np.stack([before(view, depth) for depth in np.linspace(2, 4, 200)])
    wrong = before(view, 0.1)[None]
    depths = nearest_depths(np.concatenate([points, wrong]), [view])
    assert 2 <= depths[0] < 2.1, "one point that is wrong does not count"
    assert nearest_depths(points[:5], [view])[0] == 0, "five points say nothing"
    behind = np.stack([before(view, -depth) for depth in np.linspace(2, 4, 200)])
    assert nearest_depths(behind, [view])[0] == 0


def test_only_what_a_camera_shows_stands_before_it(views: list[TrainView]) -> None:
    view = views[0]
    places = [before(view, 0.5), before(view, 1.5), before(view, 0.5, 2.0), before(view, -0.5)]
    means = np.array([*places, [np.nan] * 3], np.float32)
    found = standing_before(means, np.arange(5, dtype=np.int32), view.camera, 1.0)
    assert found.tolist() == [0], "neither farther, nor aside, nor behind, nor nowhere"
    assert standing_before(means, np.array([1, 2], np.int32), view.camera, 1.0).tolist() == []


@pytest.mark.parametrize("shape", [(40, 48), (183, 245), (61, 40), (8, 300)])
def test_depths_by_blocks_are_the_least_of_what_is_about(shape: tuple[int, int]) -> None:
    depths = np.random.default_rng(0).uniform(2, 9, shape).astype(np.float32)
    block, near = block_of(*shape), (shape[0] // 2, shape[1] // 3)
    depths[near] = 1.0
    blocks = nearest_by_blocks(depths)
    assert blocks.shape == tuple(-(-size // block) for size in shape)
    of_pixels = blocks.repeat(block, axis=0).repeat(block, axis=1)[: shape[0], : shape[1]]
    assert (of_pixels <= depths).all()
    rows, columns = np.indices(blocks.shape)
    about = (abs(rows - near[0] // block) <= ABOUT) & (abs(columns - near[1] // block) <= ABOUT)
    assert ((blocks == 1.0) == about).all()


def test_before_a_picture_each_block_has_a_depth_of_its_own(views: list[TrainView]) -> None:
    view = views[0]
    block = block_of(view.camera.height, view.camera.width)
    depths = np.zeros([-(-size // block) for size in view.pixels.shape[:2]], np.float32)
    depths[:, depths.shape[1] // 2 :] = 1.0
    places = [(0.5, 0.5), (0.5, -0.5), (1.5, 0.5), (0.5, 2.0), (-0.5, 0.5)]
    means = np.array([before(view, *place) for place in places], np.float32)
    found = standing_before(means, np.arange(5, dtype=np.int32), view.camera, depths)
    assert found.tolist() == [0], "not where nothing is known, nor farther, nor outside"
    rows = np.arange(5, dtype=np.int32)
    assert standing_before(means, rows, view.camera, depths, near=0.4).tolist() == [0]
    assert standing_before(means, rows, view.camera, depths, near=0.6).tolist() == [], "before a near plane"
    assert standing_before(means, np.arange(5, dtype=np.int32), view.camera, np.zeros_like(depths)).size == 0


def veiled(start: Parameters, views: list[TrainView]) -> Parameters:
    """The start with its first splat before the first camera, as wide as the picture."""
    start = Parameters(*(array.copy() for array in start))
    start.means[0], start.log_scales[0], start.opacity_logits[0] = before(views[0], 0.4), -1.5, 1.0
    return start


def test_other_cameras_see_past_what_stands_in_free_space(
    views: list[TrainView], start: Parameters, make_trainer, tmp_path: Path
) -> None:
    trainer = make_trainer()
    assert trainer.shown_settings == trainer.render_settings, "nothing is known"
    assert trainer.snapshot().comments == ("Trained by splatview",)
    trainer.nearest_depths[:] = [0, *np.linspace(2.0, 3.0, len(trainer.views) - 1)]
    assert trainer.shown_settings.model.near == 1.0, "half of the least, and none is 0"
    assert trainer.render_settings.model.near == ImageModel().near, "photos are trained on as they were"
    save_scene(trainer.snapshot(), tmp_path / "scene.ply")
    assert scene_settings(load_scene(tmp_path / "scene.ply")).model.near == 1.0

    veil = veiled(start, views)
    pictures = [
        draw_frame(veil, views[0].camera, settings, Workspace()).image
        for settings in (trainer.render_settings, trainer.shown_settings)
    ]
    assert np.abs(pictures[1] - pictures[0]).max() > 0.3
    rest = Parameters(*(array[1:] for array in veil))
    without = draw_frame(rest, views[0].camera, trainer.render_settings, Workspace()).image
    np.testing.assert_allclose(pictures[1], without, atol=1e-6)
    trainer.change(free_space=0.0)
    assert trainer.shown_settings == trainer.render_settings


@pytest.mark.parametrize("share", [0.5, 0.0])
def test_a_veil_before_a_camera_goes(
    views: list[TrainView], start: Parameters, make_trainer, share: float
) -> None:
    settings = make_trainer(strategy="classic").settings
    trainer = Trainer(
        TrainViews(views[:1], 0), veiled(start, views), 3.0, replace(settings, free_space=share)
    )
    trainer.nearest_depths[:] = 1.5
    opaque = trainer.splats.arrays.opacity_logits[1:].copy()
    for _ in range(CLEAR_STEPS):
        trainer.step()
    logits = trainer.splats.arrays.opacity_logits
    assert (logits[0] == GONE) == (share > 0)
    assert np.abs(logits[1:] - opaque).max() < 0.1 * CLEAR_STEPS, "the others are left alone"


def sized(start: Parameters, log_scales: np.ndarray) -> Parameters:
    """A copy of the start with other sizes."""
    return Parameters(*(array.copy() for array in start._replace(log_scales=log_scales.astype(np.float32))))


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_no_splat_is_longer_than_a_share_of_its_distance(
    views: list[TrainView], start: Parameters, unit: float
) -> None:
    camera, rng = views[0].camera, np.random.default_rng(5)
    camera = replace(
        camera,
        world_to_camera=np.block(
            [[camera.world_to_camera[:3, :3], unit * camera.t_camera_world[:, None]], [np.zeros((1, 3)), 1]]
        ),
    )
    count = len(start.means)
    splats = sized(
        start._replace(means=np.float32(unit) * start.means), rng.normal(0, 2, (count, 3)) + np.log(unit)
    )
    before = splats.log_scales.copy()
    some = np.arange(0, count, 2, dtype=np.int32)
    limit_sizes(splats, [some[:7], some[7:]], camera, 0.5)
    most = np.log(0.5 * np.linalg.norm(splats.means - camera.eye, axis=1))
    wide = before.max(axis=1) > most
    assert wide[some].any() and not wide[some].all()
    expected = np.where(np.arange(count)[:, None] % 2 == 0, np.minimum(before, most[:, None]), before)
    # Squares of float32 distances: half a dozen roundings.
    np.testing.assert_allclose(splats.log_scales, expected, rtol=0, atol=1e-6 * (1 + abs(np.log(unit))))
    np.testing.assert_array_equal(splats.log_scales[~wide], before[~wide], "what is short stays to the bit")
    again = splats.log_scales.copy()
    limit_sizes(splats, [some], camera, 0.5)
    np.testing.assert_allclose(splats.log_scales, again, rtol=0, atol=1e-6 * (1 + abs(np.log(unit))))


def test_sizes_of_splats_that_are_nowhere_stay(views: list[TrainView], start: Parameters) -> None:
    splats = sized(start, np.full_like(start.log_scales, 3.0))
    splats.means[0], splats.means[1] = np.nan, views[0].camera.eye
    splats.log_scales[2] = np.nan
    limit_sizes(splats, [np.arange(4, dtype=np.int32)], views[0].camera, 0.5)
    assert (splats.log_scales[:2] == 3).all(), "neither without a place nor at the eye itself"
    assert np.isnan(splats.log_scales[2]).all()
    assert (splats.log_scales[3] < 3).all()


@pytest.mark.parametrize("max_size", [0.5, np.inf])
def test_a_run_limits_sizes(views: list[TrainView], start: Parameters, make_trainer, max_size: float) -> None:
    splats = Parameters(*(array.copy() for array in start))
    splats.log_scales[0] = 3.0
    settings = replace(make_trainer(strategy="classic").settings, max_size=max_size, free_space=0.0)
    trainer = Trainer(TrainViews(views[:1], 0), splats, 3.0, settings)
    for _ in range(CLEAR_STEPS):
        trainer.step()
    arrays = trainer.splats.arrays
    most = np.log(0.5 * np.linalg.norm(arrays.means[0] - views[0].camera.eye))
    assert (arrays.log_scales[0].max() <= most + 1e-5) == (max_size == 0.5)
    assert np.abs(arrays.log_scales[1:] - start.log_scales[1:]).max() < 0.1 * CLEAR_STEPS


def test_splats_of_an_object_are_smaller(views: list[TrainView]) -> None:
    """Where photos say what is empty; what they show everywhere may need large ones."""
    capture = capture_of(views, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    shown = TrainViews(views, 0)  # before a plain grey
    assert settings_for(capture, shown, iterations=100).max_size == MAX_SIZE_OF_OBJECTS < MAX_SIZE
    assert settings_for(capture, shown, iterations=100, backdrop="off").max_size == MAX_SIZE
    assert settings_for(capture, shown, iterations=100, max_size=0.3).max_size == 0.3


def test_a_size_limit_is_above_zero(make_trainer) -> None:
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="max_size"):
            replace(make_trainer().settings, max_size=wrong)


def test_a_resumed_run_knows_where_scenes_begin(
    views: list[TrainView], start: Parameters, make_trainer, tmp_path: Path
) -> None:
    path, trainer = tmp_path / "run.safetensors", make_trainer()
    trainer.nearest_depths[:] = np.arange(len(trainer.views)) + 1.5
    trainer.step()
    save_checkpoint(trainer, path)
    resumed = Trainer(trainer.views, start, 3.0, trainer.settings)
    restore(resumed, load_checkpoint(path))
    assert np.array_equal(resumed.nearest_depths, trainer.nearest_depths)
    assert resumed.shown_settings == trainer.shown_settings != trainer.render_settings


def test_random_points_say_nothing(views: list[TrainView], start: Parameters) -> None:
    colours = np.full((len(start.means), 3), 128, np.uint8)
    capture = capture_of(views, start.means.astype(float), colours)
    ring = TrainViews(views, 0)
    for guessed in (False, True):
        told = replace(capture, guessed=guessed)
        settings: TrainSettings = settings_for(told, ring, iterations=10, start="points")
        trainer = trainer_for(told, ring, settings, centre=np.zeros(3))
        assert (trainer.nearest_depths > 0).any() != guessed


def test_the_extent_is_how_far_the_scene_is(views: list[TrainView], start: Parameters) -> None:
    colours = np.full((len(start.means), 3), 128, np.uint8)
    around, ring = capture_of(views, start.means.astype(float), colours), TrainViews(views, 0)
    ahead = replace(around, points=9 * around.points)
    settings: TrainSettings = settings_for(around, ring, iterations=10, start="points", sky="off")

    def extent(capture: Capture) -> float:
        return trainer_for(capture, ring, settings, centre=np.zeros(3)).extent

    assert extent(around) == around.scene_radius
    assert extent(ahead) == ahead.usual_distance > around.scene_radius
    assert extent(replace(ahead, guessed=True)) == ahead.scene_radius, "random points say nothing"


@pytest.mark.parametrize("times", [1.0, 3.0, 30.0])
def test_from_farther_away_by_a_longer_lens_a_scene_is_as_large(
    views: list[TrainView], start: Parameters, times: float
) -> None:
    colours = np.full((len(start.means), 3), 128, np.uint8)

    around = capture_of(views, start.means.astype(float), colours)

    def seen_from(factor: float) -> tuple[float, float]:
        moved = []
        for view in views:
            pose, camera = view.camera.world_to_camera.copy(), view.camera
            pose[:3, 3] *= factor
            length = 2 * factor * max(camera.width, camera.height)
            moved.append(replace(view, camera=replace(camera, world_to_camera=pose, fx=length, fy=length)))
        capture = capture_of(moved, start.means.astype(float), colours)
        return capture.extent, TrainViews(moved, 0).focal

    (near, focal), (far, far_focal) = seen_from(1.0), seen_from(times)
    assert far == pytest.approx(near) == around.scene_radius * LONG_LENS / 2
    assert far_focal == pytest.approx(focal), "what a pixel shows is as large a part of it"


def with_strays(start: Parameters) -> Parameters:
    """The start and three splats that no photo shows: faint, above all cameras, and behind the one
    before, which hides it."""
    extra = Parameters(*(np.concatenate([array, array[:4]]) for array in start))
    extra.opacity_logits[-4:] = -9.0, 3.0, 12.0, -5.0
    extra.means[-4:] = (0, 0, 0), (0, 30, 0), (0, 0, 0), (0, 0, 0)
    extra.log_scales[-4:] = np.array([-2.0, -2.0, 0.0, -6.0])[:, None]
    return extra


def test_what_photos_show(views: list[TrainView], start: Parameters, make_trainer) -> None:
    trainer = Trainer(TrainViews(views, 0), with_strays(start), 3.0, make_trainer().settings)
    settings, scene = trainer.render_settings, trainer.snapshot()

    def keeps(views: list[TrainView], least_shown: float = 2e-6) -> np.ndarray:
        return worth_keeping(scene, views, settings, least_shown=least_shown, least_visibility=0.0)

    found = keeps(views)
    assert found[-4:].tolist() == [False, False, True, False]
    larger = [
        replace(view, camera=view.camera.resized(960, 800), pixels=np.zeros((800, 960, 3), np.uint8))
        for view in views
    ]
    np.testing.assert_array_equal(keeps(larger)[-4:], found[-4:])
    assert keeps(views, 0.0).all()


def test_what_no_photo_shows_goes_as_density_control_ends(
    views: list[TrainView], start: Parameters, make_trainer
) -> None:
    settings = replace(make_trainer(iterations=8).settings, refine_until=0.5)
    trainer = Trainer(TrainViews(views, 0), start, 3.0, settings)
    counts = []
    while not trainer.done:
        if trainer.counters.iteration in (2, 6):
            trainer.splats.arrays.opacity_logits[:3] = -9.0
        trainer.step()
        counts.append(len(trainer.splats))
    assert counts == [*[len(start.means)] * 4, *[len(start.means) - 3] * 3, len(start.means) - 6]


def test_what_hides_behind_others(views: list[TrainView], start: Parameters, make_trainer) -> None:
    """The large ball hides much of the scene: a splat in its middle shows nothing, and one beside it all."""
    scene = Parameters(*(array[:3].copy() for array in start))
    scene.means[:] = (0, 0, 0), (0, 0, 0), (0, 0.9, 0)
    scene.log_scales[:] = np.log([[0.3], [0.02], [0.05]])
    scene.opacity_logits[:] = 9.0, 2.0, 2.0
    trainer = Trainer(TrainViews(views, 0), scene, 3.0, make_trainer().settings)
    given = trainer.snapshot(), views, trainer.render_settings
    for least, kept in ((0.0, True), (0.05, False)):
        found = worth_keeping(*given, least_shown=0, least_visibility=least)
        assert found.tolist() == [True, kept, True]


def shining(view: TrainView, count: int) -> Parameters:
    """Before a photo's camera a dark splat, through which little comes, and so many bright ones behind it."""
    parameters = Parameters(
        means=np.stack([before(view, 3.0)] + [before(view, 3.3)] * count).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count + 1, 1)),
        log_scales=np.full((count + 1, 3), np.log(0.05), np.float32),
        opacity_logits=np.zeros(count + 1, np.float32),
        sh=np.full((count + 1, 1, 3), 3.0, np.float32),
    )
    parameters.log_scales[0], parameters.opacity_logits[0], parameters.sh[0] = 0.0, 4.0, -1.7
    return parameters


def test_what_hides_stays_where_pictures_would_change(views: list[TrainView], make_trainer) -> None:
    """Of each bright splat a photo shows a fiftieth, and all together it would miss."""
    scene = shining(views[0], 6)
    trainer = Trainer(TrainViews(views[:1], 0), scene, 3.0, make_trainer().settings)
    ball, settings = trainer.snapshot(), trainer.render_settings

    def kept(most_changed: float = math.inf) -> list[bool]:
        given = ball, views[:1], settings
        return worth_keeping(
            *given, least_shown=0.0, least_visibility=0.05, most_changed=most_changed
        ).tolist()

    front = [True] + [False] * 6
    assert kept() == front
    by = change(ball, np.array(front), [views[0].camera], settings)
    assert 1e-8 < by < 1e-3
    assert kept(1.01 * by) == front
    assert all(all(kept(most)) for most in (0.99 * by, 0.0, math.nan))


def test_of_many_photos_some_tell_what_would_change(
    views: list[TrainView], make_trainer, monkeypatch
) -> None:
    """Both of two photos, or the first alone where both have too many pixels."""
    scene = shining(views[0], 6)
    trainer = Trainer(TrainViews(views[:2], 0), scene, 3.0, make_trainer().settings)
    ball, settings, looked_at = trainer.snapshot(), trainer.render_settings, []

    def changed(scene, kept, cameras, settings, **how) -> float:
        looked_at.append([camera.name for camera in cameras])
        return change(scene, kept, cameras, settings, **how)

    monkeypatch.setattr(free_space, "change", changed)
    for pixels in (free_space.COMPARED_PIXELS, 1):
        monkeypatch.setattr(free_space, "COMPARED_PIXELS", pixels)
        worth_keeping(ball, views[:2], settings, least_shown=0.0, least_visibility=0.5, most_changed=1.0)
    names = [view.camera.name for view in views[:2]]
    assert looked_at == [names, names[:1]]


def test_nothing_is_changed_by_what_nothing_shows(views: list[TrainView], start: Parameters, make_trainer):
    trainer = Trainer(TrainViews(views, 0), with_strays(start), 3.0, make_trainer().settings)
    scene, settings = trainer.snapshot(), trainer.render_settings
    kept = worth_keeping(scene, views, settings, least_shown=2e-6, least_visibility=0.0)
    cameras = [view.camera for view in views]
    assert not kept.all() and change(scene, kept, cameras, settings) < 1e-9
    assert change(scene, np.zeros(len(scene), np.bool_), cameras, settings) > 1e-4


def test_what_is_in_the_sky_stays(views: list[TrainView], start: Parameters, make_trainer) -> None:
    trainer = Trainer(TrainViews(views, 0), with_strays(start), 3.0, make_trainer(iterations=1).settings)
    trainer.state["sky"] = np.zeros(len(trainer.splats), np.uint8)
    trainer.state["sky"][-3] = 1
    numbers = trainer.splats.ids[-4:].copy()
    trainer.step()
    assert np.isin(numbers, trainer.splats.ids).tolist()[:2] == [False, True], "the faint one goes"


def with_a_branch(start: Parameters, view: TrainView, aside: float = 0.0) -> Parameters:
    """The start behind one splat right before a camera, which no other shows, and a wall behind all that."""
    scene = Parameters(*(np.concatenate([array, array[:2]]) for array in start))
    scene.means[-2:] = before(view, 0.3, aside), before(view, 3.5, aside)
    scene.log_scales[-2:] = np.log([[0.02], [1.2]])
    scene.opacity_logits[-2:] = 3.0, 12.0
    return scene


@pytest.mark.parametrize("aside", [0.0, 1.05])
def test_what_one_photo_alone_shows_before_what_others_do(
    views: list[TrainView], start: Parameters, make_trainer, aside: float
) -> None:
    """Beside the picture, too, into which it reaches."""
    views = views[:4]  # the far side of the ring shows the branch, too
    scene = with_a_branch(start, views[0], aside)
    trainer = Trainer(TrainViews(views, 0), scene, 3.0, make_trainer().settings)
    given = trainer.snapshot(), views, trainer.render_settings
    found = passing(*given)
    assert found[-2], "the branch"
    assert not found[-1], "the wall, which several photos show"
    stays = np.zeros(len(found), np.bool_)
    stays[-2] = True
    assert not passing(*given, stays=stays)[-2]
    assert not passing(*given, most_of_one=1.0).any()
    assert not passing(given[0], views[:1], given[2]).any(), "of one photo nothing is known"
    scene.opacity_logits[-1] = -3.0  # no longer a wall: the branch is all there is
    for_itself = Trainer(TrainViews(views, 0), scene, 3.0, make_trainer().settings).snapshot()
    assert not passing(for_itself, *given[1:])[-2], "it hangs before nothing"


@pytest.mark.parametrize(("share", "full"), [(0.95, 0.0), (1.0, 0.0), (0.95, 1e3)])
def test_it_goes_as_the_run_ends(
    views: list[TrainView], start: Parameters, make_trainer, share: float, full: float
) -> None:
    settings = make_trainer(iterations=3).settings
    settings = replace(settings, most_of_one=share, full_reg_loss=full, free_space=0.0, least_shown=0.0)
    trainer = Trainer(TrainViews(views[:4], 0), with_a_branch(start, views[0]), 3.0, settings)
    branch = trainer.splats.ids[-2]
    for _ in range(2):
        trainer.step()
        assert branch in trainer.splats.ids
    trainer.step()
    goes = share < 1 and full == 0  # photos met within a loss of 1,000 need no guesses
    assert (branch in trainer.splats.ids) != goes
    assert bool(trainer.passed) == goes


@pytest.mark.parametrize("full", [0.0, 1e3])
def test_a_run_says_how_many_went(
    views: list[TrainView], start: Parameters, make_trainer, tmp_path, full: float
) -> None:
    settings = replace(make_trainer(iterations=2).settings, full_reg_loss=full, free_space=0.0)
    trainer = Trainer(TrainViews(views[:4], 0), with_a_branch(start, views[0]), 3.0, settings)
    outputs = Outputs(
        scene=tmp_path / "s.ply", checkpoint=tmp_path / "s.safetensors", metrics=None, pictures=tmp_path / "p"
    )
    effect, notes = Effect(name=PASSING, on=False, why="", saving=Saving()), []
    run = TrainingRun(trainer, [], outputs, started=0.0, effects=(effect,), on_note=notes.append)
    run.step()
    assert not any(PASSING in note for note in notes)
    run.step()
    if full:
        assert trainer.passed is None and not run.effects[0].on and "not looked for" in run.effects[0].why
        assert not any(PASSING in note for note in notes)
        return
    said = f"{trainer.passed} in front of what other photos show were taken out"
    assert trainer.passed and run.effects[0].on and run.effects[0].why == said
    assert [note for note in notes if PASSING in note] == [
        f"{PASSING}: {said}; --passing stay leaves them in"
    ]
