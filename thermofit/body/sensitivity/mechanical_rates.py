"""Direct differentiation of the mechanical step: nodal loads and new states of all elements along many directions at once.

At the converged end of a step f_int(u, theta, s_n, p) = f_ext, so that along a direction

    K u' = f_ext' - f_int'|_u,      s' = S_F F_bar' + S_theta theta' + S_s s_n' + S_p,

with K the consistent tangent there. `load_rates` gives f_int'|_u; `update_rates` gives, for u', the rates of state and dilatation and
all of f_int', which is what a u' found with a K that is not quite exact still misses:

    f_a' = sum_q M g_a + (P' - P (ln J_bar)') g_bar_a,
    M = w (tau' - p' 1) - w (tau - p 1) l^T + (P J w / sum J w) [(ln J)' 1 - l^T],   P = sum_q w p,

from the forces of body.element.hex8, with g_a' = -l^T g_a and l = F' F^-1. Rates carry their direction as last, contiguous axis of
length m, a multiple of LANES; each group of LANES directions goes through a point side by side.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from thermofit.body.element.hex8 import ElementData
from thermofit.body.element.lanes import SHAPE_BY_POINTS, element_kinematics
from thermofit.body.element.responses import States
from thermofit.body.element.stiffness import ELEMENT_ROWS, GRADIENT, J_WEIGHT, MEAN, Vector
from thermofit.core.jit import kernel
from thermofit.core.lanes import WIDTH, Lanes, multiply_add, spread
from thermofit.law.page import Law
from thermofit.law.page_rates import N_NUMBERS, Directions
from thermofit.law.tensor import Symmetric
from thermofit.point.lanes_fused import dot, product, product_added
from thermofit.point.lanes_memory import lane_sum, lane_workspace, number, prefetch_row, prefetch_rows, row, set_row
from thermofit.point.lanes_tensor import Tensor, full, set_tensor_rows, tensor_scaled, transposed
from thermofit.point.rates import (
    IS_PLASTIC,
    K_THETA,
    NUMBER_RATES,
    RESULT,
    ROWS,
    THETA_RATE,
    elastic_part,
    flow_rates,
    kirchhoff,
    nine,
    plastic_part_rates,
    pressure_rates,
    response_size,
    stress_rates,
    virgin_stress_rates,
)
from thermofit.point.relative_rates import relative_flow_rates, relative_stress_rates, stiffness_rate
from thermofit.point.state import ALPHA, BACK, LAMBDA, N_FULL, TRACE

_CHUNKS = 64


@kernel(forceinline=True)
def _tensor_at(values: np.ndarray, at: int, step: int) -> Tensor:
    """The general tensor in the rows at, at + step, ... of an array of lanes."""
    return (
        row(values, at), row(values, at + step), row(values, at + 2 * step),
        row(values, at + 3 * step), row(values, at + 4 * step), row(values, at + 5 * step),
        row(values, at + 6 * step), row(values, at + 7 * step), row(values, at + 8 * step),
    )  # fmt: skip


@kernel(forceinline=True)
def _plastic_part(state: np.ndarray, e: int, q: int) -> Tensor:
    """F_p^-1 of a point of states (n_el, 8, 11)."""
    return (
        state[e, q, 0], state[e, q, 1], state[e, q, 2],
        state[e, q, 3], state[e, q, 4], state[e, q, 5],
        state[e, q, 6], state[e, q, 7], state[e, q, 8],
    )  # fmt: skip


@kernel(forceinline=True)
def _set_numbers(along: Directions, group: int, w: np.ndarray) -> None:
    step = along.numbers.shape[1] // WIDTH
    for k in range(N_NUMBERS):
        set_row(w, NUMBER_RATES + k, row(along.numbers, k * step + group))


@kernel(forceinline=True)
def _at_point(nodal: np.ndarray, nodes: np.ndarray, q: int, group: int) -> Lanes:
    """Rates (n_np, m) of a nodal field at a Gauss point."""
    value, step = spread(0.0), nodal.shape[1] // WIDTH
    for a in range(8):
        value = multiply_add(number(SHAPE_BY_POINTS, a, q), row(nodal, nodes[a] * step + group), value)
    return value


@kernel(forceinline=True)
def _add_nodal(w: np.ndarray, q: int, m: Tensor, force: np.ndarray, at: int, step: int) -> None:
    """The 24 rows at, at + step, ... of force += M g_a of a point."""
    for a in range(8):
        g0, g1, g2 = number(w, GRADIENT + 3 * q, a), number(w, GRADIENT + 3 * q + 1, a), number(w, GRADIENT + 3 * q + 2, a)
        for i in range(3):
            k = at + (3 * a + i) * step
            value = multiply_add(m[3 * i], g0, row(force, k))
            set_row(force, k, multiply_add(m[3 * i + 2], g2, multiply_add(m[3 * i + 1], g1, value)))


@kernel(forceinline=True)
def _add_mean(w: np.ndarray, power: Lanes, force: np.ndarray, at: int, step: int) -> None:
    """The 24 rows at, at + step, ... of force += P g_bar_a."""
    for a in range(8):
        for i in range(3):
            k = at + (3 * a + i) * step
            set_row(force, k, multiply_add(power, number(w, MEAN + i, a), row(force, k)))


@kernel(forceinline=True)
def _deviator(tau: Symmetric, weight: float, f_bar: int) -> tuple[Tensor, Lanes]:
    """w (tau - p 1) and w p; p = 0 without F-bar."""
    p = (tau[0] + tau[1] + tau[2]) * (f_bar / 3.0)
    return tensor_scaled(full((tau[0] - p, tau[1] - p, tau[2] - p, tau[3], tau[4], tau[5])), weight), weight * p


@kernel(forceinline=True)
def _stress_at_fixed_f(
    c: np.ndarray,
    q: int,
    old: tuple[Tensor, Lanes, Lanes],
    theta: Lanes,
    f: Tensor,
    fp_n: Tensor,
    law: Law,
    along: Directions,
    w: np.ndarray,
) -> Symmetric:
    """tau' of a point whose F does not change: F_el' = F (F_p^-1)'; old = rates of its old state."""
    o = spread(0.0)
    fp_rate, active = old[0], (along.in_pressure, along.in_yield)
    if number(c, IS_PLASTIC, q) == 1.0:
        set_row(w, THETA_RATE, theta)
        y, _, _ = flow_rates(c, q, fp_rate, old[1], old[2], (o, o, o, o, o, o), law, active, w)
        fp_rate = plastic_part_rates(c, q, fp_n, fp_rate, y)
    return stress_rates(c, q, product(f, fp_rate), pressure_rates(c, q, theta, o, along.in_pressure, w), law, w)


