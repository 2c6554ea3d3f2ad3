"""Yield surfaces by two linear transformations of the stress deviator (law.surface), with first and second derivatives in lanes.

    phi^a = 1/4 sum_ij |x_i - y_j|^a,      x_i, y_j the principal values of s' = C' dev S and s'' = C'' dev S        (Barlat et al. 2005)

With d_ij = x_i - y_j, h(d) = |d|^(a-2) d and the principal axes v_i of s' and w_j of s'',

    X_i = dphi/dx_i = phi^(1-a)/4 sum_j h(d_ij),    Y_j = dphi/dy_j = -phi^(1-a)/4 sum_i h(d_ij),
    N = dphi/dS = dev [C'^T sum X_i v_i v_i + C''^T sum Y_j w_j w_j].

The second derivative of an isotropic function of a symmetric tensor along b, in its principal axes, is that by the principal values on the
diagonal, and (X_k - X_l) / (x_k - x_l) b_kl off it. For equal values the quotient is its limit; for close ones each of its terms,
(h(d_kj) - h(d_lj)) / (d_kj - d_lj), is the binomial series of h about d_kj, so that no digits are lost. Principal axes are those of
Jacobi's rotations, which are orthonormal to round-off however close the values are. d is scaled by its largest.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, any_lane, larger, spread, where
from thermofit.law.tensor import Symmetric, added, deviator, double_contraction, scaled

Nine = tuple[float, float, float, float, float, float, float, float, float]
Three = tuple[float, float, float]
Curvature = tuple[Symmetric, Symmetric, Symmetric, Symmetric, Symmetric]
_SWEEPS = 12
_NEGLIGIBLE = 1e-36
"""Square of the size of off-diagonal components, beside that of the tensor, at which rotations end."""
_TINY = 1e-300
_CLOSE = 2e-3
"""Distance of two d, over one of them, below which a divided difference is a series."""


@kernel(forceinline=True)
def _first(law: Any) -> Nine:
    return (
        law.surface_1_c12, law.surface_1_c13, law.surface_1_c21, law.surface_1_c23, law.surface_1_c31, law.surface_1_c32,
        law.surface_1_c44, law.surface_1_c55, law.surface_1_c66,
    )  # fmt: skip


@kernel(forceinline=True)
def _second(law: Any) -> Nine:
    return (
        law.surface_2_c12, law.surface_2_c13, law.surface_2_c21, law.surface_2_c23, law.surface_2_c31, law.surface_2_c32,
        law.surface_2_c44, law.surface_2_c55, law.surface_2_c66,
    )  # fmt: skip


@kernel(forceinline=True)
def _transformed(s: Symmetric, c: Nine) -> Symmetric:
    """C s of a deviator s, c in the order of `surface.catalogue.COEFFICIENTS`."""
    return (
        -c[0] * s[1] - c[1] * s[2],
        -c[2] * s[0] - c[3] * s[2],
        -c[4] * s[0] - c[5] * s[1],
        c[8] * s[3],
        c[6] * s[4],
        c[7] * s[5],
    )


@kernel(forceinline=True)
def _transposed(g: Symmetric, c: Nine) -> Symmetric:
    """C^T g."""
    return (
        -c[2] * g[1] - c[4] * g[2],
        -c[0] * g[0] - c[5] * g[2],
        -c[1] * g[0] - c[3] * g[1],
        c[8] * g[3],
        c[6] * g[4],
        c[7] * g[5],
    )


@kernel(forceinline=True)
def _rotation(pp: Lanes, qq: Lanes, pq: Lanes) -> Three:
    """t, c and s of the rotation that makes pq vanish."""
    apart = qq - pp
    size = abs(apart) + np.sqrt(apart * apart + 4.0 * pq * pq)
    turned = size > 0.0
    t = where(turned, where(apart < 0.0, -2.0, 2.0) * pq / where(turned, size, 1.0), 0.0)
    c = 1.0 / np.sqrt(1.0 + t * t)
    return t, c, t * c


@kernel
def principal(s: Symmetric) -> tuple[Three, Nine]:
    """Principal values of a symmetric tensor and its axes as the columns of (3, 3), row by row; by Jacobi's rotations."""
    o, one = spread(0.0), spread(1.0)
    a, b, c, d, e, f = s[0], s[1], s[2], s[3], s[4], s[5]
    v0, v1, v2, v3, v4, v5, v6, v7, v8 = one, o, o, o, one, o, o, o, one
    bound = _NEGLIGIBLE * (a * a + b * b + c * c + d * d + e * e + f * f)
    for _ in range(_SWEEPS):
        if not any_lane(d * d + e * e + f * f > bound):
            break
        t, k, z = _rotation(a, b, d)
        a, b, d = a - t * d, b + t * d, o
        f, e = k * f - z * e, z * f + k * e
        v0, v1, v3, v4, v6, v7 = k * v0 - z * v1, z * v0 + k * v1, k * v3 - z * v4, z * v3 + k * v4, k * v6 - z * v7, z * v6 + k * v7
        t, k, z = _rotation(b, c, e)
        b, c, e = b - t * e, c + t * e, o
        d, f = k * d - z * f, z * d + k * f
        v1, v2, v4, v5, v7, v8 = k * v1 - z * v2, z * v1 + k * v2, k * v4 - z * v5, z * v4 + k * v5, k * v7 - z * v8, z * v7 + k * v8
        t, k, z = _rotation(a, c, f)
        a, c, f = a - t * f, c + t * f, o
        d, e = k * d - z * e, z * d + k * e
        v0, v2, v3, v5, v6, v8 = k * v0 - z * v2, z * v0 + k * v2, k * v3 - z * v5, z * v3 + k * v5, k * v6 - z * v8, z * v6 + k * v8
    return (a, b, c), (v0, v1, v2, v3, v4, v5, v6, v7, v8)


