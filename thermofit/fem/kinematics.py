"""Kinematics of one hex8 element, point by point: F, spatial gradients and their mean, for passes that need no stress update."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from thermofit.core.jit import kernel
from thermofit.fem.element import ElementData
from thermofit.material.tensor import determinant, inverse_transpose


class Kinematics(NamedTuple):
    """Scratch of one thread for one element: `u` (8, 3) displacement of its nodes; `f` (8, 3, 3) F and `g` (8, 8, 3) g_a = F^-T dN_a/dX
    of its points; `mean` (8, 3) g_bar_a; `j_weight` (8,) J dV; `f_inv_t` (3, 3) F^-T of a point."""

    u: np.ndarray
    f: np.ndarray
    g: np.ndarray
    mean: np.ndarray
    j_weight: np.ndarray
    f_inv_t: np.ndarray


@kernel(forceinline=True)
def kinematics_scratch() -> Kinematics:
    """Fresh scratch of one thread."""
    return Kinematics(np.zeros((8, 3)), np.zeros((8, 3, 3)), np.zeros((8, 8, 3)), np.zeros((8, 3)), np.zeros(8), np.zeros((3, 3)))


@kernel(forceinline=True)
def element_kinematics(data: ElementData, e: int, u: np.ndarray, w: Kinematics) -> float:
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
def point_temperature(data: ElementData, e: int, q: int, theta: np.ndarray) -> float:
    """Temperature of a point from nodal ones (n_np,), K."""
    t = 0.0
    for a in range(8):
        t += data.shape[q, a] * theta[data.hexes[e, a]]
    return t
