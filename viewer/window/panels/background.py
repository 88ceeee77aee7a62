"""What is behind the scene: one colour, a sky over a ground, or a picture all around."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from imgui_bundle import ImVec4, imgui

from ..backdrop import ask_for_picture
from ..core import Core
from ..preferences import BackgroundKind
from . import widgets

COLOURS = (
    ("Black", (0.0, 0.0, 0.0)),
    ("Graphite", (0.10, 0.10, 0.11)),
    ("Grey", (0.5, 0.5, 0.5)),
    ("White", (1.0, 1.0, 1.0)),
    ("Sky", (0.53, 0.70, 0.90)),
)

KINDS = {"colour": "One colour", "gradient": "Gradient", "panorama": "Picture all around"}


def show(core: Core) -> None:
    preferences = core.preferences
    kinds: tuple[BackgroundKind, ...] = get_args(BackgroundKind)
    kind = widgets.combo(
        "Behind",
        preferences.background_kind,
        kinds,
        "Blended behind the scene, as it is: no gamma. A gradient goes from straight up to straight down, "
        "a picture (equirectangular, twice as wide as high) all the way round. Both are upright as the "
        "view's up axis is, and stay where they are while the eye turns.",
        [KINDS[kind] for kind in kinds],
    )
    if kind is not None:
        core.prefer(background_kind=kind)
        if kind == "panorama" and not preferences.panorama:
            ask_for_picture(core)
    match preferences.background_kind:
        case "colour":
            one_colour(core)
        case "gradient":
            colour(core, "Above", "sky", "Straight up.")
            colour(core, "Below", "ground", "Straight down.")
        case "panorama":
            name = Path(preferences.panorama).name or "none yet"
            widgets.fact("Picture", name, preferences.panorama)
            widgets.button(
                "Open picture...",
                "An equirectangular picture: its middle is in front, its top row up.",
                lambda: ask_for_picture(core),
            )


def one_colour(core: Core) -> None:
    colour(core, "Colour", "background", "Scenes are mostly trained on black or white.")
    widgets.label("Presets", "Backgrounds for one click.")
    side = imgui.get_frame_height()
    for i, (name, preset) in enumerate(COLOURS):
        if i:
            imgui.same_line()
        flags = imgui.ColorEditFlags_.no_tooltip | imgui.ColorEditFlags_.no_drag_drop
        if imgui.color_button(f"{name}##background", ImVec4(*preset, 1), flags, (side, side)):
            core.prefer(background=preset)
        widgets.tooltip(name)


def colour(core: Core, name: str, preference: str, tip: str) -> None:
    """A row with the colour that `preference` holds."""
    widgets.label(name, tip)
    changed, new = imgui.color_edit3(f"##{preference}", list(getattr(core.preferences, preference)))
    widgets.tooltip(tip)
    if changed:
        r, g, b = (min(max(float(part), 0.0), 1.0) for part in new)
        core.prefer(**{preference: (r, g, b)})