@kernel
def _relative_stress_at_fixed_f(
    c: np.ndarray,
    q: int,
    rates_n: np.ndarray,
    place: tuple[int, int, bool],
    f: Tensor,
    fp_n: Tensor,
    law: Law,
    along: Directions,
    w: np.ndarray,
) -> Symmetric:
    """`_stress_at_fixed_f` where an effect changes the update itself, theta' standing in w; place = first row of the point in the rates of
    old states, distance of its rows, and whether it never yielded."""
    at, step, virgin = place
    o, base = spread(0.0), response_size(along.in_pressure.shape[0], along.in_yield.shape[0])
    fp_rate, accumulated = (o, o, o, o, o, o, o, o, o), o
    if not virgin:
        fp_rate, alpha, accumulated = _rates_at(rates_n, at, step)
        if number(c, IS_PLASTIC, q) == 1.0:
            back = (rates_n, at + BACK * step, step)
            strain = (o, o, o, o, o, o)
            y, _, accumulated = relative_flow_rates(c, q, base, fp_rate, alpha, accumulated, back, strain, law, along, w)
            fp_rate = plastic_part_rates(c, q, fp_n, fp_rate, y)
    k = pressure_rates(c, q, row(w, THETA_RATE), o, along.in_pressure, w)
    m_rate = stiffness_rate(c, q, base, (accumulated, row(w, THETA_RATE)), along, w)
    return relative_stress_rates(c, q, base, product(f, fp_rate), k, m_rate, law, w)


