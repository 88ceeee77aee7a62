"""Vectors of 8 lanes inside numba kernels: what the inner loops are written in.

Whether LLVM vectorises a scalar loop hangs on alias checks and cost models; code written on vectors
is vector code on every machine (two SSE or NEON registers, one AVX register a float32 vector). The
lanes are 8 neighbouring pixels of a row. Eight, not sixteen: half a tile's row is often all that a
small splat touches, and Zen 4 runs eight lanes at twice the rate of sixteen.

A `Vector` exists only inside kernels; its element type, float32 or float64, is that of the array or
scalar that it came from. Nothing here allows LLVM to assume that numbers are finite. Comparisons are
false for NaN.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic as _numba_intrinsic
from numba.extending import models, overload, register_model

from .compiling import BOUNDSCHECK, inline

LANES = 8
"""Pixels in a vector."""

# The decorated function is called without its first parameter, which type checkers cannot know.
intrinsic: Any = _numba_intrinsic


class Vector(types.Type):
    """numba type of LANES floats."""

    def __init__(self, element: types.Float) -> None:
        self.element = element
        super().__init__(name=f"Vector({element} x {LANES})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        element = ir.FloatType() if fe_type.element.bitwidth == 32 else ir.DoubleType()
        super().__init__(dmm, fe_type, ir.VectorType(element, LANES))


def _int_type(vector: Vector) -> ir.VectorType:
    return ir.VectorType(ir.IntType(vector.element.bitwidth), LANES)


def _float_type(context: Any, vector: Vector) -> ir.VectorType:
    return context.get_value_type(vector)


def _constant(llvm_type: ir.VectorType, value: float) -> ir.Constant:
    return ir.Constant(llvm_type, [value] * LANES)


def _spread(builder: Any, scalar: Any) -> Any:
    """A scalar in every lane."""
    vector_type = ir.VectorType(scalar.type, LANES)
    one = builder.insert_element(
        ir.Constant(vector_type, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(vector_type, ir.Undefined), zeros)


def _call(builder: Any, name: str, result: Any, *args: Any) -> Any:
    """Calls an LLVM intrinsic by its full name."""
    function_type = ir.FunctionType(result, [arg.type for arg in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, function_type, name), args)


def _suffix(vector: Vector) -> str:
    return f"v{LANES}f{vector.element.bitwidth}"


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

    return intrinsic({1: one, 2: two, 3: three}[arity])


fma = _vector_op(3, lambda b, v, x, y, z: _call(b, f"llvm.fmuladd.{_suffix(v)}", x.type, x, y, z))
"""x·y + z, in one rounding where the machine can."""
negate = _vector_op(1, lambda b, v, x: b.fneg(x))
divide = _vector_op(2, lambda b, v, x, y: b.fdiv(x, y))
absolute = _vector_op(1, lambda b, v, x: _call(b, f"llvm.fabs.{_suffix(v)}", x.type, x))
sqrt = _vector_op(1, lambda b, v, x: _call(b, f"llvm.sqrt.{_suffix(v)}", x.type, x))
floor = _vector_op(1, lambda b, v, x: _call(b, f"llvm.floor.{_suffix(v)}", x.type, x))
ceil = _vector_op(1, lambda b, v, x: _call(b, f"llvm.ceil.{_suffix(v)}", x.type, x))
minimum = _vector_op(2, lambda b, v, x, y: b.select(b.fcmp_ordered("<", x, y), x, y))
"""x < y ? x : y, so y where either is NaN."""
maximum = _vector_op(2, lambda b, v, x, y: b.select(b.fcmp_ordered(">", x, y), x, y))
"""x > y ? x : y, so y where either is NaN."""
keep_if_at_least = _vector_op(
    3, lambda b, v, x, y, z: b.select(b.fcmp_ordered(">=", y, z), x, _constant(x.type, 0.0))
)
"""x where y >= z, else 0."""
keep_if_below = _vector_op(
    3, lambda b, v, x, y, z: b.select(b.fcmp_ordered("<", y, z), x, _constant(x.type, 0.0))
)
"""x where y < z, else 0."""


def _emit_reciprocal(b: Any, v: Vector, x: Any) -> Any:
    return b.fdiv(_constant(x.type, 1.0), x, flags=("arcp",))


reciprocal = _vector_op(1, _emit_reciprocal)
"""1 / x."""


def _bind(symbol: Any, function: Any) -> None:
    """Makes an operator of two vectors of one type call `function`."""

    @overload(symbol)
    def bound(x, y):
        if not (isinstance(x, Vector) and x == y):
            return None

        def call(x, y):
            return function(x, y)

        return call


_bind(operator.add, _vector_op(2, lambda b, v, x, y: b.fadd(x, y)))
_bind(operator.sub, _vector_op(2, lambda b, v, x, y: b.fsub(x, y)))
_bind(operator.mul, _vector_op(2, lambda b, v, x, y: b.fmul(x, y)))


@intrinsic
def spread(typingctx: Any, scalar: Any) -> Any:
    """A float scalar in every lane."""
    if not isinstance(scalar, types.Float):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _spread(builder, args[0])

    return Vector(scalar)(scalar), codegen


@intrinsic
def fill(typingctx: Any, like: Any, value: Any) -> Any:
    """The number `value`, of any float or integer type, in every lane of a vector of the type of `like`."""
    if not isinstance(like, Vector):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _spread(builder, context.cast(builder, args[1], signature.args[1], like.element))

    return like(like, value), codegen


@intrinsic
def lane_centres(typingctx: Any, like: Any) -> Any:
    """0.5, 1.5, ..., 7.5: the pixel centres of a vector, in the type of `like`."""
    if not isinstance(like, Vector):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return ir.Constant(_float_type(context, like), [lane + 0.5 for lane in range(LANES)])

    return like(like), codegen


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any, llvm_type: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), llvm_type.as_pointer())


def _flat(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == "C"


@intrinsic
def _load(typingctx: Any, array: Any, index: Any) -> Any:
    if not (_flat(array) and isinstance(array.dtype, types.Float)):
        return None
    vector = Vector(array.dtype)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        llvm_type = _float_type(context, vector)
        address = _address(context, builder, array, args[0], args[1], llvm_type)
        return builder.load(address, align=array.dtype.bitwidth // 8)

    return vector(array, types.intp), codegen


@intrinsic
def _store(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    if not (_flat(array) and isinstance(value, Vector) and value.element == array.dtype):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address = _address(context, builder, array, args[0], args[1], args[2].type)
        builder.store(args[2], address, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def _store_int(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    if not (_flat(array) and array.dtype == types.int32 and isinstance(value, Vector)):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        ints = ir.VectorType(ir.IntType(32), LANES)
        address = _address(context, builder, array, args[0], args[1], ints)
        builder.store(builder.fptosi(args[2], ints), address, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@inline
def load(array, index):
    """LANES floats of a flat, C-contiguous array from `index` on. 0 <= index <= size - LANES."""
    if BOUNDSCHECK:
        _touch(array, index)
    return _load(array, index)


@inline
def store(array, index, value):
    """Writes a vector to a flat array of its element type from `index` on."""
    if BOUNDSCHECK:
        _touch(array, index)
    _store(array, index, value)


@inline
def store_int(array, index, value):
    """Writes a vector, rounded towards zero, to a flat int32 array. The values must fit."""
    if BOUNDSCHECK:
        _touch(array, index)
    _store_int(array, index, value)


@inline
def _touch(array, index):
    """With bounds checking on, numba's own: vectors reach memory by address and would escape it."""
    if index < 0 or index + LANES > array.size:
        raise IndexError("a vector reaches beyond its array")


