"""`splatview doctor`: what works on this machine, tried and not guessed, and what to install."""

from __future__ import annotations

import json
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from splatview.cli.arguments import Parser
from splatview.cli.main import no_window
from splatview.measure.machine import available_cores
from splatview.renderers import FrameRequest, automatic_choice
from splatview.renderers.headless import make_headless
from splatview.scene import Gaussians, InputError, RenderSettings, look_at, reference

LIBRARIES = (
    ("numpy", ""),
    ("moderngl", ""),
    ("glfw", ""),
    ("imgui-bundle", ""),
    ("numba", ""),
    ("plyfile", ""),
    ("pillow", ""),
    ("safetensors", ""),
    ("torch", "only for training: pip install 'splatview[train]'"),
    ("matplotlib", "for plots: pip install 'splatview[plot]'"),
    ("av", "for films as videos and GIFs: pip install 'splatview[film]'"),
)
"""Name, and what an optional one is for."""

BOUNDS = {"quads": 4 / 255, "tiles": 1 / 255, "cpu": 1e-4}
"""Largest error against the reference: of a float16 target, of float32 sums by a GPU, whose exp() may be
coarse, and of the same here."""


def run(arguments: list[str]) -> int:
    parser = Parser(
        "doctor",
        "Tries what this machine can do and says what to install. Exit code 0 if any\n"
        "renderer draws the right picture.",
    )
    parser.add_argument("--json", action="store_true", help="the same for scripts, on standard output")
    args = parser.parse(arguments)
    if args is None:
        return 0
    findings = examine()
    print(json.dumps(findings, indent=1) if args.json else as_text(findings))
    if not any(result["works"] for result in findings["renderers"].values()):
        raise InputError("no renderer works here; install what the lines above name")
    return 0


def examine() -> dict[str, Any]:
    """Everything that is found, ready for JSON."""
    auto, why = automatic_choice()
    return {
        "splatview": version("splatview"),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cores": available_cores(),
        "libraries": {name: installed(name) for name, _ in LIBRARIES},
        "display": no_window() or "a window can be opened",
        "gl": gl_context(),
        "renderers": {name: tried(name) for name in BOUNDS},
        "auto": {"renderer": auto, "why": why},
    }


def installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def gl_context() -> dict[str, Any]:
    """What OpenGL without a window offers."""
    from splatview.renderers.gl.context import (
        create_headless_context,
        describe,
        discard,
        missing_compute,
        unused_gpu,
    )
    from splatview.renderers.gl.resolve import float16_blending_truncates
    from splatview.renderers.precompile import probe_cache

    try:
        ctx = create_headless_context()
    except InputError as error:
        return {"works": False, "why": str(error)}
    info = describe(ctx)
    lacking = missing_compute(ctx)
    truncates = float16_blending_truncates(ctx)
    try:
        probe = probe_cache(ctx)
        ahead = {"works": probe.works, "why": probe.why}
    except Exception as error:  # as below
        ahead = {"works": False, "why": " ".join(str(error).split()) or type(error).__name__}
    discard(ctx)
    return {
        "works": True,
        "renderer": info.renderer,
        "version": info.version,
        "compute": info.has_compute,
        "software": info.is_software,
        "lacking": lacking,
        "unused_gpu": unused_gpu() if info.is_software else None,
        "float16_blending": "truncates" if truncates else "rounds",
        "background_compiling": ahead,
    }


def tried(name: str) -> dict[str, Any]:
    """Two views of a small scene by the renderer `name`, compared with the float64 reference: the second one,
    too, since drivers were seen that draw the first one only."""
    scene, settings = sample_scene(), RenderSettings()
    errors: list[float] = []
    try:
        renderer = make_headless(name)
        for eye in ((0, 0, -3), (2, 1, -2)):
            camera = look_at(eye, (0, 0, 0), up=(0, -1, 0), width=96, height=64)
            image = renderer.render(FrameRequest(scene, camera, settings))
            errors.append(float(np.abs(image - reference.render(scene, camera, settings)).max()))
    except Exception as error:  # a broken driver or library may raise anything; that is the finding
        return {"works": False, "why": " ".join(str(error).split()) or type(error).__name__}
    error = float(np.max(errors))  # NaN too
    works = error <= BOUNDS[name]
    against = "within" if works else "above"
    why = f"largest error {error:.1e} against the reference, {against} {BOUNDS[name]:.1e}"
    return {"works": works, "error": error, "why": why}


def sample_scene(count: int = 300) -> Gaussians:
    """Splats of many shapes and colours, SH degree 1, the same each time."""
    rng = np.random.default_rng(7)
    return Gaussians(
        means=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(-2.5, 0.6, (count, 3)).astype(np.float32),
        opacity_logits=rng.normal(0.5, 1.5, count).astype(np.float32),
        sh=rng.normal(0, 0.4, (count, 4, 3)).astype(np.float32),
    )


def as_text(findings: dict[str, Any]) -> str:
    """The findings for people."""
    gl, auto = findings["gl"], findings["auto"]
    lines = [
        f"splatview {findings['splatview']}, Python {findings['python']}, {findings['system']}",
        f"cores      {findings['cores']}",
        f"display    {findings['display']}",
    ]
    if gl["works"]:
        compute = "compute shaders" if gl["compute"] else "no compute shaders"
        kind = "software, no GPU" if gl["software"] else "hardware"
        lines.append(f"OpenGL     {gl['version']}, {gl['renderer']} ({kind}; {compute})")
        if gl["lacking"]:
            lines.append(f"missing    {gl['lacking']}: quads takes its OpenGL 3.3 path, tiles cannot draw")
        if gl["unused_gpu"]:
            lines.append(f"missing    {gl['unused_gpu']}")
        if gl["float16_blending"] == "truncates":
            lines.append("float16    blending truncates instead of rounding: quads sums in float32 even so")
        ahead = gl["background_compiling"]
        does = "works" if ahead["works"] else "does NOT work: effects wait for the next scene"
        lines.append(f"compiling  in the background {does}; {ahead['why']}")
    else:
        lines.append(f"OpenGL     {gl['why']}")
    for name, result in findings["renderers"].items():
        lines.append(f"{name:10} {'works' if result['works'] else 'FAILS'}: {result['why']}")
    lines.append(f"auto       takes {auto['renderer']}: {auto['why']}")
    for name, purpose in LIBRARIES:
        found = findings["libraries"][name]
        missing = f"missing; {purpose}" if purpose else f"MISSING: pip install {name}"
        lines.append(f"{name:14} {found or missing}")
    return "\n".join(lines)
