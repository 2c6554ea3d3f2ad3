"""Effects of the law in the point driver: closed forms, the finite element bar, exact derivatives, and exactly off at neutral."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from coupons import CYCLES, LOSSY, SHEET, WHOLE, bar_and_point, corners, cycles, flow_stress_of, ramp
from scipy.integrate import solve_ivp

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Parameters
from thermofit.law.composition import AMPLITUDES, CAPACITIES, EFFECT_PARAMS, capacity_effects, law_effects
from thermofit.point.driver import CHANNELS, PointSettings, Programme, simulate, simulate_rates

PROBES = {p.name: 0.3 * p.probe if p.probe is not None else p.neutral for e in (*law_effects(), *capacity_effects()) for p in e.params}
SWITCHES = (*AMPLITUDES, *CAPACITIES)
SECONDARY = {name: PROBES[name] for name in EFFECT_PARAMS if name not in SWITCHES}
PLAIN = SHEET.replace(F=0.5, alpha_exp=0.0)
PERFECT = PLAIN.replace(M_yinf=PLAIN["M_y0"] * (1.0 + 1e-9), H_exp=1e-3)
FINE = PointSettings(max_strain=0.004)


def test_a_jump_of_the_rate_moves_the_stress_by_c_ln_ratio() -> None:
    C, reference = 0.02, 1e-6
    parameters = PERFECT.replace(**{"rate_logarithmic.C": C, "rate_logarithmic.reference": reference})
    time, strain = corners((0.0, 0.0), (100.0, 0.02), (101.0, 0.03), steps=100)
    found = simulate(parameters, Programme.by_strain(time, strain))
    stress = flow_stress_of(found, parameters)
    rate = np.diff(found.accumulated) / np.diff(time)
    step = parameters["M_y0"] * C * np.log((reference + rate[150]) / (reference + rate[80]))
    assert stress[151] - stress[81] == pytest.approx(step, rel=1e-9)
    assert step == pytest.approx(parameters["M_y0"] * C * np.log(50.0), rel=0.01)


def stretched(parameters: Parameters, hold: float, by_stress: bool) -> tuple[Programme, int]:
    """A fast ramp to 0.4 %, then a hold of the strain, or of the stress reached; and the index where the hold begins."""
    time, strain = ramp(4e-3, 0.004, 100)
    late = time[-1] + hold * np.linspace(0.0, 1.0, 4001)[1:] ** 2
    value = np.append(strain, np.full(len(late), strain[-1]))
    controls = np.zeros(len(value), dtype=bool)
    if by_stress:
        value[len(time) :] = simulate(parameters, Programme.by_strain(time, strain)).stress[-1]
        controls[len(time) :] = True
    return Programme(np.append(time, late), value, controls), len(time) - 1


@pytest.mark.parametrize("m", [1.0, 0.2])
def test_relaxation_in_a_hold(m: float) -> None:
    """Overstress s = K ((1 + r/r0)^m - 1) at constant strain: ds/dt = -E r; for m = 1 it decays exponentially."""
    K, r0 = 20.0, 1e-4
    parameters = PERFECT.replace(**{"rate_power.K": K, "rate_power.m": m, "rate_power.reference": r0})
    hold = 5.0 * K / (parameters["E"] * r0)
    programme, k = stretched(parameters, hold, by_stress=False)
    found = simulate(parameters, programme)
    over = flow_stress_of(found, parameters)[k:] - parameters["M_y0"]
    time = found.time[k:] - found.time[k]
    assert over[0] > (100.0 if m == 1.0 else 10.0)

    def rate_of(_: float, s: np.ndarray) -> np.ndarray:
        return np.asarray(-parameters["E"] * r0 * (np.maximum(1.0 + s / K, 1.0) ** (1.0 / m) - 1.0))

    expected = solve_ivp(rate_of, (0.0, hold), over[:1], t_eval=time, rtol=1e-8, atol=1e-9).y[0]
    assert np.abs(over - expected).max() < 0.02 * over[0]
    if m == 1.0:
        assert np.abs(expected - over[0] * np.exp(-time * 5.0 / hold)).max() < 1e-4 * over[0]
    assert np.all(np.diff(over) <= 1e-9) and over[-1] > -1e-6
    assert np.all(np.diff(found.dissipated) >= -1e-15)


def test_creep_under_constant_stress() -> None:
    """The rate of flow that the overstress stands for, for as long as the stress is held."""
    parameters = PERFECT.replace(**{"rate_power.K": 20.0, "rate_power.m": 0.5, "rate_power.reference": 1e-6})
    programme, k = stretched(parameters, 20.0, by_stress=True)
    found = simulate(parameters, programme)
    over = flow_stress_of(found, parameters) - parameters["M_y0"]
    rate = np.diff(found.accumulated) / np.diff(found.time)
    assert rate[k:] == pytest.approx(1e-6 * ((1.0 + over[k + 1 :] / 20.0) ** 2 - 1.0), rel=1e-6)
    assert found.strain[-1] - found.strain[k] > 1e-4


def test_plateau_has_its_length() -> None:
    """No hardening up to the length, then the hardening of the law, late by the length; before it the excess of the upper yield point."""
    length, upper, drop = 0.012, 15.0, 4e-4
    changes = {"yield_plateau.share": 1.0, "yield_plateau.length": length, "yield_plateau.upper": upper, "yield_plateau.drop": drop}
    time, strain = ramp(1e-3, 0.06, 600)
    found = simulate(PLAIN.replace(**changes), Programme.by_strain(time, strain))
    stress, past = flow_stress_of(found, PLAIN), found.accumulated
    flat = (past > 12.0 * drop) & (past < 0.5 * length)
    assert np.count_nonzero(flat) > 8
    assert stress[flat] == pytest.approx(PLAIN["M_y0"], rel=2e-3)
    late = past > 1.6 * length
    voce = PLAIN["M_yinf"] - (PLAIN["M_yinf"] - PLAIN["M_y0"]) * np.exp(-PLAIN["H_exp"] * (past - length))
    assert stress[late] == pytest.approx(voce[late], rel=2e-3)
    first = int(np.argmax(past > 0.0))
    assert stress[first] == pytest.approx(PLAIN["M_y0"] + upper * np.exp(-past[first] / drop), rel=1e-4)


def test_fast_tests_heat_and_soften() -> None:
    """The yield stress falls by slope times the rise; without loss of heat the fast, with loss the slow test is the stronger."""
    slope = 2e-3
    changes = {"thermal_softening.slope": slope, "thermal_softening.reference": PLAIN["theta_ref"]}
    soft, drive = PLAIN.replace(**changes), ramp(1e-3, 0.08)
    adiabatic, plain = (simulate(p, Programme.by_strain(*drive)) for p in (soft, PLAIN))
    rise = adiabatic.theta - soft["theta_ref"]
    assert rise[-1] > 4.0
    voce = PLAIN["M_yinf"] - (PLAIN["M_yinf"] - PLAIN["M_y0"]) * np.exp(-PLAIN["H_exp"] * adiabatic.accumulated)
    late = adiabatic.accumulated > 0.0
    assert flow_stress_of(adiabatic, soft)[late] == pytest.approx((voce * (1.0 - slope * rise))[late], rel=1e-9)
    assert adiabatic.theta[-1] < plain.theta[-1], "less stress, less heat"
    slow = simulate(soft.replace(tau=50.0), Programme.by_strain(1e4 * drive[0], drive[1]))
    assert slow.stress[-1] == pytest.approx(plain.stress[-1], rel=1e-4)


def test_second_hardening_is_stored_and_rate_dependence_is_heat() -> None:
    """What rate-dependent terms add to the work becomes heat, what hardening terms add is stored."""
    drive = Programme.by_strain(*ramp(1e-2, 0.05))
    plain = simulate(PLAIN, drive)
    harder = simulate(PLAIN.replace(**{"second_hardening.Q": 50.0, "second_hardening.b": 30.0}), drive)
    assert np.interp(0.04, harder.accumulated, harder.dissipated) == pytest.approx(
        np.interp(0.04, plain.accumulated, plain.dissipated), rel=1e-6
    )
    changes = {"rate_power.K": 20.0, "rate_power.m": 0.5, "rate_power.reference": 1e-3}
    viscous = simulate(PLAIN.replace(**changes), drive)
    voce = PLAIN["M_yinf"] - (PLAIN["M_yinf"] - PLAIN["M_y0"]) * np.exp(-PLAIN["H_exp"] * viscous.accumulated)
    extra = (flow_stress_of(viscous, PLAIN) - voce)[1:] * np.diff(viscous.accumulated)
    there = np.interp(viscous.accumulated, plain.accumulated, plain.dissipated)
    grows = viscous.accumulated[1:] > 0.0
    assert (viscous.dissipated - there)[-1] == pytest.approx(extra[grows].sum(), rel=2e-3)


def test_relaxing_overstress_at_turns_needs_no_smaller_steps() -> None:
    """Holds and turns after fast flow, with steep rate laws: no step is cut, and no overstress is left behind that does not relax."""
    for changes in (
        {"rate_power.K": 200.0, "rate_power.m": 0.05, "rate_power.reference": 1e-8},
        {"rate_power.K": 400.0, "rate_power.m": 1.0, "rate_power.reference": 1e-3},
        {"rate_logarithmic.C": 0.05, "rate_logarithmic.reference": 1e-9},
    ):
        time, strain = corners(*CYCLES, (141.0, 0.0299), (142.0, 0.03), (1e4, 0.03), steps=25)
        found = simulate(LOSSY.replace(**changes), Programme.by_strain(time, strain), WHOLE)
        assert found.counts["halvings"] == 0, changes
        assert found.counts["newton_iterations"] < 9 * found.counts["steps"], changes
        assert np.all(np.diff(found.accumulated) >= 0.0)
        hold = slice(4 * 25, 5 * 25 + 1)
        assert found.accumulated[hold][-1] > found.accumulated[hold][0], "it creeps in the hold"


def test_stress_on_a_flat_plateau_cannot_be_carried() -> None:
    """A plateau that softens has no answer to a stress that rises: an error in words, whatever the iteration meets on its way."""
    plateau = {"yield_plateau.share": 1.0, "yield_plateau.length": 0.02, "yield_plateau.upper": 100.0}
    soft = SHEET.replace(**plateau, **{"backstress_first.C": 100.0})
    time = np.linspace(0.0, 10.0, 11)
    with pytest.raises(NumericsError, match="is not reached"):
        simulate(soft, Programme.under_stress(time, np.linspace(0.0, 600.0, 11)))


def resting(rate: float, constant: float, **changes: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, temperature and sensor of a coupon that rests in air which drifts from its own temperature, 290 K."""
    time = 7.0 + np.linspace(0.0, 300.0, 1201)
    parameters = PLAIN.replace(tau=40.0, theta_air=290.0, theta_ref=290.0, **changes)
    drift = {"air_drift.rate": rate, "air_drift.time": constant}
    found = simulate(parameters.replace(**drift), Programme.by_strain(time, np.zeros(len(time)), 290.0))
    return time - time[0], found.theta - 290.0, found.theta_sensor - 290.0


