"""Moduli that fall with temperature in the point driver: slope of the stress, thermoelastic heat, first law, the bar, derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import CYCLES, LOSSY, SHEET, bar_and_point, corners, flow_stress_of

from thermofit.core.parameters import Parameters
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate, simulate_rates
from thermofit.point.step import ACROSS, ALONG

SLOPE, ROUND = 1.2e-3, 0.04
HOT = 573.15
WARM = SHEET.replace(**{"modulus_by_temperature.slope": SLOPE, "theta_air": HOT, "theta_ref": HOT})


def factor(theta: np.ndarray | float, slope: float = SLOPE) -> np.ndarray:
    """m, by hand."""
    x = 1.0 - slope * (np.asarray(theta) - 293.15)
    return np.asarray((x + np.hypot(x, ROUND)) / (1.0 + np.hypot(1.0, ROUND)))


def factor_slope(theta: np.ndarray | float, slope: float = SLOPE) -> np.ndarray:
    """dm/dtheta, by hand: m x' / (x^2 + 4 e^2)^(1/2)."""
    x = 1.0 - slope * (np.asarray(theta) - 293.15)
    return np.asarray(-slope * factor(theta, slope) / np.hypot(x, ROUND))


def strained(found: PointHistory, p: Parameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Elastic energy (4.2) of full moduli and 3 alpha_exp K ln J / J of all states, and ln J."""
    a, b = found.states[:, ACROSS], found.states[:, ALONG]
    log_j, trace = 2.0 * a + b, 2.0 * np.exp(2.0 * a) + np.exp(2.0 * b)
    mu, bulk = p["E"] / (2.0 * (1.0 + p["nu"])), p["E"] / (3.0 * (1.0 - 2.0 * p["nu"]))
    free = 0.5 * (bulk - 2.0 * mu / 3.0) * log_j**2 + 0.5 * mu * (trace - 3.0) - mu * log_j
    return free, 3.0 * p["alpha_exp"] * bulk * log_j / np.exp(log_j), log_j


@pytest.mark.parametrize("theta", [200.0, 293.15, 400.0, 573.15, 900.0])
def test_first_loading_is_as_steep_as_the_modulus_at_its_temperature(theta: float) -> None:
    """Isothermal; the lateral strain stays that of nu, and the yield stress that of the law."""
    p = SHEET.replace(**{"modulus_by_temperature.slope": SLOPE, "theta_air": theta, "theta_ref": theta, "tau": 1e-4})
    found = simulate(p, Programme.by_strain(np.linspace(0.0, 10.0, 11), np.linspace(0.0, 1e-5, 11)))
    assert found.stress[-1] / 1e-5 == pytest.approx(p["E"] * float(factor(theta)), rel=1e-4)
    assert found.lateral_x[-1] / 1e-5 == pytest.approx(-p["nu"], rel=1e-4)
    flowing, plain = (simulate(q, Programme.by_strain(np.linspace(0.0, 10.0, 101), np.linspace(0.0, 0.03, 101))) for q in (p, SHEET))
    there = np.interp(plain.accumulated[50], flowing.accumulated, flow_stress_of(flowing, p))
    assert there == pytest.approx(flow_stress_of(plain, SHEET)[50], rel=2e-5)


def test_adiabatic_elastic_loading_keeps_the_entropy() -> None:
    """c0 ln(theta / theta_0) - S = const with S = m_theta A - m 3 alpha K ln J / J, of order two in the step. A material whose moduli fall
    cools more as it is pulled."""
    p, errors, cooling = WARM.replace(M_y0=1e4, M_yinf=2e4), [], []
    for steps in (20, 40):
        found = simulate(p, Programme.by_strain(np.linspace(0.0, 1.0, steps + 1), np.linspace(0.0, 8e-3, steps + 1)))
        free, expanding, _ = strained(found, p)
        taken = factor_slope(found.theta) * (free - expanding * (found.theta - HOT)) - factor(found.theta) * expanding
        entropy = p["c0"] * np.log(found.theta / HOT) - taken
        errors.append(float(np.abs(entropy - entropy[0]).max() / np.ptp(taken)))
        stiff = simulate(p.replace(**{"modulus_by_temperature.slope": 0.0, "E": p["E"] * float(factor(HOT))}), found_programme(found))
        cooling.append((HOT - found.theta[-1]) / (HOT - stiff.theta[-1]))
    assert errors[0] < 1e-5 and errors[1] < 0.27 * errors[0], errors
    # theta m_theta A, A = E e^2 / 2 of the full moduli, beside theta m alpha E e
    strain = 8e-3
    more = -float(factor_slope(HOT)) * 0.5 * strain / (float(factor(HOT)) * p["alpha_exp"])
    assert cooling[1] == pytest.approx(1.0 + more, rel=0.03) and more > 0.2


def found_programme(found: PointHistory) -> Programme:
    """The same history of strain again."""
    return Programme.by_strain(found.time, found.strain)


def test_first_law() -> None:
    """Internal energy m [(4.2) + 3 alpha K theta_0 ln J / J] - theta m_theta A + c0 (theta - theta_0) + what flow stores is work and heat
    from outside, of order two in the step."""
    p, defects = LOSSY.replace(**{"modulus_by_temperature.slope": SLOPE, "theta_air": HOT, "theta_ref": HOT}), []
    for max_strain in (4e-4, 1e-4):
        time, strain = corners((0.0, 0.0), (30.0, 0.02), (40.0, -0.005), (60.0, 0.03), steps=round(0.02 / max_strain))
        found = simulate(p, Programme.by_strain(time, strain), PointSettings(max_strain=1.0))
        free, expanding, _ = strained(found, p)
        whole = free - expanding * (found.theta - HOT)
        elastic = factor(found.theta) * (free + HOT * expanding) - found.theta * factor_slope(found.theta) * whole
        stored = stored_by_flow(found, p)
        work = np.append(0.0, np.cumsum(0.5 * (found.stress[1:] + found.stress[:-1]) * np.diff(found.strain)))
        heat = p["c0"] * (found.theta - found.theta[0]) - found.dissipated - found.thermoelastic
        held = elastic + stored + p["c0"] * (found.theta - HOT)
        defects.append(float(np.abs(held - held[0] - work - heat).max() / work.max()))
    assert defects[0] < 4e-4 and defects[1] < 0.12 * defects[0], defects


def stored_by_flow(found: PointHistory, p: Parameters) -> np.ndarray:
    """(4.5), (4.7) and H_lin Lambda^2 / 2."""
    h = p["H_exp"] * (p["M_yinf"] - p["M_y0"])
    return np.asarray((1.0 - p["beta"]) * p["M_y0"] * found.alpha + 0.5 * h * found.alpha**2 + 0.5 * p["H_lin"] * found.accumulated**2)


@pytest.mark.parametrize("control", ["displacement", "force"])
def test_homogeneous_bar(control: str) -> None:
    """Point and body alike to 1e-8 through loading, unloading and reverse flow, where 5e-3 1/K make the moduli fall by a tenth."""
    time, strain = corners(*CYCLES, steps=6)
    bar_and_point(LOSSY.replace(**{"modulus_by_temperature.slope": 5e-3}), time, strain, 2, control)


def test_homogeneous_bar_with_degradation_and_backstress_beside() -> None:
    time, strain = corners(*CYCLES, steps=6)
    more = {"elastic_degradation.amount": 0.2, "backstress_first.C": 4000.0, "backstress_first.gamma": 100.0}
    bar_and_point(LOSSY.replace(**{"modulus_by_temperature.slope": 5e-3, **more}), time, strain, 1)


NAMES = ("modulus_by_temperature.slope", "E", "nu", "M_y0", "alpha_exp", "c0", "beta", "theta_air", "theta_ref")


@pytest.mark.parametrize("driven", ["strain", "stress"])
def test_remainders_are_of_second_order(driven: str) -> None:
    """Derivatives of stress or strain, temperature and lateral strain along random directions: what is left falls with h^2."""
    base, random = (
        LOSSY.replace(**{"modulus_by_temperature.slope": SLOPE, "theta_air": HOT, "theta_ref": HOT + 3.0}),
        np.random.default_rng(3),
    )
    time, value = corners((0.0, 0.0), (30.0, 0.012), (32.0, 0.006), (60.0, 0.02), steps=20)
    if driven == "stress":
        value = simulate(base, Programme.by_strain(time, value)).stress
    programme = Programme(time, value, np.full(len(time), driven == "stress"))
    start, rates = simulate_rates(base, NAMES, programme)
    for _ in range(3):
        along = np.array([random.choice([-1.0, 1.0]) * abs(base[name]) * (1e-2 if name.startswith("theta") else 0.1) for name in NAMES])
        for channel in ("stress" if driven == "strain" else "strain", "theta", "lateral_x"):
            linear, left = rates[channel] @ along, []
            for h in (4e-3, 2e-3, 1e-3):
                there = simulate(base.replace(**{n: base[n] + h * d for n, d in zip(NAMES, along, strict=True)}), programme)
                left.append(float(np.abs(getattr(there, channel) - getattr(start, channel) - h * linear).max()))
            assert left[2] < 2e-2 * 1e-3 * np.abs(linear).max() and left[1] < 0.3 * left[0] and left[2] < 0.3 * left[1], (channel, left)
