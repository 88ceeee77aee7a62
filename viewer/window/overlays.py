"""What lies over the picture and the docks: tools, dialogs, progress, the status bar."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from . import saving, theme
from .actions import NAVIGATION_MODES
from .core import Core
from .panels import widgets
from .panels.camera import NAVIGATION_NAMES
from .shortcuts import MOUSE, SHORTCUTS

HINTS = {
    "orbit": "Drag: orbit   Right drag: pan   Wheel: zoom   Double click: turn about   F1: keys",
    "fly": "Drag: look   W A S D E Q: move   Wheel: speed   Shift: fast   F1: keys",
    "trackball": "Drag: turn   Right drag: pan   Wheel: zoom   Double click: turn about   F1: keys",
}


def over_picture(core: Core) -> None:
    """The tools in the picture's corner, and a welcome where nothing is open."""
    corner = imgui.get_window_pos()
    margin = imgui.get_font_size() * 0.6
    imgui.set_cursor_screen_pos(ImVec2(corner.x + margin, corner.y + margin))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(2, 2))
    for i, mode in enumerate(NAVIGATION_MODES):
        if i:
            imgui.same_line()
        chosen = core.preferences.navigation == mode
        fill = imgui.ImVec4(*theme.ACCENT, 0.75) if chosen else imgui.ImVec4(0.1, 0.1, 0.11, 0.7)
        imgui.push_style_color(imgui.Col_.button, fill)
        widgets.action_button(core, NAVIGATION_NAMES[mode], f"navigate_{mode}")
        imgui.pop_style_color()
    imgui.pop_style_var()
    if core.scene is None and core.loading is None:
        text = "Drop a scene here, or press Ctrl+O"
        size, area = imgui.calc_text_size(text), imgui.get_window_size()
        place = ImVec2(corner.x + (area.x - size.x) / 2, corner.y + (area.y - size.y) / 2)
        imgui.set_cursor_screen_pos(place)
        imgui.text_colored(theme.QUIET, text)


def status_bar(core: Core) -> None:
    if core.messages:
        latest = core.messages[-1]
        if latest.error:
            imgui.text_colored(theme.ERROR, latest.text)
        else:
            imgui.text_unformatted(latest.text)
    hint = HINTS[core.preferences.navigation]
    imgui.same_line(imgui.get_window_width() - imgui.calc_text_size(hint).x - imgui.get_font_size())
    imgui.text_colored(theme.QUIET, hint)


def centred(width_em: float) -> None:
    """Puts the next window into the middle."""
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing, (0.5, 0.5))
    imgui.set_next_window_size((imgui.get_font_size() * width_em, 0), imgui.Cond_.appearing)


DIALOG_FLAGS = (
    imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.no_saved_settings
)


def loading(core: Core) -> None:
    """Progress of the scene on its way, with a button to stop it."""
    if core.loading is None:
        return
    centred(24)
    imgui.begin("Loading", None, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)
    imgui.text_unformatted(f"{core.loading.stage} {core.loading.name}")
    progress = core.loading.progress
    imgui.progress_bar(progress, (imgui.get_font_size() * 22, 0), f"{progress:.0%}")
    widgets.action_button(core, "Cancel", "cancel")
    imgui.end()


def problem(core: Core) -> None:
    """An error that the user is to read; the scene behind it is as it was."""
    if core.problem is None:
        return
    name = "Sorry"
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


def help_page(core: Core) -> None:
    """All keys, from the one table that binds them."""
    if core.dialog != "help":
        return
    centred(50)
    opened = imgui.begin("Keys and mouse", True, DIALOG_FLAGS)[1]
    if imgui.begin_table("help", 2):
        imgui.table_next_column()
        key_table("Mouse", MOUSE)
        for column, groups in enumerate((("Moving", "Navigation", "Picture", "Window"), ("File", "Camera"))):
            if column:
                imgui.table_next_column()
            for group in groups:
                key_table(group, [(", ".join(s.keys), s.text) for s in SHORTCUTS if s.group == group])
        imgui.end_table()
    imgui.end()
    if not opened:
        core.dialog = None


def key_table(name: str, rows) -> None:
    imgui.separator_text(name)
    if imgui.begin_table(name, 2):
        imgui.table_setup_column("key", imgui.TableColumnFlags_.width_fixed, imgui.get_font_size() * 9)
        imgui.table_setup_column("text", imgui.TableColumnFlags_.width_stretch)
        for keys, text in rows:
            imgui.table_next_column()
            imgui.text_colored(imgui.ImVec4(*theme.ACCENT, 1), keys)
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
        core.screenshot_size = tuple(min(max(int(v), 1), saving.MAX_SIDE) for v in size)
    for name, factor in (("As seen", 1), ("2 x", 2), ("4 x", 4)):
        if factor > 1:
            imgui.same_line()
        if imgui.button(name):
            w, h = core.picture_size
            core.screenshot_size = (w * factor, h * factor)
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
