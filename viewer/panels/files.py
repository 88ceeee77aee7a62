"""The files of the scene as a list: an eye and a lock each; name and transform of the active one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.edit.operations.files import RenameFile
from splatview.scene.edits import IDENTITY, Adjustment
from splatview.scene.errors import printable
from splatview.viewer import theme
from splatview.viewer.editing import scene_files
from splatview.viewer.editing.edit_session import EditSession
from splatview.viewer.editing.gizmos import angles_of, quat_of
from splatview.viewer.editing.scene_files import Row
from splatview.viewer.editing.session import post_edit, session_of
from splatview.viewer.editing.transform import placed
from splatview.viewer.panels import widgets

if TYPE_CHECKING:
    from splatview.viewer.state import AppState

SECTION = "file"
"""Title that previews of a file's transform go by."""

SCALES = (1e-3, 1e3)
"""Range of a file's scale."""

SAME_ANGLE = 1e-9
"""Largest difference of the entries of two quaternions that are one rotation."""


def show(app: AppState) -> None:
    found, refusal = scene_files.rows(app), scene_files.refusal(app)
    if imgui.begin_table("rows", 4, imgui.TableFlags_.row_bg | imgui.TableFlags_.no_pad_outer_x):
        em = imgui.get_font_size()
        fixed = imgui.TableColumnFlags_.width_fixed
        for side in (1.5 * em, 1.5 * em):
            imgui.table_setup_column("", fixed, side)
        imgui.table_setup_column("", imgui.TableColumnFlags_.width_stretch)
        widest = max(imgui.calc_text_size(f"{row.splats:,}").x for row in found)
        imgui.table_setup_column("", fixed, widest)
        for row in found:
            imgui.push_id(row.number)
            list_row(app, row, refusal)
            imgui.pop_id()
        imgui.end_table()
    total = sum(row.splats for row in found)
    if len(found) > 1:
        widgets.fact("Splats", f"{total:,}", "Gaussians of all files, without deleted ones.")
    widgets.command_button(app, "Import...", "import")
    active = next((row for row in found if row.active), None)
    session = session_of(app)
    if active is not None and session is not None:
        imgui.push_id("active")
        details(app, session, active, refusal)
        imgui.pop_id()
    elif not refusal:
        widgets.beside("Click a row")
        imgui.text_colored(theme.QUIET, "Click a row")
        widgets.tooltip("The row that is active shows its transform; the handles on the picture are its own.")


def list_row(app: AppState, row: Row, refusal: str) -> None:
    """Eye, lock, name and number of splats of one file."""
    file, name = row.file, printable(row.file.name)
    imgui.table_next_row()
    imgui.table_next_column()
    eye = icons.ICON_FA_EYE_SLASH if file.hidden else icons.ICON_FA_EYE
    tip = f"{'Shows' if file.hidden else 'Hides'} it: in the picture, in counts, in exports of what is seen."
    toggle = partial(app.post, scene_files.toggle_eye, row)
    switch(f"{eye}###eye", tip, refusal, toggle, quiet=file.hidden)
    imgui.table_next_column()
    lock = icons.ICON_FA_LOCK if file.locked else icons.ICON_FA_LOCK_OPEN
    tip = f"{'Unlocks' if file.locked else 'Locks'} it: tools, selecting, clean-up and crops leave it alone."
    toggle = partial(app.post, scene_files.toggle_lock, row)
    switch(f"{lock}###lock", tip, refusal, toggle, quiet=not file.locked)
    imgui.table_next_column()
    fits = widgets.fitting(name, imgui.get_content_region_avail().x)
    imgui.push_style_color(
        imgui.Col_.text, theme.QUIET if file.hidden else imgui.get_style_color_vec4(imgui.Col_.text)
    )
    imgui.align_text_to_frame_padding()
    imgui.begin_disabled(refusal != "")
    pressed, _ = imgui.selectable(f"{widgets.item(fits, '')}#row", row.active)
    imgui.end_disabled()
    where = file.source if file.source not in ("", file.name) else ""
    widgets.tooltip("\n".join(filter(None, (name if fits != name else "", where, refusal))))
    if pressed:
        app.post(scene_files.toggle_active, row)
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    text = f"{row.splats:,}"
    imgui.set_cursor_pos_x(
        imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x - imgui.calc_text_size(text).x
    )
    imgui.text_unformatted(text)
    widgets.tooltip("Gaussians of this file, without deleted ones.")
    imgui.pop_style_color()


