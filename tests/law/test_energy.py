"""Free energy, entropy and internal energy of a point, and what the heat equation makes of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from point_tools import ANISOTROPIC, NOMINAL, VIRGIN, deformed_state, random_gradient, uniaxial, update

from thermofit.core.parameters import Parameters
from thermofit.law.page import Law, dissipated_energy, entropy, free_energy, internal_energy, law_of, thermoelastic_heat
from thermofit.point.state import ALPHA, LAMBDA


def of_point(energy: Callable[..., float], f: np.ndarray, state: np.ndarray, theta: float, law: Law) -> float:
    """One of the energies of a point with deformation gradient f (3, 3) and state (11,)."""
    fe = f @ state[:9].reshape(3, 3)
    j = float(np.linalg.det(f))
    return energy(float(np.sum(fe * fe)), math.log(j), j, theta, state[ALPHA], state[LAMBDA], law)


@pytest.mark.parametrize("seed", range(3))
def test_stress_is_the_derivative_of_the_free_energy(seed: int) -> None:
    """P = d psi / d F at a fixed plastic state (4.8), temperature term included."""
    law = law_of(ANISOTROPIC, plastic=False)
    f, state, h = random_gradient(seed, 0.1) * 1.01, deformed_state(law_of(ANISOTROPIC), seed), 1e-6
    slope = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            d = np.zeros((3, 3))
            d[i, j] = h
            up, down = (of_point(free_energy, f + s * d, state, 330.0, law) for s in (1.0, -1.0))
            slope[i, j] = (up - down) / (2.0 * h)
    stress = update(f, law, state, 330.0).stress
    assert slope == pytest.approx(stress, abs=2e-7 * np.abs(stress).max() + 1e-4)


def test_entropy_and_internal_energy_belong_to_the_free_energy() -> None:
    law, h = law_of(NOMINAL.replace(H_lin=30.0)), 1e-3
    trace, j, theta, alpha, accumulated = 3.02, 1.004, 325.0, 0.02, 0.03

    def psi(at: float) -> float:
        return free_energy(trace, math.log(j), j, at, alpha, accumulated, law)

    eta = entropy(math.log(j), j, theta, law)
    assert -(psi(theta + h) - psi(theta - h)) / (2.0 * h) == pytest.approx(eta, rel=1e-7)
    assert internal_energy(trace, math.log(j), j, theta, alpha, accumulated, law) == pytest.approx(psi(theta) + theta * eta, rel=1e-13)
    for energy in (free_energy, internal_energy):
        assert energy(3.0, 0.0, 1.0, law.theta_ref, 0.0, 0.0, law) == 0.0


@pytest.mark.parametrize("model", [1, 2])
def test_plastic_work_is_dissipated_or_stored(model: int) -> None:
    """sigma_y dLambda = D + d psi_pl: (4.5) to (4.7) against (4.18) and (4.21), (4.22), exactly, for any step."""
    law = law_of(NOMINAL.replace(H_lin=30.0), model)

    def alpha(multiplier: float) -> float:
        return multiplier if model == 1 else (1.0 - math.exp(-law.H_exp * multiplier)) / law.H_exp

    def work(multiplier: float) -> float:
        """int sigma_y dLambda: the same function of Lambda in both models."""
        slack = (1.0 - math.exp(-law.H_exp * multiplier)) / law.H_exp
        return law.M_yinf * multiplier - (law.M_yinf - law.M_y0) * slack + 0.5 * law.H_lin * multiplier**2

    for before, after in ((0.0, 0.01), (0.01, 0.2), (0.2, 0.21)):
        stored = [free_energy(3.0, 0.0, 1.0, law.theta_ref, alpha(x), x, law) for x in (before, after)]
        released = dissipated_energy(alpha(before), alpha(after), after - before, law)
        assert released + stored[1] - stored[0] == pytest.approx(work(after) - work(before), rel=1e-12)


def forth_and_back(parameters: Parameters, model: int, steps: int) -> tuple[float, float, float]:
    """Adiabatic tension to a stretch of 1.04 and compression to 1.01, beyond reverse yield: (first-law defect, work, rise)."""
    law = law_of(parameters, model)
    marks = [1.0, 1.04, 1.01]
    path = np.concatenate([[1.0], *(np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(marks))])
    state, theta, f, g_n = VIRGIN, law.theta_ref, np.eye(3), 0.0
    stress, lateral, work = 0.0, (1.0, 1.0), 0.0

    def step(y: float, state: np.ndarray, theta: float, g_n: float) -> tuple[np.ndarray, np.ndarray, float, float, float]:
        after = theta
        for _ in range(10):
            answer, f = uniaxial(y, law, state, after, lateral)
            j = float(np.linalg.det(f))
            heat = thermoelastic_heat(0.5 * (theta + after), g_n, math.log(j) / j, law)
            heat += dissipated_energy(state[ALPHA], answer.state[ALPHA], answer.state[LAMBDA] - state[LAMBDA], law)
            after = theta + heat / law.c0
        return answer.state, f, after, math.log(j) / j, answer.stress[1, 1]

    for y in path[1:]:
        before = f[1, 1]
        state, f, theta, g_n, new = step(float(y), state, theta, g_n)
        work += 0.5 * (stress + new) * (y - before)
        stress, lateral = new, (f[0, 0], f[2, 2])
    return of_point(internal_energy, f, state, theta, law) - work, work, theta - law.theta_ref


@pytest.mark.parametrize("model", [1, 2])
def test_first_law_of_an_adiabatic_path_with_reverse_flow(model: int) -> None:
    """Internal energy changes by the work alone, up to the trapezoid of the work: order 2 in the step (1/256, but for where in a step
    the yield point falls)."""
    defects = []
    for steps in (20, 320):
        defect, work, rise = forth_and_back(NOMINAL.replace(H_lin=30.0), model, steps)
        assert rise > 1.0
        defects.append(abs(defect) / work)
    assert defects[1] < 2e-5 and defects[1] < 0.03 * defects[0], defects
