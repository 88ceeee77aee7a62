"""Spherical harmonics of LANES splats at once: colours of their rows of coefficients, and gradients by these.

A splat's row is turned into columns by shuffles. Where only colours are asked for, columns are summed up as
they come, and gradients, products of a basis function and a colour's gradient, are multiplied as they are
turned into rows. Neither is written to memory in between: Zen 4 writes a vector of AVX-512 in two cycles.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types

from splatview.raster.compiling import BOUNDSCHECK, inline
from splatview.raster.simd import (
    LANES,
    Vector,
    address_of,
    call_llvm,
    constant,
    converted,
    fill,
    float_type,
    fma,
    intrinsic,
    is_flat,
    prefetch,
    suffix,
)
from splatview.raster.transpose import (
    STARTS,
    check_row_starts,
    column,
    emit_columns_of_rows,
    emit_rows_of_columns,
    load_rows,
    set_column,
)
from splatview.scene.sh import SH_C0, SH_C1, SH_C2, SH_C3

CHANNELS = 3


@inline
def sh_basis(x, y, z, degree, basis):
    """Writes (degree + 1)² basis functions at unit directions, and 0 for all others, to the columns `basis`
    (16·LANES,); see `scene.sh`."""
    set_column(basis, 0, fill(x, SH_C0))
    if degree >= 1:
        set_column(basis, 1, -SH_C1 * y)
        set_column(basis, 2, SH_C1 * z)
        set_column(basis, 3, -SH_C1 * x)
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        set_column(basis, 4, SH_C2[0] * x * y)
        set_column(basis, 5, SH_C2[1] * y * z)
        set_column(basis, 6, SH_C2[2] * (2 * zz - xx - yy))
        set_column(basis, 7, SH_C2[3] * x * z)
        set_column(basis, 8, SH_C2[4] * (xx - yy))
        if degree >= 3:
            set_column(basis, 9, SH_C3[0] * y * (3 * xx - yy))
            set_column(basis, 10, SH_C3[1] * x * y * z)
            set_column(basis, 11, SH_C3[2] * y * (4 * zz - xx - yy))
            set_column(basis, 12, SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy))
            set_column(basis, 13, SH_C3[4] * x * (4 * zz - xx - yy))
            set_column(basis, 14, SH_C3[5] * z * (xx - yy))
            set_column(basis, 15, SH_C3[6] * x * (xx - 3 * yy))
    for k in range((degree + 1) * (degree + 1), 16):  # whatever was there may be no number
        set_column(basis, k, fill(x, 0.0))


@inline
def sh_direction_gradient(x, y, z, degree, along):
    """The gradient by a unit direction of the sum over k of basis k times along[k]; along (16·LANES,),
    columns."""
    dx = dy = dz = fill(x, 0.0)
    if degree >= 1:
        dx = -SH_C1 * column(along, 3)
        dy = -SH_C1 * column(along, 1)
        dz = SH_C1 * column(along, 2)
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        a, b, c = SH_C2[0] * column(along, 4), SH_C2[1] * column(along, 5), 2 * SH_C2[2] * column(along, 6)
        d, e = SH_C2[3] * column(along, 7), 2 * SH_C2[4] * column(along, 8)
        dx = dx + (a * y - c * x + d * z + e * x)
        dy = dy + (a * x + b * z - c * y - e * y)
        dz = dz + (b * y + 2 * c * z + d * x)
        if degree >= 3:
            a, b, c = SH_C3[0] * column(along, 9), SH_C3[1] * column(along, 10), SH_C3[2] * column(along, 11)
            d, e, f = SH_C3[3] * column(along, 12), SH_C3[4] * column(along, 13), SH_C3[5] * column(along, 14)
            g = SH_C3[6] * column(along, 15)
            dx = dx + (6 * a * x * y + b * y * z - 2 * c * x * y - 6 * d * x * z)
            dx = dx + (e * (4 * zz - 3 * xx - yy) + 2 * f * x * z + 3 * g * (xx - yy))
            dy = dy + (3 * a * (xx - yy) + b * x * z + c * (4 * zz - xx - 3 * yy) - 6 * d * y * z)
            dy = dy - (2 * e * x * y + 2 * f * y * z + 6 * g * x * y)
            dz = dz + (b * x * y + 8 * c * y * z + d * (6 * zz - 3 * xx - 3 * yy))
            dz = dz + (8 * e * x * z + f * (xx - yy))
    return dx, dy, dz


SH_BLOCKS = 3
"""Vectors that hold a splat's 16·3 coefficients."""

SH_COLUMNS = SH_BLOCKS * LANES


@inline
def load_sh(flat_sh, starts, count, coefficients):
    """The first `count` numbers of LANES splats' rows of SH, as columns: coefficients (SH_COLUMNS·LANES,) in
    their dtype. Changes starts (LANES,) int64, where the rows begin."""
    block = 0
    while block * LANES < count:
        load_rows(flat_sh, starts, min(count - block * LANES, LANES), coefficients, block * LANES * LANES)
        starts += LANES
        block += 1


@inline
def ask_for_sh(flat_sh, start, count):
    """Asks for the memory of the first `count` numbers of a splat's row of SH, which begins at `start`: that
    of the next group, while this one is worked on. Without, its rows are waited for."""
    for at in range(0, count, LANES):
        prefetch(flat_sh, start + at)


@inline
def sh_sum(coefficients, basis, count):
    """0.5 + SH of a group: three columns in the dtype of `basis`, not yet cut at 0. Not finite where a
    coefficient is not."""
    red = green = blue = fill(column(basis, 0), 0.5)
    for k in range(count):
        weight = column(basis, k)
        red = fma(weight, converted(column(coefficients, 3 * k), basis), red)
        green = fma(weight, converted(column(coefficients, 3 * k + 1), basis), green)
        blue = fma(weight, converted(column(coefficients, 3 * k + 2), basis), blue)
    return red, green, blue


