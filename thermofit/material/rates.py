"""Rates of the local update: how stress and state of a point change along many directions at once (direct differentiation).

A rate, written x', is the derivative of x along a direction, for example by one parameter. With D = gamma N, y = exp(-D),
C_tr = F_tr^T F_tr, C = y C_tr y (material.point), n = |C|_G, r = gamma / n, differentiation of the converged update gives

    C_tr' = X + X^T + F_tr^T (l + l^T) F_tr,    X = F_tr^T F (F_p(n)^-1)',    l = F' F^-1
    D'    = gamma' N + r [(G - N N) : C' + e'],    e' = G' : C - N h',    h' = C : G' : C / (2 n)
    C'    = y C_tr' y + S : D',    S : D' = y' C_tr y + y C_tr y',    y' = Y : D'
    mu (N : C' + h') + mu' n = sigma_y'  along  gamma', alpha_n', Lambda_n' and the numbers of the law.

Eliminated: C' = A (y C_tr' y + r S e') + gamma' A S N with A = [1 - r S (G - N N)]^-1. `point_response` forms A, S, Y once per point; a
direction then costs a few small products. All directions of a group of LANES go through the same loop side by side, in one
flat workspace: row r of it holds one scalar for all lanes, and the numbers of the point follow behind the rows.
"""

from __future__ import annotations

import numpy as np

from thermofit.core.jit import kernel
from thermofit.material.law import Law
from thermofit.material.law_rates import HILL, LANES, MU, N_NUMBERS, pressure_gradient, yield_gradient
from thermofit.material.point import ALPHA, LAMBDA, flow_direction, hill
from thermofit.material.tensor import (
    Symmetric,
    added,
    congruence,
    double_contraction,
    exponential,
    exponential_derivative,
    scaled,
    solve_in_place,
)
from thermofit.material.tuples import (
    Tensor,
    mixed_congruence,
    product,
    product_symmetric,
    pulled_back,
    square,
    total,
    transposed,
    twice_symmetric_part,
)

# Rows of the workspace: one scalar for each lane.
FP_INV, ALPHA_N, LAMBDA_N, THETA = 0, 9, 10, 11
"""Given: (F_p(n)^-1)', alpha_n', Lambda_n', theta'."""
STRAIN = 12
"""Given: l + l^T (6)."""
NUMBERS = 18
"""Given: rates of the numbers of the law."""
STATE = NUMBERS + N_NUMBERS
"""Result: rates of the new state (11)."""
TAU = STATE + 11
"""Result: rate of the Kirchhoff stress at fixed F (6)."""
_Q, _B, _E, _H, _SIGMA, _ALPHA, _K, _Y = TAU + 6, TAU + 15, TAU + 21, TAU + 27, TAU + 28, TAU + 29, TAU + 30, TAU + 31
N_ROWS = TAU + 37

# Numbers of the point, behind the rows.
_POINT = N_ROWS * LANES
_F, _FP_N, _F_TRIAL, _X, _F_EL, _B_EL = _POINT, _POINT + 9, _POINT + 18, _POINT + 27, _POINT + 36, _POINT + 45
_RESPONSE = _POINT + 51
# Places in the response of a point, which `point_response` keeps from one pass to the next.
IS_PLASTIC, K_THETA, NORM, RATIO, BY_ALPHA, BY_LAMBDA, ALPHA_BY_ALPHA, ALPHA_BY_GAMMA, DENOMINATOR = range(9)
_FLOW, _ALONG, _C, _EXP = 9, 15, 21, 27
_A, _S, _DY = 33, 69, 105
_GRADIENTS = 141
"""Gradients by the active numbers: pressure, yield stress, alpha."""
_UNIT = np.eye(6)


def response_size(n_pressure: int, n_yield: int) -> int:
    """Length of a point's response for so many active numbers in pressure and yield stress."""
    return _GRADIENTS + n_pressure + 2 * n_yield


@kernel
def workspace_size(n_response: int) -> int:
    """Length of the workspace of one thread."""
    return _RESPONSE + n_response