@intrinsic
def any_above(typingctx: Any, vector: Any, scalar: Any) -> Any:
    """Whether a lane of `vector` is above `scalar` (same float type)."""
    if not (isinstance(vector, Vector) and vector.element == scalar):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        mask = builder.fcmp_ordered(">", args[0], _spread(builder, args[1]))
        bits = builder.bitcast(mask, ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(vector, scalar), codegen


def exp2_coefficients(degree: int) -> list[float]:
    """Polynomial of 2^f on [-½, ½], lowest power first: Chebyshev interpolation, near the best possible."""
    polynomial = np.polynomial.Chebyshev.interpolate(np.exp2, degree, [-0.5, 0.5])
    return polynomial.convert(kind=np.polynomial.Polynomial).coef.tolist()


EXP2_DEGREE = {32: 5, 64: 11}
"""By bits of the float type: relative errors of 2e-7 and 3e-16."""


@intrinsic
def exp2(typingctx: Any, x: Any) -> Any:
    """2^x for x in the range of normal numbers (-126 to 127 in float32); meaningless bits beyond it.

    2^x = 2^k · 2^f, k the nearest integer: adding 1.5·2^(mantissa bits) leaves k in the low bits of the
    sum, from where a shift moves it to the exponent (Schraudolph 1999, made exact by the polynomial).
    """
    if not isinstance(x, Vector):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        llvm_type, ints = _float_type(context, x), _int_type(x)
        mantissa = 23 if x.element.bitwidth == 32 else 52
        magic = _constant(llvm_type, 1.5 * 2.0**mantissa)
        shifted = builder.fadd(args[0], magic)
        fraction = builder.fsub(args[0], builder.fsub(shifted, magic))
        coefficients = exp2_coefficients(EXP2_DEGREE[x.element.bitwidth])
        power = _constant(llvm_type, coefficients[-1])
        for coefficient in coefficients[-2::-1]:
            addend = _constant(llvm_type, coefficient)
            power = _call(builder, f"llvm.fmuladd.{_suffix(x)}", llvm_type, power, fraction, addend)
        exponent = builder.shl(builder.bitcast(shifted, ints), ir.Constant(ints, [mantissa] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(power, ints), exponent), llvm_type)

    return x(x), codegen


@intrinsic
def sum_eight(typingctx: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any) -> Any:
    """The sums over the lanes of eight vectors, as one vector: lane i holds the sum of the i-th.

    A transposing tree of 7 additions and 14 shuffles, where eight separate sums need 24 of each.
    """
    vectors = (a, b, c, d, e, f, g, h)
    if not all(isinstance(vector, Vector) and vector == a for vector in vectors):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def shuffle(x: Any, y: Any, lanes: list[int]) -> Any:
            mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), lanes)
            return builder.shuffle_vector(x, y, mask)

        rows = list(args)
        # Interleaving with stride s adds lane i of x to lane i + s of it, and puts y's beside.
        for stride in (1, 2, 4):
            low = [i + (LANES - stride if i & stride else 0) for i in range(LANES)]
            high = [i + (LANES if i & stride else stride) for i in range(LANES)]
            rows = [
                builder.fadd(shuffle(x, y, low), shuffle(x, y, high))
                for x, y in zip(rows[::2], rows[1::2], strict=True)
            ]
        return rows[0]

    return a(a, b, c, d, e, f, g, h), codegen
