"""Eight points at once where an effect changes the update itself, or the yield surface is not quadratic: backstress, moduli that change,
yield stress by the sense of flow.

With the factor m(Lambda, theta) on all elastic moduli, the backstresses of `law.backstress` and q_i = C_i exp(-gamma_i dLambda), the
stress and the flow of `lanes_point` become

    tau = m (mu F_el F_el^T + k 1),    T = m mu C_el - sum q_i Y_n,i,    D = dLambda N,    N = G : T / |T|_G,
    |T|_G = f(xi) sigma_y + sum C_i dLambda phi_i,      Y_i = exp(-gamma_i dLambda) Y_n,i + dLambda phi_i dev T / |T|_G.

|T|_G stands for the equivalent stress phi(T) of any surface: then N = dphi/dT, P = phi d2phi/dT2, r P = dLambda dN/dT, and G : T is phi N.
f is the factor of the effects of slot asymmetry at the sense of flow xi = (27/4)^(1/2) J_3 / J_2^(3/2) of dev T (Lode): 1 in uniaxial
tension, -1 in uniaxial compression, 0 in shear. Flow keeps the normal N of the surface, to which f is not associated.

Newton is that of all six equations: with P = G - N N, r = dLambda/|T|_G, S = dC_el/dD, V = dT/d dLambda at a fixed C_el and
W = N - sigma_y f' dxi/dT,

    (1 - r m mu P S) dD - (N + r P V) d dLambda = r P : dT|,      -W : m mu S dD - (W : V - R') d dLambda = W : dT|,

R the right-hand side of the yield condition, dT| what T gains at fixed D and dLambda. The tangent is not symmetric where backstresses
recall, moduli degrade or f changes with xi: its symmetric part is what Newton's method is given, and derivatives are mended by the exact
rates of the forces (body.sensitivity).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from thermofit.core.jit import by_type, kernel
from thermofit.core.lanes import Lanes, all_lanes, any_lane, spread, where
from thermofit.law.backstress import decay_series
from thermofit.law.composition import asymmetry_factor, backstress_terms, modulus_factor
from thermofit.law.page import Law, flow_stress, hardening_variable, transformed
from thermofit.law.tensor import COLUMN, ROW, Symmetric, added, commuting_product, congruence, deviator, double_contraction, scaled
from thermofit.point.lanes_memory import column, row, set_column, set_row
from thermofit.point.lanes_rows import (
    ALONG_E,
    ALONG_S,
    BACK_N,
    BY_INCREMENT,
    C_TRIAL,
    CURVATURE,
    EQUATIONS,
    EXPONENTIAL,
    F_ELASTIC,
    F_TRIAL,
    FLOW,
    FLOW_TOLERANCE,
    GAMMA,
    INCREMENT,
    K_FACTOR,
    K_SLOPE,
    MAX_ITERATIONS,
    NORM,
    NORMAL,
    PUSHED,
    RELATIVE,
    SHEAR,
    SLOPE,
    STATE,
    STIFFENING,
    STIFFNESS,
    STRESS_TOLERANCE,
    eliminate,
    stress_of_rows,
)
from thermofit.point.lanes_surface import flow_accuracy, projected, surface_flow, surface_flow_and_curvature
from thermofit.point.lanes_tensor import (
    Tensor,
    chosen,
    exponential_of_traceless,
    exponential_slopes,
    full,
    inner_gram,
    largest_component,
    product,
    set_symmetric_rows,
    set_tensor_rows,
    symmetric_rows,
    symmetric_sum,
    tensor_rows,
)
from thermofit.point.state import (
    ALPHA,
    BACK,
    ELASTIC,
    LAMBDA,
    N_BACK,
    N_FULL,
    N_STATE,
    NO_CONVERGENCE,
    SENSE,
    TRACE,
    YIELD_TOLERANCE,
)

_LODE = 1.5 * math.sqrt(3.0)
_NEAR = 1e-8
"""Reach of the differences that give Newton the slopes of m over Lambda and of f over xi."""
_SMALL = 1e-2


@kernel(forceinline=True)
def decay_share_of_lanes(z: Lanes) -> Lanes:
    """phi(z) of `law.backstress`, lane by lane."""
    small = abs(z) < _SMALL
    return where(small, decay_series(z), (1.0 - np.exp(-z)) / where(small, 1.0, z))


@kernel(forceinline=True)
def sense_and_gradient(t: Symmetric) -> tuple[Lanes, Symmetric]:
    """xi of a stress and its derivative by it; 1 and zero where there is no stress."""
    s = deviator(t)
    s2 = commuting_product(s, s)
    j2, j3 = 0.5 * (s2[0] + s2[1] + s2[2]), double_contraction(s, s2) * (1.0 / 3.0)
    stressed = j2 > 0.0
    one = where(stressed, j2, 1.0)
    factor = _LODE / (one * np.sqrt(one))
    sense = where(stressed, factor * j3, 1.0)
    by_j3, by_j2 = where(stressed, factor, 0.0), where(stressed, -1.5 * sense / one, 0.0)
    mean = (2.0 / 3.0) * j2
    g = (s2[0] - mean, s2[1] - mean, s2[2] - mean, s2[3], s2[4], s2[5])
    return sense, added(scaled(g, by_j3), s, by_j2)


@kernel(forceinline=True)
def _recalled(accumulated: Lanes, gamma: Lanes, theta: Lanes, law: Law, w: np.ndarray) -> tuple[Symmetric, Symmetric, Lanes, Lanes]:
    """sum q_i Y_n,i and its slope over dLambda, sum C_i dLambda phi_i and its slope; C and gamma held."""
    o = spread(0.0)
    held, slope, gained, by_gained = (o, o, o, o, o, o), (o, o, o, o, o, o), o, o
    terms = backstress_terms(accumulated, gamma * law.per_second, theta, law)
    for i in range(N_BACK):
        modulus, recall = terms[i][0], terms[i][1]
        z, y = recall * gamma, symmetric_rows(w, BACK_N + 6 * i)
        q = modulus * np.exp(-z)
        held, slope = added(held, y, q), added(slope, y, -(q * recall))
        gained, by_gained = gained + modulus * gamma * decay_share_of_lanes(z), by_gained + q
    return held, slope, gained, by_gained


@kernel
def update_relative(f: Tensor, theta: Lanes, state_n: np.ndarray, law: Law, w: np.ndarray, state: np.ndarray) -> int:
    """`lanes_point.update_lanes` with these effects, from where the old state, k and k' stand in w. States that do not hold Y fail."""
    if state_n.shape[1] < N_FULL:
        return NO_CONVERGENCE
    for m in range(6 * N_BACK):
        set_row(w, BACK_N + m, column(state_n, BACK + m))
    fp_inv, alpha_n, lambda_n = tensor_rows(w, STATE), row(w, STATE + ALPHA), row(w, STATE + LAMBDA)
    f_trial = product(f, fp_inv)
    c_trial = inner_gram(f_trial)
    o = spread(0.0)
    held, _, _, _ = _recalled(lambda_n, o, theta, law, w)
    stiff = modulus_factor(lambda_n, theta, law)
    t = added(scaled(c_trial, stiff * law.mu), held, -1.0)
    _, norm = surface_flow(t, law)
    sigma_y = flow_stress(alpha_n, lambda_n, o, theta, law)[0] * asymmetry_factor(sense_and_gradient(t)[0], law)
    excess = where(norm > sigma_y * (1.0 + YIELD_TOLERANCE), 1.0, 0.0)
    set_row(w, GAMMA, o)
    set_tensor_rows(w, F_TRIAL, f_trial)
    set_tensor_rows(w, F_ELASTIC, f_trial)
    status = ELASTIC
    if law.plastic == 1 and any_lane(excess > 0.0):
        status = _return_map(c_trial, theta, excess, law, w)
        if status == NO_CONVERGENCE:
            return NO_CONVERGENCE
        y, gamma = full(symmetric_rows(w, EXPONENTIAL)), row(w, GAMMA)
        set_tensor_rows(w, F_ELASTIC, product(f_trial, y))
        alpha, _ = hardening_variable(alpha_n, gamma, law)
        set_tensor_rows(w, STATE, product(fp_inv, y))
        set_row(w, STATE + ALPHA, where(excess > 0.0, alpha, alpha_n))
        set_row(w, STATE + LAMBDA, lambda_n + gamma)
        stiff = modulus_factor(lambda_n + gamma, theta, law)
    set_row(w, SHEAR, stiff * law.mu)
    set_row(w, K_FACTOR, stiff * row(w, K_FACTOR))
    set_row(w, K_SLOPE, stiff * row(w, K_SLOPE))
    for m in range(N_STATE):
        set_column(state, m, row(w, STATE + m))
    set_structure(status, theta, state_n, law, w, state)
    return status


