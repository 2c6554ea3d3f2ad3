"""Programmes of the point driver: control, limits of the heat balance, sensor, cycles, first law, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from coupons import LOSSY, SHEET, WHOLE, corners, cycles

from thermofit.core.errors import NumericsError, StudyError
from thermofit.core.parameters import LAW, Parameters, acting
from thermofit.law.page import internal_energy, law_of
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate, simulate_rates
from thermofit.point.step import ACROSS, ALONG, decay_share


@pytest.mark.parametrize("model", [1, 2])
def test_stress_control_is_the_inverse_of_strain_control(model: int) -> None:
    """The stress of a strain history, prescribed, gives the strain back, and everything else with it."""
    settings = PointSettings(model=model)
    parameters = LOSSY.replace(H_lin=400.0)
    programme = Programme.by_strain(*corners((0.0, 0.0), (30.0, 0.02), (33.0, 0.017), (60.0, 0.04), (70.0, 0.036)))
    first = simulate(parameters, programme, settings)
    again = simulate(parameters, Programme.under_stress(first.time, first.stress), settings)
    for name in ("strain", "lateral_x", "lateral_z", "theta", "theta_sensor", "accumulated", "dissipated"):
        assert getattr(again, name) == pytest.approx(getattr(first, name), rel=1e-8, abs=1e-10), name


def test_mixed_control() -> None:
    """Strain up, then the stress down to zero, then held there: the specimen is free and keeps its plastic strain."""
    time, value = np.array([0.0, 10.0, 20.0, 500.0]), np.array([0.0, 0.03, 0.0, 0.0])
    found = simulate(LOSSY, Programme(time, value, np.array([False, False, True, True])))
    assert found.strain[1] == pytest.approx(0.03) and found.stress[1] > 100.0
    assert found.stress[2:] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert found.strain[2] == pytest.approx(0.03 - found.stress[1] * 1.03 / LOSSY["E"], abs=1e-4)
    shrinks = LOSSY["alpha_exp"] * (found.theta[2] - found.theta[3]) * 1.03
    assert found.strain[2] - found.strain[3] == pytest.approx(shrinks, rel=0.02)


def test_elastic_line() -> None:
    """Small stress without temperature: E along, nu across."""
    found = simulate(SHEET.replace(alpha_exp=0.0), Programme.under_stress(np.array([0.0, 1.0]), np.array([0.0, 0.5])))
    assert found.strain[1] == pytest.approx(0.5 / SHEET["E"], rel=1e-4)
    assert found.lateral_x[1] == pytest.approx(-SHEET["nu"] * found.strain[1], rel=1e-4)
    assert found.lateral_z[1] == found.lateral_x[1]


def test_thermoelastic_cooling_has_the_sign_and_size_of_kelvin() -> None:
    """Elastic tension cools by alpha theta P / c_p, compression warms."""
    capacity = SHEET["c0"] + 9.0 * law_of(SHEET).bulk * SHEET["alpha_exp"] ** 2 * SHEET["theta_ref"]
    for stress in (60.0, -60.0):
        found = simulate(SHEET, Programme.under_stress(*corners((0.0, 0.0), (1.0, stress))))
        kelvin = -SHEET["alpha_exp"] * SHEET["theta_ref"] * stress / capacity
        assert found.theta[-1] - found.theta[0] == pytest.approx(kelvin, rel=5e-3)


def test_adiabatic_and_isothermal_limits() -> None:
    """A long time constant keeps all heat, a short one none; without loss the heat released is stored in c0 dtheta."""
    adiabatic, isothermal = simulate(SHEET, cycles()), simulate(SHEET.replace(tau=1e-3), cycles())
    released = adiabatic.dissipated + adiabatic.thermoelastic
    assert SHEET["c0"] * (adiabatic.theta - adiabatic.theta[0]) == pytest.approx(released, abs=1e-8)
    assert adiabatic.theta.max() - adiabatic.theta[0] > 5.0
    assert np.abs(isothermal.theta - isothermal.theta[0]).max() < 3e-3
    assert isothermal.stress.max() > 150.0


def test_heat_loss_is_exponential_whatever_the_step() -> None:
    """A warm specimen at rest cools by exp(-t/tau), its free expansion taking the share 9 K alpha^2 theta_0 of c_p."""
    parameters = SHEET.replace(tau=50.0, alpha_exp=0.0)
    for steps in (1, 7):
        time = np.linspace(0.0, 120.0, steps + 1)
        found = simulate(parameters, Programme.under_stress(time, np.zeros(len(time)), theta_start=320.0))
        assert found.theta - 296.7 == pytest.approx(23.3 * np.exp(-time / 50.0), rel=1e-12)


def test_mean_of_the_decay_at_its_seam() -> None:
    """(1 - exp(-z))/z by series and by the exponential, on both sides of the change between them."""
    for z in (1e-7, 1e-3, 9.9e-3, 1.1e-2, 0.5, 30.0):
        assert decay_share(z) == pytest.approx(-np.expm1(-z) / z, rel=2e-14), z


def test_constant_heating_under_loss() -> None:
    """Constant dissipation D of model 1 in the plastic range: theta_air + D tau / c0 (1 - exp(-t/tau)), no step error."""
    parameters = SHEET.replace(tau=20.0, alpha_exp=0.0, H_exp=1e-3, M_yinf=SHEET["M_y0"] * (1.0 + 1e-9), F=0.5)
    yields = simulate(parameters, Programme.by_strain(np.array([0.0, 1.0]), np.array([0.0, 0.01])), PointSettings(model=1))
    elastic = yields.strain[1] - np.expm1(yields.accumulated[1])
    time = np.linspace(0.0, 60.0, 5)
    stretch = (1.0 + elastic) * np.exp(1e-3 * time)
    found = simulate(parameters, Programme.by_strain(time, stretch - 1.0, theta_start=296.7), PointSettings(model=1, max_strain=0.05))
    power = np.diff(found.dissipated)[1:] / np.diff(time)[1:]
    assert power == pytest.approx(power[0], rel=2e-3)
    steady = parameters["theta_air"] + power[-1] * 20.0 / parameters["c0"]
    rise = steady - (steady - found.theta[1]) * np.exp(-(time[1:] - time[1]) / 20.0)
    assert found.theta[1:] == pytest.approx(rise, abs=2e-3 * (steady - 296.7))


def test_sensor_follows_a_ramp_with_its_lag() -> None:
    """First order: on a ramp q t the sensor reads q (t - lag (1 - exp(-t/lag))); without lag it reads the specimen."""
    parameters = SHEET.replace(lag=3.0, alpha_exp=0.0, M_y0=1.0, M_yinf=1.0 + 1e-9, H_exp=1e-3, F=0.5)
    time = np.linspace(0.0, 12.0, 5)
    programme = Programme.by_strain(time, np.expm1(0.002 * time))
    found = simulate(parameters, programme, PointSettings(model=1))
    slope = (found.theta[-1] - found.theta[0]) / 12.0
    assert found.theta - found.theta[0] == pytest.approx(slope * time, rel=0.02)
    expected = slope * (time - 3.0 * (1.0 - np.exp(-time / 3.0)))
    assert found.theta_sensor - found.theta[0] == pytest.approx(expected, abs=0.02 * slope)
    prompt = simulate(parameters.replace(lag=0.0), programme, PointSettings(model=1))
    assert np.array_equal(prompt.theta_sensor, prompt.theta) and np.array_equal(prompt.theta, found.theta)


def test_sensor_is_exact_for_straight_temperatures() -> None:
    """The closed form of a first-order lag on the temperature of the history, interval by interval."""
    found = simulate(LOSSY, cycles(3), WHOLE)
    lag, read = LOSSY["lag"], [found.theta[0]]
    for dt, begin, end in zip(np.diff(found.time), found.theta[:-1], found.theta[1:], strict=True):
        slope = (end - begin) / dt
        read.append(end - slope * lag + (read[-1] - begin + slope * lag) * np.exp(-dt / lag))
    assert found.theta_sensor == pytest.approx(read, rel=1e-12)
    assert np.abs(found.theta_sensor - found.theta).max() > 0.1


def test_cycles_harden_isotropically() -> None:
    """Without backstress the elastic range after a reversal is twice the yield stress (mandel stress, tension as compression)."""
    parameters = SHEET.replace(alpha_exp=0.0)
    found = simulate(parameters, Programme.by_strain(*corners((0.0, 0.0), (10.0, 0.02), (30.0, -0.02), steps=400)))
    turn = 400
    limit = abs(found.stress[turn] * (1.0 + found.strain[turn]))
    reverse = turn + int(np.argmax(found.accumulated[turn:] > found.accumulated[turn] + 1e-12))
    mandel = found.stress[reverse] * (1.0 + found.strain[reverse])
    assert mandel == pytest.approx(-limit, rel=5e-3)
    assert np.all(np.diff(found.accumulated) >= 0.0) and np.all(np.diff(found.dissipated) >= 0.0)


def test_steps_do_not_matter_for_the_stress() -> None:
    """Flow is integrated in closed form: one step per interval or many, the same stress; temperature to the order of the scheme."""
    whole, fine = simulate(LOSSY, cycles(4), WHOLE), simulate(LOSSY, cycles(4), PointSettings(max_strain=1e-4))
    assert fine.counts["steps"] > 20 * whole.counts["steps"]
    assert np.abs(whole.stress - fine.stress).max() < 2e-4 * np.abs(fine.stress).max()
    assert np.abs(whole.theta - fine.theta).max() < 0.02 * np.ptp(fine.theta)


def energy_of(found: PointHistory, parameters: Parameters) -> np.ndarray:
    """Internal energy of every state, mJ/mm^3."""
    law = law_of(parameters)
    a, b = found.states[:, ACROSS], found.states[:, ALONG]
    log_j = 2.0 * a + b
    trace = 2.0 * np.exp(2.0 * a) + np.exp(2.0 * b)
    values = zip(trace, log_j, np.exp(log_j), found.theta, found.alpha, found.accumulated, strict=True)
    return np.array([internal_energy(*map(float, v), law) for v in values])


def test_first_law() -> None:
    """Internal energy = work + heat from outside, with order 2 in the step; heat from outside is c0 dtheta less what was released."""
    defects = []
    for max_strain in (4e-4, 1e-4):
        time, strain = corners((0.0, 0.0), (30.0, 0.02), (40.0, 0.005), (60.0, 0.03), steps=round(0.02 / max_strain))
        found = simulate(LOSSY, Programme.by_strain(time, strain), PointSettings(max_strain=1.0))
        work = np.append(0.0, np.cumsum(0.5 * (found.stress[1:] + found.stress[:-1]) * np.diff(found.strain)))
        heat = LOSSY["c0"] * (found.theta - found.theta[0]) - found.dissipated - found.thermoelastic
        energy = energy_of(found, LOSSY)
        assert heat[-1] < -0.05 * work[-1], "heat has left"
        defects.append(float(np.abs(energy - energy[0] - work - heat).max() / work.max()))
    assert defects[0] < 4e-4
    assert defects[1] < 0.12 * defects[0]


def test_start_of_a_record() -> None:
    """A specimen that starts warm is free of stress and counts its strain from there; a first value that is not zero is reached at once."""
    time = np.array([0.0, 1.0, 2.0])
    warm = simulate(SHEET, Programme.by_strain(time, np.array([0.0, 1e-4, 2e-4]), theta_start=310.0))
    assert warm.strain[0] == 0.0 and warm.stress[0] == pytest.approx(0.0, abs=1e-9)
    assert warm.states[0, ALONG] == pytest.approx(13.3 * SHEET["alpha_exp"], rel=0.02)
    assert warm.stress[1] == pytest.approx(1e-4 * SHEET["E"], rel=0.05)
    loaded = simulate(SHEET, Programme.by_strain(time, np.array([1e-4, 1e-4, 2e-4])))
    assert loaded.stress[0] == pytest.approx(1e-4 * SHEET["E"], rel=1e-2)


def test_elastic_settings_never_yield() -> None:
    found = simulate(SHEET, Programme.by_strain(np.array([0.0, 1.0]), np.array([0.0, 0.01])), PointSettings(plastic=False))
    assert found.stress[-1] > 650.0 and found.accumulated[-1] == 0.0


def test_stress_that_cannot_be_carried_names_the_time() -> None:
    time = np.linspace(0.0, 10.0, 11)
    with pytest.raises(NumericsError, match=r"stress 250 MPa at 5 s is not reached"):
        simulate(SHEET, Programme.under_stress(time, 50.0 * time))


@pytest.mark.parametrize(
    ("time", "value", "message"),
    [
        ([0.0], [0.0], "at least two"),
        ([0.0, 1.0, 1.0], [0.0, 0.1, 0.2], "time 1 s follows 1 s"),
        ([0.0, 1.0], [0.0, -1.5], "strain above -1"),
        ([0.0, 1.0], [0.0, float("nan")], "is nan"),
    ],
)
def test_programmes_that_cannot_be_meant(time: list[float], value: list[float], message: str) -> None:
    with pytest.raises(StudyError, match=message):
        simulate(SHEET, Programme.by_strain(np.array(time), np.array(value)))


def test_a_parameter_acts_on_a_point_where_it_says_and_nowhere_else() -> None:
    """Rates of stress and sensor along all base parameters of a coupon that loses heat: without conduction and films, but with its air."""
    names = tuple(p.name for p in LAW)
    rates = simulate_rates(LOSSY.replace(lag=2.0), names, cycles())[1]
    moved = {name for k, name in enumerate(names) for channel in ("stress", "theta_sensor") if np.abs(rates[channel][:, k]).max() > 0.0}
    felt = set(acting("stress", "across", "expansion", "heat", "reference", "coupon"))
    assert all(p.acts for p in LAW) and felt.isdisjoint(set(acting("film", "conduction")) - {"theta_air"})
    assert moved == felt - {"G", "L", "M", "N"}, "Hill's parameters of shear, and of stresses across the load, do not act in tension"
