"""The words that screen tools are spoken of by."""

from __future__ import annotations

from typing import Literal

ToolName = Literal["none", "rectangle", "lasso", "polygon", "brush", "flood", "colour", "measure", "ground"]
"""What the left mouse button does on the picture; "none" is navigation."""

Depth = Literal["through", "front"]
"""Whether screen tools take what is behind the surface too."""

Mode = Literal["set", "add", "remove", "intersect"]
"""What a new selection does to the one before."""

Point = tuple[float, float]
"""px from the picture's top left corner."""

Place = tuple[float, float, float]
"""World units."""
