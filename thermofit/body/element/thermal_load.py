"""Forces of a change of temperature at a fixed deformation."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from thermofit.body.element.hex8 import ElementData
from thermofit.body.element.lanes import element_kinematics, point_temperatures
from thermofit.body.element.stiffness import ELEMENT_ROWS, GRADIENT, MEAN, vector_added, vector_rows
from thermofit.core.jit import kernel
from thermofit.core.lanes import spread
from thermofit.law.composition import modulus_factor, restructured
from thermofit.law.page import Law, pressure_factor
from thermofit.point.lanes_memory import column, lane_sum, lane_workspace, number, row, set_row, set_vectors
from thermofit.point.state import LAMBDA

_CHUNKS = 64


@kernel(parallel=True)
def thermal_forces(
    data: ElementData, u: np.ndarray, state: np.ndarray, theta: np.ndarray, warmer: np.ndarray, law: Law, force: np.ndarray
) -> None:
    """Change of the internal forces (n_el, 24) in N at fixed u (n_np, 3) when the temperature goes from theta to warmer (n_np,) K.

    Only the pressure factor k of tau = mu b_el + k 1 (4.8) feels the temperature: int (k - k_0) g_bar dV, where the moduli have degraded
    times the factor on them at the points' state (n_el, 8, n).
    """
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        w, pressure = lane_workspace(ELEMENT_ROWS), lane_workspace(1)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            _, j = element_kinematics(data, e, u, w)
            log_j = math.log(j)
            after, _ = pressure_factor(log_j, j, point_temperatures(warmer, data.hexes[e]), law)
            before, _ = pressure_factor(log_j, j, point_temperatures(theta, data.hexes[e]), law)
            k = row(data.volume, e) * (after - before)
            if law.effective == 1 and restructured(law):
                k = k * modulus_factor(column(state[e], LAMBDA), law)
            o = spread(0.0)
            if data.f_bar == 1:
                f = vector_added((o, o, o), vector_rows(w, MEAN), lane_sum(k))
            else:
                set_row(pressure, 0, k)
                f = (o, o, o)
                for q in range(8):
                    f = vector_added(f, vector_rows(w, GRADIENT + 3 * q), number(pressure, 0, q))
            set_vectors(force[e], 0, f[0], f[1], f[2])
