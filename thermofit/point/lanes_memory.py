"""Lanes in arrays: rows of a workspace, columns of point data, vectors at the nodes, the sum over the lanes.

A workspace is a flat array in rows of eight numbers. Rows of any C-contiguous array whose last axis is 8 are counted over all its other
axes.

States and rates of all points do not stay in the processor's cache from one pass over the elements to the next. A kernel has those of the
next point or element fetched while it works on this one (docs/performance.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]

from thermofit.core.jit import kernel
from thermofit.core.lanes import DOUBLES, INDEX, LANES, WIDTH, as_lanes, intrinsic, is_operand, types

_PREFETCH = "llvm.prefetch.p0"
_LINE = 64
"""Bytes that the processor reads at once: those of one row."""


def _is_memory(kind: Any) -> bool:
    return isinstance(kind, types.Array) and kind.layout == "C" and kind.dtype == types.float64


def _row_address(context: Any, builder: Any, kind: Any, array: Any, n: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.gep(data, [builder.mul(n, ir.Constant(n.type, WIDTH))])


def _load(builder: Any, address: Any) -> Any:
    return builder.load(builder.bitcast(address, DOUBLES.as_pointer()), align=8)


def _store(builder: Any, value: Any, address: Any) -> None:
    builder.store(value, builder.bitcast(address, DOUBLES.as_pointer()), align=8)


@intrinsic
def row(typing: Any, w: Any, n: Any) -> Any:
    """Row n as lanes."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _load(builder, _row_address(context, builder, signature.args[0], *values))

    return (LANES(w, types.intp), emit) if _is_memory(w) else None


@intrinsic
def set_row(typing: Any, w: Any, n: Any, value: Any) -> Any:
    """Write lanes, or a number eight times, into row n."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        w, n, value = values
        _store(builder, as_lanes(context, builder, value, signature.args[2]), _row_address(context, builder, signature.args[0], w, n))
        return context.get_dummy_value()

    return (types.none(w, types.intp, value), emit) if _is_memory(w) and is_operand(value) else None


@intrinsic
def prefetch_row(typing: Any, w: Any, n: Any) -> Any:
    """Have the processor fetch row n before it is read or written; a row beyond the end does no harm."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = builder.bitcast(_row_address(context, builder, signature.args[0], values[0], values[1]), ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [address.type, *[ir.IntType(32)] * 3])
        function = builder.module.globals.get(_PREFETCH) or ir.Function(builder.module, kind, _PREFETCH)
        builder.call(function, [address, *(ir.IntType(32)(n) for n in (0, 3, 1))])
        return context.get_dummy_value()

    return (types.none(w, types.intp), emit) if _is_memory(w) else None


@intrinsic
def at(typing: Any, w: Any, n: Any) -> Any:
    """The eight numbers from position n of a flat array on."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        return _load(builder, builder.gep(data, [values[1]]))

    return (LANES(w, types.intp), emit) if _is_memory(w) and w.ndim == 1 else None


@intrinsic
def set_at(typing: Any, w: Any, n: Any, value: Any) -> Any:
    """Write lanes to the eight places from position n of a flat array on."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        _store(builder, values[2], builder.gep(data, [values[1]]))
        return context.get_dummy_value()

    return (types.none(w, types.intp, value), emit) if _is_memory(w) and w.ndim == 1 and value is LANES else None


@intrinsic
def number_at(typing: Any, w: Any, n: Any) -> Any:
    """The number at position n of a flat array, where w[n] would first ask whether n counts from the end."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        return builder.load(builder.gep(data, [values[1]]))

    return (types.float64(w, types.intp), emit) if _is_memory(w) and w.ndim == 1 else None


@intrinsic
def number(typing: Any, w: Any, n: Any, lane: Any) -> Any:
    """One lane of row n."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        w, n, lane = values
        return builder.load(builder.gep(_row_address(context, builder, signature.args[0], w, n), [lane]))

    return (types.float64(w, types.intp, types.intp), emit) if _is_memory(w) else None


