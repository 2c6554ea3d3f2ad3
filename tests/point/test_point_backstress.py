"""Backstress and elastic degradation in the point driver: the laws in one dimension, cycles, heat and energy."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import LOSSY, SHEET, WHOLE, corners, flow_stress_of, ramp

from thermofit.core.parameters import Parameters
from thermofit.law.backstress import decay_share, gain_share, recall_over
from thermofit.law.composition import BACKSTRESSES
from thermofit.law.page import elastic_energy, law_of, plastic_energy, thermoelastic_heat
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate
from thermofit.point.step import ACROSS, ALONG, BACKSTRESS

C1, G1, C2, G2 = 8000.0, 200.0, 900.0, 8.0
TERMS = {"backstress_first.C": C1, "backstress_first.gamma": G1, "backstress_second.C": C2, "backstress_second.gamma": G2}
ONE = {"backstress_first.C": C1, "backstress_first.gamma": G1}
CONSTANT = SHEET.replace(alpha_exp=0.0, M_yinf=SHEET["M_y0"] * (1.0 + 1e-9), H_exp=1e-3)
"""Isotropic yield stress that stays M_y0; Hill with F + H = 0.85."""


def signed(found: PointHistory, parameters: Parameters) -> np.ndarray:
    """Mandel stress in the norm of Hill along the load, with the sign of the stress."""
    return np.asarray(np.sign(found.stress) * flow_stress_of(found, parameters))


def backstress(found: PointHistory, parameters: Parameters) -> np.ndarray:
    """Sum of the backstresses in the norm of Hill, signed, MPa."""
    return np.asarray(np.sqrt(parameters["F"] + parameters["H"]) * found.states[:, BACKSTRESS:].sum(axis=1))


@pytest.mark.parametrize("settings", [WHOLE, PointSettings(max_strain=2e-4)])
def test_monotonic_loading_is_the_law_in_one_dimension(settings: PointSettings) -> None:
    """X = sum C / gamma (1 - exp(-gamma Lambda)), whatever the steps; the stress is M_y0 + X."""
    parameters = CONSTANT.replace(**TERMS)
    for sign in (1.0, -1.0):
        found = simulate(parameters, Programme.by_strain(np.linspace(0.0, 9.0, 10), sign * np.linspace(0.0, 0.09, 10)), settings)
        past = found.accumulated
        expected = C1 / G1 * (1.0 - np.exp(-G1 * past)) + C2 / G2 * (1.0 - np.exp(-G2 * past))
        assert past[-1] > 0.07
        assert sign * backstress(found, parameters) == pytest.approx(expected, rel=1e-9)
        assert flow_stress_of(found, parameters)[1:] == pytest.approx(parameters["M_y0"] + expected[1:], rel=1e-8)


def test_linear_kinematic_hardening_without_recall() -> None:
    """gamma = 0: X = C Lambda (Prager), and nothing of it is heat."""
    parameters = CONSTANT.replace(**{"backstress_second.C": 1500.0, "backstress_second.gamma": 0.0})
    plain, found = (simulate(p, Programme.by_strain(*ramp(1e-2, 0.05, 50))) for p in (CONSTANT, parameters))
    assert backstress(found, parameters) == pytest.approx(1500.0 * found.accumulated, rel=1e-12)
    there = np.interp(found.accumulated, plain.accumulated, plain.dissipated)
    assert found.dissipated == pytest.approx(there, abs=1e-12 + 1e-9 * there.max())


def test_bauschinger_effect() -> None:
    """After tension flow begins again at X - M_y0, early by 2 X; without backstress at -M_y0."""
    parameters = CONSTANT.replace(**TERMS)
    time, strain = corners((0.0, 0.0), (10.0, 0.03), (40.0, -0.01), steps=2000)
    found = simulate(parameters, Programme.by_strain(time, strain))
    turn = 2000
    again = turn + int(np.argmax(found.accumulated[turn:] > found.accumulated[turn] + 1e-12))
    X = backstress(found, parameters)[turn]
    assert X > 60.0
    assert signed(found, parameters)[again] == pytest.approx(X - parameters["M_y0"], abs=1.5)


def test_saturated_cycles() -> None:
    """Between strains of +-1 % the loop becomes stable: X = +-C/gamma tanh(gamma dLambda / 2), dLambda the flow of half a cycle."""
    parameters = CONSTANT.replace(**ONE)
    turns = [(0.0, 0.0), *((10.0 * (n + 1), 0.01 * (-1) ** n) for n in range(12))]
    found = simulate(parameters, Programme.by_strain(*corners(*turns, steps=20)))
    at = np.arange(1, 13) * 20
    X, half = backstress(found, parameters)[at], np.diff(found.accumulated[at])
    assert X[-1] == pytest.approx(-C1 / G1 * np.tanh(0.5 * G1 * half[-1]), rel=1e-6)
    assert X[-2] == pytest.approx(-X[-1], rel=5e-3)
    assert X[-1] == pytest.approx(X[-3], rel=1e-6)
    stress = signed(found, parameters)[at]
    assert stress == pytest.approx(X + np.sign(X) * parameters["M_y0"], rel=1e-8)


def test_stress_cycles_shake_down_without_recall_and_ratchet_with_it() -> None:
    """Unsymmetric stress cycles beyond the elastic range: a closed loop for gamma = 0, a drift that goes on for gamma > 0."""
    drift = {}
    for recall in (0.0, 60.0):
        parameters = CONSTANT.replace(**{"backstress_first.C": 20000.0, "backstress_first.gamma": recall})
        turns = [(0.0, 0.0), *((10.0 * (n + 1), 190.0 if n % 2 == 0 else -150.0) for n in range(15))]
        found = simulate(parameters, Programme.under_stress(*corners(*turns, steps=40)))
        tops = found.strain[40::80]
        drift[recall] = tops[-1] - tops[-2]
        assert np.diff(found.accumulated[::40])[-1] > 1e-4, "flow goes on in every half cycle"
    assert abs(drift[0.0]) < 2e-6
    assert drift[60.0] > 2e-5


def energy(found: PointHistory, parameters: Parameters) -> np.ndarray:
    """Internal energy of every state with backstress and degraded moduli, mJ/mm^3."""
    law = law_of(parameters)
    a, b = found.states[:, ACROSS], found.states[:, ALONG]
    log_j = 2.0 * a + b
    amount, scale = parameters["elastic_degradation.amount"], parameters["elastic_degradation.scale"]
    stiffness = 1.0 - amount * (1.0 - np.exp(-found.accumulated / scale))
    elastic = elastic_energy(2.0 * np.exp(2.0 * a) + np.exp(2.0 * b), log_j, law) - thermoelastic_heat(
        law.theta_ref, 0.0, log_j / np.exp(log_j), law
    )
    total = stiffness * elastic + plastic_energy(found.alpha, found.accumulated, law) + law.c0 * (found.theta - law.theta_ref)
    for k, name in enumerate(BACKSTRESSES):
        if modulus := parameters[f"{name}.C"]:
            total = total + (parameters["F"] + parameters["H"]) * found.states[:, BACKSTRESS + k] ** 2 / (2.0 * modulus)
    return np.asarray(total)


@pytest.mark.parametrize("changes", [TERMS, {"elastic_degradation.amount": 0.3}, {**TERMS, "elastic_degradation.amount": 0.3}])
def test_first_law(changes: dict[str, float]) -> None:
    """Internal energy = work + heat from outside, of order two in the step, with what backstress stores and damage releases."""
    parameters, defects = LOSSY.replace(**changes), []
    for max_strain in (4e-4, 1e-4):
        time, strain = corners((0.0, 0.0), (30.0, 0.02), (40.0, -0.005), (60.0, 0.03), steps=round(0.02 / max_strain))
        found = simulate(parameters, Programme.by_strain(time, strain), PointSettings(max_strain=1.0))
        work = np.append(0.0, np.cumsum(0.5 * (found.stress[1:] + found.stress[:-1]) * np.diff(found.strain)))
        heat = parameters["c0"] * (found.theta - found.theta[0]) - found.dissipated - found.thermoelastic
        held = energy(found, parameters)
        defects.append(float(np.abs(held - held[0] - work - heat).max() / work.max()))
    assert defects[0] < 1e-3
    assert defects[1] < 0.3 * defects[0]


def test_recall_is_heat_and_never_takes_any() -> None:
    """The heat of the recall is int gamma X^2 / C dLambda >= 0, also while X turns round."""
    parameters = CONSTANT.replace(**ONE)
    time, strain = corners((0.0, 0.0), (10.0, 0.02), (30.0, -0.02), (50.0, 0.02), steps=4000)
    found = simulate(parameters, Programme.by_strain(time, strain))
    X, past = backstress(found, parameters), found.accumulated
    recalled = np.append(0.0, np.cumsum(G1 / C1 * 0.5 * (X[1:] ** 2 + X[:-1] ** 2) * np.diff(past)))
    base = simulate(CONSTANT, Programme.by_strain(time, strain))
    there = np.interp(past, base.accumulated, base.dissipated)
    assert recalled[-1] > 0.5
    assert found.dissipated - there == pytest.approx(recalled, abs=2e-4 * recalled[-1])
    coarse = simulate(parameters, Programme.by_strain(*corners((0.0, 0.0), (10.0, 0.02), (30.0, -0.02), (50.0, 0.02), steps=7)), WHOLE)
    assert np.all(np.diff(coarse.dissipated) >= 0.0)


def test_unloading_is_as_soft_as_the_degraded_modulus() -> None:
    amount, scale = 0.2, 0.01
    parameters = SHEET.replace(alpha_exp=0.0, **{"elastic_degradation.amount": amount, "elastic_degradation.scale": scale})
    time, strain = corners((0.0, 0.0), (10.0, 0.03), (11.0, 0.0295), steps=30)
    found, plain = (simulate(p, Programme.by_strain(time, strain)) for p in (parameters, SHEET.replace(alpha_exp=0.0)))
    slope, full = ((f.stress[-1] - f.stress[-2]) / (f.strain[-1] - f.strain[-2]) for f in (found, plain))
    assert slope / full == pytest.approx(1.0 - amount * (1.0 - np.exp(-found.accumulated[-1] / scale)), rel=1e-3)
    assert flow_stress_of(found, parameters)[30] == pytest.approx(flow_stress_of(plain, SHEET)[30], rel=1e-2), "the yield stress stays"


def test_shares_of_a_step() -> None:
    """phi and psi against quadrature, across the change from series to formula."""
    s = (np.polynomial.legendre.leggauss(40)[0] + 1.0) / 2.0
    weight = np.polynomial.legendre.leggauss(40)[1] / 2.0
    for z in (0.0, 1e-9, 9.9e-3, 1.01e-2, 0.0999, 0.1001, 1.0, 12.0):
        assert decay_share(z) == pytest.approx(weight @ np.exp(-z * s), rel=1e-13)
        assert gain_share(z) == pytest.approx(weight @ ((1.0 - s) * np.exp(-z * s)), rel=1e-12)
    over = recall_over(0.01, C1, G1)
    assert over.gained == pytest.approx(C1 / G1 * (1.0 - np.exp(-2.0)), rel=1e-12) and over.kept == pytest.approx(np.exp(-2.0))
