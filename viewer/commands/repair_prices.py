"""What each repair of the health report changes in pictures, for `splatview info --repairs`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ...edit.document import Document
from ...edit.operations.repairing import REPAIRS, Repair
from ...edit.price import Price
from ...edit.sample_views import sample_cameras
from ...edit.step_price import in_words, price_operations
from ...scene import Gaussians
from .edit_tools import RasterTools

VIEWS = 8
"""That a price is measured in."""


def add_repairs(receipt: dict[str, Any], gaussians: Gaussians) -> None:
    """Gives each finding of `receipt["health"]` that can be repaired "repair", what it does, and "price"."""
    document = Document(gaussians, tools=RasterTools())
    found = [entry for entry in receipt["health"] if entry["count"] and entry["name"] in REPAIRS]
    repairs = {entry["name"]: Repair(finding=entry["name"]) for entry in found}
    prices = price_operations(document, repairs, sample_cameras(gaussians, document.edits, VIEWS))
    for entry in found:
        entry["repair"], entry["price"] = REPAIRS[entry["name"]], asdict(prices[entry["name"]])


def repairs_as_text(receipt: dict[str, Any]) -> list[str]:
    """A line for each of those findings; none where `add_repairs` was not called."""
    found = [entry for entry in receipt["health"] if "price" in entry]
    return ["repairs"] * bool(found) + [
        f"  {entry['name']}: {entry['repair']}; {in_words(Price(**entry['price']))}" for entry in found
    ]
