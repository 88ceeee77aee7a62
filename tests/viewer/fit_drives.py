"""Every part of the window in several sizes: what is cut off, and what overlaps; run by `conftest.drive` like
the functions of `drives`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from itertools import combinations
from typing import Any

import drives
from drives import Hand
from editing_drives import settle
from imgui_bundle import hello_imgui, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

import glfw  # isort: skip  (after imgui_bundle, which says which libglfw that is)

from splatview.viewer import layout, status_bar, toolbar
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing.session import session_of
from splatview.viewer.panels import edit, widgets
from splatview.viewer.state import AppState

SHOTS = os.environ.get("SPLATVIEW_SHOTS")
"""Folder for pictures of the window, to be looked at."""

SLACK = 1.5
"""px that rounding may take."""


def everything_fits(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Goes through pages, sections, tools and the strip in each of the sizes, and lists what is wrong."""
    settle(hand)
    app.prefer(smooth=False)
    hand.press("Ctrl+A")
    settle(hand)
    for _ in range(2):
        hand.press("Shift+4")
        hand.press("Shift+5")
    hand.press("Escape")
    for _ in range(2):
        hand.press("Ctrl+K")
    settle(hand)
    app.messages.clear()
    app.tell("A message that is so long that it has to be cut short in a window of any size " * 3)
    narrow, fewest = watch_labels(), watch_figures()
    looked = 0
    for width, height in options["sizes"]:
        resize(hand, width, height)
        size = f"{width}x{height}"
        for state in states(app, hand):
            hand.frames(4)
            looked += 1
            for name in shown(app):
                found.setdefault("wrong", []).extend(
                    f"{size} {state} {name}: {problem}" for problem in problems(hand, name)
                )
            found["wrong"] += [f"{size} {state}: {text}" for text in narrow]
            narrow.clear()
            found["wrong"] += [f"{size} {state}: {5 - count} figures are left out" for count in fewest]
            fewest.clear()
            found["wrong"] += [f"{size} {state}: {text}" for text in windows_apart(hand, app)]
            found["wrong"] += [f"{size} {state}: {text}" for text in beyond(hand, shown(app))]
            hand.shoot(f"{SHOTS}/{size} {state}.png".replace(" ", "_") if SHOTS else None)
    found["looked"] = looked
    found["scale"] = hello_imgui.dpi_window_size_factor()


def resize(hand: Hand, width: int, height: int) -> None:
    hand.on_gl_thread(lambda: glfw.set_window_size(glfw_window_hello_imgui(), width, height))
    hand.wait(lambda: imgui.get_io().display_size.x == width, "the window's size")
    hand.frames(4)


def states(app: AppState, hand: Hand) -> Iterator[str]:
    """Brings the window into one state after another, and names each."""
    for page in layout.PAGES:
        hand.page(page.name)
        if page.name == "Edit":
            for title, _ in edit.SECTIONS:
                session = session_of(app)
                assert session is not None
                session.forms.open_section = title
                hand.frames(3)
                settle(hand)
                yield f"Edit {title}"
            continue
        for title in FOLDS.get(page.name, ()):
            hand.ctx.item_open(title)
        yield page.name
    for panel in layout.available(app, layout.STRIP):
        hand.strip(panel.name)
        yield f"strip {panel.name}"
    hand.ctx.item_click(f"//##status/###{app.strip}")
    session = session_of(app)
    assert session is not None
    for tool in toolbar.TOOLS:
        hand.on_gl_thread(lambda tool=tool: session.take_tool(tool.name))
        yield f"tool {tool.label}"
    hand.press("Escape")
    for name, (command, _) in DIALOGS.items():
        hand.on_gl_thread(lambda command=command: COMMANDS[command].run(app))
        hand.frames(4)
        yield f"dialog {name}"
        hand.press("Escape")


FOLDS = {
    "Scene": ("Crops", "Cameras", "Problems", "Details"),
    "View": ("Picture", "Background", "Camera", "Lens", "Bookmarks", "Navigation", "Advanced", "Statistics"),
    "Accuracy": ("###Frame limit", "Compare", "Effects"),
}


DIALOGS = {
    "settings": ("settings", "Settings"),
    "export": ("export", "Export the scene"),
    "film": ("export_film", "Export the film"),
    "start": ("start_screen", "Start"),
    "recent": ("recent", "Recent scenes"),
    "screenshot": ("screenshot_as", "Save a picture"),
    "help": ("toggle_help", "Keys and mouse"),
    "palette": ("toggle_palette", "Commands"),
}
"""Name of a dialog -> the command that opens it, and ImGui's name of it."""


def shown(app: AppState) -> list[str]:
    """ImGui's names of the parts that are on the screen: of a dialog alone, where one is open."""
    return [DIALOGS[app.dialog][1]] if app.dialog in DIALOGS else parts(app)


def parts(app: AppState) -> list[str]:
    """ImGui's names of the parts of the window below dialogs."""
    open_now = [
        layout.open_panel(app, layout.PAGES, app.page),
        layout.open_panel(app, layout.STRIP, app.strip),
    ]
    return ["View", "##rail", "##status", *(panel.window for panel in open_now if panel is not None)]


