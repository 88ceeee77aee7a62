"""Vectors inside numba kernels: what the inner loops are written in.

Whether LLVM vectorises a scalar loop hangs on alias checks and cost models; code written on vectors
is vector code on every machine. There are two sorts of them:

- LANES splats, or numbers of anything: in float32 one AVX-512 register, two of AVX, four of SSE or NEON;
- a block of pixels: 8x2 with AVX-512, and 4x2 else, one register of AVX. Most splats are a few pixels large
  and waste fewer lanes of small blocks, whose sums stay in registers, too: of 100,000 splats at 256x256, each
  touches 3.4 blocks of 4x2 in place of 2.5 of 8x2 in a tile. Blocks of 4x4 in two registers of AVX each took
  1.01 to 1.09 of the time forward, and up to 1.15 backward. With AVX-512 (Zen 4) blocks of 4x2 took 0.99 to
  1.06 of the time of those of 8x2.

A `Vector` exists only inside kernels; its element type, float32 or float64, is that of the array or
scalar that it came from. + - * / and min, max, abs, math.sqrt take vectors, or a vector and a number, so
that one source can serve for vectors and for scalars. Nothing here allows LLVM to assume that numbers are
finite. Comparisons are false for NaN.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic as _numba_intrinsic
from numba.extending import models, overload, register_model

from splatview.raster.compiling import BOUNDSCHECK, config, inline

LANES = 16


def _has_wide_registers() -> bool:
    """Whether kernels are compiled for AVX-512."""
    if config.CPU_NAME is not None or config.CPU_FEATURES is not None:
        return "+avx512f" in (config.CPU_FEATURES or "").split(",")
    return llvmlite.binding.get_host_cpu_features().get("avx512f", False)


BLOCK_WIDTH, BLOCK_HEIGHT = 8 if _has_wide_registers() else 4, 2
"""Pixels that a block covers: lane = row·BLOCK_WIDTH + column."""

BLOCK_LANES = BLOCK_WIDTH * BLOCK_HEIGHT

PART_LANES = 8 if _has_wide_registers() else 4
"""Numbers of float64 in a register: long formulas keep what they need in registers so."""

CACHE_LINE = 64
"""Bytes."""

# The decorated function is called without its first parameter, which type checkers cannot know.
intrinsic: Any = _numba_intrinsic


class Vector(types.Type):
    """numba type of LANES or BLOCK_LANES floats."""

    def __init__(self, element: types.Float, lanes: int = LANES) -> None:
        self.element, self.lanes = element, lanes
        super().__init__(name=f"Vector({element} x {lanes})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        element = ir.FloatType() if fe_type.element.bitwidth == 32 else ir.DoubleType()
        super().__init__(dmm, fe_type, ir.VectorType(element, fe_type.lanes))


def int_type(vector: Vector) -> ir.VectorType:
    return ir.VectorType(ir.IntType(vector.element.bitwidth), vector.lanes)


def float_type(context: Any, vector: Vector) -> ir.VectorType:
    return context.get_value_type(vector)


def constant(llvm_type: Any, value: float) -> ir.Constant:
    count = llvm_type.count if isinstance(llvm_type, ir.VectorType) else 0
    return ir.Constant(llvm_type, [value] * count if count else value)


def emit_spread(builder: Any, scalar: Any, lanes: int = LANES) -> Any:
    """A scalar in every lane."""
    vector_type = ir.VectorType(scalar.type, lanes)
    one = builder.insert_element(
        ir.Constant(vector_type, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(one, ir.Constant(vector_type, ir.Undefined), zeros)


def call_llvm(builder: Any, name: str, result: Any, *args: Any) -> Any:
    """Calls an LLVM intrinsic by its full name."""
    function_type = ir.FunctionType(result, [arg.type for arg in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, function_type, name), args)


def suffix(vector: Vector) -> str:
    return f"v{vector.lanes}f{vector.element.bitwidth}"


def _vector_op(arity: int, emit: Callable[..., Any]) -> Any:
    """An intrinsic of `arity` vectors of one type that returns such a vector."""

    def typed(*args: Any) -> Any:
        if not all(isinstance(arg, Vector) and arg == args[0] for arg in args):
            return None

        def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return emit(builder, args[0], *values)

        return args[0](*args), codegen

    # numba takes the names and number of the arguments from the function's signature.
    def one(typingctx: Any, x: Any) -> Any:
        return typed(x)

    def two(typingctx: Any, x: Any, y: Any) -> Any:
        return typed(x, y)

    def three(typingctx: Any, x: Any, y: Any, z: Any) -> Any:
        return typed(x, y, z)

    def four(typingctx: Any, x: Any, y: Any, z: Any, other: Any) -> Any:
        return typed(x, y, z, other)

    return intrinsic({1: one, 2: two, 3: three, 4: four}[arity])


fma = _vector_op(3, lambda b, v, x, y, z: call_llvm(b, f"llvm.fmuladd.{suffix(v)}", x.type, x, y, z))
"""x·y + z, in one rounding where the machine can."""
negate = _vector_op(1, lambda b, v, x: b.fneg(x))
divide = _vector_op(2, lambda b, v, x, y: b.fdiv(x, y))
absolute = _vector_op(1, lambda b, v, x: call_llvm(b, f"llvm.fabs.{suffix(v)}", x.type, x))
sqrt = _vector_op(1, lambda b, v, x: call_llvm(b, f"llvm.sqrt.{suffix(v)}", x.type, x))
floor = _vector_op(1, lambda b, v, x: call_llvm(b, f"llvm.floor.{suffix(v)}", x.type, x))
ceil = _vector_op(1, lambda b, v, x: call_llvm(b, f"llvm.ceil.{suffix(v)}", x.type, x))
minimum = _vector_op(2, lambda b, v, x, y: b.select(b.fcmp_ordered("<", x, y), x, y))
"""x < y ? x : y, so y where either is NaN."""
maximum = _vector_op(2, lambda b, v, x, y: b.select(b.fcmp_ordered(">", x, y), x, y))
"""x > y ? x : y, so y where either is NaN."""
keep_if_at_least = _vector_op(
    3, lambda b, v, x, y, z: b.select(b.fcmp_ordered(">=", y, z), x, constant(x.type, 0.0))
)
"""x where y >= z, else 0."""
keep_if_below = _vector_op(
    3, lambda b, v, x, y, z: b.select(b.fcmp_ordered("<", y, z), x, constant(x.type, 0.0))
)
"""x where y < z, else 0."""
choose_above = _vector_op(4, lambda b, v, y, z, x, other: b.select(b.fcmp_ordered(">", y, z), x, other))
"""x where y > z, else the last."""


def _emit_reciprocal(b: Any, v: Vector, x: Any) -> Any:
    return b.fdiv(constant(x.type, 1.0), x, flags=("arcp",))


reciprocal = _vector_op(1, _emit_reciprocal)
"""1 / x."""


def _spread_to(lanes: int) -> Any:
    def spread(typingctx: Any, scalar: Any) -> Any:
        if not isinstance(scalar, types.Float):
            return None

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return emit_spread(builder, args[0], lanes)

        return Vector(scalar, lanes)(scalar), codegen

    return intrinsic(spread)


spread, spread_block = _spread_to(LANES), _spread_to(BLOCK_LANES)
"""A float scalar in every lane."""


@intrinsic
def fill(typingctx: Any, like: Any, value: Any) -> Any:
    """The number `value`, of any float or integer type, in every lane of a vector of the type of `like`."""
    if not isinstance(like, Vector):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        number = context.cast(builder, args[1], signature.args[1], like.element)
        return emit_spread(builder, number, like.lanes)

    return like(like, value), codegen


def _bind(symbol: Any, function: Any) -> None:
    """Makes an operator or builtin of two vectors of one type, or of one and a number, call `function`."""

    @overload(symbol)
    def bound(x, y):
        if isinstance(x, Vector) and x == y:
            return lambda x, y: function(x, y)  # noqa: PLW0108 numba wants the names
        if isinstance(x, Vector) and isinstance(y, types.Number):
            return lambda x, y: function(x, fill(x, y))
        if isinstance(x, types.Number) and isinstance(y, Vector):
            return lambda x, y: function(fill(y, x), y)
        return None


def _bind_one(symbol: Any, function: Any) -> None:
    """The same for what takes one vector."""

    @overload(symbol)
    def bound(x):
        return (lambda x: function(x)) if isinstance(x, Vector) else None  # noqa: PLW0108


_bind(operator.add, _vector_op(2, lambda b, v, x, y: b.fadd(x, y)))
_bind(operator.sub, _vector_op(2, lambda b, v, x, y: b.fsub(x, y)))
_bind(operator.mul, _vector_op(2, lambda b, v, x, y: b.fmul(x, y)))
_bind(operator.truediv, divide)
_bind(min, minimum)
_bind(max, maximum)
_bind_one(operator.neg, negate)
_bind_one(abs, absolute)
_bind_one(math.sqrt, sqrt)


def _lane_constant(values: list[float]) -> Any:
    """An intrinsic that gives a constant vector of the type of its argument."""

    def constant(typingctx: Any, like: Any) -> Any:
        if not (isinstance(like, Vector) and like.lanes == len(values)):
            return None

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return ir.Constant(float_type(context, like), values)

        return like(like), codegen

    return intrinsic(constant)


column_centres = _lane_constant([lane % BLOCK_WIDTH + 0.5 for lane in range(BLOCK_LANES)])
"""x of the pixel centres of a block, from its left edge, in the type of the argument."""
row_centres = _lane_constant([lane // BLOCK_WIDTH + 0.5 for lane in range(BLOCK_LANES)])
"""y of the pixel centres of a block, from its top edge, in the type of the argument."""
lane_numbers = _lane_constant([float(lane) for lane in range(LANES)])
"""0, 1, ... in the type of the argument, of LANES."""


def address_of(context: Any, builder: Any, array_type: Any, array: Any, index: Any, llvm_type: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), llvm_type.as_pointer())


def is_flat(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


def _load_of(lanes: int) -> Any:
    def load(typingctx: Any, array: Any, index: Any) -> Any:
        if not (is_flat(array) and isinstance(array.dtype, types.Float)):
            return None
        vector = Vector(array.dtype, lanes)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            llvm_type = float_type(context, vector)
            address = address_of(context, builder, array, args[0], args[1], llvm_type)
            return builder.load(address, align=array.dtype.bitwidth // 8)

        return vector(array, types.intp), codegen

    return intrinsic(load)


_load, _load_block, _load_part = _load_of(LANES), _load_of(BLOCK_LANES), _load_of(PART_LANES)


@intrinsic
def _lanes_of(typingctx: Any, vector: Any) -> Any:
    """The number of a vector's lanes."""
    if not isinstance(vector, Vector):
        return None
    return types.intp(vector), lambda context, builder, signature, args: ir.Constant(
        context.get_value_type(types.intp), vector.lanes
    )


