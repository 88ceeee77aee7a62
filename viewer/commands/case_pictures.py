"""Pictures of a hard case for the eye: the reference, what a renderer made, and where they differ."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...measure.hard_cases.case import HardCase
from ...measure.hard_cases.running import CaseRenderer, draw_case, error_of
from ...scene import InputError
from .pictures import write_picture

LONG_SIDE = 480
"""px at least: the pictures of cases are a few dozen pixels, each is shown as a square."""


def make_folder(folder: Path) -> None:
    """Raises InputError where there can be no such folder."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from error


def save_case(case: HardCase, renderers: list[CaseRenderer], folder: Path) -> list[Path]:
    """Writes reference, result and difference of every picture of `case`; returns the paths.

    In the difference white is the case's bound, or more.
    """
    written: list[Path] = []

    def write(image: np.ndarray, *words: str) -> None:
        path = folder / f"{'_'.join(file_word(word) for word in words if word)}.png"
        if path not in written:
            write_picture(enlarged_whole(image), path)
            written.append(path)

    for settings in case.settings:
        for index in range(len(case.cameras)):
            view = str(index) if len(case.cameras) > 1 else ""
            for renderer in renderers:
                drawn = draw_case(case, renderer, settings, index)
                write(drawn.truth, case.name, settings, view, "reference")
                words = (case.name, settings, view, renderer.name, renderer.blend)
                write(drawn.image, *words, "result")
                if drawn.image.shape == drawn.truth.shape:
                    error = error_of(drawn.image, drawn.truth, renderer.blend) / drawn.bound
                    shown = np.repeat(np.where(np.isfinite(error), error, 1.0)[..., None], 4, axis=2)
                    write(shown, *words, "difference")
    return written


def file_word(words: str) -> str:
    """As part of a file's name on any system."""
    return re.sub(r"[^\w.+-]+", "-", words).strip("-")


def enlarged_whole(image: np.ndarray) -> np.ndarray:
    """`image` (h, w, 4) float32 with each pixel a square, so that the longer side has LONG_SIDE px or more;
    what is not finite becomes magenta."""
    factor = max(1, -(-LONG_SIDE // max(image.shape[:2])))
    shown = np.where(np.isfinite(image).all(axis=2, keepdims=True), image, (1.0, 0.0, 1.0, 1.0))
    return shown.astype(np.float32).repeat(factor, axis=0).repeat(factor, axis=1)