@kernel(forceinline=True)
def _set_column(w: np.ndarray, n: int, s: Symmetric) -> None:
    """A traceless tensor as column n of the equations: 11 - 22, 11 + 22, 12, 23, 13. Up to their scale these are coordinates in an
    orthonormal basis, in which 1 + r P is symmetric and positive, so that elimination needs no pivots however large r is."""
    set_row(w, EQUATIONS + n, s[0] - s[1])
    set_row(w, EQUATIONS + 12 + n, s[0] + s[1])
    set_row(w, EQUATIONS + 24 + n, s[3])
    set_row(w, EQUATIONS + 36 + n, s[4])
    set_row(w, EQUATIONS + 48 + n, s[5])


@kernel(forceinline=True)
def _set_system(terms: int, r: Lanes, shear: Lanes, law: Law, w: np.ndarray) -> None:
    """The five equations and W : m mu S for the unknowns D11 - D22, D11 + D22, D12, D23, D13, and N + r P V as column 5; PUSHED holds
    dexp(-D)."""
    flow, normal, by_increment = symmetric_rows(w, FLOW), symmetric_rows(w, NORMAL), symmetric_rows(w, BY_INCREMENT)
    y_c = product(full(symmetric_rows(w, EXPONENTIAL)), full(symmetric_rows(w, C_TRIAL)))
    slopes = exponential_slopes(scaled(symmetric_rows(w, INCREMENT), -1.0), terms)
    set_symmetric_rows(w, PUSHED, scaled(added(slopes[0], slopes[1], -1.0), 0.5))
    set_symmetric_rows(w, PUSHED + 6, scaled(added(slopes[0], slopes[1], 1.0), 0.5))
    set_symmetric_rows(w, PUSHED + 12, slopes[2])
    set_symmetric_rows(w, PUSHED + 18, slopes[3])
    set_symmetric_rows(w, PUSHED + 24, slopes[4])
    for m in range(5):
        dy = scaled(symmetric_rows(w, PUSHED + 6 * m), -1.0)
        set_symmetric_rows(w, PUSHED + 6 * m, dy)
        s = scaled(symmetric_sum(full(dy), y_c), shear)
        set_row(w, ALONG_S + m, double_contraction(normal, s))
        _set_column(w, m, scaled(projected(s, flow, law, w, CURVATURE), -r))
        set_row(w, EQUATIONS + 13 * m, row(w, EQUATIONS + 13 * m) + 1.0)
    _set_column(w, 5, added(flow, projected(by_increment, flow, law, w, CURVATURE), r))


