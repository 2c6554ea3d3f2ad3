"""The hex8 element: shape functions, F-bar kinematics, internal forces and their symmetric tangent.

F-bar in its variational (mean dilatation) form, whose tangent is as symmetric as that of the point: F_bar = (J_bar/J)^(1/3) F
with J_bar the element mean of J. Its virtual work is

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
from thermofit.material.point import INVERTED, NO_CONVERGENCE, PointWork, local_tangent, local_update, piola_stress, point_work
from thermofit.material.tensor import determinant, inverse_transpose

_CORNERS = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float)
_CHUNKS = 64
"""Parts into which the elements are divided for the threads; fixed, so that the scratch is few and the order the same."""
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


class ElementWork(NamedTuple):
    """Scratch of one thread for one element.

    `u` (8, 3) displacement of its nodes; `f` (8, 3, 3) F and `g` (8, 8, 3) g_a of its points; `mean` (8, 3) g_bar_a; `j_weight` (8,)
    J dV; of one point: `f_bar`, `p` stress P, `tau`, `a` (9, 9) dP/dF, `scaled` (8, 3) gradients that pair with a, `fa` (9,)
    F_bar : a, `h` and `m` (24,) the vectors of the mean dilatation; `q` (9, 3) scratch.
    """

    u: np.ndarray
    f: np.ndarray
    g: np.ndarray
    mean: np.ndarray
    j_weight: np.ndarray
    f_bar: np.ndarray
    f_inv_t: np.ndarray
    p: np.ndarray
    tau: np.ndarray
    a: np.ndarray
    scaled: np.ndarray
    fa: np.ndarray
    h: np.ndarray
    m: np.ndarray
    q: np.ndarray


@kernel(forceinline=True)
def _element_work() -> ElementWork:
    t = np.zeros((4, 3, 3))
    return ElementWork(
        u=np.zeros((8, 3)),
        f=np.zeros((8, 3, 3)),
        g=np.zeros((8, 8, 3)),
        mean=np.zeros((8, 3)),
        j_weight=np.zeros(8),
        f_bar=t[0],
        f_inv_t=t[1],
        p=t[2],
        tau=t[3],
        a=np.zeros((9, 9)),
        scaled=np.zeros((8, 3)),
        fa=np.zeros(9),
        h=np.zeros(24),
        m=np.zeros(24),
        q=np.zeros((9, 3)),
    )


@kernel(forceinline=True)
def _kinematics(data: ElementData, e: int, u: np.ndarray, w: ElementWork) -> float:
    """F and spatial gradients g_a = F^-T dN_a/dX of all points, mean gradients g_bar; returns J_bar, or -1 if inverted."""
    for a in range(8):
        for i in range(3):
            w.u[a, i] = u[data.hexes[e, a], i]
    volume = 0.0
    dilated = 0.0
    w.mean[:] = 0.0
    for q in range(8):
        f = w.f[q]
        for i in range(3):
            for j in range(3):
                s = 1.0 if i == j else 0.0
                for a in range(8):
                    s += w.u[a, i] * data.gradient[e, q, a, j]
                f[i, j] = s
        det = determinant(f)
        if not det > 0.0:
            return -1.0
        inverse_transpose(f, det, w.f_inv_t)
        volume += data.volume[e, q]
        w.j_weight[q] = data.volume[e, q] * det
        dilated += w.j_weight[q]
        for a in range(8):
            for i in range(3):
                s = 0.0
                for j in range(3):
                    s += w.f_inv_t[i, j] * data.gradient[e, q, a, j]
                w.g[q, a, i] = s
                w.mean[a, i] += w.j_weight[q] * s
    for a in range(8):
        for i in range(3):
            w.mean[a, i] /= dilated
    return dilated / volume


@kernel(forceinline=True)
def _point_temperature(data: ElementData, e: int, q: int, theta: np.ndarray) -> float:
    t = 0.0
    for a in range(8):
        t += data.shape[q, a] * theta[data.hexes[e, a]]
    return t


@kernel(forceinline=True)
def _add_force(w: ElementWork, q: int, weight: float, f_bar: int, force: np.ndarray) -> float:
    """force += weight [tau g_a + p (g_bar_a - g_a)], tau = P F_bar^T; returns p (0 without F-bar). Leaves tau in w."""
    for i in range(3):
        for j in range(3):
            w.tau[i, j] = w.p[i, 0] * w.f_bar[j, 0] + w.p[i, 1] * w.f_bar[j, 1] + w.p[i, 2] * w.f_bar[j, 2]
    pressure = (w.tau[0, 0] + w.tau[1, 1] + w.tau[2, 2]) / 3.0 if f_bar == 1 else 0.0
    g = w.g[q]
    for n in range(8):
        for i in range(3):
            s = w.tau[i, 0] * g[n, 0] + w.tau[i, 1] * g[n, 1] + w.tau[i, 2] * g[n, 2]
            force[3 * n + i] += weight * (s + pressure * (w.mean[n, i] - g[n, i]))
    return pressure


@kernel(forceinline=True)
def _add_stiffness(w: ElementWork, q: int, weight: float, pressure: float, k: np.ndarray) -> None:
    """k += weight [G_a A G_b + p g_b (x) g_a], upper blocks a <= b; `scaled` are the gradients that pair with A."""
    g, scaled, a, t = w.g[q], w.scaled, w.a, w.q
    for b in range(8):
        for ij in range(9):
            for m in range(3):
                t[ij, m] = weight * (a[ij, 3 * m] * scaled[b, 0] + a[ij, 3 * m + 1] * scaled[b, 1] + a[ij, 3 * m + 2] * scaled[b, 2])
        for n in range(b + 1):
            s0, s1, s2 = scaled[n, 0], scaled[n, 1], scaled[n, 2]
            for i in range(3):
                wp = weight * pressure * g[b, i]
                for m in range(3):
                    k[3 * n + i, 3 * b + m] += s0 * t[3 * i, m] + s1 * t[3 * i + 1, m] + s2 * t[3 * i + 2, m] + wp * g[n, m]


@kernel(forceinline=True)
def _add_mean_dilatation(w: ElementWork, q: int, weight: float, pressure: float, k: np.ndarray) -> None:
    """k += weight [h (x) m + m (x) h], h = (g_bar - g)/3, m = F_bar : a G + tau g + (F_bar : a : F_bar + 3p)/2 h; upper blocks."""
    g, scaled, fa = w.g[q], w.scaled, w.fa
    bulk = 3.0 * pressure
    for mn in range(9):
        s = 0.0
        for i in range(3):
            for j in range(3):
                s += w.f_bar[i, j] * w.a[3 * i + j, mn]
        fa[mn] = s
        bulk += s * w.f_bar[mn // 3, mn % 3]
    for b in range(8):
        for i in range(3):
            h = (w.mean[b, i] - g[b, i]) / 3.0
            s = 0.0
            for j in range(3):
                s += fa[3 * i + j] * scaled[b, j] + w.tau[i, j] * g[b, j]
            w.h[3 * b + i] = h
            w.m[3 * b + i] = weight * (s + 0.5 * bulk * h)
    for i in range(24):
        for j in range(3 * (i // 3), 24):
            k[i, j] += w.h[i] * w.m[j] + w.m[i] * w.h[j]


@kernel(forceinline=True)
def _finish_mean_dilatation(w: ElementWork, power: float, k: np.ndarray) -> None:
    """k += P [sum_q J w (g_a (x) g_b - g_b (x) g_a) / (V J_bar) - g_bar (x) g_bar], P = int p dV; upper blocks."""
    dilated = w.j_weight.sum()
    for q in range(8):
        c = power * w.j_weight[q] / dilated
        g = w.g[q]
        for b in range(8):
            for n in range(b):
                for i in range(2):
                    for m in range(i + 1, 3):
                        v = c * (g[n, i] * g[b, m] - g[n, m] * g[b, i])
                        k[3 * n + i, 3 * b + m] += v
                        k[3 * n + m, 3 * b + i] -= v
    for b in range(8):
        for n in range(b + 1):
            for i in range(3):
                for m in range(3):
                    k[3 * n + i, 3 * b + m] -= power * w.mean[n, i] * w.mean[b, m]


@kernel(forceinline=True)
def _mirror(k: np.ndarray) -> None:
    for i in range(24):
        for j in range(i):
            k[i, j] = k[j, i]


@kernel(forceinline=True)
def _one_element(
    data: ElementData,
    e: int,
    u: np.ndarray,
    theta: np.ndarray,
    state_n: np.ndarray,
    law: Law,
    tangent: bool,
    w: ElementWork,
    point: PointWork,
    force: np.ndarray,
    stiffness: np.ndarray,
    state: np.ndarray,
    dilatation: np.ndarray,
) -> bool:
    """`element_pass` of element e; False where a point is inverted or its update does not converge."""
    force[:] = 0.0
    j_bar = _kinematics(data, e, u, w)
    if j_bar <= 0.0:
        return False
    power = 0.0
    for q in range(8):
        weight = data.volume[e, q]
        det = w.j_weight[q] / weight
        scale = (j_bar / det) ** (1.0 / 3.0) if data.f_bar == 1 else 1.0
        for i in range(3):
            for j in range(3):
                w.f_bar[i, j] = scale * w.f[q, i, j]
        status = local_update(w.f_bar, _point_temperature(data, e, q, theta), state_n[q], law, point, state[q])
        if status == NO_CONVERGENCE or status == INVERTED:
            return False
        dilatation[q] = j_bar if data.f_bar == 1 else det
        piola_stress(w.f_bar, law, point, w.p)
        pressure = _add_force(w, q, weight, data.f_bar, force)
        power += weight * pressure
        if tangent:
            local_tangent(status, law, point, w.a)
            for n in range(8):
                for i in range(3):
                    w.scaled[n, i] = scale * data.gradient[e, q, n, i]
            _add_stiffness(w, q, weight, pressure, stiffness)
            if data.f_bar == 1:
                _add_mean_dilatation(w, q, weight, pressure, stiffness)
    if tangent:
        if data.f_bar == 1:
            _finish_mean_dilatation(w, power, stiffness)
        _mirror(stiffness)
    return True


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
    failed = np.zeros(_CHUNKS, dtype=np.int64)
    for chunk in prange(_CHUNKS):
        w, point = _element_work(), point_work()
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            if tangent:
                stiffness[e, :, :] = 0.0
            if not _one_element(data, e, u, theta, state_n[e], law, tangent, w, point, force[e], stiffness[e], state[e], dilatation[e]):
                failed[chunk] += 1
    return failed.sum()
