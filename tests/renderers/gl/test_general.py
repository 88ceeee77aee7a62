"""General programs against the specialised ones for which they stand in: the same pictures."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl.programs import Variant, Variants, switches
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest, Highlight
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.edits import HIDDEN, IDENTITY, PALETTE_SHIFT, SELECTED, Adjustment, Crop, SceneEdits
from splatview.scene.lens import Lens

pytestmark = pytest.mark.usefixtures("ctx")

Made = tuple[str, Any, Variants]

COUNT = 300
CAMERA = look_at((0.4, -0.6, -2.4), (0, 0, 0), width=48, height=40)
ROUNDING = 2e-6
"""Compilers may contract other sums where more is known: llvmpipe gives the same bits nearly always."""

SETTINGS: dict[str, dict[str, Any]] = {
    "degree 0": {"sh_degree": 0},
    "degree 1": {"sh_degree": 1},
    "degree 2": {"sh_degree": 2},
    "antialiased": {"antialiased": True},
    "discs": {"footprint": "disc"},
    "cut at 2 sigma": {"sigma_cut": 2.0},
    "background": {"background": (0.2, 0.5, 0.9)},
    "points": {"mode": "points"},
    "ellipsoids": {"mode": "ellipsoids"},
    "depth": {"mode": "depth"},
    "overdraw": {"mode": "overdraw"},
    "normals": {"mode": "normals"},
    "16-bit order": {"order": "16-bit"},
    "weighted": {"order": "weighted"},
    "stochastic": {"order": "stochastic"},
}
EDITS = ("hidden", "adjusted", "cropped", "selected")
EVERYTHING = (*SETTINGS, *EDITS)

CAMERAS = {
    "lens": replace(CAMERA, lens=Lens(model="OPENCV", parameters=(0.1, -0.05, 0.01, -0.02))),
    "parallel rays": replace(CAMERA, fx=15.0, fy=15.0, orthographic=True),
}

KNOWN_AT_LOADING = {"OWN_DEGREES", "REST", "TEXTURED", "WIDE"}
"""Flags that a general program has fixed: how a scene is stored, and that a pass is another stage."""


@pytest.fixture(scope="module", params=["quads", "legacy", "tiles"])
def made(session_context: moderngl.Context, request: pytest.FixtureRequest) -> Iterator[Made]:
    ctx = session_context
    if request.param != "legacy" and ctx.version_code < 430:
        pytest.skip("needs OpenGL 4.3")
    variants = Variants(ctx)
    renderer: Any
    if request.param == "legacy":
        renderer = QuadsGL33Renderer(ctx, variants)
    else:
        renderer = {"quads": QuadsRenderer, "tiles": TilesRenderer}[request.param](ctx, variants=variants)
    yield request.param, renderer, variants
    renderer.close()


def edits_of(effects: tuple[str, ...]) -> SceneEdits:
    marks = np.zeros(COUNT, np.uint32)
    palette, crops = (IDENTITY,), ()
    if "hidden" in effects:
        marks[::5] |= HIDDEN
    if "selected" in effects:
        marks[::3] |= SELECTED
    if "adjusted" in effects:
        grade = ((0.5, 0.2, 0.0, 0.1), (0.0, 0.9, 0.1, -0.05), (0.3, 0.0, 0.4, 0.2))
        turned = Adjustment(rotation=(0.8, 0.36, -0.48, 0.0), scale=1.3, translation=(0.2, 0.0, 0.1))
        palette = (IDENTITY, turned, Adjustment(size=0.6, opacity=(1.5, -0.1, 0.05, 0.9), colour=grade))
        marks |= (np.arange(COUNT) % 3).astype(np.uint32) << PALETTE_SHIFT
    if "cropped" in effects:
        crops = (
            Crop(shape="sphere", half_extents=(0.9, 0.7, 0.8)),
            Crop(centre=(0.5, 0.0, 0.0), half_extents=(0.3, 0.2, 0.3), keep="outside"),
        )
    return SceneEdits(marks=marks, palette=palette, crops=crops, flags=HIDDEN | SELECTED)


def pictures(made: Made, scene: Gaussians, effects: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """By specialised and by general programs."""
    _, renderer, variants = made
    chosen: dict[str, Any] = {}
    for effect in effects:
        chosen |= SETTINGS.get(effect, {})
    mode, antialiased = chosen.pop("mode", "splats"), chosen.pop("antialiased", False)
    footprint = chosen.pop("footprint", "ellipsoid")
    settings = RenderSettings(blend="float32", **chosen)
    model = replace(settings.model, antialiased=antialiased).with_footprint(footprint)
    settings = replace(settings, model=model)
    shown: dict[str, Any] = {"mode": mode, "edits": edits_of(effects)}
    shown["highlight"] = Highlight() if "selected" in effects else None
    camera = next((CAMERAS[effect] for effect in effects if effect in CAMERAS), CAMERA)
    renderer.load(scene)
    special = renderer.render(FrameRequest(scene, camera, settings, **shown))
    renderer.load(scene)
    with variants.generally():
        return special, renderer.render(FrameRequest(scene, camera, settings, **shown))


def compare(made: Made, scene: Gaussians, effects: tuple[str, ...]) -> None:
    special, general = pictures(made, scene, effects)
    assert special.std() > 0.01
    unequal = np.abs(special - general) > ROUNDING
    # Where a sum is rounded otherwise, an alpha may fall to the other side of the cut.
    assert unequal.mean() < 1e-3, f"{effects}: up to {np.abs(special - general).max():.1e}"


def can(name: str, effects: tuple[str, ...]) -> bool:
    if any("order" in SETTINGS.get(effect, {}) for effect in effects):
        unsorted = {"weighted", "stochastic"} & set(effects)
        return name == "quads" or (name == "tiles" and not unsorted)
    return True


@pytest.mark.parametrize("effect", [None, *EVERYTHING, *CAMERAS])
def test_one_effect_by_the_general_programs(made, random_gaussians, effect):
    effects = (effect,) if effect else ()
    if not can(made[0], effects):
        pytest.skip(f"{made[0]} do not have this")
    compare(made, random_gaussians(COUNT, seed=8), effects)


def combinations(generator: random.Random, count: int) -> list[tuple[str, ...]]:
    """One setting of each kind at most, any of the others."""
    degrees, modes = EVERYTHING[:3], EVERYTHING[6:10]
    orders, free = EVERYTHING[10:13], (*EVERYTHING[3:6], *EDITS)
    everything = list(
        itertools.product(
            (None, *degrees), (None, *modes), (None, *orders), *((None, effect) for effect in free)
        )
    )
    chosen = generator.sample(everything, count)
    return [tuple(effect for effect in effects if effect) for effects in chosen]


@pytest.mark.parametrize("effects", combinations(random.Random(3), 6), ids=", ".join)
def test_effects_together_by_the_general_programs(made, random_gaussians, effects):
    effects = tuple(effect for effect in effects if can(made[0], (effect,)))
    compare(made, random_gaussians(COUNT, seed=9), effects)


@pytest.mark.slow
def test_many_combinations_by_the_general_programs(made, random_gaussians):
    scene = random_gaussians(COUNT, seed=10)
    for effects in combinations(random.Random(4), 300):
        compare(made, scene, tuple(effect for effect in effects if can(made[0], (effect,))))


def test_the_general_program_is_one_for_all_effects(made, random_gaussians):
    name, _, variants = made
    for effects in combinations(random.Random(3), 6):
        pictures(made, random_gaussians(COUNT), tuple(e for e in effects if can(name, (e,))))
    stages: dict[tuple[str, ...], set[Variant]] = {}
    for variant in variants.made:
        if variant.general and not any("tiles/blend" in file for file in variant.files):
            stages.setdefault(variant.files, set()).add(variant)
    assert stages
    assert all(len(found) == 1 for found in stages.values()), stages
    fixed = {flag for one in variants.made for flag, value in one.flags if isinstance(value, bool)}
    assert fixed - switches().keys() <= KNOWN_AT_LOADING, "a new flag: name it in common/switches.glsl"