@kernel(forceinline=True)
def _in_axes(s: Symmetric, v: Nine) -> Symmetric:
    """v^T s v."""
    a0, a1, a2 = s[0] * v[0] + s[3] * v[3] + s[5] * v[6], s[0] * v[1] + s[3] * v[4] + s[5] * v[7], s[0] * v[2] + s[3] * v[5] + s[5] * v[8]
    b0, b1, b2 = s[3] * v[0] + s[1] * v[3] + s[4] * v[6], s[3] * v[1] + s[1] * v[4] + s[4] * v[7], s[3] * v[2] + s[1] * v[5] + s[4] * v[8]
    c0, c1, c2 = s[5] * v[0] + s[4] * v[3] + s[2] * v[6], s[5] * v[1] + s[4] * v[4] + s[2] * v[7], s[5] * v[2] + s[4] * v[5] + s[2] * v[8]
    return (
        v[0] * a0 + v[3] * b0 + v[6] * c0,
        v[1] * a1 + v[4] * b1 + v[7] * c1,
        v[2] * a2 + v[5] * b2 + v[8] * c2,
        v[0] * a1 + v[3] * b1 + v[6] * c1,
        v[1] * a2 + v[4] * b2 + v[7] * c2,
        v[0] * a2 + v[3] * b2 + v[6] * c2,
    )


@kernel(forceinline=True)
def _out_of_axes(s: Symmetric, v: Nine) -> Symmetric:
    """v s v^T."""
    return _in_axes(s, (v[0], v[3], v[6], v[1], v[4], v[7], v[2], v[5], v[8]))


@kernel(forceinline=True)
def _logarithm(d: Lanes) -> Lanes:
    return np.log(larger(abs(d), spread(_TINY)))


