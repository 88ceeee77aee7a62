"""The Photos and Compare panels: photos of a training with their scores, and one beside the scene."""

from __future__ import annotations

from functools import partial

import moderngl
from imgui_bundle import ImVec2, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.viewer import theme
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState
from splatview.viewer.training import live as actions
from splatview.viewer.training.comparison import ComparisonRequest, shrink_for
from splatview.viewer.training.live import LiveTraining, viewer_threads


def show(app: AppState, training: LiveTraining) -> None:
    widgets.button(
        "Go to this camera",
        "Looks from where the chosen photo was taken, as a double click on it does.",
        partial(app.post, actions.go_to_photo, training.photo_index),
    )
    imgui.same_line()
    changed, shown = imgui.checkbox("In the view", app.preferences.show_photos)
    widgets.tooltip("Draws each photo's camera as a small pyramid; a click on one goes there.")
    if changed:
        app.prefer(show_photos=shown)
    if any(photo.held_out for photo in training.photos):
        imgui.same_line()
        widgets.button("Measure", "Scores the held-out photos now.", partial(app.post, actions.evaluate))
    table(app, training)


MOST_ROWS = 12
"""Of photos, seen at once."""


def table(app: AppState, training: LiveTraining) -> None:
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.scroll_y | imgui.TableFlags_.sizing_stretch_prop
    rows = min(len(training.photos), MOST_ROWS) + 1.3
    if not imgui.begin_table("photos", 3, flags, (0, rows * imgui.get_text_line_height_with_spacing())):
        return
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column("Photo", imgui.TableColumnFlags_.width_stretch, 3)
    imgui.table_setup_column("Use", imgui.TableColumnFlags_.width_stretch, 1.3)
    imgui.table_setup_column("dB", imgui.TableColumnFlags_.width_stretch, 1)
    imgui.table_headers_row()
    scores, left_out = training.scores, training.status.left_out
    clipper = imgui.ListClipper()
    clipper.begin(len(training.photos))
    while clipper.step():
        for index in range(clipper.display_start, clipper.display_end):
            photo = training.photos[index]
            imgui.table_next_row()
            imgui.table_next_column()
            flags = imgui.SelectableFlags_.span_all_columns | imgui.SelectableFlags_.allow_double_click
            if imgui.selectable(widgets.item(photo.label, index), index == training.photo_index, flags)[0]:
                double = imgui.is_mouse_double_clicked(imgui.MouseButton_.left)
                app.post(actions.go_to_photo if double else actions.compare_photo, index)
            widgets.tooltip(f"{photo.name}: {photo.camera.width} x {photo.camera.height} px")
            imgui.table_next_column()
            if photo.held_out:
                imgui.text_colored(ImVec4(*theme.HELD_OUT, 1), "held out")
            elif photo.name in left_out:
                imgui.text_colored(theme.WARNING, "left out")
                widgets.tooltip("It disagrees with the other photos: its camera's pose may be wrong.")
            elif photo.name in training.status.in_part:
                imgui.text_colored(theme.WARNING, "in part")
                widgets.tooltip(
                    "What of it the other photos contradict is masked, and dark beside the scene: somebody"
                    " who walks past, perhaps."
                )
            else:
                imgui.text_colored(theme.QUIET, "trained")
            imgui.table_next_column()
            if photo.name in scores:
                imgui.text_unformatted(f"{scores[photo.name]:.2f}")
                widgets.tooltip(f"In full size, at step {training.status.evaluated_at:,}.")
    imgui.end_table()


TITLES = ("Photo", "Scene", "Difference")

GAINS = (1.0, 20.0)

LENS_SHARE = 1 / 6
"""Share of a picture's width that the magnifying tooltip shows."""


def show_comparison(app: AppState) -> None:
    """The chosen photo beside the scene from its camera, and their difference."""
    training = app.feature(LiveTraining)
    tools(app, training)
    comparison = training.comparer.latest
    room, spacing = imgui.get_content_region_avail(), imgui.get_style().item_spacing
    camera = training.photo.camera
    width = (room.x - 2 * spacing.x) / 3
    width = max(min(width, room.y * camera.width / camera.height), 16.0)
    height = width * camera.height / camera.width
    request(app, training, width, height)
    if comparison is None or comparison.request.shot is not training.photo.shot:
        widgets.note(training.comparer.problem or "Drawing...")
        return
    textures = training.pictures.of(comparison)
    for column, (title, texture) in enumerate(zip(TITLES, textures, strict=True)):
        if column:
            imgui.same_line()
        imgui.image(imgui.ImTextureRef(texture.glo), ImVec2(width, height))
        caption(title)
        if imgui.is_item_hovered():
            magnify(textures, width, height)