@kernel(forceinline=True)
def _along(w: np.ndarray, n: int) -> Lanes:
    """W : m mu S x of column n of the solutions."""
    value = row(w, ALONG_S) * row(w, EQUATIONS + n)
    for m in range(1, 5):
        value = value + row(w, ALONG_S + m) * row(w, EQUATIONS + 12 * m + n)
    return value


@kernel(forceinline=True)
def _solution(w: np.ndarray, n: int) -> Symmetric:
    """Column n of the solutions as a traceless tensor."""
    apart, both = row(w, EQUATIONS + n), row(w, EQUATIONS + 12 + n)
    return (
        0.5 * (both + apart),
        0.5 * (both - apart),
        -both,
        row(w, EQUATIONS + 24 + n),
        row(w, EQUATIONS + 36 + n),
        row(w, EQUATIONS + 48 + n),
    )


@kernel(forceinline=True)
def _residual(
    d: Symmetric, gamma: Lanes, y: Symmetric, c_elastic: Symmetric, theta: Lanes, law: Law, w: np.ndarray
) -> tuple[Symmetric, Lanes, Lanes, Any]:
    """D - dLambda N, the excess over the yield stress, its slope over dLambda, and the mask of lanes that are solved, at D and dLambda;
    what a step of Newton takes goes into w."""
    alpha_n, accumulated = row(w, STATE + ALPHA), row(w, STATE + LAMBDA) + gamma
    stiff = modulus_factor(accumulated, theta, law)
    by_lambda = (modulus_factor(accumulated + _NEAR, theta, law) - stiff) * (1.0 / _NEAR)
    shear = stiff * law.mu
    held, by_held, gained, by_gained = _recalled(accumulated, gamma, theta, law, w)
    t = added(scaled(c_elastic, shear), held, -1.0)
    flow, norm = surface_flow_and_curvature(t, law, w, CURVATURE)
    sense, gradient = sense_and_gradient(t)
    factor = asymmetry_factor(sense, law)
    by_sense = (asymmetry_factor(sense + _NEAR, law) - factor) * (1.0 / _NEAR)
    alpha, d_alpha = hardening_variable(alpha_n, gamma, law)
    sigma_y, by_alpha, by_flow = flow_stress(alpha, accumulated, gamma, theta, law)
    slope = factor * (by_alpha * d_alpha + by_flow) + by_gained
    excess = norm - factor * sigma_y - gained
    error = added(d, flow, -gamma)
    set_row(w, GAMMA, gamma)
    set_row(w, NORM, norm)
    set_row(w, SLOPE, slope)
    set_row(w, STIFFENING, by_lambda / stiff)
    set_row(w, SHEAR, shear)
    set_symmetric_rows(w, RELATIVE, t)
    set_symmetric_rows(w, FLOW, flow)
    set_symmetric_rows(w, INCREMENT, d)
    set_symmetric_rows(w, EXPONENTIAL, y)
    set_symmetric_rows(w, BY_INCREMENT, added(scaled(c_elastic, by_lambda * law.mu), by_held, -1.0))
    set_symmetric_rows(w, NORMAL, added(flow, gradient, -(sigma_y * by_sense)))
    on_surface = abs(excess) < STRESS_TOLERANCE * sigma_y
    found = on_surface & (largest_component(error) < FLOW_TOLERANCE + flow_accuracy(law) * gamma)
    return error, excess, slope, found