@kernel
def _state(s: Symmetric, law: Any) -> tuple[Nine, Nine, Nine, Nine, tuple[Lanes, Lanes, Lanes, Lanes]]:
    """Axes of s' and s'', scaled d_ij and |d_ij|^(a-2) row by row, and (scale of d, sum of |d|^a / 4, ln of it, phi / scale)."""
    s = deviator(s)
    x, v = principal(_transformed(s, _first(law)))
    y, w = principal(_transformed(s, _second(law)))
    d0, d1, d2 = x[0] - y[0], x[0] - y[1], x[0] - y[2]
    d3, d4, d5 = x[1] - y[0], x[1] - y[1], x[1] - y[2]
    d6, d7, d8 = x[2] - y[0], x[2] - y[1], x[2] - y[2]
    largest = larger(larger(larger(abs(d0), abs(d1)), larger(abs(d2), abs(d3))), larger(larger(abs(d4), abs(d5)), larger(abs(d6), abs(d7))))
    largest = larger(largest, abs(d8))
    r = 1.0 / where(largest > 0.0, largest, 1.0)
    d0, d1, d2, d3, d4, d5, d6, d7, d8 = r * d0, r * d1, r * d2, r * d3, r * d4, r * d5, r * d6, r * d7, r * d8
    e = law.surface_a - 2.0
    p0, p1, p2 = np.exp(e * _logarithm(d0)), np.exp(e * _logarithm(d1)), np.exp(e * _logarithm(d2))
    p3, p4, p5 = np.exp(e * _logarithm(d3)), np.exp(e * _logarithm(d4)), np.exp(e * _logarithm(d5))
    p6, p7, p8 = np.exp(e * _logarithm(d6)), np.exp(e * _logarithm(d7)), np.exp(e * _logarithm(d8))
    total = 0.25 * (
        p0 * d0 * d0 + p1 * d1 * d1 + p2 * d2 * d2
        + (p3 * d3 * d3 + p4 * d4 * d4 + p5 * d5 * d5)
        + (p6 * d6 * d6 + p7 * d7 * d7 + p8 * d8 * d8)
    )  # fmt: skip
    total = where(largest > 0.0, total, 1.0)
    log_total = np.log(total)
    unit = np.exp(log_total * (1.0 / law.surface_a))
    return v, w, (d0, d1, d2, d3, d4, d5, d6, d7, d8), (p0, p1, p2, p3, p4, p5, p6, p7, p8), (largest, total, log_total, unit)


@kernel(forceinline=True)
def _slopes(h: Nine, factor: Lanes) -> tuple[Three, Three]:
    """factor times the sums of h_ij over j, and minus those over i: X_i and Y_j."""
    x = (factor * (h[0] + h[1] + h[2]), factor * (h[3] + h[4] + h[5]), factor * (h[6] + h[7] + h[8]))
    return x, (-factor * (h[0] + h[3] + h[6]), -factor * (h[1] + h[4] + h[7]), -factor * (h[2] + h[5] + h[8]))


@kernel(forceinline=True)
def _product(p: Nine, d: Nine) -> Nine:
    return (
        p[0] * d[0], p[1] * d[1], p[2] * d[2], p[3] * d[3], p[4] * d[4], p[5] * d[5], p[6] * d[6], p[7] * d[7], p[8] * d[8],
    )  # fmt: skip


@kernel(forceinline=True)
def _composed(x: Three, v: Nine) -> Symmetric:
    """sum x_i v_i v_i."""
    o = spread(0.0)
    return _out_of_axes((x[0], x[1], x[2], o, o, o), v)


@kernel(forceinline=True)
def _gathered(first: Symmetric, second: Symmetric, law: Any) -> Symmetric:
    """dev [C'^T first + C''^T second]."""
    return deviator(added(_transposed(first, _first(law)), _transposed(second, _second(law)), 1.0))


@kernel(forceinline=True)
def _divided(d: Lanes, other: Lanes, p: Lanes, p_other: Lanes, n: Lanes) -> Lanes:
    """(h(d) - h(other)) / (d - other), h(d) = p d = |d|^(n-1) d; by its series about d where both are close."""
    gap = d - other
    close, equal = abs(gap) < _CLOSE * abs(d), abs(gap) <= 0.0
    r = where(close, gap / where(abs(d) > 0.0, d, 1.0), 0.0)
    deep = 1.0 - (n - 4.0) * 0.2 * r * (1.0 - (n - 5.0) * (1.0 / 6.0) * r)
    series = n * p * (1.0 - (n - 1.0) * 0.5 * r * (1.0 - (n - 2.0) * (1.0 / 3.0) * r * (1.0 - (n - 3.0) * 0.25 * r * deep)))
    return where(close, series, where(equal, n * p, (p * d - p_other * other) / where(equal, 1.0, gap)))


