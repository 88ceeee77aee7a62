"""What is open: its files, size, what its effects are and what is ill in it."""

from __future__ import annotations

from ..core import Core
from ..loading import Examination
from . import health, widgets


def show(core: Core) -> None:
    scene = core.scene
    if scene is None:
        widgets.note("Nothing is open yet. Drop a scene on the window, or open one:")
        widgets.action_button(core, "Open...", "open")
        return
    gaussians = scene.gaussians
    for path in scene.paths:
        widgets.fact("File", path.name, str(path))
    if not scene.paths:
        widgets.fact("Scene", scene.name, "Made by the program itself; open a file to replace it.")
    widgets.fact("Splats", f"{len(gaussians):,}", "Gaussians in the scene, ill ones included.")
    widgets.fact(
        "SH degree", str(gaussians.sh_degree), "Highest band of view-dependent colour that is stored."
    )
    widgets.fact("In memory", f"{gaussians.nbytes / 2**20:,.1f} MiB", "All arrays of the scene.")
    if scene.extent is not None:
        low, high = (", ".join(f"{v:.4g}" for v in side) for side in scene.extent)
        widgets.fact("From", low, "Least x, y, z of all finite centres, world units.")
        widgets.fact("To", high, "Greatest x, y, z of all finite centres, world units.")
    widgets.fact(
        "Middle",
        ", ".join(f"{v:.4g}" for v in scene.centre),
        "Of where the splats are as the scene was opened, outliers left out.",
    )
    widgets.fact("Radius", f"{scene.radius:.4g}", "Of the same, world units.")

    if core.examination is not None:
        examination(core, core.examination)
    if gaussians.comments:
        widgets.section("Comments in the file")
        for comment in gaussians.comments:
            widgets.note(comment)


def examination(core: Core, found: Examination) -> None:
    """How many effects are computed, and splats that are ill: a click selects them."""
    if not found.done:
        widgets.note("Looking at the splats...")
        return
    receipt = core.effects.receipt(core)
    on = sum(effect.in_force for effect in receipt)
    tip = "The Effects panel tells which, why, and at which price."
    widgets.fact("Effects", f"{on} of {len(receipt)} are computed", tip)
    health.show(core, found.findings)