def test_a_coupon_follows_the_air_that_drifts() -> None:
    """tau theta' = b t - theta: theta = b (t - tau (1 - exp(-t / tau))); dying away with T: two exponentials; a sensor lags that."""
    b, tau = 0.01, 40.0
    t, steady, shown = resting(b, 1e7, lag=5.0)
    expected = b * (t - tau * -np.expm1(-t / tau))
    assert steady == pytest.approx(expected, abs=2e-5 * expected[-1])
    assert shown[-1] == pytest.approx(expected[-1] - b * 5.0, abs=1e-4), "long after the start the lag is a delay"
    T = 100.0
    _, dying, _ = resting(b, T)
    expected = b * T * (1.0 - np.exp(-t / tau) - T / (T - tau) * (np.exp(-t / T) - np.exp(-t / tau)))
    assert dying == pytest.approx(expected, abs=2e-5 * expected[-1])


def test_steps_between_samples_share_the_drift_of_the_air() -> None:
    """An interval that is cut into many steps sees the air as it is within it."""
    parameters = PLAIN.replace(tau=40.0, **{"air_drift.rate": 0.02, "air_drift.time": 1e7})
    time, strain = np.array([0.0, 60.0]), np.array([0.0, 1e-3])
    fine = np.linspace(0.0, 1.0, 401)
    whole = simulate(parameters, Programme.by_strain(60.0 * fine, 1e-3 * fine))
    cut = simulate(parameters, Programme.by_strain(time, strain), PointSettings(max_strain=1e-3 / 400.0))
    assert cut.counts["steps"] >= 400
    assert cut.theta[-1] == pytest.approx(whole.theta[-1], abs=1e-6)


