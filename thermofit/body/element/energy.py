"""Internal energy of the body: the law's e = psi + theta eta at every point, with the kinematics of the element.

First law of the whole specimen: its change over a step is the work of the load plus the heat that came in through the surface.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from thermofit.body.element.hex8 import ElementData
from thermofit.body.heat.structure import stored_squares
from thermofit.core.jit import kernel
from thermofit.law.composition import backstress_terms, modulus_factor, warm_moduli
from thermofit.law.page import Law, elastic_energy, internal_energy
from thermofit.law.structure import energy_slope
from thermofit.law.tensor import determinant
from thermofit.point.state import ALPHA, LAMBDA, N_BACK, N_FULL

_CHUNKS = 64


@kernel(forceinline=True)
def _elastic_trace(f: np.ndarray, state: np.ndarray) -> float:
    """tr C_el = |F F_p^-1|^2 of a point; state (11,) holds F_p^-1 row by row."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            s = f[i, 0] * state[j] + f[i, 1] * state[3 + j] + f[i, 2] * state[6 + j]
            total += s * s
    return total


@kernel
def _structure_energy(
    trace: float, log_j: float, j: float, theta: float, state: np.ndarray, squares: np.ndarray, e: int, q: int, law: Law
) -> float:
    """What changed moduli and backstresses (law.structure) add to the internal energy psi - theta dpsi/dtheta, mJ/mm^3; squares
    (N_BACK, n_el, 8) are twice the energies of the backstresses over their moduli."""
    stiff, free = modulus_factor(state[LAMBDA], theta, law), elastic_energy(trace, log_j, law)
    rest = 3.0 * law.alpha_exp * law.bulk * law.theta_ref * log_j / j
    energy = (stiff - 1.0) * (free + rest)
    if warm_moduli(law):
        coupling = -3.0 * law.alpha_exp * law.bulk * (theta - law.theta_ref) * log_j / j
        energy = stiff * (free + coupling) - theta * energy_slope(trace, log_j, state[LAMBDA], theta, law) - free - rest
    terms = backstress_terms(state[LAMBDA], 0.0, theta, law)
    for i in range(N_BACK):
        energy += 0.5 * terms[i][0] * squares[i, e, q]
    return energy


@kernel(parallel=True)
def _energies(
    data: ElementData,
    u: np.ndarray,
    theta: np.ndarray,
    state: np.ndarray,
    squares: np.ndarray,
    dilatation: np.ndarray,
    law: Law,
    out: np.ndarray,
) -> None:
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        f = np.empty((3, 3))
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            for q in range(8):
                t = 0.0
                for i in range(3):
                    for j in range(3):
                        f[i, j] = 1.0 if i == j else 0.0
                for a in range(8):
                    node = data.hexes[e, a]
                    t += data.shape[q, a] * theta[node]
                    for i in range(3):
                        for j in range(3):
                            f[i, j] += u[node, i] * data.gradient[e, q, a, j]
                point, det = state[e, q], dilatation[e, q]
                trace = _elastic_trace(f, point) * (det / determinant(f)) ** (2.0 / 3.0)  # of F_bar, whose J is `dilatation`
                density = internal_energy(trace, np.log(det), det, t, point[ALPHA], point[LAMBDA], law)
                if state.shape[2] == N_FULL:
                    density += _structure_energy(trace, np.log(det), det, t, point, squares, e, q, law)
                out[e] += data.volume[e, q] * density


def internal_energy_of(data: ElementData, u: np.ndarray, theta: np.ndarray, state: np.ndarray, dilatation: np.ndarray, law: Law) -> float:
    """int e dV of the model in mJ, zero in the stress-free reference state.

    u (n_np, 3) mm, theta (n_np,) K, state (n_el, 8, n) and the J (n_el, 8) that the material sees, as `element_pass` leaves them.
    """
    out = np.zeros(len(data.hexes))
    squares = stored_squares(state, law) if state.shape[2] == N_FULL else np.empty((0, 0, 0))
    _energies(data, u, theta, state, squares, dilatation, law, out)
    return float(out.sum())
