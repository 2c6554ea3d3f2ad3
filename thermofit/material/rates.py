"""Rates of the local update: how stress and state of a point change along many directions at once (direct differentiation).

A rate, written x', is the derivative of x along a direction, for example by one parameter. With D = gamma N, y = exp(-D),
C_tr = F_tr^T F_tr, C = y C_tr y (material.point), n = |C|_G, r = gamma / n, differentiation of the converged update gives

    C_tr' = X + X^T + F_tr^T (l + l^T) F_tr,    X = F_tr^T F (F_p(n)^-1)',    l = F' F^-1
    D'    = gamma' N + r [(G - N N) : C' + e'],    e' = G' : C - N h',    h' = C : G' : C / (2 n)
    C'    = b' + S D',    b' = y C_tr' y,    S D' = y' C_tr y + y C_tr y',    y' = Y D'
    mu (N : C' + h') + mu' n = sigma' + sigma_gamma gamma',

sigma' the yield stress along alpha_n', Lambda_n', theta' and the numbers of the law. With t = r [(sigma' - mu' n)/mu - h'],
s = 1 - r sigma_gamma / mu and eta = s gamma' - t, elimination of C' leaves, for the five components of the traceless D',

    [1 - r G S] D' = eta N + r q',   q' = G : b' + e',
    eta = [mu (N : b' + h' + r v . B q') + mu' n - sigma' - sigma_gamma t / s] / (sigma_gamma / s - mu v . B N),

B = [1 - r G S]^-1, v = N : S. `responses_of_points` forms B and Y once per point; a direction then costs a few small products, and
LANES directions go side by side (material.lanes).
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.material.lanes import Lanes, any_lane, spread, where
from thermofit.material.lanes_fused import (
    added,
    congruence,
    double_contraction,
    multiply_add,
    product,
    product_added,
    pulled_back,
    symmetric_sum,
)
from thermofit.material.lanes_memory import column, row, set_column, set_row
from thermofit.material.lanes_tensor import (
    Tensor,
    exponential_of_traceless,
    exponential_slopes,
    full,
    inner_gram,
    outer_gram,
    transposed,
)
from thermofit.material.law import Law
from thermofit.material.law_rates import HILL, MU, N_NUMBERS
from thermofit.material.point import LAMBDA, hill
from thermofit.material.tensor import Symmetric, scaled

# Places in the response of a point.
IS_PLASTIC, NORM, RATIO, SHARE, DENOMINATOR = range(5)
"""1 where the point flows, n, r, s and the denominator of eta."""
PRESSURE, K_LOG_J, K_THETA = 5, 6, 7
"""k and its derivatives by ln J and theta."""
BY_ALPHA, BY_LAMBDA, BY_GAMMA, ALPHA_BY_ALPHA, ALPHA_BY_GAMMA, BY_THETA = 8, 9, 10, 11, 12, 13
"""Derivatives of the yield stress and of alpha by alpha_n, Lambda_n and gamma, of the yield stress by theta."""
_FLOW, _C, _EXP, _F_TRIAL, _F_EL, _X = 14, 20, 26, 32, 41, 50
"""N, C, y (six each), F_tr, F_el, F_tr^T F (nine each)."""
_B, _BN, _VB, _DY = 59, 84, 89, 94
"""B (5, 5), B N, r v B (five each) and Y by the five components of D (5, 6)."""
GRADIENTS = 124
"""Gradients by the active numbers: of the pressure factor, the yield stress and alpha."""

_PLACE = np.array([0, 1, 3, 4, 5])
"""Which of the six components of a traceless symmetric tensor are the five unknowns."""
# Rows of the workspace of one thread.
NUMBER_RATES = 0
"""Rates of the numbers of the law."""
THETA_RATE = N_NUMBERS
"""theta' at the point that `flow_rates` is called for."""
_S, _Y, _INVERSE = N_NUMBERS + 1, N_NUMBERS + 31, N_NUMBERS + 61
"""Scratch of `responses_of_points`: S and Y (5, 6), [1 - r G S | 1] (5, 10)."""
ROWS = N_NUMBERS + 111


@kernel(forceinline=True)
def _five(s: Symmetric) -> tuple[Lanes, Lanes, Lanes, Lanes, Lanes]:
    return (s[0], s[1], s[3], s[4], s[5])


@kernel(forceinline=True)
def _six_rows(w: np.ndarray, at: int) -> Symmetric:
    return (row(w, at), row(w, at + 1), row(w, at + 2), row(w, at + 3), row(w, at + 4), row(w, at + 5))


