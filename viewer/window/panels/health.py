"""What is ill in the scene: a click selects it, a button repairs it, and says before what that costs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from imgui_bundle import imgui

from ....edit.operations import Select
from ....edit.operations.repairing import REPAIRS, Repair
from ....edit.price import NO_LOSS
from ....edit.selecting import IllSplats
from ....edit.step_price import in_words
from ....scene.health import Finding
from .. import theme
from ..core import Core
from ..editing import repairing
from ..editing.commands import apply
from ..editing.panels.clean import quality
from . import widgets


def show(core: Core, findings: Sequence[Finding]) -> None:
    """Those that concern any splat, of the scene as edits have made it, what they hide or delete included."""
    widgets.section("Health")
    ill = [finding for finding in findings if finding.count]
    if not ill:
        widgets.note("No splat is ill.")
    prices = repairing.prices(core)
    size = imgui.get_font_size()
    for finding in ill:
        imgui.text_colored(theme.WARNING if finding.culled else theme.QUIET, f"{finding.count:,}")
        imgui.same_line(size * 4)
        clicked, _ = imgui.selectable(finding.name, False)
        widgets.tooltip(f"{finding.what} Click to select them.")
        if clicked:
            core.post(partial(apply, operation=Select(by=IllSplats(finding=finding.name))))
        if finding.name not in REPAIRS:
            continue
        # On a line of its own, which a narrow panel holds too.
        imgui.set_cursor_pos_x(size * 4)
        if imgui.small_button(f"Repair##{finding.name}"):
            core.post(partial(apply, operation=Repair(finding=finding.name)))
        widgets.tooltip(f"As a step that can be undone: {REPAIRS[finding.name]}.")
        price = prices.get(finding.name)
        if price is not None:
            imgui.same_line()
            worst = "no change" if price.worst >= NO_LOSS else f"{price.worst:.0f} dB"
            imgui.text_colored(quality(price), worst)
            widgets.tooltip(f"The repair: {in_words(price)}. Above 45 dB nobody sees a difference.")
    names = [finding.name for finding in ill if finding.name in REPAIRS]
    if names and not prices and core.desk is not None:
        widgets.button(
            "What would repairs cost?",
            f"Draws {repairing.VIEWS} views as they are and with each repair, and compares.",
            partial(core.post, partial(repairing.measure, names=names)),
            width=-1,
        )
