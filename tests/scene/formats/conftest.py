"""A .ply writer of its own, so that the reader is not tested with the writer it ships with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest

from splatview.scene import Gaussians

TYPE_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int", "i1": "char"}


def splat_columns(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """The properties that a trainer writes, by name."""
    rest = gaussians.sh.shape[1] - 1
    columns = {name: gaussians.means[:, i] for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{c}": gaussians.sh[:, 0, c] for c in range(3)}
    columns |= {f"f_rest_{c * rest + k}": gaussians.sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns["opacity"] = gaussians.opacity_logits
    columns |= {f"scale_{i}": gaussians.log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": gaussians.quats[:, i] for i in range(4)}
    return columns


def ply_bytes(
    columns: Mapping[str, np.ndarray],
    *,
    form: str = "binary_little_endian",
    comments: Sequence[str] = (),
    eol: str = "\n",
    before: tuple[str, bytes] = ("", b""),
    after: tuple[str, bytes] = ("", b""),
    count: object = None,
) -> bytes:
    """A .ply of one element vertex; `before` and `after` are header lines and bodies of other elements."""
    n = len(next(iter(columns.values())))
    lines = ["ply", f"format {form} 1.0", *(f"comment {text}" for text in comments)]
    lines += [before[0]] if before[0] else []
    lines += [f"element vertex {n if count is None else count}"]
    lines += [f"property {TYPE_NAMES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    lines += [after[0]] if after[0] else []
    header = eol.join([*lines, "end_header", ""]).encode("latin-1")
    if form == "ascii":
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        body = "".join(" ".join(repr(value) for value in row) + eol for row in rows).encode()
    else:
        order = "<" if form == "binary_little_endian" else ">"
        table = np.empty(n, dtype=[(name, order + values.dtype.str[1:]) for name, values in columns.items()])
        for name, values in columns.items():
            table[name] = values
        body = table.tobytes()
    return header + before[1] + body + after[1]


@pytest.fixture(scope="session")
def columns_of() -> Callable[[Gaussians], dict[str, np.ndarray]]:
    return splat_columns


@pytest.fixture(scope="session")
def make_ply() -> Callable[..., bytes]:
    return ply_bytes


@pytest.fixture(scope="session")
def assert_same() -> Callable[[Gaussians, Gaussians], None]:
    """Fails unless two scenes are equal bit by bit, NaN payloads included."""

    def check(a: Gaussians, b: Gaussians) -> None:
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            left, right = getattr(a, name), getattr(b, name)
            assert left.dtype == right.dtype and left.shape == right.shape, name
            assert left.tobytes() == right.tobytes(), name
        assert set(a.extras) == set(b.extras)
        for name, values in a.extras.items():
            assert values.dtype == b.extras[name].dtype, name
            assert values.tobytes() == b.extras[name].tobytes(), name

    return check