@kernel(forceinline=True)
def _newton_step(
    error: Symmetric, excess: Lanes, slope: Lanes, gamma: Lanes, terms: int, law: Law, w: np.ndarray
) -> tuple[Symmetric, Lanes]:
    """Change of D, and of dLambda, which falls to no less than half of itself."""
    norm = row(w, NORM)
    _set_system(terms, where(norm > 0.0, gamma / norm, 0.0), row(w, SHEAR), law, w)
    _set_column(w, 6, error)
    eliminate(w, 7)
    across = double_contraction(symmetric_rows(w, NORMAL), symmetric_rows(w, BY_INCREMENT)) - slope
    d_gamma = (_along(w, 6) - excess) / (_along(w, 5) + across)
    d_gamma = where(gamma + d_gamma < 0.0, -0.5 * gamma, d_gamma)
    return added(scaled(_solution(w, 5), d_gamma), _solution(w, 6), -1.0), d_gamma


@kernel(forceinline=True)
def _newton_map(c_trial: Symmetric, theta: Lanes, excess_at_start: Lanes, law: Law, w: np.ndarray) -> int:
    """Solve for D and dLambda in the lanes that exceed; other lanes, and each one once it has converged, keep their D.

    Leaves the solution in w and returns the number of terms of exp(-D), or NO_CONVERGENCE.
    """
    zero, one = spread(0.0), spread(1.0)
    gamma, terms = zero, 1
    d = (zero, zero, zero, zero, zero, zero)
    y = (one, one, one, zero, zero, zero)
    c_elastic = c_trial
    set_symmetric_rows(w, C_TRIAL, c_trial)
    for _ in range(MAX_ITERATIONS):
        error, excess, slope, found = _residual(d, gamma, y, c_elastic, theta, law, w)
        active = (excess_at_start > 0.0) & ~found
        if not any_lane(active):
            return terms
        step, d_gamma = _newton_step(error, excess, slope, gamma, terms, law, w)
        d = chosen(active, added(d, step, 1.0), d)
        gamma = where(active, gamma + d_gamma, gamma)
        if not all_lanes(gamma < 1.0):
            return NO_CONVERGENCE
        y, terms = exponential_of_traceless(scaled(d, -1.0))
        if terms == 0:
            return NO_CONVERGENCE
        c_elastic = congruence(y, c_trial)
    return NO_CONVERGENCE


