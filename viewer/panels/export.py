"""The Export dialog: a format, what it may cost, the cost measured, and only then the file."""

from __future__ import annotations

import math
from pathlib import Path

from imgui_bundle import imgui

from splatview.scene.errors import bytes_in_words
from splatview.viewer import theme
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.editing.exporting import (
    DIALOG,
    GOALS,
    SCOPES,
    WRITTEN,
    Exporting,
    choose_place,
    contents_of,
    measure_export,
    title_of,
    write_export,
)
from splatview.viewer.editing.session import EditSession, session_of
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState

WIDTH_EM = 32

DEGREES = ("0", "1", "2", "3")

GOAL_NAMES = ("none: usual precision", "a quality, in as few bytes", "a size, at the best quality")


def show_dialog(app: AppState) -> None:
    """Format, SH degree, scope and target; Measure, what came of it, and Write."""
    session = session_of(app)
    if app.dialog != DIALOG or session is None:
        return
    exporting = app.feature(Exporting)
    centred(WIDTH_EM)
    imgui.set_next_window_size((imgui.get_font_size() * WIDTH_EM, 0))
    opened = imgui.begin("Export the scene", True, DIALOG_FLAGS | imgui.WindowFlags_.always_auto_resize)[1]
    measuring = session.job is not None
    imgui.begin_disabled(measuring)
    _choices(app, exporting, session)
    imgui.end_disabled()
    _result(app, exporting, session)
    _place(app, exporting, session, measuring)
    imgui.end()
    if not opened:
        app.dialog = None


def _choices(app: AppState, exporting: Exporting, session: EditSession) -> None:
    settings, degree = exporting.settings, session.gaussians.sh_degree
    chosen = widgets.combo(
        "Format",
        settings.format,
        WRITTEN,
        "The format of the file.",
        [title_of(name) for name in WRITTEN],
    )
    if chosen is not None:
        exporting.choose(app, format=chosen)
    widgets.note(f"Holds {contents_of(settings.known)}.")
    if settings.known.sh and degree:
        offered = DEGREES[: degree + 1]
        picked = widgets.combo(
            "SH degree",
            offered[min(settings.sh_degree, degree)],
            offered,
            "Highest SH degree that is kept: fewer bands, a smaller file, and less change of colour with the "
            "direction.",
        )
        if picked is not None:
            exporting.choose(app, sh_degree=int(picked) if int(picked) < degree else 3)
    scope = widgets.combo(
        "Splats",
        settings.scope,
        SCOPES,
        "Which splats are written; deleted and cropped ones never are.",
    )
    if scope is not None:
        exporting.choose(app, scope=scope)
    goal = widgets.combo(
        "Target",
        settings.goal,
        GOALS,
        "With a target, a search among coarser numbers, fewer SH bands and fewer splats finds what meets it "
        "best.",
        GOAL_NAMES,
    )
    if goal is not None:
        exporting.choose(app, goal=goal)
    if settings.goal == "quality":
        psnr = widgets.slider("dB", settings.psnr, 20, 70, "PSNR over views from around.", form="%.1f")
        if psnr is not None:
            exporting.choose(app, psnr=psnr)
    elif settings.goal == "size":
        size = widgets.slider(
            "MB", settings.megabytes, 0.01, 1000, "Million bytes at most.", form="%.2f", logarithmic=True
        )
        if size is not None:
            exporting.choose(app, megabytes=size)


def _result(app: AppState, exporting: Exporting, session: EditSession) -> None:
    """Measure, its progress, or what it found."""
    imgui.separator()
    if session.job is not None:
        widgets.progress(session.job.progress, session.job.title, beside_em=5)
        imgui.same_line()
        if imgui.button("Cancel"):
            session.job.cancel()
        return
    # No tooltip: it would cover what comes of it.
    widgets.button("Measure", "", lambda: app.post(measure_export))
    measured = exporting.measured
    if measured is None or not exporting.is_current(session):
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        imgui.text_colored(theme.QUIET, "to see size and quality before anything is written")
        return
    found = measured.found
    widgets.fact("Size", f"{bytes_in_words(found.bytes)} ({found.bytes:,} bytes), {found.splats:,} splats")
    if found.psnr == math.inf:
        widgets.fact("Quality", "every number as it was")
    else:
        widgets.fact("Quality", f"{found.psnr:.1f} dB over {found.views} views from around")
        widgets.fact("Largest error", f"{255 * found.max_error:.0f} of 255 in one pixel")
    if exporting.settings.goal != "none" and found.knobs:
        widgets.fact("Chosen", found.knobs_in_words)
    for loss in found.lost:
        widgets.note(f"- {loss}", theme.WARNING)
    if not found.lost:
        widgets.note("Nothing is lost.")


def _place(app: AppState, exporting: Exporting, session: EditSession, measuring: bool) -> None:
    imgui.separator()
    imgui.begin_disabled(measuring)
    imgui.set_next_item_width(-imgui.get_font_size() * 7)
    changed, text = imgui.input_text("##path", exporting.path)
    if changed:
        exporting.path = text
    widgets.tooltip("The file to write.")
    imgui.same_line()
    widgets.button("Browse...", "Chooses folder and name.", lambda: app.post(choose_place))
    imgui.end_disabled()
    problem = exporting.problem(session)
    if not problem and Path(exporting.path).expanduser().exists():
        widgets.note("A file of this name is there; it will be replaced.", theme.WARNING)
    elif problem:
        widgets.note(problem, theme.WARNING)
    lacks = "It is under way" if measuring else problem
    tip = "Writes the file, and says what it has lost; Measure says so before."
    widgets.button("Write", tip, lambda: app.post(write_export), lacks=lacks)
    imgui.same_line()
    if imgui.button("Close"):
        app.dialog = None
