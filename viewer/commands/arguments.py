"""Command-line arguments that several commands share, and a parser whose errors are one line."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from typing import NoReturn

from ...scene import InputError

DEFAULT_SIZE = (1280, 720)

MAX_SIDE = 1 << 16
MAX_PIXELS = 1 << 27
"""2 GiB as float32 RGBA: more is a slip of the finger."""


class Parser(argparse.ArgumentParser):
    """Raises InputError where argparse would print its usage and exit; `--help` works as ever."""

    def __init__(self, command: str, description: str, *, usage: str | None = None):
        super().__init__(
            prog=f"splatview {command}".strip(),
            usage=usage,
            description=description,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see {self.prog} --help)")

    def parse(self, arguments: Sequence[str]) -> argparse.Namespace | None:
        """The options, or None where help was asked for and printed.

        Raises:
            InputError: the arguments are wrong.
        """
        try:
            return self.parse_args(with_joined_values(arguments))
        except SystemExit:
            return None


def with_joined_values(arguments: Sequence[str]) -> list[str]:
    """``--eye -1,2,3`` as ``--eye=-1,2,3``: argparse takes a value that begins with a minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        previous = joined[-1] if joined else ""
        if re.match(r"-\.?\d", argument) and re.fullmatch(r"--[a-z-]+", previous):
            joined[-1] = f"{previous}={argument}"
        else:
            joined.append(argument)
    return joined


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def positive(text: str) -> float:
    value = number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"must be more than 0, got {text}")
    return value


def not_negative(text: str) -> float:
    value = number(text)
    if not value >= 0:
        raise argparse.ArgumentTypeError(f"must be at least 0, got {text}")
    return value


def field_of_view(text: str) -> float:
    value = number(text)
    if not 0 < value < 180:
        raise argparse.ArgumentTypeError(f"must be between 0 and 180 degrees, got {text}")
    return value


def count(text: str) -> int:
    """A whole number of at least 1."""
    if not re.fullmatch(r"\+?\d{1,9}", text) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 1, got {text!r}")
    return int(text)


def index(text: str) -> int:
    """A whole number of at least 0."""
    if not re.fullmatch(r"\d{1,9}", text):
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 0, got {text!r}")
    return int(text)


def vector(text: str) -> tuple[float, float, float]:
    """x,y,z"""
    parts = text.split(",")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not three numbers with commas between: 1,-2,0.5")
    x, y, z = (number(part) for part in parts)
    return x, y, z


def direction(text: str) -> tuple[float, float, float]:
    value = vector(text)
    if not any(value):
        raise argparse.ArgumentTypeError("0,0,0 is no direction")
    return value


def colour(text: str) -> tuple[float, float, float]:
    value = vector(text)
    if not all(0 <= part <= 1 for part in value):
        raise argparse.ArgumentTypeError(f"{text!r}: red, green and blue go from 0 to 1")
    return value


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT in pixels."""
    match = re.fullmatch(r"(\d{1,6})[xX×](\d{1,6})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size in pixels such as 1280x720")
    width, height = int(match[1]), int(match[2])
    if not (width >= 1 and height >= 1):
        raise argparse.ArgumentTypeError(f"{text}: a picture is at least 1x1 pixels")
    if not (max(width, height) <= MAX_SIDE and width * height <= MAX_PIXELS):
        raise argparse.ArgumentTypeError(f"{text} is more than {MAX_PIXELS / 1e6:.0f} megapixels can hold")
    return width, height