@kernel(forceinline=True)
def lane_tensor(w: np.ndarray, row: int, m: int) -> Tensor:
    """The tensor of lane m that starts at a row."""
    a = row * LANES + m
    return (w[a], w[a + 8], w[a + 16], w[a + 24], w[a + 32], w[a + 40], w[a + 48], w[a + 56], w[a + 64])


@kernel(forceinline=True)
def lane_symmetric(w: np.ndarray, row: int, m: int) -> Symmetric:
    """The symmetric tensor of lane m that starts at a row."""
    a = row * LANES + m
    return (w[a], w[a + 8], w[a + 16], w[a + 24], w[a + 32], w[a + 40])


@kernel(forceinline=True)
def put_lane(w: np.ndarray, row: int, m: int, s: Symmetric) -> None:
    """Store a symmetric tensor of lane m."""
    a = row * LANES + m
    w[a], w[a + 8], w[a + 16], w[a + 24], w[a + 32], w[a + 40] = s


@kernel(forceinline=True)
def put_lane_tensor(w: np.ndarray, row: int, m: int, t: Tensor) -> None:
    """Store a tensor of lane m."""
    a = row * LANES + m
    w[a], w[a + 8], w[a + 16], w[a + 24], w[a + 32], w[a + 40], w[a + 48], w[a + 56], w[a + 64] = t


@kernel(forceinline=True)
def _nine(w: np.ndarray, at: int) -> Tensor:
    return (w[at], w[at + 1], w[at + 2], w[at + 3], w[at + 4], w[at + 5], w[at + 6], w[at + 7], w[at + 8])


@kernel(forceinline=True)
def _six(w: np.ndarray, at: int) -> Symmetric:
    return (w[at], w[at + 1], w[at + 2], w[at + 3], w[at + 4], w[at + 5])


@kernel(forceinline=True)
def _put(w: np.ndarray, at: int, s: Symmetric) -> None:
    w[at], w[at + 1], w[at + 2], w[at + 3], w[at + 4], w[at + 5] = s


@kernel(forceinline=True)
def _mapped(w: np.ndarray, at: int, s: Symmetric) -> Symmetric:
    """M : s of a (6, 6) map whose rows start at `at`."""
    return (
        w[at] * s[0] + w[at + 1] * s[1] + w[at + 2] * s[2] + w[at + 3] * s[3] + w[at + 4] * s[4] + w[at + 5] * s[5],
        w[at + 6] * s[0] + w[at + 7] * s[1] + w[at + 8] * s[2] + w[at + 9] * s[3] + w[at + 10] * s[4] + w[at + 11] * s[5],
        w[at + 12] * s[0] + w[at + 13] * s[1] + w[at + 14] * s[2] + w[at + 15] * s[3] + w[at + 16] * s[4] + w[at + 17] * s[5],
        w[at + 18] * s[0] + w[at + 19] * s[1] + w[at + 20] * s[2] + w[at + 21] * s[3] + w[at + 22] * s[4] + w[at + 23] * s[5],
        w[at + 24] * s[0] + w[at + 25] * s[1] + w[at + 26] * s[2] + w[at + 27] * s[3] + w[at + 28] * s[4] + w[at + 29] * s[5],
        w[at + 30] * s[0] + w[at + 31] * s[1] + w[at + 32] * s[2] + w[at + 33] * s[3] + w[at + 34] * s[4] + w[at + 35] * s[5],
    )


