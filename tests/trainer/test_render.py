"""Gradients of the CPU rasteriser against float64 autograd of a plain torch picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import reference_torch
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatview import raster
from splatview.scene import Camera, Gaussians, ImageModel, Lens, RenderSettings, look_at, reference
from splatview.scene.lens import COUNTS
from splatview.scene.projection import project
from splatview.trainer import functional
from splatview.trainer.functional import (
    GRADIENT_EARLY_STOP,
    Visibility,
    photo_loss,
    rasterize,
    rasterize_depth,
)

GROUPS = ("means", "quats", "log_scales", "opacity_logits", "sh")
BOUNDS = {torch.float32: 1e-4, torch.float64: 1e-9}
"""Of |ours - truth| / |truth|, the norms being those of a whole group: the error that a step along it has."""

NEGLIGIBLE = 1e-6
"""A group whose gradient is below this share of the largest one's counts as that large: some cancel to
nothing, a round splat's by its quaternion say, and only rounding is left of them."""

LENSES = {
    "RADIAL": (-0.2, 0.05),
    "FULL_OPENCV": (0.1, -0.05, 0.01, -0.02, 0.02, 0.2, 0.05, 0.01),
    "OPENCV_FISHEYE": (0.05, -0.02, 0.01, 0.003),
    "FOV": (1.2,),
    "THIN_PRISM_FISHEYE": (0.03, 0.01, 0.01, -0.02, 0.0, 0.01, 0.02, -0.01),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.03, 0.01, -0.01, 0.02, 0.0, 0.01, 0.01, -0.02, 0.02, 0.01, -0.01, 0.02),
    "DIVISION": (0.1,),
    "EUCM": (0.6, 1.3),
}
"""Strong ones, each with a part of the formula that the others lack."""

NEAR_CUT, NEAR_CAP = 1e-6, 1e-5
"""An alpha so close to the cut or the cap may fall on the other side of it in float32."""


def tensors_of(scene: Gaussians, dtype: torch.dtype) -> dict[str, torch.Tensor]:
    return {name: torch.tensor(getattr(scene, name), dtype=dtype, requires_grad=True) for name in GROUPS}


def picture(inputs, camera, settings=None, **options: Any) -> tuple[torch.Tensor, Visibility]:
    means, quats, log_scales, opacity_logits, sh = (inputs[name] for name in GROUPS)
    return rasterize(means, quats, log_scales, opacity_logits, sh, camera, settings, **options)


def gradient(tensor: torch.Tensor) -> torch.Tensor:
    assert tensor.grad is not None
    return tensor.grad


def loss_weights(camera: Camera) -> torch.Tensor:
    """A random linear loss: its gradient by the picture, (H, W, 4) float64, exact in float32 too."""
    weights = np.random.default_rng(5).normal(size=(camera.height, camera.width, 4))
    return torch.from_numpy(weights.astype(np.float32).astype(np.float64))


def true_gradients(scene, camera, settings, weights) -> dict[str, torch.Tensor]:
    inputs = tensors_of(scene, torch.float64)
    inputs["background"] = torch.tensor(settings.background, dtype=torch.float64, requires_grad=True)
    inputs["pose"] = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    means, quats, log_scales, opacity_logits, sh, background, pose = inputs.values()
    image = reference_torch.render(
        means, quats, log_scales, opacity_logits, sh, camera, settings, background, pose
    )
    (image * weights).sum().backward()
    assert np.abs(image.detach().numpy() - reference.render(scene, camera, settings)).max() < 1e-12
    return {name: gradient(value) for name, value in inputs.items()}


def our_gradients(scene, camera, settings, dtype, *, weights=None, **options) -> dict[str, torch.Tensor]:
    inputs = tensors_of(scene, dtype)
    background = torch.tensor(settings.background, dtype=dtype, requires_grad=True)
    pose = torch.zeros(6, dtype=dtype, requires_grad=True)
    image, _ = picture(inputs, camera, settings, background=background, pose=pose, **options)
    weights = loss_weights(camera) if weights is None else weights
    (image * weights.to(dtype)).sum().backward()
    inputs |= {"background": background, "pose": pose}
    return {name: gradient(value) for name, value in inputs.items()}


