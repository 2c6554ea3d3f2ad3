"""Stiffness of one hex8 in lanes: the moduli with the Gauss points as lanes, then the sums with the nodes as lanes.

The stiffness of nodes a, b, with a point's spatial tangent a_ijkl = delta_ik tau_jl + c_ijkl, the spatial gradients g_a = F^-T dN_a/dX,
their mean g_bar_a = sum_q J w g_a / (V J_bar) and the weights w of the points in the reference volume V, is

    K_ab,ik = sum_q g_a,j (C_ijkl + delta_ik T_jl) g_b,l + g_bar_a,i s_b,k + s_a,i g_bar_b,k.

Full integration: C = w c, T = w tau, s = 0. F-bar, with p = tr tau / 3, P = sum_q w p and V_kl = c_iikl + 2 tau_kl:

    C = w [c - (1 (x) V + V (x) 1)/3 + tr V 1 (x) 1 / 9] + omega 1 (x) 1 + rho (delta_ik delta_jl + delta_il delta_jk),
    T = w tau - rho 1,   omega = P J w / (V J_bar),   rho = w p - omega,
    s_a = sum_q w (V - tr V 1 / 3) g_a / 3 + (sum_q w tr V / 9 - P) g_bar_a / 2.

C then is w c between deviators; what is left is the second derivative of J_bar.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, spread
from thermofit.law.tensor import Symmetric, added, scaled
from thermofit.point.lanes_memory import lane_sum, number, row, set_row, set_vectors
from thermofit.point.lanes_rows import STIFFNESS, add_to_row
from thermofit.point.lanes_tensor import Tensor, set_symmetric_rows, symmetric_rows

Vector = tuple[float, float, float]
"""Three components, each in lanes."""

# Rows of the workspace of an element.
GRADIENT, MEAN = 0, 24
"""g_a, rows 3 q + i, and g_bar_a; the lanes are nodes."""
PUSH, J_WEIGHT, STRESS = 27, 36, 37
"""(dx/dxi)^-T, nine, J w, and w tau - w p 1, six; the lanes are points."""
_MODULI, _STRESS, _DEVIATOR = 43, 79, 85
"""C, 36, T, six, and w (V - tr V 1 / 3) / 3, six; the lanes are points."""
_SIDE, _PRODUCT = 91, 94
"""s_a, and (C_ijkl + delta_ik T_jl) g_b,l, rows 27 q + 9 j + 3 i + k; the lanes are nodes."""
ELEMENT_ROWS = 310


@kernel(forceinline=True)
def vector_rows(w: np.ndarray, n: int) -> Vector:
    """The vector in three rows from row n on."""
    return (row(w, n), row(w, n + 1), row(w, n + 2))


@kernel(forceinline=True)
def set_vector_rows(w: np.ndarray, n: int, v: Vector) -> None:
    """Write a vector into three rows."""
    set_row(w, n, v[0])
    set_row(w, n + 1, v[1])
    set_row(w, n + 2, v[2])


@kernel(forceinline=True)
def vector_added(a: Vector, b: Vector, factor: float) -> Vector:
    """a + factor b."""
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


@kernel(forceinline=True)
def point_times_nodes(w: np.ndarray, n: int, q: int, v: Vector) -> Vector:
    """S . v of the symmetric tensor S of point q, in six rows from row n on, and the vectors v of all nodes."""
    s0, s1, s2 = number(w, n, q), number(w, n + 1, q), number(w, n + 2, q)
    s3, s4, s5 = number(w, n + 3, q), number(w, n + 4, q), number(w, n + 5, q)
    return (s0 * v[0] + s3 * v[1] + s5 * v[2], s3 * v[0] + s1 * v[1] + s4 * v[2], s5 * v[0] + s4 * v[1] + s2 * v[2])


@kernel(forceinline=True)
def set_full_integration(weight: Lanes, tau: Symmetric, w: np.ndarray, point: np.ndarray) -> None:
    """C = w c, T = w tau, s = 0."""
    set_symmetric_rows(w, _STRESS, scaled(tau, weight))
    for m in range(36):
        set_row(w, _MODULI + m, weight * row(point, STIFFNESS + m))
    for m in range(3):
        set_row(w, _SIDE + m, 0.0)


@kernel(forceinline=True)
def set_f_bar(weight: Lanes, power: Lanes, tau: Symmetric, w: np.ndarray, point: np.ndarray) -> None:
    """C, T and s of F-bar; `power` is w p."""
    total = lane_sum(power)
    omega = row(w, J_WEIGHT) * (total / lane_sum(row(w, J_WEIGHT)))
    rho = power - omega
    t = scaled(tau, weight)
    set_symmetric_rows(w, _STRESS, (t[0] - rho, t[1] - rho, t[2] - rho, t[3], t[4], t[5]))
    c1, c2, c3 = symmetric_rows(point, STIFFNESS), symmetric_rows(point, STIFFNESS + 6), symmetric_rows(point, STIFFNESS + 12)
    v = scaled(added(added(added(c1, c2, 1.0), c3, 1.0), tau, 2.0), weight * (1.0 / 3.0))  # w V / 3
    mean = (v[0] + v[1] + v[2]) * (1.0 / 3.0)  # w tr V / 9
    set_symmetric_rows(w, _DEVIATOR, (v[0] - mean, v[1] - mean, v[2] - mean, v[3], v[4], v[5]))
    for m in range(6):
        c = scaled(symmetric_rows(point, STIFFNESS + 6 * m), weight)
        side = -row(w, _DEVIATOR + m)
        if m < 3:
            c, side = added(c, v, -1.0), side + omega
        set_symmetric_rows(w, _MODULI + 6 * m, (c[0] + side, c[1] + side, c[2] + side, c[3], c[4], c[5]))
    for m in range(3):
        add_to_row(w, _MODULI + 7 * m, 2.0 * rho)
        add_to_row(w, _MODULI + 7 * (m + 3), rho)
    _set_side(0.5 * (lane_sum(mean) - total), w)


@kernel(forceinline=True)
def _set_side(by_mean: float, w: np.ndarray) -> None:
    """s_a = sum_q w (V - tr V 1 / 3) g_a / 3 + by_mean g_bar_a."""
    o = spread(0.0)
    s = vector_added((o, o, o), vector_rows(w, MEAN), by_mean)
    for q in range(8):
        s = vector_added(s, point_times_nodes(w, _DEVIATOR, q, vector_rows(w, GRADIENT + 3 * q)), 1.0)
    set_vector_rows(w, _SIDE, s)


@kernel(forceinline=True)
def _set_products(w: np.ndarray) -> None:
    """(C_ijkl + delta_ik T_jl) g_b,l of all points at all nodes."""
    for q in range(8):
        g = vector_rows(w, GRADIENT + 3 * q)
        t = point_times_nodes(w, _STRESS, q, g)
        at = _PRODUCT + 27 * q
        c = point_times_nodes(w, _MODULI, q, g)
        set_vector_rows(w, at, (c[0] + t[0], c[1], c[2]))  # 11
        c = point_times_nodes(w, _MODULI + 6, q, g)
        set_vector_rows(w, at + 12, (c[0], c[1] + t[1], c[2]))  # 22
        c = point_times_nodes(w, _MODULI + 12, q, g)
        set_vector_rows(w, at + 24, (c[0], c[1], c[2] + t[2]))  # 33
        c = point_times_nodes(w, _MODULI + 18, q, g)
        set_vector_rows(w, at + 9, (c[0] + t[1], c[1], c[2]))  # 12
        set_vector_rows(w, at + 3, (c[0], c[1] + t[0], c[2]))  # 21
        c = point_times_nodes(w, _MODULI + 24, q, g)
        set_vector_rows(w, at + 21, (c[0], c[1] + t[2], c[2]))  # 23
        set_vector_rows(w, at + 15, (c[0], c[1], c[2] + t[1]))  # 32
        c = point_times_nodes(w, _MODULI + 30, q, g)
        set_vector_rows(w, at + 18, (c[0] + t[2], c[1], c[2]))  # 13
        set_vector_rows(w, at + 6, (c[0], c[1], c[2] + t[0]))  # 31


@kernel(forceinline=True)
def _plus_dyad(k: Tensor, w: np.ndarray, n: int, a: int, b: Vector) -> Tensor:
    """k + v_a (x) b of the vector v of node a, in three rows from row n on."""
    x, y, z = number(w, n, a), number(w, n + 1, a), number(w, n + 2, a)
    return (
        k[0] + x * b[0], k[1] + x * b[1], k[2] + x * b[2],
        k[3] + y * b[0], k[4] + y * b[1], k[5] + y * b[2],
        k[6] + z * b[0], k[7] + z * b[1], k[8] + z * b[2],
    )  # fmt: skip


@kernel(forceinline=True)
def _plus_rows(k: Tensor, factor: float, w: np.ndarray, n: int) -> Tensor:
    """k + factor times the nine rows from row n on."""
    return (
        k[0] + factor * row(w, n), k[1] + factor * row(w, n + 1), k[2] + factor * row(w, n + 2),
        k[3] + factor * row(w, n + 3), k[4] + factor * row(w, n + 4), k[5] + factor * row(w, n + 5),
        k[6] + factor * row(w, n + 6), k[7] + factor * row(w, n + 7), k[8] + factor * row(w, n + 8),
    )  # fmt: skip


@kernel(forceinline=True)
def set_stiffness(w: np.ndarray, stiffness: np.ndarray) -> None:
    """K_ab,ik of the module docstring into stiffness (24, 24); nodes b are lanes. The upper triangle is the one that counts."""
    _set_products(w)
    mean, side = vector_rows(w, MEAN), vector_rows(w, _SIDE)
    o = spread(0.0)
    for a in range(8):
        k = _plus_dyad((o, o, o, o, o, o, o, o, o), w, MEAN, a, side)
        k = _plus_dyad(k, w, _SIDE, a, mean)
        for q in range(8):
            g, at = GRADIENT + 3 * q, _PRODUCT + 27 * q
            k = _plus_rows(k, number(w, g, a), w, at)
            k = _plus_rows(k, number(w, g + 1, a), w, at + 9)
            k = _plus_rows(k, number(w, g + 2, a), w, at + 18)
        set_vectors(stiffness, 9 * a, k[0], k[1], k[2])
        set_vectors(stiffness, 9 * a + 3, k[3], k[4], k[5])
        set_vectors(stiffness, 9 * a + 6, k[6], k[7], k[8])
    for i in range(24):
        for j in range(i):
            stiffness[i, j] = stiffness[j, i]
