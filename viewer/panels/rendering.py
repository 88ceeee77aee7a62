"""The View page: visual mode, background, camera, lens, resolution, image model, statistics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

from imgui_bundle import ImVec4, imgui

from splatview.renderers import MODES
from splatview.scene.image_model import BLUR, DISC_BLUR
from splatview.viewer.background import ask_for_picture
from splatview.viewer.commands import set_mode
from splatview.viewer.panels import camera, statistics, view_aids, widgets
from splatview.viewer.preferences import RANGES, BackgroundKind
from splatview.viewer.state import AppState

COLOURS = (
    ("Black", (0.0, 0.0, 0.0)),
    ("Graphite", (0.10, 0.10, 0.11)),
    ("Grey", (0.5, 0.5, 0.5)),
    ("White", (1.0, 1.0, 1.0)),
    ("Sky", (0.53, 0.70, 0.90)),
)

KINDS = {"colour": "One colour", "gradient": "Gradient", "panorama": "Picture all around"}


def show_background(app: AppState) -> None:
    preferences = app.preferences
    kinds: tuple[BackgroundKind, ...] = get_args(BackgroundKind)
    kind = widgets.combo(
        "Behind",
        preferences.background_kind,
        kinds,
        "What is blended behind the scene: one colour, a gradient from straight up to straight down, or "
        "an equirectangular picture.",
        [KINDS[kind] for kind in kinds],
    )
    if kind is not None:
        app.prefer(background_kind=kind)
        if kind == "panorama" and not preferences.panorama:
            ask_for_picture(app)
    match preferences.background_kind:
        case "colour":
            one_colour(app)
        case "gradient":
            colour(app, "Above", "sky", "Straight up.")
            colour(app, "Below", "ground", "Straight down.")
        case "panorama":
            name = Path(preferences.panorama).name or "none yet"
            widgets.fact("Picture", name, preferences.panorama)
            widgets.button(
                "Open picture...",
                "An equirectangular picture: its middle is in front, its top row up.",
                lambda: ask_for_picture(app),
            )


def one_colour(app: AppState) -> None:
    colour(app, "Colour", "background", "Scenes are mostly trained on black or white.")
    widgets.label("Presets", "Backgrounds for one click.")
    gaps = (len(COLOURS) - 1) * imgui.get_style().item_spacing.x
    side = min(imgui.get_frame_height(), (imgui.get_content_region_avail().x - gaps) / len(COLOURS))
    for i, (name, preset) in enumerate(COLOURS):
        if i:
            imgui.same_line()
        flags = imgui.ColorEditFlags_.no_tooltip | imgui.ColorEditFlags_.no_drag_drop
        if imgui.color_button(f"{name}##background", ImVec4(*preset, 1), flags, (side, side)):
            app.prefer(background=preset)
        widgets.tooltip(name)


def colour(app: AppState, name: str, preference: str, tip: str) -> None:
    """A row with the colour that `preference` holds."""
    widgets.label(name, tip)
    changed, new = imgui.color_edit3(f"##{preference}", list(getattr(app.preferences, preference)))
    widgets.tooltip(tip)
    if changed:
        r, g, b = (min(max(float(part), 0.0), 1.0) for part in new)
        app.prefer(**{preference: (r, g, b)})


MODE_TIP = (
    "What is drawn for each splat: "
    + "; ".join(f"{mode.explanation} ({mode.label.lower()})" for mode in MODES.values())
    + "."
)


def show(app: AppState) -> None:
    """The View page: what is drawn, and from where."""
    if widgets.fold(app, "Picture", opened=True):
        picture(app)
    if widgets.fold(app, "Background"):
        show_background(app)
    if widgets.fold(app, "Camera", opened=True):
        camera.show(app)
    if widgets.fold(app, "Lens"):
        camera.show_lens(app)
    if widgets.fold(app, "Bookmarks"):
        camera.show_bookmarks(app)
    if widgets.fold(app, "Navigation"):
        camera.speeds(app)
    if widgets.fold(app, "Advanced"):
        image_model(app)
    if widgets.fold(app, "Statistics"):
        statistics.show(app)


def picture(app: AppState) -> None:
    mode = widgets.combo("Mode", app.mode, tuple(MODES), MODE_TIP, [mode.label for mode in MODES.values()])
    if mode is not None:
        app.post(set_mode, mode)
    sh_degree(app)
    scale = widgets.slider(
        "Resolution",
        app.preferences.resolution_scale,
        *RANGES["resolution_scale"],
        "Rendered pixels for each pixel of the window, along each side: half is about four times as "
        "fast, two smooths edges.",
        form="%.2f x",
    )
    if scale is not None:
        app.prefer(resolution_scale=scale)
    view_aids.show(app)


def sh_degree(app: AppState) -> None:
    stored = app.scene.gaussians.sh_degree if app.is_open else 3
    choices = ["all", *(str(degree) for degree in range(stored + 1))]
    names = [f"All stored ({stored})", "0: constant colour", "1", "2", "3"][: len(choices)]
    now = app.settings.sh_degree
    value = "all" if now is None or now > stored else str(now)
    chosen = widgets.combo(
        "SH degree",
        value,
        choices,
        "Highest band of view-dependent colour that is computed; lower is faster and loses gloss.",
        names,
    )
    if chosen is not None:
        app.settings = replace(app.settings, sh_degree=None if chosen == "all" else int(chosen))


def image_model(app: AppState) -> None:
    model = app.settings.model
    footprint = widgets.combo(
        "Splats are",
        model.footprint,
        ("ellipsoid", "disc"),
        "Solid, or flat discs that each pixel's ray meets (2D Gaussian Splatting): right is what the "
        "scene was trained as.",
        ["Solid ellipsoids", "Flat discs"],
    )
    if footprint is not None:
        model = model.with_footprint("disc" if footprint == "disc" else "ellipsoid")
    antialiased = widgets.checkbox(
        "Antialiased",
        model.antialiased,
        "Takes back from small splats the brightness that the blur adds; right only for scenes that were "
        "trained so (Mip-Splatting).",
    )
    if antialiased is not None:
        model = replace(model, antialiased=antialiased)
    blur = widgets.slider(
        "Blur",
        model.blur,
        0.0,
        1.0,
        "Variance in px² added to every footprint; scenes expect what they were trained with, mostly "
        f"{BLUR}, discs {DISC_BLUR}.",
    )
    if blur is not None:
        model = replace(model, blur=blur)
    near = widgets.slider(
        "Near",
        model.near,
        0.001,
        10.0,
        "Splats nearer to the eye than this are not drawn, world units; more looks inside.",
        form="%.3f",
        logarithmic=True,
    )
    if near is not None:
        model = replace(model, near=near)
    if model != app.settings.model:
        app.settings = replace(app.settings, model=model)
    blend = widgets.combo(
        "Blending",
        app.preferences.blend,
        ("float16", "float32"),
        "Precision in which splats are blended: float16 is faster and within 4/255 of the truth, float32 "
        "is for measuring.",
    )
    if blend is not None:
        app.prefer(blend=blend)
    called_for = app.scene.settings.model
    if app.settings.model != called_for:
        widgets.button(
            "Reset###reset image model",
            "Takes footprint, antialiasing, blur and near back to what the scene was trained with, as far as "
            "its file says.",
            lambda: setattr(app, "settings", replace(app.settings, model=called_for)),
        )
