"""One Gauss point without lanes: implicit plastic update with the exponential map, stress, and the consistent tangent.

A second implementation of the equations of `thermofit.point.lanes_point`, by other algebra, for tests to compare with; it has no effects
that change the update itself.

State of a point, shape (11,): F_p^-1 row by row (9), alpha, accumulated plastic multiplier Lambda. Old state in, new state
out; nothing is changed in between.

With F_p(n+1) = exp(D) F_p(n), D = dLambda N, N = G : C_el / |C_el|_G (4.14), and C_tr = F_p(n)^-T C F_p(n)^-1:

    C_el = exp(-D) C_tr exp(-D),    C_p^-1 = F_p(n)^-1 exp(-2 D) F_p(n)^-T,    P = mu F C_p^-1 + k F^-T.

The map preserves det F_p = 1 because tr N = 0 (errata 3), and makes the tangent symmetric where N and C_el are coaxial (von
Mises; Hill along its axes). Elsewhere it is so to 4e-4 dLambda: enough for a Newton matrix, not for an exact derivative.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from thermofit.core.jit import kernel
from thermofit.law.page import Law, flow_stress, hardening_variable, hill, pressure_factor
from thermofit.law.tensor import (
    COLUMN,
    ROW,
    Symmetric,
    added,
    commuting_product,
    congruence,
    determinant,
    double_contraction,
    inverse_transpose,
    scaled,
)
from thermofit.point.lanes_tensor import MAX_TERMS
from thermofit.point.state import ALPHA, ELASTIC, INVERTED, LAMBDA, N_STATE, NO_CONVERGENCE, PLASTIC, YIELD_TOLERANCE

MAX_ITERATIONS = 60
STRESS_TOLERANCE = 1e-11
"""Distance from the yield surface, relative to the yield stress, at which the return map has converged."""
FLOW_TOLERANCE, FLOW_ACCURACY = 1e-14, 1e-12
"""Error of D at which it has: absolute and relative to dLambda."""
_UNIT = np.array([[1.0 if m == n else 0.0 for n in range(6)] for m in range(6)])


_NEGLIGIBLE = 1e-17


@kernel(forceinline=True)
def multiply(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """out = a . b."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel(forceinline=True)
def multiply_symmetric(a: np.ndarray, s: Symmetric, out: np.ndarray) -> None:
    """out = a . s for a symmetric s."""
    for i in range(3):
        x, y, z = a[i, 0], a[i, 1], a[i, 2]
        out[i, 0] = x * s[0] + y * s[3] + z * s[5]
        out[i, 1] = x * s[3] + y * s[1] + z * s[4]
        out[i, 2] = x * s[5] + y * s[4] + z * s[2]


@kernel(forceinline=True)
def gram(a: np.ndarray) -> Symmetric:
    """a^T . a."""
    return (
        a[0, 0] * a[0, 0] + a[1, 0] * a[1, 0] + a[2, 0] * a[2, 0],
        a[0, 1] * a[0, 1] + a[1, 1] * a[1, 1] + a[2, 1] * a[2, 1],
        a[0, 2] * a[0, 2] + a[1, 2] * a[1, 2] + a[2, 2] * a[2, 2],
        a[0, 0] * a[0, 1] + a[1, 0] * a[1, 1] + a[2, 0] * a[2, 1],
        a[0, 1] * a[0, 2] + a[1, 1] * a[1, 2] + a[2, 1] * a[2, 2],
        a[0, 0] * a[0, 2] + a[1, 0] * a[1, 2] + a[2, 0] * a[2, 2],
    )


@kernel(forceinline=True)
def largest(a: Symmetric) -> float:
    """Largest absolute component."""
    return max(abs(a[0]), abs(a[1]), abs(a[2]), abs(a[3]), abs(a[4]), abs(a[5]))


@kernel(forceinline=True)
def exponential(x: Symmetric) -> tuple[Symmetric, int]:
    """exp(x) by its power series, and the number of terms; 0 terms where the series did not converge.

    Meant for plastic increments (norm well below 1), for which the series ends after 4 to 8 terms at full precision.
    """
    term = x
    out = (1.0 + x[0], 1.0 + x[1], 1.0 + x[2], x[3], x[4], x[5])
    for order in range(2, MAX_TERMS):
        term = scaled(commuting_product(term, x), 1.0 / order)
        out = added(out, term, 1.0)
        if largest(term) < _NEGLIGIBLE:
            return out, order
    return out, 0


