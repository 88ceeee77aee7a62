"""The fused photo loss against float64 autograd of a plain convolution, and against `measure.metrics`."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.measure.metrics import SSIM_K, gaussian_window, ssim
from splatview.raster import Workspace
from splatview.trainer.functional import photo_loss as torch_photo_loss
from splatview.trainer.loss import mean_ssim, photo_loss


def pair(height: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A picture float64 (H, W, 4) and a photo that resembles it."""
    rng = np.random.default_rng(seed)
    image = rng.uniform(size=(height, width, 4))
    photo = 0.7 * image[..., :3] + 0.3 * rng.uniform(size=(height, width, 3))
    return image, (photo * 255).astype(np.uint8)


def plain_loss(image: torch.Tensor, photo: np.ndarray, weight: float) -> torch.Tensor:
    """What the loss should be, by conv2d: float64."""
    profile = torch.from_numpy(gaussian_window())
    window = torch.outer(profile, profile)[None, None]
    x = image[..., :3].permute(2, 0, 1)[:, None]
    y = torch.from_numpy(photo / 255.0).permute(2, 0, 1)[:, None]

    def mean(values: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(values, window)

    c1, c2 = (k**2 for k in SSIM_K)
    mx, my = mean(x), mean(y)
    variances = mean(x * x) - mx**2 + mean(y * y) - my**2
    covariance = mean(x * y) - mx * my
    similarity = (2 * mx * my + c1) * (2 * covariance + c2) / ((mx**2 + my**2 + c1) * (variances + c2))
    return (1 - weight) * (x - y).abs().mean() + weight * (1 - similarity.mean())


@settings(max_examples=15, deadline=None)
@given(height=st.integers(11, 40), width=st.integers(11, 60), weight=st.floats(0, 1), seed=st.integers(0, 99))
def test_loss_and_gradient_are_those_of_float64_autograd(height, width, weight, seed) -> None:
    image, photo = pair(height, width, seed)
    x = torch.from_numpy(image).requires_grad_()
    expected = plain_loss(x, photo, weight)
    expected.backward()
    assert x.grad is not None
    gradient = x.grad.numpy()
    exact = photo_loss(image, photo, Workspace(), ssim_weight=weight, threads=2)
    assert exact.loss == pytest.approx(expected.item(), rel=1e-12)
    np.testing.assert_allclose(exact.d_image, gradient, rtol=0, atol=1e-12 * np.abs(gradient).max())
    single = photo_loss(image.astype(np.float32), photo, Workspace(), ssim_weight=weight)
    assert single.loss == pytest.approx(expected.item(), abs=1e-6)
    # Nearer than this float32 cannot tell which of the two is brighter.
    told = np.abs(image[..., :3] - photo / 255.0) > 1e-6
    ours, exactly = single.d_image[..., :3][told], gradient[..., :3][told]
    assert told.mean() > 0.99
    np.testing.assert_allclose(ours, exactly, rtol=0, atol=1e-5 * np.abs(gradient).max())


def test_ssim_is_that_of_the_metrics() -> None:
    image, photo = pair(37, 53)
    result = photo_loss(image, photo, Workspace())
    assert result.ssim == pytest.approx(ssim(image, photo / 255.0), abs=1e-12)
    assert result.l1 == pytest.approx(np.abs(image[..., :3] - photo / 255.0).mean(), abs=1e-12)


def test_a_picture_equal_to_its_photo_has_no_loss_and_no_gradient() -> None:
    _, photo = pair(20, 20)
    image = np.concatenate([photo / 255.0, np.ones((20, 20, 1))], axis=2)
    result = photo_loss(image, photo, Workspace())
    assert result.loss == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(result.d_image, 0, atol=1e-12)


def test_any_number_of_threads_gives_the_same_bits() -> None:
    image, photo = pair(150, 64)
    results = [photo_loss(image.astype(np.float32), photo, Workspace(), threads=n) for n in (1, 2, 5)]
    assert len({result.loss for result in results}) == 1
    for result in results[1:]:
        np.testing.assert_array_equal(result.d_image, results[0].d_image)


def test_masked_pixels_do_not_matter() -> None:
    image, photo = pair(30, 30)
    mask = np.ones((30, 30), np.bool_)
    mask[5:15, 8:20] = False
    result = photo_loss(image, photo, Workspace(), mask=mask)
    grey, grey_photo = image.copy(), photo.astype(np.float64)
    grey[~mask, :3], grey_photo[~mask] = 0.5, 127.5
    x = torch.from_numpy(grey).requires_grad_()
    expected = plain_loss(x, grey_photo, 0.2)
    expected.backward()
    assert x.grad is not None
    assert result.loss == pytest.approx(expected.item(), rel=1e-12)
    assert (result.d_image[~mask] == 0).all()
    np.testing.assert_allclose(result.d_image[mask], x.grad.numpy()[mask], atol=1e-15)
    other_photo = photo.copy()
    other_photo[~mask] = 255 - photo[~mask]
    other = photo_loss(image, other_photo, Workspace(), mask=mask)
    assert other.loss == result.loss
    np.testing.assert_array_equal(other.d_image, result.d_image)
    wild = image.copy()
    wild[~mask] = np.nan
    assert photo_loss(wild, photo, Workspace(), mask=mask).loss == pytest.approx(result.loss, rel=1e-12)


def test_wrong_arrays_are_named() -> None:
    image, photo = pair(20, 20)
    with pytest.raises(ValueError, match="image must be"):
        photo_loss(image[..., :3], photo, Workspace())
    with pytest.raises(ValueError, match="photo must be uint8"):
        photo_loss(image, photo / 255.0, Workspace())
    with pytest.raises(ValueError, match="mask must be bool"):
        photo_loss(image, photo, Workspace(), mask=np.ones((3, 3), np.bool_))
    with pytest.raises(ValueError, match="at least 11x11"):
        photo_loss(image[:10], photo[:10], Workspace())
    assert photo_loss(image[:10], photo[:10], Workspace(), ssim_weight=0).loss > 0


def test_torch_operation_differentiates() -> None:
    image, photo = pair(14, 13)
    x = torch.from_numpy(image).requires_grad_()
    loss = torch_photo_loss(x, torch.from_numpy(photo), ssim_weight=1.0)
    (3 * loss).backward()
    y = torch.from_numpy(image).requires_grad_()
    expected = plain_loss(y, photo, 1.0)
    (3 * expected).backward()
    assert loss.item() == pytest.approx(expected.item(), rel=1e-12)
    assert x.grad is not None and y.grad is not None
    torch.testing.assert_close(x.grad, y.grad, rtol=1e-10, atol=1e-14)
    pixels, mask = torch.from_numpy(photo), torch.rand(14, 13, generator=torch.manual_seed(0)) > 0.2

    def masked(image: torch.Tensor) -> torch.Tensor:
        return torch_photo_loss(image, pixels, mask=mask)

    assert torch.autograd.gradcheck(masked, (torch.from_numpy(image).requires_grad_(),))


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("kind", ["noise", "near", "bright and flat", "out of range"])
def test_similarity_of_an_evaluation_is_that_of_the_definition(kind, masked):
    """Both in float64, clipped alike; what the mask leaves out is grey in both. Sums are in another order,
    and a variance is a difference of two: 1e-9."""
    rng = np.random.default_rng(3)
    photo = rng.integers(0, 256, size=(57, 83, 3), dtype=np.uint8)
    picture = photo / np.float32(255) + rng.normal(scale=0.02, size=photo.shape).astype(np.float32)
    if kind == "noise":
        picture = rng.random(photo.shape, dtype=np.float32)
    if kind == "bright and flat":
        photo[:] = 252
        picture = np.full(photo.shape, 0.985, np.float32)
    if kind == "out of range":
        picture = picture * 5 - 2
    mask = rng.random(photo.shape[:2]) > 0.2 if masked else None
    pair = [picture, photo / 255]
    if mask is not None:
        pair = [np.where(mask[..., None], pixels, 0.5) for pixels in pair]
    found = mean_ssim(picture, photo, Workspace(), mask=mask, threads=2)
    assert found == pytest.approx(ssim(*pair), abs=1e-9)
