"""The window's look: calm themes, dark and light, one of high contrast, and one readable font."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, implot

from splatview.scene import Camera
from splatview.scene.image_model import NEAR
from splatview.viewer.preferences import Theme

FONT = "fonts/Roboto/Roboto-Regular.ttf"
"""Ships with imgui-bundle."""
FONT_SIZE = 16.0

# The colours below follow the theme: the vectors are changed in place, as others keep them.
ACCENT = (0.36, 0.66, 0.92)
HELD_OUT = (0.97, 0.72, 0.35)
"""Photos that are not trained on."""
WARNING = ImVec4(0.95, 0.72, 0.35, 1)
ERROR = ImVec4(0.95, 0.45, 0.42, 1)
QUIET = ImVec4(0.60, 0.62, 0.66, 1)
"""Text that explains rather than states."""
OVERLAY = ImVec4(0.1, 0.1, 0.11, 0.75)
"""Ground of texts and buttons on the picture."""
CHOSEN = ImVec4(0.36, 0.66, 0.92, 0.75)
"""Ground of a button that is chosen; texts on it are as on others."""


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """The colours of a theme."""

    greys: dict[int, float]
    """By ImGui's colour, where they are not those of the dark theme."""
    tint: float
    """Factor on the blue of greys."""
    accent: tuple[float, float, float]
    held_out: tuple[float, float, float]
    warning: tuple[float, float, float]
    error: tuple[float, float, float]
    quiet: tuple[float, float, float]
    overlay: tuple[float, float, float, float]
    chosen: tuple[float, float, float, float]
    border: float = 0.0
    """Width of the lines around controls and windows."""


def load_fonts() -> None:
    hello_imgui.load_font_ttf_with_font_awesome_icons(FONT, FONT_SIZE)


def apply() -> None:
    """Sets ImGui's and ImPlot's styles. The DPI factor is applied by hello_imgui afterwards."""
    style = imgui.get_style()
    style.window_rounding = style.popup_rounding = 6
    style.frame_rounding = style.grab_rounding = style.tab_rounding = 4
    style.child_rounding = 4
    style.scrollbar_rounding = 6
    style.tab_bar_border_size = 0
    style.popup_border_size = 1
    style.window_padding = ImVec2(10, 8)
    style.frame_padding = ImVec2(8, 4)
    style.item_spacing = ImVec2(8, 6)
    style.item_inner_spacing = ImVec2(6, 4)
    style.scrollbar_size = 11
    style.grab_min_size = 10
    style.separator_text_border_size = 1
    style.separator_text_padding = ImVec2(0, 4)
    style.disabled_alpha = 0.45

    set_colours("dark")

    plot = implot.get_style()
    plot.plot_padding = ImVec2(4, 4)
    plot.plot_border_size = 0


Col = imgui.Col_

DARK: dict[int, float] = {
    Col.text: 0.88,
    Col.text_disabled: 0.50,
    Col.window_bg: 0.115,
    Col.popup_bg: 0.135,
    Col.menu_bar_bg: 0.095,
    Col.border: 0.24,
    Col.frame_bg: 0.18,
    Col.frame_bg_hovered: 0.23,
    Col.frame_bg_active: 0.26,
    Col.title_bg: 0.095,
    Col.title_bg_active: 0.095,
    Col.title_bg_collapsed: 0.095,
    Col.scrollbar_bg: 0.115,
    Col.scrollbar_grab: 0.27,
    Col.scrollbar_grab_hovered: 0.34,
    Col.scrollbar_grab_active: 0.40,
    Col.button: 0.215,
    Col.button_hovered: 0.275,
    Col.button_active: 0.32,
    Col.separator: 0.22,
    Col.tab: 0.095,
    Col.tab_hovered: 0.20,
    Col.tab_selected: 0.165,
    Col.tab_dimmed: 0.095,
    Col.tab_dimmed_selected: 0.15,
    Col.docking_empty_bg: 0.08,
    Col.table_header_bg: 0.16,
    Col.table_border_light: 0.20,
    Col.table_border_strong: 0.24,
}
"""Brightness by ImGui's colour."""

LIGHT: dict[int, float] = {
    Col.text: 0.10,
    Col.text_disabled: 0.46,
    Col.window_bg: 0.955,
    Col.popup_bg: 0.985,
    Col.menu_bar_bg: 0.90,
    Col.border: 0.76,
    Col.frame_bg: 0.875,
    Col.frame_bg_hovered: 0.835,
    Col.frame_bg_active: 0.80,
    Col.title_bg: 0.90,
    Col.title_bg_active: 0.90,
    Col.title_bg_collapsed: 0.90,
    Col.scrollbar_bg: 0.955,
    Col.scrollbar_grab: 0.76,
    Col.scrollbar_grab_hovered: 0.68,
    Col.scrollbar_grab_active: 0.60,
    Col.button: 0.85,
    Col.button_hovered: 0.79,
    Col.button_active: 0.73,
    Col.separator: 0.80,
    Col.tab: 0.90,
    Col.tab_hovered: 0.84,
    Col.tab_selected: 0.955,
    Col.tab_dimmed: 0.90,
    Col.tab_dimmed_selected: 0.93,
    Col.docking_empty_bg: 0.86,
    Col.table_header_bg: 0.88,
    Col.table_border_light: 0.84,
    Col.table_border_strong: 0.76,
}

