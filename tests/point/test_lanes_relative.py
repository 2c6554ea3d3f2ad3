"""Backstress, degraded moduli and asymmetry of a point in three dimensions: the equations of the update, its tangent, an independent
integration in time, and what must not depend on the frame."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from point_tools import ANISOTROPIC, VIRGIN, in_lanes, random_gradient
from scipy.integrate import solve_ivp
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from thermofit.core.parameters import Parameters
from thermofit.law.page import Law, law_in_step, law_of
from thermofit.point.state import BACK, LAMBDA, N_FULL, NO_CONVERGENCE, SENSE, TRACE

C1, G1, C2, G2, AMOUNT, SCALE, MORE = 8000.0, 200.0, 900.0, 8.0, 0.2, 0.02, 0.1
BACKSTRESS = {"backstress_first.C": C1, "backstress_first.gamma": G1, "backstress_second.C": C2, "backstress_second.gamma": G2}
DEGRADED = {"elastic_degradation.amount": AMOUNT, "elastic_degradation.scale": SCALE}
ASYMMETRIC = {"tension_compression.difference": MORE}
ALL = {**BACKSTRESS, **DEGRADED, **ASYMMETRIC}
FRESH = np.concatenate([VIRGIN, np.zeros(N_FULL - len(VIRGIN))])
THETA = 300.0


def law_with(changes: dict[str, float], parameters: Parameters = ANISOTROPIC) -> Law:
    return law_in_step(law_of(parameters.replace(**changes), 2), 2.5)


def loaded(law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Eight points after plastic flow (8, N_FULL), and gradients (8, 3, 3) that make them flow on in other directions."""
    first = np.stack([random_gradient(q + 5, 0.03) for q in range(8)])
    status, states, _, _ = in_lanes(first, law, np.tile(FRESH, (8, 1)), np.full(8, THETA))
    assert status > 0
    return states, np.stack([random_gradient(q + 50, 0.03) @ first[q] for q in range(8)])


def symmetric(y: np.ndarray) -> np.ndarray:
    return np.array([[y[0], y[3], y[5]], [y[3], y[1], y[4]], [y[5], y[4], y[2]]])


def in_hill(law: Law, a: np.ndarray) -> np.ndarray:
    """G : A of (4.19), by components."""
    f, g, h = law.F * (a[0, 0] - a[1, 1]), law.G * (a[2, 2] - a[0, 0]), law.H * (a[1, 1] - a[2, 2])
    out = np.diag([f - g, h - f, g - h])
    for name, (i, j) in {"L": (0, 1), "M": (1, 2), "N": (0, 2)}.items():
        out[i, j] = out[j, i] = getattr(law, name) * a[i, j]
    return out


def deviator(a: np.ndarray) -> np.ndarray:
    return np.asarray(a - np.trace(a) / 3.0 * np.eye(3))


def stiffness(accumulated: float) -> float:
    return 1.0 - AMOUNT * (1.0 - float(np.exp(-accumulated / SCALE)))


