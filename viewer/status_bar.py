"""The status bar: the bottom strip's switches, the last message, a hint, and figures of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from imgui_bundle import ImVec2, ImVec4, imgui

from splatview.scene.errors import printable
from splatview.viewer import theme
from splatview.viewer.commands import COMMANDS, keys_of
from splatview.viewer.depth_of_field import DepthOfField
from splatview.viewer.editing.session import session_of
from splatview.viewer.editing.tool_state import SELECTING, ToolName
from splatview.viewer.entries import Panel
from splatview.viewer.panels import widgets
from splatview.viewer.preferences import NavigationMode
from splatview.viewer.state import AppState

HINTS: dict[NavigationMode, tuple[str, ...]] = {
    "orbit": ("Drag: orbit", "Right drag: pan", "Wheel: zoom", "Double click: turn about"),
    "fly": ("Drag: look", "W A S D E Q: move", "Wheel: speed", "Shift: fast"),
    "trackball": ("Drag: turn", "Right drag: pan", "Wheel: zoom", "Double click: turn about"),
}

TOOL_HINTS: dict[ToolName, tuple[str, ...]] = {
    "rectangle": ("Drag: select",),
    "lasso": ("Drag: draw around",),
    "brush": ("Drag: paint", "Shift + [ ]: radius"),
    "polygon": ("Click: corner", "Double click: close"),
    "flood": ("Click: select what hangs together",),
    "colour": ("Click: select the colour",),
    "move": ("Drag an arrow: move", "Drag beside: orbit"),
    "rotate": ("Drag a ring: rotate", "Drag beside: orbit"),
    "scale": ("Drag a handle: scale", "Drag beside: orbit"),
    "crop_box": ("Drag the handles", "Drag beside: orbit"),
    "crop_sphere": ("Drag the handles", "Drag beside: orbit"),
    "measure": ("Click: two points",),
    "ground": ("Click: three points of the ground",),
}

MODIFIERS = ("Shift: add", "Ctrl: remove", "Both: keep common")


def hint(app: AppState) -> tuple[str, ...]:
    """What the mouse does on the picture now, the most important first."""
    session = session_of(app)
    if app.feature(DepthOfField).picking:
        return ("Click: what shall be sharp", "Esc: done")
    if session is None or session.tool == "none":
        return (*HINTS[app.preferences.navigation], f"{keys_of('toggle_help')}: keys")
    more = MODIFIERS if session.tool in SELECTING else ()
    turning = () if "Drag beside: orbit" in TOOL_HINTS[session.tool] else ("Alt + drag: turn",)
    return (*TOOL_HINTS[session.tool], "Esc: done", *more, *turning)


BRIEF = "9.9M"
"""As wide as `brief` gets."""


def brief(count: int) -> str:
    """A number of splats in four characters or fewer: 950, 9.5k, 512k, 1.2M."""
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if count >= 0.9995 * size:
            return f"{count / size:.{1 if count < 9.95 * size else 0}f}{unit}"
    return f"{count}"


def figures(app: AppState, *, short: bool = False) -> list[tuple[str, str, str]]:
    """Text, the widest that it gets, and what it means, of each figure on the right; `short`: counts rounded
    and without their names, for a narrow window."""
    stats, session = app.stats, session_of(app)
    count = stats.splats if session is None else session.document.counts.kept
    rate = app.rate.at(app.now(), stats.drawn)
    size = app.picture.texture.size if app.picture.texture is not None else (0, 0)
    wide = f"{len(app.scene.gaussians) if app.is_open else stats.splats:,}"
    speed = "at rest" if rate is None else f"{rate:.0f} fps"
    total = sum(stats.ms.values())
    splats, visible = f"{count:,} splats", f"{stats.visible:,} visible"
    return [
        (
            brief(count) if short else splats,
            BRIEF if short else f"{wide} splats",
            f"{splats} in the scene, without deleted ones.",
        ),
        (
            brief(stats.visible) if short else visible,
            BRIEF if short else f"{wide} visible",
            f"{visible}: left after culling, a frame or two ago.",
        ),
        (
            speed,
            "at rest",
            f"Pictures drawn a second, while something changes; the last took {total:.1f} ms.",
        ),
        (
            f"{size[0]} x {size[1]}",
            "8888 x 8888",
            "Resolution of the picture shown, px: smaller than the window while a slow picture moves.",
        ),
        (app.picture.backend, "reference", f"Renderer: {app.picture.name}, on {app.gpu_name}."),
    ]


def show(app: AppState, strip: Sequence[Panel]) -> None:
    """The whole bar, in a window of its own; in a narrow one the hint ends sooner and counts are rounded."""
    style, em = imgui.get_style(), imgui.get_font_size()
    imgui.set_cursor_pos(ImVec2(style.window_padding.x * 0.6, (imgui.get_window_height() - em * 1.5) / 2))
    switches(app, strip, em * 1.5)
    width = imgui.get_window_width()
    gap, left = em * GAP_EM, imgui.get_cursor_pos_x()
    top = (imgui.get_window_height() - em) / 2
    places = shown_figures(app, left, width - style.window_padding.x)
    for x, text, tip in places:
        imgui.set_cursor_pos(ImVec2(x, top))
        imgui.text_colored(theme.QUIET, text)
        widgets.tooltip(tip)
    right = places[-1][0] - gap if places else width
    session = session_of(app)
    if session is not None and session.job is not None and session.job.yields != "silently":
        job(app, session.job.title, session.job.progress, left, right)
        return
    right = show_hint(app, left, right, top)
    message(app, left, right - gap, top)


def shown_figures(app: AppState, left: float, right: float) -> list[tuple[float, str, str]]:
    """Places of the figures beside each other up to `right`: all of them, but in a window so narrow that even
    short ones reach beyond `left`, px."""
    em = imgui.get_font_size()
    places = placed(figures(app), right, GAP_EM * em)
    if places[-1][0] < left + LEAST_MESSAGE_EM * em:  # too narrow for all in full
        places = placed(figures(app, short=True), right, SHORT_GAP_EM * em)
    while places and places[-1][0] < left + 0.5 * em:
        places.pop()
    return places


GAP_EM, SHORT_GAP_EM = 0.9, 0.6
"""Between figures, in font heights: in full, and where there is little room."""


def placed(figures: Sequence[tuple[str, str, str]], right: float, gap: float) -> list[tuple[float, str, str]]:
    """Left end, text and meaning of figures beside each other up to `right`, the last one first."""
    places = []
    for text, widest, tip in reversed(figures):
        right -= max(imgui.calc_text_size(one).x for one in (text, widest))
        places.append((right, text, tip))
        right -= gap
    return places


def switches(app: AppState, strip: Sequence[Panel], side: float) -> None:
    """A button for each panel of the strip."""
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(0, 0))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(2, 0))
    for panel in strip:
        open_now = app.strip == panel.name and not app.panels_hidden
        colour = theme.CHOSEN if open_now else ImVec4(0, 0, 0, 0)
        imgui.push_style_color(imgui.Col_.button, colour)
        id = f"strip_{panel.name.lower()}"
        if imgui.button(f"{panel.icon}###{panel.name}", ImVec2(side * 1.15, side)):
            app.post(COMMANDS[id].run)
        imgui.pop_style_color()
        widgets.command_tooltip(app, id)
        imgui.same_line()
    imgui.pop_style_var(2)
    imgui.dummy(ImVec2(1, 1))
    imgui.same_line()


LEAST_MESSAGE_EM = 12.0
"""Room that the message keeps beside the hint, in font heights."""

SEPARATOR = "   "


def show_hint(app: AppState, left: float, right: float, top: float) -> float:
    """As much of the hint as there is room for, up to `right`; where it begins."""
    parts = list(hint(app))
    room = right - left - LEAST_MESSAGE_EM * imgui.get_font_size()
    while parts and imgui.calc_text_size(SEPARATOR.join(parts)).x > room:
        parts.pop()
    if not parts:
        return right
    text = SEPARATOR.join(parts)
    start = right - imgui.calc_text_size(text).x
    imgui.set_cursor_pos(ImVec2(start, top))
    imgui.text_colored(theme.QUIET, text)
    widgets.tooltip("\n".join(hint(app)))
    return start


def message(app: AppState, left: float, right: float, top: float) -> None:
    """The last message, cut where there is no room for it; the Log has it in full."""
    if not app.messages or right <= left:
        return
    latest = app.messages[-1]
    text = widgets.fitting(printable(latest.text), right - left)
    imgui.set_cursor_pos(ImVec2(left, top))
    if latest.error:
        imgui.text_colored(theme.ERROR, text)
    else:
        imgui.text_unformatted(text)
    if text != latest.text:
        widgets.tooltip(latest.text)


def job(app: AppState, title: str, progress: float, left: float, right: float) -> None:
    """Slow work under way, with a way to stop it."""
    em = imgui.get_font_size()
    height = em * 1.5
    cancel = imgui.calc_text_size("Cancel").x + em
    imgui.set_cursor_pos(ImVec2(left, (imgui.get_window_height() - height) / 2))
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(em * 0.5, (height - em) / 2))
    room = min(right - left - cancel - em, 26 * em)
    if room > 4 * em:
        imgui.progress_bar(progress, ImVec2(room, height), widgets.fitting(title, room - em))
        imgui.same_line()
    widgets.button(
        "Cancel###cancel job",
        "Ends this work; nothing is changed (Esc).",
        partial(app.post, COMMANDS["cancel"].run),
    )
    imgui.pop_style_var()