@intrinsic
def set_vectors(typing: Any, w: Any, n: Any, x: Any, y: Any, z: Any) -> Any:
    """Write x0 y0 z0 x1 y1 z1 ... into rows n to n + 2: the vectors at eight nodes, of which lanes hold one component each."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        w, n, x, y, z = values
        for part in range(3):
            chosen = [divmod(WIDTH * part + place, 3) for place in range(WIDTH)]
            xy = [node + WIDTH * component if component < 2 else 0 for node, component in chosen]
            xyz = [place if component < 2 else node + WIDTH for place, (node, component) in enumerate(chosen)]
            mixed = builder.shuffle_vector(x, y, ir.Constant(ir.VectorType(INDEX, WIDTH), xy))
            mixed = builder.shuffle_vector(mixed, z, ir.Constant(ir.VectorType(INDEX, WIDTH), xyz))
            _store(builder, mixed, _row_address(context, builder, signature.args[0], w, builder.add(n, ir.Constant(n.type, part))))
        return context.get_dummy_value()

    return (types.none(w, types.intp, x, y, z), emit) if _is_memory(w) and x is y is z is LANES else None


def _column_addresses(context: Any, builder: Any, kind: Any, array: Any, n: Any) -> Iterator[Any]:
    """Addresses of a[0, n] to a[7, n]."""
    a = context.make_array(kind)(context, builder, array)
    by_row, by_column = (builder.extract_value(a.strides, axis) for axis in (0, 1))
    start = builder.add(builder.ptrtoint(a.data, n.type), builder.mul(n, by_column))
    for lane in range(WIDTH):
        yield builder.inttoptr(builder.add(start, builder.mul(by_row, ir.Constant(n.type, lane))), a.data.type)


def _is_table(kind: Any) -> bool:
    return isinstance(kind, types.Array) and kind.ndim == 2 and kind.dtype == types.float64


@intrinsic
def column(typing: Any, a: Any, n: Any) -> Any:
    """Column n of an array (8, m)."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        out = ir.Constant(DOUBLES, ir.Undefined)
        for lane, address in enumerate(_column_addresses(context, builder, signature.args[0], *values)):
            out = builder.insert_element(out, builder.load(address), INDEX(lane))
        return out

    return (LANES(a, types.intp), emit) if _is_table(a) else None


@intrinsic
def set_column(typing: Any, a: Any, n: Any, value: Any) -> Any:
    """Write column n of an array (8, m)."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        for lane, address in enumerate(_column_addresses(context, builder, signature.args[0], values[0], values[1])):
            builder.store(builder.extract_element(values[2], INDEX(lane)), address)
        return context.get_dummy_value()

    return (types.none(a, types.intp, value), emit) if _is_table(a) and value is LANES else None


@intrinsic
def lane_sum(typing: Any, value: Any) -> Any:
    """Sum of the eight numbers, first of neighbours, then of the sums."""

    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        terms = [builder.extract_element(values[0], INDEX(lane)) for lane in range(WIDTH)]
        while len(terms) > 1:
            terms = [builder.fadd(a, b) for a, b in zip(terms[::2], terms[1::2], strict=True)]
        return terms[0]

    return (types.float64(value), emit) if value is LANES else None


@kernel(forceinline=True)
def prefetch_rows(w: np.ndarray, first: int, n: int, step: int) -> None:
    """`prefetch_row` for the n rows first, first + step, ..."""
    for k in range(n):
        prefetch_row(w, first + k * step)


@kernel(forceinline=True)
def lane_workspace(rows: int) -> np.ndarray:
    """Workspace of so many rows, uninitialised; it begins at a multiple of 64 bytes, so that the processor reads a row at once."""
    w = np.empty(WIDTH * (rows + 1))
    start = (_LINE - w.ctypes.data % _LINE) % _LINE // 8
    return w[start : start + WIDTH * rows]


def lane_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Zeros of a shape whose last axis is a multiple of eight; they begin at a multiple of 64 bytes, as those of `lane_workspace` do."""
    n = int(np.prod(shape))
    w = np.zeros(n + WIDTH)
    start = (-w.ctypes.data % _LINE) // 8
    return w[start : start + n].reshape(shape)
