"""Rates of the local update where an effect changes it: backstress, changed moduli, yield stress by the sense of flow.

The update is that of `point.lanes_relative`, the notation that of `point.rates`. With T = m mu C - sum q_i Y_n,i and n = |T|_G, what T
gains at fixed D and gamma = dLambda along a direction is

    t = m mu b' + (m mu)' C - sum (q_i' Y_n,i + q_i Y_n,i'),      T' = t + m mu S D' + V gamma',

and differentiation of D = gamma N and n = f sigma_y + sum C_i gamma phi_i =: R gives, with P = G - N N, r = gamma / n, e' = G' : T - N h',
h' = T : G' : T / (2 n), W = N - sigma_y f' dxi/dT and R' at fixed gamma,
of another surface P = phi d2phi/dT2, e' = phi dN/dz z' and h' = dphi/dz z' by its numbers z,

    [1 - r m mu P S] D' = (N + r P V) gamma' + rho,    rho = r (P t + e'),
    -W : m mu S D' - (W : V - R_gamma) gamma' = W : t + h' - R'.

B = [1 - r m mu P S]^-1 is formed once per point, then a direction costs products. m, C_i, gamma_i and f, and their derivatives, come from
the law page by complex step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from thermofit.core.jit import by_type, kernel
from thermofit.core.lanes import Lanes, any_lane, multiply_add, spread, where
from thermofit.law.backstress import decay_share, gain_share
from thermofit.law.page import Law, is_transformed, transformed
from thermofit.law.page_rates import HILL, MU, N_STRUCTURE, SURFACE, Directions, sense_gradients, structure_gradients
from thermofit.law.tensor import Symmetric, deviator, scaled
from thermofit.law.transformed import number_slopes
from thermofit.point.lanes_fused import added, congruence, double_contraction, product, pulled_back, symmetric_sum
from thermofit.point.lanes_memory import column, number, row, set_row
from thermofit.point.lanes_relative import sense_and_gradient
from thermofit.point.lanes_rows import N_CURVATURE
from thermofit.point.lanes_surface import projected, projected_at, surface_flow_and_curvature
from thermofit.point.lanes_tensor import (
    Tensor,
    exponential_of_traceless,
    exponential_slopes,
    full,
    inner_gram,
    outer_gram,
    set_tensor_rows,
    symmetric_rows,
    transposed,
)
from thermofit.point.rates import (
    ALONG,
    ALPHA_BY_ALPHA,
    ALPHA_BY_GAMMA,
    BY_ALPHA,
    BY_GAMMA,
    BY_LAMBDA,
    BY_THETA,
    C_ELASTIC,
    DENOMINATOR,
    EXPONENTIAL,
    F_EL,
    F_TRIAL,
    FLOW,
    GRADIENTS,
    IS_PLASTIC,
    NORM,
    NUMBER_RATES,
    PRESSURE,
    PULLED,
    RATIO,
    RESULT,
    SHEAR,
    SLOPES,
    SYSTEM,
    THETA_RATE,
    VB,
    WIDTH,
    YB,
    YBN,
    columns,
    eliminate,
    nine,
    response_size,
    set_six,
    six,
    summed,
)
from thermofit.point.state import BACK, LAMBDA, N_BACK, SENSE

# Rows of a response, after those of `point.rates`.
STIFF, FACTOR, BY_SENSE, FLOWN = range(4)
"""m, f and its slope over xi, dLambda."""
_T, _NORMAL, _BY_INCREMENT, _SENSE, _DIRECTION, _Y_C = 4, 10, 16, 22, 28, 34
"""T, W, V, dxi/dT, dev T / n (six each), exp(-D) C_tr (nine)."""
_STRESS = 43
"""sigma_y."""
_TERMS, _OF_TERM = 44, 12
"""Of each backstress: q, exp(-gamma_i dLambda), dLambda phi, C, gamma_i, the derivative of dLambda phi by gamma_i, and Y_n (six)."""
_HELD, _KEPT, _GAIN, _MODULUS, _RECALL, _BY_RECALL, _OLD = range(7)
SLOPES_OF = _TERMS + _OF_TERM * N_BACK
"""Gradients of `structure_gradients`, then those of f by the numbers of the law; of a transformed surface then its curvature, and dphi/dz
with phi dN/dz for each of its active numbers z."""


def rows_of_response(along: Directions, law: Law) -> int:
    """Length of a point's response: that of `point.rates` and, where one of these effects is on or asked for, of this page."""
    if not along.structured:
        return response_size(len(along.in_pressure), len(along.in_yield))
    return curvature_row(along) + (N_CURVATURE + 7 * len(along.in_surface) if is_transformed(law) else 0)