def assert_gradients(scene, camera, settings=None) -> None:
    """Both precisions against float64 autograd. In float32 pixels with an alpha beside an edge are given no
    weight in the loss, on either side: rounding may decide whether they show a splat at all."""
    settings = settings or RenderSettings(background=(0.2, 0.5, 0.8))
    beside = torch.from_numpy(beside_an_edge(scene, camera, settings))
    weights = loss_weights(camera)
    truth = true_gradients(scene, camera, settings, weights)
    for dtype, bound in reversed(BOUNDS.items()):
        if dtype == torch.float32 and beside.any():
            weights[beside] = 0
            truth = true_gradients(scene, camera, settings, weights)
        assert set(truth) == {*GROUPS, "background", "pose"}
        ours = our_gradients(scene, camera, settings, dtype, weights=weights)
        floor = NEGLIGIBLE * max(float(value.norm()) for value in truth.values())
        for name, expected in truth.items():
            error = float((ours[name].double() - expected).norm())
            allowed = bound * max(float(expected.norm()), floor)
            if name == "background" and dtype == torch.float32:
                # Where less light than the early stop is left, how much less is not followed up.
                allowed += GRADIENT_EARLY_STOP * float(weights.abs().sum())
            assert error <= allowed, f"{name} in {dtype}: {error:.1e}, allowed {allowed:.1e}"


def beside_an_edge(scene, camera, chosen) -> np.ndarray:
    """(H, W) bool: pixels with an alpha beside the cut or the cap, by the reference's own numbers."""
    free = replace(chosen, model=replace(chosen.model, max_alpha=np.inf, alpha_cut=0.0))
    footprints = project(scene, camera, chosen)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    alphas = reference.alphas(footprints, np.arange(len(footprints.indices)), x.ravel(), y.ravel(), free)
    model = chosen.model
    beside = np.abs(alphas - model.max_alpha) <= NEAR_CAP
    if model.alpha_cut > 0:
        beside |= np.abs(alphas - model.alpha_cut) <= NEAR_CUT
    return beside.any(axis=0).reshape(camera.height, camera.width)


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_every_group_at_every_degree(random_gaussians, sh_degree, antialiased):
    camera = look_at((0.4, 0.3, -2.4), (0, 0, 0), width=45, height=38)
    model = ImageModel(antialiased=antialiased)
    assert_gradients(
        random_gaussians(150, sh_degree=sh_degree, seed=sh_degree + 20),
        camera,
        RenderSettings(model=model, background=(0.2, 0.5, 0.8)),
    )


@pytest.mark.parametrize(
    "model",
    [
        ImageModel(blur=0.0),
        ImageModel(blur=1.0, antialiased=True),
        ImageModel(jacobian_margin=None),
        ImageModel(alpha_cut=0.0),
        ImageModel(max_alpha=0.5),
    ],
)
def test_other_settings(random_gaussians, model):
    camera = look_at((0.4, 0.3, -2.4), (0, 0, 0), width=40, height=30)
    assert_gradients(random_gaussians(80, seed=4), camera, RenderSettings(model=model))


def test_lower_degree_than_stored(random_gaussians):
    camera = look_at((0.4, 0.3, -2.4), (0, 0, 0), width=30, height=30)
    settings = RenderSettings(sh_degree=1)
    scene = random_gaussians(60)
    assert_gradients(scene, camera, settings)
    assert our_gradients(scene, camera, settings, torch.float32)["sh"][:, 4:].abs().max() == 0


def test_clamped_jacobian(random_gaussians):
    """The eye among the splats: many lie beside the image, where the Jacobian no longer follows them."""
    camera = replace(look_at((0, 0, -0.2), (0, 0, 1), width=40, height=30), cx=5.0)
    assert_gradients(random_gaussians(200, seed=31, sh_degree=1), camera)


def test_many_opaque_layers(random_gaussians):
    scene = random_gaussians(300, seed=32, sh_degree=0)
    scene = replace(scene, opacity_logits=np.full(300, 3.0, np.float32))
    assert_gradients(scene, look_at((0, 0, -2), (0, 0, 0), width=40, height=40))