@kernel(forceinline=True)
def exponential_derivative(x: Symmetric, dx: Symmetric, n_terms: int) -> Symmetric:
    """d exp(x)[dx]: the derivative of the power series of `exponential` with the same number of terms.

    T_k = x^k / k!, dT_k = (dT_(k-1) . x + T_(k-1) . dx) / k; dT_k is symmetric, so six components suffice.
    """
    term, d_term, out = x, dx, dx
    for order in range(2, n_terms + 1):
        r = 1.0 / order
        d_term = scaled(added(commuting_product(d_term, x), commuting_product(term, dx), 1.0), r)
        term = scaled(commuting_product(term, x), r)
        out = added(out, d_term, 1.0)
    return out


@kernel(forceinline=True)
def solve_in_place(a: np.ndarray, b: np.ndarray) -> None:
    """b := a^-1 . b for a small dense system without pivoting; a (n, n) close to the identity, b (n, m)."""
    n = a.shape[0]
    m = b.shape[1]
    for k in range(n):
        r = 1.0 / a[k, k]
        for i in range(k + 1, n):
            factor = a[i, k] * r
            for j in range(k + 1, n):
                a[i, j] -= factor * a[k, j]
            for j in range(m):
                b[i, j] -= factor * b[k, j]
    for k in range(n - 1, -1, -1):
        r = 1.0 / a[k, k]
        for j in range(m):
            s = b[k, j]
            for i in range(k + 1, n):
                s -= a[k, i] * b[i, j]
            b[k, j] = s * r


class PointWork(NamedTuple):
    """Scratch of one thread and what `local_update` leaves for the stress and the tangent.

    `f_trial` = F F_p(n)^-1, `fp_inv` = F_p(n)^-1, `cp_inv` = C_p^-1, `f_inv_t` = F^-T, each (3, 3); `symmetric` (4, 6) holds C_tr,
    N, D and exp(-D); `scalars` what the names below index; the rest is scratch of the tangent.
    """

    f_trial: np.ndarray
    fp_inv: np.ndarray
    cp_inv: np.ndarray
    f_inv_t: np.ndarray
    t1: np.ndarray
    symmetric: np.ndarray
    scalars: np.ndarray
    lhs: np.ndarray
    rhs: np.ndarray
    ds: np.ndarray
    dz: np.ndarray
    zc: np.ndarray
    w: np.ndarray
    wz: np.ndarray


GAMMA, NORM, SLOPE, TERMS, K_FACTOR, K_SLOPE = 0, 1, 2, 3, 4, 5
C_TRIAL, FLOW, INCREMENT, EXPONENTIAL = 0, 1, 2, 3


@kernel(forceinline=True)
def point_work() -> PointWork:
    """Fresh scratch arrays for one thread."""
    t = np.zeros((5, 3, 3))
    return PointWork(
        t[0], t[1], t[2], t[3], t[4], np.zeros((4, 6)), np.zeros(6), np.zeros((6, 6)), np.zeros((6, 7)), np.zeros((6, 6)),
        np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((9, 6)), np.zeros((9, 6)),
    )  # fmt: skip


@kernel(forceinline=True)
def _kept(w: PointWork, which: int) -> Symmetric:
    s = w.symmetric[which]
    return (s[0], s[1], s[2], s[3], s[4], s[5])


@kernel(forceinline=True)
def _keep(w: PointWork, which: int, a: Symmetric) -> None:
    for m in range(6):
        w.symmetric[which, m] = a[m]


@kernel(forceinline=True)
def flow_direction(c_elastic: Symmetric, law: Law) -> tuple[Symmetric, float]:
    """N = G : C_el / |C_el|_G and |C_el|_G, so that sqrt(M : G : M) = mu |C_el|_G (4.14), (4.19)."""
    g = hill(c_elastic, law)
    norm = math.sqrt(max(double_contraction(g, c_elastic), 0.0))
    return scaled(g, 1.0 / norm if norm > 0.0 else 0.0), norm


