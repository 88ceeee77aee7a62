"""The receipt in a real window: read, priced, overridden and taken back; run by `conftest.drive`."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import drives
import numpy as np
from drives import Hand

from splatview.edit.operations import Hide, SelectAll
from splatview.viewer.editing.commands import apply
from splatview.viewer.quality.effects import Effects
from splatview.viewer.state import AppState


def receipt(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    hand.settle()
    app.prefer(smooth=False)
    effects = app.feature(Effects)
    effects.rounds = options.get("rounds")
    exact = hand.picture()
    hand.page("Accuracy")
    hand.ctx.item_close("###Frame limit")
    hand.ctx.item_close("Compare")
    hand.ctx.item_open("Effects")
    found["receipt"] = [[e.name, e.on, e.in_force, e.why] for e in effects.receipt(app)]
    hand.shoot(options.get("shot"))

    hand.ctx.item_click("**/###measure effects")
    hand.wait(lambda: bool(effects.prices), "the prices")
    hand.frames(3)
    found["prices"] = {
        name: [price.on, price.ms, price.saved_ms, price.psnr, price.max_error, str(price)]
        for name, price in effects.prices.items()
    }
    hand.shoot(options.get("shot_prices"))

    hand.ctx.item_click("**/##SH band 2")
    hand.frames(3)
    hand.settle()
    found["without"] = [e.name for e in effects.receipt(app) if e.forced is False]
    found["degree"] = app.settings.sh_degree
    found["differs"] = float(np.abs(hand.picture() - exact).max())
    hand.ctx.item_click("**/##antialiased opacity")
    hand.frames(3)
    found["antialiased"] = app.settings.model.antialiased
    hand.ctx.item_click("**/###as called for")
    hand.frames(3)
    hand.settle()
    found["overridden"] = effects.overridden(app)
    found["back"] = float(np.abs(hand.picture() - exact).max())

    app.post(partial(apply, operation=SelectAll()))
    app.post(partial(apply, operation=Hide()))

    def hidden() -> Any:
        return next(effect for effect in effects.receipt(app) if effect.name == "hidden splats")

    hand.wait(lambda: hidden().on, "the receipt to know of the edit")
    found["hidden"] = hidden().why


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