def curvature_row(along: Directions) -> int:
    """First row of the curvature of the surface in a response of this page."""
    base = response_size(len(along.in_pressure), len(along.in_yield))
    return base + SLOPES_OF + N_STRUCTURE * (3 + len(along.in_structure)) + len(along.in_sense)


def stiffness_slopes(response: np.ndarray, along: Directions) -> np.ndarray:
    """dm / d number at all points, of the numbers `along.in_structure`: (n_el, n, 8) of the responses."""
    at = response_size(len(along.in_pressure), len(along.in_yield)) + SLOPES_OF + 3
    return response[:, at : at + len(along.in_structure)]


def set_law_rows(before: np.ndarray, after: np.ndarray, theta: np.ndarray, law: Law, along: Directions, out: np.ndarray) -> None:
    """What the law page gives, into the responses (n_el, n_response, 8): states (n_el, 8, N_FULL) before and after, theta K (n_el, 8)."""
    base, shape = response_size(len(along.in_pressure), len(along.in_yield)), theta.shape
    start, flown = np.ascontiguousarray(before[:, :, LAMBDA]), after[:, :, LAMBDA] - before[:, :, LAMBDA]
    values, slopes = structure_gradients((start.ravel(), flown.ravel(), theta.ravel()), law, along.in_structure)
    factor, by_sense = sense_gradients(np.ascontiguousarray(after[:, :, SENSE]).ravel(), law, along.in_sense)
    out[:, base + STIFF], out[:, base + FACTOR] = values[0].reshape(shape), factor.reshape(shape)
    out[:, base + BY_SENSE], out[:, base + FLOWN] = by_sense[0].reshape(shape), flown
    at = base + SLOPES_OF
    rows = slopes.reshape(-1, *shape)
    out[:, at : at + len(rows)] = rows.transpose(1, 0, 2)
    out[:, at + len(rows) : at + len(rows) + len(by_sense) - 1] = by_sense[1:].reshape(-1, *shape).transpose(1, 0, 2)
    for i in range(N_BACK):
        at = base + _TERMS + _OF_TERM * i
        out[:, at + _MODULUS], out[:, at + _RECALL] = values[1 + 2 * i].reshape(shape), values[2 + 2 * i].reshape(shape)
        _set_shares(before, flown, BACK + 6 * i, at, out)
    out[:, SHEAR] = law.mu * out[:, base + STIFF]


@kernel
def _set_shares(before: np.ndarray, flown: np.ndarray, back: int, at: int, out: np.ndarray) -> None:
    """What follows from C and gamma of one backstress, whose rows begin at `at` and whose Y_n at `back` of the old state."""
    for e in range(out.shape[0]):
        for q in range(8):
            gamma, recall = flown[e, q], out[e, at + _RECALL, q]
            z = recall * gamma
            share, kept = decay_share(z), np.exp(-z)
            out[e, at + _HELD, q], out[e, at + _KEPT, q] = out[e, at + _MODULUS, q] * kept, kept
            out[e, at + _GAIN, q], out[e, at + _BY_RECALL, q] = gamma * share, gamma * gamma * (gain_share(z) - share)
            for m in range(6):
                out[e, at + _OLD + m, q] = before[e, q, back + m]


@kernel(forceinline=True)
def _slope(n: int, by: int, n_active: int) -> int:
    """Row, after SLOPES_OF, of a derivative of number n of `structure_gradients`: by Lambda_n, dLambda, theta, then the numbers."""
    return n * (3 + n_active) + by


