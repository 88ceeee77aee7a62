"""The Film panel: keyframes on a time axis, what plays them, the path over the picture, and the export."""

from __future__ import annotations

import math
import os
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.scene import Camera
from splatview.scene.camera_path import MOTIONS, CameraPath
from splatview.scene.film import CODEC_TITLES, FORMATS
from splatview.scene.image_model import NEAR
from splatview.viewer import film as films
from splatview.viewer import theme
from splatview.viewer.commands import keys_of
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.film import Film
from splatview.viewer.overlays import pyramids
from splatview.viewer.panels import widgets
from splatview.viewer.save import FILM_DIALOG, MAX_SIDE, FilmExport, choose_film_place, start_film
from splatview.viewer.state import AppState

PANEL = "Film"

REACH_EM = 0.55
"""Half the width of a keyframe's mark, in font heights; as near the mouse takes hold of it."""

LEAST_APART = 3.0
"""px between two marks that are drawn."""

LEAST_AXIS_EM = 2.6
"""Height of the time axis at least, in font heights."""

BEYOND = 1.12
"""Length of the axis in lengths of the path: room to drag the last keyframe on."""

SAMPLES = 24
"""Points of the drawn path for each piece between keyframes; ..."""

MOST_SAMPLES = 600
"""... of all at most."""

MARK = 0.08
"""Depth of a keyframe's pyramid in distances of keyframes from what they look at."""

MOST_PYRAMIDS = 60
"""Keyframes that have one: files of other programs have one for each frame."""

SIZES = (("720p", (1280, 720)), ("1080p", (1920, 1080)), ("4K", (3840, 2160)))


def show(app: AppState) -> None:
    """Two rows: what acts on the film, and the axis of its keyframes."""
    film = app.feature(Film)
    controls(app, film)
    if app.dialog != FILM_DIALOG:
        progress(app)
    if film.path is None:
        key = keys_of("add_keyframe")
        widgets.note(
            f"No keyframes yet. Find a view and press {key}, find the next one and press {key} again: the "
            "camera goes smoothly from one to the other. Or let Turntable take it once round the scene."
        )
        return
    axis(app, film, film.path)


def controls(app: AppState, film: Film) -> None:
    path = film.path
    play = icons.ICON_FA_PAUSE if film.playing else icons.ICON_FA_PLAY
    for number, (id, icon) in enumerate(
        (
            ("previous_keyframe", icons.ICON_FA_BACKWARD_STEP),
            ("play_film", play),
            ("next_keyframe", icons.ICON_FA_FORWARD_STEP),
        )
    ):
        if number:
            imgui.same_line(0, 2)
        widgets.command_button(app, f"{icon}###{id}", id, width=imgui.get_frame_height() * 1.4)
    beside(TIME_EM * imgui.get_font_size())
    times(app, film)
    for name, id in (
        ("Add keyframe", "add_keyframe"),
        ("Update", "update_keyframe"),
        ("Delete", "delete_keyframe"),
        ("Undo", "undo_film"),
    ):
        widgets.beside(name)
        widgets.command_button(app, f"{name}###{id}", id)
    beside(imgui.get_frame_height() + imgui.calc_text_size("Loop").x + 8)
    imgui.begin_disabled(path is None)
    if imgui.checkbox("Loop", path is not None and path.loop)[0]:
        app.post(films.toggle_loop)
    imgui.end_disabled()
    widgets.tooltip("From the last keyframe back to the first, and on: the film has no end to be seen.")
    wide = 6.2 * imgui.get_font_size()
    beside(wide)
    imgui.set_next_item_width(wide)
    imgui.begin_disabled(path is None)
    index = MOTIONS.index(path.motion) if path is not None else 0
    changed, index = imgui.combo("##motion", index, [motion.capitalize() for motion in MOTIONS])
    imgui.end_disabled()
    widgets.tooltip(
        "Orbit: the camera swings about what it looks at, so it goes round things. Fly: it moves smoothly "
        "through the keyframes' places, wherever it looks."
    )
    if changed:
        app.post(films.set_motion, MOTIONS[index])
    for name, id in (
        ("Turntable", "turntable"),
        ("Open path...", "open_camera_path"),
        ("Save path...", "save_camera_path"),
        ("Export film...", "export_film"),
    ):
        widgets.beside(name)
        widgets.command_button(app, f"{name}###{id}", id)


TIME_EM = 4.4
"""Width of the playhead's time and of the length, in font heights."""


