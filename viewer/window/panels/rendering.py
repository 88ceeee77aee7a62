"""How the picture is made: what is shown, the image model's knobs, the background."""

from __future__ import annotations

from dataclasses import replace

from ....scene.image_model import BLUR, DISC_BLUR, ImageModel
from ..actions import VISUAL_MODES, set_mode
from ..core import Core
from ..preferences import RANGES
from . import background, widgets

MODE_NAMES = {
    "splats": "Splats",
    "points": "Points",
    "ellipsoids": "Ellipsoids",
    "depth": "Depth",
    "overdraw": "Overdraw",
}
MODE_TIP = (
    "What is drawn for each splat. Splats: the picture itself. Points: centres only, to see structure. "
    "Ellipsoids: solid bodies, to see needles and discs. Depth: near is bright. "
    "Overdraw: how many splats each pixel costs, to see where time goes."
)


def show(core: Core) -> None:
    mode = widgets.combo("Show", core.mode, VISUAL_MODES, MODE_TIP, [MODE_NAMES[m] for m in VISUAL_MODES])
    if mode is not None:
        core.post(set_mode, mode)
    sh_degree(core)
    scale = widgets.slider(
        "Resolution",
        core.preferences.resolution_scale,
        *RANGES["resolution_scale"],
        "Rendered pixels for each pixel of the window, along each side. Half is about four times as fast; "
        "two smooths edges. Saved pictures are always at full resolution.",
        form="%.2f x",
    )
    if scale is not None:
        core.prefer(resolution_scale=scale)
    widgets.section("Background")
    background.show(core)
    widgets.section("Image model")
    image_model(core)


def sh_degree(core: Core) -> None:
    stored = core.scene.gaussians.sh_degree if core.scene else 3
    choices = ["all", *(str(degree) for degree in range(stored + 1))]
    names = [f"All stored ({stored})", "0: constant colour", "1", "2", "3"][: len(choices)]
    now = core.settings.sh_degree
    value = "all" if now is None or now > stored else str(now)
    chosen = widgets.combo(
        "SH degree",
        value,
        choices,
        "Highest band of view-dependent colour that is computed. Lower is faster and loses gloss.",
        names,
    )
    if chosen is not None:
        core.settings = replace(core.settings, sh_degree=None if chosen == "all" else int(chosen))


def image_model(core: Core) -> None:
    model = core.settings.model
    footprint = widgets.combo(
        "Splats are",
        model.footprint,
        ("ellipsoid", "disc"),
        "Solid, or flat discs that each pixel's ray meets (2D Gaussian Splatting). Right is what the scene "
        "was trained as; blur changes with it.",
        ["Solid ellipsoids", "Flat discs"],
    )
    if footprint is not None:
        model = model.with_footprint("disc" if footprint == "disc" else "ellipsoid")
    antialiased = widgets.checkbox(
        "Antialiased",
        model.antialiased,
        "Takes back from small splats the brightness that the blur adds (Mip-Splatting). Right only for "
        "scenes that were trained so; others become thin and dark. Without effect on discs.",
    )
    if antialiased is not None:
        model = replace(model, antialiased=antialiased)
    blur = widgets.slider(
        "Blur",
        model.blur,
        0.0,
        1.0,
        f"Variance in px² added to every footprint. Trained scenes expect {BLUR}; some antialiased ones 0.1. "
        f"Of discs: of the dot that each is at least; they expect {DISC_BLUR}.",
    )
    if blur is not None:
        model = replace(model, blur=blur)
    near = widgets.slider(
        "Near",
        model.near,
        0.001,
        10.0,
        "Splats nearer to the eye than this are not drawn, world units. Raise it to look inside.",
        form="%.3f",
        logarithmic=True,
    )
    if near is not None:
        model = replace(model, near=near)
    if model != core.settings.model:
        core.settings = replace(core.settings, model=model)
    blend = widgets.combo(
        "Blending",
        core.preferences.blend,
        ("float16", "float32"),
        "Precision of the target that splats are blended into. float16 is faster and within 4/255 of the "
        "truth; float32 is for measuring, and for drivers that truncate float16 (splatview doctor).",
    )
    if blend is not None:
        core.prefer(blend=blend)
    called_for = core.scene.settings.model if core.scene else ImageModel()
    if core.settings.model != called_for:
        widgets.button(
            "As the scene calls for",
            "Takes footprint, antialiasing, blur and near back to what the scene was trained with, as far as "
            "its file says.",
            lambda: setattr(core, "settings", replace(core.settings, model=called_for)),
        )
