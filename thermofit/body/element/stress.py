"""Deformation and stress at every point of a state, for pictures and other programmes; the solver has its own, lane by lane."""

from __future__ import annotations

import numpy as np

from thermofit.body.element.hex8 import ElementData
from thermofit.law.page import Law
from thermofit.law.page_rates import set_pressure


def deformation_gradients(data: ElementData, u: np.ndarray, dilatation: np.ndarray) -> np.ndarray:
    """F_bar = (J_bar / J)^(1/3) F (n_el, 8, 3, 3), the deformation gradient that the material sees, of determinant `dilatation` (n_el, 8);
    u (n_np, 3) mm."""
    f = np.eye(3) + np.einsum("eai,eqaj->eqij", u[data.hexes], data.gradient)
    return np.asarray(f * np.cbrt(dilatation / np.linalg.det(f))[..., None, None])


def cauchy_stress(data: ElementData, f: np.ndarray, theta: np.ndarray, points: np.ndarray, dilatation: np.ndarray, law: Law) -> np.ndarray:
    """sigma = (mu F C_p^-1 F^T + k I) / J in MPa (4.8), (n_el, 8, 3, 3), with respect to x, y, z.

    f of `deformation_gradients`, theta (n_np,) K, points (n_el, 8, 11) and the J (n_el, 8) that the material sees, as a march leaves them.
    """
    fp_inv = points[..., :9].reshape(*points.shape[:2], 3, 3)
    elastic = f @ fp_inv
    k = np.empty(dilatation.shape)
    set_pressure(np.log(dilatation), np.ascontiguousarray(theta[data.hexes] @ data.shape.T), law, k)
    stress = law.mu * elastic @ np.swapaxes(elastic, -1, -2) + k[..., None, None] * np.eye(3)
    return np.asarray(stress / dilatation[..., None, None])