@kernel(forceinline=True)
def six(c: np.ndarray, at: int) -> Symmetric:
    """Symmetric tensor that lies in an array of numbers."""
    return (c[at], c[at + 1], c[at + 2], c[at + 3], c[at + 4], c[at + 5])


@kernel(forceinline=True)
def nine(c: np.ndarray, at: int) -> Tensor:
    """General tensor that lies in an array of numbers."""
    return (c[at], c[at + 1], c[at + 2], c[at + 3], c[at + 4], c[at + 5], c[at + 6], c[at + 7], c[at + 8])


@kernel(forceinline=True)
def _columns(a: np.ndarray) -> Tensor:
    """The first nine columns of (8, m) as a tensor of eight points."""
    return (
        column(a, 0), column(a, 1), column(a, 2), column(a, 3), column(a, 4), column(a, 5), column(a, 6), column(a, 7), column(a, 8),
    )  # fmt: skip


@kernel(forceinline=True)
def _set_columns(a: np.ndarray, at: int, t: Tensor) -> None:
    set_column(a, at, t[0])
    set_column(a, at + 1, t[1])
    set_column(a, at + 2, t[2])
    set_column(a, at + 3, t[3])
    set_column(a, at + 4, t[4])
    set_column(a, at + 5, t[5])
    set_column(a, at + 6, t[6])
    set_column(a, at + 7, t[7])
    set_column(a, at + 8, t[8])


@kernel(forceinline=True)
def _set_six_columns(a: np.ndarray, at: int, s: Symmetric) -> None:
    set_column(a, at, s[0])
    set_column(a, at + 1, s[1])
    set_column(a, at + 2, s[2])
    set_column(a, at + 3, s[3])
    set_column(a, at + 4, s[4])
    set_column(a, at + 5, s[5])


@kernel(forceinline=True)
def responses_of_points(f: Tensor, state_n: np.ndarray, state: np.ndarray, law: Law, w: np.ndarray, out: np.ndarray) -> None:
    """Responses (8, n_response) of the eight points of an element at the converged end of a step: what all directions share.

    f (lanes: points) deformation gradient F_bar, state_n and state (8, 11) before and after. The derivatives of the law page must stand
    in `out` already (K_LOG_J to ALPHA_BY_GAMMA, GRADIENTS).
    """
    f_el = product(f, _columns(state))
    _set_columns(out, _F_EL, f_el)
    gamma = column(state, LAMBDA) - column(state_n, LAMBDA)
    flows = gamma > 0.0
    set_column(out, IS_PLASTIC, where(flows, 1.0, 0.0))
    if not any_lane(flows):
        return
    f_trial = product(f, _columns(state_n))
    _set_columns(out, _F_TRIAL, f_trial)
    _set_columns(out, _X, product(transposed(f_trial), f))
    c_trial, c = inner_gram(f_trial), inner_gram(f_el)
    g = hill(c, law)
    norm = math.sqrt(double_contraction(g, c))
    flow = scaled(g, where(norm > 0.0, 1.0 / norm, 0.0))
    r = where(flows, gamma / norm, 0.0)
    minus_d = scaled(flow, -gamma)
    y, terms = exponential_of_traceless(minus_d)
    y_c = product(full(y), full(c_trial))
    slopes = exponential_slopes(minus_d, terms)
    _set_unknown(w, 0, slopes[0], y_c, r, law)
    _set_unknown(w, 1, slopes[1], y_c, r, law)
    _set_unknown(w, 2, slopes[2], y_c, r, law)
    _set_unknown(w, 3, slopes[3], y_c, r, law)
    _set_unknown(w, 4, slopes[4], y_c, r, law)
    _invert(w)
    _set_six_columns(out, _FLOW, flow)
    _set_six_columns(out, _C, c)
    _set_six_columns(out, _EXP, y)
    n5 = _five(flow)
    slope = column(out, BY_GAMMA)
    share = 1.0 - r * slope / law.mu
    v_b_n = spread(0.0)
    for m in range(5):
        b_n, v_b = spread(0.0), spread(0.0)
        for k in range(5):
            set_column(out, _B + 5 * m + k, row(w, _INVERSE + 10 * m + 5 + k))
            v_b = v_b + double_contraction(flow, _six_rows(w, _S + 6 * k)) * row(w, _INVERSE + 10 * k + 5 + m)
        b_n = b_n + row(w, _INVERSE + 10 * m + 5) * n5[0] + row(w, _INVERSE + 10 * m + 6) * n5[1]
        b_n = b_n + row(w, _INVERSE + 10 * m + 7) * n5[2] + row(w, _INVERSE + 10 * m + 8) * n5[3] + row(w, _INVERSE + 10 * m + 9) * n5[4]
        set_column(out, _BN + m, b_n)
        set_column(out, _VB + m, r * v_b)
        v_b_n = v_b_n + double_contraction(flow, _six_rows(w, _S + 6 * m)) * b_n
        for k in range(6):
            set_column(out, _DY + 6 * m + k, row(w, _Y + 6 * m + k))
    set_column(out, NORM, norm)
    set_column(out, RATIO, r)
    set_column(out, SHARE, share)
    set_column(out, DENOMINATOR, slope / share - law.mu * v_b_n)


