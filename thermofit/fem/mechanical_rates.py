"""Direct differentiation of the mechanical step: nodal loads and new states of all elements along many directions at once.

At the converged end of a step f_int(u, theta, s_n, p) = f_ext, so that along a direction

    K u' = f_ext' - f_int'|_u,      s' = S_F F_bar' + S_theta theta' + S_s s_n' + S_p,

with K the consistent tangent there. `load_rates` gives f_int'|_u, `update_rates` the rates of state and dilatation from u'.
Rates carry their direction as last, contiguous axis of length m, a multiple of LANES (material.rates).
"""

from __future__ import annotations

import numpy as np
from numba import prange

from thermofit.core.jit import kernel
from thermofit.fem.element import ElementData
from thermofit.fem.kinematics import Kinematics, element_kinematics, kinematics_scratch, point_temperature
from thermofit.material.law import Law
from thermofit.material.law_rates import LANES, N_NUMBERS, Directions
from thermofit.material.point import LAMBDA, N_STATE
from thermofit.material.rates import (
    FP_INV,
    K_THETA,
    NUMBERS,
    STATE,
    STRAIN,
    TAU,
    THETA,
    point_response,
    set_point,
    state_rates,
    stress_rates,
    workspace_size,
)
from thermofit.material.tuples import Tensor

_CHUNKS = 64


@kernel(forceinline=True)
def _stretched(w: Kinematics, data: ElementData, e: int, q: int, j_bar: float) -> tuple[Tensor, float]:
    """F_bar of a point and the J that its material sees."""
    det = w.j_weight[q] / data.volume[e, q]
    s = (j_bar / det) ** (1.0 / 3.0) if data.f_bar == 1 else 1.0
    f = w.f[q]
    stretched = (
        s * f[0, 0], s * f[0, 1], s * f[0, 2], s * f[1, 0], s * f[1, 1], s * f[1, 2], s * f[2, 0], s * f[2, 1], s * f[2, 2],
    )  # fmt: skip
    return stretched, j_bar if data.f_bar == 1 else det


@kernel(parallel=True)
def responses(
    data: ElementData,
    u: np.ndarray,
    theta: np.ndarray,
    state_n: np.ndarray,
    state: np.ndarray,
    law: Law,
    along: Directions,
    out: np.ndarray,
) -> None:
    """Response of all points at the converged end of a step into out (n_el, 8, n_response): `material.rates.point_response`.

    u (n_np, 3) mm, theta (n_np,) K, state_n and state (n_el, 8, 11) before and after the step.
    """
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        w = kinematics_scratch()
        scratch = (np.empty((6, 6)), np.empty((6, 6)), np.zeros((2, 3 + N_NUMBERS)))
        active = (along.in_pressure, along.in_yield)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            j_bar = element_kinematics(data, e, u, w)
            for q in range(8):
                f, j = _stretched(w, data, e, q, j_bar)
                t = point_temperature(data, e, q, theta)
                point_response(f, np.log(j), t, state_n[e, q], state[e, q], law, active, scratch, out[e, q])


@kernel(forceinline=True)
def _gather(values: np.ndarray, n: int, first: int, w: np.ndarray, row: int) -> None:
    """n rows of `values` (n, m), lanes from `first` on, into rows of the workspace."""
    for k in range(n):
        for m in range(LANES):
            w[(row + k) * LANES + m] = values[k, first + m]


@kernel(forceinline=True)
def _temperature_rates(data: ElementData, e: int, q: int, theta_rates: np.ndarray, first: int, w: np.ndarray) -> None:
    for m in range(LANES):
        w[THETA * LANES + m] = 0.0
    for a in range(8):
        node, n = data.hexes[e, a], data.shape[q, a]
        for m in range(LANES):
            w[THETA * LANES + m] += n * theta_rates[node, first + m]


