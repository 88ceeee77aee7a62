"""Quads on OpenGL 3.3: textures, the sort thread, and all of it under OpenGL 3.3 and 4.1 in the last test."""

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
from splatview.raster import Workspace
from splatview.renderers.gl import scene_textures, sort_thread
from splatview.renderers.gl.context import describe
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.scene_textures import TEXTURE_WIDTH
from splatview.renderers.gl.sort_thread import ViewLine
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, InputError, RenderSettings, look_at, reference
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, Crop, SceneEdits, bake

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
    sort = sort_thread.depth_order

    def gated(means, view, workspace):
        gate.wait(20)
        return sort(means, view, workspace)

    monkeypatch.setattr(sort_thread, "depth_order", gated)
    yield gate
    gate.set()


def assert_true(image: np.ndarray, gaussians: Gaussians, camera, settings: RenderSettings) -> None:
    truth = reference.render(gaussians, camera, settings)
    exact = settings.blend == "float32"
    assert image.shape == truth.shape
    assert image.dtype == np.float32
    assert psnr(image, truth) >= (60 if exact else 50)
    assert largest_error(image, truth) <= (2e-3 if exact else 4 / 255)


@pytest.mark.parametrize("count", [1, TEXTURE_WIDTH - 1, TEXTURE_WIDTH, TEXTURE_WIDTH + 1, 5000])
def test_whole_and_partial_rows_of_texels(renderer, random_gaussians, count):
    gaussians = random_gaussians(count, sh_degree=1)
    camera = look_at((0, 0, -3), (0, 0, 0), width=48, height=32)
    assert_true(renderer.render(FrameRequest(gaussians, camera, FLOAT32)), gaussians, camera, FLOAT32)


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


def test_a_change_of_colours_needs_no_new_order(renderer, random_gaussians):
    scene = random_gaussians(100)
    marks = np.full(100, 1 << PALETTE_SHIFT, np.uint32)
    crop = Crop(half_extents=(0.8, 0.5, 0.9))
    grades = [Adjustment(opacity=(gain, 0.0, 0.0, 1.0)) for gain in (0.5, 0.7)]
    turned = Adjustment(rotation=(0.0, 1.0, 0.0, 0.0))
    for change, work in zip((*grades, turned), ((1, 1), (2, 1), (3, 2)), strict=True):
        edits = SceneEdits(marks=marks, palette=(IDENTITY, change), crops=(crop,))
        image = renderer.render(FrameRequest(scene, CAMERA, FLOAT32, edits=edits))
        assert_true(image, bake(scene, edits), CAMERA, FLOAT32)
        assert (renderer.stats().projected, renderer.stats().sorted) == work


def test_the_threads_order_is_that_of_the_baked_scene(random_gaussians):
    scene = random_gaussians(5000)
    turned = (0.8, 0.36, -0.48, 0.0)
    palette = (
        IDENTITY,
        Adjustment(rotation=turned, scale=1.3, translation=(0.2, 0.0, 0.1)),
        Adjustment(size=0.6, opacity=(1.5, -0.1, 0.05, 0.9)),
        Adjustment(rotation=turned, scale=0.7, size=1.4),
    )
    marks = np.random.default_rng(0).integers(0, 4, 5000).astype(np.uint32) << PALETTE_SHIFT
    edits = SceneEdits(marks=marks, palette=palette)
    line, plain = ViewLine.of(CAMERA, edits, places="moved"), ViewLine.of(CAMERA)
    baked = sort_thread.depth_order(bake(scene, edits).means.astype(np.float64), plain, Workspace())
    found = sort_thread.depth_order(scene.means, line, Workspace())
    depths = (bake(scene, edits).means - CAMERA.eye) @ CAMERA.forward
    # Bake rounds means to float32: splats may only have changed places with their like.
    np.testing.assert_allclose(depths[found.order], depths[baked.order], atol=1e-6)
    assert abs(found.before_eye - baked.before_eye) <= 1
    assert line != plain
    # Marks that are newer than the palette do no harm.
    edits.marks[0] = 99 << PALETTE_SHIFT
    assert sorted(sort_thread.depth_order(scene.means, line, Workspace()).order) == list(range(5000))


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

    monkeypatch.setattr(sort_thread, "depth_order", fail)
    with pytest.raises(RuntimeError, match="sorting in the background failed"):
        renderer.render(FrameRequest(random_gaussians(10), CAMERA, FLOAT32))


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
    monkeypatch.setattr(scene_textures, "TEXTURE_WIDTH", 1)
    with pytest.raises(InputError, match=r"splats do not fit into this OpenGL driver's textures") as caught:
        renderer.load(random_gaussians(70_000, sh_degree=0))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", ["3.3", pytest.param("4.1", marks=pytest.mark.slow)])
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
    here = Path(__file__)
    files = [here, here.with_name("test_gl_state.py"), here.parents[1] / "test_conformance.py"]
    # Trained scenes tell of splats, not of drivers.
    options = ["-x", "-q", "-p", "no:cacheprovider", "-k", "gl33 and not trained and not half_a_million"]
    command = [sys.executable, "-m", "pytest", *options, *map(str, files)]
    root = Path(__file__).parents[3]
    done = subprocess.run(command, env=env, capture_output=True, text=True, cwd=root, check=False)
    assert done.returncode == 0, done.stdout[-6000:]
