"""Selectors of splats: by region of a picture, by position, by colour, by any attribute."""

from __future__ import annotations

from splatview.edit.selectors.attributes import AttributeRange, SimilarColour
from splatview.edit.selectors.region_growing import Flood
from splatview.edit.selectors.screen import Brush, Lasso, Polygon, Rectangle
from splatview.edit.selectors.volumes import Box, Everything, IndexRuns, InvalidSplats, Sphere

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
