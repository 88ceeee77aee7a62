"""The one exception that means "the user's input is at fault"."""

from __future__ import annotations

import re

LONGEST_MESSAGE = 900
"""Characters, which leaves room for two long paths."""


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one line that says what, where and what to do; the command line prints it
    after ``splatview:`` and exits with code 2, the window shows it in a dialog. Anything else
    that escapes is a defect of ours and keeps its traceback.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


def bytes_in_words(size: float) -> str:
    """``512 KiB``, ``1.5 MiB``, ``24.0 GiB``."""
    kib = max(size, 0) / 1024
    if kib < 1024:
        return f"{kib:.0f} KiB"
    return f"{kib / 1024:.1f} MiB" if kib < 10 << 20 else f"{kib / 2**20:,.1f} GiB"


UNITS = {
    "b": 1,
    "kb": 10**3,
    "mb": 10**6,
    "gb": 10**9,
    "kib": 2**10,
    "mib": 2**20,
    "gib": 2**30,
}


def parse_bytes(text: str) -> int | None:
    """``5 MB``, ``800kB``, ``1.5MiB``; None where `text` is no size of at least a byte."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-zA-Z]+)\s*", text)
    size = float(found[1]) * UNITS.get(found[2].lower(), 0) if found else 0.0
    return int(size) if 1 <= size < 2**60 else None


def printable(text: str, *, keep: str = "") -> str:
    """`text` as terminals and windows can show it: names and values of files may hold anything.

    Line breaks, what a terminal would obey, what turns the direction of writing and what UTF-8 cannot hold
    are written as escapes, but for the characters of `keep`.
    """
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in keep else ascii(one)[1:-1] for one in text)


def one_line(text: str) -> str:
    """`text` as messages quote it: `printable`, and beyond `LONGEST_MESSAGE` without its middle."""
    text = printable(text)
    if len(text) > LONGEST_MESSAGE:
        text = f"{text[: LONGEST_MESSAGE * 2 // 3]} ... {text[-LONGEST_MESSAGE // 4 :]}"
    return text
