"""The layout: the picture, the inspector with its rail, the bottom strip, the status bar, dialogs above them.

Nothing docks: each part has its place, so that all of them are found where they were. The inspector's width
and the strip's height are dragged. (Docked panels were tried: seven tabs shared a quarter of the width, and
those with the figures were scrolled off it.)
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.scene.errors import printable
from splatview.scene.user_dirs import config_folder
from splatview.viewer import dialogs, menus, overlays, palette, status_bar, theme, toolbar, viewport
from splatview.viewer.commands import COMMANDS
from splatview.viewer.dialogs import FileDialogs
from splatview.viewer.editing.saving import has_unsaved_edits
from splatview.viewer.editing.session import session_of
from splatview.viewer.entries import Panel, arrange
from splatview.viewer.panels import (
    accuracy,
    edit,
    export,
    film,
    history,
    photos,
    rendering,
    save_questions,
    scene,
    settings,
    start_screen,
    statistics,
    timeline,
    train_form,
    widgets,
)
from splatview.viewer.panels import training as training_panels
from splatview.viewer.platform import guarded
from splatview.viewer.preferences import RANGES
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining

LAYOUT_FILE = "layout.ini"
"""Place and size of the window, as hello_imgui keeps them."""

VIEW = "View"
"""The window that holds the picture."""


PAGES = (
    Panel(name="Scene", window="Scene", icon=icons.ICON_FA_LAYER_GROUP, show=scene.show),
    Panel(name="Edit", window="Edit", icon=icons.ICON_FA_PEN_TO_SQUARE, show=edit.show),
    Panel(name="View", window="Viewing", icon=icons.ICON_FA_EYE, show=rendering.show),
    Panel(name="Accuracy", window="Accuracy", icon=icons.ICON_FA_BULLSEYE, show=accuracy.show),
    Panel(name="Train", window="Training", icon=icons.ICON_FA_GRADUATION_CAP, show=training_panels.show),
)
"""Pages of the inspector, as the rail has them."""

STRIP = (
    Panel(name="History", window="History", icon=icons.ICON_FA_CLOCK_ROTATE_LEFT, show=history.show),
    Panel(name="Film", window="Film", icon=icons.ICON_FA_FILM, show=film.show),
    Panel(
        name="Curves",
        window="Curves",
        icon=icons.ICON_FA_CHART_LINE,
        show=training_panels.show_curves,
        training=True,
    ),
    Panel(
        name="Compare",
        window="Compare",
        icon=icons.ICON_FA_IMAGES,
        show=photos.show_comparison,
        training=True,
    ),
    Panel(name="Log", window="Log", icon=icons.ICON_FA_LIST, show=statistics.show_messages),
)
"""Panels of the bottom strip, of which one at a time is open."""


def runner_params(app: AppState, size: tuple[int, int]) -> hello_imgui.RunnerParams:
    """hello_imgui's parameters but for the callbacks that `app` sets."""
    params = hello_imgui.RunnerParams()
    window = params.app_window_params
    window.window_title = title(app)
    window.window_geometry.size = size
    window.restore_previous_geometry = True

    style = params.imgui_window_params
    style.default_imgui_window_type = hello_imgui.DefaultImGuiWindowType.no_default_window
    style.show_menu_bar = True
    style.show_menu_app = style.show_menu_view = False
    style.show_status_bar = False
    style.remember_theme = style.remember_status_bar_settings = False

    params.ini_folder_type = hello_imgui.IniFolderType.absolute_path
    params.ini_filename = printable(str(config_folder() / LAYOUT_FILE))
    params.ini_filename_use_app_window_title = False
    try:
        config_folder().mkdir(parents=True, exist_ok=True)
    except OSError as error:
        params.ini_disable = True
        app.tell(f"{config_folder()}: cannot be made ({error.strerror}); the layout will not be kept")

    params.callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
    params.callbacks.show_menus = guarded(app, partial(menus.show, app))
    return params