@kernel(parallel=True)
def load_rates(
    data: ElementData,
    u: np.ndarray,
    states: States,
    law: Law,
    along: Directions,
    response: np.ndarray,
    state_rates_n: np.ndarray,
    theta_rates: np.ndarray,
    out: np.ndarray,
) -> None:
    """f_int' at fixed u of every element into out (n_el, 24, m), N per unit of the direction.

    state_rates_n (n_el, 8, 11, m) rates of the old state; theta_rates (n_np, m).
    """
    state_n, state = states
    n_el, n_groups = data.hexes.shape[0], theta_rates.shape[1] // WIDTH
    for chunk in prange(_CHUNKS):
        w, point, f_rows = lane_workspace(ELEMENT_ROWS), lane_workspace(ROWS), lane_workspace(9)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            f, _ = element_kinematics(data, e, u, w)
            set_tensor_rows(f_rows, 0, f)
            c, nodes = response[e], data.hexes[e]
            out[e, :, :] = 0.0
            for group in range(n_groups):
                _set_numbers(along, group, point)
                power, force_at = spread(0.0), 24 * e * n_groups + group
                for q in range(8):
                    if group == 0:
                        _prefetch_next(data, response, out, e, q)
                    theta, n_state = _at_point(theta_rates, nodes, q, group), state_rates_n.shape[2]
                    if state[e, q, LAMBDA] != 0.0:
                        _prefetch_rates(state_rates_n, (8 * e + q) * n_state * n_groups + group, n_groups)
                    if along.structured:
                        place = ((8 * e + q) * n_state * n_groups + group, n_groups, state[e, q, LAMBDA] == 0.0)
                        set_row(point, THETA_RATE, theta)
                        f_q, fp_n = nine(f_rows, 0, q), _plastic_part(state_n, e, q)
                        tau = _relative_stress_at_fixed_f(c, q, state_rates_n, place, f_q, fp_n, law, along, point)
                    elif state[e, q, LAMBDA] == 0.0:
                        k = pressure_rates(c, q, theta, spread(0.0), along.in_pressure, point)
                        tau = virgin_stress_rates(c, q, k, point)
                    else:
                        old = _rates_at(state_rates_n, (8 * e + q) * n_state * n_groups + group, n_groups)
                        f_q, fp_n = nine(f_rows, 0, q), _plastic_part(state_n, e, q)
                        tau = _stress_at_fixed_f(c, q, old, theta, f_q, fp_n, law, along, point)
                    m, p = _deviator(tau, data.volume[e, q], data.f_bar)
                    power = power + p
                    _add_nodal(w, q, m, out, force_at, n_groups)
                if data.f_bar == 1:
                    _add_mean(w, power, out, force_at, n_groups)


@kernel(forceinline=True)
def _prefetch_rates(values: np.ndarray, at: int, step: int) -> None:
    """Have the rates of the next point fetched; those of this one begin at row `at`."""
    prefetch_rows(values, at + values.shape[2] * step, values.shape[2], step)


