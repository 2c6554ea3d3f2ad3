"""The hex8 element: shape functions, F-bar kinematics, internal forces and their symmetric tangent.

F-bar in its variational (mean dilatation) form, so that the tangent is symmetric: F_bar = (J_bar/J)^(1/3) F with J_bar the
element mean of J. Its virtual work is

    int P(F_bar) : delta F_bar dV = int [dev tau : grad w + p g_bar . w] dV,   g_bar_a = int J g_a dV / (V J_bar),

tau = P F_bar^T Kirchhoff stress, p = tr tau / 3, g_a = F^-T dN_a/dX. Isochoric plastic flow does not lock it. Standard full
integration is F_bar = F.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from thermofit.core.jit import kernel
from thermofit.material.law import Law
from thermofit.material.point import INVERTED, NO_CONVERGENCE, local_tangent, local_update, piola_stress, point_work
from thermofit.material.tensor import determinant, inverse_transpose

_CORNERS = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float)
_G = 1.0 / np.sqrt(3.0)
GAUSS_POINTS = _CORNERS * _G
"""2 x 2 x 2 Gauss points in [-1, 1]^3, all of weight 1."""


def shape_functions(xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """N (n, 8) and dN/dxi (n, 8, 3) of the hex8 at points xi (n, 3)."""
    f = 1.0 + xi[:, None, :] * _CORNERS
    n = f.prod(axis=2) / 8.0
    dn = np.empty((len(xi), 8, 3))
    for i in range(3):
        others = [j for j in range(3) if j != i]
        dn[:, :, i] = _CORNERS[:, i] * f[:, :, others].prod(axis=2) / 8.0
    return n, dn


SHAPE, _SHAPE_DERIVATIVE = shape_functions(GAUSS_POINTS)


def reference_gradients(nodes: np.ndarray, hexes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """dN/dX (n_el, 8 points, 8 nodes, 3) in 1/mm and reference volume of each point (n_el, 8) in mm^3."""
    x = nodes[hexes]
    jacobian = np.einsum("eai,gaj->egij", x, _SHAPE_DERIVATIVE)
    volume = np.linalg.det(jacobian)
    gradient = np.einsum("gaj,egji->egai", _SHAPE_DERIVATIVE, np.linalg.inv(jacobian))
    return np.ascontiguousarray(gradient), volume


class ElementData(NamedTuple):
    """What the element pass needs of the mesh: connectivity, reference gradients, point volumes."""

    hexes: np.ndarray
    gradient: np.ndarray
    volume: np.ndarray
    shape: np.ndarray
    f_bar: int


def element_data(nodes: np.ndarray, hexes: np.ndarray, *, f_bar: bool = True) -> ElementData:
    """ElementData of a mesh; `f_bar=False` gives standard full integration."""
    gradient, volume = reference_gradients(nodes, hexes)
    return ElementData(np.ascontiguousarray(hexes), gradient, volume, np.ascontiguousarray(SHAPE), int(f_bar))


@kernel
def _kinematics(data: ElementData, e: int, u: np.ndarray, f_all: np.ndarray, g_all: np.ndarray, mean: np.ndarray) -> float:
    """F and spatial gradients g_a = F^-T dN_a/dX of all points, mean gradients g_bar; returns J_bar, or -1 if inverted."""
    volume = 0.0
    dilated = 0.0
    mean[:] = 0.0
    fit = np.empty((3, 3))
    for q in range(8):
        f = f_all[q]
        for i in range(3):
            for j in range(3):
                f[i, j] = 1.0 if i == j else 0.0
        for a in range(8):
            node = data.hexes[e, a]
            for i in range(3):
                for j in range(3):
                    f[i, j] += u[node, i] * data.gradient[e, q, a, j]
        det = determinant(f)
        if not det > 0.0:
            return -1.0
        inverse_transpose(f, det, fit)
        weight = data.volume[e, q]
        volume += weight
        dilated += weight * det
        for a in range(8):
            for i in range(3):
                s = 0.0
                for j in range(3):
                    s += fit[i, j] * data.gradient[e, q, a, j]
                g_all[q, a, i] = s
                mean[a, i] += weight * det * s
    for a in range(8):
        for i in range(3):
            mean[a, i] /= dilated
    return dilated / volume


@kernel
def _add_stiffness(g: np.ndarray, scaled: np.ndarray, a: np.ndarray, weight: float, pressure: float, k: np.ndarray) -> None:
    """k += weight [G_a A G_b + p g_b (x) g_a], upper blocks a <= b; `scaled` are the gradients that pair with A."""
    q = np.empty((9, 3))
    for b in range(8):
        for ij in range(9):
            for m in range(3):
                q[ij, m] = weight * (
                    a[ij, 3 * m] * scaled[b, 0] + a[ij, 3 * m + 1] * scaled[b, 1] + a[ij, 3 * m + 2] * scaled[b, 2]
                )
        for n in range(b + 1):
            s0, s1, s2 = scaled[n, 0], scaled[n, 1], scaled[n, 2]
            for i in range(3):
                wp = weight * pressure * g[b, i]
                for m in range(3):
                    k[3 * n + i, 3 * b + m] += (
                        s0 * q[3 * i, m] + s1 * q[3 * i + 1, m] + s2 * q[3 * i + 2, m] + wp * g[n, m]
                    )


@kernel
def _add_mean_dilatation(
    g: np.ndarray, mean: np.ndarray, tau: np.ndarray, contracted: np.ndarray, weight: float, bulk: float, k: np.ndarray
) -> None:
    """k += weight [h (x) m + m (x) h], h = (g_bar - g)/3, m = c + tau g + (I:a:I + 3p)/2 h; upper blocks."""
    h = np.empty(24)
    m = np.empty(24)
    for b in range(8):
        for i in range(3):
            h[3 * b + i] = (mean[b, i] - g[b, i]) / 3.0
            s = contracted[3 * b + i]
            for j in range(3):
                s += tau[i, j] * g[b, j]
            m[3 * b + i] = weight * (s + 0.5 * bulk * h[3 * b + i])
    for i in range(24):
        for j in range(3 * (i // 3), 24):
            k[i, j] += h[i] * m[j] + m[i] * h[j]


@kernel
def _finish_mean_dilatation(gradients: np.ndarray, j_weight: np.ndarray, mean: np.ndarray, power: float, k: np.ndarray) -> None:
    """k += P [sum_q J w (g_a (x) g_b - g_b (x) g_a) / (V J_bar) - g_bar (x) g_bar], P = int p dV; then mirror to the lower half."""
    for q in range(8):
        c = power * j_weight[q]
        g = gradients[q]
        for b in range(8):
            for n in range(b + 1):
                for i in range(3):
                    for m in range(3):
                        k[3 * n + i, 3 * b + m] += c * (g[n, i] * g[b, m] - g[n, m] * g[b, i])
    for b in range(8):
        for n in range(b + 1):
            for i in range(3):
                for m in range(3):
                    k[3 * n + i, 3 * b + m] -= power * mean[n, i] * mean[b, m]


@kernel(parallel=True)
def element_pass(
    data: ElementData,
    u: np.ndarray,
    theta: np.ndarray,
    state_n: np.ndarray,
    law: Law,
    tangent: bool,
    force: np.ndarray,
    stiffness: np.ndarray,
    state: np.ndarray,
    dilatation: np.ndarray,
) -> int:
    """Internal forces of all elements and, if `tangent`, their stiffness; new state of all points.

    u (n_np, 3) mm, theta (n_np,) K, state_n and state (n_el, 8, 11), force (n_el, 24) N, stiffness (n_el, 24, 24) N/mm,
    dilatation (n_el, 8): the J that the material sees. Returns the number of elements whose update failed.
    """
    n_el = data.hexes.shape[0]
    n_chunks = 64
    failed = np.zeros(n_chunks, dtype=np.int64)
    for chunk in prange(n_chunks):
        w = point_work()
        f_all, g_all = np.empty((8, 3, 3)), np.empty((8, 8, 3))
        mean, scaled, p, tau = np.empty((8, 3)), np.empty((8, 3)), np.empty((3, 3)), np.empty((3, 3))
        f_bar, a, contracted, fa = np.empty((3, 3)), np.empty((9, 9)), np.empty(24), np.empty(9)
        j_weight = np.empty(8)
        for e in range(chunk * n_el // n_chunks, (chunk + 1) * n_el // n_chunks):
            force[e, :] = 0.0
            if tangent:
                stiffness[e, :, :] = 0.0
            j_bar = _kinematics(data, e, u, f_all, g_all, mean)
            if j_bar <= 0.0:
                failed[chunk] += 1
                continue
            power = 0.0
            volume = 0.0
            for q in range(8):
                weight = data.volume[e, q]
                volume += weight
                det = determinant(f_all[q])
                j_weight[q] = weight * det
                scale = (j_bar / det) ** (1.0 / 3.0) if data.f_bar == 1 else 1.0
                t = 0.0
                for n in range(8):
                    t += data.shape[q, n] * theta[data.hexes[e, n]]
                for i in range(3):
                    for j in range(3):
                        f_bar[i, j] = scale * f_all[q, i, j]
                status = local_update(f_bar, t, state_n[e, q], law, w, state[e, q])
                if status == NO_CONVERGENCE or status == INVERTED:
                    failed[chunk] += 1
                    break
                dilatation[e, q] = j_bar if data.f_bar == 1 else det
                piola_stress(f_bar, law, w, p)
                for i in range(3):
                    for j in range(3):
                        tau[i, j] = p[i, 0] * f_bar[j, 0] + p[i, 1] * f_bar[j, 1] + p[i, 2] * f_bar[j, 2]
                pressure = (tau[0, 0] + tau[1, 1] + tau[2, 2]) / 3.0 if data.f_bar == 1 else 0.0
                power += weight * pressure
                g = g_all[q]
                for n in range(8):
                    for i in range(3):
                        s = tau[i, 0] * g[n, 0] + tau[i, 1] * g[n, 1] + tau[i, 2] * g[n, 2]
                        force[e, 3 * n + i] += weight * (s + pressure * (mean[n, i] - g[n, i]))
                if tangent:
                    local_tangent(status, law, w, a)
                    for n in range(8):
                        for i in range(3):
                            scaled[n, i] = scale * data.gradient[e, q, n, i]
                    _add_stiffness(g, scaled, a, weight, pressure, stiffness[e])
                    if data.f_bar == 1:
                        for mn in range(9):
                            s = 0.0
                            for i in range(3):
                                for j in range(3):
                                    s += f_bar[i, j] * a[3 * i + j, mn]
                            fa[mn] = s
                        bulk = 3.0 * pressure
                        for i in range(3):
                            for j in range(3):
                                bulk += fa[3 * i + j] * f_bar[i, j]
                        for n in range(8):
                            for i in range(3):
                                contracted[3 * n + i] = (
                                    fa[3 * i] * scaled[n, 0] + fa[3 * i + 1] * scaled[n, 1] + fa[3 * i + 2] * scaled[n, 2]
                                )
                        _add_mean_dilatation(g, mean, tau, contracted, weight, bulk, stiffness[e])
            if tangent:
                if data.f_bar == 1:
                    for q in range(8):
                        j_weight[q] /= volume * j_bar
                    _finish_mean_dilatation(g_all, j_weight, mean, power, stiffness[e])
                for i in range(24):
                    for j in range(i):
                        stiffness[e, i, j] = stiffness[e, j, i]
    return failed.sum()
