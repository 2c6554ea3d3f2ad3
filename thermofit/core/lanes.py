"""Lanes: eight numbers that the processor handles as one, for instance the same component at the eight Gauss points of an element.

Kernels calculate with lanes as with numbers: `+ - * / **`, comparisons, abs, sqrt, exp and log of `math`, and of numpy the functions
OF_NUMPY. A formula of the law page or of `tensor` therefore serves a number and lanes alike; a number among lanes stands for eight equal
ones. A comparison gives a mask, which no `if` takes: `where` chooses lane by lane, `any_lane` and `all_lanes` answer for all.

Lanes live inside kernels only. They are LLVM's vector type, which it maps to the registers of any processor, and all operations are
IEEE arithmetic: what a lane holds depends on neither the processor nor the other lanes.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numba.extending
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import literal_unroll

from thermofit.core.jit import kernel

types: Any = numba.types
extending: Any = numba.extending
intrinsic = extending.intrinsic
"""numba's, as if without annotations: these are partial, and that of an intrinsic is the one of its definition, not of its calls."""

WIDTH = 8
"""Numbers of one lanes value."""
Lanes = float
"""Type of lanes in annotations: to the type checker a number."""
Mask = bool
"""Type of a comparison of lanes in annotations."""

DOUBLES, _BITS, _FLAGS = (ir.VectorType(t, WIDTH) for t in (ir.DoubleType(), ir.IntType(64), ir.IntType(1)))
"""LLVM's vectors of numbers, whole numbers and truth values."""
INDEX = ir.IntType(32)
"""LLVM's type of a place in a vector."""


class LanesType(types.Type):
    """numba type of lanes."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")

    def unify(self, context: Any, other: Any) -> Any:
        """A variable that is lanes on one way and a number on another is lanes."""
        return self if is_operand(other) else None


class MaskType(types.Type):
    """numba type of a comparison of lanes."""

    def __init__(self) -> None:
        super().__init__(name="Mask")


LANES, MASK = LanesType(), MaskType()


@extending.register_model(LanesType)
class _LanesModel(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, DOUBLES)


@extending.register_model(MaskType)
class _MaskModel(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _FLAGS)


def _same(kind: ir.VectorType, value: float) -> ir.Constant:
    return ir.Constant(kind, [value] * WIDTH)


def is_operand(kind: Any) -> bool:
    """Whether a numba type is that of lanes or of a real number."""
    return kind is LANES or isinstance(kind, types.Integer | types.Float)


def as_lanes(context: Any, builder: Any, value: Any, kind: Any) -> Any:
    """LLVM value of lanes or of a number as lanes."""
    if kind is LANES:
        return value
    undefined = ir.Constant(DOUBLES, ir.Undefined)
    one = builder.insert_element(undefined, context.cast(builder, value, kind, types.float64), INDEX(0))
    return builder.shuffle_vector(one, undefined, _same(ir.VectorType(INDEX, WIDTH), 0))


@extending.lower_cast(types.Integer, LanesType)
@extending.lower_cast(types.Float, LanesType)
def _cast(context: Any, builder: Any, from_kind: Any, to_kind: Any, value: Any) -> Any:
    return as_lanes(context, builder, value, from_kind)


def _define_binary(function: Any, result: Any, emit: Callable[[Any, Any, Any], Any]) -> None:
    """Define a function of two operands, at least one of them lanes; emit(builder, a, b) gives the LLVM value."""

    @extending.type_callable(function)
    def typed(context: Any) -> Any:
        return lambda a, b: result if (a is LANES or b is LANES) and is_operand(a) and is_operand(b) else None

    def lowered(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        a, b = (as_lanes(context, builder, value, kind) for value, kind in zip(values, signature.args, strict=True))
        return emit(builder, a, b)

    for operands in ((LanesType, LanesType), *((LanesType, n) for n in _NUMBERS), *((n, LanesType) for n in _NUMBERS)):
        extending.lower_builtin(function, *operands)(lowered)


def _define_closed(function: Any, kind: Any, n: int, emit: Callable[..., Any]) -> None:
    """Define a function of n operands of one kind with a result of this kind."""

    @extending.type_callable(function)
    def typed(context: Any) -> Any:
        if n == 1:
            return lambda a: kind if a is kind else None
        return lambda a, b: kind if a is kind and b is kind else None

    @extending.lower_builtin(function, *[type(kind)] * n)
    def lowered(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return emit(builder, *values)


def _call(builder: Any, name: str, value: Any) -> Any:
    """Call of an LLVM intrinsic of one operand; every processor has these."""
    function = builder.module.globals.get(name) or ir.Function(builder.module, ir.FunctionType(DOUBLES, [DOUBLES]), name)
    return builder.call(function, [value])


_FUSED = f"llvm.fma.v{WIDTH}f64"
_NUMBERS = (types.Float, types.Integer)
_define_binary(operator.add, LANES, lambda builder, a, b: builder.fadd(a, b))
_define_binary(operator.sub, LANES, lambda builder, a, b: builder.fsub(a, b))
_define_binary(operator.mul, LANES, lambda builder, a, b: builder.fmul(a, b))
_define_binary(operator.truediv, LANES, lambda builder, a, b: builder.fdiv(a, b))
_define_binary(operator.lt, MASK, lambda builder, a, b: builder.fcmp_ordered("<", a, b))
_define_binary(operator.le, MASK, lambda builder, a, b: builder.fcmp_ordered("<=", a, b))
_define_binary(operator.gt, MASK, lambda builder, a, b: builder.fcmp_ordered(">", a, b))
_define_binary(operator.ge, MASK, lambda builder, a, b: builder.fcmp_ordered(">=", a, b))
_define_closed(operator.neg, LANES, 1, lambda builder, a: builder.fneg(a))
_define_closed(abs, LANES, 1, lambda builder, a: _call(builder, f"llvm.fabs.v{WIDTH}f64", a))
_define_closed(math.sqrt, LANES, 1, lambda builder, a: _call(builder, f"llvm.sqrt.v{WIDTH}f64", a))
_define_closed(operator.invert, MASK, 1, lambda builder, a: builder.not_(a))
_define_closed(operator.and_, MASK, 2, lambda builder, a, b: builder.and_(a, b))
_define_closed(operator.or_, MASK, 2, lambda builder, a, b: builder.or_(a, b))


@intrinsic
def spread(typing: Any, number: Any) -> Any:
    """Lanes of eight equal numbers."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return as_lanes(context, builder, values[0], types.float64)

    return LANES(types.float64), emit