@pytest.mark.parametrize("model", LENSES)
def test_every_group_through_a_lens(random_gaussians, model):
    lens = Lens(model=model, parameters=LENSES[model])
    camera = replace(look_at((0.4, 0.3, -1.8), (0, 0, 0), width=45, height=38, fov_y=80), lens=lens, cx=20.0)
    assert_gradients(random_gaussians(150, sh_degree=1, seed=51), camera)


def test_clamped_jacobian_through_a_lens(random_gaussians):
    """The eye among the splats: many lie beside the image, where the Jacobian no longer follows them."""
    lens = Lens(model="OPENCV", parameters=(0.1, 0.02, 0.01, -0.01))
    camera = replace(look_at((0, 0, -0.2), (0, 0, 1), width=40, height=30), cx=5.0, lens=lens)
    assert_gradients(random_gaussians(200, seed=31, sh_degree=1), camera)


@pytest.mark.parametrize("antialiased", [False, True])
def test_parallel_rays(random_gaussians, antialiased):
    camera = replace(
        look_at((0.4, 0.3, -2.4), (0, 0, 0), width=45, height=38), orthographic=True, fx=17.0, fy=14.0
    )
    chosen = RenderSettings(model=ImageModel(antialiased=antialiased), background=(0.2, 0.5, 0.8))
    assert_gradients(random_gaussians(150, sh_degree=3, seed=52), camera, chosen)


@given(seed=st.integers(0, 2**31), model=st.sampled_from(sorted(COUNTS)), strength=st.floats(0, 0.15))
@settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_lens(random_gaussians, seed, model, strength):
    rng = np.random.default_rng(seed)
    match model:
        case "FOV":
            parameters = [7 * strength]
        case "EUCM":
            parameters = [6 * strength, 1 + rng.uniform(-strength, strength)]
        case _:
            parameters = rng.uniform(-strength, strength, COUNTS[model])
    lens = Lens(model=model, parameters=tuple(map(float, parameters)))
    camera = replace(look_at((0.1, 0, -1.5), (0, 0, 0), width=30, height=24, fov_y=100), lens=lens)
    assert_gradients(random_gaussians(60, sh_degree=1, seed=seed), camera)


@given(
    seed=st.integers(0, 2**31),
    count=st.integers(1, 60),
    sh_degree=st.integers(0, 3),
    antialiased=st.booleans(),
    width=st.integers(1, 40),
    height=st.integers(1, 40),
    eye=st.tuples(*[st.floats(-0.8, 0.8)] * 3),
    log_scale=st.floats(-6, 0),
    stretch=st.floats(0, 2),
)
@settings(
    max_examples=80,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_generated_scenes(
    random_gaussians, seed, count, sh_degree, antialiased, width, height, eye, log_scale, stretch
):
    rng = np.random.default_rng(seed)
    scene = random_gaussians(count, sh_degree=sh_degree, seed=seed)
    scales = rng.normal(log_scale, stretch, size=(count, 3)).astype(np.float32)
    scene = replace(scene, log_scales=scales)
    camera = look_at((eye[0], eye[1], eye[2] - 2), (0, 0, 0), width=width, height=height)
    model = ImageModel(antialiased=antialiased)
    chosen = RenderSettings(model=model)
    assert_gradients(scene, camera, chosen)


def test_few_pixels_are_beside_an_edge(random_gaussians):
    """What the comparisons in float32 leave out."""
    scene = random_gaussians(300, seed=33)
    camera = look_at((0.4, 0.3, -2.4), (0, 0, 0), width=200, height=150)
    assert 0 < beside_an_edge(scene, camera, RenderSettings()).mean() < 2e-3


def test_any_number_of_threads_gives_the_same_bits(random_gaussians):
    scene = random_gaussians(5000, sh_degree=2, seed=40)
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=90, height=75)
    first, *others = (
        our_gradients(scene, camera, RenderSettings(), torch.float32, threads=threads)
        for threads in (1, 2, 5)
    )
    for other in others:
        assert all(torch.equal(first[name], other[name]) for name in first)


