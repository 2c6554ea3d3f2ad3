"""Rates of conduction and film exchange by the motion of the body, for many directions of motion at once (direct differentiation).

Conduction int J g_a . h dV with g_a = F^-T dN_a/dX and the spatial temperature gradient h = sum_b theta_b g_b changes at fixed theta
with the velocity gradient l = F' F^-1 of a direction by

    (J g_a . h)' = J g_a . [(tr l) h - (l + l^T) h],

a film integral with the element of area da = |t_1 x t_2|, t_k the tangents of the facet. No matrix is formed for a direction.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.jit import kernel
from thermofit.fem.element import ElementData
from thermofit.fem.heat import FacetData
from thermofit.fem.lanes import add_lanes, copy_lanes, multiply_add
from thermofit.material.law_rates import LANES
from thermofit.material.tensor import determinant, inverse_transpose

Vector = tuple[float, float, float]
Nodal = tuple[Vector, Vector, Vector, Vector, Vector, Vector, Vector, Vector]

# Workspace of an element: u' of its nodes, result of both temperatures, each LANES numbers; behind them g_a and h of the point.
_U, _RESULT = 0, 24 * LANES
_G = _RESULT + 16 * LANES
_H = _G + 24
_END = _H + 6


@kernel
def add_conduction_rates(data: ElementData, u: np.ndarray, u_rates: np.ndarray, theta: np.ndarray, factor: float, out: np.ndarray) -> None:
    """out (2, n_np, m) += factor (int grad N_a . J C^-1 . grad theta dV)' at fixed theta (2, n_np) K by the motion u_rates (n_np, 3, m)."""
    m = u_rates.shape[2]
    motion, result, n = u_rates.reshape(-1), out.reshape(-1), out.shape[1]
    w, zero, point = np.zeros(_END), np.zeros(LANES), np.zeros((8, 30))
    f, f_inv_t, corner = np.empty((3, 3)), np.empty((3, 3)), np.empty((8, 5))
    for e in range(data.hexes.shape[0]):
        for a in range(8):
            node = data.hexes[e, a]
            corner[a, 0], corner[a, 1], corner[a, 2] = u[node, 0], u[node, 1], u[node, 2]
            corner[a, 3], corner[a, 4] = theta[0, node], theta[1, node]
        for q in range(8):
            _gradients(data.gradient[e, q], factor * data.volume[e, q], corner, f, f_inv_t, point[q])
        for b in range(0, m, LANES):
            for a in range(8):
                for i in range(3):
                    copy_lanes(w, _U + (3 * a + i) * LANES, motion, (data.hexes[e, a] * 3 + i) * m + b)
                for k in range(2):
                    copy_lanes(w, _RESULT + (8 * k + a) * LANES, zero, 0)
            for q in range(8):
                for r in range(30):
                    w[_G + r] = point[q, r]
                _add_point(w)
            for k in range(2):
                for a in range(8):
                    add_lanes(result, (k * n + data.hexes[e, a]) * m + b, 1.0, w, _RESULT + (8 * k + a) * LANES)


@kernel(forceinline=True)
def _gradients(gradient: np.ndarray, weight: float, corner: np.ndarray, f: np.ndarray, f_inv_t: np.ndarray, point: np.ndarray) -> None:
    """g_a (8, 3) and, for both temperatures, weight J h (2, 3) of a point, one behind the other.

    `gradient` (8, 3) is dN_a/dX, `corner` (8, 5) holds u and both temperatures of the nodes.
    """
    for i in range(3):
        for j in range(3):
            s = 1.0 if i == j else 0.0
            for a in range(8):
                s += corner[a, i] * gradient[a, j]
            f[i, j] = s
    det = determinant(f)
    inverse_transpose(f, det, f_inv_t)
    weight *= det
    for i in range(3):
        first, second = 0.0, 0.0
        for a in range(8):
            s = f_inv_t[i, 0] * gradient[a, 0] + f_inv_t[i, 1] * gradient[a, 1] + f_inv_t[i, 2] * gradient[a, 2]
            point[3 * a + i] = s
            first += corner[a, 3] * s
            second += corner[a, 4] * s
        point[24 + i], point[27 + i] = weight * first, weight * second


@kernel(forceinline=True)
def _three(w: np.ndarray, at: int) -> Vector:
    return (w[at], w[at + 1], w[at + 2])


@kernel(forceinline=True)
def _scaled(x: float, g: Vector) -> Vector:
    return (x * g[0], x * g[1], x * g[2])


@kernel(forceinline=True)
def _added(s: Vector, x: float, g: Vector) -> Vector:
    """s + x g."""
    return (multiply_add(x, g[0], s[0]), multiply_add(x, g[1], s[1]), multiply_add(x, g[2], s[2]))


@kernel(forceinline=True)
def _row(w: np.ndarray, at: int, g: Nodal) -> Vector:
    """sum_a x_a g_a of a component x of nodal vectors in the lane of `at`."""
    step = 3 * LANES
    s = _scaled(w[at], g[0])
    s = _added(s, w[at + step], g[1])
    s = _added(s, w[at + 2 * step], g[2])
    s = _added(s, w[at + 3 * step], g[3])
    s = _added(s, w[at + 4 * step], g[4])
    s = _added(s, w[at + 5 * step], g[5])
    s = _added(s, w[at + 6 * step], g[6])
    return _added(s, w[at + 7 * step], g[7])