@kernel(forceinline=True)
def _set_unknown(w: np.ndarray, m: int, slope: Symmetric, y_c: Tensor, r: Lanes, law: Law) -> None:
    """Y and S for component m of D, y = exp(-D), and column m of [1 - r G S | 1]."""
    dy = scaled(slope, -1.0)
    s = symmetric_sum(full(dy), y_c)
    for k in range(6):
        set_row(w, _Y + 6 * m + k, dy[k])
        set_row(w, _S + 6 * m + k, s[k])
    g = hill(s, law)
    for k in range(5):
        unit = 1.0 if k == m else 0.0
        set_row(w, _INVERSE + 10 * k + m, unit - r * g[_PLACE[k]])
        set_row(w, _INVERSE + 10 * k + 5 + m, unit)


@kernel(forceinline=True)
def _invert(w: np.ndarray) -> None:
    """Gauss-Jordan elimination of [1 - r G S | 1]; without pivoting, since the matrix is 1 + 2 r G up to the elastic strain."""
    for k in range(5):
        pivot = _INVERSE + 10 * k
        factor = 1.0 / row(w, pivot + k)
        for j in range(10):
            set_row(w, pivot + j, factor * row(w, pivot + j))
        for i in range(5):
            if i != k:
                other = _INVERSE + 10 * i
                factor = row(w, other + k)
                for j in range(10):
                    set_row(w, other + j, row(w, other + j) - factor * row(w, pivot + j))


@kernel(forceinline=True)
def _hill_rates(c: np.ndarray, w: np.ndarray) -> tuple[Symmetric, Lanes]:
    """e' = G' : C - N h' and h' = C : G' : C / (2 n)."""
    a, flow, at = six(c, _C), six(c, _FLOW), NUMBER_RATES + HILL
    f, g, h = row(w, at) * (a[0] - a[1]), row(w, at + 1) * (a[2] - a[0]), row(w, at + 2) * (a[1] - a[2])
    e = (f - g, h - f, g - h, row(w, at + 3) * a[3], row(w, at + 4) * a[4], row(w, at + 5) * a[5])
    h_rate = double_contraction(a, e) * (0.5 / c[NORM])
    return added(e, flow, -h_rate), h_rate


@kernel(forceinline=True)
def _summed(c: np.ndarray, at: int, active: np.ndarray, w: np.ndarray) -> Lanes:
    """Rate through the active numbers of the law, whose gradient stands in c from `at` on."""
    value = spread(0.0)
    for i in range(active.shape[0]):
        value = multiply_add(c[at + i], row(w, NUMBER_RATES + active[i]), value)
    return value


@kernel(forceinline=True)
def _contracted(c: np.ndarray, at: int, q: tuple[Lanes, Lanes, Lanes, Lanes, Lanes]) -> Lanes:
    """Product of the five numbers in c from `at` on and q."""
    value = multiply_add(c[at + 1], q[1], c[at] * q[0])
    return multiply_add(c[at + 4], q[4], multiply_add(c[at + 3], q[3], multiply_add(c[at + 2], q[2], value)))