def switch(label: str, tip: str, refusal: str, pressed: Callable[[], object], *, quiet: bool) -> None:
    """An icon without a frame."""
    imgui.push_style_color(imgui.Col_.button, ImVec4(0, 0, 0, 0))
    plain = imgui.get_style_color_vec4(imgui.Col_.text)
    imgui.push_style_color(imgui.Col_.text, theme.QUIET if quiet else plain)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(0, imgui.get_style().frame_padding.y))
    widgets.button(label, tip, pressed, width=-1, lacks=refusal)
    imgui.pop_style_var()
    imgui.pop_style_color(2)


def details(app: AppState, session: EditSession, row: Row, refusal: str) -> None:
    """Name and transform of the active file, to type or to drag; undo goes back over a whole drag."""
    file, lacks = row.file, refusal or (scene_files.UNLOCK if row.file.locked else "")
    widgets.label("Name", "In this list and in the history.", share=widgets.VECTOR_LABEL_SHARE)
    changed, name = imgui.input_text("##name", printable(file.name), imgui.InputTextFlags_.enter_returns_true)
    if changed and name.strip() and name != file.name:
        post_edit(app, EditSession.apply, RenameFile(file=row.number, name=name.strip()))
    imgui.begin_disabled(lacks != "")
    transform(app, session, row)
    imgui.end_disabled()
    for number, (title, tip, command, missing) in enumerate(
        (
            ("Move", "Takes the tool whose handles move this file as a whole.", scene_files.move, lacks),
            ("Select", "Selects the splats of this file.", scene_files.select, lacks),
            (
                "Reset",
                "Puts the file back to the coordinates that it has by itself.",
                scene_files.reset,
                lacks or ("It is where its own coordinates have it" if file.placement == IDENTITY else ""),
            ),
            (
                "Remove",
                "Takes the file out of the scene, as a step that can be undone; the file on disk stays.",
                scene_files.remove,
                lacks or ("It is the only file" if len(scene_files.rows(app)) == 1 else ""),
            ),
        )
    ):
        if number:
            widgets.beside(title)
        widgets.button(title, tip, partial(app.post, command, row), lacks=missing)


def transform(app: AppState, session: EditSession, row: Row) -> None:
    """Position, rotation and scale of a file."""
    now, forms, settled = row.file.placement, session.forms, False
    new = now
    speed = max(app.scene.radius, 1e-6) / 300
    tip = "Where the file's own origin is, world units."
    if (values := widgets.vector("Position", now.translation, speed, tip)) is not None:
        new = replace(new, translation=values)
    settled |= imgui.is_item_deactivated_after_edit()
    if not np.abs(np.subtract(quat_of(forms.file_angles), now.rotation)).max() <= SAME_ANGLE:
        forms.file_angles = angles_of(now.rotation)
    tip = "Degrees about x, y, z through the file's own origin; colours that depend on the view turn too."
    if (values := widgets.vector("Rotation", forms.file_angles, 0.25, tip, form="%.2f")) is not None:
        forms.file_angles, new = values, replace(new, rotation=quat_of(values))
    settled |= imgui.is_item_deactivated_after_edit()
    tip = "Factor about the file's own origin."
    widgets.label("Scale", tip, share=widgets.VECTOR_LABEL_SHARE)
    flags = imgui.SliderFlags_.no_round_to_format | imgui.SliderFlags_.always_clamp
    changed, scale = imgui.drag_float("##Scale", now.scale, 0.005 * now.scale, *SCALES, "%.4g", flags)
    widgets.tooltip(tip)
    if changed and np.float32(scale) != np.float32(now.scale) and SCALES[0] <= scale <= SCALES[1]:
        new = replace(new, scale=float(str(np.float32(scale))))
    settled |= imgui.is_item_deactivated_after_edit()
    change(app, row.number, now, new, settled=settled)


def change(app: AppState, number: int, now: Adjustment, new: Adjustment, *, settled: bool) -> None:
    """Previews a transform while it is dragged, and makes one step of the drag when it ends."""
    if new != now:
        post_edit(app, EditSession.preview, SECTION, placed(number, new))
    if settled:
        post_edit(app, EditSession.commit_preview)