def test_the_answer_fulfils_the_equations_of_the_law() -> None:
    """Yield condition and flow rule, written out for the whole relative stress S, with backstresses that the law of Armstrong and Frederick
    gives over the step in the direction of S; tr C_el and the sense of flow as the heat needs them."""
    law = law_with(ALL)
    states, f = loaded(law)
    status, new, tau, _ = in_lanes(f, law, states, np.full(8, THETA))
    assert status > 0 and np.all(new[:, LAMBDA] > states[:, LAMBDA])
    for q in range(8):
        fp_inv, old = new[q, :9].reshape(3, 3), states[q, :9].reshape(3, 3)
        c = (f[q] @ fp_inv).T @ (f[q] @ fp_inv)
        d_lambda, total = new[q, LAMBDA] - states[q, LAMBDA], new[q, LAMBDA]
        s = deviator(stiffness(total) * law.mu * c)
        for k, C in enumerate((C1, C2)):
            s -= C * symmetric(new[q, BACK + 6 * k :])
        norm = np.sqrt(np.tensordot(s, in_hill(law, s)))
        direction = s / norm
        for k, gamma in enumerate((G1, G2)):
            kept = np.exp(-gamma * d_lambda)
            expected = kept * symmetric(states[q, BACK + 6 * k :]) + (1.0 - kept) / gamma * direction
            assert symmetric(new[q, BACK + 6 * k :]) == pytest.approx(expected, abs=1e-14)
        flow = -logm(np.linalg.inv(old) @ fp_inv)
        assert flow == pytest.approx(d_lambda * in_hill(law, direction), abs=1e-12)
        b = law.H_exp
        alpha = (1.0 - (1.0 - b * states[q, 9]) * np.exp(-b * d_lambda)) / b
        sense = 1.5 * np.sqrt(3.0) * np.linalg.det(s) / (0.5 * np.sum(s * s)) ** 1.5
        sigma_y = law.M_y0 + b * (law.M_yinf - law.M_y0) * alpha
        assert norm == pytest.approx(sigma_y * (1.0 + 0.5 * MORE * (1.0 - sense)), rel=1e-10)
        assert new[q, SENSE] == pytest.approx(sense, abs=1e-10) and new[q, TRACE] == pytest.approx(np.trace(c), rel=1e-14)
        j = np.linalg.det(f[q])
        k_0 = law.lame * np.log(j) - law.mu - 3.0 * law.alpha_exp * law.bulk * (THETA - law.theta_ref) * (1.0 - np.log(j)) / j
        f_el = f[q] @ fp_inv
        assert tau[q] == pytest.approx(stiffness(total) * (law.mu * f_el @ f_el.T + k_0 * np.eye(3)), abs=1e-9)
    assert np.ptp(new[:, SENSE]) > 0.5


@pytest.mark.parametrize("changes", [BACKSTRESS, DEGRADED, ASYMMETRIC, ALL], ids=["backstress", "degraded", "asymmetric", "all"])
def test_the_tangent_is_the_symmetric_part_of_the_derivative(changes: dict[str, float]) -> None:
    """Against central differences of tau; what is left out is not symmetric."""
    law = law_with(changes)
    states, f = loaded(law)
    _, _, tau, c = in_lanes(f, law, states, np.full(8, THETA))
    h, a, one = 1e-6, np.empty((8, 3, 3, 3, 3)), np.eye(3)
    for k in range(3):
        for n in range(3):
            move = np.zeros((3, 3))
            move[k, n] = h
            there, back = (in_lanes(f + x * move @ f, law, states, np.full(8, THETA))[2] for x in (1.0, -1.0))
            a[:, :, :, k, n] = (there - back) / (2.0 * h)
    exact = a - np.einsum("jk,qil->qijkl", one, tau) - np.einsum("ik,qjl->qijkl", one, tau)
    mean = 0.5 * (exact + exact.transpose(0, 3, 4, 1, 2))
    assert c == pytest.approx(mean, abs=2e-8 * np.abs(c).max())
    assert 1e-6 < np.abs(exact - mean).max() / np.abs(c).max() < 1e-2


def test_nothing_of_it_depends_on_the_frame() -> None:
    """A rotated specimen: equal states, the stress turned."""
    law = law_with(ALL)
    states, f = loaded(law)
    turns = Rotation.random(8, random_state=3).as_matrix()
    _, plain, tau, _ = in_lanes(f, law, states, np.full(8, THETA))
    _, turned, there, _ = in_lanes(turns @ f, law, states, np.full(8, THETA))
    assert turned == pytest.approx(plain, abs=1e-11)
    assert there == pytest.approx(turns @ tau @ turns.transpose(0, 2, 1), abs=1e-9)


def test_states_without_room_for_backstresses_fail() -> None:
    law = law_with(ALL)
    assert in_lanes(np.tile(random_gradient(3, 0.01), (8, 1, 1)), law, np.tile(VIRGIN, (8, 1)), np.full(8, THETA))[0] == NO_CONVERGENCE


