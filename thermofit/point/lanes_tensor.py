"""Tensors whose components are lanes: general tensors as tuples, their storage in a workspace, exp of a traceless tensor.

A general tensor is the tuple of its nine components row by row, a symmetric one that of 11, 22, 33, 12, 23, 13 as in `tensor`. All
formulas serve numbers as well.
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, Mask, all_lanes, larger, spread, where
from thermofit.law.tensor import Symmetric, added, commuting_product, double_contraction, scaled
from thermofit.point.lanes_memory import row, set_row

Tensor = tuple[float, float, float, float, float, float, float, float, float]
MAX_TERMS = 26
_NEGLIGIBLE = 1e-17


@kernel(forceinline=True)
def symmetric_rows(w: np.ndarray, n: int) -> Symmetric:
    """The symmetric tensor in six rows of a workspace, from row n on."""
    return (row(w, n), row(w, n + 1), row(w, n + 2), row(w, n + 3), row(w, n + 4), row(w, n + 5))


@kernel(forceinline=True)
def set_symmetric_rows(w: np.ndarray, n: int, s: Symmetric) -> None:
    """Write a symmetric tensor into six rows of a workspace."""
    for m in range(6):
        set_row(w, n + m, s[m])


@kernel(forceinline=True)
def tensor_rows(w: np.ndarray, n: int) -> Tensor:
    """The general tensor in nine rows of a workspace, from row n on."""
    return (
        row(w, n), row(w, n + 1), row(w, n + 2),
        row(w, n + 3), row(w, n + 4), row(w, n + 5),
        row(w, n + 6), row(w, n + 7), row(w, n + 8),
    )  # fmt: skip


@kernel(forceinline=True)
def set_tensor_rows(w: np.ndarray, n: int, a: Tensor) -> None:
    """Write a general tensor into nine rows of a workspace."""
    for m in range(9):
        set_row(w, n + m, a[m])


@kernel(forceinline=True)
def determinant_and_cofactor(a: Tensor) -> tuple[Lanes, Tensor]:
    """det a and cof a = det(a) a^-T."""
    c = (
        a[4] * a[8] - a[5] * a[7], a[5] * a[6] - a[3] * a[8], a[3] * a[7] - a[4] * a[6],
        a[2] * a[7] - a[1] * a[8], a[0] * a[8] - a[2] * a[6], a[1] * a[6] - a[0] * a[7],
        a[1] * a[5] - a[2] * a[4], a[2] * a[3] - a[0] * a[5], a[0] * a[4] - a[1] * a[3],
    )  # fmt: skip
    return a[0] * c[0] + a[1] * c[1] + a[2] * c[2], c


@kernel(forceinline=True)
def tensor_scaled(a: Tensor, factor: Lanes) -> Tensor:
    """factor a."""
    return (
        factor * a[0], factor * a[1], factor * a[2],
        factor * a[3], factor * a[4], factor * a[5],
        factor * a[6], factor * a[7], factor * a[8],
    )  # fmt: skip


@kernel(forceinline=True)
def product(a: Tensor, b: Tensor) -> Tensor:
    """a . b."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6], a[0] * b[1] + a[1] * b[4] + a[2] * b[7], a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6], a[3] * b[1] + a[4] * b[4] + a[5] * b[7], a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6], a[6] * b[1] + a[7] * b[4] + a[8] * b[7], a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )  # fmt: skip


@kernel(forceinline=True)
def transposed(a: Tensor) -> Tensor:
    """a^T."""
    return (a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8])


@kernel(forceinline=True)
def full(s: Symmetric) -> Tensor:
    """All nine components of a symmetric tensor."""
    return (s[0], s[3], s[5], s[3], s[1], s[4], s[5], s[4], s[2])


