"""`splatview info`: what a scene holds, which effects it calls for, and its health."""

from __future__ import annotations

import argparse
import json
import math
import threading
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from splatview.cli.arguments import Parser, add_camera_options, check_camera_options, chosen_orbit, positive
from splatview.cli.main import make_console
from splatview.cli.sequence import describe_sequence, source_of
from splatview.measure.effect_costs import EffectPrice, price_effects
from splatview.measure.knobs import Plan
from splatview.renderers import choices
from splatview.renderers.headless import HeadlessScene, make_headless
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.effects.effect import Effect
from splatview.scene.effects.overrides import settings_for
from splatview.scene.effects.report import scene_effects, view_effects
from splatview.scene.effects.sh_bands import used_sh_degree
from splatview.scene.formats import load_scene
from splatview.scene.formats.sequence import SceneSequence
from splatview.scene.framing import robust_bounds
from splatview.scene.health import check

# ---- `splatview info --measure`: what each effect costs or saves here, by drawing with and without it.


SECONDS = 15.0

CAMERA_OPTIONS = ("camera", "camera_index", "camera_name", "eye", "target", "up", "fov", "size")


def add_measure_options(parser: Parser) -> None:
    group = parser.add_argument_group("prices")
    group.add_argument(
        "--measure",
        action="store_true",
        help="also draw with each effect on and off, and tell the difference in time",
    )
    group.add_argument(
        "--renderer", choices=("auto", *choices("ladder")), help="which one draws (default: auto)"
    )
    group.add_argument("--seconds", type=positive, metavar="S", help=f"for how long (default: {SECONDS:g})")
    add_camera_options(parser)


def check_measure_options(args: argparse.Namespace) -> None:
    """Raises InputError where options of --measure are given without it."""
    if args.measure:
        check_camera_options(args)
        return
    for name in ("renderer", "seconds", *CAMERA_OPTIONS):
        if getattr(args, name, None) is not None:
            raise InputError(f"--{name.replace('_', '-')} goes with --measure")


def measured_prices(
    args: argparse.Namespace, gaussians: Gaussians, effects: list[Effect]
) -> tuple[dict[str, EffectPrice], dict[str, Any]]:
    """By name, the price of each effect that can be switched; and what they were measured by.

    Raises KeyboardInterrupt where the user ends it early: half of the prices are not said.
    """
    from splatview.cli.ladder import FRAME_TURN, on_interrupt  # when needed: it compiles

    orbit = chosen_orbit(args, gaussians)
    scene = HeadlessScene(make_headless(args.renderer or "auto"), gaussians, orbit.turned_from)
    camera = orbit.camera
    stopped = threading.Event()

    def moved(_: int, number: int) -> Camera:
        return orbit.turned(FRAME_TURN * (number + 1))

    with Progress(
        BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"), console=make_console()
    ) as progress:
        task = progress.add_task("", total=1.0)
        with on_interrupt(stopped.set):
            prices = price_effects(
                scene,
                Plan(settings=settings_for(gaussians)),
                gaussians,
                effects,
                camera,
                moved=moved,
                seconds=args.seconds or SECONDS,
                on_progress=lambda share, text: progress.update(task, completed=share, description=text),
                cancelled=stopped.is_set,
            )
    if prices is None:
        raise KeyboardInterrupt
    return prices, {"renderer": scene.name, "size": [camera.width, camera.height]}


def price_as_json(price: EffectPrice) -> dict[str, Any]:
    """`saved_ms`: what a frame without the effect takes less than one with it."""
    return {
        "frame_ms": price.ms,
        "saved_ms": price.saved_ms,
        "noise_ms": price.noise_ms,
        "clear": price.clear,
        "max_change": price.max_error,
    }


# ---- What each repair of the health report changes in pictures, for `splatview info --repairs`.


VIEWS = 8
"""That a price is measured in."""


def add_repairs(receipt: dict[str, Any], gaussians: Gaussians) -> None:
    """Gives each finding of `receipt["health"]` that can be repaired "repair", what it does, and "price"."""
    # Imported when needed: they compile.
    from splatview.edit.document import Document
    from splatview.edit.impact import operation_impacts
    from splatview.edit.operations.cleanup import REPAIRS, Repair
    from splatview.edit.sample_views import sample_cameras
    from splatview.renderers.cpu import CpuRenderer

    document = Document(gaussians, tools=CpuRenderer())
    found = [entry for entry in receipt["health"] if entry["count"] and entry["name"] in REPAIRS]
    repairs = {entry["name"]: Repair(finding=entry["name"]) for entry in found}
    prices = operation_impacts(document, repairs, sample_cameras(gaussians, document.edits, VIEWS))
    for entry in found:
        entry["repair"], entry["price"] = REPAIRS[entry["name"]], asdict(prices[entry["name"]])


def repairs_as_text(receipt: dict[str, Any]) -> list[str]:
    """A line for each of those findings; none where `add_repairs` was not called."""
    from splatview.edit.impact import Impact, in_words

    found = [entry for entry in receipt["health"] if "price" in entry]
    return ["repairs"] * bool(found) + [
        f"  {entry['name']}: {entry['repair']}; {in_words(Impact(**entry['price']))}" for entry in found
    ]


