"""The layout: docks and their panels, menu bar, status bar, dialogs above them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from imgui_bundle import ImVec2, hello_imgui, imgui

from splatview.scene.errors import printable
from splatview.scene.user_dirs import config_folder
from splatview.viewer import dialogs, menus, overlays, viewport
from splatview.viewer.dialogs import FileDialogs
from splatview.viewer.editing.saving import has_unsaved_edits
from splatview.viewer.editing.session import session_of
from splatview.viewer.panels import (
    accuracy,
    camera,
    edit,
    effects,
    export,
    history,
    rendering,
    save_questions,
    scene,
    statistics,
    timeline,
)
from splatview.viewer.panels import training as training_panels
from splatview.viewer.platform import guarded
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining

LAYOUT_FILE = "layout.ini"
TRAINING_LAYOUT_FILE = "training-layout.ini"
"""A window that trains has other panels, and its own arrangement of them."""

PANELS: tuple[tuple[str, str, Callable[[AppState], None]], ...] = (
    ("Scene", "Upper", scene.show),
    ("Edit", "Upper", edit.show),
    ("Picture", "Upper", rendering.show),
    ("Accuracy", "Upper", accuracy.show),
    ("Effects", "Upper", effects.show),
    ("Camera", "Upper", camera.show),
    ("Views", "Lower", camera.show_bookmarks),
    ("History", "Lower", history.show),
    ("Statistics", "Lower", statistics.show),
    ("Messages", "Lower", statistics.show_messages),
)
"""Name, dock and contents of each panel."""

VIEW = "View"
"""The dock in the middle, which holds the picture."""


def runner_params(app: AppState, size: tuple[int, int]) -> hello_imgui.RunnerParams:
    """hello_imgui's parameters but for the callbacks that `app` sets."""
    params = hello_imgui.RunnerParams()
    window = params.app_window_params
    window.window_title = title(app)
    window.window_geometry.size = size
    window.restore_previous_geometry = True

    style = params.imgui_window_params
    style.default_imgui_window_type = hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
    style.show_menu_bar = True
    style.show_menu_app = style.show_menu_view = False
    style.show_status_bar = True
    style.show_status_fps = False
    style.remember_theme = style.remember_status_bar_settings = False

    params.ini_folder_type = hello_imgui.IniFolderType.absolute_path
    layout = LAYOUT_FILE if app.find(LiveTraining) is None else TRAINING_LAYOUT_FILE
    params.ini_filename = printable(str(config_folder() / layout))
    params.ini_filename_use_app_window_title = False
    try:
        config_folder().mkdir(parents=True, exist_ok=True)
    except OSError as error:
        params.ini_disable = True
        app.tell(f"{config_folder()}: cannot be made ({error.strerror}); the layout will not be kept")

    params.callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
    params.callbacks.show_menus = guarded(app, partial(menus.show, app))
    params.callbacks.show_status = guarded(app, partial(overlays.status_bar, app))
    params.docking_params = docking(app)
    return params


def docking(app: AppState) -> hello_imgui.DockingParams:
    """The picture on the left, two stacks of panels on the right."""
    split, training = hello_imgui.DockingSplit, app.find(LiveTraining)
    params = hello_imgui.DockingParams()
    # Tabs can be closed and brought back from the Window menu; more buttons than that are clutter.
    tidy = imgui.internal.DockNodeFlagsPrivate_
    flags = tidy.no_window_menu_button | tidy.no_close_button
    params.docking_splits = [
        split("MainDockSpace", "Upper", imgui.Dir.right, 0.27 if training is None else 0.30, flags),
        split("Upper", "Lower", imgui.Dir.down, 0.34, flags),
    ]
    panels = PANELS
    if training is not None:
        params.docking_splits = [
            *params.docking_splits,
            split("MainDockSpace", training_panels.STRIP, imgui.Dir.down, 0.33, flags),
        ]
        panels = (*training_panels.panels(training), *PANELS)
    view = hello_imgui.DockableWindow(
        VIEW, "MainDockSpace", guarded(app, partial(show_view, app)), can_be_closed_=False
    )
    # hello_imgui would add padding around the picture; the window is begun by hand instead.
    view.call_begin_end = False
    view.include_in_view_menu = False
    # Assigned at once: the binding hands out copies of its lists.
    params.dockable_windows = [view, *(panel(app, *entry) for entry in panels)]
    params.main_dock_space_node_flags = imgui.DockNodeFlags_.auto_hide_tab_bar
    return params


def panel(
    app: AppState, name: str, dock: str, contents: Callable[[AppState], None]
) -> hello_imgui.DockableWindow:
    made = hello_imgui.DockableWindow(name, dock, guarded(app, partial(contents, app)))
    made.is_visible = name not in app.preferences.closed_panels
    made.focus_window_at_next_frame = app.find(LiveTraining) is not None and name in training_panels.FIRST
    # hello_imgui would also remember that all were hidden for a moment.
    made.remember_is_visible = False
    return made


def closed_panels(app: AppState) -> tuple[str, ...]:
    """Names of the panels that the user has closed, hidden ones not counted."""
    windows = hello_imgui.get_runner_params().docking_params.dockable_windows[1:]
    if app.open_panels is not None:
        return tuple(window.label for window in windows if window.label not in app.open_panels)
    return tuple(window.label for window in windows if not window.is_visible)


def show_view(app: AppState) -> None:
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(0, 0))
    flags = (
        imgui.WindowFlags_.no_scrollbar
        | imgui.WindowFlags_.no_scroll_with_mouse
        | imgui.WindowFlags_.no_move
        | imgui.WindowFlags_.no_collapse
    )
    visible = imgui.begin(VIEW, None, flags)[0]
    imgui.pop_style_var()
    if visible:
        with timeline.below(app):
            viewport.show(app)
            overlays.over_picture(app)
    imgui.end()


def show_floating(app: AppState, files: FileDialogs) -> None:
    """Dialogs above everything."""
    dialogs.loading(app)
    dialogs.problem(app)
    dialogs.help_page(app)
    dialogs.screenshot(app)
    menus.show_palette(app)
    history.show_restore(app)
    export.show_dialog(app)
    save_questions.show(app)
    files.show()


UNSAVED_MARK = "\N{BULLET}"
"""Before the scene's name in the title while edits are in no file."""


def title(app: AppState) -> str:
    if not app.is_open:
        return "splatview"
    mark = f"{UNSAVED_MARK} " if has_unsaved_edits(app) else ""
    return f"{mark}{printable(app.scene.name)} - splatview"


def hide_or_show_panels(app: AppState) -> None:
    """Makes what is visible follow `app.panels_hidden`; what the user had closed stays closed, but where all
    are put back. Brings the Edit panel to the front where a section of it is to open."""
    params = hello_imgui.get_runner_params().docking_params
    windows = params.dockable_windows[1:]
    if app.panels_reset:
        app.panels_reset, params.layout_reset = False, True
        for window in windows:
            window.is_visible = True
    if app.panels_hidden and app.open_panels is None:
        app.open_panels = {window.label for window in windows if window.is_visible}
        for window in windows:
            window.is_visible = False
    elif not app.panels_hidden and app.open_panels is not None:
        for window in windows:
            window.is_visible = window.label in app.open_panels
        app.open_panels = None
    session = session_of(app)
    if session is not None and session.forms.open_section and not app.panels_hidden:
        edit_panel = next(window for window in windows if window.label == "Edit")
        edit_panel.is_visible = edit_panel.focus_window_at_next_frame = True