def _emit_cast(builder: Any, value: Any, vector: Vector, to: Vector, llvm_type: Any) -> Any:
    if vector == to:
        return value
    return (builder.fpext if to.element.bitwidth == 64 else builder.fptrunc)(value, llvm_type)


def _weight(context: Any, builder: Any, basis: Any, values: Any, number: int) -> Any:
    """The basis function that belongs to a number of a row."""
    llvm_type = float_type(context, Vector(basis.dtype))
    index = ir.Constant(ir.IntType(64), number // CHANNELS * LANES)
    address = address_of(context, builder, basis, values, index, llvm_type)
    return builder.load(address, align=basis.dtype.bitwidth // 8)


def _summed(block: int) -> Any:
    """An intrinsic that adds what LANES numbers of each row, the block's, contribute to three colours."""

    def add(
        typingctx: Any, array: Any, starts: Any, count: Any, basis: Any, red: Any, green: Any, blue: Any
    ) -> Any:
        if not (is_flat(array) and is_flat(basis) and starts == STARTS and red == Vector(basis.dtype)):
            return None

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            values, starts, count, weights, *sums = args
            llvm_type, name = float_type(context, red), f"llvm.fmuladd.{suffix(red)}"
            rest = builder.sub(count, ir.Constant(count.type, block * LANES))
            columns = emit_columns_of_rows(context, builder, array, values, starts, block * LANES, rest)
            for number, one in enumerate(columns, block * LANES):
                weight = _weight(context, builder, basis, weights, number)
                one = _emit_cast(builder, one, Vector(array.dtype), red, llvm_type)
                channel = number % CHANNELS
                sums[channel] = call_llvm(builder, name, llvm_type, weight, one, sums[channel])
            return context.make_tuple(builder, signature.return_type, sums)

        return types.UniTuple(red, CHANNELS)(array, starts, types.intp, basis, red, green, blue), codegen

    return intrinsic(add)


_FIRST_SUM, _SECOND_SUM, _THIRD_SUM = (_summed(block) for block in range(SH_BLOCKS))


@inline
def sh_sum_of_rows(flat_sh, starts, count, basis):
    """0.5 + SH of LANES splats, not yet cut at 0, of the first `count` numbers of their rows, which begin at
    starts (LANES,) int64: three columns in the dtype of `basis`, whose 16 columns must all be numbers where a
    splat is drawn. Not finite where a coefficient is not."""
    if BOUNDSCHECK:
        check_row_starts(flat_sh, starts, count)
    red = green = blue = fill(column(basis, 0), 0.5)
    red, green, blue = _FIRST_SUM(flat_sh, starts, count, basis, red, green, blue)
    if count > LANES:
        red, green, blue = _SECOND_SUM(flat_sh, starts, count, basis, red, green, blue)
    if count > 2 * LANES:
        red, green, blue = _THIRD_SUM(flat_sh, starts, count, basis, red, green, blue)
    return red, green, blue


def _multiplied(block: int) -> Any:
    """An intrinsic that writes LANES numbers of each row, the block's: products with three columns."""

    def write(
        typingctx: Any,
        array: Any,
        starts: Any,
        numbers: Any,
        used: Any,
        basis: Any,
        red: Any,
        green: Any,
        blue: Any,
        past: Any,
    ) -> Any:
        if not (is_flat(array) and is_flat(basis) and starts == STARTS and red == Vector(basis.dtype)):
            return None
        vector = Vector(array.dtype)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            values, starts, numbers, used, weights, *colours, past = args
            llvm_type, columns = float_type(context, vector), []
            for number in range(block * LANES, (block + 1) * LANES):
                weight = _weight(context, builder, basis, weights, number)
                product = builder.fmul(weight, colours[number % CHANNELS])
                product = _emit_cast(builder, product, red, vector, llvm_type)
                is_used = builder.icmp_signed("<", ir.Constant(used.type, number), used)
                columns.append(builder.select(is_used, product, constant(llvm_type, 0.0)))
            rest = builder.sub(numbers, ir.Constant(numbers.type, block * LANES))
            most = ir.Constant(rest.type, LANES)
            count = builder.select(builder.icmp_signed("<", rest, most), rest, most)
            first = block * LANES
            emit_rows_of_columns(context, builder, array, values, starts, first, columns, count, past)
            return context.get_dummy_value()

        inputs = types.intp, types.intp, basis, red, green, blue, types.boolean
        return types.void(array, starts, *inputs), codegen

    return intrinsic(write)


_FIRST_PRODUCTS, _SECOND_PRODUCTS, _THIRD_PRODUCTS = (_multiplied(block) for block in range(SH_BLOCKS))


@inline
def store_sh_products(flat_sh, starts, numbers, used, basis, red, green, blue, past):
    """Writes LANES rows of `numbers` numbers each, which begin at starts (LANES,) int64: first `used`
    products of columns of `basis` and three more in its dtype, then 0. `past` as `store_rows`."""
    if BOUNDSCHECK:
        check_row_starts(flat_sh, starts, numbers)
    _FIRST_PRODUCTS(flat_sh, starts, numbers, used, basis, red, green, blue, past)
    if numbers > LANES:
        _SECOND_PRODUCTS(flat_sh, starts, numbers, used, basis, red, green, blue, past)
    if numbers > 2 * LANES:
        _THIRD_PRODUCTS(flat_sh, starts, numbers, used, basis, red, green, blue, past)
