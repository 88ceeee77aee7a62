"""Pictures that go all the way round, for backgrounds, and how finely they show what is ahead."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

from splatview.scene.background import WORLD_UP, Panorama
from splatview.scene.errors import InputError
from splatview.scene.formats.io import open_image

LARGEST_SIDE = 8192
"""Px. Wider pictures are made smaller: at a usual field of view, this is more than a screen shows of them."""


PIXELS_PER_BYTE = 400
"""Of a file, at most: deflate makes RGB at best 344 times smaller. More is a damaged header, or a small file
made to fill the memory."""

ALWAYS_HELD = 2**20
"""Pixels that any file may say it has."""


def side_of(width: int) -> int:
    """Pixels each way of a face of the cube around a panorama so wide: as many to an angle in its middle as
    there, along the horizon, so that nothing is lost."""
    return max(round(width / math.pi), 1)


def load_panorama(path: Path, *, up: tuple[float, float, float] = WORLD_UP) -> Panorama:
    """An equirectangular picture in any of `IMAGE_FORMATS`; transparency shows black.

    Raises:
        InputError: the file is missing, is no picture that can be read, or is too short for its size.
    """
    from PIL import Image

    if not os.path.lexists(path):
        raise InputError(f"{path}: no such picture for the background")
    try:
        with open_image(path) as file:
            width, height = file.size
            if width * height > max(ALWAYS_HELD, PIXELS_PER_BYTE * path.stat().st_size):
                raise InputError(
                    f"{path}: says it has {width}x{height} pixels, more than so short a file can hold"
                )
            picture = file.convert("RGBA") if "A" in file.getbands() or "transparency" in file.info else file
            if picture.mode == "RGBA":
                picture = Image.alpha_composite(Image.new("RGBA", picture.size, (0, 0, 0, 255)), picture)
            picture = picture.convert("RGB")
            if max(picture.size) > LARGEST_SIDE:
                picture.thumbnail((LARGEST_SIDE, LARGEST_SIDE), Image.Resampling.BOX)
            pixels = np.array(picture)
    except InputError:
        raise
    except Exception as error:
        # Decoders of damaged files raise nearly anything: OSError, SyntaxError, struct.error, ValueError...
        reason = str(error).partition("\n")[0].removesuffix(repr(str(path))).strip()
        raise InputError(f"{path}: is no picture that can be read ({reason})") from None
    return Panorama(pixels=pixels, up=up, name=str(path))
