"""The window's look: a calm dark theme and one readable font."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, implot

from splatview.scene import Camera
from splatview.scene.image_model import NEAR

FONT = "fonts/Roboto/Roboto-Regular.ttf"
"""Ships with imgui-bundle."""
FONT_SIZE = 16.0

ACCENT = (0.36, 0.66, 0.92)
HELD_OUT = (0.97, 0.72, 0.35)
"""Photos that are not trained on."""
WARNING = ImVec4(0.95, 0.72, 0.35, 1)
ERROR = ImVec4(0.95, 0.45, 0.42, 1)
QUIET = ImVec4(0.60, 0.62, 0.66, 1)
"""Text that explains rather than states."""


def load_fonts() -> None:
    hello_imgui.load_font_ttf_with_font_awesome_icons(FONT, FONT_SIZE)


def apply() -> None:
    """Sets ImGui's and ImPlot's styles. The DPI factor is applied by hello_imgui afterwards."""
    imgui.style_colors_dark()
    style = imgui.get_style()
    style.window_rounding = style.popup_rounding = 6
    style.frame_rounding = style.grab_rounding = style.tab_rounding = 4
    style.child_rounding = 4
    style.scrollbar_rounding = 6
    style.window_border_size = style.frame_border_size = 0
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

    Col = imgui.Col_
    grey = {
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
    for colour, value in grey.items():
        style.set_color_(colour, ImVec4(value, value, value * 1.06, 1))
    r, g, b = ACCENT
    accent = {
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
    for colour, alpha in accent.items():
        style.set_color_(colour, ImVec4(r, g, b, alpha))
    style.set_color_(Col.modal_window_dim_bg, ImVec4(0, 0, 0, 0.45))

    plot = implot.get_style()
    plot.plot_padding = ImVec2(4, 4)
    plot.plot_border_size = 0


def point_on_picture(camera: Camera, corner: ImVec2, point: Sequence[float]) -> ImVec2 | None:
    """Where `camera`, of the picture's size, sees `point`, the picture's top left being at `corner`; None
    where it is not before the eye, or beyond what the lens shows."""
    t = camera.R_camera_world @ (np.asarray(point, np.float64) - camera.eye)
    if not t[2] >= NEAR:
        return None
    x, y = camera.image_points(t).tolist()
    at = ImVec2(corner.x + x, corner.y + y)
    return at if math.isfinite(at.x + at.y) else None
