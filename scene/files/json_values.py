"""Values out of JSON that anybody may have written, with messages that say where it went wrong."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .excerpt import excerpt

MAX_JSON_BYTES = 1 << 26
"""A camera takes some 500 bytes: this is a hundred thousand. Python's objects take up to 30 times the text:
with a larger limit a damaged file could take all memory."""


def read_json(path: Path, *, what: str) -> Any:
    """The content of `path`. Raises InputError; `what` says what the file should have been."""
    try:
        # A device or a pipe may never end: only files are opened.
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        if path.stat().st_size > MAX_JSON_BYTES:
            raise InputError(f"{path}: is too large for a {what}")
        return json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is no {what}: not JSON ({error})") from None


def _value(entry: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in entry:
        raise InputError(f"{where}: the key {key!r} is missing")
    return entry[key]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def number(entry: Mapping[str, Any], key: str, where: str) -> float:
    """`entry[key]`; may be NaN or infinite, as Python's JSON. Raises InputError, as all here."""
    value = _value(entry, key, where)
    if not _is_number(value):
        raise InputError(f"{where}: {key!r} must be a number, not {excerpt(json.dumps(value))}")
    return float(value)


def integer(entry: Mapping[str, Any], key: str, where: str) -> int:
    """`entry[key]`, a count of pixels."""
    value = number(entry, key, where)
    if not (math.isfinite(value) and value == int(value)):
        raise InputError(f"{where}: {key!r} must be a whole number of pixels, not {value:g}")
    return int(value)


def array(entry: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> np.ndarray:
    """`entry[key]`, `shape` of one or two dimensions, float64."""
    value = _value(entry, key, where)
    rows = value if len(shape) == 2 else [value]
    count = shape[-1]
    if not (
        isinstance(rows, list)
        and len(rows) == (shape[0] if len(shape) == 2 else 1)
        and all(isinstance(row, list) and len(row) == count and all(map(_is_number, row)) for row in rows)
    ):
        size = " x ".join(map(str, shape))
        raise InputError(f"{where}: {key!r} must be {size} numbers in brackets")
    return np.array(value, dtype=np.float64)
