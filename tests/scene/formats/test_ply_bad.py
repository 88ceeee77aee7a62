"""Bad files: each is one clear line that names the file; never a traceback, never unbounded memory."""

from __future__ import annotations

import gzip
import os
import re
import sys
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from splatview.scene import Gaussians, InputError
from splatview.scene.formats import load_scene


def refused(tmp_path, data: bytes, name: str = "scene.ply") -> str:
    """The message with which a file of `data` is refused, after checks on its form and on memory."""
    path = tmp_path / name
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            load_scene(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message and message.isprintable()
    assert len(message) < len(str(path)) + 300
    assert peak < 8 * len(data) + (8 << 20)
    return message


@pytest.fixture
def columns(random_gaussians, columns_of) -> dict[str, np.ndarray]:
    return columns_of(random_gaussians(10))


@pytest.fixture
def good(columns, make_ply) -> bytes:
    return make_ply(columns)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"nix\.ply: no such file"):
        load_scene(tmp_path / "nix.ply")


def test_folder(tmp_path):
    with pytest.raises(InputError, match="is a folder"):
        load_scene(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_no_permission(tmp_path, good):
    path = tmp_path / "scene.ply"
    path.write_bytes(good)
    path.chmod(0)
    with pytest.raises(InputError, match="permissions"):
        load_scene(path)


def test_permission_refused_by_the_system(tmp_path, good, monkeypatch):
    path = tmp_path / "scene.ply"
    path.write_bytes(good)

    def refuse(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(InputError, match=r"scene\.ply: may not be read; check its permissions"):
        load_scene(path)


def test_a_folder_on_windows(tmp_path, monkeypatch):
    def refuse(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(InputError, match="is a folder"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    ("data", "name", "message"),
    [
        (b"", "a.ply", "is empty"),
        (b"hello, world", "a.ply", "not a .ply file"),
        (b"hello, world", "a.txt", r"no scene that is known; there are \.ply, "),
        (b"plywood\n", "a.ply", "not a .ply file"),
        (b"\x89PNG\r\n\x1a\n", "a.png", "is a picture"),
        (gzip.compress(b"spz", mtime=0), "a.spz", "no .spz file"),
        (b"NGSP\x04\0\0\0", "a.spz", "no .spz file"),
        (b"PK\x03\x04....", "a.sog", "damaged zip"),
        (bytes(64), "a.ksplat", "not a .ksplat file"),
        (b"ply\nformat ascii 1.0\n", "a.ply", "without end_header"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nend_header", "a.ply", "without end_header"),
        (b"ply\nend_header\n", "a.ply", "line 2.*expected one of {format"),
        (b"ply\nformat ascii 1.0\nend_header\n", "a.ply", "no element vertex"),
        (b"ply\nformat ebcdic 1.0\nend_header\n", "a.ply", "understand format .*ebcdic"),
        (b"ply\nformat ascii 1.0\nnonsense here\nend_header\n", "a.ply", "not understood"),
        (
            b"ply\nformat ascii 1.0\nproperty float x\nend_header\n",
            "a.ply",
            "line 3.*expected one of {element",
        ),
        (
            b"ply\nelement vertex 1\nproperty float x\nend_header\n",
            "a.ply",
            "line 2.*expected one of {format",
        ),
        (b"ply\nformat ascii 1.0\n" + b"x" * 3_000_000, "a.ply", "no end_header in the first 1 MiB"),
        (b"ply\nformat ascii 1.0\n" + b"comment\n" * 300_000, "a.ply", "no end_header in the first 1 MiB"),
    ],
)
def test_not_a_scene(tmp_path, data, name, message):
    assert_matches(message, refused(tmp_path, data, name))


def assert_matches(pattern: str, message: str) -> None:
    assert re.search(pattern, message), message


@pytest.mark.parametrize(
    "count", ["-5", "abc", "1e3", "0x10", "1_000", "९", "1" * 5000], ids=lambda count: count[:8]
)
def test_ill_row_counts(tmp_path, good, count):
    data = good.replace(b"vertex 10", f"vertex {count}".encode())
    assert "number of rows" in refused(tmp_path, data)


HEADERS = {
    "elements": "element e{} 0",
    "properties": "property float p{}",
    "same properties": "property float x",
    "lists": "property list uchar int p{}",
    "comments": "comment {}",
    "blank lines": "",
    "blanks": " " * 20,
}


@pytest.mark.parametrize("line", HEADERS.values(), ids=list(HEADERS))
def test_long_headers_take_calls_in_proportion(tmp_path, columns, make_ply, line):
    """A header of 1 MiB is refused or read, at a bounded number of calls for a byte of it."""

    def calls(lines: int) -> int:
        text = "\n".join(line.format(i) for i in range(lines))
        path = tmp_path / "scene.ply"
        path.write_bytes(make_ply(columns, count=0, after=(text, b"")))
        count = 0

        def tell(frame: object, event: str, argument: object) -> None:
            nonlocal count
            count += 1

        sys.setprofile(tell)
        try:
            load_scene(path)
        except InputError:
            pass
        finally:
            sys.setprofile(None)
        return count

    calls(10)
    few = calls(500)
    assert calls(4000) < 10 * few


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
@pytest.mark.parametrize("count", [10**12, 10**18 - 1, 1001])
def test_header_that_promises_more_than_there_is(tmp_path, columns, make_ply, form, count):
    message = refused(tmp_path, make_ply(columns, form=form, count=count))
    assert f"promises {count:,} rows of vertex" in message


def test_more_than_memory(tmp_path, columns, make_ply):
    """A sparse file is as large as it likes and takes no disk."""
    path = tmp_path / "huge.ply"
    path.write_bytes(make_ply(columns, count=10**10))
    os.truncate(path, 3 * 10**12)
    with pytest.raises(
        InputError, match=r"huge\.ply: 10,000,000,000 rows of vertex need .* GiB of memory, and"
    ):
        load_scene(path)


def test_an_earlier_element_that_promises_more_than_there_is(tmp_path, columns, make_ply):
    for header in (
        f"element tag {10**12}\nproperty double id",
        f"element face {10**12}\nproperty list uchar int i",
    ):
        assert "promises 1,000,000,000,000 rows" in refused(tmp_path, make_ply(columns, before=(header, b"")))


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_truncated_body(tmp_path, columns, make_ply, form):
    good = make_ply(columns, form=form)
    start = good.index(b"end_header\n") + 11
    # In ascii, digits cut off the very last number cannot be missed: a whole number goes.
    for cut in (start, start + 1, (start + len(good)) // 2, len(good) - 30):
        assert_matches("promises|are not", refused(tmp_path, good[:cut]))


def test_a_list_that_claims_more_than_the_file(tmp_path, columns, make_ply):
    header = "element face 1\nproperty list uint double i"
    assert "not what the header promises" in refused(
        tmp_path, make_ply(columns, before=(header, b"\xff\xff\xff\xff"))
    )
    header = "element face 1\nproperty list int double i"
    assert "not what the header promises" in refused(
        tmp_path, make_ply(columns, before=(header, b"\xff\xff\xff\xff"))
    )


@pytest.mark.parametrize("name", ["opacity", "rot_3", "scale_0", "x", "f_dc_1"])
def test_missing_property_is_named(tmp_path, columns, make_ply, name):
    del columns[name]
    assert f"no {name};" in refused(tmp_path, make_ply(columns))


def test_all_missing_properties_are_named(tmp_path, columns, make_ply):
    for i in range(4):
        del columns[f"rot_{i}"]
    assert "no rot_0, rot_1, rot_2, rot_3;" in refused(tmp_path, make_ply(columns))


def test_partial_spherical_harmonics(tmp_path, columns, make_ply):
    del columns["f_rest_44"]
    assert "44 properties f_rest_*" in refused(tmp_path, make_ply(columns))
    columns["f_rest_77"] = columns["x"]
    assert "numbered from f_rest_0" in refused(tmp_path, make_ply(columns))


def test_wrong_types(tmp_path, columns, make_ply):
    good = make_ply(columns)
    assert "x is a list" in refused(tmp_path, good.replace(b"float x", b"list uchar float x"))
    assert "f_dc_0 is int32" in refused(tmp_path, good.replace(b"float f_dc_0", b"int f_dc_0"))
    assert "field type 'quad'" in refused(tmp_path, good.replace(b"float y", b"quad y"))
    assert "type that .ply does not have" in refused(tmp_path, good.replace(b"float y", b"list float int y"))


def test_duplicate_properties_and_elements(tmp_path, good):
    assert "two properties with same name" in refused(tmp_path, good.replace(b"float x", b"float y", 1))
    twice = good.replace(b"end_header", b"element vertex 1\nend_header")
    assert "two elements with same name" in refused(tmp_path, twice)


def test_mesh_and_compressed(tmp_path, make_ply):
    points = {name: np.zeros(3, np.float32) for name in "xyz"}
    mesh = make_ply(
        points, after=("element face 1\nproperty list uchar int vertex_indices", b"\3" + bytes(12))
    )
    assert "is a mesh (1 rows of face)" in refused(tmp_path, mesh)
    packed = {name: np.zeros(3, np.int32) for name in ("packed_position", "packed_rotation")}
    assert "bounds of its chunks are missing" in refused(tmp_path, make_ply(packed))


def test_ascii_rows_that_are_not_numbers(tmp_path, columns, make_ply):
    good = make_ply(columns, form="ascii")
    head, body = good.split(b"end_header\n")
    for bad in (b"abc " + body, b"1 " + body, body.replace(b" ", b", "), b"\xff\xfe" + body):
        assert "not" in refused(tmp_path, head + b"end_header\n" + bad)
    columns["red"] = np.full(10, 7, np.uint8)
    data = make_ply(columns, form="ascii").replace(b" 7\n", b" 300\n")
    assert "'red' is no uint8" in refused(tmp_path, data)


def test_an_endless_line(tmp_path, columns, make_ply):
    head = make_ply(columns, form="ascii").split(b"end_header\n")[0]
    assert "endless" in refused(tmp_path, head + b"end_header\n" + b"1" * (5 << 20))


SEEDS = ("binary_little_endian", "binary_big_endian", "ascii")
TOKENS = st.sampled_from(
    [
        *(
            "vertex",
            "face",
            "x",
            "y",
            "opacity",
            "rot_0",
            "f_rest_0",
            "scale_2",
            "list",
            "comment",
            "end_header",
        ),
        *("-1", "0", "1", "9", "11", "99999999999", "float", "double", "uchar", "int", "end_header"),
        *("property", "element", "format", "ascii", "binary_little_endian", "binary_big_endian"),
    ]
)


@st.composite
def mutations(draw: st.DrawFn) -> list[tuple]:
    """Up to six changes: a byte replaced, a cut, header words replaced or swapped, a piece doubled."""
    kind = st.one_of(
        st.tuples(st.just("byte"), st.floats(0, 1), st.integers(0, 255)),
        st.tuples(st.just("cut"), st.floats(0, 1)),
        st.tuples(st.just("word"), st.integers(0, 80), TOKENS),
        st.tuples(st.just("swap"), st.integers(0, 80), st.integers(0, 80)),
        st.tuples(st.just("double"), st.floats(0, 1), st.integers(1, 200)),
    )
    return draw(st.lists(kind, min_size=1, max_size=6))


def mutate(data: bytes, changes: list[tuple]) -> bytes:
    for kind, *args in changes:
        at = int(args[0] * len(data)) if isinstance(args[0], float) else 0
        if kind == "byte":
            data = data[:at] + bytes([args[1]]) + data[at + 1 :]
        elif kind == "cut":
            data = data[:at]
        elif kind == "double":
            data = data[: at + args[1]] + data[at:]
        else:
            head, mark, body = data.partition(b"end_header")
            words = head.replace(b"\n", b" \n ").split(b" ")
            i = int(args[0]) % len(words)
            if kind == "word":
                words[i] = args[1].encode()
            else:
                j = args[1] % len(words)
                words[i], words[j] = words[j], words[i]
            data = b" ".join(words).replace(b" \n ", b"\n") + mark + body
    return data


@given(form=st.sampled_from(SEEDS), kind=st.sampled_from(["splats", "lists", "points"]), changes=mutations())
@example(form="ascii", kind="splats", changes=[("word", 7, "0")])
@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_files_open_or_are_refused(
    tmp_path, random_gaussians, columns_of, make_ply, form, kind, changes
):
    columns = columns_of(random_gaussians(4, sh_degree=0))
    before = ("", b"")
    if kind == "points":
        columns = {name: columns[name] for name in "xyz"} | {
            name: np.arange(4, dtype=np.uint8) for name in ("red", "green", "blue")
        }
    elif kind == "lists":
        body = b"2 5 6 1.5\n" if form == "ascii" else b"\2" + bytes(12)
        before = ("element face 1\nproperty list uchar int i\nproperty float q", body)
    data = mutate(make_ply(columns, form=form, before=before, comments=("hello",)), changes)
    path = tmp_path / "scene.ply"
    path.write_bytes(data)
    tracemalloc.start()
    try:
        scene = load_scene(path)
        assert isinstance(scene, Gaussians) and len(scene) <= len(data)
    except InputError as error:
        assert str(path) in str(error) and "\n" not in str(error)
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < 8 << 20


@given(data=st.binary(max_size=300))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_behind_the_magic_are_refused_or_open(tmp_path, data):
    path = tmp_path / "scene.ply"
    path.write_bytes(b"ply\nformat ascii 1.0\n" + data)
    try:
        load_scene(path)
    except InputError as error:
        assert "\n" not in str(error)