@kernel(forceinline=True)
def _add_force_rates(el: Kinematics, q: int, weight: float, f_bar: int, w: np.ndarray, first: int, force: np.ndarray) -> None:
    """force += weight [tau' g_a + p' (g_bar_a - g_a)] with p' = tr tau' / 3 (0 without F-bar); force (24, m)."""
    t = TAU * LANES
    if f_bar == 1:
        for m in range(LANES):
            p = (w[t + m] + w[t + 8 + m] + w[t + 16 + m]) / 3.0
            w[t + m] -= p
            w[t + 8 + m] -= p
            w[t + 16 + m] -= p
            w[STATE * LANES + m] = p
    else:
        for m in range(LANES):
            w[STATE * LANES + m] = 0.0
    for a in range(8):
        g0, g1, g2 = weight * el.g[q, a, 0], weight * el.g[q, a, 1], weight * el.g[q, a, 2]
        h0, h1, h2 = weight * el.mean[a, 0], weight * el.mean[a, 1], weight * el.mean[a, 2]
        for m in range(LANES):
            t12, t23, t13, p = w[t + 24 + m], w[t + 32 + m], w[t + 40 + m], w[STATE * LANES + m]
            force[3 * a, first + m] += w[t + m] * g0 + t12 * g1 + t13 * g2 + p * h0
            force[3 * a + 1, first + m] += t12 * g0 + w[t + 8 + m] * g1 + t23 * g2 + p * h1
            force[3 * a + 2, first + m] += t13 * g0 + t23 * g1 + w[t + 16 + m] * g2 + p * h2


@kernel(parallel=True)
def load_rates(
    data: ElementData,
    u: np.ndarray,
    states: tuple[np.ndarray, np.ndarray],
    law: Law,
    along: Directions,
    response: np.ndarray,
    state_rates_n: np.ndarray,
    theta_rates: np.ndarray,
    out: np.ndarray,
) -> None:
    """f_int' at fixed u of every element into out (n_el, 24, m), N per unit of the direction.

    states = (state_n, state) each (n_el, 8, 11); state_rates_n (n_el, 8, 11, m); theta_rates (n_np, m).
    """
    state_n, state = states
    n_el = data.hexes.shape[0]
    n_groups = theta_rates.shape[1] // LANES
    for chunk in prange(_CHUNKS):
        el = kinematics_scratch()
        w = np.zeros(workspace_size(response.shape[2]))
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            j_bar = element_kinematics(data, e, u, el)
            out[e, :, :] = 0.0
            for q in range(8):
                f, _ = _stretched(el, data, e, q, j_bar)
                set_point(f, state_n[e, q], state[e, q], response[e, q], w)
                for group in range(n_groups):
                    first = group * LANES
                    _gather(along.numbers, N_NUMBERS, first, w, NUMBERS)
                    _gather(state_rates_n[e, q], N_STATE, first, w, FP_INV)
                    _temperature_rates(data, e, q, theta_rates, first, w)
                    virgin = state[e, q, LAMBDA] == 0.0
                    stress_rates(w, law, along.in_pressure, along.in_yield, along.hill[group] == 1, virgin)
                    _add_force_rates(el, q, data.volume[e, q], data.f_bar, w, first, out[e])


@kernel(parallel=True)
def thermal_load_rates(data: ElementData, u: np.ndarray, response: np.ndarray, theta_rates: np.ndarray, out: np.ndarray) -> None:
    """The part of `load_rates` that theta_rates (n_np, m) alone makes, out (n_el, 24, m): int dk/dtheta theta' g_bar dV."""
    n_el = data.hexes.shape[0]
    for chunk in prange(_CHUNKS):
        el = kinematics_scratch()
        w = np.zeros((THETA + 1) * LANES)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            element_kinematics(data, e, u, el)
            out[e, :, :] = 0.0
            for first in range(0, theta_rates.shape[1], LANES):
                for q in range(8):
                    _temperature_rates(data, e, q, theta_rates, first, w)
                    factor = data.volume[e, q] * response[e, q, K_THETA]
                    for a in range(8):
                        for i in range(3):
                            g = factor * (el.mean[a, i] if data.f_bar == 1 else el.g[q, a, i])
                            for m in range(LANES):
                                out[e, 3 * a + i, first + m] += g * w[THETA * LANES + m]


