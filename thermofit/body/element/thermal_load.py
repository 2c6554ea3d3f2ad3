"""Forces of a change of temperature at a fixed deformation."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from thermofit.body.element.hex8 import ElementData
from thermofit.body.element.lanes import element_kinematics, point_temperatures, set_force
from thermofit.body.element.stiffness import ELEMENT_ROWS, GRADIENT, MEAN, vector_added, vector_rows
from thermofit.core.jit import kernel
from thermofit.core.lanes import spread
from thermofit.law.composition import modulus_factor, restructured, warm_moduli
from thermofit.law.page import Law, pressure_factor
from thermofit.law.tensor import scaled
from thermofit.point.lanes_memory import column, lane_sum, lane_workspace, number, row, set_row, set_vectors
from thermofit.point.lanes_tensor import outer_gram, product
from thermofit.point.rates import columns
from thermofit.point.state import LAMBDA

_CHUNKS = 64


@kernel(parallel=True)
def thermal_forces(
    data: ElementData, u: np.ndarray, state: np.ndarray, theta: np.ndarray, warmer: np.ndarray, law: Law, force: np.ndarray
) -> None:
    """Change of the internal forces (n_el, 24) in N at fixed u (n_np, 3) when the temperature goes from theta to warmer (n_np,) K.

    Only the pressure factor k of tau = mu b_el + k 1 (4.8) feels the temperature: int (k - k_0) g_bar dV, where the moduli have degraded
    times the factor on them at the points' state (n_el, 8, n). Where the moduli change with temperature, all of tau does.
    """
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        w, pressure = lane_workspace(ELEMENT_ROWS), lane_workspace(1)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            f, j = element_kinematics(data, e, u, w)
            log_j = math.log(j)
            after, _ = pressure_factor(log_j, j, point_temperatures(warmer, data.hexes[e]), law)
            before, _ = pressure_factor(log_j, j, point_temperatures(theta, data.hexes[e]), law)
            if law.effective == 1 and warm_moduli(law):
                accumulated, elastic = column(state[e], LAMBDA), outer_gram(product(f, columns(state[e])))
                warm = modulus_factor(accumulated, point_temperatures(warmer, data.hexes[e]), law)
                cold = modulus_factor(accumulated, point_temperatures(theta, data.hexes[e]), law)
                shear, k = scaled(elastic, law.mu * (warm - cold)), warm * after - cold * before
                tau = (shear[0] + k, shear[1] + k, shear[2] + k, shear[3], shear[4], shear[5])
                power = row(data.volume, e) * ((tau[0] + tau[1] + tau[2]) * (data.f_bar / 3.0))
                set_force(row(data.volume, e), power, tau, w, force[e])
                continue
            k = row(data.volume, e) * (after - before)
            if law.effective == 1 and restructured(law):
                k = k * modulus_factor(column(state[e], LAMBDA), point_temperatures(theta, data.hexes[e]), law)
            o = spread(0.0)
            if data.f_bar == 1:
                nodal = vector_added((o, o, o), vector_rows(w, MEAN), lane_sum(k))
            else:
                set_row(pressure, 0, k)
                nodal = (o, o, o)
                for q in range(8):
                    nodal = vector_added(nodal, vector_rows(w, GRADIENT + 3 * q), number(pressure, 0, q))
            set_vectors(force[e], 0, nodal[0], nodal[1], nodal[2])