@intrinsic
def _store(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    if not (is_flat(array) and isinstance(value, Vector) and value.element == array.dtype):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = address_of(context, builder, array, args[0], args[1], args[2].type)
        builder.store(args[2], address, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def _store_int(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    if not (is_flat(array) and isinstance(array.dtype, types.Integer) and isinstance(value, Vector)):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        width = array.dtype.bitwidth
        ints, stored = (ir.VectorType(ir.IntType(bits), LANES) for bits in (32, width))
        address = address_of(context, builder, array, args[0], args[1], stored)
        numbers = builder.fptosi(args[2], ints)
        builder.store(builder.trunc(numbers, stored) if width < 32 else numbers, address, align=width // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


def _emit_ints(step: int) -> Any:
    """What stores LANES int32 numbers that begin with `first`, each `step` more than the one before."""

    def emit(typingctx: Any, array: Any, index: Any, first: Any) -> Any:
        if not (is_flat(array) and array.dtype == types.int32 and isinstance(first, types.Integer)):
            return None

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            ints = ir.VectorType(ir.IntType(32), LANES)
            address = address_of(context, builder, array, args[0], args[1], ints)
            first = emit_spread(builder, context.cast(builder, args[2], signature.args[2], types.int32))
            steps = ir.Constant(ints, [step * lane for lane in range(LANES)])
            builder.store(builder.add(first, steps), address, align=4)
            return context.get_dummy_value()

        return types.void(array, types.intp, first), codegen

    return intrinsic(emit)


_store_run, _store_same = _emit_ints(1), _emit_ints(0)


@inline
def load(array, index):
    """LANES floats of a flat, C-contiguous array from `index` on. 0 <= index <= size - LANES."""
    if BOUNDSCHECK:
        check_bounds(array, index, LANES)
    return _load(array, index)


@inline
def load_block(array, index):
    """The same of BLOCK_LANES floats."""
    if BOUNDSCHECK:
        check_bounds(array, index, BLOCK_LANES)
    return _load_block(array, index)


@inline
def load_part(array, index):
    """The same of PART_LANES floats."""
    if BOUNDSCHECK:
        check_bounds(array, index, PART_LANES)
    return _load_part(array, index)


@inline
def store(array, index, value):
    """Writes a vector to a flat array of its element type from `index` on."""
    if BOUNDSCHECK:
        check_bounds(array, index, _lanes_of(value))
    _store(array, index, value)


@inline
def store_int(array, index, value):
    """Writes a vector, rounded towards zero, to a flat array of integers of up to 32 bits. The values must
    fit."""
    if BOUNDSCHECK:
        check_bounds(array, index, LANES)
    _store_int(array, index, value)


@inline
def store_run(array, index, first):
    """Writes the LANES numbers from `first` on to a flat int32 array from `index` on."""
    if BOUNDSCHECK:
        check_bounds(array, index, LANES)
    _store_run(array, index, first)


@inline
def store_same(array, index, value):
    """Writes a number LANES times to a flat int32 array from `index` on."""
    if BOUNDSCHECK:
        check_bounds(array, index, LANES)
    _store_same(array, index, value)


@inline
def lane_sum(vector, room):
    """The sum of the lanes; `room` (LANES or more,) in their dtype is overwritten."""
    store(room, 0, vector)
    total = room[0]
    for lane in range(1, LANES):
        total += room[lane]
    return total


@inline
def check_bounds(array, index, lanes):
    """Bounds checking as numba's own, which vectors escape as they are loaded by address."""
    if index < 0 or index + lanes > array.size:
        raise IndexError("a vector reaches beyond its array")


@numba.njit(nogil=True)
def aligned(count, dtype):
    """`count` numbers of any contents that begin at a cache line; numba aligns to half of one."""
    whole = np.empty(count + LANES, dtype)
    skip = (-whole.ctypes.data % CACHE_LINE) // whole.itemsize
    return whole[skip : skip + count]


def _any(builder: Any, mask: Any) -> Any:
    bits = builder.bitcast(mask, ir.IntType(mask.type.count))
    return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))


@intrinsic
def any_above(typingctx: Any, vector: Any, scalar: Any) -> Any:
    """Whether a lane of `vector` is above `scalar` (same float type)."""
    if not (isinstance(vector, Vector) and vector.element == scalar):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _any(builder, builder.fcmp_ordered(">", args[0], emit_spread(builder, args[1], vector.lanes)))

    return types.boolean(vector, scalar), codegen


@intrinsic
def any_within(typingctx: Any, vector: Any, above: Any, below: Any) -> Any:
    """Whether a lane of `vector` is above the one and below the other scalar (same float type)."""
    if not (isinstance(vector, Vector) and vector.element == above == below):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        above = builder.fcmp_ordered(">", args[0], emit_spread(builder, args[1], vector.lanes))
        below = builder.fcmp_ordered("<", args[0], emit_spread(builder, args[2], vector.lanes))
        return _any(builder, builder.and_(above, below))

    return types.boolean(vector, above, below), codegen


def emit_shuffle(builder: Any, x: Any, y: Any, lanes: list[int]) -> Any:
    """A vector of the numbered lanes of x and, after them, y."""
    return builder.shuffle_vector(x, y, ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes))


CHEAP_LANES = 4
"""Lanes within which x86 and NEON move float32 numbers in one instruction."""


def _run_halves(lanes: int, half: int) -> tuple[list[int], list[int]]:
    """Of two vectors that hold sums in runs of 2·half lanes the first half of each run, and the second."""
    near = lanes if half >= CHEAP_LANES else CHEAP_LANES
    places = [(vector, near_by) for near_by in range(0, lanes, near) for vector in (0, lanes)]
    runs = [vector + run for vector, near_by in places for run in range(near_by, near_by + near, 2 * half)]
    first = [lane for run in runs for lane in range(run, run + half)]
    return first, [lane + half for lane in first]


def _summed_in(lanes: int) -> list[int]:
    """By lane of what `_emit_sums` gives, the place of the vector that is summed there."""
    owners, half = [[place] * lanes for place in range(lanes)], lanes // 2
    while half:
        first, _ = _run_halves(lanes, half)
        owners = [[(x + y)[lane] for lane in first] for x, y in zip(owners[::2], owners[1::2], strict=True)]
        half //= 2
    return owners[0]


def _emit_sums(builder: Any, vectors: list[Any]) -> Any:
    """The sums of lanes of vectors, no more than they have lanes: lane i has that of the i-th."""
    llvm_type = vectors[0].type
    zero, half = constant(llvm_type, 0.0), llvm_type.count // 2
    rows: list[Any] = [None] * llvm_type.count
    for vector, place in zip(vectors, _summed_in(llvm_type.count), strict=False):
        rows[place] = vector
    while half:
        first, second = _run_halves(llvm_type.count, half)
        pairs = [
            None if x is None and y is None else (x or zero, y or zero)
            for x, y in zip(rows[::2], rows[1::2], strict=True)
        ]
        rows = [
            pair and builder.fadd(emit_shuffle(builder, *pair, first), emit_shuffle(builder, *pair, second))
            for pair in pairs
        ]
        half //= 2
    return rows[0]


@intrinsic
def sum_lanes(typingctx: Any, vectors: Any) -> Any:
    """The sums over the lanes of a tuple of up to LANES vectors, as one of LANES: lane i has the i-th sum.

    A transposing tree: for 11 vectors of 8 lanes 12 additions and 24 shuffles, where separate sums need three
    of each for every vector. Halves are added first: where they are registers that takes no shuffle.
    """
    if not (isinstance(vectors, types.UniTuple) and isinstance(vectors.dtype, Vector)):
        return None
    lanes, result = vectors.dtype.lanes, Vector(vectors.dtype.element)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rows = cgutils.unpack_tuple(builder, args[0], vectors.count)
        groups = [rows[first : first + lanes] for first in range(0, LANES, lanes)]
        sums = [_emit_sums(builder, group) if group else constant(rows[0].type, 0.0) for group in groups]
        return sums[0] if len(sums) == 1 else emit_shuffle(builder, sums[0], sums[1], list(range(LANES)))

    return result(vectors), codegen


@intrinsic
def widened(typingctx: Any, vector: Any) -> Any:
    """A vector in float64."""
    if not isinstance(vector, Vector):
        return None
    result = Vector(types.float64, vector.lanes)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return args[0] if vector == result else builder.fpext(args[0], float_type(context, result))

    return result(vector), codegen


@intrinsic
def converted(typingctx: Any, vector: Any, array: Any) -> Any:
    """A vector in the float type of an array."""
    if not (isinstance(vector, Vector) and isinstance(array, types.Array)):
        return None
    result = Vector(array.dtype, vector.lanes)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        if vector == result:
            return args[0]
        cast = builder.fpext if result.element.bitwidth == 64 else builder.fptrunc
        return cast(args[0], float_type(context, result))

    return result(vector, array), codegen


@intrinsic
def greatest_lane(typingctx: Any, vector: Any) -> Any:
    """The greatest of a vector's lanes."""
    if not isinstance(vector, Vector):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        greatest, half = args[0], vector.lanes // 2
        while half:
            other = emit_shuffle(builder, greatest, greatest, [lane ^ half for lane in range(vector.lanes)])
            greatest = builder.select(builder.fcmp_ordered(">", greatest, other), greatest, other)
            half //= 2
        return builder.extract_element(greatest, ir.Constant(ir.IntType(32), 0))

    return vector.element(vector), codegen


@intrinsic
def prefetch(typingctx: Any, array: Any, index: Any) -> Any:
    """Asks for the memory of array[index], a number or a row, ahead of its use; C-contiguous, 1-D or 2-D.

    Nothing is read: an index beyond the array does no harm.
    """
    if not (isinstance(array, types.Array) and array.ndim in (1, 2) and array.layout == "C"):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values = context.make_array(array)(context, builder, args[0])
        step = cgutils.unpack_tuple(builder, values.strides, array.ndim)[0]
        address = builder.add(builder.ptrtoint(values.data, step.type), builder.mul(args[1], step))
        pointer = builder.inttoptr(address, ir.IntType(8).as_pointer())
        read, keep, data = (ir.Constant(ir.IntType(32), value) for value in (0, 3, 1))
        call_llvm(builder, "llvm.prefetch.p0", ir.VoidType(), pointer, read, keep, data)
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen
