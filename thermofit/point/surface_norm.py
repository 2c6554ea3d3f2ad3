"""Half the square of the equivalent stress phi of a transformed surface, and its derivatives, at many tensors: what backstresses store.

The energy of a backstress X = C Y is C phi(Y)^2 / 2, with a quadratic surface C Y : G : Y / 2 (law.backstress). Tensors (n, 8, 6) are those
of the points of elements, components 11, 22, 33, 12, 23, 13.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes
from thermofit.law.page import Law
from thermofit.law.tensor import Symmetric, added, double_contraction, scaled
from thermofit.law.transformed import flow_and_curvature, flow_of, number_slopes
from thermofit.point.lanes_memory import column, set_column


@kernel(forceinline=True)
def _columns(a: np.ndarray) -> Symmetric:
    return (column(a, 0), column(a, 1), column(a, 2), column(a, 3), column(a, 4), column(a, 5))


@kernel(forceinline=True)
def _set_columns(a: np.ndarray, s: Symmetric) -> None:
    for k in range(6):
        set_column(a, k, s[k])


def in_surface(y: np.ndarray, law: Law) -> np.ndarray:
    """phi^2 (n, 8) of y (n, 8, 6)."""
    out = np.empty((*y.shape[:2], 1))
    _squares(y, law, out)
    return out[:, :, 0]


@kernel
def _squares(y: np.ndarray, law: Law, out: np.ndarray) -> None:
    for e in range(y.shape[0]):
        norm: Lanes = flow_of(_columns(y[e]), law)[1]
        set_column(out[e], 0, norm * norm)


def surface_gradients(y: np.ndarray, law: Law) -> np.ndarray:
    """phi N, the derivative of phi^2 / 2 by y (n, 8, 6)."""
    out = np.empty_like(y)
    _gradients(y, law, out)
    return out


@kernel
def _gradients(y: np.ndarray, law: Law, out: np.ndarray) -> None:
    for e in range(y.shape[0]):
        flow, norm = flow_of(_columns(y[e]), law)
        _set_columns(out[e], scaled(flow, norm))


def surface_curved(y: np.ndarray, along: np.ndarray, law: Law) -> np.ndarray:
    """(N N + phi d2phi/dy2) : along, the derivative of phi N at y along a tensor, each (n, 8, 6); zero where y is."""
    out = np.empty_like(y)
    _curved(y, along, law, out)
    return out


@kernel
def _curved(y: np.ndarray, along: np.ndarray, law: Law, out: np.ndarray) -> None:
    for e in range(y.shape[0]):
        b = _columns(along[e])
        flow, _, c = flow_and_curvature(_columns(y[e]), law)
        p = (b[0] + b[1] + b[2]) * (1.0 / 3.0)
        bent = added(scaled(c[0], b[0] - p), c[1], b[1] - p)
        bent = added(added(added(bent, c[2], b[3]), c[3], b[4]), c[4], b[5])
        _set_columns(out[e], added(bent, flow, double_contraction(flow, b)))


def surface_number_slopes(y: np.ndarray, which: int, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of phi^2 / 2 (n, 8) and of phi N (n, 8, 6) at y (n, 8, 6) by a number of the surface, by its place."""
    values, normals = np.empty((*y.shape[:2], 1)), np.empty_like(y)
    _number_slopes(y, which, law, values, normals)
    return values[:, :, 0], normals


@kernel
def _number_slopes(y: np.ndarray, which: int, law: Law, values: np.ndarray, normals: np.ndarray) -> None:
    for e in range(y.shape[0]):
        s = _columns(y[e])
        flow, norm = flow_of(s, law)
        bent, slope = number_slopes(s, which, law)
        set_column(values[e], 0, norm * slope)
        _set_columns(normals[e], added(bent, flow, slope))
