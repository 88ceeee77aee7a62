"""Whatever arrays come in: a ValueError that names the argument, or a culled splat; never a crash."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from splatview import raster
from splatview.raster.gradients import differentiate
from splatview.raster.parameters import check_parameters
from splatview.scene import Gaussians, ImageModel, RenderSettings, look_at

CAMERA = look_at((0, 0, -3), (0, 0, 0), width=33, height=17)

WRONG = {
    "list": lambda array: array.tolist(),
    "None": lambda array: None,
    "integers": lambda array: array.astype(np.int32),
    "half": lambda array: array.astype(np.float16),
    "complex": lambda array: array.astype(np.complex64),
    "a column less": lambda array: array[..., :-1],
    "a row less": lambda array: array[:-1],
    "a dimension more": lambda array: array[None],
    "a number": lambda array: np.array(1.0, np.float32),
    "objects": lambda array: array.astype(object),
    "other byte order": lambda array: array.astype(array.dtype.newbyteorder()),
}


def arrays_of(scene: Gaussians) -> dict[str, np.ndarray]:
    return raster.parameters_of(scene)._asdict()


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "opacity_logits", "sh"])
def test_wrong_array_is_named(random_gaussians, name, wrong):
    parameters = arrays_of(random_gaussians(10))
    parameters[name] = WRONG[wrong](parameters[name])
    # A missing row of means shows in the others, which no longer fit.
    with pytest.raises(ValueError, match="must" if wrong == "a row less" else f"^{name} must"):
        check_parameters(**parameters)


def test_mixed_precision_is_refused(random_gaussians):
    parameters = arrays_of(random_gaussians(10))
    parameters["sh"] = parameters["sh"].astype(np.float64)
    with pytest.raises(ValueError, match=r"^sh must be float32"):
        check_parameters(**parameters)


@pytest.mark.parametrize("count", [2, 5, 15, 17])
def test_wrong_number_of_coefficients(random_gaussians, count):
    parameters = arrays_of(random_gaussians(10))
    parameters["sh"] = np.zeros((10, count, 3), np.float32)
    with pytest.raises(ValueError, match=r"^sh must"):
        check_parameters(**parameters)


def test_not_contiguous_is_copied(random_gaussians):
    scene = random_gaussians(50)
    strided = Gaussians(
        means=np.asfortranarray(scene.means),
        quats=np.repeat(scene.quats, 2, axis=0)[::2],
        log_scales=scene.log_scales[::-1].copy()[::-1],
        opacity_logits=np.repeat(scene.opacity_logits, 3)[::3],
        sh=np.ascontiguousarray(scene.sh.transpose(2, 1, 0)).transpose(2, 1, 0),
    )
    assert np.array_equal(raster.render(strided, CAMERA), raster.render(scene, CAMERA))


def test_read_only_and_unaligned(random_gaussians):
    scene = random_gaussians(50)
    raw = np.frombuffer(b"x" + scene.means.tobytes(), np.uint8)
    unaligned = raw[1:].view(np.float32).reshape(-1, 3)
    assert not unaligned.flags.writeable
    from_file = Gaussians(
        means=unaligned,
        quats=scene.quats,
        log_scales=scene.log_scales,
        opacity_logits=scene.opacity_logits,
        sh=scene.sh,
    )
    assert np.array_equal(raster.render(from_file, CAMERA), raster.render(scene, CAMERA))


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"threads": 0}, "threads"),
        ({"threads": -1}, "threads"),
        ({"early_stop": -0.1}, "early_stop"),
        ({"early_stop": 1.0}, "early_stop"),
        ({"early_stop": float("nan")}, "early_stop"),
        ({"dtype": np.float16}, "dtype"),
        ({"background": np.zeros(4)}, "background"),
        ({"background": np.array([0, np.nan, 0])}, "background"),
    ],
)
def test_wrong_option_is_named(random_gaussians, options, name):
    scene = raster.parameters_of(random_gaussians(3))
    with pytest.raises(ValueError, match=name):
        raster.draw_frame(scene, CAMERA, RenderSettings(), raster.Workspace(), **options)


def test_wrong_settings_are_named(random_gaussians):
    scene = random_gaussians(3)
    with pytest.raises(ValueError, match="sh_degree"):
        raster.render(scene, CAMERA, RenderSettings(sh_degree=-1))
    with pytest.raises(ValueError, match="background"):
        raster.render(scene, CAMERA, RenderSettings(background=(0, 0)))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    "d_image",
    [
        None,
        np.zeros((17, 33, 3), np.float32),
        np.zeros((33, 17, 4), np.float32),
        np.zeros((17, 33, 4), np.float64),
    ],
)
def test_wrong_gradient_is_named(random_gaussians, d_image):
    scene = raster.parameters_of(random_gaussians(3))
    frame = raster.draw_frame(scene, CAMERA, RenderSettings(), raster.Workspace())
    with pytest.raises(ValueError, match="d_image"):
        differentiate(scene, frame, d_image)


def test_arrays_of_earlier_gradients_are_overwritten_where_they_fit(random_gaussians):
    splats = raster.parameters_of(random_gaussians(30))
    frame = raster.draw_frame(splats, CAMERA, RenderSettings(), raster.Workspace())
    weights = np.ones_like(frame.image)
    expected = differentiate(splats, frame, weights)
    other = differentiate(splats, frame, -2 * weights)
    again = differentiate(splats, frame, weights, reuse=other)
    assert again.parameters.sh is other.parameters.sh
    for ours, theirs in zip(again.parameters, expected.parameters, strict=True):
        assert np.array_equal(ours, theirs)
    fewer = raster.parameters_of(random_gaussians(29))
    frame = raster.draw_frame(fewer, CAMERA, RenderSettings(), raster.Workspace())
    assert len(differentiate(fewer, frame, weights, reuse=again).parameters.sh) == 29


def test_gradients_by_the_view_are_left_out_where_nobody_asks(random_gaussians):
    splats = raster.parameters_of(random_gaussians(30))
    for dtype in (np.float32, np.float64):
        frame = raster.draw_frame(splats, CAMERA, RenderSettings(), raster.Workspace(), dtype=dtype)
        weights = np.random.default_rng(0).normal(size=frame.image.shape).astype(dtype)
        whole = differentiate(splats, frame, weights)
        parts = differentiate(splats, frame, weights, by_view=False)
        assert (parts.means2d, parts.abs_means2d, parts.pose) == (None, None, None)
        for ours, theirs in zip(parts.parameters, whole.parameters, strict=True):
            assert np.array_equal(ours, theirs)  # and every sum is made as before
        # Arrays go from one kind to the other and back.
        again = differentiate(splats, frame, weights, reuse=parts)
        for name in ("means2d", "abs_means2d", "pose"):
            assert np.array_equal(getattr(again, name), getattr(whole, name))
        assert differentiate(splats, frame, weights, by_view=False, reuse=again).means2d is None


def anything(*shape: int):
    return arrays.arrays(np.float32, shape, elements=st.floats(width=32))


@given(anything(6, 3), anything(6, 4), anything(6, 3), anything(6), anything(6, 4, 3))
@settings(max_examples=60, deadline=None)
def test_any_bits_make_a_finite_picture_and_finite_gradients(means, quats, log_scales, logits, sh):
    # Colours beyond 10³⁰ could add up to infinity; that would be the picture they ask for.
    scene = check_parameters(means, quats, log_scales, logits, np.where(np.abs(sh) > 1e30, np.nan, sh))
    frame = raster.draw_frame(scene, CAMERA, RenderSettings(), raster.Workspace(), threads=1)
    assert np.isfinite(frame.image).all()
    gradients = differentiate(scene, frame, np.ones_like(frame.image))
    for name, gradient in gradients.parameters._asdict().items():
        assert np.isfinite(gradient).all(), name


BOUNDS_CHECKED = """
import numpy as np
from splatview import raster
from splatview.raster.gradients import differentiate
from splatview.raster.parameters import check_parameters
from splatview.raster.compiling import BOUNDSCHECK
from splatview.scene import ImageModel, RenderSettings, look_at
assert BOUNDSCHECK
rng = np.random.default_rng(1)
for count, width, height in ((0, 5, 5), (1, 1, 1), (300, 33, 17), (2500, 70, 100)):
    scene = check_parameters(
        rng.normal(size=(count, 3)).astype(np.float32),
        rng.normal(size=(count, 4)).astype(np.float32),
        rng.normal(-2, 1.5, size=(count, 3)).astype(np.float32),
        rng.normal(size=count).astype(np.float32),
        rng.normal(size=(count, 16, 3)).astype(np.float32),
    )
    for eye in ((0, 0, -3), (0, 0, -0.5)):
        camera = look_at(eye, (0, 0, 0), width=width, height=height)
        for threads in (1, 2):
            workspace = raster.Workspace()
            frame = raster.draw_frame(scene, camera, RenderSettings(), workspace, threads=threads)
            differentiate(scene, frame, np.ones_like(frame.image))