def test_bands_do_not_show(random_gaussians, monkeypatch):
    """More pairs than fit into memory at once: the tiles are taken in runs, forward and backward."""
    scene = random_gaussians(1500, sh_degree=0, seed=41)
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=90, height=75)
    whole = our_gradients(scene, camera, RenderSettings(), torch.float64)
    monkeypatch.setattr("splatview.raster.frame.MAX_LISTED_PAIRS", 700)
    monkeypatch.setattr("splatview.raster.gradients.MAX_SUMMED_PAIRS", 300)
    banded = our_gradients(scene, camera, RenderSettings(), torch.float64)
    for name in whole:
        assert torch.allclose(whole[name], banded[name], rtol=0, atol=1e-12 * float(whole[name].abs().max()))


def test_bad_splats_have_no_gradient_and_spoil_none(random_gaussians):
    scene = random_gaussians(40, seed=42)
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=30, height=30)
    clean = our_gradients(scene, camera, RenderSettings(), torch.float32)
    means, quats, sh = scene.means.copy(), scene.quats.copy(), scene.sh.copy()
    scales, logits = scene.log_scales.copy(), scene.opacity_logits.copy()
    bad = np.arange(0, 40, 8)
    means[0, 1], quats[8], scales[16, 2], logits[24], sh[32, 3, 1] = np.nan, 0, np.inf, np.nan, -np.inf
    ill = Gaussians(means=means, quats=quats, log_scales=scales, opacity_logits=logits, sh=sh)
    ours = our_gradients(ill, camera, RenderSettings(), torch.float32)
    without = our_gradients(
        scene.take(np.setdiff1d(np.arange(40), bad)), camera, RenderSettings(), torch.float32
    )
    for name in GROUPS:
        assert torch.isfinite(ours[name]).all()
        assert (ours[name][bad] == 0).all()
        kept = np.setdiff1d(np.arange(40), bad)
        assert torch.allclose(ours[name][kept], without[name], rtol=1e-5, atol=1e-6)
    assert any((clean[name][bad] != 0).any() for name in GROUPS)


def test_visibility(random_gaussians):
    scene = random_gaussians(200, seed=43)
    camera = look_at((0, 0, -1.0), (0, 0, 0), width=60, height=50)
    inputs = tensors_of(scene, torch.float32)
    image, visibility = picture(inputs, camera)
    assert visibility.means2d is None
    radii = visibility.radii
    image[..., :3].sum().backward()
    footprint = raster.draw_frame(raster.parameters_of(scene), camera, RenderSettings(), raster.Workspace())
    assert visibility.visible.sum() == len(footprint.bins.order) == len(visibility.indices)
    assert 0 < len(visibility.indices) < 200
    assert radii.shape == visibility.indices.shape
    assert (radii > 0).all()
    with pytest.raises(RuntimeError, match="before"):
        _ = visibility.radii
    assert visibility.means2d is not None and visibility.abs_means2d is not None
    # The absolute sum bounds the sum, and a splat that is not visible pulls nothing.
    slack = 1e-5 * visibility.abs_means2d.abs().max()
    assert (visibility.means2d.abs() <= visibility.abs_means2d + slack).all()
    assert (visibility.abs_means2d[~visibility.visible] == 0).all()
    assert (visibility.abs_means2d[visibility.visible].sum(1) > 0).any()


def test_gradient_by_the_mean_in_the_image(random_gaussians):
    """With the eye on the z axis and no footprint change, dL/dmean = f/z · dL/dmean2d along x and y.

    Moving the principal point moves all means in the image and nothing else: the sum of the gradients is
    the derivative by it.
    """
    scene = random_gaussians(50, seed=44)
    camera = look_at((0, 0, -2.5), (0, 0, 0), width=40, height=40)
    model = ImageModel(jacobian_margin=None, alpha_cut=0.0)
    weights = loss_weights(camera)

    def loss(cx: float) -> tuple[float, torch.Tensor]:
        inputs = tensors_of(scene, torch.float64)
        moved = replace(camera, cx=cx)
        image, visibility = picture(inputs, moved, RenderSettings(model=model))
        (image * weights).sum().backward()
        assert visibility.means2d is not None
        return float((image.detach() * weights).sum()), visibility.means2d[:, 0].sum()

    step = 1e-5
    slope = (loss(20 + step)[0] - loss(20 - step)[0]) / (2 * step)
    assert float(loss(20)[1]) == pytest.approx(slope, rel=1e-6)