def run(arguments: list[str]) -> int:
    parser = Parser(
        "info",
        "Tells what SCENE holds, which effects it calls for and why, and its health.\n"
        "Of a folder of scenes, or a glob in quotes, it tells what each frame holds.",
    )
    parser.add_argument("scene", metavar="SCENE")
    parser.add_argument(
        "--repairs",
        action="store_true",
        help="also tell what each repair that the health report offers changes, seen from all around",
    )
    parser.add_argument("--json", action="store_true", help="the same for scripts, on standard output")
    add_measure_options(parser)
    args = parser.parse(arguments)
    if args is None:
        return 0
    check_measure_options(args)
    source = source_of(args.scene)
    if isinstance(source, SceneSequence):
        if args.measure or args.repairs:
            raise InputError("--measure and --repairs look at one scene; name one of the sequence's files")
        return describe_sequence(source, as_json=args.json)
    gaussians = load_scene(source)
    receipt = describe(gaussians)
    if args.measure:
        prices, receipt["measured"] = measured_prices(args, gaussians, scene_effects(gaussians))
        for effect in receipt["effects"]:
            if effect["name"] in prices:
                effect["price"] = price_as_json(prices[effect["name"]])
                effect["measured"] = str(prices[effect["name"]])
    if args.repairs:
        add_repairs(receipt, gaussians)
    print(json.dumps(receipt, indent=1, allow_nan=False) if args.json else as_text(args.scene, receipt))
    return 0


def describe(gaussians: Gaussians) -> dict[str, Any]:
    """The receipt of a scene, ready for JSON."""
    findings = check(gaussians)
    by_scene = scene_effects(gaussians, findings=findings)
    effects = [*by_scene, *view_effects(gaussians)]
    return {
        "count": len(gaussians),
        "bounds": bounds(gaussians.means),
        "sh_degree": {"stored": gaussians.sh_degree, "used": used_sh_degree(gaussians)},
        "effects": [
            {
                "name": e.name,
                "on": bool(e.on),
                "why": e.why,
                "leaving_out": e.leaving_out,
                "saved_bytes": e.saving.bytes,
                "saved_operations": e.saving.operations,
                "largest_change": e.bound if math.isfinite(e.bound) else None,
                "can_override": e.can_override,
                "decided_by": "scene" if e in by_scene else "view",
            }
            for e in effects
        ],
        "health": [
            {"name": f.name, "count": int(f.count), "what": f.what, "culled": bool(f.culled)}
            for f in findings
        ],
        "bytes": gaussians.nbytes,
        "comments": list(gaussians.comments),
        "extras": sorted(gaussians.extras),
    }


def bounds(means: np.ndarray) -> dict[str, Any]:
    """Corners of all finite means (null where there are none); centre and radius of the bulk."""
    finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    centre, radius = robust_bounds(means)
    return {
        "min": finite.min(axis=0).tolist() if len(finite) else None,
        "max": finite.max(axis=0).tolist() if len(finite) else None,
        "centre": [float(value) for value in centre],
        "radius": float(radius),
    }


def as_text(path: str, receipt: dict[str, Any]) -> str:
    """The receipt for people."""
    box, degree = receipt["bounds"], receipt["sh_degree"]
    lines = [f"{path}: {receipt['count']:,} splats, {receipt['bytes'] / 2**20:.1f} MiB in memory"]
    if box["min"] is not None:
        low, high = (", ".join(f"{value:.4g}" for value in box[key]) for key in ("min", "max"))
        lines.append(f"  from ({low}) to ({high})")
        centre = ", ".join(f"{value:.4g}" for value in box["centre"])
        lines.append(f"  most of it within {box['radius']:.4g} of ({centre})")
    lines.append(f"  SH degree {degree['stored']} stored, {degree['used']} in use")
    lines += [f"  comment: {comment}" for comment in receipt["comments"]]
    if receipt["extras"]:
        lines.append(f"  other properties: {', '.join(receipt['extras'])}")
    lines.append("effects")
    if "measured" in receipt:
        by = receipt["measured"]
        lines[-1] += f", measured with {by['renderer']} at {by['size'][0]}x{by['size'][1]}"
    later = [e["name"] for e in receipt["effects"] if e["decided_by"] == "view" and not e["on"]]
    for effect in receipt["effects"]:
        if effect["name"] in later:
            continue
        lines.append(f"  {'on ' if effect['on'] else 'off'}  {effect['name']}: {effect['why']}")
        if effect["leaving_out"]:
            lines.append(f"       {effect['leaving_out']}")
        if "measured" in effect:
            lines.append(f"       measured: {effect['measured']}")
    lines.append(f"  off until a view or an edit calls for it: {', '.join(later)}")
    lines.append("health")
    found = [f for f in receipt["health"] if f["count"]]
    lines += [
        f"  {f['count']:>9,}  {f['name']}: {f['what']}{' (not drawn)' if f['culled'] else ''}" for f in found
    ]
    if not found:
        lines.append("  nothing found")
    if any("price" in finding for finding in receipt["health"]):
        lines += repairs_as_text(receipt)
    return "\n".join(lines)