def gathered(hand: Hand, name: str) -> list[Any]:
    """All items of a window and its children."""
    items = imgui.test_engine.TestItemList()
    hand.ctx.gather_items(items, f"//{name}")
    return [items.get_by_index(number) for number in range(items.get_size())]


def problems(hand: Hand, name: str) -> list[str]:
    """Items of a window that are cut off at its sides, and those that lie on each other; and a window whose
    contents are wider than it is."""
    window = hand.ctx.get_window_by_ref(f"//{name}")
    found = []
    if window.content_size.x > window.work_rect.max.x - window.work_rect.min.x + SLACK:
        room = window.work_rect.max.x - window.work_rect.min.x
        end = window.work_rect.max.x + SLACK
        widest = [label(item) for item in gathered(hand, name) if item.rect_full.max.x > end]
        found.append(f"contents {window.content_size.x:.0f} px wide in {room:.0f} px: {'; '.join(widest)}")
    items = gathered(hand, name)
    items = [item for item in items if item.id_ != window.get_id("picture")]
    plots = [item for item in items if item.rect_full.get_height() > PLOT_EM * imgui.get_font_size()]
    # Axes and lines of a plot belong to it.
    items = [item for item in items if not any(within(item, plot) for plot in plots)]
    for item in items:
        rect, inner = item.rect_full, item.window.inner_rect
        if rect.min.x < inner.min.x - SLACK or rect.max.x > inner.max.x + SLACK:
            found.append(f"{label(item)} cut off: {rect.min.x:.0f} to {rect.max.x:.0f}")
        if name in ("View", "##rail", "##status") and (
            rect.min.y < inner.min.y - SLACK or rect.max.y > inner.max.y + SLACK
        ):
            found.append(f"{label(item)} cut off: {rect.min.y:.0f} to {rect.max.y:.0f} below")
    for a, b in combinations(items, 2):
        if covers(a, b):
            found.append(f"{label(a)} overlaps {label(b)}")
    return found


PLOT_EM = 5.0
"""Font heights that only plots and pictures have."""


def within(item: Any, plot: Any) -> bool:
    return (
        item.id_ != plot.id_
        and item.window.id_ == plot.window.id_
        and plot.rect_full.contains(item.rect_full)
    )


def covers(a: Any, b: Any) -> bool:
    """Whether two items lie on each other, rows that lie under their own buttons not counted."""
    if (a.item_flags | b.item_flags) & int(imgui.internal.ItemFlagsPrivate_.allow_overlap):
        return False
    if a.id_ == b.window.child_id or b.id_ == a.window.child_id:
        return False  # a window within, and its contents
    x = min(a.rect_clipped.max.x, b.rect_clipped.max.x) - max(a.rect_clipped.min.x, b.rect_clipped.min.x)
    y = min(a.rect_clipped.max.y, b.rect_clipped.max.y) - max(a.rect_clipped.min.y, b.rect_clipped.min.y)
    share = 2 * hello_imgui.dpi_window_size_factor()  # rows of a table share a line
    return x > SLACK and y > SLACK + share


def label(item: Any) -> str:
    low, high = item.rect_full.min, item.rect_full.max
    return f"{item.window.name} ({low.x:.0f}, {low.y:.0f}) to ({high.x:.0f}, {high.y:.0f})"


def watch_labels() -> list[str]:
    """Lists from now on labels of rows that reach below their controls."""
    found: list[str] = []
    as_it_was = widgets.label

    def watched(text: str, tip: str, *, share: float = widgets.LABEL_SHARE) -> None:
        room = imgui.get_content_region_avail().x * share
        if imgui.calc_text_size(text).x > room:
            found.append(f"the label {text!r} is {imgui.calc_text_size(text).x:.0f} px wide in {room:.0f} px")
        as_it_was(text, tip, share=share)

    widgets.label = watched
    return found


def watch_figures() -> list[int]:
    """Counts from now on the status bar's figures wherever there are fewer than all five."""
    found: list[int] = []
    as_it_was = status_bar.shown_figures

    def watched(app: AppState, left: float, right: float) -> list[tuple[float, str, str]]:
        places = as_it_was(app, left, right)
        if len(places) < 5:
            found.append(len(places))
        return places

    status_bar.shown_figures = watched
    return found


def windows_apart(hand: Hand, app: AppState) -> list[str]:
    """Parts of the window that lie on each other."""
    rects = {name: hand.ctx.get_window_by_ref(f"//{name}").rect() for name in parts(app)}
    found = []
    for (one, a), (other, b) in combinations(rects.items(), 2):
        x = min(a.max.x, b.max.x) - max(a.min.x, b.min.x)
        y = min(a.max.y, b.max.y) - max(a.min.y, b.min.y)
        if x > 0 and y > 0:
            found.append(f"{one} and {other} overlap")
    return found


def beyond(hand: Hand, names: list[str]) -> list[str]:
    """Those of the windows `names` that reach beyond the program's."""
    size = imgui.get_io().display_size
    rects = {name: hand.ctx.get_window_by_ref(f"//{name}").rect() for name in names}
    return [
        f"{name} is beyond the window"
        for name, rect in rects.items()
        if rect.min.x < 0 or rect.min.y < 0 or rect.max.x > size.x or rect.max.y > size.y
    ]


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