@kernel
def point_response(
    f: Tensor,
    log_j: float,
    theta: float,
    state_n: np.ndarray,
    state: np.ndarray,
    law: Law,
    active: tuple[np.ndarray, np.ndarray],
    scratch: tuple[np.ndarray, np.ndarray, np.ndarray],
    out: np.ndarray,
) -> None:
    """Response (n_response,) of one point at its converged state: what all directions share.

    f deformation gradient (F_bar), state_n and state (11,) before and after, active = numbers felt by pressure and yield stress;
    scratch = (6, 6), (6, 6) and (2, 3 + N_NUMBERS) arrays.
    """
    in_pressure, in_yield = active
    lhs, inverse, gradient = scratch
    pressure_gradient(log_j, theta, law, in_pressure, gradient)
    out[K_THETA] = gradient[0, 1]
    for i in range(len(in_pressure)):
        out[_GRADIENTS + i] = gradient[0, 2 + in_pressure[i]]
    gamma = state[LAMBDA] - state_n[LAMBDA]
    out[IS_PLASTIC] = 1.0 if gamma > 0.0 else 0.0
    if not gamma > 0.0:
        return
    yield_gradient(state_n[ALPHA], state_n[LAMBDA], gamma, law, in_yield, gradient)
    out[BY_ALPHA], out[BY_LAMBDA], slope = gradient[0, 0], gradient[0, 1], gradient[0, 2]
    out[ALPHA_BY_ALPHA], out[ALPHA_BY_GAMMA] = gradient[1, 0], gradient[1, 2]
    at = _GRADIENTS + len(in_pressure)
    for i in range(len(in_yield)):
        out[at + i] = gradient[0, 3 + in_yield[i]]
        out[at + len(in_yield) + i] = gradient[1, 3 + in_yield[i]]
    f_trial = transposed(product(f, _nine(state_n, 0)))
    f_el = transposed(product(f, _nine(state, 0)))
    c_trial, c = square(f_trial), square(f_el)
    flow, norm = flow_direction(c, law)
    d = scaled(flow, -gamma)
    y, terms = exponential(d)
    r = gamma / norm
    out[NORM], out[RATIO] = norm, r
    for m in range(6):
        e = (_UNIT[m, 0], _UNIT[m, 1], _UNIT[m, 2], _UNIT[m, 3], _UNIT[m, 4], _UNIT[m, 5])
        dy = exponential_derivative(d, scaled(e, -1.0), terms)
        s = mixed_congruence(dy, c_trial, y)
        for n in range(6):
            out[_DY + 6 * n + m] = dy[n]
            out[_S + 6 * n + m] = s[n]
    for m in range(6):
        e = (_UNIT[m, 0], _UNIT[m, 1], _UNIT[m, 2], _UNIT[m, 3], _UNIT[m, 4], _UNIT[m, 5])
        turned = _mapped(out, _S, added(hill(e, law), flow, -double_contraction(flow, e)))
        for n in range(6):
            lhs[n, m] = _UNIT[n, m] - r * turned[n]
            inverse[n, m] = _UNIT[n, m]
    solve_in_place(lhs, inverse)
    for n in range(6):
        for m in range(6):
            out[_A + 6 * n + m] = inverse[n, m]
    along = _mapped(out, _A, _mapped(out, _S, flow))
    out[DENOMINATOR] = slope - law.mu * double_contraction(flow, along)
    _put(out, _FLOW, flow)
    _put(out, _ALONG, along)
    _put(out, _C, c)
    _put(out, _EXP, y)


@kernel(forceinline=True)
def set_point(f: Tensor, state_n: np.ndarray, state: np.ndarray, response: np.ndarray, w: np.ndarray) -> None:
    """Numbers of the point into the workspace: F, F_p(n)^-1, F_tr, F_tr^T F, F_el, b_el = F_el F_el^T, and its response."""
    fp_n = _nine(state_n, 0)
    f_trial, f_el = product(f, fp_n), product(f, _nine(state, 0))
    x = product(transposed(f_trial), f)
    for i in range(9):
        w[_F + i], w[_FP_N + i], w[_F_TRIAL + i], w[_X + i], w[_F_EL + i] = f[i], fp_n[i], f_trial[i], x[i], f_el[i]
    _put(w, _B_EL, square(f_el))
    for i in range(response.shape[0]):
        w[_RESPONSE + i] = response[i]