def test_heat_capacity_that_changes_with_temperature() -> None:
    """Adiabatic: c0 (x + s x^2 / 2) = Q, x the rise; without heat in a film: -tau ln(x / x_0) - tau s (x - x_0) = t."""
    s, c0 = 4e-3, PLAIN["c0"]
    parameters = PLAIN.replace(theta_ref=PLAIN["theta_air"], **{"capacity_by_temperature.slope": s})
    found = simulate(parameters, Programme.by_strain(*ramp(1e-3, 0.15, 300)))
    rise = found.theta - found.theta[0]
    assert rise[-1] > 5.0
    assert c0 * (rise + 0.5 * s * rise**2) == pytest.approx(found.dissipated, rel=1e-9, abs=1e-10)
    time = np.linspace(0.0, 60.0, 2001)
    cooling = simulate(parameters.replace(tau=40.0), Programme.by_strain(time, np.zeros(len(time)), parameters["theta_air"] + 30.0))
    x = cooling.theta - parameters["theta_air"]
    assert -40.0 * np.log(x / 30.0) - 40.0 * s * (x - 30.0) == pytest.approx(time, abs=1e-4)
    plain = simulate(PLAIN.replace(theta_ref=PLAIN["theta_air"]), Programme.by_strain(*ramp(1e-3, 0.15, 300)))
    assert rise[-1] < 0.995 * (plain.theta[-1] - plain.theta[0])