@kernel
def relative_responses_of_points(
    f: Tensor,
    state_n: np.ndarray,
    state: np.ndarray,
    law: Law,
    further: tuple[int, int, int],
    in_surface: np.ndarray,
    w: np.ndarray,
    out: np.ndarray,
) -> None:
    """`rates.responses_of_points` with these effects; further = (first row of this page, in which what the law page gives stands; number of
    its active numbers; first row of the curvature of the surface)."""
    base, n_active, curved = further
    f_el = product(f, columns(state))
    set_tensor_rows(out, F_EL, f_el)
    gamma = column(state, LAMBDA) - column(state_n, LAMBDA)
    flows = gamma > 0.0
    set_row(out, IS_PLASTIC, where(flows, 1.0, 0.0))
    if not any_lane(flows):
        return
    f_trial = product(f, columns(state_n))
    set_tensor_rows(out, F_TRIAL, f_trial)
    set_tensor_rows(out, PULLED, product(transposed(f_trial), f))
    c_trial, c, shear = inner_gram(f_trial), inner_gram(f_el), row(out, SHEAR)
    slopes_at = base + SLOPES_OF
    by_m = row(out, slopes_at + _slope(0, 0, n_active))
    t, by_increment, gained, by_gained = scaled(c, shear), scaled(c, law.mu * by_m), spread(0.0), spread(0.0)
    for i in range(N_BACK):
        at = base + _TERMS + _OF_TERM * i
        q, kept, gain, modulus = row(out, at + _HELD), row(out, at + _KEPT), row(out, at + _GAIN), row(out, at + _MODULUS)
        old, recall, by_recall = symmetric_rows(out, at + _OLD), row(out, at + _RECALL), row(out, at + _BY_RECALL)
        modulus_by = row(out, slopes_at + _slope(1 + 2 * i, 1, n_active))
        recall_by = row(out, slopes_at + _slope(2 + 2 * i, 1, n_active))
        t = added(t, old, -q)
        by_increment = added(by_increment, old, q * (recall + gamma * recall_by) - modulus_by * kept)
        gained = gained + modulus * gain
        by_gained = by_gained + modulus_by * gain + modulus * (kept + by_recall * recall_by)
    flow, norm = surface_flow_and_curvature(t, law, out, curved)
    stressed = where(norm > 0.0, norm, 1.0)
    r = where(flows, gamma / stressed, 0.0)
    factor, by_sense = row(out, base + FACTOR), row(out, base + BY_SENSE)
    sigma_y = (norm - gained) / factor
    _, sense = sense_and_gradient(t)
    normal = added(flow, sense, -(sigma_y * by_sense))
    minus_d = scaled(flow, where(flows, -gamma, 0.0))
    y, terms = exponential_of_traceless(minus_d)
    y_c = product(full(y), full(c_trial))
    slopes = exponential_slopes(minus_d, terms)
    set_six(w, SLOPES, scaled(added(slopes[0], slopes[1], spread(-1.0)), -0.5))
    set_six(w, SLOPES + 6, scaled(added(slopes[0], slopes[1], spread(1.0)), -0.5))
    set_six(w, SLOPES + 12, scaled(slopes[2], -1.0))
    set_six(w, SLOPES + 18, scaled(slopes[3], -1.0))
    set_six(w, SLOPES + 24, scaled(slopes[4], -1.0))
    for m in range(5):
        s = scaled(symmetric_sum(full(symmetric_rows(w, SLOPES + 6 * m)), y_c), shear)
        set_row(w, ALONG + m, double_contraction(normal, s))
        column_of = _five(scaled(projected(s, flow, law, out, curved), -r))
        for k in range(5):
            set_row(w, SYSTEM + WIDTH * k + m, column_of[k] + (1.0 if k == m else 0.0))
            set_row(w, SYSTEM + WIDTH * k + 6 + m, 1.0 if k == m else 0.0)
    driven = _five(added(flow, projected(by_increment, flow, law, out, curved), r))
    for k in range(5):
        set_row(w, SYSTEM + WIDTH * k + 5, driven[k])
        set_row(w, SYSTEM + WIDTH * k + 11, 0.0)
    eliminate(w)
    set_six(out, FLOW, flow)
    set_six(out, C_ELASTIC, c)
    set_six(out, EXPONENTIAL, y)
    set_row(out, NORM, norm)
    set_row(out, RATIO, r)
    set_six(out, base + _T, t)
    set_six(out, base + _NORMAL, normal)
    set_six(out, base + _BY_INCREMENT, by_increment)
    set_six(out, base + _SENSE, sense)
    set_six(out, base + _DIRECTION, scaled(deviator(t), 1.0 / stressed))
    set_tensor_rows(out, base + _Y_C, y_c)
    set_row(out, base + _STRESS, sigma_y)
    slope = factor * row(out, BY_GAMMA) + by_gained
    across = double_contraction(normal, by_increment) - slope
    set_row(out, DENOMINATOR, across + _set_solutions(w, out))
    _set_number_slopes(t, law, in_surface, out, curved + N_CURVATURE)


