"""The start screen: open, train, the demo, and what was open lately, over the picture of a new window."""

from __future__ import annotations

import os
from pathlib import Path

import moderngl
from imgui_bundle import ImVec2, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.scene.errors import printable
from splatview.viewer import open as opening
from splatview.viewer import theme
from splatview.viewer.commands import keys_of
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState, Feature
from splatview.viewer.thumbnails import HEIGHT, WIDTH, Thumbnails, thumbnail_file
from splatview.viewer.training import start

NAME = "Start"
"""ImGui's name of its window, and the value of `AppState.dialog` in lower case."""

WIDTH_EM = 52.0
ACTIONS_EM = 17.0
"""Width of the screen and of its left column, in font heights."""

TITLE_SIZE = 1.9
"""Of the program's name, in font heights."""

SMALL = 0.86
"""Of a card's explanation, in font heights."""

COLUMNS, MOST_RECENT = 3, 6

LOOK_SECONDS = 2.0
"""Between two looks at whether recent files still exist."""


class StartScreen(Feature):
    """Pictures of the recent scenes, while the start screen is open."""

    def __init__(self) -> None:
        self.thumbnails = Thumbnails()
        self._there: dict[str, bool] = {}
        self._look_due = 0.0

    def exists(self, app: AppState, name: str) -> bool:
        """Whether the file is there, as of a moment ago: a network may be slow to say."""
        if app.now() >= self._look_due:
            self._look_due = app.now() + LOOK_SECONDS
            self._there = {recent: os.path.exists(recent) for recent in app.preferences.recent}
        return self._there.get(name, False)

    def before_frame(self, app: AppState) -> None:
        if app.dialog != "start":
            self.thumbnails.forget()
            self._look_due = 0.0

    def busy(self, app: AppState) -> bool:
        return app.dialog == "start" and self.thumbnails.busy

    def close(self, app: AppState) -> None:
        self.thumbnails.forget()


FLAGS = (
    imgui.WindowFlags_.no_docking
    | imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.always_auto_resize
    | imgui.WindowFlags_.no_scrollbar
)


def show(app: AppState) -> None:
    """The screen, while it is open; a click beside it closes it, as Escape does."""
    if app.dialog != "start":
        return
    viewport, em = imgui.get_main_viewport(), imgui.get_font_size()
    width = min(WIDTH_EM * em, viewport.size.x * 0.94)
    imgui.set_next_window_pos(viewport.get_center(), imgui.Cond_.always, (0.5, 0.5))
    imgui.set_next_window_size_constraints((width, 0), (width, viewport.size.y * 0.94))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(1.4 * em, 1.2 * em))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.6 * em)
    imgui.push_style_var(imgui.StyleVar_.window_border_size, 1.0)
    imgui.begin(NAME, None, FLAGS)
    imgui.pop_style_var(3)
    _headline(app)
    left = min(ACTIONS_EM * em, 0.42 * imgui.get_content_region_avail().x)
    imgui.push_style_var(imgui.StyleVar_.cell_padding, ImVec2(0.7 * em, 0))
    if imgui.begin_table("##start", 2, imgui.TableFlags_.no_pad_outer_x):
        imgui.table_setup_column("actions", imgui.TableColumnFlags_.width_fixed, left)
        imgui.table_setup_column("recent", imgui.TableColumnFlags_.width_stretch)
        imgui.table_next_column()
        _actions(app)
        imgui.table_next_column()
        _recent(app)
        imgui.end_table()
    imgui.pop_style_var()
    imgui.spacing()
    _foot(app)
    beside = imgui.is_mouse_clicked(0) and not imgui.is_window_hovered(
        imgui.HoveredFlags_.root_and_child_windows
        | imgui.HoveredFlags_.allow_when_blocked_by_active_item  # a press on one of its own buttons
    )
    imgui.end()
    if beside and not imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        app.dialog = None


def _headline(app: AppState) -> None:
    imgui.push_font(None, imgui.get_style().font_size_base * TITLE_SIZE)
    imgui.text_unformatted("splatview")
    imgui.pop_font()
    imgui.text_colored(theme.QUIET, "Look at, clean up and train Gaussian splats")
    imgui.dummy(ImVec2(0, 0.4 * imgui.get_font_size()))


def _actions(app: AppState) -> None:
    lacks = app.feature(start.TrainingStart).lacks
    cards = (
        ("open", icons.ICON_FA_FOLDER_OPEN, "Open a scene", "PLY, SPZ, SOG, splat, glTF ...", "",
         opening.choose_scene),
        ("train", icons.ICON_FA_CAMERA, "Train on photos", "A folder of photos with their cameras", lacks,
         start.choose_photos),
        ("demo", icons.ICON_FA_MOUNTAIN_SUN, "Demo", "A small scene to try things on", "", _demo),
    )  # fmt: skip
    for name, icon, title, text, lacking, run in cards:
        keys = keys_of("open") if name == "open" else ""
        if card(name, icon, title, text, keys, enabled=not lacking):
            app.post(run)
        widgets.tooltip(lacking)
    imgui.dummy(ImVec2(0, 0.2 * imgui.get_font_size()))
    widgets.note(lacks if lacks else "Or drop files and folders on the window.")