@kernel(forceinline=True)
def flow_rates(
    c: np.ndarray,
    fp_rate: Tensor,
    alpha_n: Lanes,
    lambda_n: Lanes,
    strain: Symmetric,
    law: Law,
    active: tuple[np.ndarray, np.ndarray],
    w: np.ndarray,
) -> tuple[Symmetric, Lanes, Lanes]:
    """y', alpha' and Lambda' of a flowing point by the implicit function theorem.

    c (n_response,) its response; fp_rate, alpha_n, lambda_n the rates of the old state; strain l + l^T; active = numbers felt by pressure
    and yield stress, whose rates stand in the rows NUMBER_RATES; theta' stands in the row THETA_RATE.
    """
    in_pressure, in_yield = active
    flow, r, mu_rate = six(c, _FLOW), c[RATIO], row(w, NUMBER_RATES + MU)
    e, h = _hill_rates(c, w)
    at = GRADIENTS + in_pressure.shape[0]
    sigma = _summed(c, at, in_yield, w) + c[BY_ALPHA] * alpha_n + c[BY_LAMBDA] * lambda_n + c[BY_THETA] * row(w, THETA_RATE)
    x = product(nine(c, _X), fp_rate)
    moved = pulled_back(nine(c, _F_TRIAL), strain)
    c_rate = (
        2.0 * x[0] + moved[0],
        2.0 * x[4] + moved[1],
        2.0 * x[8] + moved[2],
        x[1] + x[3] + moved[3],
        x[5] + x[7] + moved[4],
        x[2] + x[6] + moved[5],
    )
    b = congruence(six(c, _EXP), c_rate)
    q = _five(added(hill(b, law), e, 1.0))
    t = r * ((sigma - mu_rate * c[NORM]) * (1.0 / law.mu) - h)
    v_b_q = _contracted(c, _VB, q)
    slope = c[BY_GAMMA]
    eta = (law.mu * (double_contraction(flow, b) + h + v_b_q) + mu_rate * c[NORM] - sigma - (slope / c[SHARE]) * t) * (1.0 / c[DENOMINATOR])
    gamma = (eta + t) * (1.0 / c[SHARE])
    o = spread(0.0)
    y = (o, o, o, o, o, o)
    for m in range(5):
        k = _B + 5 * m
        b_q = _contracted(c, k, q)
        y = added(y, six(c, _DY + 6 * m), c[_BN + m] * eta + r * b_q)
    alpha = c[ALPHA_BY_ALPHA] * alpha_n + c[ALPHA_BY_GAMMA] * gamma + _summed(c, at + in_yield.shape[0], in_yield, w)
    return y, alpha, lambda_n + gamma


@kernel(forceinline=True)
def plastic_part_rates(c: np.ndarray, fp_n: Tensor, fp_rate: Tensor, y_rate: Symmetric) -> Tensor:
    """(F_p^-1)' = (F_p(n)^-1)' y + F_p(n)^-1 y'."""
    return product_added(product(fp_rate, full(six(c, _EXP))), fp_n, full(y_rate))


@kernel(forceinline=True)
def pressure_rates(c: np.ndarray, theta: Lanes, log_j: Lanes, in_pressure: np.ndarray, w: np.ndarray) -> Lanes:
    """k' through theta', (ln J)' and the numbers of the law."""
    return c[K_THETA] * theta + c[K_LOG_J] * log_j + _summed(c, GRADIENTS, in_pressure, w)


@kernel(forceinline=True)
def stress_rates(c: np.ndarray, f_el_rate: Tensor, k_rate: Lanes, law: Law, w: np.ndarray) -> Symmetric:
    """tau' of tau = mu F_el F_el^T + k 1."""
    f_el = nine(c, _F_EL)
    tau = added(scaled(symmetric_sum(f_el_rate, f_el), law.mu), scaled(outer_gram(f_el), row(w, NUMBER_RATES + MU)), 1.0)
    return (tau[0] + k_rate, tau[1] + k_rate, tau[2] + k_rate, tau[3], tau[4], tau[5])


@kernel(forceinline=True)
def virgin_stress_rates(c: np.ndarray, k_rate: Lanes, w: np.ndarray) -> Symmetric:
    """tau' at fixed F of a point that never yielded: mu' b_el + k' 1."""
    tau = scaled(outer_gram(nine(c, _F_EL)), row(w, NUMBER_RATES + MU))
    return (tau[0] + k_rate, tau[1] + k_rate, tau[2] + k_rate, tau[3], tau[4], tau[5])


@kernel(forceinline=True)
def kirchhoff(c: np.ndarray, law: Law) -> Symmetric:
    """tau = mu F_el F_el^T + k 1."""
    tau = scaled(outer_gram(nine(c, _F_EL)), law.mu)
    return (tau[0] + c[PRESSURE], tau[1] + c[PRESSURE], tau[2] + c[PRESSURE], tau[3], tau[4], tau[5])


@kernel(forceinline=True)
def elastic_part(c: np.ndarray) -> Tensor:
    """F_el."""
    return nine(c, _F_EL)


def response_size(n_pressure: int, n_yield: int) -> int:
    """Length of a point's response for so many active numbers in pressure and yield stress."""
    return GRADIENTS + n_pressure + 2 * n_yield