@kernel(forceinline=True)
def _prefetch_next(data: ElementData, response: np.ndarray, out: np.ndarray, e: int, q: int) -> None:
    """Have an eighth of what the next element will read, and write to `out` (n_el, 24, m), fetched."""
    n, n_groups = response.shape[1], out.shape[2] // WIDTH
    prefetch_rows(out, (24 * (e + 1) + 3 * q) * n_groups, 3 * n_groups, 1)
    prefetch_rows(response, (e + 1) * n + q, (n - q + 7) // 8, 8)
    prefetch_row(data.inverse_jacobian, 9 * (e + 1) + q)


@kernel(forceinline=True)
def _rates_at(values: np.ndarray, at: int, step: int) -> tuple[Tensor, Lanes, Lanes]:
    """Rates of F_p^-1, alpha, Lambda of a point, whose state begins at row `at`."""
    return _tensor_at(values, at, step), row(values, at + ALPHA * step), row(values, at + LAMBDA * step)


@kernel(parallel=True)
def thermal_load_rates(data: ElementData, u: np.ndarray, response: np.ndarray, theta_rates: np.ndarray, out: np.ndarray) -> None:
    """The part of `load_rates` that theta_rates (n_np, m) alone makes, out (n_el, 24, m): int dk/dtheta theta' g_bar dV."""
    n_el, n_groups = data.hexes.shape[0], theta_rates.shape[1] // WIDTH
    for chunk in prange(_CHUNKS):
        w, o = lane_workspace(ELEMENT_ROWS), spread(0.0)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            element_kinematics(data, e, u, w)
            nodes = data.hexes[e]
            out[e, :, :] = 0.0
            for group in range(n_groups):
                power, force_at = o, 24 * e * n_groups + group
                for q in range(8):
                    k = _at_point(theta_rates, nodes, q, group) * (data.volume[e, q] * response[e, K_THETA, q])
                    power = power + k
                    if data.f_bar != 1:
                        _add_nodal(w, q, (k, o, o, o, k, o, o, o, k), out, force_at, n_groups)
                if data.f_bar == 1:
                    _add_mean(w, power, out, force_at, n_groups)


@kernel(forceinline=True)
def _velocity_gradient(w: np.ndarray, nodes: np.ndarray, q: int, u_rates: np.ndarray, group: int) -> Tensor:
    """l = sum_a u_a' (x) g_a of a point."""
    o = spread(0.0)
    lv = (o, o, o, o, o, o, o, o, o)
    for a in range(8):
        g0, g1, g2 = number(w, GRADIENT + 3 * q, a), number(w, GRADIENT + 3 * q + 1, a), number(w, GRADIENT + 3 * q + 2, a)
        x, y, z = _vector(u_rates, nodes[a], group)
        lv = (
            multiply_add(g0, x, lv[0]), multiply_add(g1, x, lv[1]), multiply_add(g2, x, lv[2]),
            multiply_add(g0, y, lv[3]), multiply_add(g1, y, lv[4]), multiply_add(g2, y, lv[5]),
            multiply_add(g0, z, lv[6]), multiply_add(g1, z, lv[7]), multiply_add(g2, z, lv[8]),
        )  # fmt: skip
    return lv


@kernel(forceinline=True)
def _vector(u_rates: np.ndarray, node: int, group: int) -> Vector:
    at = 3 * (u_rates.shape[2] // WIDTH)
    step = u_rates.shape[2] // WIDTH
    return (row(u_rates, at * node + group), row(u_rates, at * node + step + group), row(u_rates, at * node + 2 * step + group))


@kernel(forceinline=True)
def _mean_dilatation(w: np.ndarray, nodes: np.ndarray, u_rates: np.ndarray, group: int) -> Lanes:
    """(ln J_bar)' = sum_a g_bar_a . u_a'."""
    value = spread(0.0)
    for a in range(8):
        x, y, z = _vector(u_rates, nodes[a], group)
        value = value + dot(number(w, MEAN, a), x, number(w, MEAN + 1, a), y, number(w, MEAN + 2, a), z)
    return value


@kernel(parallel=True)
def dilatation_rates(data: ElementData, u: np.ndarray, u_rates: np.ndarray, out: np.ndarray) -> None:
    """Rates of J that the material sees at every point, out (n_el, 8, m), by u' (n_np, 3, m)."""
    n_el, n_groups = data.hexes.shape[0], u_rates.shape[2] // WIDTH
    for chunk in prange(_CHUNKS):
        w, j_row = lane_workspace(ELEMENT_ROWS), lane_workspace(1)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            _, j = element_kinematics(data, e, u, w)
            set_row(j_row, 0, j)
            nodes = data.hexes[e]
            for group in range(n_groups):
                wanted = _mean_dilatation(w, nodes, u_rates, group)
                for q in range(8):
                    if data.f_bar != 1:
                        lv = _velocity_gradient(w, nodes, q, u_rates, group)
                        wanted = lv[0] + lv[4] + lv[8]
                    set_row(out, (8 * e + q) * n_groups + group, number(j_row, 0, q) * wanted)


@kernel(forceinline=True)
def _power(data: ElementData, e: int, c: np.ndarray) -> float:
    """P = sum_q w p of the stress at the end of the step; 0 without F-bar."""
    value = 0.0
    for q in range(8):
        tau = kirchhoff(c, q)
        value += data.volume[e, q] * (tau[0] + tau[1] + tau[2])
    return value * (data.f_bar / 3.0)


@kernel(parallel=True)
def update_rates(
    data: ElementData,
    u: np.ndarray,
    states: States,
    law: Law,
    along: Directions,
    response: np.ndarray,
    rates: tuple[np.ndarray, np.ndarray, np.ndarray],
    state_rates_new: np.ndarray,
    dilatation_rates: np.ndarray,
    forces: bool,
    force: np.ndarray,
) -> None:
    """Rates of the new state (n_el, 8, 11, m), of J (n_el, 8, m) and, if `forces`, of the internal forces, force (n_el, 24, m).

    rates = (u' (n_np, 3, m), rates of the old state (n_el, 8, 11, m), theta' (n_np, m)). A point that never yielded has none of its state:
    they stay the zeros that they are. Where no point flows, state_rates_new may be the rates of the old state themselves. Neither holds
    where moduli change with temperature: then every point has a rate of tr C_el.
    """
    state_n, state = states
    u_rates, state_rates_n, theta_rates = rates
    keeps = state_rates_new.ctypes.data == state_rates_n.ctypes.data
    n_el, n_groups = data.hexes.shape[0], theta_rates.shape[1] // WIDTH
    for chunk in prange(_CHUNKS):
        w, point, f_rows, o = lane_workspace(ELEMENT_ROWS), lane_workspace(ROWS), lane_workspace(10), spread(0.0)
        no_rate = (o, o, o, o, o, o, o, o, o)
        for e in range(chunk * n_el // _CHUNKS, (chunk + 1) * n_el // _CHUNKS):
            f, j = element_kinematics(data, e, u, w)
            set_tensor_rows(f_rows, 0, f)
            set_row(f_rows, 9, j)
            c, nodes, power = response[e], data.hexes[e], 0.0
            if forces:
                force[e, :, :] = 0.0
                power = _power(data, e, c)
            dilated = lane_sum(row(w, J_WEIGHT))
            for group in range(n_groups):
                _set_numbers(along, group, point)
                mean, power_rate, force_at = _mean_dilatation(w, nodes, u_rates, group), spread(0.0), 24 * e * n_groups + group
                for q in range(8):
                    if group == 0:
                        _prefetch_next(data, response, force, e, q)
                    virgin, point_at = state[e, q, LAMBDA] == 0.0, (8 * e + q) * n_groups
                    if (virgin or keeps) and not forces and not along.warms and data.f_bar == 1:
                        set_row(dilatation_rates, point_at + group, number(f_rows, 9, q) * mean)
                        continue
                    lv = _velocity_gradient(w, nodes, q, u_rates, group)
                    trace = lv[0] + lv[4] + lv[8]
                    dilatation = mean if data.f_bar == 1 else trace
                    set_row(dilatation_rates, point_at + group, number(f_rows, 9, q) * dilatation)
                    d = (dilatation - trace) * (1.0 / 3.0)
                    l_bar = (lv[0] + d, lv[1], lv[2], lv[3], lv[4] + d, lv[5], lv[6], lv[7], lv[8] + d)
                    theta = _at_point(theta_rates, nodes, q, group)
                    fp_rate, accumulated, at = no_rate, o, point_at * state_rates_n.shape[2] + group
                    if not virgin:
                        _prefetch_rates(state_rates_n, at, n_groups)
                        if not keeps:
                            _prefetch_rates(state_rates_new, at, n_groups)
                        if keeps:
                            fp_rate, accumulated = _tensor_at(state_rates_n, at, n_groups), row(state_rates_n, at + LAMBDA * n_groups)
                        elif along.structured:
                            set_row(point, THETA_RATE, theta)
                            fp_n = _plastic_part(state_n, e, q)
                            fp_rate = _new_relative_part(c, q, l_bar, state_rates_n, fp_n, law, along, point, state_rates_new, at, n_groups)
                            accumulated = row(state_rates_new, at + LAMBDA * n_groups)
                        else:
                            set_row(point, THETA_RATE, theta)
                            old, fp_n = _rates_at(state_rates_n, at, n_groups), _plastic_part(state_n, e, q)
                            fp_rate = _new_plastic_part(c, q, l_bar, old, fp_n, law, along, point, state_rates_new, at, n_groups)
                    if not forces and not along.warms:
                        continue
                    f_el_rate = product_added(product(l_bar, elastic_part(c, q)), nine(f_rows, 0, q), fp_rate)
                    if along.warms:
                        set_row(state_rates_new, at + TRACE * n_groups, _trace_rate(elastic_part(c, q), f_el_rate))
                        if not forces:
                            continue
                    k = pressure_rates(c, q, theta, dilatation, along.in_pressure, point)
                    if along.structured:
                        base = response_size(along.in_pressure.shape[0], along.in_yield.shape[0])
                        m_rate = stiffness_rate(c, q, base, (accumulated, theta), along, point)
                        tau = relative_stress_rates(c, q, base, f_el_rate, k, m_rate, law, point)
                    else:
                        tau = stress_rates(c, q, f_el_rate, k, law, point)
                    m, p = _deviator(tau, data.volume[e, q], data.f_bar)
                    power_rate = power_rate + p
                    stress, _ = _deviator(kirchhoff(c, q), data.volume[e, q], data.f_bar)
                    share = power * number(w, J_WEIGHT, q) / dilated
                    _add_nodal(w, q, _with_geometry(m, stress, lv, trace, share), force, force_at, n_groups)
                if forces and data.f_bar == 1:
                    _add_mean(w, power_rate - power * mean, force, force_at, n_groups)


@kernel(forceinline=True)
def _trace_rate(f_el: Tensor, f_el_rate: Tensor) -> Lanes:
    """(tr C_el)' = 2 F_el : F_el'."""
    value = f_el[0] * f_el_rate[0]
    for k in range(1, 9):
        value = multiply_add(f_el[k], f_el_rate[k], value)
    return 2.0 * value


@kernel(forceinline=True)
def _with_geometry(m: Tensor, stress: Tensor, lv: Tensor, trace: Lanes, share: float) -> Tensor:
    """w (tau' - p' 1) - w (tau - p 1) l^T + share [tr l 1 - l^T]."""
    t = product(stress, transposed(lv))
    return (
        m[0] - t[0] + share * (trace - lv[0]), m[1] - t[1] - share * lv[3], m[2] - t[2] - share * lv[6],
        m[3] - t[3] - share * lv[1], m[4] - t[4] + share * (trace - lv[4]), m[5] - t[5] - share * lv[7],
        m[6] - t[6] - share * lv[2], m[7] - t[7] - share * lv[5], m[8] - t[8] + share * (trace - lv[8]),
    )  # fmt: skip


@kernel(forceinline=True)
def _new_plastic_part(
    c: np.ndarray,
    q: int,
    lv: Tensor,
    old: tuple[Tensor, Lanes, Lanes],
    fp_n: Tensor,
    law: Law,
    along: Directions,
    w: np.ndarray,
    out: np.ndarray,
    at: int,
    step: int,
) -> Tensor:
    """(F_p^-1)' at the end of the step; all rates of the new state go into the rows at, at + step, ... of out."""
    fp_rate, alpha, accumulated = old
    if number(c, IS_PLASTIC, q) == 1.0:
        strain = (2.0 * lv[0], 2.0 * lv[4], 2.0 * lv[8], lv[1] + lv[3], lv[5] + lv[7], lv[2] + lv[6])
        y, alpha, accumulated = flow_rates(c, q, fp_rate, alpha, accumulated, strain, law, (along.in_pressure, along.in_yield), w)
        fp_rate = plastic_part_rates(c, q, fp_n, fp_rate, y)
    for k in range(9):
        set_row(out, at + k * step, fp_rate[k])
    set_row(out, at + ALPHA * step, alpha)
    set_row(out, at + LAMBDA * step, accumulated)
    return fp_rate


@kernel
def _new_relative_part(
    c: np.ndarray,
    q: int,
    lv: Tensor,
    rates_n: np.ndarray,
    fp_n: Tensor,
    law: Law,
    along: Directions,
    w: np.ndarray,
    out: np.ndarray,
    at: int,
    step: int,
) -> Tensor:
    """`_new_plastic_part` where an effect changes the update itself; the rates of the old state stand at the same rows of rates_n."""
    base = response_size(along.in_pressure.shape[0], along.in_yield.shape[0])
    fp_rate, alpha, accumulated = _rates_at(rates_n, at, step)
    if number(c, IS_PLASTIC, q) == 1.0:
        strain = (2.0 * lv[0], 2.0 * lv[4], 2.0 * lv[8], lv[1] + lv[3], lv[5] + lv[7], lv[2] + lv[6])
        back = (rates_n, at + BACK * step, step)
        y, alpha, accumulated = relative_flow_rates(c, q, base, fp_rate, alpha, accumulated, back, strain, law, along, w)
        fp_rate = plastic_part_rates(c, q, fp_n, fp_rate, y)
        for k in range(TRACE, N_FULL):
            set_row(out, at + k * step, row(w, RESULT + k - TRACE))
    else:
        for k in range(TRACE, N_FULL):
            set_row(out, at + k * step, row(rates_n, at + k * step))
    for k in range(9):
        set_row(out, at + k * step, fp_rate[k])
    set_row(out, at + ALPHA * step, alpha)
    set_row(out, at + LAMBDA * step, accumulated)
    return fp_rate


@kernel
def add_answer(equation: np.ndarray, x: np.ndarray, u: np.ndarray) -> None:
    """u (n_np, 3, m) += x (n_eq, m) by equation numbers (n_np, 3); prescribed dofs, with negative ones, stay."""
    for n in range(equation.shape[0]):
        for i in range(3):
            k = equation[n, i]
            if k >= 0:
                for m in range(u.shape[2]):
                    u[n, i, m] += x[k, m]
