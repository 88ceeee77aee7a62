"""The Scene page: files, crops and cameras of the open scene, its problems, its size."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from imgui_bundle import imgui

from splatview.edit.impact import NO_LOSS, in_words
from splatview.edit.operations import Select
from splatview.edit.operations.cleanup import REPAIRS, Repair
from splatview.edit.selectors import InvalidSplats
from splatview.scene.health import Finding
from splatview.viewer import theme
from splatview.viewer.editing import cleanup
from splatview.viewer.editing.commands import apply
from splatview.viewer.editing.session import session_of
from splatview.viewer.loading import Examination
from splatview.viewer.panels import camera, crops, files, widgets
from splatview.viewer.panels.clean import quality
from splatview.viewer.state import AppState

LABELS = {"needles": "needles and discs"}
"""Findings whose names alone say something else where the detectors are: its Needles are no discs."""


def show_health(app: AppState, findings: Sequence[Finding]) -> None:
    """Findings of the health check, hidden and deleted splats included, each with a button that selects the
    splats and one that repairs them, and says before what that costs."""
    found = [finding for finding in findings if finding.count]
    if not found:
        widgets.note("No problems found.")
    prices = cleanup.repair_prices(app)
    size = imgui.get_font_size()
    for finding in found:
        imgui.text_colored(theme.WARNING if finding.culled else theme.QUIET, f"{finding.count:,}")
        imgui.same_line(size * 4)
        imgui.text_unformatted(LABELS.get(finding.name, finding.name))
        widgets.tooltip(finding.what)
        # On a line of its own, which a narrow panel holds too.
        imgui.set_cursor_pos_x(size * 4)
        if imgui.small_button(f"Select##{finding.name}"):
            app.post(partial(apply, operation=Select(by=InvalidSplats(finding=finding.name))))
        widgets.tooltip("Selects them, to be looked at, deleted or hidden.")
        if finding.name not in REPAIRS:
            continue
        imgui.same_line()
        if imgui.small_button(f"Repair##{finding.name}"):
            app.post(partial(apply, operation=Repair(finding=finding.name)))
        widgets.tooltip(f"As a step that can be undone: {REPAIRS[finding.name]}.")
        price = prices.get(finding.name)
        if price is not None:
            imgui.same_line()
            worst = "no change" if price.worst >= NO_LOSS else f"{price.worst:.0f} dB"
            imgui.text_colored(quality(price), worst)
            widgets.tooltip(f"The repair: {in_words(price)}; above 45 dB nobody sees a difference.")
    names = [finding.name for finding in found if finding.name in REPAIRS]
    if names and not prices and session_of(app) is not None:
        widgets.button(
            "What would repairs cost?",
            f"Draws {cleanup.VIEWS} views as they are and with each repair, and compares.",
            partial(app.post, partial(cleanup.measure_repairs, names=names)),
            width=-1,
        )


def show(app: AppState) -> None:
    """The Scene page: files, crops, cameras, problems."""
    if not app.is_open:
        widgets.note("Nothing is open yet. Drop a scene on the window, or open one:")
        widgets.command_button(app, "Open...", "open")
        return
    if widgets.fold(app, "Files", opened=True):
        imgui.push_id("files")
        files.show(app)
        imgui.pop_id()
    session = session_of(app)
    if session is not None and widgets.fold(app, "Crops", opened=True):
        imgui.push_id("crops")
        crops.list_of(app, session)
        imgui.pop_id()
    if widgets.fold(app, "Cameras", opened=bool(app.cameras)):
        camera.show_cameras(app)
    if app.examination is not None and widgets.fold(app, "Problems", opened=True):
        examination(app, app.examination)
    if widgets.fold(app, "Details"):
        details(app)


def details(app: AppState) -> None:
    """Size and place of the scene, and the comments of its file."""
    scene, gaussians = app.scene, app.scene.gaussians
    widgets.fact(
        "SH degree", str(gaussians.sh_degree), "Highest band of view-dependent colour that is stored."
    )
    widgets.fact("In memory", f"{gaussians.nbytes / 2**20:,.1f} MiB", "All arrays of the scene.")
    if scene.extent is not None:
        low, high = (", ".join(f"{v:.4g}" for v in side) for side in scene.extent)
        widgets.fact("From", low, "Least x, y, z of all finite centres, world units.")
        widgets.fact("To", high, "Greatest x, y, z of all finite centres, world units.")
    widgets.fact(
        "Centre",
        ", ".join(f"{v:.4g}" for v in scene.centre),
        "Of where the splats are as the scene was opened, outliers left out.",
    )
    widgets.fact("Radius", f"{scene.radius:.4g}", "Of the same, world units.")
    if gaussians.comments:
        widgets.section("Comments in the file")
        for comment in gaussians.comments:
            widgets.note(comment)


def examination(app: AppState, found: Examination) -> None:
    """The health of the splats."""
    if not found.done:
        widgets.note("Looking at the splats...")
        return
    show_health(app, found.findings)