@kernel(forceinline=True)
def _set_solutions(w: np.ndarray, out: np.ndarray) -> Lanes:
    """Y B (N + r P V), Y B and W : m mu S B into the response, Y = dexp(-D)/dD; returns W : m mu S B (N + r P V)."""
    o = spread(0.0)
    across, y_driven = o, (o, o, o, o, o, o)
    for k in range(5):
        v = row(w, SYSTEM + WIDTH * k + 5)
        across, y_driven = multiply_add(row(w, ALONG + k), v, across), added(y_driven, symmetric_rows(w, SLOPES + 6 * k), v)
    set_six(out, YBN, y_driven)
    for m in range(5):
        y, along = (o, o, o, o, o, o), o
        for k in range(5):
            b = row(w, SYSTEM + WIDTH * k + 6 + m)
            y, along = added(y, symmetric_rows(w, SLOPES + 6 * k), b), multiply_add(row(w, ALONG + k), b, along)
        set_six(out, YB + 6 * m, y)
        set_row(out, VB + m, along)
    return across


@kernel(forceinline=True)
def _five(s: Symmetric) -> tuple[Lanes, Lanes, Lanes, Lanes, Lanes]:
    """Unknowns of the equations: 11 - 22, 11 + 22, 12, 23, 13, as in `lanes_relative`."""
    return (s[0] - s[1], s[0] + s[1], s[3], s[4], s[5])


@kernel(forceinline=True)
def _of_numbers(c: np.ndarray, q: int, at: int, by_lambda: Lanes, by_theta: Lanes, active: np.ndarray, w: np.ndarray) -> Lanes:
    """Rate at fixed dLambda of a number of `structure_gradients`, whose derivatives begin at row `at`."""
    value = multiply_add(number(c, at, q), by_lambda, number(c, at + 2, q) * by_theta)
    return value + summed(c, q, at + 3, active, w)


@kernel
def stiffness_rate(c: np.ndarray, q: int, base: int, ends: tuple[Lanes, Lanes], along: Directions, w: np.ndarray) -> Lanes:
    """m' of a point whose Lambda and theta at the end of the step have the given rates."""
    at = base + SLOPES_OF
    return _of_numbers(c, q, at, ends[0], ends[1], along.in_structure, w)