_MAX_TRIALS = 250
_LONGEST = 0.2
"""Largest component of D by which one step of the search may move."""
_DECREASE = 2e-4
"""Share of the decrease that a full step of Newton predicts, which a step has to reach (Armijo)."""
_SHORTEST = 2.0**-9
"""Share of a step of Newton that is taken however much it gains."""


@kernel
def _searched_map(c_trial: Symmetric, theta: Lanes, excess_at_start: Lanes, law: Law, w: np.ndarray) -> int:
    """`_newton_map` for surfaces with sharp bends, where Newton alone goes to and fro (Perez-Foguet and Armero 2002; Scherzinger 2017).

    Each lane halves its step until |D - dLambda N|^2 + (excess / 2 mu)^2 falls. While one lane halves, others go on with theirs.
    """
    zero, one = spread(0.0), spread(1.0)
    gamma, terms = zero, 1
    d = (zero, zero, zero, zero, zero, zero)
    y = (one, one, one, zero, zero, zero)
    c_elastic = c_trial
    set_symmetric_rows(w, C_TRIAL, c_trial)
    base, base_gamma, merit, share, length, d_gamma = d, gamma, spread(math.inf), one, one, zero
    step = d
    for _ in range(_MAX_TRIALS):
        error, excess, slope, found = _residual(d, gamma, y, c_elastic, theta, law, w)
        active = (excess_at_start > 0.0) & ~found
        if not any_lane(active):
            return terms
        off = excess / (2.0 * row(w, SHEAR))
        here = double_contraction(error, error) + off * off
        taken = found | (here <= (1.0 - _DECREASE * share) * merit) | (share < _SHORTEST)
        base, base_gamma, merit = chosen(taken, d, base), where(taken, gamma, base_gamma), where(taken, here, merit)
        next_step, next_d_gamma = _newton_step(error, excess, slope, gamma, terms, law, w)
        size = largest_component(next_step)
        length = where(taken, where(size > _LONGEST, _LONGEST / size, 1.0), length)
        step, d_gamma = chosen(taken, next_step, step), where(taken, next_d_gamma, d_gamma)
        share = where(taken, length, 0.5 * share)
        d = chosen(active, added(base, step, share), d)
        gamma = where(active, base_gamma + share * d_gamma, gamma)
        if not all_lanes(gamma < 1.0):
            return NO_CONVERGENCE
        y, terms = exponential_of_traceless(scaled(d, -1.0))
        if terms == 0:
            return NO_CONVERGENCE
        c_elastic = congruence(y, c_trial)
    return NO_CONVERGENCE


def _return_map(c_trial: Symmetric, theta: Lanes, excess_at_start: Lanes, law: Law, w: np.ndarray) -> int:
    """In kernels: `_newton_map` of a quadratic surface, `_searched_map` of another one."""
    raise NotImplementedError


@by_type(_return_map)
def _return_map_of(c_trial: Any, theta: Any, excess_at_start: Any, law: Any, w: Any) -> Any:
    if transformed(law):
        return lambda c_trial, theta, excess_at_start, law, w: _searched_map(c_trial, theta, excess_at_start, law, w)
    return lambda c_trial, theta, excess_at_start, law, w: _newton_map(c_trial, theta, excess_at_start, law, w)