K, R0, PERIOD = 40.0, 0.02, 20.0
VISCOUS = {"rate_power.K": K, "rate_power.m": 1.0, "rate_power.reference": R0}
"""dLambda/dt = R0 (|S|_G - sigma_y) / K: what flows is smooth in time, and can be integrated by any method."""


def gradient(t: float) -> np.ndarray:
    """A cycle of stretch and shear that are out of phase, with a turning frame."""
    a, b = 0.02 * np.sin(2.0 * np.pi * t / PERIOD), 0.03 * np.sin(4.0 * np.pi * t / PERIOD + 0.4) - 0.03 * np.sin(0.4)
    strain = np.array([[-0.4 * a, b, 0.0], [b, a, 0.2 * b], [0.0, 0.2 * b, -0.5 * a]])
    return np.asarray(Rotation.from_rotvec([0.0, 0.3 * t / PERIOD, 0.1]).as_matrix() @ expm(strain))


def independent(law: Law) -> np.ndarray:
    """State at the end of the cycle by an explicit integrator of high order: F_p, Lambda, and both X in MPa."""

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        fp, total, x = z[:9].reshape(3, 3), z[9], z[10:].reshape(2, 3, 3)
        f_el = gradient(t) @ np.linalg.inv(fp)
        s = deviator(stiffness(total) * law.mu * f_el.T @ f_el) - x.sum(axis=0)
        norm = np.sqrt(np.tensordot(s, in_hill(law, s)))
        sigma_y = law.M_yinf - (law.M_yinf - law.M_y0) * np.exp(-law.H_exp * total)
        speed = max(0.0, R0 * (norm - sigma_y) / K)
        flow = speed * in_hill(law, s) / norm
        moved = [speed * (C * s / norm - gamma * x[k]) for k, (C, gamma) in enumerate(((C1, G1), (C2, G2)))]
        return np.concatenate([(flow @ fp).ravel(), [speed], np.ravel(moved)])

    start = np.concatenate([np.eye(3).ravel(), np.zeros(19)])
    found = solve_ivp(rates, (0.0, PERIOD), start, method="DOP853", rtol=1e-10, atol=1e-12, max_step=PERIOD / 400.0)
    return np.asarray(found.y[:, -1])


def by_steps(parameters: Parameters, n: int) -> np.ndarray:
    """The same by n steps of the update."""
    states = np.tile(FRESH, (8, 1))
    law = law_in_step(law_of(parameters, 2), PERIOD / n)
    for t in PERIOD * np.arange(1, n + 1) / n:
        status, states, _, _ = in_lanes(np.tile(gradient(float(t)), (8, 1, 1)), law, states, np.full(8, law.theta_ref))
        assert status >= 0
    fp = np.linalg.inv(states[0, :9].reshape(3, 3))
    x = [C * symmetric(states[0, BACK + 6 * k :]) for k, C in enumerate((C1, C2))]
    return np.concatenate([fp.ravel(), [states[0, LAMBDA]], np.ravel(x)])


def test_a_cycle_against_an_independent_integration() -> None:
    """Backstress and degradation over a cycle of stretch and shear out of phase: steps lead to the answer of another integrator, their
    error falls in proportion, and what they extrapolate to (four orders) is that answer to 1e-6."""
    parameters = ANISOTROPIC.replace(**BACKSTRESS, **DEGRADED, **VISCOUS)
    expected = independent(law_in_step(law_of(parameters, 2), 1.0))
    scale = np.concatenate([np.full(9, 0.03), [expected[9]], np.full(18, np.abs(expected[10:]).max())])
    runs = [(by_steps(parameters, 1000 * 2**k) - expected) / scale for k in range(5)]
    assert np.abs(runs[0]).max() < 0.05
    assert np.abs(runs[4]).max() < 0.55 * np.abs(runs[3]).max()
    for order in range(1, 5):
        runs = [(2**order * fine - coarse) / (2**order - 1) for coarse, fine in pairwise(runs)]
    assert np.abs(runs[0]).max() < 1e-6