@kernel(forceinline=True)
def _product(a: Vector, b: Vector, s: float) -> float:
    """a . b + s."""
    return multiply_add(a[0], b[0], multiply_add(a[1], b[1], multiply_add(a[2], b[2], s)))


@kernel(forceinline=True)
def _add_nodes(w: np.ndarray, at: int, g: Nodal, v: Vector) -> None:
    """Nodal numbers += g_a . v in the lane of `at`."""
    w[at] = _product(g[0], v, w[at])
    w[at + LANES] = _product(g[1], v, w[at + LANES])
    w[at + 2 * LANES] = _product(g[2], v, w[at + 2 * LANES])
    w[at + 3 * LANES] = _product(g[3], v, w[at + 3 * LANES])
    w[at + 4 * LANES] = _product(g[4], v, w[at + 4 * LANES])
    w[at + 5 * LANES] = _product(g[5], v, w[at + 5 * LANES])
    w[at + 6 * LANES] = _product(g[6], v, w[at + 6 * LANES])
    w[at + 7 * LANES] = _product(g[7], v, w[at + 7 * LANES])


@kernel(forceinline=True)
def _add_point(w: np.ndarray) -> None:
    """Results of all lanes += g_a . [(tr l) h - (l + l^T) h] of the point.

    The numbers of the point are local while the loop runs, which is long enough not to be unrolled: so it becomes vector instructions.
    """
    g = (
        _three(w, _G), _three(w, _G + 3), _three(w, _G + 6), _three(w, _G + 9),
        _three(w, _G + 12), _three(w, _G + 15), _three(w, _G + 18), _three(w, _G + 21),
    )  # fmt: skip
    h_1, h_2 = _three(w, _H), _three(w, _H + 3)
    for m in range(LANES):
        x, y, z = _row(w, m, g), _row(w, m + LANES, g), _row(w, m + 2 * LANES, g)
        xy, yz, xz = -(x[1] + y[0]), -(y[2] + z[1]), -(x[2] + z[0])
        t = ((y[1] + z[2] - x[0], xy, xz), (xy, x[0] + z[2] - y[1], yz), (xz, yz, x[0] + y[1] - z[2]))
        _add_nodes(w, _RESULT + m, g, (_product(t[0], h_1, 0.0), _product(t[1], h_1, 0.0), _product(t[2], h_1, 0.0)))
        _add_nodes(w, _RESULT + 8 * LANES + m, g, (_product(t[0], h_2, 0.0), _product(t[1], h_2, 0.0), _product(t[2], h_2, 0.0)))


# Workspace of a facet: u' of its nodes, tangents' and area'.
_TANGENT = 12 * LANES
_AREA = _TANGENT + 6 * LANES


@kernel
def add_film_rates(data: FacetData, x: np.ndarray, u_rates: np.ndarray, excess: np.ndarray, factor: float, out: np.ndarray) -> None:
    """out (2, n_np, m) += factor (int N_a (theta - theta_M) da)' at fixed excess theta - theta_M (2, n_np) K by the motion u_rates.

    x (n_np, 3) mm are the current positions.
    """
    m = u_rates.shape[2]
    motion, result, n = u_rates.reshape(-1), out.reshape(-1), out.shape[1]
    w, zero, t, c = np.zeros(_AREA + LANES), np.zeros(LANES), np.empty((2, 3)), np.empty(3)
    for s in range(data.facets.shape[0]):
        for q in range(4):
            t[:] = 0.0
            first, second = 0.0, 0.0
            for a in range(4):
                node = data.facets[s, a]
                first += data.shape[q, a] * excess[0, node]
                second += data.shape[q, a] * excess[1, node]
                for i in range(3):
                    t[0, i] += data.derivative[q, a, 0] * x[node, i]
                    t[1, i] += data.derivative[q, a, 1] * x[node, i]
            for i in range(3):
                c[i] = t[0, (i + 1) % 3] * t[1, (i + 2) % 3] - t[0, (i + 2) % 3] * t[1, (i + 1) % 3]
            c *= factor / np.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
            for b in range(0, m, LANES):
                _area_rate(data, s, q, t, c, motion, m, b, zero, w)
                for a in range(4):
                    at = data.facets[s, a] * m + b
                    add_lanes(result, at, data.shape[q, a] * first, w, _AREA)
                    add_lanes(result, n * m + at, data.shape[q, a] * second, w, _AREA)


@kernel(forceinline=True)
def _area_rate(
    data: FacetData, s: int, q: int, t: np.ndarray, c: np.ndarray, motion: np.ndarray, m: int, b: int, zero: np.ndarray, w: np.ndarray
) -> None:
    """Rate of the element of area c . (t_1' x t_2 + t_1 x t_2'), c = t_1 x t_2 / |t_1 x t_2| times a factor."""
    for r in range(6):
        copy_lanes(w, _TANGENT + r * LANES, zero, 0)
    for a in range(4):
        for i in range(3):
            start = (data.facets[s, a] * 3 + i) * m + b
            add_lanes(w, _TANGENT + i * LANES, data.derivative[q, a, 0], motion, start)
            add_lanes(w, _TANGENT + (3 + i) * LANES, data.derivative[q, a, 1], motion, start)
    copy_lanes(w, _AREA, zero, 0)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        add_lanes(w, _AREA, t[1, j] * c[k] - t[1, k] * c[j], w, _TANGENT + i * LANES)
        add_lanes(w, _AREA, c[j] * t[0, k] - c[k] * t[0, j], w, _TANGENT + (3 + i) * LANES)
