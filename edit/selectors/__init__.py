"""Selectors of splats: by region of a picture, by position, by colour, by any attribute."""

from __future__ import annotations

from splatview.edit.selectors.attributes import (
    ATTRIBUTES,
    Attribute,
    AttributeRange,
    Histogram,
    SimilarColour,
    attribute_values,
    histogram,
    usual_span,
)
from splatview.edit.selectors.base import Selector
from splatview.edit.selectors.region_growing import Flood, grow, picked, shrink, typical_spacing
from splatview.edit.selectors.screen import Brush, Lasso, Polygon, Rectangle
from splatview.edit.selectors.volumes import (
    Box,
    Everything,
    IndexRuns,
    InvalidSplats,
    Sphere,
    health_findings,
)

SELECTORS: dict[str, type] = {
    "rectangle": Rectangle,
    "polygon": Polygon,
    "lasso": Lasso,
    "brush": Brush,
    "sphere": Sphere,
    "box": Box,
    "flood": Flood,
    "colour": SimilarColour,
    "range": AttributeRange,
    "health": InvalidSplats,
    "runs": IndexRuns,
    "all": Everything,
}
"""Selectors by their names in recipes; each class is a `Selector`."""

__all__ = [
    "ATTRIBUTES",
    "SELECTORS",
    "Attribute",
    "AttributeRange",
    "Box",
    "Brush",
    "Everything",
    "Flood",
    "Histogram",
    "IndexRuns",
    "InvalidSplats",
    "Lasso",
    "Polygon",
    "Rectangle",
    "Selector",
    "SimilarColour",
    "Sphere",
    "attribute_values",
    "grow",
    "health_findings",
    "histogram",
    "picked",
    "shrink",
    "typical_spacing",
    "usual_span",
]
