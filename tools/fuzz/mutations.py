"""Damage to files, drawn by a seed: of their bytes, of their words and numbers, and of what JSON holds."""

from __future__ import annotations

import copy
import json
import random
import struct
from collections.abc import Callable, Sequence
from typing import Any

INTEGERS = (
    *(0, 1, 2, 3, 4, 7, 8, 15, 16, 17, 31, 32, 63, 64, 65, 127, 128, 129, 255, 256, 257, 1000, 4096),
    *(2**15 - 1, 2**15, 2**16 - 1, 2**16, 2**24 + 1, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53 + 1),
    *(2**62, 2**63 - 1, 2**63, 2**64 - 1, 10**18, 10**19, 10**30),
)

FLOAT_BITS = (
    *(0x00000000, 0x80000000, 0x3F800000, 0xBF800000),  # 0, -0, 1, -1
    *(0x00000001, 0x807FFFFF, 0x00800000),  # subnormals, the smallest normal number
    *(0x7F7FFFFF, 0xFF7FFFFF, 0x7F800000, 0xFF800000),  # the largest, infinities
    *(0x7FC00000, 0xFFC00001, 0x7F800001, 0x7FFFFFFF),  # NaN: quiet, with payloads, signalling
)

WORDS = (
    *(b"0", b"-0", b"1", b"-1", b"255", b"256", b"1e308", b"-1e308", b"1e309", b"1e-320", b"1e400"),
    *(b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"-Infinity", b"9" * 19, b"9" * 40, b"1_000", b"0x10"),
    *(b"true", b"null", b'""', b"[]", b"{}", b"1.5", b"+1", b".5", b"5.", b"e", b"--1", b"1e", b"\xd9\xa1"),
)
"""The last is a digit, though not one of ASCII."""

HEADER_END = b"end_header\n"

VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 7, 1.5, -0.0, 1e-320, 1e308, -1e308, 2**31, 2**53 + 1, 2**64, 10**400),
    *(float("nan"), float("inf"), float("-inf"), "", "x", "a/../../b", "\0", "\ud800", "é\u202e", "\n", "1"),
    *([], {}, [[]], [None], [1], [1, 2, 3], [0, 0, 0], [1, 0, 0, 0], {"x": 1}, "A" * 5000, [0.5] * 17),
)


def mutated(rng: random.Random, seeds: Sequence[bytes], words: Sequence[bytes]) -> bytes:
    """One of `seeds`, damaged in one to six ways; `words` are those of the format."""
    data = rng.choice(seeds)
    if rng.random() < 0.02:
        return data
    if data[:1] in (b"{", b"[") and rng.random() < 0.6:
        data = damaged_json(rng, data)
        if rng.random() < 0.8:
            return data
    # Half of the time what a header promises stays, so that the damage gets past it.
    head = data.find(HEADER_END) + len(HEADER_END) if HEADER_END in data and rng.random() < 0.5 else 0
    buffer = bytearray(data[head:])
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 6))):
        rng.choice(_DAMAGES)(rng, buffer, seeds, words)
    return data[:head] + bytes(buffer)


def _at(rng: random.Random, buffer: bytearray) -> int:
    """A place; one in three in the first bytes, where headers and counts are."""
    length = len(buffer)
    return rng.randrange(min(length, 64) if rng.random() < 0.33 else length) if length else 0


