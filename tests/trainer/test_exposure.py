"""Exposure: learnt where photos differ, left alone where not, and measured without looking."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from splatview.scene.camera import look_at
from splatview.trainer.checkpoint import load_checkpoint, restore, save_checkpoint
from splatview.trainer.evaluate import evaluate
from splatview.trainer.exposure import (
    Evidence,
    Exposures,
    angle_between,
    fitted,
    fitted_by_tiles,
    log_gain,
    measured_evidence,
    unexplained,
)
from splatview.trainer.functional import expose, photo_loss
from splatview.trainer.settings import TrainSettings
from splatview.trainer.setup import settings_for, trainer_for
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews

from .conftest import EXTENT, capture_of, whole_and_resumed

make_settings: Any = TrainSettings


def exposed(views: list[TrainView], spread: float) -> list[TrainView]:
    """The same photos with gains of this standard deviation, and a tint of each photo's own."""
    rng = np.random.default_rng(1)
    log_gains = rng.normal(scale=spread, size=(len(views), 1)) + rng.normal(scale=0.02, size=(len(views), 3))
    # The background is known, so that the average exposure of the photos trained on has to be its own.
    gains = np.exp(log_gains - np.mean([gain for i, gain in enumerate(log_gains) if i % 5], axis=0))
    return [
        replace(view, pixels=np.clip(view.pixels * (0.7 * gain) + 0.5, 0, 255).astype(np.uint8))
        for view, gain in zip(views, gains, strict=True)
    ]


def begun(views: list[TrainView], start, **settings) -> Trainer:
    options = {"iterations": 1000, "max_splats": 300, "background": (0.14, 0.14, 0.14), **settings}
    chosen = make_settings(**options)
    to_train = [view for i, view in enumerate(views) if i % 5]
    return Trainer(TrainViews(to_train, 0), start, EXTENT, chosen, threads=2)


def trained(views: list[TrainView], start, **settings) -> Trainer:
    trainer = begun(views, start, **settings)
    while not trainer.done:
        trainer.step()
    return trainer


def score(trainer: Trainer, views: list[TrainView]) -> float:
    held_out = views[::5]
    return evaluate(trainer.splats.arrays, held_out, trainer.render_settings, exposures_differ=True).psnr


def test_photos_of_different_exposure_are_corrected(views, start) -> None:
    photos = exposed(views, 0.25)
    with_it, without = (trained(photos, start, exposure=mode, few_views=0) for mode in ("on", "off"))
    assert with_it.exposures.is_on and not without.exposures.is_on
    # Both are measured alike, after fits. Measured over four seeds: 30.8 to 31.9 dB, and 29.6 to 30.3 without
    # (photos of one exposure: 32.4). One seed gains 0.7 to 2.2 dB, by chance of roundings.
    assert score(with_it, photos) - score(without, photos) > 0.4
    learnt = with_it.exposures.table[:, :, 0].mean(axis=1)
    ratios = [photo.pixels.mean() / view.pixels.mean() for photo, view in zip(photos, views, strict=True)]
    truth = np.log([ratio for i, ratio in enumerate(ratios) if i % 5])
    assert np.corrcoef(learnt, truth)[0, 1] > 0.9
    np.testing.assert_allclose(with_it.exposures.table.mean(axis=0), 0, atol=1e-12)