@kernel(forceinline=True)
def outer_gram(a: Tensor) -> Symmetric:
    """a . a^T."""
    return (
        a[0] * a[0] + a[1] * a[1] + a[2] * a[2],
        a[3] * a[3] + a[4] * a[4] + a[5] * a[5],
        a[6] * a[6] + a[7] * a[7] + a[8] * a[8],
        a[0] * a[3] + a[1] * a[4] + a[2] * a[5],
        a[3] * a[6] + a[4] * a[7] + a[5] * a[8],
        a[0] * a[6] + a[1] * a[7] + a[2] * a[8],
    )


@kernel(forceinline=True)
def inner_gram(a: Tensor) -> Symmetric:
    """a^T . a."""
    return outer_gram(transposed(a))


@kernel(forceinline=True)
def symmetric_sum(a: Tensor, b: Tensor) -> Symmetric:
    """a . b^T + b . a^T."""
    return (
        2.0 * (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]),
        2.0 * (a[3] * b[3] + a[4] * b[4] + a[5] * b[5]),
        2.0 * (a[6] * b[6] + a[7] * b[7] + a[8] * b[8]),
        a[0] * b[3] + a[1] * b[4] + a[2] * b[5] + b[0] * a[3] + b[1] * a[4] + b[2] * a[5],
        a[3] * b[6] + a[4] * b[7] + a[5] * b[8] + b[3] * a[6] + b[4] * a[7] + b[5] * a[8],
        a[0] * b[6] + a[1] * b[7] + a[2] * b[8] + b[0] * a[6] + b[1] * a[7] + b[2] * a[8],
    )


@kernel(forceinline=True)
def chosen(mask: Mask, a: Symmetric, b: Symmetric) -> Symmetric:
    """a where the mask holds, else b."""
    return (
        where(mask, a[0], b[0]),
        where(mask, a[1], b[1]),
        where(mask, a[2], b[2]),
        where(mask, a[3], b[3]),
        where(mask, a[4], b[4]),
        where(mask, a[5], b[5]),
    )


@kernel(forceinline=True)
def largest_component(a: Symmetric) -> Lanes:
    """Largest absolute component."""
    normal = larger(larger(abs(a[0]), abs(a[1])), abs(a[2]))
    return larger(normal, larger(larger(abs(a[3]), abs(a[4])), abs(a[5])))


@kernel(forceinline=True)
def invariants(x: Symmetric, x2: Symmetric) -> tuple[Lanes, Lanes]:
    """J2 = x : x / 2 and J3 = det x of a traceless x; x2 = x . x. Its characteristic equation is x^3 = J2 x + J3 1."""
    return 0.5 * (x2[0] + x2[1] + x2[2]), double_contraction(x, x2) / 3.0


@kernel(forceinline=True)
def series_length(j2: Lanes) -> int:
    """Terms of the power series of exp(x) that reach full precision in all lanes, traceless x; 0 where more than MAX_TERMS.

    No eigenvalue of x exceeds sqrt(4 J2 / 3).
    """
    radius = math.sqrt(j2 * (4.0 / 3.0))
    term = radius
    for order in range(2, MAX_TERMS):
        term = term * radius * (1.0 / order)
        if all_lanes(term < _NEGLIGIBLE):
            return order
    return 0


@kernel(forceinline=True)
def exponential_coefficients(j2: Lanes, j3: Lanes, terms: int) -> tuple[Lanes, Lanes, Lanes]:
    """a, b, c of exp x = a 1 + b x + c x^2 for traceless x, by Horner's scheme 1 + x (1 + x/2 (1 + x/3 (...)))."""
    a, b, c = spread(1.0), spread(0.0), spread(0.0)
    for order in range(terms, 0, -1):
        r = 1.0 / order
        a, b, c = 1.0 + r * (c * j3), r * (a + c * j2), r * b
    return a, b, c


@kernel(forceinline=True)
def combined(a: Lanes, b: Lanes, c: Lanes, x: Symmetric, x2: Symmetric) -> Symmetric:
    """a 1 + b x + c x^2."""
    return (
        a + (b * x[0] + c * x2[0]),
        a + (b * x[1] + c * x2[1]),
        a + (b * x[2] + c * x2[2]),
        b * x[3] + c * x2[3],
        b * x[4] + c * x2[4],
        b * x[5] + c * x2[5],
    )