@kernel(forceinline=True)
def _quotients(d: Nine, p: Nine, n: Lanes, rows: bool) -> Three:
    """Sums over the other index of the divided differences of h between rows (or columns) 0 and 1, 1 and 2, 0 and 2 of d."""
    if rows:
        return (
            _divided(d[0], d[3], p[0], p[3], n) + _divided(d[1], d[4], p[1], p[4], n) + _divided(d[2], d[5], p[2], p[5], n),
            _divided(d[3], d[6], p[3], p[6], n) + _divided(d[4], d[7], p[4], p[7], n) + _divided(d[5], d[8], p[5], p[8], n),
            _divided(d[0], d[6], p[0], p[6], n) + _divided(d[1], d[7], p[1], p[7], n) + _divided(d[2], d[8], p[2], p[8], n),
        )
    return (
        _divided(d[0], d[1], p[0], p[1], n) + _divided(d[3], d[4], p[3], p[4], n) + _divided(d[6], d[7], p[6], p[7], n),
        _divided(d[1], d[2], p[1], p[2], n) + _divided(d[4], d[5], p[4], p[5], n) + _divided(d[7], d[8], p[7], p[8], n),
        _divided(d[0], d[2], p[0], p[2], n) + _divided(d[3], d[5], p[3], p[5], n) + _divided(d[6], d[8], p[6], p[8], n),
    )


@kernel
def _bent(
    first: Symmetric,
    second: Symmetric,
    axes: tuple[Nine, Nine],
    p: Nine,
    quotients: tuple[Three, Three],
    slopes: tuple[Three, Three],
    factor: Lanes,
    law: Any,
) -> Symmetric:
    """phi times the change of N along changes of s' and s'', without that of C' and C'' themselves; factor = (phi / scale)^(2-a) / 4."""
    (v, w), (x, y), n = axes, slopes, law.surface_a - 1.0
    b, c = _in_axes(first, v), _in_axes(second, w)
    along = x[0] * b[0] + x[1] * b[1] + x[2] * b[2] + y[0] * c[0] + y[1] * c[1] + y[2] * c[2]
    b0 = n * (factor * ((p[0] + p[1] + p[2]) * b[0] - p[0] * c[0] - p[1] * c[1] - p[2] * c[2]) - x[0] * along)
    b1 = n * (factor * ((p[3] + p[4] + p[5]) * b[1] - p[3] * c[0] - p[4] * c[1] - p[5] * c[2]) - x[1] * along)
    b2 = n * (factor * ((p[6] + p[7] + p[8]) * b[2] - p[6] * c[0] - p[7] * c[1] - p[8] * c[2]) - x[2] * along)
    c0 = n * (factor * ((p[0] + p[3] + p[6]) * c[0] - p[0] * b[0] - p[3] * b[1] - p[6] * b[2]) - y[0] * along)
    c1 = n * (factor * ((p[1] + p[4] + p[7]) * c[1] - p[1] * b[0] - p[4] * b[1] - p[7] * b[2]) - y[1] * along)
    c2 = n * (factor * ((p[2] + p[5] + p[8]) * c[2] - p[2] * b[0] - p[5] * b[1] - p[8] * b[2]) - y[2] * along)
    q, r = quotients
    of_first = _out_of_axes((b0, b1, b2, factor * q[0] * b[3], factor * q[1] * b[4], factor * q[2] * b[5]), v)
    of_second = _out_of_axes((c0, c1, c2, factor * r[0] * c[3], factor * r[1] * c[4], factor * r[2] * c[5]), w)
    return _gathered(of_first, of_second, law)


