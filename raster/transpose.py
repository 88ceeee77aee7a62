"""Rows of LANES splats as columns and back: what a splat has in one place becomes a vector for each number,
with a lane for each splat. And pixels, of which four vectors are four numbers in one place.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types

from splatview.raster.compiling import BOUNDSCHECK, inline
from splatview.raster.simd import (
    BLOCK_LANES,
    BLOCK_WIDTH,
    CACHE_LINE,
    LANES,
    Vector,
    address_of,
    call_llvm,
    constant,
    emit_shuffle,
    emit_spread,
    float_type,
    intrinsic,
    is_flat,
    load,
    store,
    suffix,
)

MOST_CACHED = 16 << 20
"""Bytes of records beyond which they are written past the caches: a frame of 500,000 splats then takes 0.96
of the time, one of 100,000, whose records stay in a cache until they are binned and drawn, 1.04."""


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """LANES vectors with rows and columns exchanged: 64 shuffles, halves of ever smaller squares swapped."""
    stride = LANES // 2
    while stride:
        low = [i if not i & stride else LANES + i - stride for i in range(LANES)]
        high = [i + stride if not i & stride else LANES + i for i in range(LANES)]
        masks = [ir.Constant(ir.VectorType(ir.IntType(32), LANES), lanes) for lanes in (low, high)]
        for i in range(LANES):
            if not i & stride:
                pair = rows[i], rows[i + stride]
                rows[i], rows[i + stride] = (builder.shuffle_vector(*pair, mask) for mask in masks)
        stride //= 2
    return rows


def _first_lanes(builder: Any, count: Any) -> Any:
    """The mask of the first `count` lanes."""
    width = ir.VectorType(count.type, LANES)
    return builder.icmp_signed("<", ir.Constant(width, list(range(LANES))), emit_spread(builder, count))


def _rows(
    context: Any, builder: Any, array: Any, value: Any, starts: Any, llvm_type: Any, first: int
) -> list[Any]:
    """Addresses in a flat array of the numbers `first` of LANES rows that begin at starts (LANES,) int64."""
    begins = context.make_array(types.Array(types.int64, 1, "C"))(context, builder, starts).data
    places = [builder.load(builder.gep(begins, [ir.Constant(ir.IntType(64), lane)])) for lane in range(LANES)]
    within = [builder.add(place, ir.Constant(place.type, first)) for place in places] if first else places
    return [address_of(context, builder, array, value, place, llvm_type) for place in within]


STARTS = types.Array(types.int64, 1, "C")


def emit_columns_of_rows(
    context: Any, builder: Any, array: Any, values: Any, starts: Any, first: int, count: Any
) -> list[Any]:
    """Columns: LANES numbers of each of LANES rows of a flat array, from the row's `first` on; 0 from `count`
    of them on."""
    vector = Vector(array.dtype)
    llvm_type = float_type(context, vector)
    mask, align = _first_lanes(builder, count), ir.Constant(ir.IntType(32), array.dtype.bitwidth // 8)
    name, zero = f"llvm.masked.load.{suffix(vector)}.p0", constant(llvm_type, 0.0)
    rows = [
        call_llvm(builder, name, llvm_type, row, align, mask, zero)
        for row in _rows(context, builder, array, values, starts, llvm_type, first)
    ]
    return _transposed(builder, rows)


def emit_rows_of_columns(
    context: Any,
    builder: Any,
    array: Any,
    values: Any,
    starts: Any,
    first: int,
    columns: list[Any],
    count: Any,
    past: Any,
) -> None:
    """What `emit_columns_of_rows` reads, written: the first `count` of LANES columns; past the caches, where
    these are all and `past` says so."""
    llvm_type, align = columns[0].type, array.dtype.bitwidth // 8
    addresses = _rows(context, builder, array, values, starts, llvm_type, first)
    rows = list(zip(addresses, _transposed(builder, columns), strict=True))
    whole = builder.icmp_signed("==", count, ir.Constant(count.type, LANES))
    with builder.if_else(whole) as (then, otherwise):
        with then, builder.if_else(past) as (beyond, within):
            with beyond:
                number = ir.Constant(ir.IntType(32), 1)
                for address, row in rows:
                    stored = builder.store(row, address, align=CACHE_LINE)
                    stored.set_metadata("nontemporal", builder.module.add_metadata([number]))
            with within:
                for address, row in rows:
                    builder.store(row, address, align=align)
        with otherwise:
            mask = _first_lanes(builder, count)
            name = f"llvm.masked.store.{suffix(Vector(array.dtype))}.p0"
            for address, row in rows:
                number = ir.Constant(ir.IntType(32), align)
                call_llvm(builder, name, ir.VoidType(), row, address, number, mask)


@intrinsic
def _load_rows(typingctx: Any, array: Any, starts: Any, count: Any, columns: Any, index: Any) -> Any:
    if not (is_flat(array) and starts == STARTS and columns == array):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values, starts, count, columns, index = args
        loaded = emit_columns_of_rows(context, builder, array, values, starts, 0, count)
        for lane, column in enumerate(loaded):
            place = builder.add(index, ir.Constant(index.type, lane * LANES))
            address = address_of(context, builder, array, columns, place, column.type)
            builder.store(column, address, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, starts, types.intp, columns, types.intp), codegen


@intrinsic
def _store_rows(
    typingctx: Any, array: Any, starts: Any, count: Any, columns: Any, index: Any, past: Any
) -> Any:
    if not (is_flat(array) and starts == STARTS and columns == array):
        return None
    vector = Vector(array.dtype)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values, starts, count, columns, index, past = args
        llvm_type = float_type(context, vector)
        loaded = []
        for lane in range(LANES):
            place = builder.add(index, ir.Constant(index.type, lane * LANES))
            address = address_of(context, builder, array, columns, place, llvm_type)
            loaded.append(builder.load(address, align=array.dtype.bitwidth // 8))
        emit_rows_of_columns(context, builder, array, values, starts, 0, loaded, count, past)
        return context.get_dummy_value()

    return types.void(array, starts, types.intp, columns, types.intp, types.boolean), codegen


@intrinsic
def _store_interleaved(
    typingctx: Any, array: Any, index: Any, second: Any, red: Any, green: Any, blue: Any, alpha: Any
) -> Any:
    colours = (red, green, blue, alpha)
    if not (
        is_flat(array) and all(isinstance(one, Vector) and one.element == array.dtype for one in colours)
    ):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array, index, second, *colours = args
        quad = LANES // 4  # pixels that are a vector of the picture
        red, green, blue, alpha = colours
        for row, first in enumerate((index, second)):
            pairs = [
                lane
                for place in range(row * BLOCK_WIDTH, (row + 1) * BLOCK_WIDTH)
                for lane in (place, BLOCK_LANES + place)
            ]
            rg, ba = emit_shuffle(builder, red, green, pairs), emit_shuffle(builder, blue, alpha, pairs)
            for part in range(0, BLOCK_WIDTH, quad):
                places = range(2 * part, 2 * (part + quad), 2)
                quads = [lane for one in places for at in (one, len(pairs) + one) for lane in (at, at + 1)]
                at = builder.add(first, ir.Constant(first.type, 4 * part))
                pixels = emit_shuffle(builder, rg, ba, quads)
                address = address_of(context, builder, signature.args[0], array, at, pixels.type)
                builder.store(pixels, address, align=signature.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, *colours), codegen


@intrinsic
def begins_at_line(typingctx: Any, array: Any) -> Any:
    """Whether an array begins at a cache line."""
    if not isinstance(array, types.Array):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        address = builder.ptrtoint(data, ir.IntType(64))
        rest = builder.and_(address, ir.Constant(address.type, CACHE_LINE - 1))
        return builder.icmp_unsigned("==", rest, ir.Constant(address.type, 0))

    return types.boolean(array), codegen


@intrinsic
def finish_stores(typingctx: Any) -> Any:
    """Waits for what was stored past the caches: only then may another thread be told that it is there."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), codegen