@kernel
def set_relative_part(terms: int, law: Law, w: np.ndarray) -> None:
    """The symmetric part of what flow adds to c, into the rows STIFFNESS, by the implicit function theorem."""
    gamma, norm, flow = row(w, GAMMA), row(w, NORM), symmetric_rows(w, FLOW)
    flows = gamma > 0.0
    r, shear = where(flows, gamma / norm, 0.0), row(w, SHEAR)
    _set_system(terms, r, shear, law, w)
    normal = symmetric_rows(w, NORMAL)
    for m in range(6):
        k, n = F_ELASTIC + 3 * ROW[m], F_ELASTIC + 3 * COLUMN[m]
        a0, a1, a2 = row(w, k), row(w, k + 1), row(w, k + 2)
        b0, b1, b2 = row(w, n), row(w, n + 1), row(w, n + 2)
        e = (2.0 * a0 * b0, 2.0 * a1 * b1, 2.0 * a2 * b2, a0 * b1 + a1 * b0, a1 * b2 + a2 * b1, a0 * b2 + a2 * b0)
        e = scaled(e, shear)
        set_row(w, ALONG_E + m, double_contraction(normal, e))
        _set_column(w, 6 + m, scaled(projected(e, flow, law, w, CURVATURE), r))
    eliminate(w, 12)
    f, f_trial = tensor_rows(w, F_ELASTIC), tensor_rows(w, F_TRIAL)
    for m in range(5):
        dy = full(symmetric_rows(w, PUSHED + 6 * m))
        set_symmetric_rows(w, PUSHED + 6 * m, symmetric_sum(product(f_trial, dy), f))
    across = double_contraction(normal, symmetric_rows(w, BY_INCREMENT)) - row(w, SLOPE)
    factor = where(flows, -1.0 / (_along(w, 5) + across), 0.0)
    softened = scaled(stress_of_rows(w), row(w, STIFFENING))
    for m in range(6):
        d_gamma = factor * (row(w, ALONG_E + m) + _along(w, 6 + m))
        response = scaled(softened, d_gamma)
        for n in range(5):
            d = row(w, EQUATIONS + 12 * n + 6 + m) + d_gamma * row(w, EQUATIONS + 12 * n + 5)
            response = added(response, symmetric_rows(w, PUSHED + 6 * n), shear * d)
        for n in range(6):
            set_row(w, STIFFNESS + 6 * n + m, response[n])
    for m in range(6):
        for n in range(m):
            mean = 0.5 * (row(w, STIFFNESS + 6 * m + n) + row(w, STIFFNESS + 6 * n + m))
            set_row(w, STIFFNESS + 6 * m + n, mean)
            set_row(w, STIFFNESS + 6 * n + m, mean)


@kernel
def set_structure(status: int, theta: Lanes, state_n: np.ndarray, law: Law, w: np.ndarray, state: np.ndarray) -> None:
    """tr C_el, xi and all Y at the end of a step into the columns of state (8, N_FULL), xi and Y of points that do not flow as they were.

    The first eleven numbers of the state and F_el stand in w. Also where all moduli C are zero: then Y is what they would act on.
    """
    for m in range(N_STATE, N_FULL):
        set_column(state, m, column(state_n, m))
    c_elastic = inner_gram(tensor_rows(w, F_ELASTIC))
    set_column(state, TRACE, c_elastic[0] + c_elastic[1] + c_elastic[2])
    if status == ELASTIC:
        return
    for m in range(6 * N_BACK):
        set_row(w, BACK_N + m, column(state_n, BACK + m))
    gamma, accumulated, shear = row(w, GAMMA), row(w, STATE + LAMBDA), row(w, SHEAR)
    flows = gamma > 0.0
    held, _, _, _ = _recalled(accumulated, gamma, theta, law, w)
    t = added(scaled(c_elastic, shear), held, -1.0)
    _, norm = surface_flow(t, law)
    sense, _ = sense_and_gradient(t)
    direction = scaled(deviator(t), where(flows, 1.0 / norm, 0.0))
    set_column(state, SENSE, where(flows, sense, column(state_n, SENSE)))
    terms = backstress_terms(accumulated, gamma * law.per_second, theta, law)
    for i in range(N_BACK):
        z, old = terms[i][1] * gamma, symmetric_rows(w, BACK_N + 6 * i)
        new = added(scaled(old, np.exp(-z)), direction, gamma * decay_share_of_lanes(z))
        for m in range(6):
            set_column(state, BACK + 6 * i + m, where(flows, new[m], old[m]))
