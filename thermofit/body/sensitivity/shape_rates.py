"""Rates of conduction and film exchange by the motion of the body, for many directions of motion at once (direct differentiation).

Conduction int J g_a . h dV with g_a = F^-T dN_a/dX and the spatial temperature gradient h = sum_b theta_b g_b changes at fixed theta
with the velocity gradient l = F' F^-1 of a direction by

    (J g_a . h)' = J g_a . [(tr l) h - (l + l^T) h],

a film integral with the element of area da = |t_1 x t_2|, t_k the tangents of the facet. No matrix is formed for a direction.
"""

from __future__ import annotations

import numpy as np

from thermofit.body.element.hex8 import ElementData
from thermofit.body.element.lanes import element_kinematics
from thermofit.body.element.stiffness import ELEMENT_ROWS, GRADIENT, J_WEIGHT, Vector, set_vector_rows
from thermofit.body.heat.equation import FacetData
from thermofit.body.sensitivity.lanes import add_lanes, copy_lanes
from thermofit.core.jit import kernel
from thermofit.core.lanes import WIDTH, Lanes, multiply_add, spread
from thermofit.law.page_rates import LANES
from thermofit.point.lanes_fused import dot
from thermofit.point.lanes_memory import lane_workspace, number, prefetch_rows, row, set_row

_H, _SLOPE = 0, 16
"""Rows of the workspace of an element: weight J g_a . h of the points for both temperatures; behind them the maps of u' to the results."""
_MAP_ROWS = _SLOPE + 48
Eight = tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]


@kernel
def add_conduction_rates(data: ElementData, u: np.ndarray, u_rates: np.ndarray, theta: np.ndarray, factor: float, out: np.ndarray) -> None:
    """out (2, n_np, m) += factor (int grad N_a . J C^-1 . grad theta dV)' at fixed theta (2, n_np) K by the motion u_rates (n_np, 3, m).

    What an element gives is linear in the u' of its nodes: the map is formed once and serves all directions.
    """
    n_groups, n = u_rates.shape[2] // WIDTH, out.shape[1]
    w, slope, corner, h = lane_workspace(ELEMENT_ROWS), lane_workspace(_MAP_ROWS), np.empty(8), np.empty((2, 8, 3))
    for e in range(data.hexes.shape[0]):
        nodes = data.hexes[e]
        prefetch_rows(data.inverse_jacobian, 9 * (e + 1), 9, 1)
        element_kinematics(data, e, u, w)
        for k in range(2):
            for a in range(8):
                corner[a] = theta[k, nodes[a]]
            _temperature_gradients(w, corner, factor, h[k], slope, _H + 8 * k)
        for b in range(8):
            _set_slopes(w, b, h, slope, _SLOPE + 3 * b)
        for group in range(n_groups):
            for k in range(2):
                result = _mapped(slope, _SLOPE + 24 * k, nodes, u_rates, group)
                _add_to_nodes(out, k * n, nodes, group, result)


@kernel(forceinline=True)
def _temperature_gradients(w: np.ndarray, corner: np.ndarray, factor: float, h: np.ndarray, slope: np.ndarray, at: int) -> None:
    """factor J w h (8, 3) of all points by the temperatures of the nodes (8,), and its product with g_a of all nodes into the rows of
    `slope` from `at` on."""
    for q in range(8):
        g, weight = GRADIENT + 3 * q, factor * number(w, J_WEIGHT, q)
        for i in range(3):
            s = 0.0
            for a in range(8):
                s += corner[a] * number(w, g + i, a)
            h[q, i] = weight * s
        set_row(slope, at + q, dot(h[q, 0], row(w, g), h[q, 1], row(w, g + 1), h[q, 2], row(w, g + 2)))


@kernel(forceinline=True)
def _set_slopes(w: np.ndarray, b: int, h: np.ndarray, slope: np.ndarray, to: int) -> None:
    """Derivatives of both results at all nodes a by u' of node b: sum_q J w [g_b (g_a . h) - g_a (g_b . h) - (g_a . g_b) h]."""
    o = spread(0.0)
    first, second = (o, o, o), (o, o, o)
    for q in range(8):
        g = GRADIENT + 3 * q
        at_all, at_b = (row(w, g), row(w, g + 1), row(w, g + 2)), (number(w, g, b), number(w, g + 1, b), number(w, g + 2, b))
        both = -dot(at_b[0], at_all[0], at_b[1], at_all[1], at_b[2], at_all[2])
        along = (row(slope, _H + q), number(slope, _H + q, b))
        first = _slopes_added(first, at_all, at_b, both, along, (h[0, q, 0], h[0, q, 1], h[0, q, 2]))
        along = (row(slope, _H + 8 + q), number(slope, _H + 8 + q, b))
        second = _slopes_added(second, at_all, at_b, both, along, (h[1, q, 0], h[1, q, 1], h[1, q, 2]))
    set_vector_rows(slope, to, first)
    set_vector_rows(slope, to + 24, second)


@kernel(forceinline=True)
def _slopes_added(s: Vector, at_all: Vector, at_b: Vector, both: Lanes, along: tuple[Lanes, float], h: Vector) -> Vector:
    """s + g_b (g_a . h) - g_a (g_b . h) + both h of one point; along = g_a . h of all nodes and g_b . h."""
    minus = -along[1]
    return (
        multiply_add(at_b[0], along[0], multiply_add(minus, at_all[0], multiply_add(h[0], both, s[0]))),
        multiply_add(at_b[1], along[0], multiply_add(minus, at_all[1], multiply_add(h[1], both, s[1]))),
        multiply_add(at_b[2], along[0], multiply_add(minus, at_all[2], multiply_add(h[2], both, s[2]))),
    )


@kernel(forceinline=True)
def _mapped(slope: np.ndarray, at: int, nodes: np.ndarray, u_rates: np.ndarray, group: int) -> Eight:
    """Result at the eight nodes by the u' of all nodes."""
    n_groups, o = u_rates.shape[2] // WIDTH, spread(0.0)
    s = (o, o, o, o, o, o, o, o)
    for b in range(8):
        for i in range(3):
            x, k = row(u_rates, (3 * nodes[b] + i) * n_groups + group), at + 3 * b + i
            s = (
                multiply_add(number(slope, k, 0), x, s[0]), multiply_add(number(slope, k, 1), x, s[1]),
                multiply_add(number(slope, k, 2), x, s[2]), multiply_add(number(slope, k, 3), x, s[3]),
                multiply_add(number(slope, k, 4), x, s[4]), multiply_add(number(slope, k, 5), x, s[5]),
                multiply_add(number(slope, k, 6), x, s[6]), multiply_add(number(slope, k, 7), x, s[7]),
            )  # fmt: skip
    return s


@kernel(forceinline=True)
def _add_to_nodes(out: np.ndarray, start: int, nodes: np.ndarray, group: int, values: Eight) -> None:
    """Rows `start` + nodes of out, seen as (n, m), += values."""
    n_groups = out.shape[2] // WIDTH
    for a in range(8):
        at = (start + nodes[a]) * n_groups + group
        set_row(out, at, row(out, at) + values[a])


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
