"""The local update with a yield surface by linear transformations: it converges, its answer fulfils the equations, an independent
integration in time agrees, its tangent is that of differences."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from point_tools import NOMINAL, VIRGIN, in_lanes, random_gradient
from published_surfaces import AA2090_T3, TWISTED, equivalent, normal, numbers_of
from scipy.integrate import solve_ivp
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from thermofit.core.slots import Slots
from thermofit.law.page import Law, law_in_step, law_of
from thermofit.point.state import BACK, LAMBDA, N_FULL, NO_CONVERGENCE, TRACE

FRESH = np.concatenate([VIRGIN, np.zeros(N_FULL - len(VIRGIN))])
FRESH[TRACE] = 3.0
C, G, AMOUNT, SCALE = 3000.0, 60.0, 0.2, 0.02
BACKSTRESS = {"backstress_first.C": C, "backstress_first.gamma": G}
DEGRADED = {"elastic_degradation.amount": AMOUNT, "elastic_degradation.scale": SCALE}
ASYMMETRIC = {"tension_compression.difference": 0.1}
PLAIN = NOMINAL.replace(F=0.5)


def law_with(name: str, values: dict[str, float], dt: float = 2.5, **changes: float) -> Law:
    return law_in_step(law_of(PLAIN.replace(**values, **changes), Slots(1, name)), dt)


def symmetric(y: np.ndarray) -> np.ndarray:
    return np.array([[y[0], y[3], y[5]], [y[3], y[1], y[4]], [y[5], y[4], y[2]]])


def components(t: np.ndarray) -> np.ndarray:
    return np.array([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[1, 2], t[0, 2]])


def deviator(a: np.ndarray) -> np.ndarray:
    return np.asarray(a - np.trace(a) / 3.0 * np.eye(3))


@pytest.mark.parametrize("a", [2.0, 3.0, 8.0, 20.0])
@pytest.mark.parametrize("name", ["hosford", "yld2004"])
def test_it_converges_from_far_outside_and_the_answer_lies_on_the_surface(name: str, a: float) -> None:
    """Steps of 0.3 to 25 % in random directions, then again from the states they lead to: phi = sigma_y to 1e-10, D = dLambda N."""
    law = law_with(name, {"hosford.a": a} if name == "hosford" else {**AA2090_T3, "yld2004.a": a})
    numbers = numbers_of(law)
    for size in (0.003, 0.03, 0.25):
        states, before = np.tile(FRESH, (8, 1)), np.tile(np.eye(3), (8, 1, 1))
        for step in range(4):
            f = np.stack([random_gradient(100 * step + q, size) @ before[q] for q in range(8)])
            status, new, _, _ = in_lanes(f, law, states, np.full(8, 297.0))
            assert status >= 0, (size, step)
            for q in range(8):
                d_lambda = new[q, LAMBDA] - states[q, LAMBDA]
                f_el = f[q] @ new[q, :9].reshape(3, 3)
                stress = deviator(law.mu * f_el.T @ f_el)
                sigma_y = law.M_yinf - (law.M_yinf - law.M_y0) * np.exp(-law.H_exp * new[q, LAMBDA])
                excess = equivalent(components(stress), numbers) / sigma_y - 1.0
                assert excess < 1e-9 and (d_lambda == 0.0 or abs(excess) < 2e-10), (size, step, q)
                if d_lambda > 0.0:
                    flow = -logm(np.linalg.inv(states[q, :9].reshape(3, 3)) @ new[q, :9].reshape(3, 3))
                    assert flow == pytest.approx(d_lambda * normal(stress, numbers), abs=2e-9 * d_lambda + 1e-13)
            states, before = new, f
        assert np.all(states[:, LAMBDA] > 0.3 * size)


def test_beyond_what_it_can_do_it_says_so() -> None:
    """A step of ten times the stretch has no plastic increment below one; states without room for backstresses."""
    law = law_with("hosford", {"hosford.a": 20.0})
    far = np.tile(np.diag([0.3, 10.0, 1.0 / 3.0]), (8, 1, 1))
    assert in_lanes(far, law, np.tile(FRESH, (8, 1)), np.full(8, 297.0))[0] == NO_CONVERGENCE
    assert in_lanes(np.tile(random_gradient(3, 0.01), (8, 1, 1)), law, np.tile(VIRGIN, (8, 1)), np.full(8, 297.0))[0] == NO_CONVERGENCE


def test_the_tangent_is_the_symmetric_part_of_the_derivative() -> None:
    """Against central differences of tau, with backstress, degradation and asymmetry on."""
    law = law_with("yld2004", TWISTED, **BACKSTRESS, **DEGRADED, **ASYMMETRIC)
    theta, first = np.full(8, 297.0), np.stack([random_gradient(q + 5, 0.03) for q in range(8)])
    _, states, _, _ = in_lanes(first, law, np.tile(FRESH, (8, 1)), theta)
    f = np.stack([random_gradient(q + 50, 0.03) @ first[q] for q in range(8)])
    _, new, tau, c = in_lanes(f, law, states, theta)
    assert np.all(new[:, LAMBDA] > states[:, LAMBDA])
    h, a, one = 1e-6, np.empty((8, 3, 3, 3, 3)), np.eye(3)
    for k in range(3):
        for n in range(3):
            move = np.zeros((3, 3))
            move[k, n] = h
            there, back = (in_lanes(f + x * move @ f, law, states, theta)[2] for x in (1.0, -1.0))
            a[:, :, :, k, n] = (there - back) / (2.0 * h)
    exact = a - np.einsum("jk,qil->qijkl", one, tau) - np.einsum("ik,qjl->qijkl", one, tau)
    mean = 0.5 * (exact + exact.transpose(0, 3, 4, 1, 2))
    assert c == pytest.approx(mean, abs=3e-8 * np.abs(c).max())


def test_nothing_of_it_depends_on_the_frame() -> None:
    law = law_with("yld2004", TWISTED, **BACKSTRESS)
    f, states = np.stack([random_gradient(q + 5, 0.03) for q in range(8)]), np.tile(FRESH, (8, 1))
    turns = Rotation.random(8, random_state=3).as_matrix()
    _, plain, tau, _ = in_lanes(f, law, states, np.full(8, 297.0))
    _, turned, there, _ = in_lanes(turns @ f, law, states, np.full(8, 297.0))
    assert turned == pytest.approx(plain, abs=1e-11)
    assert there == pytest.approx(turns @ tau @ turns.transpose(0, 2, 1), abs=1e-8)


K, R0, PERIOD = 40.0, 0.02, 20.0
VISCOUS = {"rate_power.K": K, "rate_power.m": 1.0, "rate_power.reference": R0}
"""dLambda/dt = R0 (phi - sigma_y) / K: what flows is smooth in time, and can be integrated by any method."""


def gradient(t: float) -> np.ndarray:
    """Stretch and shear out of phase, all components of stress, with a turning frame."""
    a, b = 0.02 * np.sin(2.0 * np.pi * t / PERIOD), 0.03 * np.sin(4.0 * np.pi * t / PERIOD + 0.4) - 0.03 * np.sin(0.4)
    strain = np.array([[-0.3 * a, b, 0.1 * a], [b, a, 0.3 * b], [0.1 * a, 0.3 * b, -0.6 * a]])
    return np.asarray(Rotation.from_rotvec([0.0, 0.3 * t / PERIOD, 0.1]).as_matrix() @ expm(strain))


def test_a_nonproportional_path_against_an_independent_integration() -> None:
    """Flow along the normal of AA2090-T3, backstress and degradation over half a cycle: the answer of an explicit integrator of high order
    is what steps extrapolate to, to 1e-6."""
    values, end = {**AA2090_T3, **BACKSTRESS, **DEGRADED, **VISCOUS}, 0.5 * PERIOD
    law = law_with("yld2004", values, 1.0)
    numbers = numbers_of(law)

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        fp, total, x = z[:9].reshape(3, 3), z[9], z[10:].reshape(3, 3)
        f_el = gradient(t) @ np.linalg.inv(fp)
        stiff = 1.0 - AMOUNT * (1.0 - float(np.exp(-total / SCALE)))
        s = deviator(stiff * law.mu * f_el.T @ f_el) - x
        phi = equivalent(components(s), numbers)
        sigma_y = law.M_yinf - (law.M_yinf - law.M_y0) * np.exp(-law.H_exp * total)
        speed = max(0.0, R0 * (phi - sigma_y) / K)
        flow = speed * normal(s, numbers) if speed > 0.0 else np.zeros((3, 3))
        return np.concatenate([(flow @ fp).ravel(), [speed], (speed * (C * s / max(phi, 1e-9) - G * x)).ravel()])

    start = np.concatenate([np.eye(3).ravel(), np.zeros(10)])
    expected = solve_ivp(rates, (0.0, end), start, method="DOP853", rtol=1e-10, atol=1e-12, max_step=end / 200.0).y[:, -1]

    def by_steps(n: int) -> np.ndarray:
        states, stepped = np.tile(FRESH, (8, 1)), law_with("yld2004", values, end / n)
        for t in end * np.arange(1, n + 1) / n:
            status, states, _, _ = in_lanes(np.tile(gradient(float(t)), (8, 1, 1)), stepped, states, np.full(8, law.theta_ref))
            assert status >= 0
        fp = np.linalg.inv(states[0, :9].reshape(3, 3))
        return np.concatenate([fp.ravel(), [states[0, LAMBDA]], (C * symmetric(states[0, BACK:])).ravel()])

    scale = np.concatenate([np.full(9, 0.03), [expected[9]], np.full(9, np.abs(expected[10:]).max())])
    table = [(by_steps(500 * 2**k) - expected) / scale for k in range(4)]
    assert np.abs(table[1]).max() < 0.6 * np.abs(table[0]).max(), "first order in the step"
    for order in (1, 2, 3):
        table = [(2**order * fine - coarse) / (2**order - 1) for coarse, fine in pairwise(table)]
    assert np.abs(table[0]).max() < 1e-6
