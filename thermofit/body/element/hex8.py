"""The hex8 element: shape functions, F-bar kinematics, internal forces and their symmetric tangent.

F-bar in its variational (mean dilatation) form, whose tangent is as symmetric as that of the point: F_bar = (J_bar/J)^(1/3) F
with J_bar the element mean of J. Its virtual work is

    int P(F_bar) : delta F_bar dV = int [dev tau : grad w + p g_bar . w] dV,   g_bar_a = int J g_a dV / (V J_bar),

tau = P F_bar^T Kirchhoff stress, p = tr tau / 3, g_a = F^-T dN_a/dX. Isochoric plastic flow does not lock it. Standard full
integration is F_bar = F.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from thermofit.body.element.lanes import one_element, prefetch_element
from thermofit.body.element.shape import GAUSS_POINTS, SHAPE, ElementData, element_data, reference_gradients, shape_functions
from thermofit.body.element.stiffness import ELEMENT_ROWS
from thermofit.core.jit import kernel
from thermofit.law.page import Law
from thermofit.point.lanes_memory import lane_workspace, prefetch_rows
from thermofit.point.lanes_rows import POINT_ROWS

__all__ = ["GAUSS_POINTS", "SHAPE", "ElementData", "element_data", "element_pass", "reference_gradients", "shape_functions"]

_CHUNKS = 64
"""Parts into which the elements are divided for the threads; fixed, so that the scratch is few and the order the same."""


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
        w, point = lane_workspace(ELEMENT_ROWS), lane_workspace(POINT_ROWS)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            prefetch_element(data, e + 1, state_n, state)
            if tangent:
                prefetch_rows(stiffness, 72 * (e + 1), 72, 1)
            if not one_element(data, e, u, theta, state_n[e], law, tangent, w, point, force[e], stiffness[e], state[e], dilatation[e]):
                failed[chunk] += 1
    return failed.sum()