@kernel(forceinline=True)
def _apply_inverse(v: Symmetric, k: float, law: Law) -> Symmetric:
    """(I + k G)^-1 : v; G is the Hill tensor, k >= 0."""
    a, d, f = 1.0 + k * (law.F + law.G), 1.0 + k * (law.F + law.H), 1.0 + k * (law.G + law.H)
    b, c, e = -k * law.F, -k * law.G, -k * law.H
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return (
        ((d * f - e * e) * v[0] + (c * e - b * f) * v[1] + (b * e - c * d) * v[2]) / det,
        ((c * e - b * f) * v[0] + (a * f - c * c) * v[1] + (b * c - a * e) * v[2]) / det,
        ((b * e - c * d) * v[0] + (b * c - a * e) * v[1] + (a * d - b * b) * v[2]) / det,
        v[3] / (1.0 + k * law.L),
        v[4] / (1.0 + k * law.M),
        v[5] / (1.0 + k * law.N),
    )


@kernel(forceinline=True)
def _return_map(c_trial: Symmetric, theta: float, state_n: np.ndarray, law: Law, w: PointWork) -> int:
    """Solve D = dLambda N(C_el(D)), mu |C_el|_G = sigma_y (4.18) for D and dLambda; the solution is kept in w.

    Newton with dC_el replaced by -2 c dD, c = tr C_tr / 3: exact up to the elastic strain, so that an iteration gains two to
    three digits; the converged answer is exact.
    """
    alpha_n, lambda_n = state_n[ALPHA], state_n[LAMBDA]
    c = (c_trial[0] + c_trial[1] + c_trial[2]) / 3.0
    gamma, terms = 0.0, 1
    d = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    y = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    c_elastic = c_trial
    for _ in range(MAX_ITERATIONS):
        flow, norm = flow_direction(c_elastic, law)
        alpha, d_alpha = hardening_variable(alpha_n, gamma, law)
        sigma_y, by_alpha, by_lambda = flow_stress(alpha, lambda_n + gamma, gamma, theta, law)
        slope = by_alpha * d_alpha + by_lambda
        excess = law.mu * norm - sigma_y
        error = added(d, flow, -gamma)
        if abs(excess) < STRESS_TOLERANCE * sigma_y and largest(error) < FLOW_TOLERANCE + FLOW_ACCURACY * gamma:
            s = w.scalars
            s[GAMMA], s[NORM], s[SLOPE], s[TERMS] = gamma, norm, slope, terms
            _keep(w, C_TRIAL, c_trial)
            _keep(w, FLOW, flow)
            _keep(w, INCREMENT, d)
            _keep(w, EXPONENTIAL, y)
            return PLASTIC
        # (I + 2 c gamma (G - N N)/|C|) dD = dgamma N - (D - gamma N) by Sherman-Morrison
        k = 2.0 * c * gamma / norm
        x = _apply_inverse(flow, k, law)
        r = _apply_inverse(error, k, law)
        denominator = 1.0 - k * double_contraction(flow, x)
        n_x = double_contraction(flow, x) / denominator
        n_r = double_contraction(flow, r) / denominator
        d_gamma = (excess + 2.0 * c * law.mu * n_r) / (2.0 * c * law.mu * n_x + slope)
        if gamma + d_gamma < 0.0:
            d_gamma = -0.5 * gamma
        d = added(added(d, x, d_gamma * (1.0 + k * n_x) - k * n_r), r, -1.0)
        gamma += d_gamma
        if not gamma < 1.0:
            return NO_CONVERGENCE
        y, terms = exponential(scaled(d, -1.0))
        if terms == 0:
            return NO_CONVERGENCE
        c_elastic = congruence(y, c_trial)
    return NO_CONVERGENCE


