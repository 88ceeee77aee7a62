"""The OpenGL 3.3 renderer against the truth. The last test runs this file again under 3.3 and 4.1."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatview.measure.metrics import largest_error, psnr
from splatview.renderers import VisualMode
from splatview.renderers.gl import scene_textures as texel_array
from splatview.renderers.gl import sort_thread as sort_worker
from splatview.renderers.gl.context import describe
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH
from splatview.renderers.request import FrameRequest
from splatview.scene import TEXTBOOK, Gaussians, ImageModel, InputError, RenderSettings, look_at, reference
from splatview.scene.formats import load_scene
from splatview.scene.sh import rgb_to_sh

CAMERA = look_at((0.4, -0.3, -2.2), (0, 0, 0), width=97, height=61)
FLOAT32 = RenderSettings(blend="float32")


@pytest.fixture
def renderer(ctx):
    renderer = QuadsGL33Renderer(ctx)
    yield renderer
    renderer.close()


@pytest.fixture
def gate(monkeypatch):
    """Holds the sort thread back until it is set."""
    gate = threading.Event()
    sort = sort_worker.depth_order

    def gated(means, view, workspace):
        gate.wait(20)
        return sort(means, view, workspace)

    monkeypatch.setattr(sort_worker, "depth_order", gated)
    yield gate
    gate.set()


def assert_true(image: np.ndarray, gaussians: Gaussians, camera, settings: RenderSettings) -> None:
    truth = reference.render(gaussians, camera, settings)
    exact = settings.blend == "float32"
    assert image.shape == truth.shape
    assert image.dtype == np.float32
    assert psnr(image, truth) >= (60 if exact else 50)
    assert largest_error(image, truth) <= (2e-3 if exact else 4 / 255)


@pytest.mark.parametrize("blend", ["float16", "float32"])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_random_scenes(renderer, random_gaussians, degree, blend):
    gaussians = random_gaussians(400, sh_degree=degree, seed=degree)
    settings = RenderSettings(blend=blend, background=(0.2, 0.5, 0.9))
    assert_true(renderer.render(FrameRequest(gaussians, CAMERA, settings)), gaussians, CAMERA, settings)


@pytest.mark.parametrize(
    "settings",
    [
        replace(FLOAT32, sh_degree=1),
        replace(FLOAT32, model=ImageModel(antialiased=True)),
        replace(FLOAT32, model=ImageModel(blur=0.1)),
        replace(FLOAT32, model=ImageModel(near=2.0)),
        replace(FLOAT32, model=TEXTBOOK),
    ],
    ids=["sh 1", "antialiased", "thin blur", "near plane inside", "textbook"],
)
def test_every_setting(renderer, random_gaussians, settings):
    gaussians = random_gaussians(150, seed=7)
    assert_true(renderer.render(FrameRequest(gaussians, CAMERA, settings)), gaussians, CAMERA, settings)


@pytest.mark.parametrize("count", [1, TEXTURE_WIDTH - 1, TEXTURE_WIDTH, TEXTURE_WIDTH + 1, 5000])
def test_whole_and_partial_rows_of_texels(renderer, random_gaussians, count):
    gaussians = random_gaussians(count, sh_degree=1)
    camera = look_at((0, 0, -3), (0, 0, 0), width=48, height=32)
    assert_true(renderer.render(FrameRequest(gaussians, camera, FLOAT32)), gaussians, camera, FLOAT32)


@pytest.mark.parametrize("size", [(1, 1), (17, 9), (16, 16), (130, 3)])
def test_odd_sizes_and_the_eye_inside(renderer, random_gaussians, size):
    gaussians = random_gaussians(300)
    camera = replace(look_at((0.1, 0.1, 0.1), (0, 0, 1), width=size[0], height=size[1]), cx=size[0] * 0.2)
    assert_true(renderer.render(FrameRequest(gaussians, camera, FLOAT32)), gaussians, camera, FLOAT32)


def test_an_empty_scene_is_the_background(renderer, random_gaussians):
    image = renderer.render(
        FrameRequest(random_gaussians(0), CAMERA, RenderSettings(background=(0.25, 0.5, 1)))
    )
    assert np.array_equal(image, np.broadcast_to(np.array([0.25, 0.5, 1, 0], np.float32), image.shape))
    assert renderer.stats().visible == 0


def test_ill_splats_are_culled_and_the_others_stay(renderer, random_gaussians):
    gaussians = random_gaussians(300)
    arrays = {name: getattr(gaussians, name).copy() for name in ("means", "quats", "log_scales", "sh")}
    logits = gaussians.opacity_logits.copy()
    arrays["means"][0, 1] = np.nan
    arrays["means"][1, 0] = np.inf
    arrays["quats"][2] = 0
    arrays["quats"][3, 2] = np.nan
    arrays["log_scales"][4, 1] = np.inf
    arrays["sh"][5, 7, 1] = np.nan
    logits[6], logits[7], logits[8] = np.nan, -np.inf, np.inf
    ill = replace(gaussians, **arrays, opacity_logits=logits)
    image = renderer.render(FrameRequest(ill, CAMERA, FLOAT32))
    assert np.isfinite(image).all()
    assert_true(image, ill, CAMERA, FLOAT32)


def test_a_scene_ten_thousand_kilometres_away(renderer, random_gaussians):
    gaussians = random_gaussians(300)
    shift = np.array([1e7, -2e7, 5e6])
    far = replace(gaussians, means=gaussians.means.astype(np.float64) + shift)
    camera = look_at(CAMERA.eye + shift, shift, width=97, height=61)
    assert_true(renderer.render(FrameRequest(far, camera, FLOAT32)), far, camera, FLOAT32)


@pytest.mark.parametrize("blend", ["float16", "float32"])
@pytest.mark.parametrize("scene", ["train-1000", "skull"])
def test_trained_scenes(renderer, data_file, scene, blend):
    gaussians = load_scene(data_file(f"scenes/{scene}.ply"))
    middle = np.median(gaussians.means, axis=0).astype(np.float64)
    radius = np.median(np.linalg.norm(gaussians.means - middle, axis=1))
    camera = look_at(middle + np.array([0.5, 0.8, -3]) * radius, middle, width=128, height=96)
    settings = RenderSettings(blend=blend)
    assert_true(renderer.render(FrameRequest(gaussians, camera, settings)), gaussians, camera, settings)


def test_same_pictures_as_the_compute_path(ctx, renderer, random_gaussians):
    if not describe(ctx).has_compute:
        pytest.skip("this context has no compute shaders")
    gaussians = random_gaussians(3000)
    other = QuadsRenderer(ctx)
    for settings in (RenderSettings(), FLOAT32):
        image = renderer.render(FrameRequest(gaussians, CAMERA, settings))
        assert largest_error(image, other.render(FrameRequest(gaussians, CAMERA, settings))) <= 1e-3
    assert renderer.stats().visible == other.stats(wait=True).visible
    other.close()


# ---- visual modes


def balls(depths: list[float], *, radius: float = 0.3, opacity: float = 2.0) -> Gaussians:
    """Grey balls on the axis that a camera at the origin looks along."""
    n = len(depths)
    means = np.zeros((n, 3), np.float32)
    means[:, 2] = depths
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    return Gaussians(
        means=means,
        quats=quats,
        log_scales=np.full((n, 3), np.log(radius), np.float32),
        opacity_logits=np.full(n, opacity, np.float32),
        sh=np.full((n, 1, 3), rgb_to_sh(np.array(0.4)), np.float32),
    )


AXIS = look_at((0, 0, 0), (0, 0, 1), up=(0, -1, 0), width=63, height=63)


def test_points_are_small_opaque_discs(renderer):
    image = renderer.render(FrameRequest(balls([3.0], opacity=-4.0), AXIS, FLOAT32, mode="points"))
    rows, columns = np.nonzero(image[..., 3] > 0)
    assert 5 <= len(rows) <= 21
    assert np.abs(rows - 31).max() <= 2
    assert np.abs(columns - 31).max() <= 2
    assert np.allclose(image[31, 31], [0.4, 0.4, 0.4, 1], atol=1e-6)


def test_ellipsoids_are_opaque_surfaces_lit_from_the_eye(renderer):
    image = renderer.render(FrameRequest(balls([3.0]), AXIS, FLOAT32, mode="ellipsoids"))
    rows, columns = np.indices((63, 63)) + 0.5
    slope = 0.3 * 1.5 / 3  # sine of the angle at which the sphere of 1.5 sigma is seen
    radius = AXIS.fx * slope / np.sqrt(1 - slope**2)
    distance = np.hypot(rows - 31.5, columns - 31.5) / radius
    assert (image[distance < 0.98][:, 3] == 1).all()
    assert (image[distance > 1.02][:, 3] == 0).all()
    assert image[31, 31, 0] == pytest.approx(0.4, abs=2e-3), "lit in full where it faces the eye"
    assert (image[(distance > 0.9) & (distance < 0.98)][:, 0] < 0.28).all()


def test_a_nearer_ellipsoid_hides_a_farther_one(renderer):
    scene = balls([4.0, 3.0])
    colours = scene.sh.copy()
    colours[1] = rgb_to_sh(np.array([0.9, 0.1, 0.1]))
    image = renderer.render(FrameRequest(replace(scene, sh=colours), AXIS, FLOAT32, mode="ellipsoids"))
    assert image[31, 31, 0] > 0.8


def test_nearer_is_brighter_in_depth_colours(renderer):
    lightness = []
    for depth in (2.0, 3.0, 4.0):
        scene = balls([depth, 2.0, 4.0])
        moved = scene.means.copy()
        moved[1:, 0] = 50, -50  # out of sight: they keep the range of depths the same
        image = renderer.render(FrameRequest(replace(scene, means=moved), AXIS, FLOAT32, mode="depth"))
        shown = image[31, 31]
        assert shown[3] > 0.8
        lightness.append(shown[:3].sum() / shown[3])
    assert lightness[0] > lightness[1] > lightness[2]


def test_overdraw_counts_splats(renderer):
    def brightness(count: int) -> float:
        image = renderer.render(FrameRequest(balls([3.0] * count), AXIS, FLOAT32, mode="overdraw"))
        return float(image[31, 31, :3].sum())

    heat = [brightness(count) for count in (0, 1, 4, 16, 64, 400)]
    assert heat == sorted(heat)
    assert len(set(heat)) == len(heat)
    assert brightness(513) == brightness(600), "512 and more show as the last colour"


@pytest.mark.parametrize("mode", ["points", "ellipsoids", "depth", "overdraw"])
def test_modes_look_as_on_the_compute_path(ctx, renderer, random_gaussians, mode):
    if not describe(ctx).has_compute:
        pytest.skip("this context has no compute shaders")
    gaussians = random_gaussians(500)
    other = QuadsRenderer(ctx)
    other.load(gaussians)
    other.draw(FrameRequest(None, CAMERA, FLOAT32, mode=mode))
    assert (
        largest_error(renderer.render(FrameRequest(gaussians, CAMERA, FLOAT32, mode=mode)), other.read())
        <= 2e-3
    )
    other.close()


def test_every_mode_is_drawn_anew_and_back(renderer, random_gaussians):
    gaussians = random_gaussians(300)
    modes: tuple[VisualMode, ...] = ("splats", "points", "ellipsoids", "depth", "overdraw")
    images = [renderer.render(FrameRequest(gaussians, CAMERA, FLOAT32, mode=mode)) for mode in modes]
    for i, image in enumerate(images):
        assert np.isfinite(image).all()
        assert not any(np.allclose(image, other, atol=0.01) for other in images[:i])
    again = renderer.render(FrameRequest(gaussians, CAMERA, FLOAT32))
    assert np.array_equal(again, images[0])
    assert renderer.stats().sorted == 1, "no mode needs another order"


# ---- when things happen


def test_nothing_is_done_again_when_nothing_changed(renderer, random_gaussians):
    renderer.render(FrameRequest(random_gaussians(100), CAMERA, FLOAT32))
    before = renderer.stats()
    renderer.draw(FrameRequest(None, replace(CAMERA, name="the same by another name"), FLOAT32))
    renderer.read()
    assert not renderer.busy
    assert renderer.stats() == before
    assert (before.projected, before.sorted, before.drawn) == (1, 1, 1)


def test_only_what_changed_is_done_again(renderer, random_gaussians):
    gaussians = random_gaussians(100)

    def work(camera, settings):
        before = renderer.stats()
        renderer.render(FrameRequest(gaussians, camera, settings))
        after = renderer.stats()
        return tuple(
            getattr(after, name) - getattr(before, name) for name in ("projected", "sorted", "drawn")
        )

    assert work(CAMERA, FLOAT32) == (1, 1, 1)
    assert work(CAMERA, replace(FLOAT32, background=(1, 1, 1))) == (0, 0, 1)
    assert work(CAMERA.resized(50, 40), FLOAT32) == (1, 0, 1)
    moved = look_at((1, 1, 3), (0, 0, 0), width=50, height=40)
    assert work(moved, FLOAT32) == (1, 1, 1)


def test_drawing_never_waits_for_the_order(renderer, random_gaussians, gate):
    """Before the first order the background, then the order of a moment ago, at rest the exact one."""
    gaussians = random_gaussians(500)
    settings = replace(FLOAT32, background=(0.1, 0.2, 0.3))
    renderer.load(gaussians)
    renderer.draw(FrameRequest(None, CAMERA, settings))
    assert renderer.busy
    shown = np.frombuffer(renderer.framebuffer.read(components=4, dtype="f4"), np.float32).reshape(-1, 4)
    assert np.allclose(shown, [0.1, 0.2, 0.3, 0])

    gate.set()
    assert_true(renderer.read(), gaussians, CAMERA, settings)
    assert not renderer.busy

    gate.clear()
    turned = look_at((-0.4, 0.3, 2.2), (0, 0, 0), width=97, height=61)
    renderer.draw(FrameRequest(None, turned, settings))
    assert renderer.busy
    stale = np.frombuffer(renderer.framebuffer.read(components=4, dtype="f4"), np.float32)
    truth = reference.render(gaussians, turned, settings)
    stale = stale.reshape(truth.shape)
    assert np.allclose(stale[..., 3], truth[..., 3], atol=1e-3), "what covers a pixel knows no order"
    assert not np.allclose(stale, truth, atol=0.05), "from behind, the old order is the wrong way round"

    gate.set()
    while renderer.busy:
        renderer.draw(FrameRequest(None, turned, settings))
    drawn = renderer.stats().drawn
    assert_true(renderer.read(), gaussians, turned, settings)
    assert renderer.stats().drawn == drawn, "once it is not busy the picture is final"


def test_an_error_in_the_sort_thread_reaches_the_caller(renderer, random_gaussians, monkeypatch):
    def fail(*arguments):
        raise MemoryError("not enough")

    monkeypatch.setattr(sort_worker, "depth_order", fail)
    with pytest.raises(RuntimeError, match="sorting in the background failed"):
        renderer.render(FrameRequest(random_gaussians(10), CAMERA, FLOAT32))


def test_results_before_a_draw_are_refused(renderer, random_gaussians):
    with pytest.raises(RuntimeError, match=r"load\(\) comes before draw\(\)"):
        renderer.draw(FrameRequest(None, CAMERA, FLOAT32))
    renderer.load(random_gaussians(10))
    for result in (renderer.read, lambda: renderer.texture, lambda: renderer.framebuffer):
        with pytest.raises(RuntimeError, match=r"draw\(\) comes first"):
            result()


def test_loading_in_steps_keeps_the_old_scene_until_the_end(renderer, random_gaussians):
    old, new = random_gaussians(50, seed=1), random_gaussians(70_000, sh_degree=0, seed=2)
    picture = renderer.render(FrameRequest(old, CAMERA, FLOAT32))
    steps = renderer.load_steps(new)
    assert 0 < next(steps) < 1
    renderer.draw(FrameRequest(None, CAMERA, FLOAT32))
    assert np.array_equal(renderer.read(), picture)
    steps.close()
    assert renderer.stats().splats == 50

    shares = list(renderer.load_steps(new))
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert renderer.stats().splats == 70_000


def test_too_many_splats_are_refused_in_one_line(renderer, random_gaussians, monkeypatch):
    monkeypatch.setattr(texel_array, "TEXTURE_WIDTH", 1)
    with pytest.raises(InputError, match=r"splats do not fit into this OpenGL driver's textures") as caught:
        renderer.load(random_gaussians(70_000, sh_degree=0))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", ["3.3", "4.1"])
def test_all_of_this_on_old_opengl(version):
    """Mesa can pass for an older driver: it then refuses newer GLSL, compute shaders and storage buffers."""
    if "SPLATVIEW_TEST_GL" in os.environ:
        pytest.skip("this is the run under another version")
    code = version.replace(".", "") + "0"
    env = os.environ | {
        "MESA_GL_VERSION_OVERRIDE": version,
        "MESA_GLSL_VERSION_OVERRIDE": "330" if version == "3.3" else "410",
        "SPLATVIEW_TEST_GL": code,
    }
    probe = "from splatview.renderers.gl.context import *; print(create_headless_context().version_code)"
    answer = subprocess.run(
        [sys.executable, "-c", probe], env=env, capture_output=True, text=True, check=True
    )
    if answer.stdout.strip() != code:
        pytest.skip(f"this driver does not obey Mesa's version override: {answer.stdout.strip()}")
    files = [__file__, str(Path(__file__).with_name("test_edits_drawn.py"))]
    # Trained scenes tell of splats, not of drivers.
    options = ["-x", "-q", "-p", "no:cacheprovider", "-k", "not trained_scenes"]
    command = [sys.executable, "-m", "pytest", *options, *files]
    root = Path(__file__).parents[3]
    done = subprocess.run(command, env=env, capture_output=True, text=True, cwd=root, check=False)
    assert done.returncode == 0, done.stdout[-6000:]