@kernel(forceinline=True)
def _mean_dilatation_rates(data: ElementData, e: int, el: Kinematics, u_rates: np.ndarray, out: np.ndarray) -> None:
    """(ln J_bar)' = sum_a g_bar_a . u_a' into out (m,)."""
    out[:] = 0.0
    for a in range(8):
        node = data.hexes[e, a]
        for i in range(3):
            g = el.mean[a, i]
            for m in range(out.shape[0]):
                out[m] += g * u_rates[node, i, m]


@kernel(forceinline=True)
def _strain_rates(
    data: ElementData, e: int, q: int, el: Kinematics, u_rates: np.ndarray, dilatation: np.ndarray, first: int, w: np.ndarray
) -> None:
    """l + l^T of F_bar (rows STRAIN), l = sum_a u_a' (x) g_a + 1/3 [(ln J_bar)' - tr l] 1; (ln J)' of the material in row STATE."""
    s = STRAIN * LANES
    for k in range(6 * LANES):
        w[s + k] = 0.0
    for a in range(8):
        node = data.hexes[e, a]
        g0, g1, g2 = el.g[q, a, 0], el.g[q, a, 1], el.g[q, a, 2]
        for m in range(LANES):
            u0, u1, u2 = u_rates[node, 0, first + m], u_rates[node, 1, first + m], u_rates[node, 2, first + m]
            w[s + m] += 2.0 * u0 * g0
            w[s + 8 + m] += 2.0 * u1 * g1
            w[s + 16 + m] += 2.0 * u2 * g2
            w[s + 24 + m] += u0 * g1 + u1 * g0
            w[s + 32 + m] += u1 * g2 + u2 * g1
            w[s + 40 + m] += u0 * g2 + u2 * g0
    for m in range(LANES):
        trace = 0.5 * (w[s + m] + w[s + 8 + m] + w[s + 16 + m])
        wanted = dilatation[first + m] if data.f_bar == 1 else trace
        spread = 2.0 / 3.0 * (wanted - trace)
        w[s + m] += spread
        w[s + 8 + m] += spread
        w[s + 16 + m] += spread
        w[STATE * LANES + m] = wanted


@kernel(parallel=True)
def update_rates(
    data: ElementData,
    u: np.ndarray,
    states: tuple[np.ndarray, np.ndarray],
    law: Law,
    along: Directions,
    response: np.ndarray,
    u_rates: np.ndarray,
    state_rates_n: np.ndarray,
    state_rates_new: np.ndarray,
    dilatation_rates: np.ndarray,
) -> None:
    """Rates of the new state (n_el, 8, 11, m) and of J (n_el, 8, m) from u_rates (n_np, 3, m) and the rates of the old state."""
    state_n, state = states
    n_el = data.hexes.shape[0]
    n_lanes = u_rates.shape[2]
    for chunk in prange(_CHUNKS):
        el = kinematics_scratch()
        w = np.zeros(workspace_size(response.shape[2]))
        mean_rates = np.zeros(n_lanes)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            j_bar = element_kinematics(data, e, u, el)
            _mean_dilatation_rates(data, e, el, u_rates, mean_rates)
            for q in range(8):
                f, j = _stretched(el, data, e, q, j_bar)
                set_point(f, state_n[e, q], state[e, q], response[e, q], w)
                for group in range(n_lanes // LANES):
                    first = group * LANES
                    _strain_rates(data, e, q, el, u_rates, mean_rates, first, w)
                    for m in range(LANES):
                        dilatation_rates[e, q, first + m] = j * w[STATE * LANES + m]
                    if state[e, q, LAMBDA] == 0.0:
                        state_rates_new[e, q, :, first : first + LANES] = state_rates_n[e, q, :, first : first + LANES]
                        continue
                    _gather(along.numbers, N_NUMBERS, first, w, NUMBERS)
                    _gather(state_rates_n[e, q], N_STATE, first, w, FP_INV)
                    state_rates(w, law, along.in_yield, len(along.in_pressure), along.hill[group] == 1)
                    for k in range(N_STATE):
                        for m in range(LANES):
                            state_rates_new[e, q, k, first + m] = w[(STATE + k) * LANES + m]