@kernel(forceinline=True)
def local_update(f: np.ndarray, theta: float, state_n: np.ndarray, law: Law, w: PointWork, state: np.ndarray) -> int:
    """Update one point: new state and, in w, all that `piola_stress` and `local_tangent` need.

    f (3, 3) deformation gradient at the end of the step, theta K, state_n (11,) and state (11,) as in the module docstring.
    Returns ELASTIC, PLASTIC, NO_CONVERGENCE or INVERTED (det F <= 0).
    """
    j = determinant(f)
    if not j > 0.0:
        return INVERTED
    inverse_transpose(f, j, w.f_inv_t)
    w.scalars[K_FACTOR], w.scalars[K_SLOPE] = pressure_factor(math.log(j), j, theta, law)
    for i in range(3):
        for m in range(3):
            w.fp_inv[i, m] = state_n[3 * i + m]
    multiply(f, w.fp_inv, w.f_trial)
    c_trial = gram(w.f_trial)
    for i in range(N_STATE):
        state[i] = state_n[i]
    _, norm = flow_direction(c_trial, law)
    sigma_y, _, _ = flow_stress(state_n[ALPHA], state_n[LAMBDA], 0.0, theta, law)
    if law.plastic == 0 or law.mu * norm <= sigma_y * (1.0 + YIELD_TOLERANCE):
        _set_cp_inv(w.fp_inv, w)
        return ELASTIC
    status = _return_map(c_trial, theta, state_n, law, w)
    if status != PLASTIC:
        return status
    multiply_symmetric(w.fp_inv, _kept(w, EXPONENTIAL), w.t1)  # F_p^-1 = F_p(n)^-1 exp(-D)
    _set_cp_inv(w.t1, w)
    for i in range(3):
        for m in range(3):
            state[3 * i + m] = w.t1[i, m]
    gamma = w.scalars[GAMMA]
    state[ALPHA], _ = hardening_variable(state_n[ALPHA], gamma, law)
    state[LAMBDA] = state_n[LAMBDA] + gamma
    return PLASTIC


@kernel(forceinline=True)
def _set_cp_inv(fp_inv: np.ndarray, w: PointWork) -> None:
    """C_p^-1 = F_p^-1 F_p^-T."""
    for i in range(3):
        for j in range(3):
            w.cp_inv[i, j] = fp_inv[i, 0] * fp_inv[j, 0] + fp_inv[i, 1] * fp_inv[j, 1] + fp_inv[i, 2] * fp_inv[j, 2]


@kernel(forceinline=True)
def piola_stress(f: np.ndarray, law: Law, w: PointWork, p: np.ndarray) -> None:
    """P = mu F C_p^-1 + k F^-T in MPa (4.8), after `local_update`."""
    multiply(f, w.cp_inv, p)
    k = w.scalars[K_FACTOR]
    for i in range(3):
        for j in range(3):
            p[i, j] = law.mu * p[i, j] + k * w.f_inv_t[i, j]


@kernel(forceinline=True)
def _set_column(a: np.ndarray, m: int, s: Symmetric) -> None:
    for n in range(6):
        a[n, m] = s[n]


@kernel(forceinline=True)
def _column(a: np.ndarray, m: int) -> Symmetric:
    return (a[0, m], a[1, m], a[2, m], a[3, m], a[4, m], a[5, m])


@kernel(forceinline=True)
def _sum_product(a: Symmetric, b: Symmetric) -> Symmetric:
    """a . b + b . a of two symmetric tensors."""
    return (
        2.0 * (a[0] * b[0] + a[3] * b[3] + a[5] * b[5]),
        2.0 * (a[3] * b[3] + a[1] * b[1] + a[4] * b[4]),
        2.0 * (a[5] * b[5] + a[4] * b[4] + a[2] * b[2]),
        a[0] * b[3] + a[3] * b[1] + a[5] * b[4] + b[0] * a[3] + b[3] * a[1] + b[5] * a[4],
        a[3] * b[5] + a[1] * b[4] + a[4] * b[2] + b[3] * a[5] + b[1] * a[4] + b[4] * a[2],
        a[0] * b[5] + a[3] * b[4] + a[5] * b[2] + b[0] * a[5] + b[3] * a[4] + b[5] * a[2],
    )


@kernel(forceinline=True)
def _projected(a: Symmetric, flow: Symmetric, law: Law) -> Symmetric:
    """(G - N N) : a, so that dN = (G - N N) : dC_el / |C_el|_G."""
    return added(hill(a, law), flow, -double_contraction(flow, a))


