"""Eight points at once: the update, the stress and the tangent of `point` in lanes.

The equations, their solution and the tolerances are those of `point`, which is the page to read. Here the stress is Kirchhoff's,
tau = P F^T, and the tangent a_ijkl = F_jJ F_lL dP_iJ/dF_kL = delta_ik tau_jl + c_ijkl, whose c is symmetric in ij and in kl:

    tau = mu F_el F_el^T + k 1,   F_el = F F_p^-1,
    c_ijkl = k' delta_ij delta_kl - k (delta_ik delta_jl + delta_il delta_jk) + mu [F_tr dZ(E_kl) F_tr^T]_ij,   Z = exp(-2 D),

with F_tr = F F_p(n)^-1 and E_kl = F_k (x) F_l + F_l (x) F_k of the rows F_k of F_el: what C_el gains at a fixed D.
"""

from __future__ import annotations

import math

import numpy as np

from thermofit.core.jit import kernel
from thermofit.core.lanes import Lanes, Mask, all_lanes, any_lane, spread, where
from thermofit.law.page import Law, flow_stress, hardening_variable, pressure_factor
from thermofit.law.tensor import COLUMN, ROW, Symmetric, added, congruence, double_contraction, scaled
from thermofit.point.lanes_memory import column, row, set_column, set_row
from thermofit.point.lanes_tensor import (
    Tensor,
    chosen,
    determinant_and_cofactor,
    exponential_of_traceless,
    exponential_slopes,
    full,
    inner_gram,
    largest_component,
    outer_gram,
    product,
    set_symmetric_rows,
    set_tensor_rows,
    symmetric_rows,
    symmetric_sum,
    tensor_rows,
)
from thermofit.point.update import (
    ALPHA,
    ELASTIC,
    FLOW_ACCURACY,
    FLOW_TOLERANCE,
    INVERTED,
    LAMBDA,
    MAX_ITERATIONS,
    N_STATE,
    NO_CONVERGENCE,
    STRESS_TOLERANCE,
    YIELD_TOLERANCE,
    hill,
)

# Rows of the workspace of a point.
F_ELASTIC, F_TRIAL = 0, 9
"""F_el and F_tr, nine each."""
STATE = 18
"""The state, eleven: before the update the old, then the new one."""
C_TRIAL, FLOW, INCREMENT, EXPONENTIAL = 29, 35, 41, 47
"""C_tr, N, D and exp(-D), six each."""
GAMMA, NORM, SLOPE, K_FACTOR, K_SLOPE = 53, 54, 55, 56, 57
"""dLambda, |C_el|_G, d sigma_y / d dLambda, k and k'."""
STIFFNESS = 58
"""c, 36: row by row over 11, 22, 33, 12, 23, 13."""
_EQUATIONS, _PUSHED, _ALONG_S, _ALONG_E = 94, 154, 184, 189
"""Scratch of the plastic tangent: equations (5, 12), F_tr dZ F_tr^T (5, 6), N : S (5), N : E_kl (6)."""
POINT_ROWS = 195


