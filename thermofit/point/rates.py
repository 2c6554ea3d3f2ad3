"""Rates of the local update: how stress and state of a point change along many directions at once (direct differentiation).

A rate, written x', is the derivative of x along a direction, for example by one parameter. With D = gamma N, y = exp(-D),
C_tr = F_tr^T F_tr, C = y C_tr y (point.lanes_point), n = |C|_G, r = gamma / n, differentiation of the converged update gives

    C_tr' = X + X^T + F_tr^T (l + l^T) F_tr,    X = F_tr^T F (F_p(n)^-1)',    l = F' F^-1
    D'    = gamma' N + r [(G - N N) : C' + e'],    e' = G' : C - N h',    h' = C : G' : C / (2 n)
    C'    = b' + S D',    b' = y C_tr' y,    S D' = y' C_tr y + y C_tr y',    y' = Y D'
    mu (N : C' + h') + mu' n = sigma' + sigma_gamma gamma',

sigma' the yield stress along alpha_n', Lambda_n', theta' and the numbers of the law. With t = r [(sigma' - mu' n)/mu - h'],
s = 1 - r sigma_gamma / mu and eta = s gamma' - t, elimination of C' leaves, for the five components of the traceless D',

    [1 - r G S] D' = eta N + r q',   q' = G : b' + e',
    eta = [mu (N : b' + h' + r v . B q') + mu' n - sigma' - sigma_gamma t / s] / (sigma_gamma / s - mu v . B N),

B = [1 - r G S]^-1, v = N : S. y' = eta Y B N + r Y B q' has Y B formed once per point by `responses_of_points`;
a direction then costs a few small products, and LANES directions go side by side (core.lanes).
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, any_lane, multiply_add, spread, where
from thermofit.law.page import Law, hill
from thermofit.law.page_rates import HILL, MU, N_NUMBERS
from thermofit.law.tensor import Symmetric, scaled
from thermofit.point.lanes_fused import (
    added,
    congruence,
    dot,
    double_contraction,
    product,
    product_added,
    pulled_back,
    symmetric_sum,
)
from thermofit.point.lanes_memory import column, number, row, set_row
from thermofit.point.lanes_tensor import (
    Tensor,
    exponential_of_traceless,
    exponential_slopes,
    full,
    inner_gram,
    outer_gram,
    set_tensor_rows,
    transposed,
)
from thermofit.point.state import LAMBDA, N_BACK

# Rows of the response of an element: one number of all its points each.
IS_PLASTIC, PRESSURE, K_LOG_J, K_THETA = range(4)
"""1 where the point flows, k and its derivatives by ln J and theta."""
F_EL = 4
"""F_el (nine)."""
NORM, RATIO, SHARE, DENOMINATOR = 13, 14, 15, 16
"""n, r, s and the denominator of eta."""
BY_ALPHA, BY_LAMBDA, BY_GAMMA, BY_THETA, ALPHA_BY_ALPHA, ALPHA_BY_GAMMA = 17, 18, 19, 20, 21, 22
"""Derivatives of the yield stress by alpha_n, Lambda_n, gamma and theta, of alpha by alpha_n and gamma."""
FLOW, C_ELASTIC, EXPONENTIAL, F_TRIAL, PULLED = 23, 29, 35, 41, 50
"""N, C, y (six each), F_tr, F_tr^T F (nine each)."""
VB, YBN, YB = 59, 64, 70
"""r v B (five), Y B N (six) and r Y B, six for each component of q (5, 6)."""
SHEAR = 100
"""Shear modulus at the point."""
GRADIENTS = 101
"""Gradients by the active numbers: of the pressure factor, the yield stress and alpha."""

# Rows of the workspace of one thread.
NUMBER_RATES = 0
"""Rates of the numbers of the law."""
THETA_RATE = N_NUMBERS
"""theta' at the point that `flow_rates` is called for."""
SYSTEM, WIDTH = N_NUMBERS + 1, 12
"""Scratch of `responses_of_points`: [(1 - r G S)^T | Y^T | v^T] (5, 12)."""
SLOPES, ALONG, RESULT = N_NUMBERS + 61, N_NUMBERS + 91, N_NUMBERS + 96
"""Scratch of `relative_rates`: derivatives of exp(-D) (5, 6), W : S (5), and the rates of tr C_el, xi and all Y."""
ROWS = RESULT + 2 + 6 * N_BACK


@kernel(forceinline=True)
def five(s: Symmetric) -> tuple[Lanes, Lanes, Lanes, Lanes, Lanes]:
    """The components of a deviator but zz, which follows from them."""
    return (s[0], s[1], s[3], s[4], s[5])


