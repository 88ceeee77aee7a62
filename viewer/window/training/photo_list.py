"""The photos of a training: which are trained on, which are held out and how they score."""

from __future__ import annotations

from functools import partial

from imgui_bundle import ImVec4, imgui

from .. import theme
from ..core import Core
from ..panels import widgets
from . import actions


def show(core: Core) -> None:
    training = core.training
    if training is None:
        return
    widgets.button(
        "Go to this camera",
        "Looks from where the chosen photo was taken. A double click on a photo does it, too.",
        partial(core.post, actions.go_to_photo, training.photo_index),
    )
    imgui.same_line()
    changed, shown = imgui.checkbox("In the view", core.preferences.show_photos)
    widgets.tooltip("Draws each photo's camera as a small pyramid; a click on one goes there.")
    if changed:
        core.prefer(show_photos=shown)
    if any(photo.held_out for photo in training.photos):
        imgui.same_line()
        widgets.button("Measure", "Scores the held-out photos now.", partial(core.post, actions.evaluate))
    table(core)


def table(core: Core) -> None:
    training = core.training
    assert training is not None
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.scroll_y | imgui.TableFlags_.sizing_stretch_prop
    if not imgui.begin_table("photos", 3, flags):
        return
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column("Photo", imgui.TableColumnFlags_.width_stretch, 3)
    imgui.table_setup_column("Use", imgui.TableColumnFlags_.width_stretch, 1.3)
    imgui.table_setup_column("dB", imgui.TableColumnFlags_.width_stretch, 1)
    imgui.table_headers_row()
    scores = training.scores
    clipper = imgui.ListClipper()
    clipper.begin(len(training.photos))
    while clipper.step():
        for index in range(clipper.display_start, clipper.display_end):
            photo = training.photos[index]
            imgui.table_next_row()
            imgui.table_next_column()
            flags = imgui.SelectableFlags_.span_all_columns | imgui.SelectableFlags_.allow_double_click
            if imgui.selectable(f"{photo.label}##{index}", index == training.photo_index, flags)[0]:
                double = imgui.is_mouse_double_clicked(imgui.MouseButton_.left)
                core.post(actions.go_to_photo if double else actions.compare_photo, index)
            widgets.tooltip(f"{photo.name}: {photo.camera.width} x {photo.camera.height} px")
            imgui.table_next_column()
            if photo.held_out:
                imgui.text_colored(ImVec4(*theme.HELD_OUT, 1), "held out")
            else:
                imgui.text_colored(theme.QUIET, "trained")
            imgui.table_next_column()
            if photo.name in scores:
                imgui.text_unformatted(f"{scores[photo.name]:.2f}")
    imgui.end_table()