@kernel(forceinline=True)
def _flow_direction(c_elastic: Symmetric, law: Law) -> tuple[Symmetric, Lanes]:
    """N = G : C_el / |C_el|_G and |C_el|_G (4.14), (4.19)."""
    g = hill(c_elastic, law)
    squared = double_contraction(g, c_elastic)
    norm = math.sqrt(where(squared > 0.0, squared, 0.0))
    return scaled(g, where(norm > 0.0, 1.0 / norm, 0.0)), norm


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
    """`point._return_map` of the lanes `plastic`, the old state in w. Other lanes, and each one once it has converged, keep their D.

    Leaves the solution in w and returns the number of terms of exp(-D), or NO_CONVERGENCE.
    """
    alpha_n, lambda_n = row(w, STATE + ALPHA), row(w, STATE + LAMBDA)
    c = (c_trial[0] + c_trial[1] + c_trial[2]) * (1.0 / 3.0)
    zero, one = spread(0.0), spread(1.0)
    gamma, terms = zero, 1
    d = (zero, zero, zero, zero, zero, zero)
    y = (one, one, one, zero, zero, zero)
    c_elastic = c_trial
    for _ in range(MAX_ITERATIONS):
        flow, norm = _flow_direction(c_elastic, law)
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
    """`point.local_update` of eight points: their new state and, in the workspace w, all that stress and tangent need.

    f deformation gradient, theta K, state_n and state (8, 11). Returns ELASTIC, or the number of terms of exp(-D) where at least one
    point flows, or NO_CONVERGENCE or INVERTED where at least one fails.
    """
    j, _ = determinant_and_cofactor(f)
    if not all_lanes(j > 0.0):
        return INVERTED
    k, k_slope = pressure_factor(math.log(j), j, theta, law)
    set_row(w, K_FACTOR, k)
    set_row(w, K_SLOPE, k_slope)
    for m in range(N_STATE):
        set_row(w, STATE + m, column(state_n, m))
    fp_inv, alpha_n, lambda_n = tensor_rows(w, STATE), row(w, STATE + ALPHA), row(w, STATE + LAMBDA)
    f_trial = product(f, fp_inv)
    c_trial = inner_gram(f_trial)
    _, norm = _flow_direction(c_trial, law)
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
    return status


@kernel(forceinline=True)
def kirchhoff_stress(law: Law, w: np.ndarray) -> Symmetric:
    """tau = mu F_el F_el^T + k 1 in MPa, after `update_lanes`."""
    b, k = scaled(outer_gram(tensor_rows(w, F_ELASTIC)), law.mu), row(w, K_FACTOR)
    return (b[0] + k, b[1] + k, b[2] + k, b[3], b[4], b[5])


@kernel(forceinline=True)
def add_to_row(w: np.ndarray, n: int, value: Lanes) -> None:
    """Row n += value."""
    set_row(w, n, row(w, n) + value)


