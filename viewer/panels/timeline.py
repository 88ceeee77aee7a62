"""The timeline: a strip below the picture while a sequence is open."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise

from imgui_bundle import ImVec2, ImVec4, icons_fontawesome_6, imgui

from splatview.scene.errors import bytes_in_words
from splatview.viewer import sequence, theme
from splatview.viewer.panels import widgets
from splatview.viewer.playback import FrameState
from splatview.viewer.preferences import RANGES, PlayMode
from splatview.viewer.sequence import Player, Sequences
from splatview.viewer.state import AppState

MODES: dict[PlayMode, str] = {"loop": "Loop", "bounce": "Bounce", "once": "Once"}

COLOURS: dict[FrameState, ImVec4] = {
    "absent": ImVec4(0.20, 0.20, 0.21, 1),
    "coming": ImVec4(0.30, 0.38, 0.45, 1),
    "cached": ImVec4(0.27, 0.45, 0.62, 1),
    "failed": ImVec4(0.85, 0.30, 0.27, 1),
}
"""Fill of the slider where frames are in each state."""

BAR_EM = 1.15
"""Height of the slider, in font heights."""

NARROW_EM = 38
"""Width of the strip, in font heights, below which its controls take two rows."""

TIP_EM = 24
"""Width of the slider's tooltip at most, in font heights."""

LEAST_MARK = 2.0
"""px: width of a mark at least, so that one damaged frame among a thousand is seen."""

REACHES = 0.95
"""Share of the wanted frame rate below which it is said to be missed."""


def height(app: AppState) -> float:
    """Height of the strip; 0 where no sequence is open."""
    if app.feature(Sequences).player is None:
        return 0.0
    style, rows = imgui.get_style(), 2 if is_narrow() else 1
    controls = rows * (imgui.get_frame_height() + style.item_spacing.y)
    return imgui.get_font_size() * BAR_EM + controls + 2 * style.window_padding.y


def is_narrow() -> bool:
    """Whether the controls need two rows, as far as the room right of the cursor tells."""
    return imgui.get_content_region_avail().x < NARROW_EM * imgui.get_font_size()


@contextmanager
def below(app: AppState) -> Iterator[None]:
    """The contents of the block above the strip, in the current window; all of it where there is none."""
    strip = height(app)
    if not strip or imgui.get_content_region_avail().y < 2 * strip:
        yield
        return
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(0, 0))
    flags = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
    imgui.begin_child("above the timeline", ImVec2(0, -strip), imgui.ChildFlags_.none, flags)
    imgui.pop_style_var()
    try:
        yield
    finally:
        imgui.end_child()
        show(app)


def show(app: AppState) -> None:
    """The strip, at the cursor: the slider, and below it what plays and how."""
    player = app.feature(Sequences).player
    if player is None:
        return
    style, narrow = imgui.get_style(), is_narrow()
    background = imgui.get_style_color_vec4(imgui.Col_.window_bg)
    imgui.push_style_color(imgui.Col_.child_bg, background)
    flags = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
    padding = imgui.ChildFlags_.always_use_window_padding
    imgui.push_style_var(imgui.StyleVar_.window_padding, style.window_padding)
    imgui.begin_child("Timeline", ImVec2(0, 0), padding, flags)
    imgui.pop_style_var()
    imgui.pop_style_color()
    try:
        slider(app, player)
        buttons(app, player)
        if not narrow:
            imgui.same_line()
        settings(app, player)
    finally:
        imgui.end_child()


def slider(app: AppState, player: Player) -> None:
    """All frames side by side, in the colours of their states; a press or drag goes to a frame."""
    corner, width = imgui.get_cursor_screen_pos(), max(imgui.get_content_region_avail().x, 1.0)
    tall, count = imgui.get_font_size() * BAR_EM, len(player.sequence)
    imgui.invisible_button("frames", ImVec2(width, tall))
    draw = imgui.get_window_draw_list()
    states: list[FrameState] = [player.cache.state(index) for index in range(count)]
    starts = [index for index in range(count) if index == 0 or states[index] != states[index - 1]]
    for first, last in pairwise((*starts, count)):
        state = states[first]
        left, right = (corner.x + width * place / count for place in (first, last))
        if state == "failed":
            right = max(right, left + LEAST_MARK)
        ink = imgui.get_color_u32(COLOURS[state])
        draw.add_rect_filled(ImVec2(left, corner.y + 0.3 * tall), ImVec2(right, corner.y + 0.7 * tall), ink)
    under = min(max(int((imgui.get_mouse_pos().x - corner.x) / width * count), 0), count - 1)
    player.dragging = imgui.is_item_active()
    if player.dragging:
        app.post(sequence.seek, under)
    middle = corner.x + width * (player.head.frame + 0.5) / count
    half = max(width / count / 2, 0.2 * tall)
    head = (
        ImVec2(max(middle - half, corner.x), corner.y),
        ImVec2(min(middle + half, corner.x + width), corner.y + tall),
    )
    failed = player.cache.state(player.head.frame) == "failed"
    draw.add_rect_filled(*head, imgui.get_color_u32(theme.ERROR if failed else ImVec4(*theme.ACCENT, 1)), 2)
    if imgui.is_item_hovered():
        imgui.set_mouse_cursor(imgui.MouseCursor_.hand)
        if imgui.begin_tooltip():
            imgui.push_text_wrap_pos(imgui.get_font_size() * TIP_EM)
            imgui.text_unformatted(described(player, under))
            imgui.pop_text_wrap_pos()
            imgui.end_tooltip()


