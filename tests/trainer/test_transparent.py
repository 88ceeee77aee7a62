"""Transparent photos: what they are laid over, and that nothing is left where they are empty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from splatview.raster import Parameters, Workspace, draw_frame, render
from splatview.scene import Gaussians, RenderSettings
from splatview.scene.captures import load_capture
from splatview.scene.sh import SH_C0
from splatview.trainer.functional import expose, photo_loss
from splatview.trainer.settings import TrainSettings
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainView, TrainViews, train_views

from .conftest import EXTENT


@pytest.fixture(scope="module")
def cut_outs(truth: Gaussians, views: list[TrainView]) -> list[TrainView]:
    """The toy's photos with their opacity, over black."""
    made = []
    for view in views:
        drawn = np.clip(render(truth, view.camera, RenderSettings()), 0, 1)
        levels = (drawn * 255 + 0.5).astype(np.uint8)
        made.append(replace(view, pixels=levels[..., :3].copy(), alpha=levels[..., 3].copy()))
    return made


@pytest.fixture
def trained(cut_outs: list[TrainView], start: Parameters) -> Callable[..., Trainer]:
    """`trained(**settings)`: a trainer at its end, of all photos but the first."""

    def run(**settings) -> Trainer:
        # Black splats before black, where the photos are empty: over that alone nobody sees them.
        stray = Parameters(*(np.concatenate([array, array[:20]]) for array in start))
        stray.means[-20:] += (0.0, -0.9, 0.0)
        stray.sh[-20:] = -0.5 / SH_C0
        stray.opacity_logits[-20:] = 3
        recipe = TrainSettings(iterations=400, max_splats=300, resolution=(), **settings)
        trainer = Trainer(TrainViews(cut_outs[1:], 0), stray, EXTENT, recipe, threads=2)
        while not trainer.done:
            trainer.step()
        return trainer

    return run


def haze(trainer: Trainer, views: list[TrainView]) -> float:
    """Mean opacity where the photos are empty."""
    found = []
    for view in views:
        drawn = draw_frame(trainer.splats.arrays, view.camera, trainer.render_settings, Workspace()).image
        found.append(float(drawn[..., 3][view.alpha == 0].mean()))
    return float(np.mean(found))


def test_no_haze_is_left_where_photos_are_empty(trained, cut_outs: list[TrainView]) -> None:
    assert haze(trained(alpha_weight=0), cut_outs) > 0.02
    assert haze(trained(), cut_outs) < 0.005


def test_smaller_photos_keep_their_opacity(cut_outs: list[TrainView]) -> None:
    small = cut_outs[0].smaller(2)
    assert small.alpha is not None and small.alpha.shape == small.pixels.shape[:2]
    exact = np.asarray(cut_outs[0].alpha).reshape(20, 2, 24, 2).mean(axis=(1, 3))
    assert np.abs(small.alpha - exact).max() <= 0.51
    with pytest.raises(ValueError, match="alpha must be uint8"):
        replace(cut_outs[0], alpha=np.zeros((3, 3), np.uint8))


def test_the_loss_of_opacity_is_its_mean_difference(views: list[TrainView]) -> None:
    rng = np.random.default_rng(0)
    image = torch.from_numpy(rng.uniform(size=(14, 16, 4))).requires_grad_()
    photo = torch.from_numpy(rng.integers(0, 256, (14, 16, 3), dtype=np.uint8))
    alpha = torch.from_numpy(rng.integers(0, 256, (14, 16), dtype=np.uint8))
    mask = torch.from_numpy(rng.uniform(size=(14, 16)) < 0.7)

    def loss(image: torch.Tensor, weight: float = 0.3) -> torch.Tensor:
        return photo_loss(image, photo, mask=mask, alpha=alpha, alpha_weight=weight)

    assert torch.autograd.gradcheck(loss, (image,), fast_mode=True)
    expected = 0.3 * ((image[..., 3] - alpha / 255).abs() * mask).mean()
    torch.testing.assert_close(loss(image) - loss(image, 0.0), expected)
    with pytest.raises(ValueError, match="alpha must be uint8"):
        photo_loss(image, photo, alpha=alpha[:3], alpha_weight=0.3)
    with pytest.raises(ValueError, match="alpha_weight"):
        photo_loss(image, photo, alpha=alpha, alpha_weight=float("nan"))


def test_exposure_leaves_the_background_of_a_cut_out_alone() -> None:
    rng, behind = np.random.default_rng(1), (0.2, 0.7, 0.4)
    image = torch.from_numpy(rng.uniform(size=(13, 14, 4))).requires_grad_()
    exposure = torch.from_numpy(rng.normal(scale=0.2, size=(3, 2))).requires_grad_()
    assert torch.autograd.gradcheck(lambda x, e: expose(x, e, behind), (image, exposure), fast_mode=True)
    # What is drawn over b is c + (1 - a)·b: only c is a matter of exposure, offsets being a part of a.
    colours, alpha = rng.uniform(size=(13, 14, 3)), rng.uniform(size=(13, 14, 1))
    over = np.concatenate([colours + (1 - alpha) * behind, alpha], axis=-1)
    gain, offset = exposure[:, 0].exp().detach().numpy(), exposure[:, 1].detach().numpy()
    exposed = expose(torch.from_numpy(over), exposure, behind).detach().numpy()
    np.testing.assert_allclose(
        exposed[..., :3], colours * gain + alpha * offset + (1 - alpha) * behind, atol=1e-12
    )


def test_photos_keep_their_opacity_and_masks_may_cut_out(capture_folder: Path) -> None:
    made = {}
    for image in sorted((capture_folder / "images").iterdir()):
        pixels = np.asarray(Image.open(image).convert("RGB"))
        columns = np.arange(pixels.shape[1])[None, :].repeat(len(pixels), 0)
        alpha = np.where(columns < 20, 255, 51).astype(np.uint8)
        made[image.name] = np.concatenate([pixels, alpha[..., None]], axis=-1)
        if image.name not in ("view_4.png", "view_5.png"):
            Image.fromarray(made[image.name], "RGBA").save(image)
    rgba = made["view_3.png"]
    left = rgba[..., 3] == 255
    (capture_folder / "masks").mkdir()
    Image.fromarray(np.where(left, 255, 0).astype(np.uint8)).save(capture_folder / "masks" / "view_5.png")

    def photos(**options) -> dict[str, TrainView]:
        views = train_views(load_capture(capture_folder, **options).photos)
        return {view.camera.name: view for view in views}

    ignored = photos(background=(1.0, 1.0, 1.0))
    np.testing.assert_array_equal(ignored["view_3.png"].alpha, rgba[..., 3])
    assert ignored["view_4.png"].alpha is None and ignored["view_5.png"].alpha is None
    assert ignored["view_5.png"].mask is not None
    cut = photos(background=(1.0, 1.0, 1.0), masks="cut-out")["view_5.png"]
    assert cut.mask is None
    np.testing.assert_array_equal(cut.alpha, np.where(left, 255, 0))
    assert (cut.pixels[~left] == 255).all()
    np.testing.assert_array_equal(cut.pixels[left], ignored["view_5.png"].pixels[left])