CONTRAST: dict[int, float] = {
    Col.text: 1.0,
    Col.text_disabled: 0.72,
    Col.window_bg: 0.0,
    Col.popup_bg: 0.0,
    Col.menu_bar_bg: 0.0,
    Col.border: 0.75,
    Col.frame_bg: 0.10,
    Col.frame_bg_hovered: 0.25,
    Col.frame_bg_active: 0.35,
    Col.title_bg: 0.0,
    Col.title_bg_active: 0.0,
    Col.title_bg_collapsed: 0.0,
    Col.scrollbar_bg: 0.0,
    Col.scrollbar_grab: 0.65,
    Col.scrollbar_grab_hovered: 0.85,
    Col.scrollbar_grab_active: 1.0,
    Col.button: 0.14,
    Col.button_hovered: 0.30,
    Col.button_active: 0.42,
    Col.separator: 0.65,
    Col.tab: 0.0,
    Col.tab_hovered: 0.30,
    Col.tab_selected: 0.22,
    Col.tab_dimmed: 0.0,
    Col.tab_dimmed_selected: 0.18,
    Col.docking_empty_bg: 0.0,
    Col.table_header_bg: 0.15,
    Col.table_border_light: 0.50,
    Col.table_border_strong: 0.70,
}

SHARES: dict[int, float] = {
    Col.check_mark: 1.0,
    Col.slider_grab: 0.75,
    Col.slider_grab_active: 1.0,
    Col.header: 0.22,
    Col.header_hovered: 0.32,
    Col.header_active: 0.42,
    Col.tab_selected_overline: 0.9,
    Col.tab_dimmed_selected_overline: 0.0,
    Col.separator_hovered: 0.5,
    Col.separator_active: 0.8,
    Col.resize_grip: 0.0,
    Col.resize_grip_hovered: 0.4,
    Col.resize_grip_active: 0.7,
    Col.text_selected_bg: 0.35,
    Col.docking_preview: 0.5,
    Col.nav_cursor: 0.8,
    Col.drag_drop_target: 0.9,
    Col.plot_histogram: 0.85,
}
"""Opacity of the accent by ImGui's colour."""

SCHEMES: dict[Theme, Scheme] = {
    "dark": Scheme(
        greys=DARK,
        tint=1.06,
        accent=(0.36, 0.66, 0.92),
        held_out=(0.97, 0.72, 0.35),
        warning=(0.95, 0.72, 0.35),
        error=(0.95, 0.45, 0.42),
        quiet=(0.60, 0.62, 0.66),
        overlay=(0.1, 0.1, 0.11, 0.75),
        chosen=(0.36, 0.66, 0.92, 0.75),
    ),
    "light": Scheme(
        greys=LIGHT,
        tint=1.01,
        accent=(0.09, 0.42, 0.78),
        held_out=(0.78, 0.45, 0.02),
        warning=(0.62, 0.36, 0.0),
        error=(0.76, 0.12, 0.10),
        quiet=(0.36, 0.38, 0.42),
        overlay=(0.97, 0.97, 0.98, 0.82),
        chosen=(0.55, 0.76, 0.98, 0.95),
    ),
    "contrast": Scheme(
        greys=CONTRAST,
        tint=1.0,
        accent=(1.0, 0.84, 0.0),
        held_out=(1.0, 0.6, 0.1),
        warning=(1.0, 0.8, 0.2),
        error=(1.0, 0.5, 0.5),
        quiet=(0.85, 0.85, 0.85),
        overlay=(0.0, 0.0, 0.0, 0.9),
        chosen=(0.50, 0.40, 0.0, 1.0),
        border=1.0,
    ),
}


def set_colours(name: Theme) -> None:
    """Gives ImGui the colours of a theme, and those above to everything that draws with them."""
    global ACCENT, HELD_OUT
    scheme, style = SCHEMES[name], imgui.get_style()
    imgui.style_colors_light() if name == "light" else imgui.style_colors_dark()
    ACCENT, HELD_OUT = scheme.accent, scheme.held_out
    for vector, colour in ((WARNING, scheme.warning), (ERROR, scheme.error), (QUIET, scheme.quiet)):
        vector.x, vector.y, vector.z = colour
    OVERLAY.x, OVERLAY.y, OVERLAY.z, OVERLAY.w = scheme.overlay
    CHOSEN.x, CHOSEN.y, CHOSEN.z, CHOSEN.w = scheme.chosen
    for colour, value in scheme.greys.items():
        style.set_color_(colour, ImVec4(value, value, min(value * scheme.tint, 1.0), 1))
    for colour, share in SHARES.items():
        style.set_color_(colour, ImVec4(*scheme.accent, share))
    style.set_color_(Col.modal_window_dim_bg, ImVec4(0, 0, 0, 0.45))
    style.window_border_size = style.frame_border_size = scheme.border


def set_font_size(size: float) -> None:
    """The height of all text, px on a screen of 96 dpi; at once, as fonts are drawn at any size."""
    imgui.get_style().font_scale_main = size / FONT_SIZE


def point_on_picture(camera: Camera, corner: ImVec2, point: Sequence[float]) -> ImVec2 | None:
    """Where `camera`, of the picture's size, sees `point`, the picture's top left being at `corner`; None
    where it is not before the eye, or beyond what the lens shows."""
    t = camera.R_camera_world @ (np.asarray(point, np.float64) - camera.eye)
    if not t[2] >= NEAR:
        return None
    x, y = camera.image_points(t).tolist()
    at = ImVec2(corner.x + x, corner.y + y)
    return at if math.isfinite(at.x + at.y) else None
