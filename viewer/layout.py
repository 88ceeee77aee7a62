"""What is where: docks, menu bar, status bar, and what floats above."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from imgui_bundle import ImVec2, hello_imgui, imgui

from splatview.scene.user_dirs import config_folder
from splatview.viewer import dialogs, menus, overlays, viewport
from splatview.viewer import menus as palette
from splatview.viewer.dialogs import FileDialogs
from splatview.viewer.panels import accuracy, camera, edit, effects, history, rendering, scene, statistics
from splatview.viewer.panels import camera as bookmarks
from splatview.viewer.panels import history as restore
from splatview.viewer.panels import statistics as messages
from splatview.viewer.panels import training as training_panels
from splatview.viewer.platform import guarded
from splatview.viewer.state import Core

LAYOUT_FILE = "layout.ini"
TRAINING_LAYOUT_FILE = "training-layout.ini"
"""A window that trains has other panels, and its own arrangement of them."""

PANELS: tuple[tuple[str, str, Callable[[Core], None]], ...] = (
    ("Scene", "Upper", scene.show),
    ("Edit", "Upper", edit.show),
    ("Picture", "Upper", rendering.show),
    ("Accuracy", "Upper", accuracy.show),
    ("Effects", "Upper", effects.show),
    ("Camera", "Upper", camera.show),
    ("Views", "Lower", bookmarks.show_bookmarks),
    ("History", "Lower", history.show),
    ("Statistics", "Lower", statistics.show),
    ("Messages", "Lower", messages.show_messages),
)
"""Name, dock and contents of each panel."""

VIEW = "View"
"""The dock in the middle, which holds the picture."""


def runner_params(core: Core, size: tuple[int, int]) -> hello_imgui.RunnerParams:
    """hello_imgui's parameters but for the callbacks that `app` sets."""
    params = hello_imgui.RunnerParams()
    window = params.app_window_params
    window.window_title = title(core)
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
    layout = LAYOUT_FILE if core.training is None else TRAINING_LAYOUT_FILE
    params.ini_filename = str(config_folder() / layout)
    params.ini_filename_use_app_window_title = False
    try:
        config_folder().mkdir(parents=True, exist_ok=True)
    except OSError as error:
        params.ini_disable = True
        core.tell(f"{config_folder()}: cannot be made ({error.strerror}); the layout will not be kept")

    params.callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
    params.callbacks.show_menus = guarded(core, partial(menus.show, core))
    params.callbacks.show_status = guarded(core, partial(overlays.status_bar, core))
    params.docking_params = docking(core)
    return params


def docking(core: Core) -> hello_imgui.DockingParams:
    """The picture on the left, two stacks of panels on the right."""
    split = hello_imgui.DockingSplit
    params = hello_imgui.DockingParams()
    # Tabs can be closed and brought back from the Window menu; more buttons than that are clutter.
    tidy = imgui.internal.DockNodeFlagsPrivate_
    flags = tidy.no_window_menu_button | tidy.no_close_button
    params.docking_splits = [
        split("MainDockSpace", "Upper", imgui.Dir.right, 0.27 if core.training is None else 0.30, flags),
        split("Upper", "Lower", imgui.Dir.down, 0.34, flags),
    ]
    panels = PANELS
    if core.training is not None:
        params.docking_splits = [
            *params.docking_splits,
            split("MainDockSpace", training_panels.STRIP, imgui.Dir.down, 0.33, flags),
        ]
        panels = (*training_panels.PANELS, *PANELS)
    view = hello_imgui.DockableWindow(
        VIEW, "MainDockSpace", guarded(core, partial(show_view, core)), can_be_closed_=False
    )
    # hello_imgui would add padding around the picture; the window is begun by hand instead.
    view.call_begin_end = False
    view.include_in_view_menu = False
    # Assigned at once: the binding hands out copies of its lists.
    params.dockable_windows = [view, *(panel(core, *entry) for entry in panels)]
    params.main_dock_space_node_flags = imgui.DockNodeFlags_.auto_hide_tab_bar
    return params


def panel(core: Core, name: str, dock: str, contents: Callable[[Core], None]) -> hello_imgui.DockableWindow:
    made = hello_imgui.DockableWindow(name, dock, guarded(core, partial(contents, core)))
    made.is_visible = name not in core.preferences.closed_panels
    made.focus_window_at_next_frame = core.training is not None and name in training_panels.FIRST
    # hello_imgui would also remember that all were hidden for a moment.
    made.remember_is_visible = False
    return made


def closed_panels(core: Core) -> tuple[str, ...]:
    """Names of the panels that the user has closed, hidden ones not counted."""
    windows = hello_imgui.get_runner_params().docking_params.dockable_windows[1:]
    if core.open_panels is not None:
        return tuple(window.label for window in windows if window.label not in core.open_panels)
    return tuple(window.label for window in windows if not window.is_visible)


def show_view(core: Core) -> None:
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
        viewport.show(core)
        overlays.over_picture(core)
    imgui.end()


def show_floating(core: Core, files: FileDialogs) -> None:
    """Dialogs above everything."""
    dialogs.loading(core)
    dialogs.problem(core)
    dialogs.help_page(core)
    dialogs.screenshot(core)
    palette.show_palette(core)
    restore.show_restore(core)
    files.show()


def title(core: Core) -> str:
    return f"{core.scene.name} - splatview" if core.scene else "splatview"


def hide_or_show_panels(core: Core) -> None:
    """Makes what is visible follow `core.panels_hidden`; what the user had closed stays closed."""
    windows = hello_imgui.get_runner_params().docking_params.dockable_windows[1:]
    if core.panels_hidden and core.open_panels is None:
        core.open_panels = {window.label for window in windows if window.is_visible}
        for window in windows:
            window.is_visible = False
    elif not core.panels_hidden and core.open_panels is not None:
        for window in windows:
            window.is_visible = window.label in core.open_panels
        core.open_panels = None