@inline
def load_rows(array, starts, count, columns, index):
    """The first `count` <= LANES numbers of LANES rows of a flat array, rows that begin at starts (LANES,)
    int64, to columns: LANES vectors of `columns`, an array of the same dtype, from `index` on. The vectors
    from `count` on become 0."""
    if BOUNDSCHECK:
        _check_rows(array, starts, count, columns, index)
    _load_rows(array, starts, count, columns, index)


@inline
def store_rows(array, starts, count, columns, index, past):
    """What `load_rows` reads, written. Rows that begin at one place must be equal. `past`: past the caches,
    where `passes_caches` allows it.

    Whole vectors are stored without a mask: Zen takes some 40 operations for a masked store.
    """
    if BOUNDSCHECK:
        _check_rows(array, starts, count, columns, index)
    _store_rows(array, starts, count, columns, index, past)


@inline
def passes_caches(array, numbers):
    """Whether rows of so many numbers of a flat array can be written past the caches: whole vectors that
    begin at cache lines. No line is read then before it is overwritten. See `finish_stores`."""
    return numbers % LANES == 0 and begins_at_line(array)


@inline
def check_row_starts(array, starts, count):
    """Raises IndexError where one of LANES rows of `count` numbers, from `starts` on, is not in an array."""
    for lane in range(LANES):
        if starts[lane] < 0 or starts[lane] + count > array.size:
            raise IndexError("a row reaches beyond its array")


@inline
def _check_rows(array, starts, count, columns, index):
    check_row_starts(array, starts, count)
    if count > LANES:
        raise IndexError("a row has more numbers than there are columns")
    if index < 0 or index + LANES * LANES > columns.size:
        raise IndexError("a vector reaches beyond its array")


@inline
def store_interleaved(array, index, second, red, green, blue, alpha):
    """Writes the pixels of a block to a flat picture of four numbers a pixel: its first row from `index` on,
    its second from `second` on."""
    if BOUNDSCHECK and (min(index, second) < 0 or max(index, second) + 4 * BLOCK_WIDTH > array.size):
        raise IndexError("a block reaches beyond its picture")
    _store_interleaved(array, index, second, red, green, blue, alpha)


@inline
def column(lanes, index):
    """The vector of a column, by its number, of an array of columns of LANES numbers each."""
    return load(lanes, index * LANES)


@inline
def set_column(lanes, index, value):
    store(lanes, index * LANES, value)
