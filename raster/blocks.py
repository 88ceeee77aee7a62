"""What loops over blocks of pixels need besides vectors: sets of blocks as bits, listed without guesses, and
exponentials with constants from memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import models, register_model

from splatview.raster.compiling import BOUNDSCHECK, inline
from splatview.raster.exponentials import EXP2_DEGREE, exp2_coefficients
from splatview.raster.simd import (
    BLOCK_LANES,
    LANES,
    Vector,
    address_of,
    call_llvm,
    check_bounds,
    constant,
    emit_spread,
    float_type,
    fma,
    int_type,
    intrinsic,
    is_flat,
    spread_block,
    store,
)


class Bits(types.Type):
    """numba type of LANES sets of up to 32 numbers from 0 on, each the bits of an int32."""

    def __init__(self) -> None:
        super().__init__(name=f"Bits(x {LANES})")


@register_model(Bits)
class _BitsModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Bits) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(ir.IntType(32), LANES))


bits_type = Bits()


@intrinsic
def no_bits(typingctx: Any) -> Any:
    """Empty sets."""
    empty = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return bits_type(), lambda context, builder, signature, args: empty


@intrinsic
def with_run(typingctx: Any, bits: Any, place: Any, first: Any, last: Any, low: Any, high: Any) -> Any:
    """`bits` with the numbers place + first to place + last, vectors that are rounded towards zero and then
    are 0 to 31 - place, where neither last < first nor high < low."""
    limits = (first, last, low, high)
    if not (bits == bits_type and all(isinstance(one, Vector) and one.lanes == LANES for one in limits)):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits, place, first, last, low, high = args
        begins, ends = (builder.fptosi(one, bits.type) for one in (first, last))
        one, two = constant(bits.type, 1), constant(bits.type, 2)
        run = builder.sub(builder.shl(two, ends), builder.shl(one, begins))
        missed = builder.or_(builder.fcmp_ordered("<", last, first), builder.fcmp_ordered("<", high, low))
        run = builder.select(missed, constant(bits.type, 0), run)
        at = emit_spread(builder, context.cast(builder, place, signature.args[1], types.int32))
        return builder.or_(bits, builder.shl(run, at))

    return bits_type(bits, place, *limits), codegen


@intrinsic
def _store_bits(typingctx: Any, array: Any, index: Any, bits: Any) -> Any:
    if not (is_flat(array) and array.dtype == types.uint32 and bits == bits_type):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values, index, bits = args
        builder.store(bits, address_of(context, builder, array, values, index, bits.type), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, bits), codegen


@inline
def store_bits(array, index, bits):
    """Writes sets to a flat uint32 array from `index` on."""
    if BOUNDSCHECK:
        check_bounds(array, index, LANES)
    _store_bits(array, index, bits)


def _of_bits(name: str, *more: Any) -> Any:
    """An intrinsic of LLVM that counts bits of an uint64, as int64."""

    def count(typingctx: Any, bits: Any) -> Any:
        if bits != types.uint64:
            return None

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return call_llvm(builder, f"llvm.{name}.i64", ir.IntType(64), args[0], *more)

        return types.int64(bits), codegen

    return intrinsic(count)


lowest_bit = _of_bits("cttz", ir.Constant(ir.IntType(1), 0))
"""The least number of a set, 64 of an empty one."""
count_bits = _of_bits("ctpop")
"""How many numbers a set has."""

BYTE = 8
"""Bits."""

MEMBERS = np.zeros((1 << BYTE, BYTE), np.uint8)
"""By the bits of a set of numbers below BYTE its numbers, then any."""
for _bits, _row in enumerate(MEMBERS):
    _members = [number for number in range(BYTE) if _bits >> number & 1]
    _row[: len(_members)] = _members


@intrinsic
def _store_members(typingctx: Any, array: Any, index: Any, table: Any, bits: Any, more: Any) -> Any:
    if not (is_flat(array) and array.dtype == types.int32 and is_flat(table) and table.dtype == types.uint8):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array, index, table, bits, more = args
        bytes_type, ints = (ir.VectorType(ir.IntType(width), BYTE) for width in (8, 32))
        place = builder.mul(bits, ir.Constant(bits.type, BYTE))
        source = address_of(context, builder, signature.args[2], table, place, bytes_type)
        members = builder.zext(builder.load(source, align=1), ints)
        more = emit_spread(builder, builder.trunc(more, ir.IntType(32)), BYTE)
        address = address_of(context, builder, signature.args[0], array, index, ints)
        builder.store(builder.add(members, more), address, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, table, types.uint64, types.int64), codegen


@inline
def store_members(array, index, table, bits, more):
    """Writes the numbers of a set of numbers below BYTE, each plus `more`, to a flat int32 array from `index`
    on, and what fills up to BYTE of them. `table` is MEMBERS, flat."""
    if BOUNDSCHECK:
        check_bounds(array, index, BYTE)
    _store_members(array, index, table, bits, more)


EXP2_CONSTANTS = (EXP2_DEGREE[64] + 2) * BLOCK_LANES
"""Numbers of the constants of `exp2_by`, in an array."""


@intrinsic
def _exp2_constants(typingctx: Any, like: Any) -> Any:
    """Vectors of the constants of `exp2_by`, a tuple in the type of a vector."""
    if not isinstance(like, Vector):
        return None
    bits = like.element.bitwidth
    numbers = [1.5 * 2.0 ** (23 if bits == 32 else 52), *exp2_coefficients(EXP2_DEGREE[bits])[::-1]]
    vectors = types.UniTuple(like, len(numbers))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        llvm_type = float_type(context, like)
        return context.make_tuple(builder, vectors, [constant(llvm_type, number) for number in numbers])

    return vectors(like), codegen


@inline
def place_exp2_constants(constants, at):
    """Writes what `exp2_by` reads to an array, from `at` on: EXP2_CONSTANTS numbers at the most."""
    for vector in _exp2_constants(spread_block(constants.dtype.type(0))):
        store(constants, at, vector)
        at += BLOCK_LANES


@intrinsic
def _scaled(typingctx: Any, x: Any, shifted: Any) -> Any:
    """x·2^k, k being the low bits of a sum with the magic number of `exp2`."""
    if not (isinstance(x, Vector) and x == shifted):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        ints = int_type(x)
        power, exponent = (builder.bitcast(arg, ints) for arg in args)
        exponent = builder.shl(exponent, constant(ints, 23 if x.element.bitwidth == 32 else 52))
        return builder.bitcast(builder.add(power, exponent), args[0].type)

    return x(x, shifted), codegen


@intrinsic
def _exp2_degree(typingctx: Any, like: Any) -> Any:
    """The degree of the polynomial for the type of a vector."""
    if not isinstance(like, Vector):
        return None
    degree = ir.Constant(ir.IntType(64), len(exp2_coefficients(EXP2_DEGREE[like.element.bitwidth])) - 1)
    return types.int64(like), lambda context, builder, signature, args: degree


@intrinsic
def _loaded_constants(typingctx: Any, array: Any, index: Any) -> Any:
    if not (is_flat(array) and isinstance(array.dtype, types.Float)):
        return None
    vector = Vector(array.dtype, BLOCK_LANES)
    count = len(exp2_coefficients(EXP2_DEGREE[array.dtype.bitwidth])) + 1
    vectors = types.UniTuple(vector, count)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        llvm_type = float_type(context, vector)
        loaded = []
        for number in range(count):
            at = builder.add(args[1], ir.Constant(args[1].type, number * BLOCK_LANES))
            address = address_of(context, builder, signature.args[0], args[0], at, llvm_type)
            loaded.append(builder.load(address, align=array.dtype.bitwidth // 8))
        return context.make_tuple(builder, vectors, loaded)

    return vectors(array, types.intp), codegen


@inline
def exp2_constants(constants, at):
    """What `exp2_by` takes, of numbers that `place_exp2_constants` wrote to an array from `at` on: a tuple of
    vectors.

    Taken before a loop they stay in registers, as far as there are enough: the forward pass takes 0.93 of the
    time so (two threads of a core share what loads can be done), the backward pass, whose sums need the
    registers, 1.03: that takes them anew for each block.
    """
    return _loaded_constants(constants, at)


@inline
def exp2_by(constants, x):
    """`exp2` of pixels, with constants as `exp2_constants` gives them.

    Constants of the program's own are loaded anew for each block, by instructions of their own: the loop over
    the blocks of the backward pass has 96 instructions with those from an array, in Horner's scheme, which
    needs one at a time, in place of 130.
    """
    magic = constants[0]
    shifted = x + magic
    fraction = x - (shifted - magic)
    power = constants[1]
    for coefficient in constants[2:]:
        power = fma(power, fraction, coefficient)
    return _scaled(power, shifted)