def test_workspaces_go_round(random_gaussians):
    """Two pictures alive at once do not disturb each other; a picture never differentiated is no leak."""
    scene = random_gaussians(300, seed=45)
    one, other = (look_at((x, 0, -2.5), (0, 0, 0), width=40, height=40) for x in (-1, 1))
    alone = [our_gradients(scene, camera, RenderSettings(), torch.float32) for camera in (one, other)]
    first, second = tensors_of(scene, torch.float32), tensors_of(scene, torch.float32)
    picture_one, _ = picture(first, one, RenderSettings())
    picture_two, _ = picture(second, other, RenderSettings())
    (picture_two * loss_weights(other).float()).sum().backward()
    (picture_one * loss_weights(one).float()).sum().backward()
    for inputs, expected in ((first, alone[0]), (second, alone[1])):
        assert all(torch.equal(gradient(inputs[name]), expected[name]) for name in GROUPS)


def test_a_kept_graph_is_differentiated_again(random_gaussians):
    inputs = tensors_of(random_gaussians(10), torch.float32)
    image, _ = picture(inputs, look_at((0, 0, -2), (0, 0, 0), width=20, height=20))
    photo = torch.full((20, 20, 3), 90, dtype=torch.uint8)
    loss = photo_loss(image, photo)
    loss.backward(retain_graph=True)
    once = {name: gradient(value).clone() for name, value in inputs.items()}
    loss.backward()
    for name, value in inputs.items():
        torch.testing.assert_close(gradient(value), 2 * once[name])
    with pytest.raises(RuntimeError, match="second time"):
        loss.backward()
    with pytest.raises(RuntimeError, match="once_differentiable"):
        again, _ = picture(inputs, look_at((0, 0, -2), (0, 0, 0), width=20, height=20))
        (slope,) = torch.autograd.grad(again.square().sum(), inputs["means"], create_graph=True)
        slope.sum().backward()


def test_gradients_that_are_held_are_not_overwritten(random_gaussians):
    """Memory of gradients goes round, but only where nobody has it any more."""
    inputs, camera = tensors_of(random_gaussians(50), torch.float32), look_at((0, 0, -2), (0, 0, 0))
    camera = camera.resized(20, 20)

    def differentiated(factor: float) -> tuple[torch.Tensor, int]:
        """The gradient by the means, and which of the pool's arrays that by SH went into."""
        for value in inputs.values():
            value.grad = None
        image, _ = picture(inputs, camera)
        (factor * image).sum().backward()
        return gradient(inputs["means"]), id(functional._pictures._free[-1].gradients[4])

    held = [differentiated(factor)[0] for factor in (1.0, 2.0, 3.0)]
    torch.testing.assert_close(held[1], 2 * held[0])
    torch.testing.assert_close(held[2], 3 * held[0])
    held.clear()
    assert differentiated(1.0)[1] == differentiated(1.0)[1]


@pytest.mark.parametrize("antialiased", [False, True])
def test_gradcheck(random_gaussians, antialiased):
    """torch's own check, by finite differences in float64, where no alpha is cut."""
    camera = look_at((0.4, 0.3, -2.4), (0, 0, 0), width=9, height=7)
    model = ImageModel(alpha_cut=0.0, jacobian_margin=None, antialiased=antialiased)
    chosen = RenderSettings(model=model)
    inputs = list(tensors_of(random_gaussians(4, sh_degree=1, seed=3), torch.float64).values())
    background = torch.tensor([0.2, 0.5, 0.8], dtype=torch.float64, requires_grad=True)

    def drawn(*tensors: torch.Tensor) -> torch.Tensor:
        return rasterize(*tensors[:5], camera=camera, settings=chosen, background=tensors[5])[0]

    assert torch.autograd.gradcheck(drawn, (*inputs, background))
    depth = lambda *tensors: rasterize_depth(*tensors, camera=camera, settings=chosen)  # noqa: E731
    assert torch.autograd.gradcheck(depth, tuple(inputs[:4]), atol=1e-4)


