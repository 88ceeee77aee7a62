"""Windows that open over the docks: progress, errors, the help page, saving a picture."""

from __future__ import annotations

from collections.abc import Iterable

from imgui_bundle import ImVec4, imgui

from . import saving, theme
from .core import Core
from .panels import widgets
from .shortcuts import MOUSE, SHORTCUTS


def centred(width_em: float) -> None:
    """Puts the next window into the middle, no larger than the program's."""
    viewport = imgui.get_main_viewport()
    imgui.set_next_window_pos(viewport.get_center(), imgui.Cond_.appearing, (0.5, 0.5))
    imgui.set_next_window_size_constraints((0, 0), (viewport.size.x * 0.96, viewport.size.y * 0.9))
    imgui.set_next_window_size((imgui.get_font_size() * width_em, 0), imgui.Cond_.appearing)


DIALOG_FLAGS = (
    imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.no_saved_settings
)


LOADING_SHOWN_AFTER = 0.3
"""Seconds: what is quicker than this would only flicker."""


def loading(core: Core) -> None:
    """Progress of the scene on its way, with a button to stop it."""
    if core.loading is None or core.now() - core.loading.began < LOADING_SHOWN_AFTER:
        return
    centred(24)
    imgui.begin("Loading", None, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)
    imgui.text_unformatted(f"{core.loading.stage} {core.loading.name}")
    progress = core.loading.progress
    share, text = (-imgui.get_time(), "") if progress is None else (progress, f"{progress:.0%}")
    imgui.progress_bar(share, (imgui.get_font_size() * 22, 0), text)
    widgets.action_button(core, "Cancel", "cancel")
    imgui.end()


def problem(core: Core) -> None:
    """An error that the user is to read; the scene behind it is as it was."""
    if core.problem is None:
        return
    name = "That did not work"
    if not imgui.is_popup_open(name):
        imgui.open_popup(name)
    centred(30)
    if imgui.begin_popup_modal(name, None, DIALOG_FLAGS)[0]:
        imgui.push_text_wrap_pos(0)
        imgui.text_unformatted(core.problem)
        imgui.pop_text_wrap_pos()
        imgui.spacing()
        if imgui.button("OK", (imgui.get_font_size() * 6, 0)) or imgui.is_key_pressed(imgui.Key.enter):
            core.problem = None
            imgui.close_current_popup()
        imgui.set_item_default_focus()
        imgui.end_popup()


HELP_COLUMNS = (
    ("Mouse", "Moving", "Navigation"),
    ("Camera", "File"),
    ("Select", "Edit"),
    ("Picture", "Window", "Training"),
)
"""Groups of the shortcut table, and the mouse, as the help page sets them."""


def help_page(core: Core) -> None:
    """All keys, from the one table that binds them."""
    if core.dialog != "help":
        return
    centred(84)
    opened = imgui.begin("Keys and mouse", True, DIALOG_FLAGS)[1]
    if imgui.begin_table("help", len(HELP_COLUMNS)):
        for column in HELP_COLUMNS:
            imgui.table_next_column()
            for group in column:
                rows = [(", ".join(s.keys), s.text) for s in SHORTCUTS if s.group == group and s.keys]
                key_table(group, MOUSE if group == "Mouse" else rows)
        imgui.end_table()
    imgui.end()
    if not opened:
        core.dialog = None


def key_table(name: str, rows: Iterable[tuple[str, str]]) -> None:
    imgui.separator_text(name)
    if imgui.begin_table(name, 2):
        imgui.table_setup_column("key", imgui.TableColumnFlags_.width_fixed, imgui.get_font_size() * 8)
        imgui.table_setup_column("text", imgui.TableColumnFlags_.width_stretch)
        for keys, text in rows:
            imgui.table_next_column()
            imgui.text_colored(ImVec4(*theme.ACCENT, 1), keys)
            imgui.table_next_column()
            imgui.push_text_wrap_pos(0)
            imgui.text_unformatted(text)
            imgui.pop_text_wrap_pos()
        imgui.end_table()


def screenshot(core: Core) -> None:
    """Size and place of a picture to save."""
    if core.dialog != "screenshot":
        return
    centred(24)
    opened = imgui.begin("Save a picture", True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    width, height = core.screenshot_size or core.picture_size
    widgets.label("Size", "Pixels of the saved picture; the window shows its middle.")
    changed, size = imgui.input_int2("##size", [width, height])
    if changed:
        width, height = (min(max(int(side), 1), saving.MAX_SIDE) for side in size)
        core.screenshot_size = (width, height)
    for name, factor in (("As seen", 1), ("2 x", 2), ("4 x", 4)):
        if factor > 1:
            imgui.same_line()
        if imgui.button(name):
            w, h = core.picture_size
            core.screenshot_size = (min(w * factor, saving.MAX_SIDE), min(h * factor, saving.MAX_SIDE))
    imgui.spacing()
    if imgui.button("Beside the scene"):
        path = saving.next_free(saving.picture_folder(core) / f"{saving.picture_stem(core)}.png")
        core.post(saving.save_picture, saving.resized(core.camera, width, height), path)
        core.dialog = None
    imgui.same_line()
    if imgui.button("Choose a place..."):
        camera = saving.resized(core.camera, width, height)
        core.choose_files(
            "Save the picture",
            lambda paths: core.post(saving.save_picture, camera, paths[0].with_suffix(".png")),
            kind="save_picture",
            name=f"{saving.picture_stem(core)}.png",
        )
        core.dialog = None
    imgui.end()
    if not opened:
        core.dialog = None