@kernel(forceinline=True)
def _law_rates(w: np.ndarray, in_yield: np.ndarray, n_pressure: int) -> None:
    """Rates of yield stress and alpha through the numbers of the law alone: rows _SIGMA, _ALPHA."""
    for m in range(LANES):
        w[_SIGMA * LANES + m] = 0.0
        w[_ALPHA * LANES + m] = 0.0
    at = _RESPONSE + _GRADIENTS + n_pressure
    for i in range(len(in_yield)):
        sigma, alpha = w[at + i], w[at + len(in_yield) + i]
        row = (NUMBERS + in_yield[i]) * LANES
        for m in range(LANES):
            w[_SIGMA * LANES + m] += sigma * w[row + m]
            w[_ALPHA * LANES + m] += alpha * w[row + m]


@kernel(forceinline=True)
def _hill_rates(w: np.ndarray) -> None:
    """Rows _E and _H: e' = G' : C - N h', h' = C : G' : C / (2 n)."""
    c, flow, norm = _six(w, _RESPONSE + _C), _six(w, _RESPONSE + _FLOW), w[_RESPONSE + NORM]
    for m in range(LANES):
        a = (NUMBERS + HILL) * LANES + m
        f, g, h = w[a] * (c[0] - c[1]), w[a + 8] * (c[2] - c[0]), w[a + 16] * (c[1] - c[2])
        e = (f - g, h - f, g - h, w[a + 24] * c[3], w[a + 32] * c[4], w[a + 40] * c[5])
        h_rate = 0.5 * double_contraction(c, e) / norm
        w[_H * LANES + m] = h_rate
        put_lane(w, _E, m, added(e, flow, -h_rate))


@kernel(forceinline=True)
def _no_hill_rates(w: np.ndarray) -> None:
    for k in range(6 * LANES):
        w[_E * LANES + k] = 0.0
    for m in range(LANES):
        w[_H * LANES + m] = 0.0


@kernel(forceinline=True)
def _trial_rates(w: np.ndarray, moving: bool) -> None:
    """Rows _Q = F (F_p(n)^-1)' and _B = y C_tr' y; the strain rate takes part if `moving`."""
    f, x, y = _nine(w, _F), _nine(w, _X), _six(w, _RESPONSE + _EXP)
    f_trial = _nine(w, _F_TRIAL)
    for m in range(LANES):
        fp_rate = lane_tensor(w, FP_INV, m)
        if not moving:
            put_lane_tensor(w, _Q, m, product(f, fp_rate))
        t = product(x, fp_rate)
        c_rate = (2.0 * t[0], 2.0 * t[4], 2.0 * t[8], t[1] + t[3], t[5] + t[7], t[2] + t[6])
        if moving:
            c_rate = added(c_rate, pulled_back(f_trial, lane_symmetric(w, STRAIN, m)), 1.0)
        put_lane(w, _B, m, congruence(y, c_rate))


@kernel(forceinline=True)
def _flow_rates(w: np.ndarray, law: Law) -> None:
    """Rows _Y = y', STATE + ALPHA and STATE + LAMBDA: D' and gamma' by the implicit function theorem."""
    at = _RESPONSE
    flow, along, r = _six(w, at + _FLOW), _six(w, at + _ALONG), w[at + RATIO]
    for m in range(LANES):
        e = lane_symmetric(w, _E, m)
        b = added(lane_symmetric(w, _B, m), _mapped(w, at + _S, e), r)
        x = _mapped(w, at + _A, b)
        alpha_n, lambda_n = w[ALPHA_N * LANES + m], w[LAMBDA_N * LANES + m]
        sigma = w[_SIGMA * LANES + m] + w[at + BY_ALPHA] * alpha_n + w[at + BY_LAMBDA] * lambda_n
        pull = law.mu * (double_contraction(flow, x) + w[_H * LANES + m]) + w[(NUMBERS + MU) * LANES + m] * w[at + NORM]
        gamma = (pull - sigma) / w[at + DENOMINATOR]
        c = added(x, along, gamma)
        turned = added(added(hill(c, law), flow, -double_contraction(flow, c)), e, 1.0)
        put_lane(w, _Y, m, _mapped(w, at + _DY, added(scaled(flow, gamma), turned, r)))
        w[(STATE + ALPHA) * LANES + m] = w[at + ALPHA_BY_ALPHA] * alpha_n + w[at + ALPHA_BY_GAMMA] * gamma + w[_ALPHA * LANES + m]
        w[(STATE + LAMBDA) * LANES + m] = lambda_n + gamma


