"""The window's look: its themes and one readable font."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, implot

from splatview.scene import Camera
from splatview.scene.image_model import NEAR
from splatview.viewer.preferences import Theme

FONT = "fonts/Roboto/Roboto-Regular.ttf"
"""Ships with imgui-bundle."""
FONT_SIZE = 16.0

ACCENT = (0.36, 0.66, 0.92)
HELD_OUT = (0.97, 0.72, 0.35)
"""Photos that are not trained on."""
WARNING = ImVec4(0.95, 0.72, 0.35, 1)
ERROR = ImVec4(0.95, 0.45, 0.42, 1)
QUIET = ImVec4(0.60, 0.62, 0.66, 1)
"""Text that explains rather than states; its values follow the theme."""


def load_fonts() -> None:
    hello_imgui.load_font_ttf_with_font_awesome_icons(FONT, FONT_SIZE)


def apply(theme: Theme = "dark", font_size: float = FONT_SIZE) -> None:
    """Sets ImGui's and ImPlot's styles, before hello_imgui scales them by the DPI factor."""
    style = imgui.get_style()
    set_sizes(style)
    style.scale_all_sizes(font_size / FONT_SIZE)
    style.font_scale_main = font_size / FONT_SIZE
    set_colours(style, theme)
    plot = implot.get_style()
    plot.plot_padding = ImVec2(4, 4)
    plot.plot_border_size = 0


def follow(theme: Theme, font_size: float) -> None:
    """As `apply`, in a window that is open."""
    style = imgui.get_style()
    fresh = imgui.Style()
    for name in SIZES:
        setattr(style, name, getattr(fresh, name))
    set_sizes(style)
    style.scale_all_sizes(hello_imgui.dpi_window_size_factor() * font_size / FONT_SIZE)
    style.font_scale_main = font_size / FONT_SIZE
    set_colours(style, theme)


SIZES = (
    "indent_spacing",
    "columns_min_spacing",
    "cell_padding",
    "log_slider_deadzone",
)
"""Sizes of ImGui's style that stay as it has them."""


def set_sizes(style: imgui.Style) -> None:
    """Unscaled sizes, px at 96 dpi and a font of `FONT_SIZE`."""
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


@dataclass(frozen=True)
class Tones:
    """Lightness of a theme."""

    ground: float
    """Of panels, 0 to 1."""
    text: float
    quiet: float
    contrast: float = 1.0
    """Factor on how far controls stand off the ground."""
    border: float = 0.0
    """px around controls."""


THEMES: dict[Theme, Tones] = {
    "dark": Tones(ground=0.115, text=0.88, quiet=0.62),
    "light": Tones(ground=0.93, text=0.10, quiet=0.38),
    "high contrast": Tones(ground=0.0, text=1.0, quiet=0.86, contrast=1.5, border=1.0),
}

OFFSETS = {
    imgui.Col_.window_bg: 0.0,
    imgui.Col_.popup_bg: 0.02,
    imgui.Col_.menu_bar_bg: -0.02,
    imgui.Col_.border: 0.125,
    imgui.Col_.frame_bg: 0.065,
    imgui.Col_.frame_bg_hovered: 0.115,
    imgui.Col_.frame_bg_active: 0.145,
    imgui.Col_.title_bg: -0.02,
    imgui.Col_.title_bg_active: -0.02,
    imgui.Col_.title_bg_collapsed: -0.02,
    imgui.Col_.scrollbar_bg: 0.0,
    imgui.Col_.scrollbar_grab: 0.155,
    imgui.Col_.scrollbar_grab_hovered: 0.225,
    imgui.Col_.scrollbar_grab_active: 0.285,
    imgui.Col_.button: 0.10,
    imgui.Col_.button_hovered: 0.16,
    imgui.Col_.button_active: 0.205,
    imgui.Col_.separator: 0.105,
    imgui.Col_.table_header_bg: 0.045,
    imgui.Col_.table_border_light: 0.085,
    imgui.Col_.table_border_strong: 0.125,
}
"""How far from the ground a colour is, towards the text."""


@contextmanager
def on_picture() -> Iterator[None]:
    """Within, controls are as in the dark theme: they lie on the picture, on a dark ground."""
    dark = THEMES["dark"]
    greys = {imgui.Col_.text: dark.text} | {
        colour: dark.ground + offset for colour, offset in OFFSETS.items()
    }
    for colour, value in greys.items():
        imgui.push_style_color(colour, ImVec4(value, value, min(value * 1.06, 1.0), 1))
    try:
        yield
    finally:
        imgui.pop_style_color(len(greys))


def set_colours(style: imgui.Style, theme: Theme) -> None:
    """Colours of ImGui and of the texts that explain."""
    tones = THEMES[theme]
    (imgui.style_colors_light if tones.ground > 0.5 else imgui.style_colors_dark)()
    towards = 1.0 if tones.ground < 0.5 else -1.0

    def grey(value: float) -> ImVec4:
        return ImVec4(value, value, min(value * 1.06, 1.0), 1)

    for colour, offset in OFFSETS.items():
        value = tones.ground + towards * offset * tones.contrast
        style.set_color_(colour, grey(min(max(value, 0.0), 1.0)))
    style.set_color_(imgui.Col_.text, grey(tones.text))
    style.set_color_(imgui.Col_.text_disabled, grey((tones.text + 2 * tones.ground) / 3))
    style.frame_border_size = tones.border
    QUIET.x = QUIET.y = tones.quiet
    QUIET.z = min(tones.quiet * 1.06, 1.0)
    Col = imgui.Col_
    r, g, b = ACCENT
    accent = {
        Col.check_mark: 1.0,
        Col.slider_grab: 0.75,
        Col.slider_grab_active: 1.0,
        Col.header: 0.32,
        Col.header_hovered: 0.4,
        Col.header_active: 0.5,
        Col.separator_hovered: 0.5,
        Col.separator_active: 0.8,
        Col.text_selected_bg: 0.35,
        Col.nav_cursor: 0.8,
        Col.drag_drop_target: 0.9,
        Col.plot_histogram: 0.85,
    }
    for colour, alpha in accent.items():
        style.set_color_(colour, ImVec4(r, g, b, alpha))
    style.set_color_(Col.modal_window_dim_bg, ImVec4(0, 0, 0, 0.45))


def point_on_picture(camera: Camera, corner: ImVec2, point: Sequence[float]) -> ImVec2 | None:
    """Where `camera`, of the picture's size, sees `point`, the picture's top left being at `corner`; None
    where it is not before the eye, or beyond what the lens shows."""
    t = camera.R_camera_world @ (np.asarray(point, np.float64) - camera.eye)
    if not t[2] >= NEAR:
        return None
    x, y = camera.image_points(t).tolist()
    at = ImVec2(corner.x + x, corner.y + y)
    return at if math.isfinite(at.x + at.y) else None
