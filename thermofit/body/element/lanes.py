"""One hex8 in lanes: kinematics and stress with the Gauss points as lanes, forces with the nodes as lanes.

The parent element carries everything: with H = sum_a u_a (x) dN_a/dxi and J_0 = dX/dxi,

    F = 1 + H J_0^-1,   g_a = (dx/dxi)^-T dN_a/dxi = F^-T J_0^-T dN_a/dxi,   f_a = sum_q w (tau - p 1) g_a + P g_bar_a,

P = sum_q w p; without F-bar p = 0 here.
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.body.element.shape import SHAPE, SHAPE_DERIVATIVE, ElementData
from thermofit.body.element.stiffness import (
    GRADIENT,
    J_WEIGHT,
    MEAN,
    PUSH,
    STRESS,
    point_times_nodes,
    set_f_bar,
    set_full_integration,
    set_stiffness,
    set_vector_rows,
    vector_added,
    vector_rows,
)
from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, all_lanes, spread
from thermofit.law.page import Law
from thermofit.law.tensor import Symmetric, scaled
from thermofit.point.lanes_memory import lane_sum, number, prefetch_rows, row, set_row, set_vectors
from thermofit.point.lanes_point import kirchhoff_stress, set_spatial_stiffness, update_lanes
from thermofit.point.lanes_tensor import (
    Tensor,
    determinant_and_cofactor,
    product,
    set_symmetric_rows,
    set_tensor_rows,
    tensor_rows,
    tensor_scaled,
    transposed,
)

SHAPE_BY_POINTS = np.ascontiguousarray(SHAPE.T)
"""N (8 nodes, 8 points): the points are lanes."""
_BY_POINTS = np.ascontiguousarray(SHAPE_DERIVATIVE.transpose(1, 2, 0))
"""dN/dxi (8 nodes, 3, 8 points): the points are lanes."""
_BY_NODES = np.ascontiguousarray(SHAPE_DERIVATIVE.transpose(0, 2, 1))
"""dN/dxi (8 points, 3, 8 nodes): the nodes are lanes."""


@kernel(forceinline=True)
def _deformation_gradient(u: np.ndarray, nodes: np.ndarray, inverse_jacobian: Tensor) -> Tensor:
    """F = 1 + (sum_a u_a (x) dN_a/dxi) J_0^-1 of all points."""
    o = spread(0.0)
    h = (o, o, o, o, o, o, o, o, o)
    for a in range(8):
        x, y, z = u[nodes[a], 0], u[nodes[a], 1], u[nodes[a], 2]
        d = vector_rows(_BY_POINTS, 3 * a)
        h = (
            h[0] + x * d[0], h[1] + x * d[1], h[2] + x * d[2],
            h[3] + y * d[0], h[4] + y * d[1], h[5] + y * d[2],
            h[6] + z * d[0], h[7] + z * d[1], h[8] + z * d[2],
        )  # fmt: skip
    f = product(h, inverse_jacobian)
    return (1.0 + f[0], f[1], f[2], f[3], 1.0 + f[4], f[5], f[6], f[7], 1.0 + f[8])


@kernel(forceinline=True)
def point_temperatures(theta: np.ndarray, nodes: np.ndarray) -> Lanes:
    """theta of all points."""
    value = spread(0.0)
    for a in range(8):
        value = value + theta[nodes[a]] * row(SHAPE_BY_POINTS, a)
    return value


@kernel(forceinline=True)
def _set_gradients(w: np.ndarray) -> None:
    """g_a = (dx/dxi)^-T dN_a/dxi of all points and g_bar_a = sum_q J w g_a / sum_q J w, at all nodes."""
    o = spread(0.0)
    mean = (o, o, o)
    for q in range(8):
        d = vector_rows(_BY_NODES, 3 * q)
        g = (
            number(w, PUSH, q) * d[0] + number(w, PUSH + 1, q) * d[1] + number(w, PUSH + 2, q) * d[2],
            number(w, PUSH + 3, q) * d[0] + number(w, PUSH + 4, q) * d[1] + number(w, PUSH + 5, q) * d[2],
            number(w, PUSH + 6, q) * d[0] + number(w, PUSH + 7, q) * d[1] + number(w, PUSH + 8, q) * d[2],
        )
        set_vector_rows(w, GRADIENT + 3 * q, g)
        mean = vector_added(mean, g, number(w, J_WEIGHT, q))
    r = 1.0 / lane_sum(row(w, J_WEIGHT))
    set_vector_rows(w, MEAN, (r * mean[0], r * mean[1], r * mean[2]))


@kernel(forceinline=True)
def prefetch_element(data: ElementData, e: int, state_n: np.ndarray, state: np.ndarray) -> None:
    """Have J_0^-1 of element e and the states of its points, (n_el, 8, n), before and after, fetched."""
    prefetch_rows(data.inverse_jacobian, 9 * e, 9, 1)
    prefetch_rows(state_n, e * state_n.shape[2], state_n.shape[2], 1)
    prefetch_rows(state, e * state.shape[2], state.shape[2], 1)


@kernel(forceinline=True)
def element_kinematics(data: ElementData, e: int, u: np.ndarray, w: np.ndarray) -> tuple[Tensor, Lanes]:
    """F that the material of each point sees and its J; g_a, g_bar_a, push and J w into their rows of w.

    Where a point is inverted J is not positive in it, and w is undefined.
    """
    nodes, weight, inverse_jacobian = data.hexes[e], row(data.volume, e), tensor_rows(data.inverse_jacobian, 9 * e)
    f = _deformation_gradient(u, nodes, inverse_jacobian)
    j, cofactor = determinant_and_cofactor(f)
    if not all_lanes(j > 0.0):
        return f, j
    set_tensor_rows(w, PUSH, product(tensor_scaled(cofactor, 1.0 / j), transposed(inverse_jacobian)))
    set_row(w, J_WEIGHT, j * weight)
    _set_gradients(w)
    if data.f_bar == 1:
        j_bar = spread(lane_sum(row(w, J_WEIGHT)) / lane_sum(weight))
        f = tensor_scaled(f, math.exp(math.log(j_bar / j) * (1.0 / 3.0)))
        j = j_bar
    return f, j


@kernel(forceinline=True)
def set_force(weight: Lanes, power: Lanes, tau: Symmetric, w: np.ndarray, force: np.ndarray) -> None:
    """f_a = sum_q w (tau - p 1) g_a + P g_bar_a; `power` is w p."""
    t = scaled(tau, weight)
    set_symmetric_rows(w, STRESS, (t[0] - power, t[1] - power, t[2] - power, t[3], t[4], t[5]))
    o = spread(0.0)
    f = vector_added((o, o, o), vector_rows(w, MEAN), lane_sum(power))
    for q in range(8):
        f = vector_added(f, point_times_nodes(w, STRESS, q, vector_rows(w, GRADIENT + 3 * q)), 1.0)
    set_vectors(force, 0, f[0], f[1], f[2])


@kernel(forceinline=True)
def one_element(
    data: ElementData,
    e: int,
    u: np.ndarray,
    theta: np.ndarray,
    state_n: np.ndarray,
    law: Law,
    tangent: bool,
    w: np.ndarray,
    point: np.ndarray,
    force: np.ndarray,
    stiffness: np.ndarray,
    state: np.ndarray,
    dilatation: np.ndarray,
) -> bool:
    """`element_pass` of element e; False where a point is inverted or its update does not converge: its results are then undefined."""
    nodes, weight = data.hexes[e], row(data.volume, e)
    f, j = element_kinematics(data, e, u, w)
    if not all_lanes(j > 0.0):
        return False
    status = update_lanes(f, point_temperatures(theta, nodes), state_n, law, point, state)
    if status < 0:
        return False
    set_row(dilatation, 0, j)
    tau = kirchhoff_stress(law, point)
    power = weight * ((tau[0] + tau[1] + tau[2]) * (data.f_bar / 3.0))
    set_force(weight, power, tau, w, force)
    if tangent:
        set_spatial_stiffness(status, law, point)
        if data.f_bar == 1:
            set_f_bar(weight, power, tau, w, point)
        else:
            set_full_integration(weight, tau, w, point)
        set_stiffness(w, stiffness)
    return True
