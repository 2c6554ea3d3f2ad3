"""Second-order tensors in three dimensions: products and inverse.

A general tensor is a (3, 3) array. A symmetric tensor is a tuple of its six components 11, 22, 33, 12, 23, 13, which the
compiler keeps in registers. A linear map between symmetric tensors is a (6, 6) array over these components; an off-diagonal
component stands for both of its entries.
"""

from __future__ import annotations

import numpy as np

import thermofit.core.lanes  # noqa: F401, see law.composition
from thermofit.core.jit import kernel

Symmetric = tuple[float, float, float, float, float, float]

ROW = np.array([0, 1, 2, 0, 1, 0])
"""First index of the six components of a symmetric tensor."""
COLUMN = np.array([0, 1, 2, 1, 2, 2])
"""Second index of the six components of a symmetric tensor."""


@kernel(forceinline=True)
def determinant(a: np.ndarray) -> float:
    """det(a) of a (3, 3) tensor."""
    return (
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


@kernel(forceinline=True)
def inverse_transpose(a: np.ndarray, det: float, out: np.ndarray) -> None:
    """out = a^-T = cof(a) / det(a)."""
    r = 1.0 / det
    out[0, 0] = (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]) * r
    out[0, 1] = (a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]) * r
    out[0, 2] = (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]) * r
    out[1, 0] = (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) * r
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) * r
    out[1, 2] = (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) * r
    out[2, 0] = (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]) * r
    out[2, 1] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) * r
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) * r


@kernel(forceinline=True)
def congruence(y: Symmetric, c: Symmetric) -> Symmetric:
    """y . c . y of two symmetric tensors."""
    t00 = c[0] * y[0] + c[3] * y[3] + c[5] * y[5]
    t01 = c[0] * y[3] + c[3] * y[1] + c[5] * y[4]
    t02 = c[0] * y[5] + c[3] * y[4] + c[5] * y[2]
    t10 = c[3] * y[0] + c[1] * y[3] + c[4] * y[5]
    t11 = c[3] * y[3] + c[1] * y[1] + c[4] * y[4]
    t12 = c[3] * y[5] + c[1] * y[4] + c[4] * y[2]
    t20 = c[5] * y[0] + c[4] * y[3] + c[2] * y[5]
    t21 = c[5] * y[3] + c[4] * y[1] + c[2] * y[4]
    t22 = c[5] * y[5] + c[4] * y[4] + c[2] * y[2]
    return (
        y[0] * t00 + y[3] * t10 + y[5] * t20,
        y[3] * t01 + y[1] * t11 + y[4] * t21,
        y[5] * t02 + y[4] * t12 + y[2] * t22,
        y[0] * t01 + y[3] * t11 + y[5] * t21,
        y[3] * t02 + y[1] * t12 + y[4] * t22,
        y[0] * t02 + y[3] * t12 + y[5] * t22,
    )


@kernel(forceinline=True)
def commuting_product(a: Symmetric, b: Symmetric) -> Symmetric:
    """a . b of two symmetric tensors that commute, so that the product is symmetric."""
    return (
        a[0] * b[0] + a[3] * b[3] + a[5] * b[5],
        a[3] * b[3] + a[1] * b[1] + a[4] * b[4],
        a[5] * b[5] + a[4] * b[4] + a[2] * b[2],
        a[0] * b[3] + a[3] * b[1] + a[5] * b[4],
        a[3] * b[5] + a[1] * b[4] + a[4] * b[2],
        a[0] * b[5] + a[3] * b[4] + a[5] * b[2],
    )


@kernel(forceinline=True)
def double_contraction(a: Symmetric, b: Symmetric) -> float:
    """a : b of two symmetric tensors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + 2.0 * (a[3] * b[3] + a[4] * b[4] + a[5] * b[5])


@kernel(forceinline=True)
def added(a: Symmetric, b: Symmetric, factor: float) -> Symmetric:
    """a + factor b."""
    return (
        a[0] + factor * b[0],
        a[1] + factor * b[1],
        a[2] + factor * b[2],
        a[3] + factor * b[3],
        a[4] + factor * b[4],
        a[5] + factor * b[5],
    )


@kernel(forceinline=True)
def scaled(a: Symmetric, factor: float) -> Symmetric:
    """factor a."""
    return (factor * a[0], factor * a[1], factor * a[2], factor * a[3], factor * a[4], factor * a[5])


@kernel(forceinline=True)
def deviator(t: Symmetric) -> Symmetric:
    """dev t."""
    p = (t[0] + t[1] + t[2]) * (1.0 / 3.0)
    return (t[0] - p, t[1] - p, t[2] - p, t[3], t[4], t[5])