def times(app: AppState, film: Film) -> None:
    """The playhead and the length, to drag or to type."""
    em, path = imgui.get_font_size(), film.path
    duration = path.duration if path is not None else 0.0
    imgui.begin_disabled(not duration > 0)
    imgui.set_next_item_width(TIME_EM * em)
    clamp = imgui.SliderFlags_.always_clamp
    changed, time = imgui.drag_float("##time", film.time, 0.01, 0.0, max(duration, 1e-3), "%.2f s", clamp)
    widgets.tooltip("Time of the film that is shown, to drag or (double click) to type.")
    if changed:
        app.post(scrub, time)
    beside(imgui.calc_text_size("of").x + 4 + TIME_EM * em)
    imgui.align_text_to_frame_padding()
    imgui.text_colored(theme.QUIET, "of")
    imgui.same_line(0, 4)
    imgui.set_next_item_width(TIME_EM * em)
    changed, seconds = imgui.drag_float("##length", duration, 0.02, 0.1, 3600.0, "%.2f s", clamp)
    begun = imgui.is_item_activated()
    widgets.tooltip("Length of the film: all keyframes move along, and the camera is quicker or slower.")
    if begun:
        film.grip.moved = False
    if changed:
        app.post(partial(films.set_length, seconds=seconds, again=film.grip.moved))
        film.grip.moved = True
    imgui.end_disabled()


def scrub(app: AppState, time: float) -> None:
    film = app.feature(Film)
    film.playing = False
    film.show(app, time)


def beside(width: float) -> None:
    """Keeps the next item, so wide, on the line of the last one if it fits there."""
    right = imgui.get_cursor_screen_pos().x + imgui.get_content_region_avail().x
    if imgui.get_item_rect_max().x + imgui.get_style().item_spacing.x + width <= right:
        imgui.same_line()


def axis(app: AppState, film: Film, path: CameraPath) -> None:
    """Seconds from left to right with the keyframes as marks. A click on a mark goes to its keyframe and a
    drag moves it in time; elsewhere the playhead follows the mouse."""
    em, corner = imgui.get_font_size(), imgui.get_cursor_screen_pos()
    room = imgui.get_content_region_avail()
    width, height = max(room.x, 1.0), max(room.y, LEAST_AXIS_EM * em)
    imgui.invisible_button("axis", ImVec2(width, height))
    left, span = corner.x + em, max(width - 2 * em, 1.0)
    if not imgui.is_item_active():  # the scale rests while a keyframe is dragged beyond the end
        film.grip.seconds = max(path.duration * BEYOND, films.STEP)
    scale = span / film.grip.seconds
    middle = corner.y + 0.62 * height
    draw = imgui.get_window_draw_list()
    ruler(draw, corner, left, scale, width, film.grip.seconds)
    quiet, bright = imgui.get_color_u32(theme.QUIET), imgui.get_color_u32(imgui.Col_.text)
    accent = imgui.get_color_u32(ImVec4(*theme.ACCENT, 1))
    draw.add_line(ImVec2(left, middle), ImVec2(left + scale * path.duration, middle), quiet, 2)
    mouse = imgui.get_mouse_pos()
    places = [left + scale * key.time for key in path.keyframes]
    near = [i for i, x in enumerate(places) if abs(x - mouse.x) <= REACH_EM * em]
    under = min(near, key=lambda i: abs(places[i] - mouse.x), default=-1)
    if not (imgui.is_item_hovered() and abs(mouse.y - middle) <= 1.2 * em):
        under = -1
    head = left + scale * film.time
    draw.add_line(ImVec2(head, corner.y), ImVec2(head, corner.y + height), accent, 2)
    tip = 0.45 * em
    draw.add_triangle_filled(
        ImVec2(head - tip, corner.y), ImVec2(head + tip, corner.y), ImVec2(head, corner.y + tip), accent
    )
    dense = len(places) > 1 and span / len(places) < 2 * REACH_EM * em
    drawn = -math.inf
    for i, x in enumerate(places):
        if x - drawn < LEAST_APART and i not in (under, film.chosen):
            continue
        drawn = x
        chosen, hot = i == film.chosen, i in (under, film.grip.keyframe)
        half = (REACH_EM if chosen or hot else 0.4) * em * (0.5 if dense and not (chosen or hot) else 1)
        ink = accent if chosen else bright if hot else quiet
        top, bottom = ImVec2(x, middle - half), ImVec2(x, middle + half)
        draw.add_quad_filled(top, ImVec2(x + half, middle), bottom, ImVec2(x - half, middle), ink)
    pressed(app, film, path, under, (mouse.x - left) / scale)
    if imgui.is_item_hovered():
        imgui.set_mouse_cursor(imgui.MouseCursor_.hand if under >= 0 else imgui.MouseCursor_.arrow)
    if under >= 0 and film.grip.keyframe < 0:
        key = path.keyframes[under]
        widgets.tooltip(
            f"Keyframe {under + 1} at {key.time:.2f} s: a click goes there, a drag moves it in time.",
            hovered=True,
        )