def _flip(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    if buffer:
        buffer[_at(rng, buffer)] ^= 1 << rng.randrange(8)


def _byte(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    if buffer:
        buffer[_at(rng, buffer)] = rng.choice((0, 1, 10, 13, 32, 34, 45, 127, 128, 255, rng.randrange(256)))


def _integer(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    size, at = rng.choice((1, 2, 4, 8)), _at(rng, buffer)
    value = rng.choice(INTEGERS) * rng.choice((1, 1, 1, -1)) % (1 << 8 * size)
    buffer[at : at + size] = value.to_bytes(size, rng.choice(("little", "big")))


def _float(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    at, bits = _at(rng, buffer), rng.choice(FLOAT_BITS)
    if rng.random() < 0.5:
        buffer[at : at + 4] = struct.pack(rng.choice("<>") + "I", bits)
    else:
        buffer[at : at + 8] = struct.pack(rng.choice("<>") + "Q", bits << 32 | rng.choice((0, 1, 2**32 - 1)))


def _cut(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    at = _at(rng, buffer)
    del buffer[at : at + rng.choice((1, 2, 4, 8, rng.randrange(1, 64)))]


def _truncate(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    del buffer[_at(rng, buffer) :]


def _repeat(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    at = _at(rng, buffer)
    part = bytes(buffer[at : at + rng.randrange(1, 64)])
    buffer[at:at] = part * rng.choice((1, 1, 2, 100))


def _insert(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    at = _at(rng, buffer)
    buffer[at:at] = rng.randbytes(rng.choice((1, 2, 8, 40)))


def _splice(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    other, at = rng.choice(seeds), _at(rng, buffer)
    if other:
        start = rng.randrange(len(other))
        buffer[at:] = other[start:]


def _word(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    """A word of the text around some place becomes another one."""
    at = _at(rng, buffer)
    start, stop = at, at
    breaks = b' \n\t,:[]{}"'
    while start > 0 and at - start < 40 and buffer[start - 1] not in breaks:
        start -= 1
    while stop < len(buffer) and stop - at < 40 and buffer[stop] not in breaks:
        stop += 1
    buffer[start:stop] = rng.choice(WORDS if rng.random() < 0.6 or not words else words)


def _lines(rng: random.Random, buffer: bytearray, seeds, words) -> None:
    """Lines that change places, come twice, or are lost."""
    lines = bytes(buffer).split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(3)
    if kind == 0:
        lines[a], lines[b] = lines[b], lines[a]
    elif kind == 1:
        lines.insert(a, lines[b])
    else:
        del lines[a]
    buffer[:] = b"\n".join(lines)


_DAMAGES = (_flip, _byte, _integer, _float, _cut, _truncate, _repeat, _insert, _splice, _word, _word, _lines)


def damaged_json(rng: random.Random, data: bytes) -> bytes:
    """Some values of a JSON text, at any depth, replaced, lost, doubled or exchanged."""
    try:
        root = [json.loads(data)]
    except (ValueError, RecursionError):
        return data
    for _ in range(rng.choice((1, 1, 2, 4))):
        places: list[tuple[Any, Any]] = []
        stack: list[Any] = [root]
        while stack:
            node = stack.pop()
            keys = node if isinstance(node, dict) else range(len(node))
            for key in keys:
                places.append((node, key))
                if isinstance(node[key], (dict, list)):
                    stack.append(node[key])
        node, key = rng.choice(places[1:] or places)
        kind = rng.randrange(8)
        if kind <= 3:
            node[key] = copy.deepcopy(rng.choice(VALUES))
        elif kind == 4:
            other, other_key = rng.choice(places)
            node[key] = other[other_key] if other is not root else None
            if _is_in(node, node[key]):
                node[key] = 0
        elif kind == 5 and node is not root:
            del node[key]
        elif kind == 6 and isinstance(node, dict):
            node[rng.choice(("", "x", "op", "\ud800", str(key) + " "))] = node.pop(key)
        elif isinstance(node, list) and node is not root:
            node.insert(key, node[key])
        if not root:
            root = [None]
    text = json.dumps(root[0])
    if rng.random() < 0.02:
        text = "[" * rng.choice((10, 900, 2000, 200_000)) + text
    return text.encode("utf-8", "surrogatepass")


def _is_in(node: Any, value: Any) -> bool:
    """Whether `node` is a part of `value`, which must not become a part of it then."""
    stack = [value]
    while stack:
        one = stack.pop()
        if one is node:
            return True
        if isinstance(one, (dict, list)):
            stack += one.values() if isinstance(one, dict) else one
    return False


def mutated_checkpoint(
    rng: random.Random, seeds: Sequence[bytes], damaged: Callable[[bytes], bytes]
) -> bytes:
    """A checkpoint with damage in the JSON within its header's JSON, which bytes alone rarely reach."""
    data = rng.choice(seeds)
    (length,) = struct.unpack_from("<Q", data)
    try:
        header = json.loads(data[8 : 8 + length])
        header["__metadata__"]["run"] = damaged(header["__metadata__"]["run"].encode()).decode(
            "utf-8", "replace"
        )
        text = json.dumps(header).encode()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return data
    return struct.pack("<Q", len(text)) + text + data[8 + length :]