def card(name: str, icon: str, title: str, text: str, keys: str, *, enabled: bool = True) -> bool:
    """A wide button with an icon, a title and a line that explains; whether it was pressed."""
    em = imgui.get_font_size()
    size = ImVec2(imgui.get_content_region_avail().x, 3.5 * em)
    low = imgui.get_cursor_screen_pos()
    imgui.begin_disabled(not enabled)
    pressed = imgui.invisible_button(f"###{name}", size)
    hovered, held = imgui.is_item_hovered(), imgui.is_item_active()
    ground = imgui.Col_.button_active if held else imgui.Col_.button_hovered if hovered else imgui.Col_.button
    draw, high = imgui.get_window_draw_list(), ImVec2(low.x + size.x, low.y + size.y)
    draw.add_rect_filled(low, high, imgui.get_color_u32(ground), 0.4 * em)
    accent = imgui.get_color_u32(ImVec4(*theme.ACCENT, 1))
    draw.add_text(imgui.get_font(), 1.5 * em, ImVec2(low.x + 0.9 * em, low.y + 1.0 * em), accent, icon)
    ink, quiet = imgui.get_color_u32(imgui.Col_.text), imgui.get_color_u32(theme.QUIET)
    left = low.x + 3.5 * em
    room = high.x - 0.5 * em - left
    draw.add_text(ImVec2(left, low.y + 0.6 * em), ink, widgets.fitting(title, room))
    shown = widgets.fitting(text, room / SMALL)
    draw.add_text(imgui.get_font(), SMALL * em, ImVec2(left, low.y + 1.85 * em), quiet, shown)
    at = high.x - imgui.calc_text_size(keys).x - 0.8 * em
    if keys and at > left + imgui.calc_text_size(title).x + 0.5 * em:
        draw.add_text(ImVec2(at, low.y + 0.6 * em), quiet, keys)
    imgui.end_disabled()
    widgets.tooltip(text if shown != text else "")
    return pressed


def _demo(app: AppState) -> None:
    """The demo, which stands behind the screen already where nothing else was opened."""
    app.dialog = None
    if app.scene.paths or not (app.is_open or app.loading is not None):
        opening.begin_demo(app)


def _recent(app: AppState) -> None:
    imgui.text_colored(theme.QUIET, "Recent")
    names = app.preferences.recent[:MOST_RECENT]
    if not names:
        widgets.note("Scenes that you open are shown here.")
        return
    screen, gap = app.feature(StartScreen), imgui.get_style().item_spacing.x
    width = (imgui.get_content_region_avail().x - (COLUMNS - 1) * gap) / COLUMNS
    for number, name in enumerate(names):
        if number % COLUMNS:
            imgui.same_line()
        there = screen.exists(app, name)
        texture = screen.thumbnails.get(thumbnail_file(Path(name)))
        if picture_button(str(number), texture, Path(name).name, width, faded=not there):
            if there:
                app.post(opening.open_paths, [Path(name)])
            else:
                app.post(_forget, name)
        widgets.tooltip(name if there else f"{name}\nis no longer there; a click takes it off the list")


def picture_button(
    name: str, texture: moderngl.Texture | None, text: str, width: float, *, faded: bool = False
) -> bool:
    """A picture with a line of text below, as one button of `width`; whether it was pressed."""
    em = imgui.get_font_size()
    height = width * HEIGHT / WIDTH
    low = imgui.get_cursor_screen_pos()
    pressed = imgui.invisible_button(f"###recent {name}", ImVec2(width, height + 1.4 * em))
    high, corner = ImVec2(low.x + width, low.y + height), 0.3 * em
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(low, high, imgui.get_color_u32(imgui.Col_.frame_bg), corner)
    if texture is not None:
        across, down = texture.width / width, texture.height / height
        fit = min(across, down)  # fills the place, and what is over is cut off evenly
        u, v = fit / across / 2, fit / down / 2
        tint = imgui.get_color_u32(ImVec4(1, 1, 1, 0.3 if faded else 1))
        draw.add_image_rounded(
            imgui.ImTextureRef(texture.glo), low, high, (0.5 - u, 0.5 - v), (0.5 + u, 0.5 + v), tint, corner
        )
    else:
        icon, size = icons.ICON_FA_CUBE, 1.8 * em
        quiet = imgui.get_color_u32(imgui.Col_.text_disabled, 0.35 if faded else 0.7)
        place = ImVec2(low.x + (width - size) / 2, low.y + (height - size) / 2)
        draw.add_text(imgui.get_font(), size, place, quiet, icon)
    if imgui.is_item_hovered():
        edge = imgui.get_color_u32(ImVec4(*theme.ACCENT, 1))
        draw.add_rect(low, high, edge, corner, max(0.12 * em, 1.0))
    ink = imgui.get_color_u32(imgui.Col_.text_disabled if faded else imgui.Col_.text)
    draw.push_clip_rect(ImVec2(low.x, high.y), ImVec2(high.x, high.y + 1.5 * em), True)
    draw.add_text(ImVec2(low.x + 0.1 * em, high.y + 0.2 * em), ink, fitted(printable(text), width))
    draw.pop_clip_rect()
    return pressed


def fitted(text: str, room: float) -> str:
    """`text`, its middle left out where it is wider than `room`: the end tells files apart, too."""
    if imgui.calc_text_size(text).x <= room:
        return text
    for kept in range(len(text) - 1, 3, -1):
        shorter = f"{text[: (kept + 1) // 2]}...{text[-(kept // 2) :]}"
        if imgui.calc_text_size(shorter).x <= room:
            return shorter
    return "..."


def _forget(app: AppState, name: str) -> None:
    app.prefer(recent=tuple(recent for recent in app.preferences.recent if recent != name))


def _foot(app: AppState) -> None:
    if app.loading is not None:
        widgets.note("The demo behind this is being made ...")
    changed, value = imgui.checkbox("Show this at the start", app.preferences.start_screen)
    if changed:
        app.prefer(start_screen=value)
    hint = "Esc closes"
    width = imgui.calc_text_size(hint).x
    imgui.same_line(imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x - width)
    imgui.text_colored(theme.QUIET, hint)