def pressed(app: AppState, film: Film, path: CameraPath, under: int, time: float) -> None:
    """What the mouse does on the axis, the last item; `under`: keyframe under it, `time`: where it is."""
    if imgui.is_item_activated():
        film.grip.keyframe, film.grip.moved = under, False
    if not imgui.is_item_active():
        if film.grip.keyframe >= 0 and imgui.is_item_deactivated() and not film.grip.moved:
            app.post(films.go_to_keyframe, film.grip.keyframe)
        film.grip.keyframe = -1
        return
    if film.grip.keyframe < 0:
        app.post(scrub, min(max(time, 0.0), path.duration))
    elif film.grip.keyframe < len(path.keyframes) and imgui.is_mouse_dragging(imgui.MouseButton_.left):
        app.post(partial(films.move_keyframe, index=film.grip.keyframe, time=time, again=film.grip.moved))
        film.grip.moved = True


def ruler(
    draw: imgui.ImDrawList, corner: ImVec2, left: float, scale: float, width: float, seconds: float
) -> None:
    """Marks at round seconds, as many as there is room for."""
    em = imgui.get_font_size()
    step = next(
        (
            part * 10**power
            for power in range(-2, 6)
            for part in (1, 2, 5)
            if part * 10**power * scale >= 3.5 * em
        ),
        1e6,
    )
    ink, text = imgui.get_color_u32(imgui.Col_.separator), imgui.get_color_u32(theme.QUIET)
    for number in range(math.floor(seconds / step + 1e-6) + 1):
        x = left + scale * step * number
        draw.add_line(ImVec2(x, corner.y), ImVec2(x, corner.y + 0.45 * em), ink)
        label = f"{step * number:.10g} s"
        if x + 0.3 * em + imgui.calc_text_size(label).x <= corner.x + width:
            draw.add_text(ImVec2(x + 0.3 * em, corner.y), text, label)


def progress(app: AppState) -> None:
    """The export under way, and how to end it."""
    task = app.feature(FilmExport).task
    if task is None:
        return
    widgets.progress(task.progress, task.text, beside_em=5)
    imgui.same_line()
    widgets.button("Cancel###cancel film", "Ends the film; nothing is written.", task.cancel)


# ---- Over the picture.


