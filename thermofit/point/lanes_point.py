"""Eight points at once, in lanes: implicit plastic update with the exponential map, stress, and the consistent tangent.

With F_p(n+1) = exp(D) F_p(n), D = dLambda N, N = G : C_el / |C_el|_G (4.14), and C_tr = F_p(n)^-T C F_p(n)^-1:

    C_el = exp(-D) C_tr exp(-D),    F_p^-1 = F_p(n)^-1 exp(-D),    mu |C_el|_G = sigma_y or D = 0 (4.18).

The map preserves det F_p = 1 because tr N = 0 (errata 3), and makes the tangent symmetric where N and C_el are coaxial (von Mises; Hill
along its axes). Elsewhere it is so to 4e-4 dLambda: enough for a Newton matrix, not for an exact derivative. Effects that change the
update itself, and yield surfaces that are not quadratic, are on the page `lanes_relative`; else nothing of it is called.

The stress is Kirchhoff's, tau = P F^T, and the tangent a_ijkl = F_jJ F_lL dP_iJ/dF_kL = delta_ik tau_jl + c_ijkl, whose c is symmetric in
ij and in kl:

    tau = mu F_el F_el^T + k 1,   F_el = F F_p^-1,
    c_ijkl = k' delta_ij delta_kl - k (delta_ik delta_jl + delta_il delta_jk) + mu [F_tr dZ(E_kl) F_tr^T]_ij,   Z = exp(-2 D),

with F_tr = F F_p(n)^-1 and E_kl = F_k (x) F_l + F_l (x) F_k of the rows F_k of F_el: what C_el gains at a fixed D.
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, Mask, all_lanes, any_lane, spread, where
from thermofit.law.page import Law, flow_stress, hardening_variable, hill, pressure_factor, relative
from thermofit.law.tensor import COLUMN, ROW, Symmetric, added, congruence, double_contraction, scaled
from thermofit.point.lanes_memory import column, row, set_column, set_row
from thermofit.point.lanes_relative import set_relative_part, set_structure, update_relative
from thermofit.point.lanes_rows import (
    ALONG_E,
    ALONG_S,
    C_TRIAL,
    EQUATIONS,
    EXPONENTIAL,
    F_ELASTIC,
    F_TRIAL,
    FLOW,
    FLOW_ACCURACY,
    FLOW_TOLERANCE,
    GAMMA,
    INCREMENT,
    K_FACTOR,
    K_SLOPE,
    MAX_ITERATIONS,
    NORM,
    PUSHED,
    SHEAR,
    SLOPE,
    STATE,
    STIFFNESS,
    STRESS_TOLERANCE,
    add_to_row,
    eliminate,
    flow_direction,
    set_equation_column,
    stress_of_rows,
)
from thermofit.point.lanes_tensor import (
    Tensor,
    chosen,
    determinant_and_cofactor,
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
from thermofit.point.state import ALPHA, ELASTIC, INVERTED, LAMBDA, N_STATE, NO_CONVERGENCE, YIELD_TOLERANCE


@kernel(forceinline=True)
def _mapped(normal: Symmetric, s: tuple[Lanes, Lanes, Lanes], v: Symmetric) -> Symmetric:
    """The map with matrix `normal` of the components 11, 22, 33 and factors s of 12, 23, 13, applied to v."""
    return (
        normal[0] * v[0] + normal[3] * v[1] + normal[5] * v[2],
        normal[3] * v[0] + normal[1] * v[1] + normal[4] * v[2],
        normal[5] * v[0] + normal[4] * v[1] + normal[2] * v[2],
        s[0] * v[3],
        s[1] * v[4],
        s[2] * v[5],
    )


@kernel(forceinline=True)
def _apply_inverse(v: Symmetric, w: Symmetric, k: Lanes, law: Law) -> tuple[Symmetric, Symmetric]:
    """(I + k G)^-1 : v and : w; G is the Hill tensor, k >= 0."""
    a, d, f = 1.0 + k * (law.F + law.G), 1.0 + k * (law.F + law.H), 1.0 + k * (law.G + law.H)
    b, c, e = -k * law.F, -k * law.G, -k * law.H
    i11, i12, i13 = d * f - e * e, c * e - b * f, b * e - c * d
    r = 1.0 / (a * i11 + b * i12 + c * i13)
    normal = (r * i11, r * (a * f - c * c), r * (a * d - b * b), r * i12, r * (b * c - a * e), r * i13)
    shear = (1.0 / (1.0 + k * law.L), 1.0 / (1.0 + k * law.M), 1.0 / (1.0 + k * law.N))
    return _mapped(normal, shear, v), _mapped(normal, shear, w)


@kernel(forceinline=True)
def _return_map(c_trial: Symmetric, theta: Lanes, plastic: Mask, law: Law, w: np.ndarray) -> int:
    """Solve D = dLambda N(C_el(D)), mu |C_el|_G = sigma_y (4.18) for D and dLambda in the lanes `plastic`, the old state in w. Other
    lanes, and each one once it has converged, keep their D.

    Newton with dC_el replaced by -2 c dD, c = tr C_tr / 3: exact up to the elastic strain, so that an iteration gains two to three
    digits; the converged answer is exact. Leaves the solution in w and returns the number of terms of exp(-D), or NO_CONVERGENCE.
    """
    alpha_n, lambda_n = row(w, STATE + ALPHA), row(w, STATE + LAMBDA)
    c = (c_trial[0] + c_trial[1] + c_trial[2]) * (1.0 / 3.0)
    zero, one = spread(0.0), spread(1.0)
    gamma, terms = zero, 1
    d = (zero, zero, zero, zero, zero, zero)
    y = (one, one, one, zero, zero, zero)
    c_elastic = c_trial
    for _ in range(MAX_ITERATIONS):
        flow, norm = flow_direction(c_elastic, law)
        alpha, d_alpha = hardening_variable(alpha_n, gamma, law)
        sigma_y, by_alpha, by_lambda = flow_stress(alpha, lambda_n + gamma, gamma, theta, law)
        slope = by_alpha * d_alpha + by_lambda
        excess = law.mu * norm - sigma_y
        error = added(d, flow, -gamma)
        on_surface = abs(excess) < STRESS_TOLERANCE * sigma_y
        active = plastic & ~(on_surface & (largest_component(error) < FLOW_TOLERANCE + FLOW_ACCURACY * gamma))
        if not any_lane(active):
            set_row(w, GAMMA, gamma)
            set_row(w, NORM, norm)
            set_row(w, SLOPE, slope)
            set_symmetric_rows(w, C_TRIAL, c_trial)
            set_symmetric_rows(w, FLOW, flow)
            set_symmetric_rows(w, INCREMENT, d)
            set_symmetric_rows(w, EXPONENTIAL, y)
            return terms
        k = 2.0 * c * gamma / norm
        x, r = _apply_inverse(flow, error, k, law)
        n_x, n_r = double_contraction(flow, x), double_contraction(flow, r)
        rest = 1.0 - k * n_x
        d_gamma = (excess * rest + 2.0 * c * law.mu * n_r) / (2.0 * c * law.mu * n_x + slope * rest)
        d_gamma = where(gamma + d_gamma < 0.0, -0.5 * gamma, d_gamma)
        d = chosen(active, added(added(d, x, (d_gamma - k * n_r) / rest), r, -1.0), d)
        gamma = where(active, gamma + d_gamma, gamma)
        if not all_lanes(gamma < 1.0):
            return NO_CONVERGENCE
        y, terms = exponential_of_traceless(scaled(d, -1.0))
        if terms == 0:
            return NO_CONVERGENCE
        c_elastic = congruence(y, c_trial)
    return NO_CONVERGENCE


@kernel(forceinline=True)
def update_lanes(f: Tensor, theta: Lanes, state_n: np.ndarray, law: Law, w: np.ndarray, state: np.ndarray) -> int:
    """Update eight points: their new state and, in the workspace w, all that stress and tangent need.

    f deformation gradient, theta K, state_n and state (8, n), n = N_STATE or N_FULL. Returns ELASTIC, or the number of terms of exp(-D)
    where at least one point flows, or NO_CONVERGENCE or INVERTED where at least one fails.
    """
    j, _ = determinant_and_cofactor(f)
    if not all_lanes(j > 0.0):
        return INVERTED
    k, k_slope = pressure_factor(math.log(j), j, theta, law)
    set_row(w, K_FACTOR, k)
    set_row(w, K_SLOPE, k_slope)
    set_row(w, SHEAR, law.mu)
    for m in range(N_STATE):
        set_row(w, STATE + m, column(state_n, m))
    if relative(law):
        return update_relative(f, theta, state_n, law, w, state)
    fp_inv, alpha_n, lambda_n = tensor_rows(w, STATE), row(w, STATE + ALPHA), row(w, STATE + LAMBDA)
    f_trial = product(f, fp_inv)
    c_trial = inner_gram(f_trial)
    _, norm = flow_direction(c_trial, law)
    sigma_y, _, _ = flow_stress(alpha_n, lambda_n, spread(0.0), theta, law)
    plastic = law.mu * norm > sigma_y * (1.0 + YIELD_TOLERANCE)
    status, f_elastic = ELASTIC, f_trial
    if law.plastic == 1 and any_lane(plastic):
        status = _return_map(c_trial, theta, plastic, law, w)
        if status == NO_CONVERGENCE:
            return NO_CONVERGENCE
        y, gamma = full(symmetric_rows(w, EXPONENTIAL)), row(w, GAMMA)
        f_elastic = product(f_trial, y)
        alpha, _ = hardening_variable(alpha_n, gamma, law)
        set_tensor_rows(w, STATE, product(fp_inv, y))
        set_row(w, STATE + ALPHA, where(plastic, alpha, alpha_n))
        set_row(w, STATE + LAMBDA, lambda_n + gamma)
    set_tensor_rows(w, F_TRIAL, f_trial)
    set_tensor_rows(w, F_ELASTIC, f_elastic)
    for m in range(N_STATE):
        set_column(state, m, row(w, STATE + m))
    if state.shape[1] > N_STATE:
        set_structure(status, theta, state_n, law, w, state)
    return status


@kernel(forceinline=True)
def kirchhoff_stress(law: Law, w: np.ndarray) -> Symmetric:
    """tau = mu F_el F_el^T + k 1 in MPa, after `update_lanes`."""
    return stress_of_rows(w)


@kernel(forceinline=True)
def set_spatial_stiffness(status: int, law: Law, w: np.ndarray) -> None:
    """c into the rows STIFFNESS of w, in MPa, after `update_lanes`, whose answer is `status`."""
    if status == ELASTIC:
        for m in range(36):
            set_row(w, STIFFNESS + m, 0.0)
    elif relative(law):
        set_relative_part(status, law, w)
    else:
        _set_plastic_part(status, law, w)
    k, k_slope = row(w, K_FACTOR), row(w, K_SLOPE)
    for m in range(3):
        for n in range(3):
            add_to_row(w, STIFFNESS + 6 * m + n, k_slope)
        add_to_row(w, STIFFNESS + 7 * m, -2.0 * k)
        add_to_row(w, STIFFNESS + 7 * (m + 3), -k)


@kernel(forceinline=True)
def _set_plastic_part(terms: int, law: Law, w: np.ndarray) -> None:
    """mu F_tr dZ(E_kl) F_tr^T into the rows STIFFNESS, by the implicit function theorem.

    With x = -D, S = dC_el/dx at a fixed C_tr, r = dLambda/|C_el|_G and eta = (1 - r sigma_y'/mu) d dLambda:

        dx + r G : S dx = -N eta - r G : E,   N : (E + S dx) = sigma_y' eta / (mu - r sigma_y').
    """
    gamma, flow, slope = row(w, GAMMA), symmetric_rows(w, FLOW), row(w, SLOPE)
    flows = gamma > 0.0
    r = where(flows, gamma / row(w, NORM), 0.0)
    _set_unknowns(terms, r, flow, law, w)
    _set_right_sides(r, flow, law, w)
    eliminate(w, 12)
    share = law.mu - r * slope
    factor = where(flows, share / (slope + share * _along(w, 5)), 0.0)
    o = spread(0.0)
    for m in range(6):
        eta = factor * (row(w, ALONG_E + m) - _along(w, 6 + m))
        response = (o, o, o, o, o, o)
        for n in range(5):
            dx = row(w, EQUATIONS + 12 * n + 6 + m) + eta * row(w, EQUATIONS + 12 * n + 5)
            response = added(response, symmetric_rows(w, PUSHED + 6 * n), -law.mu * dx)
        for n in range(6):
            set_row(w, STIFFNESS + 6 * n + m, response[n])


@kernel(forceinline=True)
def _along(w: np.ndarray, n: int) -> Lanes:
    """N : S x of column n of the solutions."""
    value = row(w, ALONG_S) * row(w, EQUATIONS + n)
    for m in range(1, 5):
        value = value + row(w, ALONG_S + m) * row(w, EQUATIONS + 12 * m + n)
    return value


@kernel(forceinline=True)
def _set_unknowns(terms: int, r: Lanes, flow: Symmetric, law: Law, w: np.ndarray) -> None:
    """1 + r G : S, N : S and F_tr dZ F_tr^T for the components 11, 22, 12, 23, 13 of the traceless dx.

    With Y = exp(x) and dY its derivative: S = dY C_tr Y + Y C_tr dY, dZ = dY Y + Y dY.
    """
    f, f_trial = tensor_rows(w, F_ELASTIC), tensor_rows(w, F_TRIAL)
    y_c = product(full(symmetric_rows(w, EXPONENTIAL)), full(symmetric_rows(w, C_TRIAL)))
    slopes = exponential_slopes(scaled(symmetric_rows(w, INCREMENT), -1.0), terms)
    set_symmetric_rows(w, PUSHED, slopes[0])
    set_symmetric_rows(w, PUSHED + 6, slopes[1])
    set_symmetric_rows(w, PUSHED + 12, slopes[2])
    set_symmetric_rows(w, PUSHED + 18, slopes[3])
    set_symmetric_rows(w, PUSHED + 24, slopes[4])
    for m in range(5):
        dy = full(symmetric_rows(w, PUSHED + 6 * m))
        s = symmetric_sum(dy, y_c)
        set_row(w, ALONG_S + m, double_contraction(flow, s))
        set_equation_column(w, m, scaled(hill(s, law), r))
        add_to_row(w, EQUATIONS + 13 * m, spread(1.0))
        set_symmetric_rows(w, PUSHED + 6 * m, symmetric_sum(product(f_trial, dy), f))


@kernel(forceinline=True)
def _set_right_sides(r: Lanes, flow: Symmetric, law: Law, w: np.ndarray) -> None:
    """N and r G : E_kl as right-hand sides, and N : E_kl."""
    set_equation_column(w, 5, flow)
    for m in range(6):
        k, n = F_ELASTIC + 3 * ROW[m], F_ELASTIC + 3 * COLUMN[m]
        a0, a1, a2 = row(w, k), row(w, k + 1), row(w, k + 2)
        b0, b1, b2 = row(w, n), row(w, n + 1), row(w, n + 2)
        e = (2.0 * a0 * b0, 2.0 * a1 * b1, 2.0 * a2 * b2, a0 * b1 + a1 * b0, a1 * b2 + a2 * b1, a0 * b2 + a2 * b0)
        set_row(w, ALONG_E + m, double_contraction(flow, e))
        set_equation_column(w, 6 + m, scaled(hill(e, law), r))
