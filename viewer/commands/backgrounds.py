"""What `--background` takes: a colour, a gradient, or a picture all around."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from ...scene.background import WORLD_UP, Background, Colour, Gradient
from ...scene.files.panorama import load_panorama
from .arguments import colour

HELP = (
    "r,g,b (0 to 1 each); gradient:TOP,BOTTOM with colours as #rrggbb or names (or six numbers); or a "
    "picture that is equirectangular (default: 0,0,0)"
)


def background(text: str) -> Colour | Gradient | Path:
    """The option's value; pictures are read later, by `chosen_background`."""
    if text.startswith("gradient:"):
        return _gradient(text.removeprefix("gradient:"))
    if text.startswith("#"):
        return _named(text)
    if re.fullmatch(r"[-+.\d,eE ]*|nan.*|inf.*", text):
        return colour(text)
    return Path(text)


def chosen_background(
    value: Colour | Gradient | Path | None, up: tuple[float, float, float] | None
) -> Background:
    """The background itself, with `up` upwards; black where none was asked for.

    Raises:
        InputError: it is a picture that cannot be read.
    """
    if value is None:
        return 0.0, 0.0, 0.0
    if isinstance(value, Path):
        return load_panorama(value, up=up or WORLD_UP)
    if isinstance(value, Gradient) and up is not None:
        return Gradient(top=value.top, bottom=value.bottom, up=up)
    return value


def _gradient(text: str) -> Gradient:
    parts = text.split(",")
    if len(parts) == 6:
        return Gradient(top=colour(",".join(parts[:3])), bottom=colour(",".join(parts[3:])))
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(
            f"gradient:{text} is not two colours, the upper first: gradient:#88b0e0,#404038"
        )
    return Gradient(top=_named(parts[0]), bottom=_named(parts[1]))


def _named(text: str) -> Colour:
    from PIL import ImageColor

    try:
        r, g, b = (value / 255 for value in ImageColor.getrgb(text.strip())[:3])
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no colour such as #88b0e0 or white") from None
    return r, g, b