def test_depth_is_that_of_a_plane(random_gaussians):
    """Flat, opaque splats side by side, turned to the camera: their plane's depth, and 0 beside them."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.5, 0.5, 21))
    count = x.size
    inputs = {
        "means": torch.from_numpy(np.stack([x.ravel(), y.ravel(), np.full(count, 3.25)], 1)),
        "quats": torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64).repeat(count, 1),
        "log_scales": torch.full((count, 3), -3.2, dtype=torch.float64),
        "opacity_logits": torch.full((count,), 6.0, dtype=torch.float64),
    }
    means = inputs["means"].requires_grad_()
    camera = look_at((0, 0, 0), (0, 0, 1), width=40, height=40, fov_y=40)
    depth = rasterize_depth(*inputs.values(), camera=camera)
    torch.testing.assert_close(depth[20, 20], torch.tensor(3.25, dtype=torch.float64), rtol=1e-6, atol=0)
    assert depth[0, 0] == 0
    depth[20, 20].backward()
    assert float(gradient(means)[:, 2].sum()) == pytest.approx(1, abs=0.05), "it moves with the plane"


def test_parameter_changed_between_is_noticed(random_gaussians):
    inputs = tensors_of(random_gaussians(10), torch.float32)
    image, _ = picture(inputs, look_at((0, 0, -2), (0, 0, 0), width=20, height=20))
    with torch.no_grad():
        inputs["means"] += 1
    with pytest.raises(RuntimeError, match="modified"):
        image.sum().backward()


def test_means_in_the_image_are_left_out_and_a_pose_that_asks_is_not(random_gaussians):
    camera = look_at((0.4, 0.3, -2.4), (0, 0, 0), width=40, height=30)
    scene, found = random_gaussians(20), {}
    for by_view in (True, False):
        for asks in (True, False):
            inputs, pose = tensors_of(scene, torch.float32), torch.zeros(6, requires_grad=asks)
            image, info = picture(inputs, camera, pose=pose, by_view=by_view)
            image.square().sum().backward()
            assert (info.means2d is None) == (not by_view and not asks)
            found[by_view, asks] = [gradient(inputs[name]) for name in GROUPS], pose.grad
    for gradients, _ in found.values():
        assert all(map(torch.equal, gradients, found[True, True][0]))
    assert torch.equal(found[True, True][1], found[False, True][1])


@pytest.mark.parametrize("name", [*GROUPS, "background", "pose"])
def test_wrong_arguments_are_named(random_gaussians, name):
    camera = look_at((0, 0, -2), (0, 0, 0), width=20, height=20)
    for change in (lambda t: t.half(), lambda t: t[..., :-1], lambda t: t[None], lambda t: t.tolist()):
        inputs = tensors_of(random_gaussians(10), torch.float32)
        inputs |= {"background": torch.zeros(3), "pose": torch.zeros(6)}
        inputs[name] = change(inputs[name].detach())
        with pytest.raises(ValueError, match=f"^{name} must"):
            picture(inputs, camera, background=inputs["background"], pose=inputs["pose"])


def test_not_contiguous_is_fine(random_gaussians):
    scene = random_gaussians(30, seed=46)
    camera = look_at((0, 0, -2), (0, 0, 0), width=20, height=20)
    inputs = tensors_of(scene, torch.float32)
    image, _ = picture(inputs, camera)
    strided = {
        name: value.detach().repeat_interleave(2, dim=0)[::2].requires_grad_()
        for name, value in inputs.items()
    }
    again, _ = picture(strided, camera)
    assert torch.equal(image, again)
    image.square().sum().backward()
    again.square().sum().backward()
    assert all(torch.equal(gradient(inputs[name]), gradient(strided[name])) for name in GROUPS)


def test_cap_of_one_cannot_be_differentiated(random_gaussians):
    inputs = tensors_of(random_gaussians(10), torch.float32)
    settings = RenderSettings(model=ImageModel(max_alpha=1.0))
    image, _ = picture(inputs, look_at((0, 0, -2), (0, 0, 0), width=20, height=20), settings)
    with pytest.raises(ValueError, match="max_alpha"):
        image.sum().backward()
