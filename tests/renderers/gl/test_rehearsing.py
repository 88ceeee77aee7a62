"""Compiling in the background: who is told what, what is drawn meanwhile, and that it is the same picture."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatview import raster
from splatview.raster.frame import specialisation_key
from splatview.renderers import make_renderer
from splatview.renderers.async_renderer import KernelPrecompiler
from splatview.renderers.cpu import CpuRenderer
from splatview.renderers.edit_snapshot import edit_snapshot
from splatview.renderers.gl.programs import Variants
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.shader_fallback import FallbackShaders, title_of
from splatview.renderers.precompile import MOST_REMEMBERED, ShaderPrecompiler, precompile_job
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import RenderSettings, look_at
from splatview.scene.edits import HIDDEN, IDENTITY, PALETTE_SHIFT, SELECTED, Adjustment, Crop, SceneEdits
from splatview.viewer.picture import Picture

COUNT = 200
CAMERA = look_at((0.4, -0.6, -2.4), (0, 0, 0), width=48, height=40)
SETTINGS = RenderSettings(blend="float32")
PATIENCE = 200.0
"""Seconds until a test that hangs is given up; no measure of anything."""
NOTHING: Any = SimpleNamespace(backend="quads")


def some_edits() -> SceneEdits:
    marks = np.zeros(COUNT, np.uint32)
    marks[::5] |= HIDDEN
    marks[::3] |= SELECTED
    marks[50:120] |= 1 << PALETTE_SHIFT
    grade = ((0.5, 0.2, 0.0, 0.1), (0.0, 0.9, 0.1, -0.05), (0.3, 0.0, 0.4, 0.2))
    turned = Adjustment(rotation=(0.8, 0.36, -0.48, 0.0), scale=1.3, colour=grade)
    crops = (Crop(shape="sphere", half_extents=(0.9, 0.7, 0.8)),)
    return SceneEdits(marks=marks, palette=(IDENTITY, turned), crops=crops, flags=HIDDEN | SELECTED)


class Stage:
    """ShaderPrecompiler that go on for as long as the test likes."""

    def __init__(self, **options) -> None:
        self.performed: list = []
        self._curtain = threading.Event()
        self.precompiler = ShaderPrecompiler(perform=self._perform, **options)

    def _perform(self, job) -> None:
        assert self._curtain.wait(PATIENCE)
        self.performed.append(job)

    def finish(self, *keys: str) -> None:
        self._curtain.set()
        if keys:
            assert self.precompiler.wait(keys)


def test_each_key_is_compiled_once_and_remembered_by_the_next_session(tmp_path):
    memory = tmp_path / "cache" / "compiled.txt"
    changes: list[str] = []
    stage = Stage(memory=memory, on_change=lambda: changes.append(stage.precompiler.title))
    asked: list[list[str]] = []
    for keys in (["a"], ["a", "b"], ["b"]):
        stage.precompiler.ask(keys, f"crops {keys}", lambda keys=keys: asked.append(keys) or NOTHING)
    assert asked == [["a"], ["a", "b"]]
    assert not stage.precompiler.is_done(["a"])
    stage.finish("a", "b")
    assert stage.precompiler.is_done(["a", "b"])
    stage.precompiler.release()
    assert "crops ['a']" in changes
    later = ShaderPrecompiler(memory=memory)
    assert later.is_done(["b", "a"])
    assert not later.is_done(["c"])


def test_a_memory_that_cannot_be_used_is_done_without(tmp_path):
    memory = tmp_path / "compiled.txt"
    memory.write_bytes(b"\xff\xfe\n")
    assert not ShaderPrecompiler(memory=memory).is_done(["a"])
    memory.write_text("a\n" * (MOST_REMEMBERED + 1))
    assert not ShaderPrecompiler(memory=memory).is_done(["a"])
    assert not memory.exists()
    assert not ShaderPrecompiler(memory=tmp_path).is_done(["a"])


def test_programs_do_not_wait_for_kernels():
    at_work, curtain = threading.Event(), threading.Event()

    def perform(job) -> None:
        if job.backend == "cpu":
            at_work.set()
            assert curtain.wait(PATIENCE)

    precompiler = ShaderPrecompiler(perform=perform)
    precompiler.ask(["kernel"], "edits", lambda: SimpleNamespace(backend="cpu"))  # pyright: ignore
    precompiler.ask(["program"], "points", lambda: NOTHING)
    assert precompiler.wait(["program"])
    assert not precompiler.is_done(["kernel"])
    assert at_work.wait(PATIENCE)
    assert precompiler.title == "edits"
    curtain.set()
    assert precompiler.wait(["kernel"])
    precompiler.release()


def test_what_fails_is_told_once_and_not_waited_for():
    def fail(job) -> None:
        raise RuntimeError("no second OpenGL context")

    precompiler = ShaderPrecompiler(perform=fail)
    precompiler.ask(["a"], "crops", lambda: NOTHING)
    assert precompiler.wait(["a"])
    assert precompiler.take_problem() == (
        "crops cannot be compiled in the background: no second OpenGL context"
    )
    assert precompiler.take_problem() is None
    assert precompiler.is_done(["a"])


def test_an_end_wakes_who_waits():
    stage = Stage()
    stage.precompiler.ask(["a"], "crops", lambda: NOTHING)
    told: list[bool] = []
    waiting = threading.Thread(target=lambda: told.append(stage.precompiler.wait(["a"])))
    waiting.start()
    stage.precompiler.release()
    waiting.join(PATIENCE)
    assert told == [False]
    assert stage.precompiler.is_done(["never asked for"])
    stage.finish()


def test_a_process_draws_and_says_why_it_cannot(random_gaussians):
    precompiler = ShaderPrecompiler()
    job = precompile_job("quads", FrameRequest(random_gaussians(9), CAMERA, SETTINGS))
    precompiler.ask(
        ["wrong"], "nothing", lambda: replace(job, backend="cpu", request=replace(job.request, camera=None))
    )  # pyright: ignore
    assert precompiler.wait(["wrong"])
    assert "AttributeError" in (precompiler.take_problem() or "")
    precompiler.ask(["right"], "quads", lambda: job)
    assert precompiler.wait(["right"])
    assert precompiler.take_problem() is None
    precompiler.release()


@pytest.mark.parametrize("name", ["quads", "tiles", "legacy"])
def test_general_programs_stand_in_until_the_others_are_compiled(ctx, random_gaussians, name):
    if name != "legacy" and ctx.version_code < 430:
        pytest.skip("needs OpenGL 4.3")
    stage = Stage()
    variants = FallbackShaders(ctx, stage.precompiler)
    renderer = make_renderer(name, ctx, variants) if name != "legacy" else QuadsGL33Renderer(ctx, variants)
    variants.prepare(renderer)
    assert all(variant.general for variant in variants.made if "project" in variant.files[-1])
    scene, edits, highlight = random_gaussians(COUNT, seed=4), some_edits(), Highlight()
    meanwhile = renderer.render(FrameRequest(scene, CAMERA, SETTINGS, edits=edits, highlight=highlight))
    variants.after_drawing(name, FrameRequest(scene, CAMERA, SETTINGS, edits=edits, highlight=highlight))
    assert all(variant.general for variant in variants.made if "project" in variant.files[-1])
    turned = replace(CAMERA, fx=CAMERA.fx + 1)
    renderer.render(FrameRequest(scene, turned, SETTINGS, edits=edits, highlight=highlight))
    asked = [variants._key(variant) for variant in variants.take_waiting()]
    assert asked
    stage.finish(*asked)
    renderer.render(FrameRequest(scene, turned, RenderSettings(), edits=edits, highlight=highlight))
    assert not variants.take_waiting()
    specialised = renderer.render(FrameRequest(scene, CAMERA, SETTINGS, edits=edits, highlight=highlight))
    assert any(not variant.general for variant in variants.made if "project" in variant.files[-1])
    np.testing.assert_allclose(specialised, meanwhile, atol=2e-6)
    (job,) = stage.performed
    assert job.variants
    assert "hidden splats" in title_of(job.variants)
    stage.precompiler.release()
    renderer.close()


@pytest.mark.parametrize("mode", ["splats", "points", "ellipsoids", "depth"])
@pytest.mark.parametrize("edited", [False, True])
def test_a_rehearsal_needs_the_programs_of_the_picture_it_stands_for(ctx, random_gaussians, mode, edited):
    scene = random_gaussians(COUNT, sh_degree=2)
    settings = replace(SETTINGS, model=replace(SETTINGS.model, antialiased=True))
    shown = {"edits": some_edits(), "highlight": Highlight()} if edited else {}
    made = []
    job = precompile_job("quads", FrameRequest(scene, CAMERA, settings, mode=mode, **shown))
    small = {"edits": job.request.edits, "highlight": job.request.highlight}
    for gaussians, camera, options in (
        (scene, CAMERA, shown),
        (job.request.gaussians, job.request.camera, small),
    ):
        variants = Variants(ctx)
        renderer = make_renderer("quads", ctx, variants)
        image = renderer.render(FrameRequest(gaussians, camera, settings, mode=mode, **options))
        made.append(variants.made)
        renderer.close()
    assert image.std() > 0.01, "nothing was drawn"
    assert made[0] == made[1]


def test_the_baked_scene_is_drawn_until_kernels_with_edits_are_there(random_gaussians):
    scene, stage = random_gaussians(COUNT, seed=6), Stage()
    kernels = KernelPrecompiler(CpuRenderer(), stage.precompiler)
    plain = FrameRequest(scene, CAMERA, SETTINGS)
    shown = edit_snapshot(some_edits(), Highlight(), None)
    assert shown is not None
    edited = replace(plain, edits=shown.kept, highlight=shown.highlight)
    raster.render(scene, CAMERA, SETTINGS)  # compiled, or in the cache
    assert kernels.must_wait(plain) is None
    assert kernels.must_wait(edited) is None
    baked = kernels.what_to_draw(edited)
    assert baked.edits is None
    assert baked.gaussians is not None
    assert kernels.what_to_draw(edited).gaussians is baked.gaussians, "baked once"
    meanwhile = raster.render(baked.gaussians, CAMERA, SETTINGS)
    stage.finish(specialisation_key(scene, CAMERA, SETTINGS, edited=True))
    assert kernels.what_to_draw(edited) is edited
    np.testing.assert_allclose(CpuRenderer().render(edited), meanwhile, atol=1e-4)
    (job,) = stage.performed
    assert job.backend == "cpu"
    assert job.request.edits.in_force
    stage.precompiler.release()


def test_a_picture_that_needs_other_kernels_waits_for_them(random_gaussians):
    scene, stage = random_gaussians(COUNT), Stage()
    kernels = KernelPrecompiler(CpuRenderer(), stage.precompiler)
    discs = FrameRequest(scene, CAMERA, replace(SETTINGS, model=replace(SETTINGS.model, footprint="disc")))
    raster.render(scene, CAMERA, SETTINGS)
    kind = kernels.must_wait(discs)
    assert kind is not None
    assert kind == specialisation_key(scene, CAMERA, discs.settings)
    assert kind != specialisation_key(scene, CAMERA, SETTINGS)
    stage.finish()
    assert kernels.wait(kind)
    assert kernels.must_wait(discs) is None
    edited = replace(discs, edits=some_edits())
    assert kernels.must_wait(edited) is None
    assert kernels.what_to_draw(edited).edits is None, "baked, for kernels that are there"
    stage.precompiler.release()


def test_splats_with_degrees_of_their_own_wait_for_their_kernels(random_gaussians):
    scene, stage = random_gaussians(COUNT), Stage()
    scene.sh[: COUNT // 2, 1:] = 0
    kernels = KernelPrecompiler(CpuRenderer(), stage.precompiler)
    request = FrameRequest(scene, CAMERA, SETTINGS)
    raster.render(random_gaussians(COUNT), CAMERA, SETTINGS)
    kind = kernels.must_wait(request)
    assert kind is not None
    stage.finish(kind)
    (job,) = stage.performed
    same = specialisation_key(job.request.gaussians, job.request.camera, job.request.settings)
    assert same == kind, "few splats stand for the scene"
    stage.precompiler.release()


def test_a_mode_is_shown_once_its_kernels_are_compiled(ctx, random_gaussians):
    scene, stage, ready = random_gaussians(COUNT, seed=5), Stage(), threading.Event()
    raster.render(scene, CAMERA, SETTINGS)
    picture = Picture(ctx, "cpu", on_ready=ready.set, precompiler=stage.precompiler)
    for _ in picture.load_steps(scene):
        pass
    points = FrameRequest(None, CAMERA, SETTINGS, mode="points")
    picture.draw(points)
    picture.wait(0.2)
    assert picture.busy
    assert picture.status == "Compiling for this machine: points"
    stage.finish(f"{specialisation_key(scene, CAMERA, SETTINGS)} points")
    until = time.monotonic() + PATIENCE
    while picture.busy and time.monotonic() < until:
        picture.draw(points)
        time.sleep(0.02)
    assert not picture.busy
    shown = np.frombuffer(picture.texture.read(), np.float32).reshape(CAMERA.height, CAMERA.width, 4)
    assert np.array_equal(shown, picture.read(points)) and shown.std() > 0.01
    stage.precompiler.release()
    picture.close()
