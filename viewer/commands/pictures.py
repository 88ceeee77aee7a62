"""Pictures to files: checked before the work, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ...scene import InputError
from ...scene.files.atomic import atomic_write

SUFFIXES = (".png", ".npy")


def check_output(path: Path, suffixes: tuple[str, ...] = SUFFIXES) -> None:
    """Raises InputError where `path` could not be written, so that nobody waits for a picture in vain."""
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{path}: pictures are written as {' or '.join(suffixes)}; give it that suffix")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")
    folder = path.resolve().parent
    if not folder.is_dir():
        raise InputError(f"{path}: the folder {folder} does not exist; make it first")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{path}: the folder {folder} cannot be written to")


def write_picture(image: np.ndarray, path: Path, *, alpha: bool = False) -> None:
    """Writes `image` (H, W, 4) float32 by the suffix: .npy as it is, .png as `eight_bit` makes it.

    Raises:
        InputError: the system refuses.
    """
    with atomic_write(path) as file:
        if path.suffix.lower() == ".npy":
            np.save(file, image)
        else:
            from PIL import Image

            Image.fromarray(eight_bit(image, alpha=alpha)).save(file, format="PNG")


def eight_bit(image: np.ndarray, *, alpha: bool = False) -> np.ndarray:
    """(H, W, 4) float -> uint8: RGB clipped to [0, 1] and rounded to nearest.

    With `alpha` (the picture has a black background) RGBA not premultiplied, as PNG wants it.
    """
    shown = image[..., :3]
    if alpha:
        cover = image[..., 3:]
        shown = np.divide(shown, cover, out=np.zeros_like(shown), where=cover > 0)
        shown = np.concatenate([shown, cover], axis=-1)
    return np.floor(np.clip(shown, 0, 1) * 255 + 0.5).astype(np.uint8)