@kernel(forceinline=True)
def exponential_of_traceless(x: Symmetric) -> tuple[Symmetric, int]:
    """exp(x) of a traceless x and the number of terms; 0 terms where the series did not converge."""
    x2 = commuting_product(x, x)
    j2, j3 = invariants(x, x2)
    terms = series_length(j2)
    a, b, c = exponential_coefficients(j2, j3, terms)
    return combined(a, b, c, x, x2), terms


@kernel(forceinline=True)
def _coefficient_slopes(j2: Lanes, j3: Lanes, terms: int) -> tuple[Lanes, Lanes, tuple[Lanes, Lanes, Lanes], tuple[Lanes, Lanes, Lanes]]:
    """b, c and the derivatives of (a, b, c) by J2 and by J3, all by the scheme of `exponential_coefficients`."""
    one, zero = spread(1.0), spread(0.0)
    a, b, c = one, zero, zero
    a2, b2, c2 = zero, zero, zero
    a3, b3, c3 = zero, zero, zero
    for order in range(terms, 0, -1):
        r = 1.0 / order
        a2, b2, c2 = r * (c2 * j3), r * (a2 + c2 * j2 + c), r * b2
        a3, b3, c3 = r * (c3 * j3 + c), r * (a3 + c3 * j2), r * b3
        a, b, c = 1.0 + r * (c * j3), r * (a + c * j2), r * b
    return b, c, (a2, b2, c2), (a3, b3, c3)


@kernel(forceinline=True)
def _plus_two(s: Symmetric, by_u: Lanes, u: Symmetric, by_v: Lanes, v: Symmetric) -> Symmetric:
    """s + by_u u + by_v v."""
    return added(added(s, u, by_u), v, by_v)


@kernel(forceinline=True)
def exponential_slopes(x: Symmetric, terms: int) -> tuple[Symmetric, Symmetric, Symmetric, Symmetric, Symmetric]:
    """Derivatives of exp x, x traceless, by its components 11, 22 (33 = -11 - 22), 12, 23, 13.

    d exp(x)[e] = b e + c (x e + e x) + (x : e) u + (x^2 : e) v, where u and v are the derivatives of a 1 + b x + c x^2 by J2 and J3 at
    fixed x: dJ2 = x : e and dJ3 = x^2 : e for a traceless e.
    """
    x2 = commuting_product(x, x)
    j2, j3 = invariants(x, x2)
    b, c, by_j2, by_j3 = _coefficient_slopes(j2, j3, terms)
    u = combined(by_j2[0], by_j2[1], by_j2[2], x, x2)
    v = combined(by_j3[0], by_j3[1], by_j3[2], x, x2)
    o = spread(0.0)
    y = scaled(x, c)
    e11 = (b + 2.0 * y[0], o, -b - 2.0 * y[2], y[3], -y[4], o)
    e22 = (o, b + 2.0 * y[1], -b - 2.0 * y[2], y[3], o, -y[5])
    e12 = (2.0 * y[3], 2.0 * y[3], o, b + y[0] + y[1], y[5], y[4])
    e23 = (o, 2.0 * y[4], 2.0 * y[4], y[5], b + y[1] + y[2], y[3])
    e13 = (2.0 * y[5], o, 2.0 * y[5], y[4], y[3], b + y[0] + y[2])
    return (
        _plus_two(e11, x[0] - x[2], u, x2[0] - x2[2], v),
        _plus_two(e22, x[1] - x[2], u, x2[1] - x2[2], v),
        _plus_two(e12, 2.0 * x[3], u, 2.0 * x2[3], v),
        _plus_two(e23, 2.0 * x[4], u, 2.0 * x2[4], v),
        _plus_two(e13, 2.0 * x[5], u, 2.0 * x2[5], v),
    )