def test_equal_photos_are_left_alone(make_trainer) -> None:
    trainer, other = make_trainer(iterations=60), make_trainer(iterations=60, exposure="off")
    while not trainer.done:
        trainer.step()
        other.step()
    assert trainer.exposures.is_decided and not trainer.exposures.is_on
    assert not other.exposures.is_decided and other.exposures.evidence is None
    for ours, theirs in zip(trainer.splats.arrays, other.splats.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_gradients_are_those_of_finite_differences(views) -> None:
    rng, photo = np.random.default_rng(0), torch.from_numpy(views[0].pixels[:13, :14].copy())
    image = torch.from_numpy(rng.uniform(size=(13, 14, 4))).requires_grad_()
    exposure = torch.from_numpy(rng.normal(scale=0.2, size=(3, 2))).requires_grad_()
    assert torch.autograd.gradcheck(expose, (image, exposure), fast_mode=True)
    assert torch.autograd.gradcheck(
        lambda image, exposure: photo_loss(expose(image, exposure), photo), (image, exposure), fast_mode=True
    )
    exposed = expose(image, exposure)
    gain, offset = exposure[:, 0].exp(), exposure[:, 1]
    torch.testing.assert_close(exposed[..., :3], image[..., :3] * gain + offset)
    torch.testing.assert_close(exposed[..., 3], image[..., 3])


def wall(gains, *, shine: float = 0.0, **more: Any) -> tuple[np.ndarray, list[TrainView]]:
    """Points of a coloured wall, and photos of it with these gains; with shine parts of the wall are brighter
    from some sides, its blue most."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1, 1, size=(2, 2000))
    photos = []
    for i, gain in enumerate(gains):
        angle = 0.5 * np.sin(i)
        eye = (2 * np.sin(angle), 0.3 * np.cos(i), -2 * np.cos(angle))
        camera = replace(look_at(eye, (0, 0, 0), width=96, height=72, fov_y=50), name=f"{i}.png")
        u, v = np.meshgrid(np.arange(96) + 0.5, np.arange(72) + 0.5)
        ray = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
        ray = ray @ camera.R_camera_world
        at = camera.eye + ray * (-camera.eye[2] / ray[..., 2])[..., None]
        colour = 0.4 + 0.1 * np.sin(4 * at[..., :1] + 3 * at[..., 1:2] + np.arange(3))
        bright = shine * np.sin(5 * at[..., :1] + 7 * angle) * [0.4, 0.6, 1.0]
        pixels = np.clip(colour * gain * np.exp(bright) * 255 + 0.5, 0, 255).astype(np.uint8)
        photos.append(TrainView(camera, pixels, **more))
    return np.stack([x, y, np.zeros_like(x)], axis=1).astype(np.float32), photos


def test_evidence_is_how_far_photos_differ_where_they_show_the_same() -> None:
    gains = np.exp([0.2, -0.1, 0.15, -0.2, 0.0, 0.1, -0.15, 0.0])
    points, photos = wall(gains)
    evidence = measured_evidence(points, photos)
    assert evidence.spread == pytest.approx(np.std(np.log(gains)), rel=0.05)
    assert evidence.error < 0.01 and evidence.unevenness < 1.1 and evidence.calls_for_correction
    assert str(evidence).startswith("photos differ in exposure by 13% (known to 0.")
    unknown = measured_evidence(points, photos[:1])
    assert not unknown.calls_for_correction and "inf" not in str(unknown), "one photo tells nothing"
    alike = measured_evidence(*wall(np.ones(8)))
    assert alike.spread < 0.01 and not alike.calls_for_correction


def test_shine_is_no_exposure() -> None:
    evidence = measured_evidence(*wall(np.ones(8), shine=0.6))
    assert evidence.spread > 0.03 and not evidence.calls_for_correction
    by_colour = Evidence(spread=0.2, error=0.01, unevenness=2.5)
    assert not by_colour.calls_for_correction and "2.5 times more in one colour" in str(by_colour)


def test_photos_from_the_same_place_tell_exposure_from_shine() -> None:
    """Light that changes from photo to photo leaves much that no gain explains, as shine does."""
    gains = np.exp([0.5, -0.4, 0.3, -0.5, 0.4, -0.3, 0.2, -0.2])
    changing = measured_evidence(*wall(gains, shine=0.6))
    assert changing.spread < 15 * changing.error
    assert changing.near > 0.3 and changing.calls_for_correction
    assert "from nearly the same place by" in str(changing)
    shining = measured_evidence(*wall(np.ones(8), shine=0.6))
    assert shining.near < 0.1 and not shining.calls_for_correction
    assert "same place" not in str(shining)


def test_a_pair_from_the_same_place_is_too_few_to_tell() -> None:
    points, photos = wall(np.exp([0.5, -0.4, 0.3]), shine=0.6)
    assert measured_evidence(points, photos).near == 0
    assert not Evidence(0.3, 0.1, 1.0, np.nan).calls_for_correction
    assert not Evidence(0.02, 0.01, 1.0, 0.2).calls_for_correction


def test_rays_of_two_cameras() -> None:
    one, other = (look_at(eye, (0, 0, 0), width=8, height=8) for eye in ((0, 0, -2), (0, -2, 0)))
    points = np.array([[0, 0, 0], [0, 0, 0.01], [0, 0, -0.01]])
    assert angle_between(one, other, points) == pytest.approx(90, abs=0.1)
    assert angle_between(one, one, points) == pytest.approx(0, abs=1e-4)
    assert np.isnan(angle_between(one, other, one.eye[None]))


def test_checkpoints_of_before_have_three_numbers() -> None:
    exposures = Exposures(["a.png", "b.png"])
    exposures.evidence = Evidence(0.2, 0.01, 1.1, 0.25)
    state = exposures.state()
    again = Exposures(["a.png", "b.png"])
    again.restore(state)
    assert again.evidence == exposures.evidence
    again.restore(state | {"evidence": state["evidence"][:3]})
    assert again.evidence == Evidence(0.2, 0.01, 1.1)


def test_gains_that_leave_much_may_be_light() -> None:
    assert Evidence(0.2, 0.01).calls_for_correction and not Evidence(0.2, 0.02).calls_for_correction
    assert not Evidence(0.028, 0.001).calls_for_correction and Evidence(0.032, 0.001).calls_for_correction
    assert not Evidence(0.2, 0.01, np.nan).calls_for_correction


def test_evidence_leaves_out_what_says_nothing() -> None:
    gains = np.exp([0.2, -0.1, 0.15, -0.2, 0.0, 0.1])
    points, photos = wall(gains)
    nothing = Evidence(0.0, np.inf)
    assert measured_evidence(points[:20], photos) == nothing, "too few places"
    assert measured_evidence(np.full((50, 3), np.nan, np.float32), photos) == nothing
    assert measured_evidence(points, photos[:1]) == nothing
    assert not Evidence(np.nan, 0.0).calls_for_correction and not Evidence(0.1, np.nan).calls_for_correction
    # What stands before the wall hides it, and what a mask leaves out may be anything.
    hidden = np.concatenate([points, points * 0.5 + [0, 0, 3.0]]).astype(np.float32)
    assert measured_evidence(hidden, photos).spread == pytest.approx(np.std(np.log(gains)), rel=0.1)
    left = np.arange(96)[None, :].repeat(72, 0) < 48
    spoilt = [
        replace(photo, pixels=np.where(left[..., None], photo.pixels, 60 + 20 * i), mask=left)
        for i, photo in enumerate(photos)
    ]
    spoilt = [replace(photo, pixels=photo.pixels.astype(np.uint8)) for photo in spoilt]
    assert measured_evidence(points, spoilt).spread == pytest.approx(np.std(np.log(gains)), rel=0.2)
    see_through = [replace(photo, alpha=np.full((72, 96), 128, np.uint8)) for photo in photos]
    assert measured_evidence(points, see_through) == nothing


def test_what_lies_beside_the_bare_background_says_nothing() -> None:
    """Lights on black: how much black is mixed in by the blur differs from photo to photo."""
    points, photos = wall(np.ones(8))
    grid = (np.arange(72)[:, None] % 9 < 3) & (np.arange(96) % 9 < 3)  # in the image, so another wall in each
    for background in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.5)):
        bare = np.rint(np.array(background) * 255).astype(np.uint8)
        lights = [replace(photo, pixels=np.where(grid[..., None], photo.pixels, bare)) for photo in photos]
        assert measured_evidence(points, lights, background) == Evidence(0.0, np.inf)
        # A backdrop's alpha says only where the photo is surely empty.
        backdrop = [replace(view, alpha=np.full((72, 96), 255, np.uint8), alpha_known=0) for view in lights]
        assert measured_evidence(points, backdrop, background) == Evidence(0.0, np.inf)
    # Half of each photo shows the wall, up to where there is nothing.
    gains = np.exp([0.2, -0.1, 0.15, -0.2, 0.0, 0.1, -0.15, 0.0])
    points, photos = wall(gains)
    left = np.arange(96)[None, :, None] < 48
    halves = [replace(photo, pixels=np.where(left, photo.pixels, np.uint8(0))) for photo in photos]
    evidence = measured_evidence(points, halves)
    assert evidence.spread == pytest.approx(np.std(np.log(gains)), rel=0.1)
    assert evidence.calls_for_correction


BLACK = (0.0, 0.0, 0.0)


def test_photos_are_compared_once_and_only_where_that_decides() -> None:
    points, photos = wall(np.exp([0.2, -0.1, 0.15, -0.2, 0.0, 0.1]))
    names = [photo.camera.name for photo in photos]
    for mode in ("on", "off"):
        asked = Exposures(names, mode)
        asked.measure(points, photos, BLACK)
        assert asked.evidence is None
    exposures = Exposures(names)
    exposures.measure(points[:20], photos, BLACK)
    assert exposures.evidence is None, "too few places: another time there may be more"
    exposures.measure(points, photos, BLACK)
    found = exposures.evidence
    assert found == measured_evidence(points, photos)
    exposures.measure(points, photos[::-1], BLACK)
    assert exposures.evidence is found and not exposures.is_decided


def drifting_trainer(iterations: int, *, guessed: bool = False) -> Trainer:
    points, views = wall(np.exp([0.2, -0.1, 0.15, -0.2, 0.0, 0.1]))
    grey = np.full((len(points), 3), 100, np.uint8)
    capture, trained_on = capture_of(views, points.astype(float), grey, guessed=guessed), TrainViews(views, 0)
    settings = settings_for(capture, trained_on, iterations=iterations, start="points")
    return trainer_for(capture, trained_on, settings, centre=np.zeros(3), threads=2)


def test_what_decides_is_known_before_the_first_step_however_long_the_run(tmp_path: Path) -> None:
    short, long = drifting_trainer(60), drifting_trainer(6000)
    found = short.exposures.evidence
    assert found is not None and found == long.exposures.evidence
    assert found.calls_for_correction and not short.exposures.is_decided
    guessed = drifting_trainer(60, guessed=True)
    assert guessed.exposures.evidence is None, "random points are no places of the scene"
    while not guessed.done:
        guessed.step()
    assert guessed.exposures.evidence is not None
    # A run that was stopped before it had decided goes on with what it knew.
    path = tmp_path / "run.safetensors"
    short.step()
    save_checkpoint(short, path)
    resumed = Trainer(short.views, short.splats.arrays, EXTENT, short.settings, threads=2)
    assert resumed.exposures.evidence is None
    checkpoint = load_checkpoint(path)
    restore(resumed, checkpoint)
    assert resumed.exposures.evidence == short.exposures.evidence and not resumed.exposures.is_decided
    while not resumed.done:
        resumed.step()
    assert resumed.exposures.is_on
    del checkpoint.exposure["evidence"]  # as of runs that noted none
    restore(resumed, checkpoint)
    assert resumed.exposures.evidence is None


def test_the_first_gain_is_that_of_least_squares(views) -> None:
    picture = np.random.default_rng(0).uniform(0.1, 0.5, size=(40, 48, 3))
    photo = replace(views[0], pixels=(picture * 1.3 * 255 + 0.5).astype(np.uint8))
    np.testing.assert_allclose(log_gain(picture, photo), np.log(1.3), atol=0.01)
    assert np.isnan(log_gain(np.zeros((40, 48, 3)), photo)).all()
    wrong_outside = picture.copy()
    wrong_outside[:, 24:] = 9
    masked = replace(photo, mask=np.arange(48)[None, :].repeat(40, 0) < 24)
    np.testing.assert_allclose(log_gain(wrong_outside, masked), np.log(1.3), atol=0.01)


def test_tiles_are_measured_by_fits_that_have_not_seen_them(views) -> None:
    rng = np.random.default_rng(0)
    picture = rng.uniform(0.2, 0.6, size=(40, 48, 3))
    pixels = ((picture * [1.2, 1.0, 0.8] + 0.05) * 255 + 0.5).astype(np.uint8)
    view = replace(views[0], pixels=pixels)
    gain, offset = fitted(picture, pixels)
    np.testing.assert_allclose(gain, [1.2, 1.0, 0.8], atol=0.01)
    np.testing.assert_allclose(offset, 0.05, atol=0.01)
    np.testing.assert_allclose(fitted_by_tiles(picture, view), pixels / 255, atol=0.01)
    # What is wrong with the tiles of one colour is not mended by a fit to them.
    white = np.add.outer(np.arange(40) // 6, np.arange(48) // 6) % 2 == 0
    darker = np.where(white[..., None], 0.5 * picture, picture)
    out = fitted_by_tiles(darker, view)
    assert np.abs(out - pixels / 255)[white].mean() > 0.1
    assert np.abs(out - pixels / 255)[~white].mean() > 0.1  # by the exposure of darker ones
    # What is masked takes no part in any fit.
    masked = fitted_by_tiles(darker, replace(view, mask=~white))
    np.testing.assert_allclose(masked[white], out[white], atol=1e-12)
    np.testing.assert_array_equal(masked[~white], darker[~white])
    # Something that the picture does not show, on most of a half, says nothing about the rest of it.
    covered = pixels.copy()
    covered[:25] = 0
    gain, offset = fitted(picture, covered)
    np.testing.assert_allclose(gain, [1.2, 1.0, 0.8], atol=0.02)
    np.testing.assert_allclose(offset, 0.05, atol=0.02)
    spoilt = picture.copy()
    spoilt[:3, :5] = np.nan
    np.testing.assert_allclose(fitted(spoilt, pixels)[0], [1.2, 1.0, 0.8], atol=0.01)
    flat, shift = fitted(np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 255, np.uint8))
    assert flat.tolist() == [1, 1, 1] and shift.tolist() == [0, 0, 0]


def test_a_run_with_exposures_resumes_bit_for_bit(views, start, tmp_path: Path) -> None:
    photos = exposed(views, 0.2)
    settings = TrainSettings(iterations=90, max_splats=150, exposure="on")

    def another() -> Trainer:
        return Trainer(TrainViews(photos[1:], 0), start, EXTENT, settings, threads=2)

    whole, resumed = whole_and_resumed(another, tmp_path / "run.safetensors")
    assert resumed.exposures.is_on
    np.testing.assert_array_equal(whole.exposures.table, resumed.exposures.table)


@pytest.mark.parametrize("gains", [1, 40])
def test_what_gains_leave_is_their_standard_deviation(gains, rng):
    """Chance alone, where there are many more pairs than gains, some of which these meet."""
    left = rng.normal(scale=0.02, size=800 - gains)
    differences = rng.permutation(np.concatenate([left, np.zeros(gains)]))
    assert unexplained(differences, 800 - gains) == pytest.approx(0.02, rel=0.15)


@pytest.mark.parametrize("freedom", [399, 370, 200])
def test_pairs_side_by_side_do_not_make_gains_certain(freedom, rng):
    """As of shine: photos side by side agree, and those from elsewhere do not."""
    near, far = rng.normal(scale=0.001, size=240), rng.normal(scale=0.1, size=160)
    assert unexplained(np.concatenate([near, far]), freedom) > 0.015
