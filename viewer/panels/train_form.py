"""The form of a new training, with what was found in its folder; and the question about a dropped capture."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from imgui_bundle import ImVec2, imgui

from splatview.scene import InputError
from splatview.scene.errors import bytes_in_words, printable
from splatview.viewer import theme
from splatview.viewer.dialogs import DIALOG_FLAGS
from splatview.viewer.panels import widgets
from splatview.viewer.panels.start_screen import fitted
from splatview.viewer.state import AppState, Feature
from splatview.viewer.thumbnails import Thumbnails
from splatview.viewer.training import start
from splatview.viewer.training.live import LiveTraining
from splatview.viewer.training.start import (
    BACKGROUNDS,
    DOWNSCALES,
    LENGTHS,
    MASKS,
    MEMORIES,
    OUTLIERS,
    PASSING,
    WHETHER,
    TrainingStart,
)

NAME, DROPPED = "Train on photos", "Photos with cameras"
"""Titles of the two windows."""

PHOTOS_SHOWN = 6
PHOTO_PX = 200
"""Thumbnails of photos: how many, and the longer side as they are read."""

BUTTON_EM = 9.0

AUTOMATIC_SIZE = "auto"

SIZES = {1: "Full size", 2: "Half", 4: "A quarter", 8: "An eighth"}


class TrainForm(Feature):
    """Thumbnails of the photos of the form, while it is open."""

    def __init__(self) -> None:
        self.thumbnails = Thumbnails(PHOTO_PX)

    def before_frame(self, app: AppState) -> None:
        if not self._shown(app):
            self.thumbnails.forget()

    def _shown(self, app: AppState) -> bool:
        on_page = app.page == "Train" and not app.panels_hidden and app.find(LiveTraining) is None
        return app.dialog == "train" or on_page

    def busy(self, app: AppState) -> bool:
        return self._shown(app) and self.thumbnails.busy

    def close(self, app: AppState) -> None:
        self.thumbnails.forget()


def show(app: AppState) -> None:
    """The form or the question, whichever is open."""
    if app.dialog == "train":
        _window(app, NAME, 34, _form)
    elif app.dialog == "capture":
        _window(app, DROPPED, 28, _question)


def on_page(app: AppState) -> None:
    """The form on the Train page of a window without a training, and captures that were trained on."""
    widgets.note(
        "Trains a scene on photos whose cameras are known (COLMAP, nerfstudio, or a list of cameras); it is "
        "seen as it grows."
    )
    if app.dialog == "train":
        widgets.note("The form is open.")
        return
    _form(app, closes=False)
    state = app.feature(TrainingStart)
    if app.preferences.recent_photos and not state.is_readying:
        widgets.section("Recent")
        for name in app.preferences.recent_photos:
            room = imgui.get_content_region_avail().x
            if imgui.selectable(widgets.item(fitted(printable(name), room), name), False)[0]:
                app.post(start.look_at, Path(name))
            widgets.tooltip(f"Looks through {printable(name)} again.")


def _window(app: AppState, name: str, width: float, contents: Callable[[AppState], None]) -> None:
    viewport = imgui.get_main_viewport()
    wide = min(width * imgui.get_font_size(), 0.96 * viewport.size.x)
    # In the middle also when it grows by what is found.
    imgui.set_next_window_pos(viewport.get_center(), imgui.Cond_.always, (0.5, 0.5))
    imgui.set_next_window_size_constraints((wide, 0), (wide, 0.94 * viewport.size.y))
    opened = imgui.begin(name, True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    contents(app)
    imgui.end()
    if not opened:
        app.dialog = None


def _question(app: AppState) -> None:
    dropped = app.feature(TrainingStart).dropped
    name = printable(dropped.name) if dropped is not None else ""
    imgui.push_text_wrap_pos(0)
    imgui.text_unformatted(f"{name} may hold photos with their cameras. What shall be done with it?")
    imgui.pop_text_wrap_pos()
    imgui.spacing()
    lacks = app.feature(TrainingStart).lacks
    widgets.button(
        "Train on the photos",
        "Opens the form: how long, at which size, and where the scene goes.",
        partial(app.post, start.train_on_dropped),
        lacks=lacks,
    )
    imgui.same_line()
    widgets.button(
        "Only load its cameras",
        "Their views can be gone through over the open scene.",
        partial(app.post, start.load_dropped_cameras),
    )
    widgets.beside("Cancel")
    widgets.button("Cancel", "Does nothing (Escape).", partial(_close, app))
    if lacks:
        widgets.note(lacks, theme.WARNING)


def _form(app: AppState, *, closes: bool = True) -> None:
    state = app.feature(TrainingStart)
    folder = printable(str(state.folder)) if state.folder is not None else "No folder yet"
    widgets.label(
        "Photos",
        "A folder with a COLMAP model (sparse/0), a transforms.json or a poses_bounds.npy, and its photos.",
    )
    change = "Choose..." if state.folder is None else "Change..."
    room = imgui.get_content_region_avail().x - imgui.calc_text_size(change).x - 3 * imgui.get_font_size()
    imgui.text_unformatted(path_in(folder, room))
    widgets.tooltip(folder)
    widgets.beside(change)
    ask = start.choose_photos if closes else start.choose_for_page
    tip = "The folder with the photos." if state.folder is None else "Another folder."
    widgets.button(change, tip, partial(app.post, ask))
    if state.found is not None:
        _found(app, state)
        _choices(app, state)
    elif state.is_looking:
        widgets.note("Looking through the folder...")
    if state.problem:
        widgets.note(state.problem, theme.ERROR)
    if state.lacks:
        widgets.note(state.lacks, theme.WARNING)
    imgui.spacing()
    _buttons(app, state, closes=closes)


def _found(app: AppState, state: TrainingStart) -> None:
    found = state.found
    assert found is not None
    width, height = found.size
    text = f"{len(found.photos):,} photos, {width} x {height} px"
    text += f", {found.points:,} points" if found.points else ", no points: it begins with random ones"
    if found.masks:
        text += f", {found.masks:,} masks"
    widgets.fact("Found", text)
    if found.missing:
        widgets.note(
            f"{found.missing:,} photos with a camera are not there; the others are enough", theme.WARNING
        )
    gap = imgui.get_style().item_spacing.x
    side = (imgui.get_content_region_avail().x - (PHOTOS_SHOWN - 1) * gap) / PHOTOS_SHOWN
    thumbnails, step = app.feature(TrainForm).thumbnails, max(len(found.photos) // PHOTOS_SHOWN, 1)
    low, draw = imgui.get_cursor_screen_pos(), imgui.get_window_draw_list()
    imgui.dummy(ImVec2(imgui.get_content_region_avail().x, 0.75 * side))
    for number, path in enumerate(found.photos[::step][:PHOTOS_SHOWN]):
        left = low.x + number * (side + gap)
        corner, end = ImVec2(left, low.y), ImVec2(left + side, low.y + 0.75 * side)
        draw.add_rect_filled(corner, end, imgui.get_color_u32(imgui.Col_.frame_bg), 4)
        if (texture := thumbnails.get(path)) is None:
            continue
        fit = min(texture.width / side, texture.height / (0.75 * side))
        u, v = fit * side / texture.width / 2, fit * 0.75 * side / texture.height / 2
        white = imgui.get_color_u32((1, 1, 1, 1))
        draw.add_image_rounded(
            imgui.ImTextureRef(texture.glo), corner, end, (0.5 - u, 0.5 - v), (0.5 + u, 0.5 + v), white, 4
        )
    imgui.spacing()


def _choices(app: AppState, state: TrainingStart) -> None:
    form = state.form
    length = widgets.combo(
        "Length",
        form.length,
        tuple(LENGTHS),
        "How long to train: a minute shows whether the photos fit together, the best takes hours on a "
        "laptop, and all can be ended early.",
    )
    if length is not None:
        form.length = length
    assert state.found is not None
    automatic = state.found.automatic[form.length]
    sizes = [f"As time allows: {_size(state, automatic)}"]
    sizes += [f"{SIZES[factor]}: {_size(state, factor)}" for factor in DOWNSCALES]
    chosen = widgets.combo(
        "Size of the photos",
        str(form.downscale or AUTOMATIC_SIZE),
        [AUTOMATIC_SIZE, *(str(factor) for factor in DOWNSCALES)],
        "Smaller photos train faster; larger ones show finer detail, given the time."
        " As time allows: as large as there are steps enough for.",
        sizes,
    )
    if chosen is not None:
        form.downscale = None if chosen == AUTOMATIC_SIZE else int(chosen)
    memory = widgets.combo(
        "Memory",
        form.memory,
        MEMORIES,
        "The most that training may take, window and photos included: where there is no room for more, fewer"
        " splats grow.",
    )
    if memory is not None:
        form.memory = memory
    _memory(state)
    if state.found.masks:
        masks = widgets.combo(
            "Masks",
            form.masks,
            MASKS,
            "What is black in the masks of the photos: something in the way, such as somebody who walks past,"
            " or all that is not the object; photos without a mask are left out then.",
            ("Black is not compared", "Black is empty: an object alone"),
        )
        if masks is not None:
            form.masks = masks
    exposure = widgets.combo(
        "Exposure",
        form.exposure,
        WHETHER,
        "Learns a gain and an offset for each photo and colour, so that photos of differing brightness train"
        " one scene.",
        ("Corrected where photos differ", "Corrected for each photo", "Not corrected"),
    )
    if exposure is not None:
        form.exposure = exposure
    shading = widgets.combo(
        "Shading",
        form.shading,
        WHETHER,
        "Learns a coarse map of gains for each photo, for shadows and other light that falls on it alone, so"
        " that the scene does not have to explain them.",
        ("Corrected where photos are few", "Corrected for each photo", "Not corrected"),
    )
    if shading is not None:
        form.shading = shading
    outliers = widgets.combo(
        "Outliers",
        form.outliers,
        OUTLIERS,
        "Photos that show something else than the others, or whose cameras stand elsewhere than is said,"
        " spoil a scene.",
        ("Left out where photos disagree", "Trained on"),
    )
    if outliers is not None:
        form.outliers = outliers
    passing = widgets.combo(
        "Passing by",
        form.passing,
        PASSING,
        "What one photo alone shows in front of what others do, as somebody who walks past.",
        ("Masked, and taken out", "Stays"),
    )
    if passing is not None:
        form.passing = passing
    sky = widgets.combo(
        "Sky",
        form.sky,
        WHETHER,
        "Adds far splats for what photos show at infinity; without, sky that no photo shows is black.",
        ("Added where photos show one", "Always added", "Not added"),
    )
    if sky is not None:
        form.sky = sky
    background = widgets.combo(
        "Background",
        form.background,
        list(BACKGROUNDS),
        "What is behind the scene, and under transparent photos. By the photos: a plain colour before which"
        " they stand, which needs no splats; the mean colour of others, for what none shows; else black.",
        ("By the photos", "Black", "White"),
    )
    if background is not None:
        form.background = background
    widgets.label("Save as", "The scene, written when training ends or the window closes.")
    change = "Change...###output"
    room = (
        imgui.get_content_region_avail().x - imgui.calc_text_size("Change...").x - 3 * imgui.get_font_size()
    )
    imgui.text_unformatted(path_in(printable(str(form.output)), room))
    widgets.tooltip(str(form.output))
    widgets.beside(change)
    widgets.button(change, "Another place or name.", partial(app.post, start.choose_output))


def _memory(state: TrainingStart) -> None:
    """What the run will take, or why it does not fit."""
    if state.lacks:
        return
    try:
        planned = state.planned_memory()
    except InputError as error:
        widgets.note(str(error), theme.ERROR)
        return
    text = f"About {bytes_in_words(planned.peak)} at most, for up to {planned.splats:,} splats"
    if planned.splats < planned.wanted:
        text += f"; with more memory there would be {planned.wanted:,}"
    widgets.note(text)


def path_in(text: str, room: float) -> str:
    """A path, or its last part where there is no room for it."""
    return text if imgui.calc_text_size(text).x <= room else fitted(os.path.basename(text) or text, room)


def _size(state: TrainingStart, factor: int) -> str:
    assert state.found is not None
    width, height = state.found.size
    return f"{width // factor} x {height // factor} px"


def _buttons(app: AppState, state: TrainingStart, *, closes: bool) -> None:
    width = BUTTON_EM * imgui.get_font_size()
    if state.is_readying:
        imgui.progress_bar(-imgui.get_time(), (-1, 0), "")
        widgets.note(state.stage)
        widgets.button("Cancel", "Ends what is being readied.", partial(app.post, state.cancel), width=width)
        return
    lacks = state.lacks or ("" if state.found is not None else "Choose a folder of photos first")
    widgets.button(
        "Start training",
        "Trains in this window; the scene is seen as it grows.",
        partial(app.post, start.start_training),
        width=width,
        lacks=lacks,
    )
    if closes:
        imgui.same_line()
        widgets.button("Cancel", "Closes the form (Escape).", partial(_close, app), width=width)


def _close(app: AppState) -> None:
    app.dialog = None
