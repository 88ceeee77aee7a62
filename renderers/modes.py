"""The visual modes: what each is called, and how its picture is made. The one table of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

VisualMode = Literal["splats", "points", "ellipsoids", "depth", "overdraw", "normals"]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One way to show a scene."""

    name: VisualMode
    label: str
    """Name in menus."""
    key: str
    """Shortcut in the window."""
    tip: str
    """Half a sentence for the list of shortcuts."""
    explanation: str
    """Half a sentence for the tooltip of all modes."""
    flag: str | None = None
    """Shader flag that turns it on."""
    surfaces: bool = False
    """Solid bodies by a depth test, from the ``ellipsoids`` shaders, in place of blended quads."""
    sums: bool = False
    """Accumulates numbers in a float32 target, which the resolve pass maps to colours."""
    depths: bool = False
    """The numbers are depths, world units."""
    normals: bool = False
    """Splats have the colours of their normals from projection on, and are blended as ever."""
    tintable: bool = False
    """Shows the splats' colours, and so highlights."""
    stops_early: bool = False
    """Splats behind an opaque block of the picture cannot show."""
    backends: tuple[str, ...] = ("quads", "cpu")
    """Backends with programs of their own for it."""


MODES: Mapping[VisualMode, Mode] = MappingProxyType(
    {
        mode.name: mode
        for mode in (
            Mode(
                name="splats",
                label="Splats",
                key="1",
                tip="the picture itself",
                explanation="the picture itself",
                tintable=True,
                stops_early=True,
                backends=("quads", "tiles", "cpu", "reference"),
            ),
            Mode(
                name="points",
                label="Points",
                key="2",
                tip="a dot for each splat's centre",
                explanation="centres only, to see structure",
                flag="POINTS",
                tintable=True,
            ),
            Mode(
                name="ellipsoids",
                label="Ellipsoids",
                key="3",
                tip="the splats as solid bodies",
                explanation="solid bodies, to see needles and discs",
                surfaces=True,
                tintable=True,
            ),
            Mode(
                name="depth",
                label="Depth",
                key="4",
                tip="near is bright",
                explanation="near is bright",
                flag="DEPTH",
                sums=True,
                depths=True,
                stops_early=True,
            ),
            Mode(
                name="overdraw",
                label="Overdraw",
                key="5",
                tip="how many splats each pixel costs",
                explanation="how many splats each pixel costs, to see where time goes",
                flag="OVERDRAW",
                sums=True,
            ),
            Mode(
                name="normals",
                label="Normals",
                key="6",
                tip="the way surfaces face: red right, green up, blue towards you",
                explanation="the way surfaces face (each splat's shortest axis): red to the right, green up, "
                "blue towards you",
                flag="NORMALS",
                normals=True,
                stops_early=True,
                backends=("quads", "tiles", "cpu", "reference"),
            ),
        )
    }
)


def mode_flags(name: VisualMode, *, resolved: bool = False) -> dict[str, bool]:
    """Shader flags of all modes, on for `name`; `resolved`: only those that the resolve pass knows."""
    return {
        mode.flag: mode.name == name
        for mode in MODES.values()
        if mode.flag is not None and (mode.sums or not resolved)
    }
