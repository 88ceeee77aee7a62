"""Ways to choose splats: by region of a picture, by place, by colour, by any attribute."""

from __future__ import annotations

from .attributes import ATTRIBUTES, Attribute, attribute_values
from .colour import SimilarColour
from .flood import Flood, picked
from .growing import grow, shrink
from .histogram import Histogram, histogram, usual_span
from .listed import Everything, IllSplats, IndexRuns, health_findings
from .screen import Brush, Lasso, Polygon, Rectangle
from .selector import Selector
from .spacing import typical_spacing
from .values import AttributeRange
from .volumes import Box, Sphere

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
    "health": IllSplats,
    "runs": IndexRuns,
    "all": Everything,
}
"""By the name that a recipe has; each class is a `Selector`."""

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
    "IllSplats",
    "IndexRuns",
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
