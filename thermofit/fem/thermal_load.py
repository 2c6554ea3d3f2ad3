"""Forces of a change of temperature at a fixed deformation."""

from __future__ import annotations

import numpy as np
from numba import prange

from thermofit.core.jit import kernel
from thermofit.fem.element import ElementData
from thermofit.fem.kinematics import element_kinematics, kinematics_scratch, point_temperature
from thermofit.material.law import Law, pressure_factor

_CHUNKS = 64


@kernel(parallel=True)
def thermal_forces(data: ElementData, u: np.ndarray, theta: np.ndarray, warmer: np.ndarray, law: Law, force: np.ndarray) -> None:
    """Change of the internal forces (n_el, 24) in N at fixed u (n_np, 3) when the temperature goes from theta to warmer (n_np,) K.

    Only the pressure factor k of tau = mu b_el + k 1 (4.8) feels the temperature: int (k - k_0) g_bar dV.
    """
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        w = kinematics_scratch()
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            force[e, :] = 0.0
            j_bar = element_kinematics(data, e, u, w)
            for q in range(8):
                j = j_bar if data.f_bar == 1 else w.j_weight[q] / data.volume[e, q]
                log_j = np.log(j)
                after, _ = pressure_factor(log_j, j, point_temperature(data, e, q, warmer), law)
                before, _ = pressure_factor(log_j, j, point_temperature(data, e, q, theta), law)
                pressure = data.volume[e, q] * (after - before)
                for a in range(8):
                    for i in range(3):
                        force[e, 3 * a + i] += pressure * (w.mean[a, i] if data.f_bar == 1 else w.g[q, a, i])
