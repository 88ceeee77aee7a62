"""Where pictures are wrong, as photos agree; and splats that are added there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.raster import Parameters, Workspace, draw_frame, parameters_of
from splatview.raster.contributions import contributions
from splatview.raster.gradients import weighted_contributions
from splatview.scene import Gaussians, RenderSettings
from splatview.trainer.consistency import error_rates
from splatview.trainer.splats import copied
from splatview.trainer.strategies.mcmc import MCMCStrategy
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews

SETTINGS = RenderSettings(background=(0.2, 0.2, 0.2))

ROUNDED = 0.6 / 255
"""Of photos, and of float32."""


@pytest.fixture
def splats(truth: Gaussians) -> Parameters:
    return copied(parameters_of(truth))


def test_contributions_are_weighted_by_pixel(truth: Gaussians, views: list[TrainView]) -> None:
    camera = views[0].camera
    frame = draw_frame(parameters_of(truth), camera, SETTINGS, Workspace())
    weights = np.zeros((camera.height, camera.width, 3), np.float32)
    weights[..., 0], weights[:, :20, 1], weights[:, 20:, 2] = 1, 1, 1
    found = weighted_contributions(frame, weights)
    np.testing.assert_allclose(found[:, 0], contributions(truth, [camera]), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(found[:, 1] + found[:, 2], found[:, 0], rtol=1e-4, atol=1e-5)
    assert (found[:, 1] > found[:, 2]).any() and (found[:, 1] < found[:, 2]).any()


def test_a_scene_that_meets_its_photos_is_nowhere_wrong(splats, views) -> None:
    rates = error_rates(splats, views, SETTINGS)
    assert (rates <= ROUNDED).all() and rates.any()


def test_a_wrong_splat_is_where_photos_are_wrong(splats, views) -> None:
    visible = error_rates(splats, views, SETTINGS) > 0
    row = int(np.flatnonzero(visible)[3])
    splats.sh[row] += 1.5
    rates = error_rates(splats, views, SETTINGS)
    assert rates.argmax() == row and rates[row] > 10 * np.median(rates)


def test_one_photo_that_is_wrong_asks_for_nothing(splats, views) -> None:
    spoilt = [replace(views[0], pixels=255 - views[0].pixels), *views[1:]]
    assert (error_rates(splats, spoilt[:1], SETTINGS) > 0.05).any()
    assert (error_rates(splats, spoilt, SETTINGS) <= ROUNDED).all()


def test_masks_take_pixels_out(splats, views) -> None:
    half = np.zeros(views[0].pixels.shape[:2], np.bool_)
    half[:, :24] = True
    pixels = np.where(half[..., None], views[0].pixels, 255 - views[0].pixels)
    wrong = replace(views[0], pixels=pixels)
    assert (error_rates(splats, [wrong], SETTINGS) > 0.05).any()
    assert (error_rates(splats, [replace(wrong, mask=half)], SETTINGS) <= ROUNDED).all()
    assert not error_rates(splats, [replace(wrong, mask=np.zeros_like(half))], SETTINGS).any()


def test_a_scene_that_no_photo_shows(splats, views) -> None:
    splats.means[:] += 100
    assert not error_rates(splats, views[:2], SETTINGS).any()


@pytest.mark.parametrize("error_views", [0, 8])
def test_copies_are_made_where_photos_are_wrong(error_views, views, start, make_trainer, monkeypatch) -> None:
    """The first refinement of a grey scene with one splat that is not, of photos that are grey."""
    splats, asked = copied(start), []
    splats.sh[:], splats.opacity_logits[:] = 0, 0
    splats.sh[5] = 4
    settings = make_trainer(max_splats=300, error_views=error_views, background=(0.5,) * 3).settings
    grey = [replace(view, pixels=np.full_like(view.pixels, 128)) for view in views]
    trainer = Trainer(TrainViews(grey, 0), splats, 3.0, settings)
    monkeypatch.setattr(trainer.strategy, "refine", lambda *given: asked.append(given[2].get("error_rates")))
    while not asked:
        trainer.step()
        assert "error_rates" not in trainer.state
    rates = asked[0]
    if error_views == 0:
        assert rates is None
    else:
        assert rates is not None and rates.argmax() == 5 and rates[5] > 3 * np.median(rates)


def test_draws_go_by_opacity_and_error(start) -> None:
    strategy, rng = MCMCStrategy(), np.random.default_rng(0)
    opacities, every = np.array([0.4, 0.8, 0.4, 0.4]), np.arange(4)
    some = Parameters(*(array[:4] for array in start))

    def shares(rates: np.ndarray | None) -> np.ndarray:
        drawn, _ = strategy.draw(some, opacities, rates, every, 20_000, rng)
        return np.bincount(drawn, minlength=4) / len(drawn)

    np.testing.assert_allclose(shares(None), [0.2, 0.4, 0.2, 0.2], atol=0.02)
    np.testing.assert_allclose(shares(np.zeros(4)), [0.2, 0.4, 0.2, 0.2], atol=0.02)
    np.testing.assert_allclose(shares(np.array([0.1, 0.1, 0.3, 0])), [1 / 6, 1 / 3, 1 / 2, 0], atol=0.02)