def test_yield_stress_in_compression() -> None:
    """Perfect plasticity: M_y0 in tension, M_y0 (1 + d) in compression, also on the way back; what is more is heat."""
    d = 0.2
    parameters = PERFECT.replace(**{"tension_compression.difference": d})
    time, strain = corners((0.0, 0.0), (100.0, 0.02), (200.0, -0.02), (300.0, 0.02), steps=100)
    found = simulate(parameters, Programme.by_strain(time, strain))
    stress, limit = flow_stress_of(found, parameters), parameters["M_y0"]
    assert stress[[100, 300]] == pytest.approx(limit, rel=1e-9)
    assert stress[200] == pytest.approx(limit * (1.0 + d), rel=1e-9) and found.stress[200] < 0.0
    late = slice(180, 201)
    heat, flow = np.diff(found.dissipated[late]), np.diff(found.accumulated[late])
    beta = parameters["beta"]
    assert heat / flow == pytest.approx(limit * (beta + d), rel=3e-5)


@pytest.mark.parametrize("control", ["displacement", "force"])
@pytest.mark.parametrize("name", [*(e.amplitude.name for e in law_effects()), "all"])
def test_bar_of_finite_elements(name: str, control: str) -> None:
    """Every effect of the law, and all at once, loaded, unloaded and reversed: stress, strains and temperature of the adiabatic bar are
    those of the point to 1e-8, driven by its end or by the force."""
    on = {
        e.amplitude.name: PROBES[e.amplitude.name] for e in law_effects() if e.amplitude.name in PROBES
    }  # others: of files that tests read
    changes = {**SECONDARY, **(on if name == "all" else {name: 2.0 * PROBES[name]})}
    if control == "force":
        changes["H_lin"] = 900.0  # without it the plateau is flat, and the strain at a given stress not unique
    time, strain = corners(*CYCLES, steps=4)
    bar_and_point(LOSSY.replace(**changes), time, strain, 2, control)


