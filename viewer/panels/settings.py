"""The settings: font size, theme, background, keys and mouse; what is chosen takes effect at once."""

from __future__ import annotations

from imgui_bundle import imgui

from splatview.viewer import commands, theme
from splatview.viewer.dialogs import DIALOG_FLAGS
from splatview.viewer.key_presets import ACTION_TEXTS, MOUSE, PRESET_NAMES, PRESETS
from splatview.viewer.panels import widgets
from splatview.viewer.preferences import RANGES, Preferences, Theme
from splatview.viewer.state import AppState

NAME = "Settings"

WIDTH_EM = 32.0

FONT_SIZES = ("12", "13", "14", "15", "16", "18", "20", "22", "24", "28", "32")
"""Px. A list, as a slider would move away under the mouse that drags it."""

THEMES: dict[Theme, str] = {"dark": "Dark", "light": "Light", "contrast": "High contrast"}


class Appearance:
    """Theme, font and keys as they were last given to ImGui and to the table of commands."""

    def __init__(self) -> None:
        self._given: tuple[object, ...] = ()

    def follow(self, preferences: Preferences) -> None:
        """Called before each frame."""
        wanted = preferences.theme, preferences.font_size, preferences.keys
        if wanted == self._given:
            return
        self._given = wanted
        theme.set_colours(preferences.theme)
        theme.set_font_size(preferences.font_size)
        commands.use_keys(preferences.keys)


def show(app: AppState) -> None:
    """The settings, while they are open."""
    if app.dialog != "settings":
        return
    viewport = imgui.get_main_viewport()
    width = min(WIDTH_EM * imgui.get_font_size(), 0.96 * viewport.size.x)
    # In the middle also when the font grows.
    imgui.set_next_window_pos(viewport.get_center(), imgui.Cond_.always, (0.5, 0.5))
    imgui.set_next_window_size_constraints((width, 0), (width, 0.94 * viewport.size.y))
    opened = imgui.begin(NAME, True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    _appearance(app)
    _controls(app)
    _start(app)
    imgui.spacing()
    if imgui.button("Reset all"):
        new = Preferences()
        names = ("theme", "font_size", "background", "keys", "mouse", "touchpad", "mouse_speed",
                 "invert_wheel", "smooth", "start_screen")  # fmt: skip
        app.prefer(**{name: getattr(new, name) for name in names})
    widgets.tooltip("Takes everything on this page back to how it was at first.")
    imgui.end()
    if not opened:
        app.dialog = None


def _appearance(app: AppState) -> None:
    preferences = app.preferences
    widgets.section("Appearance")
    chosen = widgets.combo(
        "Theme",
        preferences.theme,
        tuple(THEMES),
        "Colours of panels and menus; the picture keeps its own.",
        tuple(THEMES.values()),
    )
    if chosen is not None:
        app.prefer(theme=chosen)
    size = widgets.combo(
        "Font size",
        min(FONT_SIZES, key=lambda one: abs(float(one) - preferences.font_size)),
        FONT_SIZES,
        "Height of all text, px on a screen of 96 dpi.",
        [f"{one} px" for one in FONT_SIZES],
    )
    if size is not None:
        app.prefer(font_size=float(size))
    widgets.label("Background", "Colour behind the scene; the View page has gradients and panoramas.")
    changed, colour = imgui.color_edit3("##background", list(preferences.background))
    if changed:
        red, green, blue = (min(max(float(value), 0.0), 1.0) for value in colour)
        app.prefer(background=(red, green, blue), background_kind="colour")


def _controls(app: AppState) -> None:
    preferences = app.preferences
    widgets.section("Keys and mouse")
    keys = widgets.combo(
        "Keys", preferences.keys, PRESETS, "Keys as another program has them; F1 lists them.", PRESET_NAMES
    )
    if keys is not None:
        app.prefer(keys=keys)
    mouse = widgets.combo(
        "Mouse", preferences.mouse, PRESETS, "What drags do, as in another program.", PRESET_NAMES
    )
    if mouse is not None:
        app.prefer(mouse=mouse)
    drags = (f"{drag.text}: {ACTION_TEXTS[drag.action].lower()}" for drag in MOUSE[preferences.mouse])
    widgets.note("\n".join(drags))
    low, high = RANGES["mouse_speed"]
    speed = widgets.slider(
        "Mouse speed", preferences.mouse_speed, low, high, "How far a drag turns the view.", logarithmic=True
    )
    if speed is not None:
        app.prefer(mouse_speed=speed)
    touchpad = widgets.checkbox(
        "Touchpad",
        preferences.touchpad,
        "Two fingers turn the view, with Shift they slide it, and with Ctrl they go nearer and farther.",
    )
    if touchpad is not None:
        app.prefer(touchpad=touchpad)
    inverted = widgets.checkbox(
        "Invert the wheel", preferences.invert_wheel, "Up goes farther, instead of nearer."
    )
    if inverted is not None:
        app.prefer(invert_wheel=inverted)


def _start(app: AppState) -> None:
    widgets.section("Window")
    smooth = widgets.checkbox(
        "Smooth motion", app.preferences.smooth, "Shows a jump of the view as a short motion."
    )
    if smooth is not None:
        app.prefer(smooth=smooth)
    shown = widgets.checkbox(
        "Start screen", app.preferences.start_screen, "Shown where the program is started without a scene."
    )
    if shown is not None:
        app.prefer(start_screen=shown)