def caption(text: str) -> None:
    """In the corner of the picture just drawn, on a dark ground."""
    corner, size = imgui.get_item_rect_min(), imgui.calc_text_size(text)
    edge = 0.3 * imgui.get_font_size()
    draw = imgui.get_window_draw_list()
    low = ImVec2(corner.x + edge, corner.y + edge)
    high = ImVec2(low.x + size.x + 2 * edge, low.y + size.y + edge)
    draw.add_rect_filled(low, high, imgui.get_color_u32(ImVec4(0, 0, 0, 0.6)), edge)
    draw.add_text(ImVec2(low.x + edge, low.y + edge / 2), imgui.get_color_u32(ImVec4(1, 1, 1, 0.9)), text)


def tools(app: AppState, training: LiveTraining) -> None:
    """Which photo, its score, and how strongly differences are shown."""
    index = training.photo_index
    widgets.button(
        f"{icons.ICON_FA_CHEVRON_LEFT}###previous",
        "Previous photo",
        partial(app.post, actions.compare_photo, index - 1),
    )
    imgui.same_line()
    widgets.button(
        f"{icons.ICON_FA_CHEVRON_RIGHT}###next",
        "Next photo",
        partial(app.post, actions.compare_photo, index + 1),
    )
    imgui.same_line()
    widgets.button(
        f"{icons.ICON_FA_VIDEO}  Go there###go",
        "Looks from where this photo was taken",
        partial(app.post, actions.go_to_photo, index),
    )
    imgui.same_line()
    kind = "held out" if training.photo.held_out else "trained"
    kind = "trained in part" if training.photo.name in training.status.in_part else kind
    kind = "left out" if training.photo.name in training.status.left_out else kind
    imgui.text_unformatted(f"{training.photo.label} ({kind})   {training.score_text()}")
    widgets.tooltip(
        "Held-out photos are measured in full size, as the list has them; others as they are seen."
    )
    imgui.same_line()
    imgui.set_next_item_width(imgui.get_font_size() * 8)
    changed, gain = imgui.drag_float(
        "##gain", training.gain, 0.05, *GAINS, "difference x %.1f", imgui.SliderFlags_.logarithmic
    )
    widgets.tooltip("By how much differences are brightened")
    if changed:
        training.gain = min(max(gain, GAINS[0]), GAINS[1])


def request(app: AppState, training: LiveTraining, width: float, height: float) -> None:
    """Asks for the pictures in the size in which they are seen."""
    if training.shown is None:
        return
    camera, scale = training.photo.camera, imgui.get_io().display_framebuffer_scale
    training.comparer.threads = viewer_threads(app.preferences.training_share, training.thread.cores)
    training.comparer.request(
        ComparisonRequest(
            shot=training.photo.shot,
            gaussians=training.shown.gaussians,
            settings=training.settings,
            shrink=shrink_for(camera.width, camera.height, (width * scale.x, height * scale.y)),
            gain=training.gain,
            exposures_differ=training.shown.exposures_differ,
            in_part=training.status.in_part.get(training.photo.name),
        )
    )


def magnify(textures: list[moderngl.Texture], width: float, height: float) -> None:
    """The place under the mouse in all three pictures, enlarged."""
    corner, mouse = imgui.get_item_rect_min(), imgui.get_mouse_pos()
    half = LENS_SHARE / 2
    tall = half * width / height
    x = min(max((mouse.x - corner.x) / width, half), 1 - half)
    y = min(max((mouse.y - corner.y) / height, tall), 1 - tall)
    if imgui.begin_tooltip():
        side = imgui.get_font_size() * 10
        for column, texture in enumerate(textures):
            if column:
                imgui.same_line()
            texture_ref = imgui.ImTextureRef(texture.glo)
            imgui.image(
                texture_ref, ImVec2(side, side), ImVec2(x - half, y - tall), ImVec2(x + half, y + tall)
            )
        imgui.end_tooltip()