def over_picture(app: AppState) -> None:
    """The camera's way as a line, its keyframes as pyramids, while the panel is open and nothing plays."""
    film = app.feature(Film)
    if app.strip != PANEL or app.panels_hidden or film.path is None or film.playing:
        return
    path, corner, camera = film.path, imgui.get_window_pos(), app.camera
    scale = imgui.get_io().display_framebuffer_scale
    draw = imgui.get_window_draw_list()
    t = (eyes_of(path) - camera.eye) @ camera.R_camera_world.T
    pixels = camera.image_points(t) / (scale.x, scale.y) + (corner.x, corner.y)
    ink, dark = imgui.get_color_u32(ImVec4(*theme.ACCENT, 0.9)), imgui.get_color_u32(ImVec4(0, 0, 0, 0.45))
    seen = (t[:, 2] >= NEAR) & np.isfinite(pixels).all(axis=1) & (abs(pixels) < 1e5).all(axis=1)
    ends = [
        (ImVec2(*a), ImVec2(*b))
        for a, b, shown in zip(pixels.tolist(), pixels[1:].tolist(), seen[:-1] & seen[1:], strict=False)
        if shown
    ]
    for a, b in ends:
        draw.add_line(a, b, dark, 4)
    for a, b in ends:
        draw.add_line(a, b, ink, 2)
    size = MARK * float(np.median([key.pose.distance for key in path.keyframes]))
    step = -(-len(path.keyframes) // MOST_PYRAMIDS)
    for index, lines in pyramids(cameras_of(path, step), camera, size):
        chosen = index * step == film.chosen
        colour = imgui.get_color_u32(ImVec4(*theme.ACCENT, 1) if chosen else ImVec4(1, 1, 1, 0.75))
        for a, b in (lines / (scale.x, scale.y) + (corner.x, corner.y)).tolist():
            draw.add_line(ImVec2(*a), ImVec2(*b), colour, 2 if chosen else 1)


@lru_cache(maxsize=4)
def cameras_of(path: CameraPath, step: int) -> list[Camera]:
    """Of each `step`th keyframe, as wide as a film mostly is."""
    return [key.pose.camera(160, 90) for key in path.keyframes[::step]]


@lru_cache(maxsize=4)
def eyes_of(path: CameraPath) -> np.ndarray:
    """(n, 3) float64, world: where the camera is on its way."""
    if len(path.keyframes) > MOST_SAMPLES:
        step = -(-len(path.keyframes) // MOST_SAMPLES)
        return np.array([key.pose.eye for key in path.keyframes[::step]])
    knots = [key.time for key in path.keyframes]
    if path.loop:
        knots.append(knots[0] + path.duration)
    each = max(min(SAMPLES, MOST_SAMPLES // len(knots)), 1)
    inner = [np.linspace(a, b, each, endpoint=False) for a, b in pairwise(knots)]
    # A loop's end, exactly, would be its beginning by the remainder, which is the same place.
    return np.array([path.pose(float(time)).eye for time in np.concatenate([*inner, knots[-1:]])])


# ---- The export.


def show_dialog(app: AppState) -> None:
    """Format, size, rate and place; what it will be, and its progress."""
    film, made = app.feature(Film), app.feature(FilmExport)
    if app.dialog != FILM_DIALOG:
        return
    centred(30)
    imgui.set_next_window_size((imgui.get_font_size() * 30, 0))
    opened = imgui.begin("Export the film", True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    imgui.begin_disabled(made.task is not None)
    choices(app, film, made)
    imgui.end_disabled()
    imgui.separator()
    if made.task is not None:
        progress(app)
        widgets.note("The window can be used meanwhile; closing this dialog does not stop the film.")
    else:
        place(app, film, made)
    imgui.end()
    if not opened:
        app.dialog = None


def choices(app: AppState, film: Film, made: FilmExport) -> None:
    settings = film.settings
    names = tuple(FORMATS)
    chosen = widgets.combo(
        "Format",
        settings.format,
        names,
        "A video, a GIF for pages without one, or every frame as a file, without loss.",
        [FORMATS[name].title for name in names],
    )
    if chosen is not None:
        made.choose(film, format=chosen)
    codecs = FORMATS[settings.format].codecs
    if codecs:
        codec = widgets.combo(
            "Codec",
            settings.codec or codecs[0],
            codecs,
            "AV1 and VP9 are free to use and small; H.264 plays on old devices too, and has patents.",
            [CODEC_TITLES[one] for one in codecs],
        )
        if codec is not None:
            made.choose(film, codec=codec)
    widgets.label("Size", "Pixels of a frame; a wider one than the window shows more at the sides.")
    changed, size = imgui.input_int2("##size", list(settings.size))
    if changed:
        width, height = (min(max(int(side), 1), MAX_SIDE) for side in size)
        made.choose(film, size=(width, height))
    width, height = app.picture_size
    seen = (width - width % 2, height - height % 2)
    for number, (name, size) in enumerate((*SIZES, ("As seen", seen))):
        if number:
            imgui.same_line()
        if imgui.button(name):
            made.choose(film, size=size)
    fps = widgets.slider(
        "Frames a second", settings.fps, 1.0, 60.0, "24 as films, 30 as videos, 60 as screens.", form="%.0f"
    )
    if fps is not None:
        made.choose(film, fps=float(round(fps)))
    if film.path is not None:
        count = len(film.path.frame_times(settings.fps))
        widgets.fact("Length", f"{film.path.duration:.2f} s, {count:,} frames")


def place(app: AppState, film: Film, made: FilmExport) -> None:
    """Where the film goes, what is in the way, and the button that begins."""
    imgui.set_next_item_width(-imgui.get_font_size() * 7)
    changed, text = imgui.input_text("##path", made.file)
    if changed:
        made.file = text
    widgets.tooltip("The file, or the new folder, to write.")
    imgui.same_line()
    widgets.button("Browse...", "Chooses folder and name.", lambda: app.post(choose_film_place))
    problem = made.problem(app, film)
    if problem:
        widgets.note(problem, theme.WARNING)
    elif Path(os.path.expanduser(made.file)).is_file():
        widgets.note("A file of this name is there; it will be replaced.", theme.WARNING)
    widgets.button(
        "Export###begin film",
        "Renders every frame in full, beside the window's work.",
        lambda: app.post(start_film),
        lacks=problem,
    )
    imgui.same_line()
    if imgui.button("Close"):
        app.dialog = None
