"""What the ladder says of a shortcut is what one finds oneself with `splatview render`, rung for rung."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from splatview.cli import ladder, render
from splatview.cli.ladder import draw_truths
from splatview.cli.main import main
from splatview.measure.knobs import KNOBS, Knob, Plan, apply_choices
from splatview.measure.ladder import draw_by_path, run_ladder, rungs_for
from splatview.measure.metrics import psnr
from splatview.renderers import FrameRequest, Renderer
from splatview.renderers.gl.context import create_headless_context
from splatview.renderers.headless import HeadlessScene, make_headless
from splatview.renderers.quality import reduced
from splatview.scene import Camera, Gaussians, InputError, look_at
from splatview.scene.camera import orbited
from splatview.scene.formats import save_scene

EXACT_DB = 60.0
EYE, TARGET, SIZE = (-0.5, -1.0, -3.0), (0.0, 0.1, 0.0), (64, 48)
VIEW = ["--eye", "-0.5,-1,-3", "--target", "0,0.1,0", "--size", "64x48"]
CAMERA = look_at(EYE, TARGET, up=(0, -1, 0), width=SIZE[0], height=SIZE[1])


def renderers() -> list[str]:
    try:
        create_headless_context(require=430).release()
    except InputError:
        return ["cpu"]
    return ["cpu", "quads", "tiles"]


@pytest.fixture(scope="module")
def scene(random_gaussians) -> Gaussians:
    """Large opaque splats in front of many others, so that every shortcut leaves out something."""
    made = random_gaussians(400, seed=4)
    return replace(made, log_scales=made.log_scales + 0.7, opacity_logits=made.opacity_logits + 3)


@pytest.fixture(scope="module")
def truth(scene) -> np.ndarray:
    truths, apart = draw_truths(scene, [CAMERA], Plan().settings)
    assert apart < 1e-9
    return truths[0]


@pytest.fixture(scope="module")
def scenes(scene) -> dict[str, HeadlessScene]:
    return {name: HeadlessScene(make_headless(name), scene, turned) for name in renderers()}


def turned(camera: Camera, degrees: float) -> Camera:
    return orbited(camera, np.array(TARGET), np.array((0.0, -1.0, 0.0)), degrees)


def drawn(scene: HeadlessScene, choices: dict[str, str], camera: Camera = CAMERA) -> np.ndarray:
    plan = apply_choices(Plan(), choices, scene.name)
    scene.prepare(plan)
    return draw_by_path(scene, camera, plan)[0]


def shared_renderers():
    made: dict[str, Renderer] = {}

    def make(name: str, **_: object) -> Renderer:
        if name not in made:
            made[name] = make_headless(name)
        return made[name]

    return make


def owned(knobs: tuple[Knob, ...] = KNOBS) -> list[tuple[str, Knob]]:
    return [(name, knob) for name in ("cpu", "quads", "tiles") for knob in knobs if name in knob.renderers]


def test_every_rung_is_what_render_draws(scene, tmp_path: Path, capsys, monkeypatch):
    # Each command compiles its shaders; here they share them, as it were in one process.
    for command in (render, ladder):
        monkeypatch.setattr(command, "make_headless", shared_renderers())
    save_scene(scene, tmp_path / "scene.ply")
    names = renderers()

    def run(*argv: object) -> str:
        assert main([str(argument) for argument in argv]) == 0
        return capsys.readouterr().out

    def rendered(*options: str) -> np.ndarray:
        out = tmp_path / "x.npy"
        run("render", tmp_path / "scene.ply", "-o", out, *VIEW, *options)
        return np.load(out)

    text = run(
        *("ladder", tmp_path / "scene.ply", *VIEW, "--json", "--rounds", 1),
        *("--renderers", ",".join(names)),
    )
    assert json.loads(text)["views"] == 1, "a view that is given is the only one"
    rungs = json.loads(text)["rungs"]
    scenes = [HeadlessScene(make_headless(name), scene) for name in names]
    expected = {(r.renderer.name, r.knob, r.value) for r in rungs_for(scenes, Plan(), used_sh_degree=3)}
    assert {(r["renderer"], r["knob"], r["value"]) for r in rungs} == expected
    reference = rendered("--renderer", "reference")
    for rung in rungs:
        here = psnr(rendered(*rung["options"]), reference)
        stated = rung["psnr"]
        # Above 100 dB float32 itself, in which pictures are written, begins to count.
        close = (here > 100 and stated > 100) or stated == pytest.approx(here, abs=0.1)
        assert close, (rung["renderer"], rung["knob"], rung["value"], stated, here)


def test_several_views_are_reproduced_by_the_cameras_in_the_json(scene, tmp_path: Path, capsys):
    save_scene(scene, tmp_path / "scene.ply")
    size = ("--size", "40x32")
    knobs = ("--renderers", "cpu", "--knobs", "keep,resort", "--rounds", "1", *size)
    assert main(["ladder", str(tmp_path / "scene.ply"), *knobs, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps(made["cameras"]))
    assert made["views"] == len(made["cameras"]) == 2

    def rendered(view: int, *options: str) -> np.ndarray:
        given = ["render", str(tmp_path / "scene.ply"), "-o", str(tmp_path / "x.npy"), *options]
        assert main([*given, "--camera", str(cameras), "--camera-index", str(view)]) == 0
        return np.load(tmp_path / "x.npy")

    references = [rendered(view, "--renderer", "reference") for view in (0, 1)]
    for rung in made["rungs"][1:]:
        here = [psnr(rendered(view, *rung["options"]), references[view]) for view in (0, 1)]
        assert abs(here[0] - here[1]) > 0.2 and rung["psnr"] == pytest.approx(np.mean(here), abs=0.02), rung
    given = ("--camera", str(cameras), "--camera-index", "1")
    assert main(["ladder", str(tmp_path / "scene.ply"), *knobs, *given, "--json"]) == 0
    one = json.loads(capsys.readouterr().out)
    assert one["cameras"] == [made["cameras"][1]], "a camera that is given is the only view"
    for rung in one["rungs"][1:]:
        assert rung["psnr"] == pytest.approx(psnr(rendered(1, *rung["options"]), references[1]), abs=0.02)


@pytest.mark.parametrize(("name", "knob"), owned(), ids=lambda x: getattr(x, "name", x))
def test_the_exact_end_of_every_knob_is_exact_and_the_others_are_not(scenes, truth, name, knob):
    if name not in scenes:
        pytest.skip("no OpenGL 4.3")
    best, *coarser = (
        psnr(drawn(scenes[name], {knob.name: value.text}), truth) for value in knob.values_for(name)
    )
    assert best >= EXACT_DB
    # Above so much, roundings decide.
    decibels = [min(each, 90) for each in (best, *coarser)]
    if knob.monotone:
        assert all(b <= a + 0.01 for a, b in pairwise(decibels)), decibels
    if knob.name != "early-stop" or name == "cpu":  # else whole blocks stop, and this picture has too few
        assert min(coarser) < best


def fewer(scene: Gaussians, share: float) -> Gaussians:
    made = reduced(FrameRequest(scene, CAMERA, kept=share)).gaussians
    assert made is not None
    return made


@pytest.mark.parametrize("name", ["cpu", "quads"])
def test_splats_kept_are_the_same_whatever_is_drawn(scenes, scene, name):
    if name not in scenes:
        pytest.skip("no OpenGL 4.3")
    half, quarter = (fewer(scene, share) for share in (0.5, 0.25))
    assert (len(half), len(quarter)) == (200, 100)
    assert fewer(scene, 0.5) is half
    rows = {row.tobytes() for row in half.means}
    assert all(row.tobytes() in rows for row in quarter.means), "a smaller share is part of a larger one"
    direct = make_headless(name).render(FrameRequest(half, CAMERA))
    np.testing.assert_array_equal(drawn(scenes[name], {"keep": "50"}), direct)


@pytest.mark.parametrize("value", ["3-sigma", "2-sigma"])
def test_renderers_cut_alike(scenes, value):
    if len(scenes) == 1:
        pytest.skip("no OpenGL 4.3")
    pictures = {name: drawn(each, {"cut": value}) for name, each in scenes.items()}
    exact = drawn(scenes["cpu"], {})
    assert np.abs(pictures["cpu"] - exact).max() > 0.01
    for name in ("quads", "tiles"):
        apart = np.abs(pictures[name] - pictures["cpu"]).max(axis=2)
        assert np.mean(apart > 2e-3) < 3e-3, "but for pixels on the cut to the last digit"


@pytest.mark.parametrize("name", ["quads", "tiles"])
def test_fewer_bits_are_fewer_bytes_and_the_values_that_cpu_draws(scenes, scene, name):
    if name not in scenes:
        pytest.skip("no OpenGL 4.3")
    # One that has drawn nothing else: an order that was kept would count.
    scenes = {**scenes, name: HeadlessScene(make_headless(name), scene)}
    held = []
    for knob in (knob for knob in KNOBS if knob.name == "attributes"):
        for value in knob.values:
            picture = drawn(scenes[name], {knob.name: value.text, "sh-degree": "3"})
            held.append(scenes[name].memory())
            assert psnr(picture, drawn(scenes["cpu"], {knob.name: value.text})) > EXACT_DB
    assert held[0] - held[1] == len(scenes[name].gaussians) * (236 - 124), "float16, but for positions"
    assert held[1] - held[2] == len(scenes[name].gaussians) * (96 - 56), "a byte in place of two, and a step"


def test_a_scene_that_pops_does_so_in_the_global_order_only():
    turn = np.radians(35) / 2
    sheets = Gaussians(  # an opaque red and a green one that cross, their means equally far
        means=np.array([[-0.001, 0, 0], [0.001, 0, 0]], np.float32),
        quats=np.array([[np.cos(turn), 0, np.sin(turn), 0], [np.cos(turn), 0, -np.sin(turn), 0]], np.float32),
        log_scales=np.tile(np.float32(np.log([0.5, 0.5, 0.01])), (2, 1)),
        opacity_logits=np.array([4, 4], np.float32),
        sh=np.array([[[1.5, -1.5, -1.5]], [[-1.5, 1.5, -1.5]]], np.float32),
    )

    def beside(view: int, number: int) -> Camera:
        return look_at((1e-4 * number, 0, -2.5), (0, 0, 0), up=(0, -1, 0), width=40, height=33)

    camera = look_at((-1e-4, 0, -2.5), (0, 0, 0), up=(0, -1, 0), width=40, height=33)
    truths, _ = draw_truths(sheets, [camera], Plan().settings)
    rungs = rungs_for(
        [HeadlessScene(make_headless("cpu"), sheets)], Plan(), used_sh_degree=0, knobs=["order"]
    )
    made = run_ladder(rungs, [camera], truths, moved=beside, seconds=1, rounds=3)
    popping = {one.rung.value: one.popping for one in made.rungs}
    assert popping["cpu"] > 0.3
    assert popping["per-pixel"] < 0.01