def described(player: Player, index: int) -> str:
    """Number, name and state of a frame, and how much of the sequence is in memory."""
    cache = player.cache
    lines = [f"{index + 1} of {len(player.sequence):,}: {player.sequence.labels[index]}"]
    if index in cache.problems:
        lines.append(cache.problems[index])
    lines.append(
        f"{len(cache):,} frames are decoded (blue), {bytes_in_words(cache.used)} of at most"
        f" {bytes_in_words(cache.budget)}"
    )
    return "\n".join(lines)


def buttons(app: AppState, player: Player) -> None:
    """First, previous, play, next, last; then the frame's number and name."""
    icons = icons_fontawesome_6
    play = icons.ICON_FA_PAUSE if player.head.playing else icons.ICON_FA_PLAY
    for i, (id, icon) in enumerate(
        (
            ("first_frame", icons.ICON_FA_BACKWARD_FAST),
            ("previous_frame", icons.ICON_FA_BACKWARD_STEP),
            ("play", play),
            ("next_frame", icons.ICON_FA_FORWARD_STEP),
            ("last_frame", icons.ICON_FA_FORWARD_FAST),
        )
    ):
        if i:
            imgui.same_line(0, 2)
        widgets.command_button(app, f"{icon}###{id}", id, width=imgui.get_frame_height() * 1.4)
    imgui.same_line()
    count = len(player.sequence)
    imgui.set_next_item_width(imgui.calc_text_size(f"{count} / {count}").x + 2 * imgui.get_frame_height())
    form = f"%d / {count}"
    flags = imgui.SliderFlags_.always_clamp
    changed, number = imgui.drag_int("##frame", player.head.frame + 1, 0.1, 1, count, form, flags)
    widgets.tooltip("Number of the frame, to drag or (double click) to type.")
    if changed:
        app.post(sequence.seek, number - 1)


def settings(app: AppState, player: Player) -> None:
    """On the right frame rate, repeat and memory; in the room that is left the name of the frame."""
    em, style = imgui.get_font_size(), imgui.get_style()
    rate, combo, gear = 5.2 * em, 5.6 * em, imgui.get_frame_height() * 1.2
    left, right = imgui.get_cursor_pos_x(), imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x
    start = max(right - rate - combo - gear - 2 * style.item_spacing.x, left)
    name(app, player, start - left - style.item_spacing.x)
    imgui.set_cursor_pos_x(start)
    imgui.set_next_item_width(rate)
    low, high = RANGES["frame_rate"]
    changed, fps = imgui.drag_float(
        "##rate", app.preferences.frame_rate, 0.2, low, high, "%.3g fps", imgui.SliderFlags_.always_clamp
    )
    widgets.tooltip(
        "Frames a second, to drag or (double click) to type; what is not decoded in time is dropped."
    )
    if changed:
        app.post(sequence.set_rate, fps)
    imgui.same_line()
    imgui.set_next_item_width(combo)
    modes = list(MODES)
    changed, index = imgui.combo("##repeat", modes.index(app.preferences.play_mode), list(MODES.values()))
    widgets.tooltip("At the last frame: on from the first, back again, or stop.")
    if changed:
        app.post(sequence.set_mode, modes[index])
    imgui.same_line()
    if imgui.button(f"{icons_fontawesome_6.ICON_FA_GEAR}###memory", ImVec2(gear, 0)):
        imgui.open_popup("Memory for frames")
    widgets.tooltip("Memory for decoded frames.")
    if imgui.begin_popup("Memory for frames"):
        memory(app, player)
        imgui.end_popup()


def name(app: AppState, player: Player, room: float) -> None:
    """The frame's name, or what hinders it, and the reached frame rate; as far as there is room."""
    index = player.head.frame
    text, colour = player.sequence.labels[index], imgui.get_style_color_vec4(imgui.Col_.text)
    tip = str(player.sequence.paths[index])
    held = app.feature(Sequences).held(app)
    if index in player.cache.problems:
        tip = player.cache.problems[index]
        text, colour = f"{text} cannot be read", theme.ERROR
    elif held is not None:
        text, tip, colour = held, held, theme.WARNING
    elif player.head.playing:
        fps, reached = app.preferences.frame_rate, player.reached
        if reached:
            missed = reached < REACHES * fps
            text = f"{reached:.1f} fps   {text}" if missed else text
            colour = theme.WARNING if missed else colour
            tip = f"{reached:.1f} of {fps:.3g} frames a second are reached"
    elif index != player.shown:
        text, colour = f"{text} ...", theme.QUIET
    if room <= imgui.get_font_size() * 2:
        return
    corner = imgui.get_cursor_screen_pos()
    imgui.push_clip_rect(corner, ImVec2(corner.x + room, corner.y + imgui.get_frame_height()), True)
    imgui.align_text_to_frame_padding()
    imgui.push_style_color(imgui.Col_.text, colour)
    imgui.text_unformatted(text)
    imgui.pop_style_color()
    widgets.tooltip(tip)
    imgui.pop_clip_rect()
    imgui.same_line()


def memory(app: AppState, player: Player) -> None:
    """The budget of the frames, and what of it is used."""
    imgui.text_unformatted(f"{len(player.cache):,} of {len(player.sequence):,} frames are decoded")
    imgui.set_next_item_width(imgui.get_font_size() * 9)
    gib = app.preferences.sequence_memory_gib
    form = "%.2f GiB" if gib else f"automatic: {bytes_in_words(player.cache.budget)}"
    low, high = RANGES["sequence_memory_gib"]
    changed, gib = imgui.drag_float("Memory", gib, 0.02, low, high, form, imgui.SliderFlags_.always_clamp)
    widgets.tooltip("For decoded frames; 0: a quarter of what was free when the sequence was opened.")
    if changed:
        app.post(partial(AppState.prefer, sequence_memory_gib=float(gib)))
