"""Lanes: LANES directions side by side, 8 numbers that lie one behind the other, which the processor takes as one vector.

numba's compiler unrolls a loop over 8 lanes into scalar instructions wherever its body is short. The two operations here are vector
instructions from the start; they serve gathering, scattering and sums. Arrays are flat, positions count numbers, nothing is checked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from thermofit.core.jit import kernel
from thermofit.law.page_rates import LANES

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_Made = tuple[Any, Callable[..., Any]]


def _address(context: Any, builder: Any, array: tuple[Any, Any], at: Any) -> Any:
    """Pointer to the vector that begins at a position of an array, given as (type, value)."""
    start = context.make_array(array[0])(context, builder, array[1]).data
    return builder.bitcast(builder.gep(start, [at]), _VECTOR.as_pointer())


def _flat(*arrays: Any) -> bool:
    """True for types of contiguous vectors of doubles; for others the compiler then tells that the operation does not exist."""
    return all(isinstance(a, types.Array) and (a.ndim, a.layout, a.dtype) == (1, "C", types.float64) for a in arrays)


def _copy_lanes(_: Any, y: Any, at: Any, x: Any, start: Any) -> _Made | None:
    if not _flat(y, x):
        return None
    signature = types.void(y, types.intp, x, types.intp)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        source = builder.load(_address(context, builder, (sig.args[2], args[2]), args[3]), align=8)
        builder.store(source, _address(context, builder, (sig.args[0], args[0]), args[1]), align=8)
        return context.get_dummy_value()

    return signature, generate


def _add_lanes(_: Any, y: Any, at: Any, factor: Any, x: Any, start: Any) -> _Made | None:
    if not _flat(y, x):
        return None
    signature = types.void(y, types.intp, types.float64, x, types.intp)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        scalar = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), args[2], ir.Constant(ir.IntType(32), 0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        factor_lanes = builder.shuffle_vector(scalar, ir.Constant(_VECTOR, ir.Undefined), mask)
        source = builder.load(_address(context, builder, (sig.args[3], args[3]), args[4]), align=8)
        target = _address(context, builder, (sig.args[0], args[0]), args[1])
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        fma = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{LANES}f64")  # type: ignore[no-untyped-call]
        builder.store(builder.call(fma, [factor_lanes, source, builder.load(target, align=8)]), target, align=8)
        return context.get_dummy_value()

    return signature, generate


def _multiply_add(_: Any, a: Any, b: Any, c: Any) -> _Made:
    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


copy_lanes: Any = intrinsic(_copy_lanes)
"""copy_lanes(y, at, x, start): y[at : at + LANES] = x[start : start + LANES]."""
add_lanes: Any = intrinsic(_add_lanes)
"""add_lanes(y, at, factor, x, start): y[at : at + LANES] += factor x[start : start + LANES], product and sum rounded once."""
multiply_add: Any = intrinsic(_multiply_add)
"""multiply_add(a, b, c): a b + c, rounded once, as in `add_lanes`."""


@kernel
def _multiply(row: np.ndarray, column: np.ndarray, data: np.ndarray, x: np.ndarray, m: int, y: np.ndarray) -> None:
    for s in range(row.shape[0]):
        i, j, d = row[s] * m, column[s] * m, data[s]
        if d != 0.0:  # most of a film's matrix is
            for b in range(0, m, LANES):
                add_lanes(y, i + b, d, x, j + b)
                if i != j:
                    add_lanes(y, j + b, d, x, i + b)


def multiply_directions(row: np.ndarray, column: np.ndarray, data: np.ndarray, x: np.ndarray) -> np.ndarray:
    """y (n, m) = K x for contiguous x (n, m), m a multiple of LANES, of a symmetric matrix kept by its lower triangle."""
    y = np.zeros(x.shape)
    _multiply(row, column, data, x.reshape(-1), x.shape[1], y.reshape(-1))
    return y
