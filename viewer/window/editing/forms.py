"""What is filled in on the editing panels, until it is applied."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ....edit.grade import Grade
from ....edit.operations.looks import How
from ....edit.operations.scope import Scope
from ....edit.price import Price
from ....edit.selecting import Histogram

Euler = tuple[float, float, float]
"""Degrees about x, y, z."""


@dataclass(kw_only=True)
class MoveForm:
    """Of the transform section; neutral values change nothing."""

    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World units."""
    rotation: Euler = (0.0, 0.0, 0.0)
    scale: float = 1.0
    gizmo: bool = False
    """Whether handles are shown on the picture."""
    turning: bool = False
    """Whether the handles turn rather than move."""


@dataclass(kw_only=True)
class LookForm:
    """Of the looks section."""

    opacity: float = 1.0
    """Factor, or the value."""
    size: float = 1.0
    """Likewise."""
    grade: Grade = field(default_factory=Grade)


@dataclass(kw_only=True)
class RangeForm:
    """Of selecting by a range of an attribute."""

    attribute: str = "opacity"
    values: np.ndarray | None = None
    """(N,) float32 of the attribute, and..."""
    of: object = None
    """... the attribute and the document's versions that they are of."""
    histogram: Histogram | None = None
    low: float = 0.0
    high: float = 1.0


@dataclass(kw_only=True)
class CleanForm:
    """Of the clean-up section."""

    detector: str = "clusters"
    scores: np.ndarray | None = None
    """(N,) float32, and..."""
    of: object = None
    """... the detector and the document's versions that they are of."""
    threshold: float = 0.0
    mask: np.ndarray | None = None
    """(N,) bool: what would go."""
    count: int = 0
    price: Price | None = None
    """Of deleting `mask`; None: not measured."""
    keep: int = 0
    """Splats that decimation leaves; 0: not filled in yet."""
    kept_price: tuple[object, Price] | None = None
    """What it is of, and the price of decimation."""


@dataclass(kw_only=True)
class HealthForm:
    """Of the health report."""

    prices: dict[str, Price] = field(default_factory=dict)
    """Of the repair of each finding, by its name, and..."""
    of: object = None
    """... the document's versions that they are of."""


@dataclass(kw_only=True)
class Forms:
    """All of them."""

    scope: Scope = "selection"
    move: MoveForm = field(default_factory=MoveForm)
    look: LookForm = field(default_factory=LookForm)
    how: How = "scale"
    """Whether opacities and sizes are multiplied or set."""
    range: RangeForm = field(default_factory=RangeForm)
    clean: CleanForm = field(default_factory=CleanForm)
    health: HealthForm = field(default_factory=HealthForm)
    crop: int = -1
    """Which crop has the handles; -1: none."""
    crop_handles: int = 0
    """What they do, an index of `panels.crops.KINDS`, and..."""
    crop_dragged: bool = False
    """... whether they are being dragged."""
    open_section: str = ""
    """Title of the section that the Edit panel is to open, once."""
    previewing: str = ""
    """The section whose preview is in force; "" for none."""