@kernel(forceinline=True)
def _plastic_rates(w: np.ndarray, law: Law, in_yield: np.ndarray, n_pressure: int, hill_moves: bool, moving: bool) -> None:
    _law_rates(w, in_yield, n_pressure)
    if hill_moves:
        _hill_rates(w)
    else:
        _no_hill_rates(w)
    _trial_rates(w, moving)
    _flow_rates(w, law)


@kernel(forceinline=True)
def state_rates(w: np.ndarray, law: Law, in_yield: np.ndarray, n_pressure: int, hill_moves: bool) -> None:
    """Rates of the new state (rows STATE) from those of the old one, of the strain and of the law."""
    if w[_RESPONSE + IS_PLASTIC] == 0.0:
        for k in range(11 * LANES):
            w[STATE * LANES + k] = w[FP_INV * LANES + k]
        return
    _plastic_rates(w, law, in_yield, n_pressure, hill_moves, True)
    fp_n, y = _nine(w, _FP_N), _six(w, _RESPONSE + _EXP)
    for m in range(LANES):
        first = product_symmetric(lane_tensor(w, FP_INV, m), y)
        second = product_symmetric(fp_n, lane_symmetric(w, _Y, m))
        put_lane_tensor(w, STATE, m, total(first, second))


@kernel(forceinline=True)
def stress_rates(w: np.ndarray, law: Law, in_pressure: np.ndarray, in_yield: np.ndarray, hill_moves: bool, virgin: bool) -> None:
    """Rate of tau = mu b_el + k 1 at fixed F (rows TAU): b_el' = 2 sym (F (F_p^-1)' F_el^T), k' through theta and the law.

    `virgin`: the point never yielded, so that its F_p does not change along any direction.
    """
    plastic = w[_RESPONSE + IS_PLASTIC] == 1.0
    if plastic:
        _plastic_rates(w, law, in_yield, len(in_pressure), hill_moves, False)
    for m in range(LANES):
        w[_K * LANES + m] = w[_RESPONSE + K_THETA] * w[THETA * LANES + m]
    for i in range(len(in_pressure)):
        slope, row = w[_RESPONSE + _GRADIENTS + i], (NUMBERS + in_pressure[i]) * LANES
        for m in range(LANES):
            w[_K * LANES + m] += slope * w[row + m]
    f, f_el, b_el = _nine(w, _F), _nine(w, _F_EL), _six(w, _B_EL)
    if virgin:
        for m in range(LANES):
            tau, k = scaled(b_el, w[(NUMBERS + MU) * LANES + m]), w[_K * LANES + m]
            put_lane(w, TAU, m, (tau[0] + k, tau[1] + k, tau[2] + k, tau[3], tau[4], tau[5]))
        return
    f_trial, y = _nine(w, _F_TRIAL), _six(w, _RESPONSE + _EXP)
    if plastic:
        for m in range(LANES):
            rate = total(product_symmetric(lane_tensor(w, _Q, m), y), product_symmetric(f_trial, lane_symmetric(w, _Y, m)))
            put_lane_tensor(w, _Q, m, rate)
    else:
        for m in range(LANES):
            put_lane_tensor(w, _Q, m, product(f, lane_tensor(w, FP_INV, m)))
    for m in range(LANES):
        b_rate = twice_symmetric_part(lane_tensor(w, _Q, m), f_el)
        tau = added(scaled(b_rate, law.mu), b_el, w[(NUMBERS + MU) * LANES + m])
        k = w[_K * LANES + m]
        put_lane(w, TAU, m, (tau[0] + k, tau[1] + k, tau[2] + k, tau[3], tau[4], tau[5]))