@kernel(forceinline=True)
def _plastic_response(law: Law, w: PointWork) -> None:
    """w.zc (6, 6): derivative of Z = exp(-2 D) by the components of C_tr, by the implicit function theorem.

    dC_el = T dC_tr + S dD,  dD = N dgamma + r (G - N N) : dC_el,  mu N : dC_el = sigma_y' dgamma,  r = gamma / |C_el|_G.
    """
    r, slope, terms = w.scalars[GAMMA] / w.scalars[NORM], w.scalars[SLOPE], int(w.scalars[TERMS])
    c_trial, flow, d, y = _kept(w, C_TRIAL), _kept(w, FLOW), _kept(w, INCREMENT), _kept(w, EXPONENTIAL)
    x = scaled(d, -1.0)
    for m in range(6):
        e = (_UNIT[m, 0], _UNIT[m, 1], _UNIT[m, 2], _UNIT[m, 3], _UNIT[m, 4], _UNIT[m, 5])
        _set_column(w.rhs, m, congruence(y, e))
        dy = exponential_derivative(x, scaled(e, -1.0), terms)
        _set_column(w.ds, m, _mixed_congruence(dy, c_trial, y))
        _set_column(w.dz, m, _sum_product(dy, y))
    # lhs = I - r S (G - N N)
    for m in range(6):
        e = (_UNIT[m, 0], _UNIT[m, 1], _UNIT[m, 2], _UNIT[m, 3], _UNIT[m, 4], _UNIT[m, 5])
        p = _projected(e, flow, law)
        for n in range(6):
            s = w.ds[n]
            w.lhs[n, m] = _UNIT[n, m] - r * (s[0] * p[0] + s[1] * p[1] + s[2] * p[2] + s[3] * p[3] + s[4] * p[4] + s[5] * p[5])
    for n in range(6):
        s = w.ds[n]
        w.rhs[n, 6] = s[0] * flow[0] + s[1] * flow[1] + s[2] * flow[2] + s[3] * flow[3] + s[4] * flow[4] + s[5] * flow[5]
    solve_in_place(w.lhs, w.rhs)
    along_flow = _column(w.rhs, 6)
    n_s = double_contraction(flow, along_flow)
    for m in range(6):
        by_trial = _column(w.rhs, m)
        d_gamma = law.mu * double_contraction(flow, by_trial) / (slope - law.mu * n_s)
        dc = added(by_trial, along_flow, d_gamma)
        dd = added(scaled(flow, d_gamma), _projected(dc, flow, law), r)
        for n in range(6):
            s = w.dz[n]
            w.zc[n, m] = s[0] * dd[0] + s[1] * dd[1] + s[2] * dd[2] + s[3] * dd[3] + s[4] * dd[4] + s[5] * dd[5]


@kernel(forceinline=True)
def _mixed_congruence(dy: Symmetric, c: Symmetric, y: Symmetric) -> Symmetric:
    """dy . c . y + y . c . dy = d(y . c . y)[dy], by polarisation of the quadratic form."""
    plus = congruence(added(y, dy, 0.5), c)
    minus = congruence(added(y, dy, -0.5), c)
    return added(plus, minus, -1.0)


@kernel(forceinline=True)
def local_tangent(status: int, law: Law, w: PointWork, a: np.ndarray) -> None:
    """A = dP/dF into a (9, 9), rows iJ and columns kL, in MPa, consistent with `local_update`; status is its answer.

    A_iJkL = mu d_ik C_p^-1_JL + k' F^-T_iJ F^-T_kL - k F^-T_iL F^-T_kJ + mu F_tr (dZ/dC_tr : dC_tr/dF) F_p(n)^-T.
    """
    k, k_slope = w.scalars[K_FACTOR], w.scalars[K_SLOPE]
    g = w.f_inv_t
    for i in range(3):
        for j in range(3):
            for m in range(3):
                for n in range(3):
                    value = k_slope * g[i, j] * g[m, n] - k * g[i, n] * g[m, j]
                    if i == m:
                        value += law.mu * w.cp_inv[j, n]
                    a[3 * i + j, 3 * m + n] = value
    if status != PLASTIC:
        return
    _plastic_response(law, w)
    for i in range(3):
        for j in range(3):
            for m in range(6):
                p, q = ROW[m], COLUMN[m]
                value = w.f_trial[i, p] * w.fp_inv[j, q]
                if m > 2:
                    value += w.f_trial[i, q] * w.fp_inv[j, p]
                w.w[3 * i + j, m] = value
    for i in range(9):
        for m in range(6):
            s = 0.0
            for n in range(6):
                s += w.w[i, n] * w.zc[n, m]
            w.wz[i, m] = law.mu * s * (2.0 if m < 3 else 1.0)
    for i in range(9):
        for j in range(9):
            s = 0.0
            for m in range(6):
                s += w.wz[i, m] * w.w[j, m]
            a[i, j] += s
