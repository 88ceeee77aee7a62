"""`splatview info`: what a scene holds, which effects it calls for, and its health."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ...scene import Gaussians
from ...scene.effects import census, used_sh_degree
from ...scene.files import load_scene
from ...scene.framing import robust_bounds
from ...scene.health import check
from .arguments import Parser


def run(arguments: list[str]) -> int:
    parser = Parser("info", "Tells what SCENE holds, which effects it calls for and why, and its health.")
    parser.add_argument("scene", metavar="SCENE")
    parser.add_argument("--json", action="store_true", help="the same for scripts, on standard output")
    args = parser.parse(arguments)
    if args is None:
        return 0
    receipt = describe(load_scene(args.scene))
    print(json.dumps(receipt, indent=1, allow_nan=False) if args.json else as_text(args.scene, receipt))
    return 0


def describe(gaussians: Gaussians) -> dict[str, Any]:
    """The receipt of a scene, ready for JSON."""
    findings = check(gaussians)
    return {
        "count": len(gaussians),
        "bounds": bounds(gaussians.means),
        "sh_degree": {"stored": gaussians.sh_degree, "used": used_sh_degree(gaussians)},
        "effects": [
            {"name": e.name, "on": bool(e.on), "why": e.why} for e in census(gaussians, findings=findings)
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
    lines += [f"  {'on ' if e['on'] else 'off'}  {e['name']}: {e['why']}" for e in receipt["effects"]]
    lines.append("health")
    ill = [f for f in receipt["health"] if f["count"]]
    lines += [
        f"  {f['count']:>9,}  {f['name']}: {f['what']}{' (not drawn)' if f['culled'] else ''}" for f in ill
    ]
    if not ill:
        lines.append("  nothing found")
    return "\n".join(lines)
