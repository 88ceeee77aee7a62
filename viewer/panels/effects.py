"""The Effects panel: what this scene calls for and what is left out, why, at which price; with switches."""

from __future__ import annotations

import math
from functools import partial

from imgui_bundle import ImVec4, imgui

from splatview.measure.effect_costs import EDITS, EffectPrice
from splatview.scene.effects.effect import Effect, grey_levels
from splatview.viewer import theme
from splatview.viewer.panels import widgets
from splatview.viewer.quality.effects import Effects
from splatview.viewer.state import AppState

EDIT_EFFECTS = ("hidden splats", "crop", "adjusted splats", "colour grade")
"""Effects whose price is that of the edits together."""


def show(app: AppState) -> None:
    effects = app.feature(Effects)
    if not app.is_open:
        widgets.note("Open a scene to see which effects it calls for.")
        return
    if app.examination is None or not app.examination.done:
        widgets.note("Looking at the splats...")
        return
    receipt = effects.receipt(app)
    on = sum(effect.in_force for effect in receipt)
    widgets.note(f"{on} of {len(receipt)} effects are computed: those that can be seen in this scene.")
    tools(app, effects)
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    if imgui.begin_table("effects", 3, flags):
        for title, width in (("", 0.6), ("effect", 3.0), ("time", 1.4)):
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch, width)
        for effect in receipt:
            row(app, effects, effect)
        imgui.end_table()


def tools(app: AppState, effects: Effects) -> None:
    pricing = effects.pricing
    if pricing is None:
        again = "Measure again" if effects.prices else "Measure"
        widgets.button(
            f"{again}###measure effects",
            "Draws this view with each effect the other way, beside the picture as it is, for some seconds, "
            "and tells the difference in time.",
            partial(app.post, effects.measure),
        )
    else:
        widgets.progress(pricing.progress, pricing.text, beside_em=5)
        imgui.same_line()
        widgets.button(
            "Cancel###cancel effects",
            "Ends measuring.",
            partial(app.post, lambda app: effects.cancel_measuring()),
        )
    if effects.overridden(app):
        widgets.button(
            "As the scene calls for###as called for",
            "Takes all switches back.",
            partial(app.post, effects.as_called_for),
        )


def row(app: AppState, effects: Effects, effect: Effect) -> None:
    """On or off, the name with the evidence as its tooltip, and the time it costs or would cost."""
    imgui.table_next_row()
    imgui.table_next_column()
    if effect.can_override:
        changed, on = imgui.checkbox(f"##{effect.name}", effect.in_force)
        widgets.tooltip("Computed or not, whatever the scene calls for.")
        if changed:
            app.post(effects.switch, effect.name, on)
    else:
        imgui.align_text_to_frame_padding()
        colour = ImVec4(*theme.ACCENT, 1) if effect.in_force else theme.QUIET
        imgui.text_colored(colour, "on" if effect.in_force else "off")
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    if effect.forced is None:
        imgui.text_unformatted(effect.name)
    else:
        imgui.text_colored(theme.WARNING, f"{effect.name} (by hand)")
    price = effects.prices.get(EDITS if effect.name in EDIT_EFFECTS and effect.in_force else effect.name)
    widgets.tooltip(evidence(effect, price))
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    if price is None:
        imgui.text_colored(theme.QUIET, "-")
    elif not price.clear:
        imgui.text_colored(theme.QUIET, "same")
    else:
        saved = price.saved_ms
        imgui.text_unformatted(f"{saved:+.0f} ms" if abs(saved) >= 100 else f"{saved:+.2g} ms")
    widgets.tooltip(str(price) if price is not None else "Not measured: it cannot be turned the other way.")


def evidence(effect: Effect, price: EffectPrice | None) -> str:
    """The receipt's line in full: why, what leaving it out saves and can cost, and what was measured."""
    lines = [f"{effect.why[:1].upper()}{effect.why[1:]}."]
    if str(effect.saving) != "nothing":
        lines.append(f"Leaving it out saves {effect.saving}.")
    if math.isfinite(effect.bound) and not effect.in_force:
        lines.append(
            f"Left out, it can change a pixel by {grey_levels(effect.bound)} at most."
            if effect.bound
            else "Left out, it changes nothing."
        )
    if effect.forced is not None:
        lines.append(f"The scene calls for it {'on' if effect.on else 'off'}.")
    if price is not None:
        lines.append(f"Measured here: {price}.")
    return "\n".join(lines)
