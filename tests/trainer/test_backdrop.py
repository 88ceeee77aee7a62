"""Photos of an object before one plain colour: it is behind the scene, and no splats are in its place."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.cli.main import main
from splatview.raster import Parameters, Workspace, draw_frame, render
from splatview.scene.sh import SH_C0
from splatview.trainer.backdrop import (
    ENOUGH_PHOTOS,
    SPREAD,
    automatic_surround,
    find_backdrop,
    mean_colour,
    standing_before,
    surround_of_a_step,
)
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.effects import SURROUND, capture_effects
from splatview.trainer.loss import photo_loss
from splatview.trainer.recipe import automatic_steps
from splatview.trainer.settings import TrainSettings, from_recorded, recorded
from splatview.trainer.setup import kernel_threads_only
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews, train_views

from .conftest import EXTENT
from .test_sky import LEVEL, capture_of, indoors, trainer_of


def painted(views: list[TrainView], photo: np.ndarray) -> list[TrainView]:
    return [replace(view, pixels=photo.copy()) for view in views]


def plain(colour: tuple[int, int, int], views: list[TrainView]) -> np.ndarray:
    return np.broadcast_to(np.array(colour, np.uint8), views[0].pixels.shape).copy()


def test_the_colour_behind_an_object_is_found(views: list[TrainView]) -> None:
    found = find_backdrop(views)  # rendered over a dark grey, with nothing at their borders
    assert found is not None and found.colour == (0.2, 0.2, 0.2)
    assert found.share > 0.95


def test_noise_and_what_is_cut_off_do_not_hide_it(views: list[TrainView]) -> None:
    photo = plain((255, 250, 240), views)
    photo[30:, 5:40] = (90, 60, 30)  # an object that goes on beyond the lower edge
    noise = np.random.default_rng(0).integers(-5, 6, photo.shape)
    photo = np.clip(photo + noise, 0, 255).astype(np.uint8)
    found = find_backdrop(painted(views, photo))
    assert found is not None
    np.testing.assert_allclose(found.colour, (1, 250 / 255, 240 / 255), atol=0.02)
    assert 0.6 < found.share < 0.9


def test_a_sky_and_a_gradient_are_none(views: list[TrainView]) -> None:
    sky = plain((255, 255, 255), views)
    sky[20:] = np.random.default_rng(0).integers(0, 255, sky[20:].shape)
    assert find_backdrop(painted(views, sky)) is None
    gradient = plain((0, 0, 0), views)
    gradient[:] = np.linspace(60, 250, 48)[None, :, None]
    assert find_backdrop(painted(views, gradient)) is None


def test_a_frame_around_what_a_lens_sees_is_none(views: list[TrainView]) -> None:
    """Black at the same pixels of all photos hides the scene, and says nothing of it."""
    y, x = np.mgrid[:40, :48]
    outside = (x - 23.5) ** 2 + (y - 19.5) ** 2 > 19**2
    rng, framed, lit = np.random.default_rng(0), [], []
    for view in views:
        photo = rng.integers(30, 255, (40, 48, 3)).astype(np.uint8)
        photo[outside] = 2
        framed.append(replace(view, pixels=photo))
        object_at, photo = rng.integers(5, 25, 2), np.full((40, 48, 3), 2, np.uint8)
        photo[object_at[0] : object_at[0] + 12, object_at[1] : object_at[1] + 18] = 200
        lit.append(replace(view, pixels=photo))
    assert find_backdrop(framed) is None
    assert find_backdrop(lit) is not None


def test_most_photos_must_have_it(views: list[TrainView]) -> None:
    white, some = painted(views, plain((255, 255, 255), views)), len(views) // 4
    noise = np.random.default_rng(0).integers(0, 255, views[0].pixels.shape, np.uint8)
    assert find_backdrop(white) is not None
    assert find_backdrop(painted(views[:some], noise) + white[some:]) is None


def test_transparency_says_more_and_masks_hide_what_they_hide(views: list[TrainView]) -> None:
    white = painted(views, plain((255, 255, 255), views))
    opaque = np.full((40, 48), 255, np.uint8)
    assert find_backdrop([replace(view, alpha=opaque) for view in white]) is None
    inside = np.zeros((40, 48), np.bool_)
    inside[5:-5, 5:-5] = True
    assert find_backdrop([replace(view, mask=inside) for view in white]) is None


def test_what_is_connected_to_the_border_is_known_to_be_empty(views: list[TrainView]) -> None:
    photo = plain((255, 255, 255), views)
    photo[10:30, 10:30] = 40
    photo[15:20, 15:20] = 255  # plain within the object: it may be its own
    photo[18:26, 40:48] = 90
    (view, *_) = standing_before(TrainViews(painted(views, photo), 0), (1, 1, 1)).all
    assert view.alpha is not None and view.alpha_known == 0
    expected = np.zeros((40, 48), np.uint8)
    expected[9:31, 9:31] = 255  # a pixel at the rim may be mixed
    expected[17:27, 39:48] = 255
    np.testing.assert_array_equal(view.alpha, expected)
    smaller = view.smaller(2)
    assert smaller.alpha_known == 0 and smaller.alpha is not None
    assert set(np.unique(smaller.alpha)) > {0, 255}, "pixels that are empty in part are above 0, so not known"
    assert standing_before(TrainViews(views, 0), (1, 1, 1)).all[0].alpha is None, "they stand before a grey"


def test_opacity_is_compared_where_it_is_known(rng: np.random.Generator) -> None:
    image = rng.random((20, 24, 4)).astype(np.float32)
    photo = rng.integers(0, 256, (20, 24, 3)).astype(np.uint8)
    alpha = np.where(rng.random((20, 24)) < 0.5, 0, 255).astype(np.uint8)
    known = photo_loss(
        image, photo, Workspace(), alpha=alpha, alpha_known=0, ssim_weight=0.0, alpha_weight=0.5
    )
    d_alpha = known.d_image[..., 3].copy()
    np.testing.assert_allclose(d_alpha, np.where(alpha == 0, 0.5 / alpha.size, 0), rtol=1e-6)
    without = photo_loss(image, photo, Workspace(), ssim_weight=0.0)
    by_alpha = 0.5 * image[..., 3][alpha == 0].sum() / alpha.size
    assert known.loss == pytest.approx(without.loss + by_alpha, rel=1e-5)


def test_fog_of_the_colour_goes(views: list[TrainView], start: Parameters) -> None:
    """Grey splats before grey: nobody sees them where nothing is known to be empty."""
    fog = Parameters(*(np.concatenate([array, array[:20]]) for array in start))
    fog.means[-20:] += (0.0, -0.9, 0.0)
    fog.sh[-20:] = (0.2 - 0.5) / SH_C0
    fog.opacity_logits[-20:] = 3
    photos = TrainViews(views[1:], 0)
    known = standing_before(photos, (0.2, 0.2, 0.2))
    left = []
    for used in (known, photos):
        recipe = TrainSettings(iterations=400, max_splats=300, resolution=(), background=(0.2, 0.2, 0.2))
        trainer = Trainer(used, fog, EXTENT, recipe, threads=2)
        while not trainer.done:
            trainer.step()
        scene = trainer.snapshot()
        left.append(np.mean([render(scene, one.camera)[..., 3][one.alpha == 0].mean() for one in known.all]))
    assert left[0] < 0.5 * left[1]


def train(folder: Path, output: Path, *options: str) -> int:
    return main(["train", str(folder), "--headless", "-o", str(output), "--threads", "2", *options])


def test_a_run_puts_the_colour_behind_its_scene(
    capture_folder: Path, views: list[TrainView], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "toy.ply"
    assert train(capture_folder, output, "--iterations", "300") == 0
    report = " ".join(capsys.readouterr().err.split())
    assert "0.2, 0.2, 0.2 is behind the scene" in report
    checkpoint = tmp_path / "toy.checkpoint.safetensors"
    assert load_checkpoint(checkpoint).settings.background == (0.2, 0.2, 0.2)
    # A resumed run goes on with it, and takes no other.
    assert train(capture_folder, output, "--resume", str(checkpoint), "--iterations", "302") == 0
    assert load_checkpoint(checkpoint).settings.background == (0.2, 0.2, 0.2)
    assert train(capture_folder, output, "--resume", str(checkpoint), "--background", "auto") == 2


def test_another_colour_can_be_asked_for(capture_folder: Path, tmp_path: Path) -> None:
    for file in (capture_folder / "images").iterdir():
        photo = np.asarray(Image.open(file).convert("RGBA")).copy()
        photo[..., 3] = 255 * (np.abs(photo[..., :3].astype(int) - 51).max(axis=-1) > 4)
        Image.fromarray(photo).save(file)
    output, options = tmp_path / "toy.ply", ("--iterations", "2", "--background", "1,0.5,0")
    assert train(capture_folder, output, *options) == 0
    checkpoint = tmp_path / "toy.checkpoint.safetensors"
    assert load_checkpoint(checkpoint).settings.background == (1, 0.5, 0)
    held_out = np.asarray(Image.open(next((tmp_path / "toy-held-out").glob("*.png"))))
    assert held_out[0, 0].tolist() == [255, 128, 0], "the photo lies over it, too"
    assert train(capture_folder, output, "--resume", str(checkpoint), "--iterations", "4") == 0
    held_out = np.asarray(Image.open(next((tmp_path / "toy-held-out").glob("*.png"))))
    assert held_out[0, 0].tolist() == [255, 128, 0]


def test_the_mean_colour_is_that_of_what_photos_show() -> None:
    views = train_views(capture_of(indoors).train)
    mean = np.mean([view.pixels.reshape(-1, 3).mean(axis=0) for view in views], axis=0) / 255
    np.testing.assert_allclose(np.array(mean_colour(views)), mean, atol=1e-3)
    mask = np.zeros(views[0].pixels.shape[:2], np.bool_)
    assert mean_colour([replace(view, mask=mask) for view in views]) is None
    mask[:10] = True
    above = np.mean([view.pixels[:10].reshape(-1, 3).mean(axis=0) for view in views], axis=0) / 255
    np.testing.assert_allclose(
        np.array(mean_colour([replace(view, mask=mask) for view in views])), above, atol=1e-3
    )
    assert mean_colour(train_views(capture_of(indoors, alpha=True).train)) is None


def test_what_is_empty_or_has_a_background_has_no_surround() -> None:
    room = trainer_of(capture_of(indoors))
    assert room.settings.surround is not None and room.settings.background == (0, 0, 0)
    assert room.render_settings.background == room.settings.surround
    asked = trainer_of(capture_of(indoors), background=(0.0, 0.0, 0.0))
    assert asked.settings.surround is None and asked.render_settings.background == (0, 0, 0)
    assert trainer_of(capture_of(indoors, alpha=True)).settings.surround is None
    for trainer in (room, asked):
        effects = capture_effects(capture_of(indoors), trainer.settings, "auto")
        effect = next(one for one in effects if one.name == SURROUND)
        assert effect.on is (trainer is room)
        assert ("mean colour" if effect.on else "background is asked for") in effect.why


@pytest.mark.parametrize("name", ["background", "surround"])
def test_colours_of_a_caller_are_any_three_numbers(name: str) -> None:
    for colour in ([0, 0.5, 1], np.array([0, 0.5, 1])):
        assert getattr(trainer_of(capture_of(indoors), **{name: colour}).settings, name) == (0, 0.5, 1)
    for wrong in ("white", (0.5, 0.5), (0.5, 0.5, math.nan), (0, 0, 255), 1):
        with pytest.raises(ValueError, match=f"{name} must be three numbers from 0 to 1, got"):
            trainer_of(capture_of(indoors), **{name: wrong})


def test_what_many_photos_show_has_no_surround() -> None:
    capture = capture_of(indoors)
    views = train_views(capture.train)
    assert automatic_surround(views, ENOUGH_PHOTOS - 0.5) == mean_colour(views) is not None
    assert automatic_surround(views, ENOUGH_PHOTOS) is None
    many = replace(capture, photos=tuple(p for p in capture.photos for _ in range(ENOUGH_PHOTOS)))
    settings = trainer_of(many).settings
    assert settings.surround is None and settings.background == (0, 0, 0)
    effects = capture_effects(many, settings, "auto")
    assert f"{ENOUGH_PHOTOS} and more show each place" in next(e for e in effects if e.name == SURROUND).why
    assert trainer_of(many, surround=(0.5, 0.4, 0.3)).settings.surround == (0.5, 0.4, 0.3)


def test_few_photos_that_say_what_is_empty_take_more_steps() -> None:
    everywhere, transparent = capture_of(indoors, count=7), capture_of(indoors, alpha=True, count=7)
    views = TrainViews(train_views(everywhere.train), 0)
    steps = automatic_steps(7, everywhere=True, shown=views.photos_of_a_place(everywhere.points))
    for fields in ({}, {"background": (0.0, 0.0, 0.0)}, {"surround": None}):
        assert trainer_of(everywhere, iterations=None, **fields).settings.iterations == steps
    assert trainer_of(transparent, iterations=None).settings.iterations == automatic_steps(7) != steps
    assert trainer_of(everywhere, iterations=70).settings.iterations == 70


def test_each_photo_has_its_own_colour_about_the_surrounds() -> None:
    mean = (0.5, 0.9, 0.0)
    drawn = np.array([surround_of_a_step(mean, (0, place)) for place in range(400)])
    assert drawn.min() == 0 and drawn.max() == 1
    assert np.abs(drawn - mean).max() <= SPREAD < np.abs(drawn[:, 0] - 0.5).max() + 0.02
    assert abs(drawn[:, 0].mean() - 0.5) < 0.03
    assert (surround_of_a_step(mean, (0, 7)) == drawn[7]).all() and len(np.unique(drawn[:, 0])) == 400


def test_training_before_a_surround_makes_the_scene_opaque() -> None:
    """In front of black, bright splats that are half transparent are as good as dark ones."""
    shown, capture = [], capture_of(indoors)
    rays = np.random.default_rng(0).normal(size=(1500, 3))
    walls = rays * (np.array([6.0, 4.0, 6.0]) / np.abs(rays)).min(axis=1)[:, None]
    walls[:, 1] = np.minimum(walls[:, 1], LEVEL)
    colours = indoors(np.zeros(3), rays / np.linalg.norm(rays, axis=1, keepdims=True))
    capture = replace(capture, points=walls, point_colours=(np.clip(colours, 0, 1) * 255).astype(np.uint8))
    for fields in ({"surround": None}, {}):
        trainer = trainer_of(capture, iterations=300, **fields)
        with kernel_threads_only():
            while not trainer.done:
                trainer.step()
        pictures = [
            draw_frame(trainer.splats.arrays, view.camera, trainer.render_settings, Workspace()).image
            for view in trainer.views.all
        ]
        shown.append(np.mean([picture[..., 3].mean() for picture in pictures]))
    assert shown[1] > shown[0] + 0.015


def test_a_resumed_run_goes_on_before_its_surround(tmp_path: Path) -> None:
    trainer = trainer_of(capture_of(indoors))
    trainer.step()
    save_checkpoint(trainer, tmp_path / "run.safetensors")
    checkpoint = load_checkpoint(tmp_path / "run.safetensors")
    assert checkpoint.settings.surround == trainer.settings.surround
    again = Trainer(trainer.views, checkpoint.parameters, checkpoint.extent, checkpoint.settings)
    restore(again, checkpoint)
    for one in (trainer, again):
        one.step()
    for ours, theirs in zip(again.splats.arrays, trainer.splats.arrays, strict=True):
        assert np.array_equal(ours, theirs)
    values = recorded(trainer.settings)
    del values["surround"]  # as checkpoints from before there was one
    assert from_recorded(values).surround is None
    with pytest.raises(ValueError, match="surround"):
        trainer.change(surround=None)
