"""Exponentials and logarithms of vectors: polynomials, and exponents moved by shifts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba.core import types

from splatview.raster.compiling import inline
from splatview.raster.simd import (
    Vector,
    call_llvm,
    constant,
    fill,
    float_type,
    int_type,
    intrinsic,
    maximum,
    minimum,
    suffix,
)


def exp2_coefficients(degree: int) -> list[float]:
    """Polynomial of 2^f on [-½, ½], lowest power first: Chebyshev interpolation, near the best possible."""
    polynomial = np.polynomial.Chebyshev.interpolate(np.exp2, degree, [-0.5, 0.5])
    return polynomial.convert(kind=np.polynomial.Polynomial).coef.tolist()


LOG2_E = math.log2(math.e)

EXP2_DEGREE = {32: 5, 64: 11}
"""By bits of the float type: relative errors of 2e-7 and 3e-16. Degree 4, 3e-6, would do for pictures and
save a twentieth of the inner loop; gradients through many layers keep a digit more with 5."""

EXP_DEGREE_FOR = {32: 7, 64: 11}
"""Of exponentials of float64 numbers, by bits of the pictures that come of them: relative errors of 6e-11, a
thousandth of what float32 records round away, and 3e-15."""

LOG2_TERMS_FOR = {32: 6, 64: 11}
"""The same of logarithms: absolute errors of 3e-11 and 3e-16."""


def emit_polynomial(builder: Any, vector: Vector, x: Any, coefficients: list[float]) -> Any:
    """Estrin's scheme: pairs of terms side by side, so that latencies overlap where Horner's add up."""
    terms: list[Any] = [constant(x.type, coefficient) for coefficient in coefficients]
    while len(terms) > 1:
        paired = [
            call_llvm(builder, f"llvm.fmuladd.{suffix(vector)}", x.type, high, x, low)
            for low, high in zip(terms[::2], terms[1::2], strict=False)
        ]
        terms = paired + terms[len(paired) * 2 :]
        x = builder.fmul(x, x)
    return terms[0]


def _emit_exp2(context: Any, builder: Any, vector: Vector, value: Any, degree: int) -> Any:
    llvm_type, ints = float_type(context, vector), int_type(vector)
    mantissa = 23 if vector.element.bitwidth == 32 else 52
    magic = constant(llvm_type, 1.5 * 2.0**mantissa)
    shifted = builder.fadd(value, magic)
    fraction = builder.fsub(value, builder.fsub(shifted, magic))
    power = emit_polynomial(builder, vector, fraction, exp2_coefficients(degree))
    exponent = builder.shl(builder.bitcast(shifted, ints), constant(ints, mantissa))
    return builder.bitcast(builder.add(builder.bitcast(power, ints), exponent), llvm_type)


@intrinsic
def exp2(typingctx: Any, x: Any) -> Any:
    """2^x for x in the range of normal numbers (-126 to 127 in float32); meaningless bits beyond it.

    2^x = 2^k · 2^f, k the nearest integer: adding 1.5·2^(mantissa bits) leaves k in the low bits of the
    sum, from where a shift moves it to the exponent (Schraudolph 1999, made exact by the polynomial).
    """
    if not isinstance(x, Vector):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _emit_exp2(context, builder, x, args[0], EXP2_DEGREE[x.element.bitwidth])

    return x(x), codegen


@intrinsic
def _exp2_for(typingctx: Any, x: Any, pictures: Any) -> Any:
    """The same of float64 lanes, as exact as an array of pictures needs it."""
    if not (isinstance(x, Vector) and x.element == types.float64 and isinstance(pictures, types.Array)):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _emit_exp2(context, builder, x, args[0], EXP_DEGREE_FOR[pictures.dtype.bitwidth])

    return x(x, pictures), codegen


@inline
def exp_lanes(x, pictures):
    """e^x in every lane of float64, at most 2^1023 and at least 2^-1022; NaN for NaN. As exact as the dtype
    of an array `pictures` needs it: see EXP_DEGREE_FOR."""
    # The order of the arguments keeps NaN, and so does the sum: it is 0 for all else.
    power = minimum(fill(x, 1023.0), maximum(fill(x, -1022.0), x * LOG2_E))
    return _exp2_for(power, pictures) + (power - power)


@intrinsic
def log2_lanes(typingctx: Any, x: Any, pictures: Any) -> Any:
    """log2 of positive normal float64 numbers, nothing for others; as exact as the dtype of an array
    `pictures` needs it: see LOG2_TERMS_FOR.

    x = 2^k·m with m in [√½, √2), and log2(m) = 2/ln(2)·artanh((m - 1) / (m + 1)) by its series.
    """
    if not (isinstance(x, Vector) and x.element == types.float64 and isinstance(pictures, types.Array)):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        llvm_type, ints = float_type(context, x), int_type(x)
        bits = builder.bitcast(args[0], ints)
        root_half = constant(ints, int(np.float64(math.sqrt(0.5)).view(np.int64)))
        shift = constant(ints, 52)
        exponent = builder.ashr(builder.sub(bits, root_half), shift)
        m = builder.bitcast(builder.sub(bits, builder.shl(exponent, shift)), llvm_type)
        one = constant(llvm_type, 1.0)
        s = builder.fdiv(builder.fsub(m, one), builder.fadd(m, one))
        series = [2 / math.log(2) / (2 * term + 1) for term in range(LOG2_TERMS_FOR[pictures.dtype.bitwidth])]
        log2_m = builder.fmul(s, emit_polynomial(builder, x, builder.fmul(s, s), series))
        return builder.fadd(builder.sitofp(exponent, llvm_type), log2_m)

    return x(x, pictures), codegen
