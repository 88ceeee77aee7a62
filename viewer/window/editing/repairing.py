"""What repairs of the health report would cost, measured in a thread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ....edit.operations.repairing import Repair
from ....edit.price import Price
from ....edit.step_price import price_operations
from ....edit.watch import Watch
from .cleaning import VIEWS, views

if TYPE_CHECKING:
    from ..core import Core

__all__ = ["VIEWS", "measure", "prices"]


def prices(core: Core) -> dict[str, Price]:
    """By finding; none where they were not measured, or the scene was edited since."""
    if core.desk is None:
        return {}
    form = core.desk.forms.health
    return form.prices if form.of == core.desk.document.versions else {}


def measure(core: Core, names: Sequence[str]) -> None:
    """Of the repairs of the findings `names`, each by itself, by the renderer of all prices."""
    desk = core.desk
    if desk is None:
        return
    form, document = desk.forms.health, desk.document
    repairs = {name: Repair(finding=name) for name in names}
    of, cameras = document.versions, views(core, desk)

    def work(watch: Watch) -> dict[str, Price]:
        return price_operations(document, repairs, cameras, watch=watch)

    def done(found: dict[str, Price]) -> None:
        form.prices, form.of = found, of

    desk.start("Measuring what repairs cost", work, done)