@kernel(forceinline=True)
def set_spatial_stiffness(status: int, law: Law, w: np.ndarray) -> None:
    """c into the rows STIFFNESS of w, in MPa, after `update_lanes`, whose answer is `status`."""
    if status == ELASTIC:
        for m in range(36):
            set_row(w, STIFFNESS + m, 0.0)
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

    With x = -D, S = dC_el/dx at a fixed C_tr, r = dLambda/|C_el|_G and eta = (1 - r sigma_y'/mu) d dLambda, `point._plastic_response`
    reads

        dx + r G : S dx = -N eta - r G : E,   N : (E + S dx) = sigma_y' eta / (mu - r sigma_y').
    """
    gamma, flow, slope = row(w, GAMMA), symmetric_rows(w, FLOW), row(w, SLOPE)
    flows = gamma > 0.0
    r = where(flows, gamma / row(w, NORM), 0.0)
    _set_unknowns(terms, r, flow, law, w)
    _set_right_sides(r, flow, law, w)
    _eliminate(w)
    share = law.mu - r * slope
    factor = where(flows, share / (slope + share * _along(w, 5)), 0.0)
    o = spread(0.0)
    for m in range(6):
        eta = factor * (row(w, _ALONG_E + m) - _along(w, 6 + m))
        response = (o, o, o, o, o, o)
        for n in range(5):
            dx = row(w, _EQUATIONS + 12 * n + 6 + m) + eta * row(w, _EQUATIONS + 12 * n + 5)
            response = added(response, symmetric_rows(w, _PUSHED + 6 * n), -law.mu * dx)
        for n in range(6):
            set_row(w, STIFFNESS + 6 * n + m, response[n])


@kernel(forceinline=True)
def _along(w: np.ndarray, n: int) -> Lanes:
    """N : S x of column n of the solutions."""
    value = row(w, _ALONG_S) * row(w, _EQUATIONS + n)
    for m in range(1, 5):
        value = value + row(w, _ALONG_S + m) * row(w, _EQUATIONS + 12 * m + n)
    return value


@kernel(forceinline=True)
def _set_unknowns(terms: int, r: Lanes, flow: Symmetric, law: Law, w: np.ndarray) -> None:
    """1 + r G : S, N : S and F_tr dZ F_tr^T for the components 11, 22, 12, 23, 13 of the traceless dx.

    With Y = exp(x) and dY its derivative: S = dY C_tr Y + Y C_tr dY, dZ = dY Y + Y dY.
    """
    f, f_trial = tensor_rows(w, F_ELASTIC), tensor_rows(w, F_TRIAL)
    y_c = product(full(symmetric_rows(w, EXPONENTIAL)), full(symmetric_rows(w, C_TRIAL)))
    slopes = exponential_slopes(scaled(symmetric_rows(w, INCREMENT), -1.0), terms)
    set_symmetric_rows(w, _PUSHED, slopes[0])
    set_symmetric_rows(w, _PUSHED + 6, slopes[1])
    set_symmetric_rows(w, _PUSHED + 12, slopes[2])
    set_symmetric_rows(w, _PUSHED + 18, slopes[3])
    set_symmetric_rows(w, _PUSHED + 24, slopes[4])
    for m in range(5):
        dy = full(symmetric_rows(w, _PUSHED + 6 * m))
        s = symmetric_sum(dy, y_c)
        set_row(w, _ALONG_S + m, double_contraction(flow, s))
        _set_equation_column(w, m, scaled(hill(s, law), r))
        add_to_row(w, _EQUATIONS + 13 * m, spread(1.0))
        set_symmetric_rows(w, _PUSHED + 6 * m, symmetric_sum(product(f_trial, dy), f))


@kernel(forceinline=True)
def _set_right_sides(r: Lanes, flow: Symmetric, law: Law, w: np.ndarray) -> None:
    """N and r G : E_kl as right-hand sides, and N : E_kl."""
    _set_equation_column(w, 5, flow)
    for m in range(6):
        k, n = F_ELASTIC + 3 * ROW[m], F_ELASTIC + 3 * COLUMN[m]
        a0, a1, a2 = row(w, k), row(w, k + 1), row(w, k + 2)
        b0, b1, b2 = row(w, n), row(w, n + 1), row(w, n + 2)
        e = (2.0 * a0 * b0, 2.0 * a1 * b1, 2.0 * a2 * b2, a0 * b1 + a1 * b0, a1 * b2 + a2 * b1, a0 * b2 + a2 * b0)
        set_row(w, _ALONG_E + m, double_contraction(flow, e))
        _set_equation_column(w, 6 + m, scaled(hill(e, law), r))


@kernel(forceinline=True)
def _set_equation_column(w: np.ndarray, n: int, s: Symmetric) -> None:
    """Components 11, 22, 12, 23, 13 of a traceless tensor as column n of the equations."""
    set_row(w, _EQUATIONS + n, s[0])
    set_row(w, _EQUATIONS + 12 + n, s[1])
    set_row(w, _EQUATIONS + 24 + n, s[3])
    set_row(w, _EQUATIONS + 36 + n, s[4])
    set_row(w, _EQUATIONS + 48 + n, s[5])


@kernel(forceinline=True)
def _eliminate(w: np.ndarray) -> None:
    """Gauss-Jordan elimination of the five equations; without pivoting, since 1 + r G : S is 1 + 2 r G up to the elastic strain."""
    for k in range(5):
        pivot = _EQUATIONS + 12 * k
        r = 1.0 / row(w, pivot + k)
        for j in range(k + 1, 12):
            set_row(w, pivot + j, r * row(w, pivot + j))
        for i in range(5):
            if i != k:
                other = _EQUATIONS + 12 * i
                factor = row(w, other + k)
                for j in range(k + 1, 12):
                    set_row(w, other + j, row(w, other + j) - factor * row(w, pivot + j))
