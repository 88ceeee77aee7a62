"""Photos of an object before one plain colour: it is behind the scene, and no splats are in its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.cli.main import main
from splatview.raster import Parameters, Workspace, draw_frame, render
from splatview.scene import RenderSettings
from splatview.scene.sh import SH_C0
from splatview.trainer.backdrop import (
    SPREAD,
    SURROUND,
    SURROUND_SPLATS,
    find_backdrop,
    find_surround,
    standing_before,
    surround_drawn,
)
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.effects import SURROUND as EFFECT
from splatview.trainer.effects import capture_effects, with_surround_found
from splatview.trainer.loss import photo_loss
from splatview.trainer.settings import TrainSettings
from splatview.trainer.setup import kernel_threads_only
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews, train_views

from .conftest import EXTENT
from .test_sky import LEVEL, capture_of, indoors, outdoors, trainer_of


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


def test_opaque_photos_without_a_sky_have_a_surround_of_their_mean_colour() -> None:
    capture = capture_of(indoors)
    views = train_views(capture.train)
    surround = find_surround(views, capture.points, capture.scene_radius)
    assert surround.parameters is not None and surround.count == SURROUND_SPLATS
    mean = np.mean([view.pixels.reshape(-1, 3).mean(axis=0) for view in views], axis=0) / 255
    for view in views[::3]:
        picture = draw_frame(surround.parameters, view.camera, RenderSettings(), Workspace()).image
        assert picture[..., 3].min() > 0.99
        np.testing.assert_allclose(picture[..., :3], np.broadcast_to(mean, (48, 64, 3)), atol=0.01)
    trainer = trainer_of(capture)
    assert np.count_nonzero(trainer.state["sky"] == SURROUND) == SURROUND_SPLATS


def test_what_is_empty_black_as_asked_or_behind_a_sky_has_none(views: list[TrainView]) -> None:
    transparent = find_surround(train_views(capture_of(indoors, alpha=True).train), np.zeros((0, 3)), 1.0)
    assert transparent.count == 0 and "where nothing is" in transparent.why
    asked = trainer_of(capture_of(indoors), background=(0.0, 0.0, 0.0))
    assert "sky" not in asked.state and asked.surround is not None and "asked for" in asked.surround.why
    sky = trainer_of(capture_of(outdoors))
    assert not (sky.state["sky"] == SURROUND).any() and sky.surround is not None
    assert sky.surround.why == "there is a sky"


def test_the_report_says_what_the_surround_is() -> None:
    for capture, on, why in (
        (capture_of(indoors), True, "300 far splats of their mean colour"),
        (capture_of(outdoors), False, "there is a sky"),
    ):
        trainer = trainer_of(capture)
        count = int(np.count_nonzero(trainer.state["sky"] == SURROUND))
        effects = with_surround_found(
            capture_effects(capture, trainer.settings, "auto"), trainer.surround, count
        )
        effect = next(one for one in effects if one.name == EFFECT)
        assert effect.on is on and why in effect.why


def test_the_surround_has_another_colour_for_each_photo_and_its_own_after() -> None:
    trainer = trainer_of(capture_of(indoors))
    rows = np.flatnonzero(trainer.state["sky"] == SURROUND)
    sh = trainer.splats.arrays.sh
    own, seen = sh[rows].copy(), []
    for place in range(20):
        with surround_drawn(trainer.splats.arrays, trainer.state, (0, place)):
            seen.append(sh[rows, 0] - own[:, 0])
            assert (seen[-1] == seen[-1][0]).all()
        assert (sh[rows] == own).all()
    away = SH_C0 * np.array([one[0] for one in seen])
    assert SPREAD / 2 < np.abs(away).max() <= SPREAD + 1e-6
    with pytest.raises(RuntimeError), surround_drawn(trainer.splats.arrays, trainer.state, (0, 0)):
        raise RuntimeError
    assert (sh[rows] == own).all()


@pytest.mark.parametrize("strategy", ["mcmc", "classic"])
def test_training_before_a_surround_makes_the_scene_opaque(strategy: str) -> None:
    """In front of black, bright splats that are half transparent are as good as dark ones."""
    shown, capture = {}, capture_of(indoors)
    rays = np.random.default_rng(0).normal(size=(1500, 3))
    walls = rays * (np.array([6.0, 4.0, 6.0]) / np.abs(rays)).min(axis=1)[:, None]
    walls[:, 1] = np.minimum(walls[:, 1], LEVEL)
    colours = indoors(np.zeros(3), rays / np.linalg.norm(rays, axis=1, keepdims=True))
    capture = replace(capture, points=walls, point_colours=(np.clip(colours, 0, 1) * 255).astype(np.uint8))
    for surround in ("auto", "off"):
        trainer = trainer_of(capture, surround=surround, strategy=strategy, iterations=300)
        before = trainer.splats.snapshot(comments=())
        of_before = trainer.state.get("sky", np.zeros(len(trainer.splats), np.uint8)) == SURROUND
        with kernel_threads_only():
            while not trainer.done:
                trainer.step()
        after = trainer.splats.snapshot(comments=())
        of_after = trainer.state.get("sky", np.zeros(len(after), np.uint8)) == SURROUND
        for name in ("means", "quats", "log_scales", "opacity_logits"):
            assert np.array_equal(getattr(after, name)[of_after], getattr(before, name)[of_before])
        assert np.array_equal(after.sh[of_after, 0], before.sh[of_before, 0])
        scene = Parameters(*(array[~of_after] for array in trainer.splats.arrays))
        pictures = [
            draw_frame(scene, view.camera, trainer.render_settings, Workspace()).image
            for view in trainer.views.all
        ]
        shown[surround] = np.mean([picture[..., 3].mean() for picture in pictures])
    if strategy == "mcmc":  # so short a run by the other one ends soon after opacities were reset
        assert shown["auto"] > shown["off"] + 0.015


def test_a_resumed_run_knows_its_surround(tmp_path: Path) -> None:
    trainer = trainer_of(capture_of(indoors))
    trainer.step()
    save_checkpoint(trainer, tmp_path / "run.safetensors")
    checkpoint = load_checkpoint(tmp_path / "run.safetensors")
    again = Trainer(trainer.views, checkpoint.parameters, checkpoint.extent, checkpoint.settings)
    restore(again, checkpoint)
    for one in (trainer, again):
        one.step()
    for ours, theirs in zip(again.splats.arrays, trainer.splats.arrays, strict=True):
        assert np.array_equal(ours, theirs)