@kernel
def _bent_along(
    b: Symmetric,
    axes: tuple[Nine, Nine],
    p: Nine,
    quotients: tuple[Three, Three],
    slopes: tuple[Three, Three],
    factor: Lanes,
    law: Any,
) -> Symmetric:
    """phi d2phi/dS2 : b of a traceless b."""
    return _bent(_transformed(b, _first(law)), _transformed(b, _second(law)), axes, p, quotients, slopes, factor, law)


@kernel
def flow_of(s: Symmetric, law: Any) -> tuple[Symmetric, Lanes]:
    """N and phi at a stress; zero where there is no stress."""
    v, w, d, p, (largest, _, log_total, unit) = _state(s, law)
    x, y = _slopes(_product(p, d), 0.25 * np.exp((1.0 / law.surface_a - 1.0) * log_total))
    return _gathered(_composed(x, v), _composed(y, w), law), largest * unit


@kernel
def flow_and_curvature(s: Symmetric, law: Any) -> tuple[Symmetric, Lanes, Curvature]:
    """N and phi at a stress, and phi d2phi/dS2 along a unit of each of the components 11, 22 (33 = -11 - 22), 12, 23, 13."""
    v, w, d, p, (largest, _, log_total, unit) = _state(s, law)
    inverse, n = np.exp((1.0 / law.surface_a - 1.0) * log_total), law.surface_a - 1.0
    factor, slopes = 0.25 * inverse * unit, _slopes(_product(p, d), 0.25 * inverse)
    axes, quotients = (v, w), (_quotients(d, p, n, True), _quotients(d, p, n, False))
    o, one = spread(0.0), spread(1.0)
    curvature = (
        _bent_along((one, o, -one, o, o, o), axes, p, quotients, slopes, factor, law),
        _bent_along((o, one, -one, o, o, o), axes, p, quotients, slopes, factor, law),
        _bent_along((o, o, o, one, o, o), axes, p, quotients, slopes, factor, law),
        _bent_along((o, o, o, o, one, o), axes, p, quotients, slopes, factor, law),
        _bent_along((o, o, o, o, o, one), axes, p, quotients, slopes, factor, law),
    )
    return _gathered(_composed(slopes[0], v), _composed(slopes[1], w), law), largest * unit, curvature


@kernel
def number_slopes(s: Symmetric, which: int, law: Any) -> tuple[Symmetric, Lanes]:
    """phi dN/dz and dphi/dz at a given stress, z one of `surface.catalogue.NUMBERS` by its place there."""
    v, u, d, p, (largest, total, log_total, unit) = _state(s, law)
    a, n = law.surface_a, law.surface_a - 1.0
    inverse, phi = np.exp((1.0 / a - 1.0) * log_total), largest * unit
    h = _product(p, d)
    x, y = _slopes(h, 0.25 * inverse)
    if which == 0:
        logs = (
            _logarithm(d[0]), _logarithm(d[1]), _logarithm(d[2]), _logarithm(d[3]), _logarithm(d[4]), _logarithm(d[5]),
            _logarithm(d[6]), _logarithm(d[7]), _logarithm(d[8]),
        )  # fmt: skip
        k = _product(h, logs)
        g = _product(k, d)
        grown = 0.25 * (g[0] + g[1] + g[2] + g[3] + g[4] + g[5] + g[6] + g[7] + g[8])
        slope = grown / (a * total) - log_total * (1.0 / (a * a))  # d ln phi / da
        share = -log_total * (1.0 / a) - n * slope
        by_x, by_y = _slopes(k, 0.25 * inverse)
        x_rate = (by_x[0] + share * x[0], by_x[1] + share * x[1], by_x[2] + share * x[2])
        y_rate = (by_y[0] + share * y[0], by_y[1] + share * y[1], by_y[2] + share * y[2])
        return scaled(_gathered(_composed(x_rate, v), _composed(y_rate, u), law), phi), phi * slope
    place, o = (which - 1) % 9, spread(0.0)
    one = (
        1.0 if place == 0 else 0.0, 1.0 if place == 1 else 0.0, 1.0 if place == 2 else 0.0, 1.0 if place == 3 else 0.0,
        1.0 if place == 4 else 0.0, 1.0 if place == 5 else 0.0, 1.0 if place == 6 else 0.0, 1.0 if place == 7 else 0.0,
        1.0 if place == 8 else 0.0,
    )  # fmt: skip
    moved, none = _transformed(deviator(s), one), (o, o, o, o, o, o)
    first, second, gradient = none, moved, _composed(y, u)
    if which <= 9:
        first, second, gradient = moved, none, _composed(x, v)
    quotients = (_quotients(d, p, n, True), _quotients(d, p, n, False))
    bent = _bent(first, second, (v, u), p, quotients, (x, y), 0.25 * inverse * unit, law)
    return added(bent, deviator(_transposed(gradient, one)), phi), double_contraction(gradient, moved)


