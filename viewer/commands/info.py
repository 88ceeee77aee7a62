"""`splatview info`: what a scene holds, which effects it calls for, and its health."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from ...scene import Gaussians
from ...scene.effects import scene_effects, used_sh_degree, view_effects
from ...scene.files import load_scene
from ...scene.framing import robust_bounds
from ...scene.health import check
from .arguments import Parser
from .info_prices import add_measure_options, check_measure_options, measured_prices, price_as_json


def run(arguments: list[str]) -> int:
    parser = Parser("info", "Tells what SCENE holds, which effects it calls for and why, and its health.")
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
    gaussians = load_scene(args.scene)
    receipt = describe(gaussians)
    if args.measure:
        prices, receipt["measured"] = measured_prices(args, gaussians, scene_effects(gaussians))
        for effect in receipt["effects"]:
            if effect["name"] in prices:
                effect["price"] = price_as_json(prices[effect["name"]])
                effect["measured"] = str(prices[effect["name"]])
    if args.repairs:
        # Imported when needed: it compiles.
        from .repair_prices import add_repairs

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
    ill = [f for f in receipt["health"] if f["count"]]
    lines += [
        f"  {f['count']:>9,}  {f['name']}: {f['what']}{' (not drawn)' if f['culled'] else ''}" for f in ill
    ]
    if not ill:
        lines.append("  nothing found")
    if any("price" in finding for finding in receipt["health"]):
        from .repair_prices import repairs_as_text

        lines += repairs_as_text(receipt)
    return "\n".join(lines)