@kernel
def relative_flow_rates(
    c: np.ndarray,
    q: int,
    base: int,
    fp_rate: Tensor,
    alpha_n: Lanes,
    lambda_n: Lanes,
    back: tuple[np.ndarray, int, int],
    strain: Symmetric,
    law: Law,
    along: Directions,
    w: np.ndarray,
) -> tuple[Symmetric, Lanes, Lanes]:
    """y', alpha' and Lambda' of a flowing point, as `rates.flow_rates`; the rates of tr C_el, xi and all Y go into the rows RESULT of w.

    back = (rates of old states, row of the first component of Y_n there, distance of its rows).
    """
    rates_n, back_at, step = back
    active, n_active, slopes = along.in_structure, along.in_structure.shape[0], base + SLOPES_OF
    theta, mu_rate, flow, ratio = row(w, THETA_RATE), row(w, NUMBER_RATES + MU), six(c, FLOW, q), number(c, RATIO, q)
    t, normal, c_el, gamma = six(c, base + _T, q), six(c, base + _NORMAL, q), six(c, C_ELASTIC, q), number(c, base + FLOWN, q)
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
    m_rate = _of_numbers(c, q, slopes, lambda_n, theta, active, w)
    shear_rate = law.mu * m_rate + number(c, base + STIFF, q) * mu_rate
    driven, gained = added(scaled(b, number(c, SHEAR, q)), c_el, shear_rate), spread(0.0)
    for i in range(N_BACK):
        at = base + _TERMS + _OF_TERM * i
        held, kept, gain, modulus = (
            number(c, at + _HELD, q),
            number(c, at + _KEPT, q),
            number(c, at + _GAIN, q),
            number(c, at + _MODULUS, q),
        )
        modulus_rate = _of_numbers(c, q, slopes + _slope(1 + 2 * i, 0, n_active), lambda_n, theta, active, w)
        recall_rate = _of_numbers(c, q, slopes + _slope(2 + 2 * i, 0, n_active), lambda_n, theta, active, w)
        driven = added(driven, six(c, at + _OLD, q), gamma * held * recall_rate - kept * modulus_rate)
        driven = added(driven, _back_rates(rates_n, back_at + 6 * i * step, step), spread(-held))
        gained = gained + gain * modulus_rate + (modulus * number(c, at + _BY_RECALL, q)) * recall_rate
    e, h = _surface_rates(t, flow, law, c, _curvature_at(base, along), q, along.in_surface, w)
    rho = _five(scaled(added(projected_at(driven, flow, law, c, _curvature_at(base, along), q), e, 1.0), ratio))
    at = GRADIENTS + along.in_pressure.shape[0]
    sigma = multiply_add(number(c, BY_ALPHA, q), alpha_n, summed(c, q, at, along.in_yield, w))
    sigma = multiply_add(number(c, BY_THETA, q), theta, multiply_add(number(c, BY_LAMBDA, q), lambda_n, sigma))
    factor_rate = summed(c, q, slopes + N_STRUCTURE * (3 + n_active), along.in_sense, w)
    radius = number(c, base + FACTOR, q) * sigma + number(c, base + _STRESS, q) * factor_rate + gained
    rest = double_contraction(normal, driven) + h - radius
    for k in range(5):
        rest = multiply_add(number(c, VB + k, q), rho[k], rest)
    gamma_rate = rest * (-1.0 / number(c, DENOMINATOR, q))
    y = scaled(six(c, YBN, q), gamma_rate)
    for k in range(5):
        y = added(y, six(c, YB + 6 * k, q), rho[k])
    grown = symmetric_sum(full(y), nine(c, base + _Y_C, q))
    t_rate = added(added(driven, grown, number(c, SHEAR, q)), six(c, base + _BY_INCREMENT, q), gamma_rate)
    norm_rate = double_contraction(flow, t_rate) + h
    set_row(w, RESULT, b[0] + b[1] + b[2] + grown[0] + grown[1] + grown[2])
    set_row(w, RESULT + 1, double_contraction(six(c, base + _SENSE, q), t_rate))
    direction = six(c, base + _DIRECTION, q)
    turned = scaled(added(deviator(t_rate), direction, -norm_rate), 1.0 / number(c, NORM, q))
    for i in range(N_BACK):
        at = base + _TERMS + _OF_TERM * i
        kept, by_recall, recall = number(c, at + _KEPT, q), number(c, at + _BY_RECALL, q), number(c, at + _RECALL, q)
        recall_at = slopes + _slope(2 + 2 * i, 0, n_active)
        recall_rate = _of_numbers(c, q, recall_at, lambda_n, theta, active, w) + number(c, recall_at + 1, q) * gamma_rate
        kept_rate = (recall_rate * gamma + gamma_rate * recall) * (-kept)
        gain_rate = gamma_rate * kept + recall_rate * by_recall
        new = scaled(_back_rates(rates_n, back_at + 6 * i * step, step), kept)
        new = added(added(added(new, six(c, at + _OLD, q), kept_rate), direction, gain_rate), turned, spread(number(c, at + _GAIN, q)))
        set_six(w, RESULT + 2 + 6 * i, new)
    alpha = number(c, ALPHA_BY_ALPHA, q) * alpha_n + number(c, ALPHA_BY_GAMMA, q) * gamma_rate
    return y, alpha + summed(c, q, at_of_alpha(along), along.in_yield, w), lambda_n + gamma_rate


@kernel(forceinline=True)
def at_of_alpha(along: Directions) -> int:
    """First row of the gradient of alpha by the active numbers."""
    return GRADIENTS + along.in_pressure.shape[0] + along.in_yield.shape[0]


@kernel(forceinline=True)
def _back_rates(values: np.ndarray, at: int, step: int) -> Symmetric:
    """Symmetric tensor in the rows at, at + step, ... of an array of lanes."""
    return (
        row(values, at), row(values, at + step), row(values, at + 2 * step),
        row(values, at + 3 * step), row(values, at + 4 * step), row(values, at + 5 * step),
    )  # fmt: skip