# Vectors reach memory by address; the check beside them must work too.
from splatview.raster.compiling import inline
from splatview.raster.simd import load, store

@inline
def copy(array, start, to):
    store(array, to, load(array, start))

copy(np.zeros(32, np.float32), 16, 0)
for start, to in ((17, 0), (0, 17), (-1, 0)):
    try:
        copy(np.zeros(32, np.float32), start, to)
    except IndexError:
        continue
    raise SystemExit("a vector beyond its array was not noticed")
print("all within bounds")
"""


def test_kernels_stay_within_bounds():
    """Every access of every kernel checked by numba, in a process of its own: it is decided on import.

    The compiler's first level leaves every check in place, and takes half of the time.
    """
    result = subprocess.run(
        [sys.executable, "-c", BOUNDS_CHECKED],
        env={**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_OPT": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "all within bounds"


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("blur", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(6))
def test_hard_but_valid_scenes_have_finite_gradients(seed, blur, antialiased):
    """Quaternions, scales and opacities over all of float32, splats just beyond the near plane."""
    rng = np.random.default_rng(seed)
    count = 80
    means = rng.normal(size=(count, 3)) * rng.choice([0.01, 1, 3], size=(count, 1))
    means[:10, 2] = -3 + 10.0 ** rng.uniform(-2.1, -1, 10)
    scales = rng.uniform(-30, rng.choice([0, 5, 30]), size=(count, 3))
    scales[0, 0] = -np.inf
    scene = check_parameters(
        means.astype(np.float32),
        (rng.normal(size=(count, 4)) * 10.0 ** rng.uniform(-28, 28, (count, 1))).astype(np.float32),
        scales.astype(np.float32),
        rng.choice([-3, 0, 3, 100, np.inf, -100], size=count).astype(np.float32),
        (rng.normal(size=(count, 16, 3)) * rng.choice([1, 1e6], size=(count, 1, 1))).astype(np.float32),
    )
    model = ImageModel(antialiased=antialiased, blur=blur)
    frame = raster.draw_frame(scene, CAMERA, RenderSettings(model=model), raster.Workspace())
    assert frame.image[..., 3].max() > 0.5
    weights = rng.normal(size=frame.image.shape).astype(np.float32)
    gradients = differentiate(scene, frame, weights)
    for name, gradient in gradients.parameters._asdict().items():
        assert np.isfinite(gradient).all(), name
    assert gradients.pose is not None and np.isfinite(gradients.pose).all()
    assert np.abs(gradients.parameters.means).max() > 0
