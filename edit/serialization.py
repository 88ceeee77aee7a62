"""Dataclasses to JSON and back, strictly: the way back gives an equal object, and no other input is
accepted."""

from __future__ import annotations

import json
import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from splatview.scene import InputError

LONGEST_QUOTE = 60
"""Characters of a wrong value that a message repeats."""

T = TypeVar("T")


def to_json(value: Any) -> Any:
    """The JSON form of a value: a dataclass as an object of its fields, arrays and tuples as lists.

    A `Camera` takes the form of a camera file. Floats come back to the bit: JSON's decimals are Python's
    shortest that do.

    Raises:
        TypeError: a value has no JSON form.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_json(getattr(value, field.name)) for field in fields(value) if field.init}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [to_json(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, (np.bool_, np.integer, np.floating)):
        return value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"{type(value).__name__} has no JSON form")


def from_json(cls: type[T], data: Any) -> T:
    """The `cls`, a dataclass, that `data` describes: every field of its annotated type, no other keys.

    Understood annotations: float, int, bool, str, None, Literal, tuples, dict, numpy arrays (of float64),
    dataclasses, Any, and unions of those. Whatever its constructor objects to by ValueError counts too.

    Raises:
        InputError: with one line that names the field.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"must be an object in braces, not {quoted(data)}")
    hints = _hints(cls)
    own = {field.name: field for field in fields(cls) if field.init}  # pyright: ignore[reportArgumentType]
    for key in data:
        if key not in own:
            known = ", ".join(own) or "nothing"
            raise InputError(f"unknown key {quoted(key)}; known here: {known}")
    values: dict[str, Any] = {}
    for name, field in own.items():
        if name in data:
            values[name] = _value(hints[name], data[name], name)
        elif field.default is MISSING and field.default_factory is MISSING:
            raise InputError(f"{name} is missing")
    try:
        return cls(**values)
    except InputError:
        raise
    except (ValueError, OverflowError) as error:
        raise InputError(" ".join(str(error).split())) from None


def quoted(value: Any) -> str:
    """A value for a message: as JSON, on one line, cut short."""
    text = json.dumps(value, default=str)
    return text if len(text) <= LONGEST_QUOTE else text[: LONGEST_QUOTE - 3] + "..."


@cache
def _hints(cls: type) -> dict[str, Any]:
    return get_type_hints(cls)


def _value(hint: Any, data: Any, name: str) -> Any:
    """`data` as `hint` says. Raises InputError that begins with `name`."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        _check_finite(data, name)
        return data
    if hint is None or hint is type(None):
        if data is None:
            return None
    elif origin is Literal:
        if any(data == choice and type(data) is type(choice) for choice in arguments):
            return data
        choices = ", ".join(str(choice) for choice in arguments)
        raise InputError(f"{name} must be one of {choices}, not {quoted(data)}")
    elif origin in (Union, types.UnionType):
        return _any_of(arguments, data, name)
    elif origin in (tuple, list):
        return _sequence(origin, arguments, data, name)
    elif origin in (dict, Mapping) or hint in (dict, Mapping):
        if isinstance(data, Mapping):
            _check_finite(data, name)
            return dict(data)
    elif hint is np.ndarray:
        return _array(data, name)
    elif is_dataclass(hint):
        try:
            return from_json(hint, data)  # pyright: ignore[reportArgumentType]
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
    elif hint is bool:
        if isinstance(data, bool):
            return data
        raise InputError(f"{name} must be true or false, not {quoted(data)}")
    elif hint is str:
        if isinstance(data, str):
            try:
                data.encode()
            except UnicodeEncodeError:
                raise InputError(f"{name} has characters that are none: {quoted(data)}") from None
            return data
    elif hint is float:
        return _number(data, name)
    elif hint is int:
        value = _number(data, name)
        if isinstance(data, int) or value == int(value):
            return int(data)
        raise InputError(f"{name} must be a whole number, not {quoted(data)}")
    else:
        raise TypeError(f"{name}: annotation {hint} is not understood")
    raise InputError(f"{name} must be {_in_words(hint)}, not {quoted(data)}")


def _number(data: Any, name: str) -> float:
    if isinstance(data, bool) or not isinstance(data, (int, float)):
        raise InputError(f"{name} must be a number, not {quoted(data)}")
    try:
        value = float(data)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise InputError(f"{name} must be a finite number, not {quoted(data)}")
    return value


def _any_of(arguments: tuple[Any, ...], data: Any, name: str) -> Any:
    if data is None and type(None) in arguments:
        return None
    choices = [argument for argument in arguments if argument is not type(None)]
    problems = []
    for choice in choices:
        try:
            return _value(choice, data, name)
        except InputError as error:
            problems.append(error)
    if len(problems) == 1:
        raise problems[0]
    raise InputError(f"{name} must be {' or '.join(map(_in_words, choices))}, not {quoted(data)}")


def _sequence(origin: type, arguments: tuple[Any, ...], data: Any, name: str) -> Any:
    if not isinstance(data, (list, tuple)):
        raise InputError(f"{name} must be a list in brackets, not {quoted(data)}")
    if origin is list or (len(arguments) == 2 and arguments[1] is Ellipsis):
        hints = (arguments[0],) * len(data)
    else:
        hints = arguments
        if len(data) != len(hints):
            raise InputError(f"{name} must be a list of {len(hints)}, not of {len(data)}")
    items = (
        _value(hint, item, f"{name}[{i}]") for i, (hint, item) in enumerate(zip(hints, data, strict=True))
    )
    return origin(items)


def _array(data: Any, name: str) -> np.ndarray:
    try:
        array = np.array(data, np.float64)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{name} must be numbers in brackets, not {quoted(data)}") from None
    if not isinstance(data, (list, tuple)) or not np.isfinite(array).all():
        raise InputError(f"{name} must be finite numbers in brackets, not {quoted(data)}")
    return array


def _check_finite(data: Any, name: str) -> None:
    """Raises InputError for a NaN or an infinity anywhere inside."""
    if isinstance(data, float) and not math.isfinite(data):
        raise InputError(f"{name} must be finite, not {quoted(data)}")
    if isinstance(data, Mapping):
        for key, item in data.items():
            _check_finite(item, f"{name}.{key}")
    elif isinstance(data, (list, tuple)):
        for i, item in enumerate(data):
            _check_finite(item, f"{name}[{i}]")


def _in_words(hint: Any) -> str:
    words = {
        str: "a text",
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        dict: "an object",
    }
    return words.get(hint) or ("a list" if get_origin(hint) in (tuple, list) else str(hint))
