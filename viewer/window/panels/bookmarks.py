"""Views to go back to: bookmarks, and the cameras of a loaded list."""

from __future__ import annotations

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from ..actions import delete_bookmark, go_to_bookmark, rename_bookmark
from ..camera_list import go_to_camera
from ..core import Core
from ..shortcuts import keys_of
from . import widgets


def show(core: Core) -> None:
    imgui.push_id("bookmarks")
    widgets.section("Bookmarks")
    widgets.action_button(core, "Bookmark this view", "add_bookmark")
    if not core.bookmarks:
        widgets.note(f"None yet. {keys_of('add_bookmark')} keeps the present view, beside the scene's file.")
    for index, bookmark in enumerate(core.bookmarks):
        bookmark_row(core, index, bookmark.name)
    imgui.pop_id()
    imgui.push_id("cameras")
    widgets.section("Cameras")
    if core.cameras:
        cameras(core)
    else:
        widgets.note("A cameras.json, a COLMAP model or a saved camera: drop it on the window, or")
        widgets.action_button(core, "Load...", "open_cameras")
    imgui.pop_id()


def bookmark_row(core: Core, index: int, name: str) -> None:
    imgui.push_id(index)
    style = imgui.get_style()
    signs = (icons.ICON_FA_PEN, icons.ICON_FA_TRASH)
    buttons = sum(
        imgui.calc_text_size(sign).x + 2 * style.frame_padding.x + style.item_spacing.x for sign in signs
    )
    width = max(imgui.get_content_region_avail().x - buttons, imgui.get_font_size())
    if imgui.selectable(name, index == core.bookmark_index, 0, (width, 0))[0]:
        core.post(go_to_bookmark, index)
    widgets.tooltip("Go to this view")
    imgui.same_line()
    if imgui.small_button(icons.ICON_FA_PEN):
        imgui.open_popup("rename")
    widgets.tooltip("Rename")
    imgui.same_line()
    if imgui.small_button(icons.ICON_FA_TRASH):
        core.post(delete_bookmark, index)
    widgets.tooltip("Delete this bookmark")
    if imgui.begin_popup("rename"):
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(imgui.get_font_size() * 14)
        done, text = imgui.input_text("##name", name, imgui.InputTextFlags_.enter_returns_true)
        if done:
            core.post(rename_bookmark, index, text)
            imgui.close_current_popup()
        imgui.end_popup()
    imgui.pop_id()


def cameras(core: Core) -> None:
    widgets.action_button(core, "Previous", "previous_camera")
    imgui.same_line()
    widgets.action_button(core, "Next", "next_camera")
    imgui.same_line()
    changed, shown = imgui.checkbox("In the view", core.preferences.show_cameras)
    widgets.tooltip("Draws each camera as a small pyramid that opens the way it looks.")
    if changed:
        core.prefer(show_cameras=shown)
    clipper = imgui.ListClipper()
    clipper.begin(len(core.cameras))
    while clipper.step():
        for index in range(clipper.display_start, clipper.display_end):
            camera = core.cameras[index]
            text = f"{camera.name or f'Camera {index + 1}'}##{index}"
            if imgui.selectable(text, index == core.camera_index)[0]:
                core.post(go_to_camera, index)
            widgets.tooltip(f"{camera.width} x {camera.height} px")
