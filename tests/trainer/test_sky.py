"""Sky: the evidence for one, its splats, and what training leaves alone of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.raster import draw_frame, render
from splatview.raster.frame import Workspace
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.camera import look_at
from splatview.scene.captures.capture import Capture, Photo, Pixels
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.framing import bulk, without_sky
from splatview.scene.health import check
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.effects import SKY, capture_effects, with_sky_found
from splatview.trainer.exposure import measured_evidence
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.settings import TrainSettings, from_recorded, recorded
from splatview.trainer.setup import kernel_threads_only, settings_for, trainer_for
from splatview.trainer.sky import FINE_SHARE, FIXED, TRAINED, Sky, find_sky, nearest, sphere
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainViews, train_views

UP = np.array([0.0, -1.0, 0.0])

LEVEL = 1.0
"""The ground is the plane y = LEVEL."""

Paint = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Colours (N, 3) from an eye (3,) along unit directions (N, 3)."""


def ground(eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """A chequered plane."""
    down = np.maximum(directions[:, 1], 1e-3)
    places = eye + directions * ((LEVEL - eye[1]) / down)[:, None]
    chequer = (np.floor(places[:, 0]) + np.floor(places[:, 2])) % 2
    return np.where(chequer[:, None] > 0, (0.5, 0.4, 0.2), (0.2, 0.3, 0.1))


def sky_colour(directions: np.ndarray) -> np.ndarray:
    """Blue above, pale below, and brighter at one side."""
    height, side = -directions[:, 1:2], directions[:, :1]
    return np.clip((0.7, 0.8, 0.95) + height * np.array((-0.6, -0.45, -0.2)) + 0.15 * side, 0, 1)


def outdoors(eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
    return np.where(directions[:, 1:2] > 0, ground(eye, directions), sky_colour(directions))


def indoors(eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """A room with plain walls of uneven light, at some 6 units."""
    ways = np.full(len(directions), np.inf)
    for axis, half in enumerate((6.0, 4.0, 6.0)):
        with np.errstate(divide="ignore"):
            ways = np.minimum(ways, (np.sign(directions[:, axis]) * half - eye[axis]) / directions[:, axis])
    places = eye + directions * ways[:, None]
    light = 0.85 - 0.04 * np.linalg.norm(places - (2, -4, 3), axis=1)
    walls = light[:, None] * np.array((1.0, 0.97, 0.92))
    return np.where(directions[:, 1:2] > 0, ground(eye, directions), walls)


def capture_of(paint: Paint, *, alpha: bool = False, count: int = 12, quarters: int = 0) -> Capture:
    """Photos from a ring, which look outwards and a little up; points on the ground. `quarters`: turns of the
    camera about its axis."""
    cosine, sine = round(math.cos(quarters * math.pi / 2)), round(math.sin(quarters * math.pi / 2))
    turn = np.eye(4)
    turn[:2, :2] = (cosine, sine), (-sine, cosine)
    photos = []
    for i in range(count):
        angle = 2 * np.pi * i / count
        eye = np.array([np.sin(3 * angle), 0.0, np.cos(3 * angle)]) * 1.5
        ahead = np.array([np.sin(angle), -0.25, np.cos(angle)])
        camera = look_at(eye, eye + ahead, up=UP, fov_y=65, width=64, height=48)
        camera = replace(camera, name=f"{i}.png", world_to_camera=turn @ camera.world_to_camera)
        pixels = Pixels(
            image=painted(paint, camera),
            mask=None,
            alpha=np.full((48, 64), 255, np.uint8) if alpha else None,
        )
        photos.append(Photo(name=camera.name, camera=camera, held_out=False, pixels=lambda p=pixels: p))
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (1500, 3)) * (1, 0, 1) + (0, LEVEL, 0)
    return Capture(
        name="made",
        photos=tuple(photos),
        points=points,
        point_colours=np.full((len(points), 3), 90, np.uint8),
        background=(0.0, 0.0, 0.0) if alpha else None,
    )


def painted(paint: Paint, camera: Camera) -> np.ndarray:
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    rays = camera.points_at(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), 1.0) @ camera.R_camera_world
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    colours = paint(camera.eye, rays).reshape(camera.height, camera.width, 3)
    return np.ascontiguousarray((np.clip(colours, 0, 1) * 255 + 0.5).astype(np.uint8))


def found(capture: Capture, mode: str = "auto", most: int = 9000) -> Sky:
    return find_sky(capture, train_views(capture.train), capture.points, mode=mode, most=most)  # pyright: ignore


@pytest.fixture(scope="module")
def open_air() -> Capture:
    return capture_of(outdoors)


def trainer_of(capture: Capture, **fields: object) -> Trainer:
    views = TrainViews(train_views(capture.train), 0)
    settings = settings_for(capture, views, **{"iterations": 60, "max_splats": 6000, **fields})  # pyright: ignore
    return trainer_for(capture, views, settings, centre=np.zeros(3), threads=2)


def test_photos_that_agree_at_infinity_show_a_sky(open_air: Capture) -> None:
    sky = found(open_air)
    assert sky.count > sky.fine > 100 and sky.evidence.share > 0.3 and sky.evidence.left < 0.5


@pytest.mark.parametrize("quarters", [1, 3])
def test_photos_on_their_sides_show_the_same_sky(open_air: Capture, quarters: int) -> None:
    """Portraits are stored so, one way or the other, whichever way is up."""
    upright, sky = found(open_air), found(capture_of(outdoors, quarters=quarters))
    assert sky.evidence.share == pytest.approx(upright.evidence.share, abs=0.1)
    assert sky.count > sky.fine > 100


def test_plain_walls_are_no_sky() -> None:
    sky = found(capture_of(indoors))
    # They agree about much of it, but better as if it were nearer.
    assert sky.count == 0 and sky.evidence.left > 1 and "plain wall" in str(sky.evidence)


def over_ground(even: tuple[float, float, float]) -> Paint:
    """The chequered plane below one colour, with a noise that is each photo's own."""

    def paint(eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(abs(int(1e6 * eye.sum())))
        above = np.clip(np.array(even) + rng.normal(scale=0.01, size=directions.shape), 0, 1)
        return np.where(directions[:, 1:2] > 0, ground(eye, directions), above)

    return paint


def test_what_is_as_even_as_a_wall_is_a_sky_where_it_is_bright_and_blue() -> None:
    bright, warm, dark, cool = (
        found(capture_of(over_ground(even)))
        for even in ((0.8, 0.88, 0.97), (0.97, 0.9, 0.8), (0.12, 0.16, 0.2), (0.88, 0.9, 0.91))
    )
    for sky in (bright, warm, dark, cool):
        assert 0.7 < sky.evidence.left < 1.25 and sky.evidence.share > 0.3
    assert bright.count > 0 and "but in the colours of a sky" in str(bright.evidence)
    assert warm.count == dark.count == cool.count == 0 and "plain wall" in str(warm.evidence)
    # Overexposed: nothing is left of its colours, and nothing is known.
    white = found(capture_of(lambda eye, d: np.where(d[:, 1:2] > 0, ground(eye, d), np.ones((len(d), 3)))))
    assert white.evidence.left == np.inf and white.count == 0


def test_transparent_photos_and_random_points_say_nothing(open_air: Capture) -> None:
    assert found(capture_of(outdoors, alpha=True)).count == 0
    views = train_views(open_air.train)
    sky = find_sky(open_air, views, open_air.points, mode="auto", most=9000, random_points=True)
    assert sky.count == 0 and "random" in str(sky.evidence)
    asked = find_sky(open_air, views, open_air.points, mode="on", most=9000, random_points=True)
    assert asked.count > 0


def test_ground_alone_is_no_sky() -> None:
    def plane(eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
        return ground(eye, np.abs(directions))

    assert found(capture_of(plane)).count == 0


def test_shells_are_far_opaque_and_coloured_as_the_sky(open_air: Capture) -> None:
    sky = found(open_air)
    assert sky.parameters is not None
    distances = np.linalg.norm(sky.parameters.means, axis=1)
    reach = np.linalg.norm(open_air.points, axis=1).max()
    assert distances.min() > 9 * reach and distances.max() < 2.1 * distances.min()
    # A view that no photo has: straight up.
    camera = look_at((0, 0, 0), (0.05, -1, 0.05), up=(0, 0, 1), fov_y=50, width=48, height=48)
    picture = draw_frame(sky.parameters, camera, RenderSettings(), Workspace()).image
    assert picture[..., 3].min() > 0.99
    truth = painted(outdoors, camera) / 255
    # By heights that photos end below: what they show nearest. Black is wrong by more than 0.4.
    assert np.abs(picture[..., :3] - truth).mean() < 0.15


def test_the_sky_is_as_fine_as_its_share_of_the_splats_allows(open_air: Capture) -> None:
    few, more, most = (found(open_air, most=splats).fine for splats in (1600, 2000, 100_000))
    # All cells of so many directions that are far are known, but for a few.
    assert 0.9 * FINE_SHARE * 1600 < few <= FINE_SHARE * 1600 < more <= FINE_SHARE * 2000
    # Photos of so few pixels have no more to show, however many splats there may be.
    assert more < most < 2 * more
    sparse = replace(open_air, points=open_air.points[::30], point_colours=None)
    assert found(sparse, most=2000).fine > 0.9 * more, "points do not limit it"


def test_off_and_no_sky_start_with_the_same_bytes(open_air: Capture) -> None:
    for capture, fields in ((open_air, {"sky": "off"}), (capture_of(indoors), {})):
        trainer = trainer_of(capture, **fields)
        plain = initial_parameters(
            capture.points, capture.point_colours, capture.scene_radius, limit=6000, seed=0
        )
        assert "sky" not in trainer.state
        for ours, theirs in zip(trainer.splats.arrays, plain, strict=True):
            assert ours.tobytes() == theirs.tobytes()


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_training_leaves_the_sky_where_it_is(open_air: Capture, strategy: str) -> None:
    fields = {"refine_every": 0.05, "least_refine_steps": 2, "scale_reg": 1.0, "opacity_reg": 1.0}
    trainer = trainer_of(open_air, strategy=strategy, dropout=0.2, **fields)
    before, flags = trainer.splats.snapshot(comments=()), trainer.state["sky"].copy()
    with kernel_threads_only():
        while not trainer.done:
            trainer.step()
    after, now = trainer.splats.snapshot(comments=()), trainer.state["sky"]
    assert np.count_nonzero(now) == np.count_nonzero(flags) > 100 and len(now) == len(trainer.splats)
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        assert np.array_equal(getattr(after, name)[now > 0], getattr(before, name)[flags > 0])
    # Colours of the fine shell learn, those of the coarse one stay.
    trained, fixed = (
        np.abs(after.sh[now == kind, 0] - before.sh[flags == kind, 0]) for kind in (TRAINED, FIXED)
    )
    assert trained.max() > 0.01 and fixed.max() == 0
    # Nothing else was sent there.
    others = np.linalg.norm(after.means[now == 0], axis=1)
    assert others.max() < 0.5 * np.linalg.norm(after.means[now > 0], axis=1).min()


def test_a_resumed_run_knows_its_sky(open_air: Capture, tmp_path: Path) -> None:
    trainer = trainer_of(open_air)
    trainer.step()
    save_checkpoint(trainer, tmp_path / "run.safetensors")
    checkpoint = load_checkpoint(tmp_path / "run.safetensors")
    again = Trainer(trainer.views, checkpoint.parameters, checkpoint.extent, checkpoint.settings)
    restore(again, checkpoint)
    assert np.array_equal(again.state["sky"], trainer.state["sky"])
    for one in (trainer, again):
        one.step()
    for ours, theirs in zip(again.splats.arrays, trainer.splats.arrays, strict=True):
        assert np.array_equal(ours, theirs)


def test_checkpoints_from_before_have_none() -> None:
    values = recorded(TrainSettings())
    del values["sky"]
    assert from_recorded(values).sky == "off"
    with pytest.raises(ValueError, match="sky"):
        TrainSettings(sky="perhaps")  # pyright: ignore[reportArgumentType]


def test_a_deleted_part_of_the_sky_does_not_come_back(open_air: Capture) -> None:
    trainer = trainer_of(open_air)
    rows = np.flatnonzero(trainer.state["sky"])[:50]
    trainer.delete(trainer.splats.ids[rows])
    kept = np.count_nonzero(trainer.state["sky"])
    trainer.step()
    assert np.count_nonzero(trainer.state["sky"]) == kept and len(trainer.state["sky"]) == len(trainer.splats)


def test_the_report_says_why(open_air: Capture) -> None:
    settings = TrainSettings()
    for capture, on in ((open_air, True), (capture_of(indoors), False)):
        sky = found(capture)
        effects = with_sky_found(capture_effects(capture, settings, "auto"), sky, sky.count)
        effect = next(one for one in effects if one.name == SKY)
        assert effect.in_force == on and "%" in effect.why


def scene_with_sky(capture: Capture) -> Gaussians:
    return trainer_of(capture).snapshot()


def test_framing_leaves_the_sky_out(open_air: Capture) -> None:
    scene = scene_with_sky(open_air)
    plain = trainer_of(open_air, sky="off").snapshot()
    (centre, radius), (expected, size) = bulk(scene), bulk(plain)
    assert not any(finding.count for finding in check(scene) if finding.name == "giants")
    assert radius == pytest.approx(size, rel=0.1) and np.linalg.norm(centre - expected) < 0.1 * size


def test_two_things_far_apart_are_no_sky() -> None:
    rng = np.random.default_rng(1)
    near, away = rng.normal(size=(900, 3)), rng.normal(loc=(200, 0, 0), size=(300, 3))
    both = np.concatenate([near, away])
    assert len(without_sky(both)) == len(both)
    assert len(without_sky(np.concatenate([near, 200 * sphere(300)]))) == len(near)


@pytest.mark.parametrize("name", ["s.ply", "s.spz", "s.sog", "s.compressed.ply", "s.splat", "s.glb"])
def test_files_hold_the_sky_and_the_rest(open_air: Capture, tmp_path: Path, name: str) -> None:
    scene = scene_with_sky(open_air)
    save_scene(scene, tmp_path / name)
    again = load_scene(tmp_path / name)
    camera = replace(open_air.photos[0].camera, name="")
    first, second = (render(one, camera) for one in (scene, again))
    assert np.abs(first - second).mean() < 0.01


def test_exposures_are_judged_without_the_sky(open_air: Capture) -> None:
    trainer = trainer_of(open_air, resolution=())
    arrays, views = trainer.splats.arrays, trainer.views.all
    expected = measured_evidence(arrays.means[trainer.state["sky"] == 0], views)
    assert expected != measured_evidence(arrays.means, views)
    trainer.exposures.is_due = lambda progress, rounds: not trainer.exposures.is_decided  # pyright: ignore
    trainer.step()
    assert trainer.exposures.evidence == expected


@pytest.mark.parametrize("count", [30, 2000])
def test_the_nearest_direction_is_that_of_all(count: int) -> None:
    known, asked = sphere(count), np.random.default_rng(0).normal(size=(5000, 3))
    asked = np.concatenate([asked / np.linalg.norm(asked, axis=1, keepdims=True), [[0, 0, 1], [0, 0, -1]]])
    np.testing.assert_array_equal(nearest(known, asked), (asked @ known.T).argmax(axis=1))