@kernel(forceinline=True)
def six(c: np.ndarray, at: int, q: int) -> Symmetric:
    """Symmetric tensor of point q, whose components are rows of c."""
    return (number(c, at, q), number(c, at + 1, q), number(c, at + 2, q), number(c, at + 3, q), number(c, at + 4, q), number(c, at + 5, q))


@kernel(forceinline=True)
def nine(c: np.ndarray, at: int, q: int) -> Tensor:
    """General tensor of point q, whose components are rows of c."""
    return (
        number(c, at, q), number(c, at + 1, q), number(c, at + 2, q), number(c, at + 3, q), number(c, at + 4, q),
        number(c, at + 5, q), number(c, at + 6, q), number(c, at + 7, q), number(c, at + 8, q),
    )  # fmt: skip


@kernel(forceinline=True)
def columns(a: np.ndarray) -> Tensor:
    """The first nine columns of (8, m) as a tensor of eight points."""
    return (
        column(a, 0), column(a, 1), column(a, 2), column(a, 3), column(a, 4), column(a, 5), column(a, 6), column(a, 7), column(a, 8),
    )  # fmt: skip


@kernel(forceinline=True)
def set_six(c: np.ndarray, at: int, s: Symmetric) -> None:
    """Write a symmetric tensor into six rows of c, from row `at`."""
    set_row(c, at, s[0])
    set_row(c, at + 1, s[1])
    set_row(c, at + 2, s[2])
    set_row(c, at + 3, s[3])
    set_row(c, at + 4, s[4])
    set_row(c, at + 5, s[5])


@kernel(forceinline=True)
def responses_of_points(f: Tensor, state_n: np.ndarray, state: np.ndarray, law: Law, w: np.ndarray, out: np.ndarray) -> None:
    """Responses (n_response, 8) of the eight points of an element at the converged end of a step: what all directions share.

    f (lanes: points) deformation gradient F_bar, state_n and state (8, 11) before and after. The derivatives of the law page must stand
    in `out` already (K_LOG_J to ALPHA_BY_GAMMA, GRADIENTS).
    """
    f_el = product(f, columns(state))
    set_tensor_rows(out, F_EL, f_el)
    gamma = column(state, LAMBDA) - column(state_n, LAMBDA)
    flows = gamma > 0.0
    set_row(out, IS_PLASTIC, where(flows, 1.0, 0.0))
    set_row(out, SHEAR, law.mu)
    if not any_lane(flows):
        return
    f_trial = product(f, columns(state_n))
    set_tensor_rows(out, F_TRIAL, f_trial)
    set_tensor_rows(out, PULLED, product(transposed(f_trial), f))
    c_trial, c = inner_gram(f_trial), inner_gram(f_el)
    g = hill(c, law)
    norm = math.sqrt(double_contraction(g, c))
    flow = scaled(g, where(norm > 0.0, 1.0 / norm, 0.0))
    r = where(flows, gamma / norm, 0.0)
    minus_d = scaled(flow, -gamma)
    y, terms = exponential_of_traceless(minus_d)
    y_c = product(full(y), full(c_trial))
    slopes = exponential_slopes(minus_d, terms)
    _set_equation(w, 0, slopes[0], y_c, r, flow, law)
    _set_equation(w, 1, slopes[1], y_c, r, flow, law)
    _set_equation(w, 2, slopes[2], y_c, r, flow, law)
    _set_equation(w, 3, slopes[3], y_c, r, flow, law)
    _set_equation(w, 4, slopes[4], y_c, r, flow, law)
    eliminate(w)
    set_six(out, FLOW, flow)
    set_six(out, C_ELASTIC, c)
    set_six(out, EXPONENTIAL, y)
    slope = row(out, BY_GAMMA)
    share = 1.0 - r * slope / law.mu
    set_row(out, NORM, norm)
    set_row(out, RATIO, r)
    set_row(out, SHARE, share)
    set_row(out, DENOMINATOR, slope / share - law.mu * _set_solution(w, flow, r, out))


@kernel(forceinline=True)
def _set_equation(w: np.ndarray, m: int, slope: Symmetric, y_c: Tensor, r: Lanes, flow: Symmetric, law: Law) -> None:
    """Row m of [(1 - r G S)^T | Y^T | v^T], that of component m of D; y = exp(-D)."""
    dy = scaled(slope, -1.0)
    s = symmetric_sum(full(dy), y_c)
    g, at = hill(s, law), SYSTEM + WIDTH * m
    set_row(w, at, (1.0 if m == 0 else 0.0) - r * g[0])
    set_row(w, at + 1, (1.0 if m == 1 else 0.0) - r * g[1])
    set_row(w, at + 2, (1.0 if m == 2 else 0.0) - r * g[3])
    set_row(w, at + 3, (1.0 if m == 3 else 0.0) - r * g[4])
    set_row(w, at + 4, (1.0 if m == 4 else 0.0) - r * g[5])
    set_six(w, at + 5, dy)
    set_row(w, at + 11, double_contraction(flow, s))


