"""Heat equation on the deformed body: capacity, conduction, film exchange and sources as nodal quantities.

Balance of energy (4.20) in the reference configuration, weak form with test function w:

    int w c0 theta_dot dV + int grad w . kappa J C^-1 . grad theta dV + int w alpha_con (theta - theta_M) da
        = int w [D_mech - 3 alpha_exp K theta d(ln J / J)/dt] dV.

Conduction follows the deformation of the body (Fourier's law 4.12 in space), film exchange the current area.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from thermofit.body.element.hex8 import ElementData
from thermofit.body.element.lanes import element_kinematics, point_temperatures
from thermofit.body.element.stiffness import ELEMENT_ROWS, GRADIENT, J_WEIGHT
from thermofit.body.sensitivity.lanes import add_lanes, copy_lanes
from thermofit.core.jit import kernel
from thermofit.core.lanes import spread
from thermofit.law.page import Law, released_energy, thermoelastic_heat
from thermofit.point.lanes_memory import lane_sum, lane_workspace, number, row, set_row

_P = 1.0 / np.sqrt(3.0)
_FACET_POINTS = np.array([[-_P, -_P], [_P, -_P], [_P, _P], [-_P, _P]])
_FACET_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)


class FacetData(NamedTuple):
    """Facets of one film boundary: nodes (n_f, 4), shape functions and their derivatives at the 2 x 2 points, all nodes once (n,)."""

    facets: np.ndarray
    shape: np.ndarray
    derivative: np.ndarray
    nodes: np.ndarray


def facet_data(facets: np.ndarray) -> FacetData:
    """FacetData of (n_f, 4) facets."""
    factor = 1.0 + _FACET_POINTS[:, None, :] * _FACET_CORNERS
    shape = factor.prod(axis=2) / 4.0
    derivative = _FACET_CORNERS * factor[:, :, ::-1] / 4.0
    return FacetData(np.ascontiguousarray(facets), np.ascontiguousarray(shape), np.ascontiguousarray(derivative), np.unique(facets))


@kernel
def capacity_matrices(data: ElementData) -> np.ndarray:
    """int N_a N_b dV of every element, (n_el, 8, 8) in mm^3: the capacity matrix for unit c0."""
    n_el = data.hexes.shape[0]
    out = np.zeros((n_el, 8, 8))
    for e in range(n_el):
        for q in range(8):
            for a in range(8):
                for b in range(8):
                    out[e, a, b] += data.volume[e, q] * data.shape[q, a] * data.shape[q, b]
    return out


def swelling_matrices(data: ElementData) -> np.ndarray:
    """int N_a dV int N_b dV / V of every element, (n_el, 8, 8) in mm^3: with F_bar its volume feels the mean of its temperature alone, and
    what it takes for that is spread evenly. Without F_bar the capacity matrix."""
    if data.f_bar != 1:
        return capacity_matrices(data)
    share = data.volume @ data.shape
    return np.asarray(share[:, :, None] * share[:, None, :] / data.volume.sum(axis=1)[:, None, None])


@kernel(parallel=True)
def conduction_matrices(data: ElementData, u: np.ndarray, out: np.ndarray) -> None:
    """int grad N_a . J C^-1 . grad N_b dV = sum_q J w g_a . g_b of every element into out (n_el, 8, 8), mm: conduction for unit kappa."""
    n_el = data.hexes.shape[0]
    for chunk in prange(16):
        w = lane_workspace(ELEMENT_ROWS)
        for e in range(chunk * n_el // 16, (chunk + 1) * n_el // 16):
            element_kinematics(data, e, u, w)
            for a in range(8):
                k = spread(0.0)
                for q in range(8):
                    g, weight = GRADIENT + 3 * q, number(w, J_WEIGHT, q)
                    x, y, z = weight * number(w, g, a), weight * number(w, g + 1, a), weight * number(w, g + 2, a)
                    k = k + (x * row(w, g) + y * row(w, g + 1) + z * row(w, g + 2))
                set_row(out, 8 * e + a, k)


@kernel
def film_matrices(data: FacetData, x: np.ndarray, out: np.ndarray) -> None:
    """int N_a N_b da of every facet at current positions x (n_np, 3) into out (n_f, 4, 4), mm^2."""
    t = np.empty((2, 3))
    for n in range(data.facets.shape[0]):
        out[n, :, :] = 0.0
        for q in range(4):
            t[:] = 0.0
            for a in range(4):
                node = data.facets[n, a]
                for i in range(3):
                    t[0, i] += data.derivative[q, a, 0] * x[node, i]
                    t[1, i] += data.derivative[q, a, 1] * x[node, i]
            c0 = t[0, 1] * t[1, 2] - t[0, 2] * t[1, 1]
            c1 = t[0, 2] * t[1, 0] - t[0, 0] * t[1, 2]
            c2 = t[0, 0] * t[1, 1] - t[0, 1] * t[1, 0]
            area = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
            for a in range(4):
                for b in range(4):
                    out[n, a, b] += area * data.shape[q, a] * data.shape[q, b]


_NONE = np.empty((0, 0, 0))


class PointStates(NamedTuple):
    """State of all points at one time as the heat sources need it, each (n_el, 8): J, alpha, Lambda; `structure` (n_el, 8, n) is what the
    state of a point holds beyond its first eleven numbers (point.state), empty where that is nothing."""

    dilatation: np.ndarray
    alpha: np.ndarray
    accumulated: np.ndarray
    structure: np.ndarray = _NONE


def at_points(data: ElementData, nodal: np.ndarray) -> np.ndarray:
    """Nodal fields (n_np,) or (n_np, m) at the Gauss points (n_el, 8) or (n_el, 8, m)."""
    of_corners = nodal[data.hexes]
    return np.ascontiguousarray(of_corners @ data.shape.T if nodal.ndim == 1 else data.shape @ of_corners)


@kernel
def heat_of_increment(
    data: ElementData, start: PointStates, end: PointStates, theta: np.ndarray, law: Law, out: np.ndarray
) -> tuple[float, float]:
    """Nodal heat of one increment int N_a (dissipated + thermoelastic) dV added to out (n_np,), mJ.

    theta (n_np,) K is the temperature in the thermoelastic term. Returns the totals (dissipated, thermoelastic) in mJ.
    """
    total_dissipated, total_elastic = 0.0, 0.0
    w = lane_workspace(2)
    for e in range(data.hexes.shape[0]):
        nodes, weight = data.hexes[e], row(data.volume, e)
        t, j_n, j = point_temperatures(theta, nodes), row(start.dilatation, e), row(end.dilatation, e)
        elastic = weight * thermoelastic_heat(t, math.log(j_n) / j_n, math.log(j) / j, law)
        set_row(w, 0, elastic)
        total_elastic += lane_sum(elastic)
        for q in range(8):
            d_lambda = end.accumulated[e, q] - start.accumulated[e, q]
            if d_lambda > 0.0:
                temperature = 0.0
                for a in range(8):
                    temperature += data.shape[q, a] * theta[nodes[a]]
                released = released_energy(start.alpha[e, q], end.alpha[e, q], d_lambda, end.accumulated[e, q], temperature, law)
                total_dissipated += data.volume[e, q] * released
                w[q] += data.volume[e, q] * released
        heat = spread(0.0)
        for q in range(8):
            heat = heat + w[q] * row(data.shape, q)
        set_row(w, 1, heat)
        for a in range(8):
            out[nodes[a]] += w[8 + a]
    return total_dissipated, total_elastic


class Increment(NamedTuple):
    """Change of all points over one increment as the heat sources need it, each (n_el, 8): ln J / J and alpha at both ends, dLambda, and
    Lambda at the end."""

    g_n: np.ndarray
    g: np.ndarray
    alpha_n: np.ndarray
    alpha: np.ndarray
    d_lambda: np.ndarray
    accumulated: np.ndarray


def increment_between(start: PointStates, end: PointStates) -> Increment:
    """Increment from one state of all points to another."""
    g_n, g = np.log(start.dilatation) / start.dilatation, np.log(end.dilatation) / end.dilatation
    return Increment(g_n, g, start.alpha, end.alpha, end.accumulated - start.accumulated, end.accumulated)


@kernel
def add_released_heat(data: ElementData, increment: Increment, theta: np.ndarray, law: Law, out: np.ndarray) -> None:
    """`heat_of_increment` of a prepared increment, without the totals: for many sets of parameters on one mechanical history.

    The 8 points of an element, and then its 8 nodes, take the lanes.
    """
    shape, transposed = data.shape.reshape(-1), data.shape.T.copy().reshape(-1)
    t, heat, nodal, zero = np.zeros(8), np.zeros(8), np.zeros(8), np.zeros(8)
    for e in range(data.hexes.shape[0]):
        copy_lanes(t, 0, zero, 0)
        for a in range(8):
            add_lanes(t, 0, theta[data.hexes[e, a]], transposed, 8 * a)
        for q in range(8):
            heat[q] = thermoelastic_heat(t[q], increment.g_n[e, q], increment.g[e, q], law)
            if increment.d_lambda[e, q] > 0.0:
                alpha_n, alpha, d_lambda = increment.alpha_n[e, q], increment.alpha[e, q], increment.d_lambda[e, q]
                heat[q] += released_energy(alpha_n, alpha, d_lambda, increment.accumulated[e, q], t[q], law)
        copy_lanes(nodal, 0, zero, 0)
        for q in range(8):
            add_lanes(nodal, 0, data.volume[e, q] * heat[q], shape, 8 * q)
        for a in range(8):
            out[data.hexes[e, a]] += nodal[a]


@kernel
def smallest_dissipation(start: PointStates, end: PointStates, theta: float, law: Law, added: np.ndarray) -> float:
    """Smallest dissipation of one increment over all points at about theta K, mJ/mm^3; negative violates the second law. `added` (n_el, 8)
    is that of effects which change the local update itself."""
    smallest = 0.0
    for e in range(start.alpha.shape[0]):
        for q in range(8):
            d_lambda = end.accumulated[e, q] - start.accumulated[e, q]
            if d_lambda != 0.0:
                released = released_energy(start.alpha[e, q], end.alpha[e, q], d_lambda, end.accumulated[e, q], theta, law)
                smallest = min(smallest, released + added[e, q])
    return smallest


@kernel
def dissipation_of_points(data: ElementData, start: PointStates, end: PointStates, theta: np.ndarray, law: Law, out: np.ndarray) -> None:
    """Mechanical dissipation of one increment at every point, mJ/mm^3, added to out (n_el, 8); theta (n_np,) K at its end."""
    for e in range(data.hexes.shape[0]):
        for q in range(8):
            d_lambda = end.accumulated[e, q] - start.accumulated[e, q]
            if d_lambda > 0.0:
                t = 0.0
                for a in range(8):
                    t += data.shape[q, a] * theta[data.hexes[e, a]]
                out[e, q] += released_energy(start.alpha[e, q], end.alpha[e, q], d_lambda, end.accumulated[e, q], t, law)