@dataclass(frozen=True)
class Rectangle:
    """A part of the window, in ImGui's units from the screen's corner."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True, kw_only=True)
class Places:
    """Where the parts of the window are."""

    view: Rectangle
    inspector: Rectangle | None
    rail: Rectangle | None
    strip: Rectangle | None
    status: Rectangle


RAIL_EM = 4.4
"""Width of the rail, in font heights."""

EDGE_EM = 0.3
"""Width of the edges that are dragged, in font heights."""

LEAST_VIEW_EM = 12.0
"""What is left to the picture each way, in font heights, before inspector and strip are smaller than asked
for."""

LEAST_STRIP_EM = 5.0
"""Height that the bottom strip has all the same, in font heights."""

MOST_STRIP = 0.6
"""Share of the height that the bottom strip may take."""


def places(area: Rectangle, em: float, *, inspector: float, strip: float, rail: bool) -> Places:
    """The parts of `area` at a font height of `em`; `inspector` is its width and `strip` its height in font
    heights, 0 where it is closed."""
    status_height = round(em * 1.9)
    height = area.height - status_height
    rail_width = round(em * RAIL_EM) if rail else 0
    width = min(inspector * em, max(area.width - rail_width - LEAST_VIEW_EM * em, RANGES_LOW * em))
    width = round(width) if inspector else 0
    left = max(height - LEAST_VIEW_EM * em, LEAST_STRIP_EM * em)
    low = round(min(strip * em, MOST_STRIP * height, left)) if strip else 0
    view_width = max(area.width - rail_width - width, 1)
    right = area.x + view_width
    return Places(
        view=Rectangle(area.x, area.y, view_width, max(height - low, 1)),
        inspector=Rectangle(right, area.y, width, height) if width else None,
        rail=Rectangle(right + width, area.y, rail_width, height) if rail else None,
        strip=Rectangle(area.x, area.y + height - low, view_width, low) if low else None,
        status=Rectangle(area.x, area.y + height, area.width, status_height),
    )


RANGES_LOW = RANGES["inspector_width"][0]


def available(app: AppState, panels: tuple[Panel, ...]) -> tuple[Panel, ...]:
    training = app.find(LiveTraining) is not None
    return tuple(panel for panel in panels if training or not panel.training)


def open_panel(app: AppState, panels: tuple[Panel, ...], name: str) -> Panel | None:
    """The one of `panels` that is called `name` and can be shown; None where none is or all are hidden."""
    if app.panels_hidden:
        return None
    return next((panel for panel in available(app, panels) if panel.name == name), None)


def show(app: AppState) -> None:
    """All parts of the window but the menu bar and the dialogs."""
    follow_section(app)
    viewport_now = imgui.get_main_viewport()
    corner, size = viewport_now.work_pos, viewport_now.work_size
    page, strip = (
        open_panel(app, PAGES, app.page),
        open_panel(app, STRIP, app.strip),
    )
    parts = places(
        Rectangle(corner.x, corner.y, size.x, size.y),
        imgui.get_font_size(),
        inspector=app.preferences.inspector_width if page else 0.0,
        strip=app.preferences.strip_height if strip else 0.0,
        rail=not app.panels_hidden,
    )
    show_view(app, parts.view)
    if page is not None and parts.inspector is not None:
        panel_window(app, page, parts.inspector)
        drag_inspector(app, parts.inspector)
    if parts.rail is not None:
        rail(app, parts.rail)
    if strip is not None and parts.strip is not None:
        panel_window(app, strip, parts.strip)
        drag_strip(app, parts.strip)
    with fixed("##status", parts.status):
        guarded(app, partial(status_bar.show, app, available(app, STRIP)))()


FIXED = (
    imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_collapse
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_docking
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_bring_to_front_on_focus
    | imgui.WindowFlags_.no_nav
)
"""Of windows that have their place: dialogs stay above them."""


@contextmanager
def fixed(
    name: str, place: Rectangle, *, scrolls: bool = False, padding: ImVec2 | None = None
) -> Iterator[bool]:
    """A window at a place of the layout; gives whether there is something to draw."""
    imgui.set_next_window_pos(ImVec2(place.x, place.y))
    imgui.set_next_window_size(ImVec2(place.width, place.height))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.push_style_var(imgui.StyleVar_.window_min_size, ImVec2(1, 1))
    if padding is not None:
        imgui.push_style_var(imgui.StyleVar_.window_padding, padding)
    still = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
    visible = imgui.begin(name, None, FIXED if scrolls else FIXED | still)[0]
    imgui.pop_style_var(2 if padding is None else 3)
    try:
        yield visible
    finally:
        imgui.end()


def show_view(app: AppState, place: Rectangle) -> None:
    with fixed(VIEW, place, padding=ImVec2(0, 0)) as visible:
        if visible:
            guarded(app, partial(view_contents, app))()


def view_contents(app: AppState) -> None:
    with timeline.below(app):
        viewport.show(app)
        film.over_picture(app)
        overlays.over_picture(app)
        toolbar.over_picture(app)


def panel_window(app: AppState, panel: Panel, place: Rectangle) -> None:
    with fixed(panel.window, place, scrolls=True) as visible:
        if visible:
            guarded(app, partial(panel.show, app))()


def drag_inspector(app: AppState, place: Rectangle) -> None:
    dx = edge("##inspector edge", Rectangle(place.x, place.y, 0, place.height), upright=True)
    if dx:
        low, high = RANGES["inspector_width"]
        width = (place.width - dx) / imgui.get_font_size()
        app.prefer(inspector_width=min(max(width, low), high))


def drag_strip(app: AppState, place: Rectangle) -> None:
    dy = edge("##strip edge", Rectangle(place.x, place.y, place.width, 0), upright=False)
    if dy:
        low, high = RANGES["strip_height"]
        height = (place.height - dy) / imgui.get_font_size()
        app.prefer(strip_height=min(max(height, low), high))


def edge(name: str, line: Rectangle, *, upright: bool) -> float:
    """A line between two parts that can be dragged; by how much it is dragged in this frame."""
    thick = max(round(imgui.get_font_size() * EDGE_EM), 3)
    place = (
        Rectangle(line.x, line.y, thick, line.height)
        if upright
        else Rectangle(line.x, line.y, line.width, thick)
    )
    moved = 0.0
    imgui.push_style_color(imgui.Col_.window_bg, ImVec4(0, 0, 0, 0))
    with fixed(name, place, padding=ImVec2(0, 0)):
        imgui.invisible_button("##drag", ImVec2(max(place.width, 1), max(place.height, 1)))
        active = imgui.is_item_active()
        if active or imgui.is_item_hovered():
            imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew if upright else imgui.MouseCursor_.resize_ns)
        if active:
            delta = imgui.get_io().mouse_delta
            moved = delta.x if upright else delta.y
        colour = imgui.get_color_u32(
            imgui.Col_.separator_active
            if active
            else imgui.Col_.separator_hovered
            if imgui.is_item_hovered()
            else imgui.Col_.separator
        )
        end = ImVec2(place.x, place.y + place.height) if upright else ImVec2(place.x + place.width, place.y)
        imgui.get_window_draw_list().add_line(ImVec2(place.x, place.y), end, colour, 2 if active else 1)
    imgui.pop_style_color()
    return moved


LABEL_SIZE = 0.78
"""Of the rail's labels, in font heights."""