@kernel(forceinline=True)
def eliminate(w: np.ndarray) -> None:
    """Gauss-Jordan elimination, which leaves [1 | (Y B)^T | (v B)^T]; without pivoting, since 1 - r G S is 1 + 2 r G up to the elastic
    strain."""
    for k in range(5):
        pivot = SYSTEM + WIDTH * k
        factor = 1.0 / row(w, pivot + k)
        for j in range(k + 1, WIDTH):
            set_row(w, pivot + j, factor * row(w, pivot + j))
        for i in range(5):
            if i != k:
                other = SYSTEM + WIDTH * i
                factor = -row(w, other + k)
                for j in range(k + 1, WIDTH):
                    set_row(w, other + j, multiply_add(factor, row(w, pivot + j), row(w, other + j)))


@kernel(forceinline=True)
def _set_solution(w: np.ndarray, flow: Symmetric, r: Lanes, out: np.ndarray) -> Lanes:
    """Y B N, r Y B and r v B into the response; returns v . B N."""
    n, o, v_b_n = five(flow), spread(0.0), spread(0.0)
    y_b_n = (o, o, o, o, o, o)
    for m in range(5):
        at = SYSTEM + WIDTH * m + 5
        y_b, v_b = (row(w, at), row(w, at + 1), row(w, at + 2), row(w, at + 3), row(w, at + 4), row(w, at + 5)), row(w, at + 6)
        y_b_n, v_b_n = added(y_b_n, y_b, n[m]), multiply_add(n[m], v_b, v_b_n)
        set_six(out, YB + 6 * m, scaled(y_b, r))
        set_row(out, VB + m, r * v_b)
    set_six(out, YBN, y_b_n)
    return v_b_n


@kernel(forceinline=True)
def _hill_rates(c: np.ndarray, q: int, w: np.ndarray) -> tuple[Symmetric, Lanes]:
    """e' = G' : C - N h' and h' = C : G' : C / (2 n)."""
    a, flow, at = six(c, C_ELASTIC, q), six(c, FLOW, q), NUMBER_RATES + HILL
    f, g, h = row(w, at) * (a[0] - a[1]), row(w, at + 1) * (a[2] - a[0]), row(w, at + 2) * (a[1] - a[2])
    e = (f - g, h - f, g - h, row(w, at + 3) * a[3], row(w, at + 4) * a[4], row(w, at + 5) * a[5])
    h_rate = double_contraction(a, e) * (0.5 / number(c, NORM, q))
    return added(e, flow, -h_rate), h_rate


@kernel(forceinline=True)
def summed(c: np.ndarray, q: int, at: int, active: np.ndarray, w: np.ndarray) -> Lanes:
    """Rate through the active numbers of the law, whose gradient stands in c from `at` on."""
    value = spread(0.0)
    for i in range(active.shape[0]):
        value = multiply_add(number(c, at + i, q), row(w, NUMBER_RATES + active[i]), value)
    return value