@kernel(forceinline=True)
def _hill_rates(a: Symmetric, flow: Symmetric, norm: float, w: np.ndarray) -> tuple[Symmetric, Lanes]:
    """e' = G' : T - N h' and h' = T : G' : T / (2 n)."""
    at = NUMBER_RATES + HILL
    f, g, h = row(w, at) * (a[0] - a[1]), row(w, at + 1) * (a[2] - a[0]), row(w, at + 2) * (a[1] - a[2])
    e = (f - g, h - f, g - h, row(w, at + 3) * a[3], row(w, at + 4) * a[4], row(w, at + 5) * a[5])
    h_rate = double_contraction(a, e) * (0.5 / norm)
    return added(e, flow, -h_rate), h_rate


@kernel(forceinline=True)
def _number_rates(c: np.ndarray, at: int, q: int, in_surface: np.ndarray, w: np.ndarray) -> tuple[Symmetric, Lanes]:
    """e' = phi dN/dz z' and h' = dphi/dz z' of the active numbers z of a transformed surface, seven rows each from `at` on."""
    o = spread(0.0)
    e, h = (o, o, o, o, o, o), o
    for i in range(in_surface.shape[0]):
        rate = row(w, NUMBER_RATES + in_surface[i])
        h = multiply_add(number(c, at + 7 * i, q), rate, h)
        e = added(e, six(c, at + 7 * i + 1, q), rate)
    return e, h


def _surface_rates(
    t: Symmetric, flow: Symmetric, law: Law, c: np.ndarray, at: int, q: int, in_surface: np.ndarray, w: np.ndarray
) -> tuple[Symmetric, Lanes]:
    """In kernels: e' and h' of whichever surface the law has."""
    raise NotImplementedError


@by_type(_surface_rates)
def _surface_rates_of(t: Any, flow: Any, law: Any, c: Any, at: Any, q: Any, in_surface: Any, w: Any) -> Any:
    if transformed(law):
        return lambda t, flow, law, c, at, q, in_surface, w: _number_rates(c, at + N_CURVATURE, q, in_surface, w)
    return lambda t, flow, law, c, at, q, in_surface, w: _hill_rates(t, flow, number(c, NORM, q), w)


def _set_number_slopes(t: Symmetric, law: Law, in_surface: np.ndarray, out: np.ndarray, at: int) -> None:
    """In kernels: what `_number_rates` needs into rows from `at` on, of a transformed surface."""
    raise NotImplementedError


@by_type(_set_number_slopes)
def _set_number_slopes_of(t: Any, law: Any, in_surface: Any, out: Any, at: Any) -> Any:
    if transformed(law):
        return lambda t, law, in_surface, out, at: _all_number_slopes(t, law, in_surface, out, at)
    return lambda t, law, in_surface, out, at: None


@kernel
def _all_number_slopes(t: Symmetric, law: Law, in_surface: np.ndarray, out: np.ndarray, at: int) -> None:
    for i in range(in_surface.shape[0]):
        normal, value = number_slopes(t, in_surface[i] - SURFACE, law)
        set_row(out, at + 7 * i, value)
        set_six(out, at + 7 * i + 1, normal)


@kernel(forceinline=True)
def _curvature_at(base: int, along: Directions) -> int:
    """First row of the curvature of the surface: after the gradients of the law page."""
    return base + SLOPES_OF + N_STRUCTURE * (3 + along.in_structure.shape[0]) + along.in_sense.shape[0]


@kernel(forceinline=True)
def relative_stress_rates(
    c: np.ndarray, q: int, base: int, f_el_rate: Tensor, k_rate: Lanes, m_rate: Lanes, law: Law, w: np.ndarray
) -> Symmetric:
    """tau' of tau = m (mu F_el F_el^T + k 1); k_rate is m k'."""
    f_el, m, mu_rate = nine(c, F_EL, q), number(c, base + STIFF, q), row(w, NUMBER_RATES + MU)
    tau = added(scaled(symmetric_sum(f_el_rate, f_el), number(c, SHEAR, q)), scaled(outer_gram(f_el), m * mu_rate + law.mu * m_rate), 1.0)
    k = k_rate + m_rate * (number(c, PRESSURE, q) / m)
    return (tau[0] + k, tau[1] + k, tau[2] + k, tau[3], tau[4], tau[5])