def rail(app: AppState, place: Rectangle) -> None:
    """A column of pages to choose from; a click on the open one closes the inspector."""
    imgui.push_style_color(imgui.Col_.window_bg, imgui.get_style_color_vec4(imgui.Col_.menu_bar_bg))
    with fixed("##rail", place, padding=ImVec2(0, 0)):
        em = imgui.get_font_size()
        height = min(3.6 * em, place.height / len(PAGES))
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(0, 0))
        for page in available(app, PAGES):
            if rail_entry(page, ImVec2(place.width, height), chosen=app.page == page.name):
                app.post(COMMANDS[f"page_{page.name.lower()}"].run)
            widgets.command_tooltip(app, f"page_{page.name.lower()}")
        imgui.pop_style_var()
    imgui.pop_style_color()


def rail_entry(page: Panel, size: ImVec2, *, chosen: bool) -> bool:
    """An icon above its label, bright where it is chosen; whether it was clicked."""
    low = imgui.get_cursor_screen_pos()
    clicked = imgui.invisible_button(page.name, size)
    high, em = ImVec2(low.x + size.x, low.y + size.y), imgui.get_font_size()
    draw, font = imgui.get_window_draw_list(), imgui.get_font()
    if chosen:
        draw.add_rect_filled(low, high, imgui.get_color_u32(imgui.Col_.window_bg, 1.0))
        ground = imgui.get_style_color_vec4(imgui.Col_.frame_bg)
        draw.add_rect_filled(low, high, imgui.get_color_u32(ground))
        bar = ImVec2(low.x + max(em * 0.16, 2), high.y)
        draw.add_rect_filled(low, bar, imgui.get_color_u32(ImVec4(*theme.ACCENT, 1)))
    elif imgui.is_item_hovered():
        draw.add_rect_filled(low, high, imgui.get_color_u32(imgui.Col_.frame_bg, 0.6))
    bright = chosen or imgui.is_item_hovered()
    ink = imgui.get_color_u32(imgui.Col_.text) if bright else imgui.get_color_u32(theme.QUIET)
    icon_size, label_size = min(1.25 * em, size.y * 0.42), min(LABEL_SIZE * em, size.y * 0.3)
    gap = min(0.3 * em, size.y * 0.08)
    top = low.y + (size.y - icon_size - gap - label_size) / 2
    for text, height, y in (
        (page.icon, icon_size, top),
        (page.name, label_size, top + icon_size + gap),
    ):
        width = imgui.calc_text_size(text).x * height / em
        draw.add_text(font, height, ImVec2(low.x + (size.x - width) / 2, y), ink, text)
    return clicked


def show_floating(app: AppState, files: FileDialogs) -> None:
    """Dialogs above everything."""
    dialogs.loading(app)
    dialogs.problem(app)
    dialogs.help_page(app)
    dialogs.screenshot(app)
    dialogs.recent(app)
    palette.show(app)
    history.show_restore(app)
    start_screen.show(app)
    train_form.show(app)
    settings.show(app)
    export.show_dialog(app)
    film.show_dialog(app)
    save_questions.show(app)
    files.show()


UNSAVED_MARK = "\N{BULLET}"
"""Before the scene's name in the title while edits are in no file."""


def title(app: AppState) -> str:
    if not app.is_open:
        return "splatview"
    mark = f"{UNSAVED_MARK} " if has_unsaved_edits(app) else ""
    return f"{mark}{printable(app.scene.name)} - splatview"


def follow_section(app: AppState) -> None:
    """Opens the Edit page where a command asks for a section of it."""
    session = session_of(app)
    if session is not None and session.forms.open_section:
        if app.page != "Edit":
            arrange(app, page="Edit")
        app.panels_hidden = False