@kernel(forceinline=True)
def flow_rates(
    c: np.ndarray,
    q: int,
    fp_rate: Tensor,
    alpha_n: Lanes,
    lambda_n: Lanes,
    strain: Symmetric,
    law: Law,
    active: tuple[np.ndarray, np.ndarray],
    w: np.ndarray,
) -> tuple[Symmetric, Lanes, Lanes]:
    """y', alpha' and Lambda' of a flowing point by the implicit function theorem.

    c (n_response, 8) the response of its element, q its place there; fp_rate, alpha_n, lambda_n the rates of the old state; strain l + l^T;
    active = numbers felt by pressure and yield stress, whose rates stand in the rows NUMBER_RATES; theta' stands in the row THETA_RATE.
    """
    in_pressure, in_yield = active
    flow, r, mu_rate = six(c, FLOW, q), number(c, RATIO, q), row(w, NUMBER_RATES + MU)
    e, h = _hill_rates(c, q, w)
    at = GRADIENTS + in_pressure.shape[0]
    sigma = multiply_add(number(c, BY_ALPHA, q), alpha_n, summed(c, q, at, in_yield, w))
    sigma = multiply_add(number(c, BY_THETA, q), row(w, THETA_RATE), multiply_add(number(c, BY_LAMBDA, q), lambda_n, sigma))
    x = product(nine(c, PULLED, q), fp_rate)
    moved = pulled_back(nine(c, F_TRIAL, q), strain)
    c_rate = (
        2.0 * x[0] + moved[0],
        2.0 * x[4] + moved[1],
        2.0 * x[8] + moved[2],
        x[1] + x[3] + moved[3],
        x[5] + x[7] + moved[4],
        x[2] + x[6] + moved[5],
    )
    b = congruence(six(c, EXPONENTIAL, q), c_rate)
    driven = five(added(hill(b, law), e, 1.0))
    norm_rate = mu_rate * number(c, NORM, q)
    t = r * ((sigma - norm_rate) * (1.0 / law.mu) - h)
    bent = multiply_add(number(c, VB + 1, q), driven[1], number(c, VB, q) * driven[0])
    bent = dot(number(c, VB + 2, q), driven[2], number(c, VB + 3, q), driven[3], number(c, VB + 4, q), driven[4]) + bent
    share = 1.0 / number(c, SHARE, q)
    eta = law.mu * (double_contraction(flow, b) + h + bent) + norm_rate - sigma - (number(c, BY_GAMMA, q) * share) * t
    eta = eta * (1.0 / number(c, DENOMINATOR, q))
    gamma = (eta + t) * share
    y = scaled(six(c, YBN, q), eta)
    y = added(y, six(c, YB, q), driven[0])
    y = added(y, six(c, YB + 6, q), driven[1])
    y = added(y, six(c, YB + 12, q), driven[2])
    y = added(y, six(c, YB + 18, q), driven[3])
    y = added(y, six(c, YB + 24, q), driven[4])
    alpha = number(c, ALPHA_BY_ALPHA, q) * alpha_n + number(c, ALPHA_BY_GAMMA, q) * gamma
    return y, alpha + summed(c, q, at + in_yield.shape[0], in_yield, w), lambda_n + gamma


@kernel(forceinline=True)
def plastic_part_rates(c: np.ndarray, q: int, fp_n: Tensor, fp_rate: Tensor, y_rate: Symmetric) -> Tensor:
    """(F_p^-1)' = (F_p(n)^-1)' y + F_p(n)^-1 y'."""
    return product_added(product(fp_rate, full(six(c, EXPONENTIAL, q))), fp_n, full(y_rate))


@kernel(forceinline=True)
def pressure_rates(c: np.ndarray, q: int, theta: Lanes, log_j: Lanes, in_pressure: np.ndarray, w: np.ndarray) -> Lanes:
    """k' through theta', (ln J)' and the numbers of the law."""
    return number(c, K_THETA, q) * theta + number(c, K_LOG_J, q) * log_j + summed(c, q, GRADIENTS, in_pressure, w)


@kernel(forceinline=True)
def stress_rates(c: np.ndarray, q: int, f_el_rate: Tensor, k_rate: Lanes, law: Law, w: np.ndarray) -> Symmetric:
    """tau' of tau = mu F_el F_el^T + k 1."""
    f_el = nine(c, F_EL, q)
    tau = added(scaled(symmetric_sum(f_el_rate, f_el), law.mu), scaled(outer_gram(f_el), row(w, NUMBER_RATES + MU)), 1.0)
    return (tau[0] + k_rate, tau[1] + k_rate, tau[2] + k_rate, tau[3], tau[4], tau[5])


@kernel(forceinline=True)
def virgin_stress_rates(c: np.ndarray, q: int, k_rate: Lanes, w: np.ndarray) -> Symmetric:
    """tau' at fixed F of a point that never yielded: mu' b_el + k' 1."""
    tau = scaled(outer_gram(nine(c, F_EL, q)), row(w, NUMBER_RATES + MU))
    return (tau[0] + k_rate, tau[1] + k_rate, tau[2] + k_rate, tau[3], tau[4], tau[5])


@kernel(forceinline=True)
def kirchhoff(c: np.ndarray, q: int) -> Symmetric:
    """tau = mu F_el F_el^T + k 1."""
    tau = scaled(outer_gram(nine(c, F_EL, q)), number(c, SHEAR, q))
    k = number(c, PRESSURE, q)
    return (tau[0] + k, tau[1] + k, tau[2] + k, tau[3], tau[4], tau[5])


@kernel(forceinline=True)
def elastic_part(c: np.ndarray, q: int) -> Tensor:
    """F_el."""
    return nine(c, F_EL, q)


@kernel(forceinline=True)
def response_size(n_pressure: int, n_yield: int) -> int:
    """Length of a point's response for so many active numbers in pressure and yield stress."""
    return GRADIENTS + n_pressure + 2 * n_yield