@intrinsic
def multiply_add(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once; one or two of the three may be numbers."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        operands = [as_lanes(context, builder, value, kind) for value, kind in zip(values, signature.args, strict=True)]
        kind = ir.FunctionType(DOUBLES, [DOUBLES] * 3)
        return builder.call(builder.module.globals.get(_FUSED) or ir.Function(builder.module, kind, _FUSED), operands)

    kinds = (a, b, c)
    return (LANES(a, b, c), emit) if LANES in kinds and all(is_operand(kind) for kind in kinds) else None


@intrinsic
def where(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """Lane by lane a where the mask holds, else b; a or b may be a number."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        a, b = (as_lanes(context, builder, values[n], signature.args[n]) for n in (1, 2))
        return builder.select(values[0], a, b)

    return (LANES(mask, a, b), emit) if mask is MASK and is_operand(a) and is_operand(b) else None


@intrinsic
def _mask_bits(typing: Any, mask: Any) -> Any:
    """The mask as a whole number, one bit per lane."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.zext(builder.bitcast(values[0], ir.IntType(WIDTH)), ir.IntType(64))

    return (types.int64(mask), emit) if mask is MASK else None


@kernel(forceinline=True)
def any_lane(mask: Mask) -> bool:
    """Whether the mask holds in at least one lane."""
    return _mask_bits(mask) != 0


@kernel(forceinline=True)
def all_lanes(mask: Mask) -> bool:
    """Whether the mask holds in every lane."""
    return _mask_bits(mask) == 2**WIDTH - 1


@kernel(forceinline=True)
def larger(a: Lanes, b: Lanes) -> Lanes:
    """The larger of two, lane by lane."""
    return where(a > b, a, b)


_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.6931471803691238, 1.9082149292705877e-10
"""ln 2 = high + low; n high is exact for |n| < 2^20."""
_ROUND = 1.5 * 2.0**52
"""x + _ROUND holds in its last bits the whole number next to x."""
_BIAS, _PLACE = 1023, 52
"""Offset and place of the exponent among the bits of a number."""
_EXP_LIMIT = 708.0
_SMALLEST = np.finfo(float).tiny
_COSH = tuple(1.0 / math.factorial(n) for n in range(12, -1, -2))
_SINH = tuple(1.0 / math.factorial(n) for n in range(13, 0, -2))
"""Coefficients of cosh r and of sinh r / r by powers of r^2, highest first."""
_ARTANH = tuple(1.0 / n for n in range(21, 2, -2))
"""Coefficients of (artanh(s) / s - 1) / s^2 by powers of s^2, highest first."""


def _bits(value: float) -> int:
    return int(np.float64(value).view(np.int64))


@intrinsic
def _power_of_two(typing: Any, rounded: Any) -> Any:
    """2^n of lanes n + _ROUND, |n| < 1023: the last bits become the exponent."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        n = builder.add(builder.bitcast(values[0], _BITS), _same(_BITS, _BIAS))
        return builder.bitcast(builder.shl(n, _same(_BITS, _PLACE)), DOUBLES)

    return (LANES(rounded), emit) if rounded is LANES else None


@intrinsic
def _mantissa_exponent(typing: Any, a: Any) -> Any:
    """m in [sqrt(1/2), sqrt 2) and n of a = m 2^n > 0."""
    kind = types.UniTuple(LANES, 2)

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        a, place = builder.bitcast(values[0], _BITS), _same(_BITS, _PLACE)
        n_biased = builder.lshr(builder.add(a, _same(_BITS, (_BIAS << _PLACE) - _bits(math.sqrt(0.5)))), place)
        m = builder.sub(a, builder.shl(builder.sub(n_biased, _same(_BITS, _BIAS)), place))
        n_rounded = builder.bitcast(builder.add(n_biased, _same(_BITS, _bits(_ROUND) - _BIAS)), DOUBLES)
        return context.make_tuple(builder, kind, [builder.bitcast(m, DOUBLES), builder.fsub(n_rounded, _same(DOUBLES, _ROUND))])

    return (kind(a), emit) if a is LANES else None


@kernel(forceinline=True)
def _polynomial(c: tuple[float, ...], x: Lanes) -> Lanes:
    """Value of a polynomial, highest coefficient first."""
    value = c[0] * x + c[1]
    for coefficient in literal_unroll(c[2:]):
        value = value * x + coefficient
    return value


@kernel(forceinline=True)
def _reduced(x: Lanes) -> tuple[Lanes, Lanes]:
    """n + _ROUND and r of x = n ln 2 + r, |r| < ln 2 / 2; x beyond +-708 counts as +-708."""
    x = where(x > _EXP_LIMIT, _EXP_LIMIT, where(x < -_EXP_LIMIT, -_EXP_LIMIT, x))
    rounded = x * _LOG2_E + _ROUND
    n = rounded - _ROUND
    return rounded, (x - n * _LN2_HIGH) - n * _LN2_LOW


@kernel
def _exponential(x: Lanes) -> Lanes:
    """exp x = 2^n (cosh r + sinh r), |r| < ln 2 / 2, to the last digit or two; x beyond +-708 counts as +-708."""
    rounded, r = _reduced(x)
    s = r * r
    return (_polynomial(_COSH, s) + r * _polynomial(_SINH, s)) * _power_of_two(rounded)


@kernel
def _logarithm(x: Lanes) -> Lanes:
    """ln x = n ln 2 + 2 artanh s, s = (m - 1)/(m + 1), of x = m 2^n, to the last digit or two; nan unless x is positive and finite."""
    m, n = _mantissa_exponent(x)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    value = n * _LN2_HIGH + (2.0 * s + (n * _LN2_LOW + 2.0 * s * z * _polynomial(_ARTANH, z)))
    return where((x >= _SMALLEST) & (x < math.inf), value, math.nan)


@kernel
def _exponential_less_one(x: Lanes) -> Lanes:
    """exp x - 1 = 2^n (cosh r - 1 + sinh r) + (2^n - 1), |r| < ln 2 / 2, to the last digits also next to x = 0; x as for exp."""
    rounded, r = _reduced(x)
    s = r * r
    scale = _power_of_two(rounded)
    return scale * (s * _polynomial(_COSH[:-1], s) + r * _polynomial(_SINH, s)) + (scale - 1.0)


@kernel
def _logarithm_of_more_than_one(x: Lanes) -> Lanes:
    """ln(1 + x) = ln u + (x - (u - 1)) / u with u = 1 + x rounded, to the last digits also next to x = 0."""
    u = 1.0 + x
    return _logarithm(u) + (x - (u - 1.0)) / u


@kernel
def _hyperbolic_tangent(x: Lanes) -> Lanes:
    """tanh x = m / (m + 2) with m = exp 2|x| - 1, and the sign of x."""
    m = _exponential_less_one(2.0 * abs(x))
    return where(x < 0.0, -(m / (m + 2.0)), m / (m + 2.0))


@kernel
def _hyperbolic_sine(x: Lanes) -> Lanes:
    """sinh x = (m + m / (m + 1)) / 2 with m = exp |x| - 1, and the sign of x."""
    m = _exponential_less_one(abs(x))
    value = 0.5 * (m + m / (m + 1.0))
    return where(x < 0.0, -value, value)


@kernel
def _hyperbolic_cosine(x: Lanes) -> Lanes:
    """cosh x = (exp |x| + exp -|x|) / 2."""
    e = _exponential(abs(x))
    return 0.5 * (e + 1.0 / e)


@kernel
def _area_sine(x: Lanes) -> Lanes:
    """arsinh x = ln(1 + |x| + x^2 / (1 + sqrt(1 + x^2))), and the sign of x."""
    a = abs(x)
    value = _logarithm_of_more_than_one(a + a * a / (1.0 + math.sqrt(1.0 + a * a)))
    return where(x < 0.0, -value, value)


@kernel
def _whole_power(a: Lanes, n: int) -> Lanes:
    """a^n of a whole number n, by squares."""
    value, factor, left = 0.0 * a + 1.0, a, abs(n)
    while left > 0:
        if left % 2 == 1:
            value = value * factor
        factor = factor * factor
        left = left // 2
    return 1.0 / value if n < 0 else value


@kernel
def _real_power(a: Lanes, n: Lanes) -> Lanes:
    """a^n = exp(n ln a) of a > 0; as of numbers 1 for n = 0 and nan for a < 0. Of a = 0, and of what has not all of its digits, it is 0 for
    n > 0 and inf for n < 0."""
    positive = _exponential(n * _logarithm(where(a >= _SMALLEST, a, 1.0)))
    at_zero = where(n > 0.0, 0.0, math.inf)
    value = where(a >= _SMALLEST, positive, where(a >= 0.0, at_zero, math.nan))
    return where((n >= 0.0) & (n <= 0.0), 1.0, value)


@extending.overload(operator.pow, strict=False)
def _power(a: Any, n: Any) -> Any:
    if not (a is LANES or n is LANES) or not (is_operand(a) and is_operand(n)):
        return None
    if a is LANES and getattr(n, "literal_value", None) == 2:
        return lambda a, n: a * a
    if a is LANES and isinstance(n, types.Integer):
        return lambda a, n: _whole_power(a, n)
    return lambda a, n: _real_power(_lanes_of(a), _lanes_of(n))


@intrinsic
def _lanes_of(typing: Any, operand: Any) -> Any:
    """Lanes as they stand, or eight of a number."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return as_lanes(context, builder, values[0], signature.args[0])

    return (LANES(operand), emit) if is_operand(operand) else None


def _of_lanes(implementation: Any) -> Callable[[Any], Any]:
    return lambda x: (lambda x: implementation(x)) if x is LANES else None


OF_NUMPY = ("abs", "sqrt", "exp", "expm1", "log", "log1p", "sinh", "cosh", "tanh", "arcsinh")
"""Functions of numpy that take lanes."""
_FOUND = {
    "exp": _of_lanes(_exponential),
    "expm1": _of_lanes(_exponential_less_one),
    "log": _of_lanes(_logarithm),
    "log1p": _of_lanes(_logarithm_of_more_than_one),
    "sinh": _of_lanes(_hyperbolic_sine),
    "cosh": _of_lanes(_hyperbolic_cosine),
    "tanh": _of_lanes(_hyperbolic_tangent),
    "arcsinh": _of_lanes(_area_sine),
    "abs": _of_lanes(abs),
    "sqrt": _of_lanes(math.sqrt),
}
for _function, _name in ((math.exp, "exp"), (math.log, "log"), *((getattr(np, name), name) for name in OF_NUMPY)):
    extending.overload(_function, strict=False)(_FOUND[_name])