@pytest.mark.parametrize("name", SWITCHES)
def test_neutral_is_exactly_off_and_the_probe_is_visible(name: str) -> None:
    programme = cycles(6)
    plain, off = simulate(LOSSY, programme), simulate(LOSSY.replace(**SECONDARY), programme)
    assert np.array_equal(plain.states, off.states) and plain.counts == off.counts
    there = simulate(LOSSY.replace(**SECONDARY, **{name: PROBES[name]}), programme)
    assert max(np.abs(there.stress - plain.stress).max(), np.abs(there.theta - plain.theta).max()) > 0.01


def _taken(case: str) -> tuple[Programme, Callable[..., Parameters]]:
    """Programme and parameters of a test of derivatives, all effects on."""
    base = LOSSY.replace(theta_ref=296.1, **PROBES)
    if case == "strain":
        return cycles(10), base.replace
    base = base.replace(H_lin=900.0)  # without it the plateau is flat, and the strain at a given stress not unique
    found = simulate(base.replace(M_y0=0.98 * base["M_y0"]), Programme.by_strain(np.linspace(0.0, 60.0, 25), np.linspace(0.0, 0.03, 25)))
    return Programme.under_stress(found.time, found.stress), base.replace


@pytest.mark.parametrize("case", ["strain", "stress"])
@pytest.mark.parametrize("model", [1, 2])
def test_derivatives_with_all_effects_on(case: str, model: int) -> None:
    programme, changed = _taken(case)
    settings = PointSettings(model=model, max_strain=0.004)
    names = (*EFFECT_PARAMS, "E", "M_y0", "H_exp", "beta", "theta_air")
    start, rates = simulate_rates(changed(), names, programme, settings)
    for k, name in enumerate(names):
        size = changed()[name] or 1.0
        h = 1e-2 if name == "theta_air" else 1e-5 * size
        upper, lower = (simulate(changed(**{name: changed()[name] + s * h}), programme, settings) for s in (1.0, -1.0))
        for channel in CHANNELS:
            found = rates[channel][:, k]
            difference = (getattr(upper, channel) - getattr(lower, channel)) / (2.0 * h)
            round_off = 2e-13 * (np.abs(getattr(start, channel)).max() + 1e-3) / h
            assert np.abs(found - difference).max() < 5e-5 * np.abs(found).max() + 20.0 * round_off, (name, channel)


@pytest.mark.parametrize("name", SWITCHES)
def test_influence_of_a_dormant_effect(name: str) -> None:
    """Asked for at a thousandth of the probe, by differences from neutral; one that rests in holds does not flow there without it."""
    programme, h = cycles(10), 0.02 * PROBES[name]
    parameters = LOSSY.replace(**SECONDARY)
    _, rates = simulate_rates(parameters.replace(**{name: 1e-3 * PROBES[name]}), (name,), programme, FINE)
    plain, one, two = (simulate(parameters.replace(**{name: x}), programme, FINE) for x in (0.0, h, 2.0 * h))
    for channel in ("stress", "theta"):
        slope = (4.0 * getattr(one, channel) - 3.0 * getattr(plain, channel) - getattr(two, channel)) / (2.0 * h)
        assert np.abs(slope).max() > 0.0
        assert np.abs(rates[channel][:, 0] - slope).max() < 1e-2 * np.abs(slope).max(), channel
    _, neutral = simulate_rates(parameters, (name,), programme, FINE)
    assert np.abs(neutral["stress"][:, 0]).max() > 0.0