Complex = Any
"""A complex number where a formula, written for real ones, says float."""


@kernel(forceinline=True)
def _h(d: Complex, a: Complex) -> Complex:
    """|d|^(a-2) d of a real d, and its continuation to complex ones beside the real axis."""
    if d == 0.0:
        return 0.0 * d
    return d * np.exp((0.5 * a - 1.0) * np.log(d * d))


@kernel
def axial_gradient(a11: Complex, a22: Complex, a33: Complex, law: Any) -> tuple[Complex, Complex, Complex]:
    """phi dphi/dS of a stress without shear, its normal components, of numbers, real or complex: as `page.hill_gradient` is of Hill's."""
    mean = (a11 + a22 + a33) / 3.0
    s0, s1, s2, a = a11 - mean, a22 - mean, a33 - mean, law.surface_a
    c, e = _first(law), _second(law)
    x0, x1, x2 = -c[0] * s1 - c[1] * s2, -c[2] * s0 - c[3] * s2, -c[4] * s0 - c[5] * s1
    y0, y1, y2 = -e[0] * s1 - e[1] * s2, -e[2] * s0 - e[3] * s2, -e[4] * s0 - e[5] * s1
    largest = max(abs((x0 - y0).real), abs((x0 - y1).real), abs((x0 - y2).real), abs((x1 - y0).real), abs((x1 - y1).real))
    largest = max(largest, abs((x1 - y2).real), abs((x2 - y0).real), abs((x2 - y1).real), abs((x2 - y2).real))
    if largest == 0.0:
        zero = 0.0 * (x0 + y0) * a
        return zero, zero, zero
    x0, x1, x2, y0, y1, y2 = x0 / largest, x1 / largest, x2 / largest, y0 / largest, y1 / largest, y2 / largest
    h00, h01, h02 = _h(x0 - y0, a), _h(x0 - y1, a), _h(x0 - y2, a)
    h10, h11, h12 = _h(x1 - y0, a), _h(x1 - y1, a), _h(x1 - y2, a)
    h20, h21, h22 = _h(x2 - y0, a), _h(x2 - y1, a), _h(x2 - y2, a)
    total = h00 * (x0 - y0) + h01 * (x0 - y1) + h02 * (x0 - y2) + h10 * (x1 - y0) + h11 * (x1 - y1) + h12 * (x1 - y2)
    total = 0.25 * (total + h20 * (x2 - y0) + h21 * (x2 - y1) + h22 * (x2 - y2))
    # phi phi^(1-a) / 4 in units of the largest d.
    factor = 0.25 * largest * np.exp((2.0 / a - 1.0) * np.log(total))
    g0, g1, g2 = factor * (h00 + h01 + h02), factor * (h10 + h11 + h12), factor * (h20 + h21 + h22)
    k0, k1, k2 = -factor * (h00 + h10 + h20), -factor * (h01 + h11 + h21), -factor * (h02 + h12 + h22)
    n0 = -c[2] * g1 - c[4] * g2 - e[2] * k1 - e[4] * k2
    n1 = -c[0] * g0 - c[5] * g2 - e[0] * k0 - e[5] * k2
    n2 = -c[1] * g0 - c[3] * g1 - e[1] * k0 - e[3] * k1
    mean = (n0 + n1 + n2) / 3.0
    return n0 - mean, n1 - mean, n2 - mean
