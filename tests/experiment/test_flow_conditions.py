"""Rates and temperatures at which records flow, as measured, and which effects are asked by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import not_identifiable
from thermofit.effects.catalogue import Effect, effect
from thermofit.experiment.coupon_records import CouponTest, whole
from thermofit.experiment.flow_conditions import (
    KNEE,
    ONE_TEMPERATURE,
    FlowConditions,
    by_strain,
    flow_conditions,
    flow_since_turn,
    warmer_at_strain,
)
from thermofit.experiment.known_effects import effects_of_point
from thermofit.point.driver import PointHistory, PointSettings, Programme, simulate

STEEL = Parameters.of(
    {"E": 200e3, "nu": 0.3, "M_y0": 300.0, "M_yinf": 500.0, "H_exp": 20.0, "tau": 1e-3, "theta_air": 293.0, "theta_ref": 293.0}
)
RNG = np.random.default_rng(3)
NOISE = {"strain": 2e-6, "stress": 0.3}


def record(*legs: tuple[float, float, int], theta: float = 293.0, name: str = "a") -> CouponTest:
    """Strain from zero through legs (strain at the end, 1/s (of a hold: s), samples), with noise; stress and temperature of the law."""
    time, strain = [0.0], [0.0]
    for end, rate, n in legs:
        seconds = rate if end == strain[-1] else abs(end - strain[-1]) / rate
        t0, e0 = time[-1], strain[-1]
        share = np.arange(1, n + 1) / n
        time += (t0 + seconds * share).tolist()
        strain += (e0 + (end - e0) * share).tolist()
    return measured(np.array(time), np.array(strain), theta, name)


def measured(t: np.ndarray, strain: np.ndarray, theta: float = 293.0, name: str = "a") -> CouponTest:
    """The record of a strain (n,) at times (n,) s, with noise; stress and temperature of the law."""
    e = strain + NOISE["strain"] * RNG.normal(size=len(t))
    bare = CouponTest(name, t, e, 0.0 * t, np.full(len(t), theta), theta, theta, NOISE, whole(t))
    found = history_of(bare)
    return replace(bare, stress=found.stress + NOISE["stress"] * RNG.normal(size=len(t)))


def by_crosshead(rate: float, name: str = "a") -> CouponTest:
    """Tension at 0.27 of a rate while elastic, which grows to 1.5 times that rate at a strain of 0.06: a soft machine."""
    strain = np.linspace(0.0, 0.06, 600)
    own = rate * (0.27 + 1.23 * np.maximum(strain - 0.0015, 0.0) / 0.0585)
    return measured(np.append(0.0, np.cumsum(np.diff(strain) / own[1:])), strain, name=name)


def history_of(test: CouponTest) -> PointHistory:
    return simulate(STEEL, Programme.by_strain(test.time, test.strain), PointSettings(model=1))


def conditions(*tests: CouponTest) -> FlowConditions:
    return flow_conditions(tests, history_of)


@pytest.mark.parametrize(
    ("legs", "one", "low", "high"),
    [
        ([(0.05, 1e-3, 500)], True, 1e-3, 1e-3),
        ([(0.03, 1e-3, 300), (0.05, 1e-2, 200)], False, 1e-3, 1e-2),
        ([(0.03, 1e-3, 300), (0.05, 1.5e-3, 200)], True, 1e-3, 1.5e-3),
        ([(0.04, 1e-3, 485), (0.0404, 1e-2, 15)], True, 1e-3, 1e-3),
        ([(0.0012, 1e-4, 60), (0.05, 1e-3, 500)], True, 1e-3, 1e-3),
        ([(0.03, 1e-3, 300), (0.03, 60.0, 60), (0.05, 1e-3, 200)], False, 0.0, 1e-3),
        ([(0.03, 1e-3, 300), (0.029, 1e-3, 30), (0.029, 60.0, 60), (0.05, 1e-3, 200)], True, 1e-3, 1e-3),
    ],
    ids=["one", "jump", "small jump", "few rows", "slow while elastic", "hold in flow", "hold below yield"],
)
def test_rates_are_measured_where_the_record_flows(legs: list[tuple[float, float, int]], one: bool, low: float, high: float) -> None:
    found = conditions(record(*legs))
    assert found.one_rate is one
    assert found.rates == pytest.approx((low, high), rel=0.25, abs=1e-9)
    assert found.rows > 200


def test_records_at_different_rates_and_temperatures() -> None:
    slow, fast = record((0.05, 1e-4, 300)), record((0.05, 1e-2, 300), name="b", theta=400.0)
    both = conditions(slow, fast)
    assert not both.one_rate and both.rates == pytest.approx((1e-4, 1e-2), rel=0.02) and both.span == pytest.approx(107.0)
    assert conditions(slow, replace(slow, name="b")).one_rate and conditions(slow).span == pytest.approx(0.0, abs=1e-9)
    assert conditions(slow, replace(fast, theta=None)).span == pytest.approx(107.0), "not measured: as declared"
    assert not conditions(slow, replace(slow, name="b", theta_start=297.0)).tells(0.0), "two rooms"


def test_a_record_that_does_not_flow_has_one_rate() -> None:
    found = conditions(record((0.001, 1e-3, 60)))
    assert found.rows == 0 and found.one_rate and found.span == 0.0 and found.apart == 1.0


def test_a_rate_that_drifts_with_the_strain_is_one() -> None:
    """Although it changes by a factor of three: at each strain there is one. Two bars of one machine alike; at another speed they tell."""
    found = conditions(by_crosshead(1e-3))
    assert found.rates[1] > 3.0 * found.rates[0] and found.apart == pytest.approx(1.2, abs=0.1) and found.one_rate
    assert conditions(by_crosshead(1e-3), by_crosshead(1.1e-3, "b")).one_rate
    apart = conditions(by_crosshead(1e-3), by_crosshead(4e-3, "b")).apart
    assert 4.0 < apart < 6.0


def test_unloadings_begin_no_new_strain() -> None:
    """A drifting rate is no other one at the same strain after an unloading that stays elastic."""
    pull = by_crosshead(1e-3)
    k = [200, 400]
    time, strain = [pull.time[:1]], [pull.strain[:1]]
    for a, b in ((1, k[0]), (k[0], k[1]), (k[1], 600)):
        time.append(pull.time[a:b] - pull.time[a - 1] + time[-1][-1])
        strain.append(pull.strain[a:b])
        if b < 600:
            down = np.concatenate([np.linspace(0.0, -0.001, 31)[1:], np.linspace(-0.001, 0.0, 31)[1:]])
            time.append(time[-1][-1] + np.arange(1, 61) * 0.1)
            strain.append(strain[-1][-1] + down)
    found = conditions(measured(np.concatenate(time), np.concatenate(strain)))
    assert found.rates[1] > 2.5 * found.rates[0] and found.one_rate


def cycles(quickly: float = 1.0) -> CouponTest:
    """Two cycles of a sine of amplitude 0.012 and 10 s, the second that many times as fast."""
    part = np.linspace(0.0, 10.0, 401)
    time = np.concatenate([part, 10.0 + part[1:] / quickly])
    return measured(time, 0.012 * np.sin(2.0 * np.pi * np.concatenate([part, part[1:]]) / 10.0))


def test_a_sine_has_one_rate_and_two_of_them_have_two() -> None:
    """It slows down before it turns, in the first quarter at other plastic strains than later: none of that counts."""
    one = conditions(cycles())
    assert one.rates[1] > 4.0 * one.rates[0] and one.one_rate
    assert 4.0 < conditions(cycles(5.0)).apart < 10.0


@pytest.mark.parametrize(("knee", "one"), [(1.0, True), (4.0, False)])
def test_rates_at_the_knee_after_a_turn_do_not_count(knee: float, one: bool) -> None:
    """A rate that is five times as high up to KNEE, or some knees, after yield in one branch and not in the others."""
    elastic = 2 * 310.0 / 200e3
    at = 0.02 - elastic - 0.8 * knee * KNEE
    legs = [(0.02, 1e-3, 200), (at, 5e-3, 200), (-0.02, 1e-3, 200), (0.02, 1e-3, 400)]
    found = conditions(record(*legs))
    assert found.rates[1] > 3.0 * found.rates[0] and found.one_rate is one


def test_rates_are_compared_at_the_same_strain_from_the_knee_on() -> None:
    """By hand: from KNEE on, within SMOOTH, and of each record without the twentieth part at either end."""
    strain, rate = np.array([0.01, 0.01, 0.01, 0.012, 0.012, 0.012]), np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])
    assert by_strain([strain], [rate]) == 3.0
    assert by_strain([strain * [1, 1, 1, 2, 2, 2]], [rate]) == 1.0, "0.01 and 0.024 are two strains"
    assert by_strain([0.16 * strain], [rate]) == 1.0, "within the knee"
    assert by_strain([np.where(rate > 1.0, np.nan, strain)], [rate]) == 1.0
    assert by_strain([np.zeros(0)], [np.zeros(0)]) == 1.0 and by_strain([], []) == 1.0


@pytest.mark.parametrize(("fast", "apart"), [(1, 1.0), (2, 1.0), (3, 1.0), (4, 3.0)])
def test_few_rows_of_a_record_are_no_rate_of_it(fast: int, apart: float) -> None:
    """Of sixty; another record with one row at the strain has its rate there."""
    rate = np.array([3.0] * fast + [1.0] * (60 - fast))
    assert by_strain([np.full(60, 0.01)], [rate]) == apart
    assert by_strain([np.full(60, 0.01), np.array([0.011])], [np.ones(60), np.array([3.0])]) == 3.0
    assert by_strain([np.full(10, 0.01)], [np.array([1.0] * 8 + [3.0] * 2)]) == 1.0, "nor is a single window"


def test_strain_of_flow_counts_from_where_the_flow_turned() -> None:
    """Not from an unloading, and not where the strain is about to turn."""
    test = record((0.02, 1e-3, 200), (0.019, 1e-3, 20), (0.04, 1e-3, 200), (0.0, 1e-3, 400))
    history = history_of(test)
    found, at = flow_since_turn(test, history), history.accumulated
    assert found[120] == at[120] and found[300] == at[300] and found[600] == pytest.approx(at[600] - at[420])
    about = np.isnan(found)
    assert about[151:201].all() and not about[60:149].any() and about[370:421].all() and not about[280:367].any()
    assert about[30] and about[245] and about[440] and not about[500:].any(), "after each yield; the last branch ends where the record does"


def warming(kelvin: float, told: bool = True, name: str = "a", start: float = 293.0) -> CouponTest:
    """Tension to a strain of 0.1 that warms by so much, by a sensor or by the model alone: its capacity is that small."""
    test = record((0.1, 1e-3, 500), theta=start, name=name)
    heat = kelvin * np.maximum(test.strain - 0.002, 0.0) / 0.098
    return replace(test, theta=start + heat if told else None)


def heated(test: CouponTest) -> PointHistory:
    """The history of a coupon that keeps its heat."""
    own = STEEL.replace(tau=1e6, c0=1.0, beta=0.9, theta_air=test.theta_start, theta_ref=test.theta_start)
    return simulate(own, Programme.by_strain(test.time, test.strain, test.theta_start), PointSettings(model=1))


def test_a_heating_that_is_computed_tells_no_softening() -> None:
    """It is the law's own and a function of the strain; one that a sensor shows is that too, and tells beside a record that stays cold."""
    cold, hot = (replace(warming(0.0, told=False), name=n) for n in "ab")
    found = flow_conditions([cold, hot], heated)
    assert found.computed > 20.0 and found.span < 1e-9 and not found.tells(0.0)
    alone = conditions(warming(40.0))
    assert alone.temperatures[1] - alone.temperatures[0] > 30.0 and alone.span < 1.0 and not alone.tells(0.0) and alone.computed == 0.0
    both = conditions(warming(40.0), warming(0.0, name="b"))
    assert both.span == pytest.approx(40.0, abs=5.0) and both.tells(0.0) and not both.tells(50.0)
    assert conditions(warming(40.0), warming(0.0, told=False, name="b")).tells(0.0), "as declared, a record beside"
    assert conditions(warming(0.0, told=False), warming(0.0, told=False, name="b", start=393.0)).tells(50.0)


def test_a_rest_in_which_a_record_cools_tells_temperature() -> None:
    """At the strain of the rest there are two temperatures; by less than ONE_TEMPERATURE they are one."""
    test = record((0.04, 1e-3, 300), (0.039, 1e-3, 20), (0.039, 300.0, 60), (0.08, 1e-3, 300))
    for fall, tells in ((2.0, False), (20.0, True)):
        theta = 293.0 + 500.0 * np.maximum(test.strain, 0.0) - fall * (test.time > test.time[340])
        found = conditions(replace(test, theta=theta))
        assert found.span == pytest.approx(fall, abs=1.0) and found.tells(0.0) is tells


def test_temperatures_are_compared_at_the_same_strain_from_the_knee_on() -> None:
    """By hand: within SMOOTH, without the line that a record follows, its first and last rows, and the knee."""
    at = np.linspace(0.010, 0.012, 60)
    assert warmer_at_strain([at, at], [np.full(60, 300.0), np.full(60, 310.0)]) == pytest.approx(10.0)
    assert warmer_at_strain([at, 2.0 * at], [np.full(60, 300.0), np.full(60, 310.0)]) == pytest.approx(0.0, abs=1e-9)
    assert warmer_at_strain([0.1 * at, 0.1 * at], [np.full(60, 300.0), np.full(60, 310.0)]) == 0.0, "within the knee"
    assert warmer_at_strain([at], [300.0 + 1e4 * (at - 0.01)]) == pytest.approx(0.0, abs=1e-9), "a drift along the strain"
    few = np.where(np.arange(60) < 3, 350.0, 300.0)
    assert warmer_at_strain([np.full(60, 0.011)], [few]) == 0.0 and warmer_at_strain([], []) == 0.0


@pytest.mark.parametrize(
    ("legs", "unloads"),
    [
        ([(0.05, 1e-3, 300)], False),
        ([(0.04, 1e-3, 300), (0.0395, 1e-3, 30), (0.05, 1e-3, 60)], False),
        ([(0.04, 1e-3, 300), (0.0385, 1e-3, 30), (0.05, 1e-3, 60)], True),
        ([(0.04, 1e-3, 300), (0.0385, 1e-3, 4), (0.05, 1e-3, 10)], False),
        ([(0.001, 1e-3, 60), (0.0, 1e-3, 60), (0.05, 1e-3, 300)], False),
        ([(0.02, 1e-3, 200), (-0.02, 1e-3, 400)], True),
    ],
    ids=["monotonic", "by a fifth", "unloads", "few rows", "before flow", "reversed"],
)
def test_elasticity_after_flow_is_seen_where_a_record_unloads(legs: list[tuple[float, float, int]], unloads: bool) -> None:
    found = conditions(record(*legs), record((0.05, 1e-3, 300), name="b"))
    assert found.unloads is unloads
    known, said = not_identifiable(effects_of_point(sensor=False), STEEL, replace(found, apart=100.0, span=107.0))
    assert ("elastic_degradation" in names(known)) is unloads and len(said) == 1 + int(not unloads)
    assert unloads or said[0].startswith("not asked for elastic_degradation: no record unloads after flow")
    assert "elastic_degradation" in names(
        not_identifiable(effects_of_point(sensor=False), STEEL.with_free(("elastic_degradation.amount",)), found)[0]
    )


def names(known: tuple[Effect, ...]) -> set[str]:
    return {e.name for e in known}


APART = 50.0
"""K; span that the effect of the temperature on the moduli declares."""


@pytest.mark.parametrize(
    ("thetas", "curves", "asked"),
    [((293.0, 293.0), False, False), ((293.0, 340.0), False, False), ((293.0, 346.0), False, True), ((293.0, 500.0), True, False)],
    ids=["alike", "near", "apart", "without elastic ranges"],
)
def test_moduli_over_temperature_need_elastic_ranges_apart(thetas: tuple[float, float], curves: bool, asked: bool) -> None:
    """First loadings at temperatures further apart than SPAN; flow curves over plastic strain hold none, whatever their temperatures."""
    tests = [replace(record((0.05, 1e-3, 3000), theta=t, name=str(t)), over_plastic=curves) for t in thetas]
    found = conditions(*tests)
    assert effect("modulus_by_temperature").span == APART
    if not curves:
        assert found.elastic == pytest.approx(thetas)
    known, said = not_identifiable(effects_of_point(sensor=False), STEEL, replace(found, apart=100.0, span=107.0, unloads=True))
    assert ("modulus_by_temperature" in names(known)) is asked
    if not asked:
        where = "are not seen in any record" if curves else f"lie at {thetas[0]:.0f} to {thetas[1]:.0f} K"
        assert said[0].startswith(f"not asked for modulus_by_temperature: elastic ranges {where}, expected more than 50 K apart")
    assert "modulus_by_temperature" in names(
        not_identifiable(effects_of_point(sensor=False), STEEL.with_free(("modulus_by_temperature.slope",)), found)[0]
    )


def test_an_unloading_after_flow_shows_the_modulus_as_well() -> None:
    """Of a record without a first line, and at the mean of what its sensor shows."""
    back = record((0.04, 1e-3, 300), (0.0385, 1e-3, 30), (0.05, 1e-3, 60))
    hot = replace(back, over_plastic=True, theta=np.full(len(back.time), 400.0), name="hot")
    assert conditions(record((0.05, 1e-3, 3000)), hot).elastic[1] == pytest.approx(400.0)


def test_effects_are_asked_by_what_the_records_hold() -> None:
    """Rate effects only with more than one rate, what grows with temperature only with temperatures far apart; the reasons are said. One
    that the study switches on or frees is not dormant, and stays."""
    every = effects_of_point(sensor=True)
    rates, spans = {"rate_logarithmic", "rate_power", "rate_by_temperature"}, {"rate_by_temperature", "softening_power"}
    at = {
        "neither": FlowConditions((1e-3, 1.2e-3), (293.0, 296.0), 400, 1.2, 0.0, 20.0),
        "rates": FlowConditions((1e-3, 1e-1), (293.0, 400.0), 400, 100.0, ONE_TEMPERATURE, 0.0),
        "some kelvins": FlowConditions((1e-3, 1e-1), (293.0, 300.0), 400, 100.0, ONE_TEMPERATURE + 1.0, 0.0),
        "temperatures": FlowConditions((1e-3, 3e-3), (293.0, 400.0), 400, 1.4, 107.0, 0.0),
        "both": FlowConditions((1e-3, 1e-1), (293.0, 400.0), 400, 100.0, 107.0, 0.0),
    }
    some = spans | {"thermal_softening"}
    at = {case: replace(there, elastic=(293.0, 400.0)) for case, there in at.items()}
    left = {"neither": rates | some, "rates": some, "some kelvins": spans, "temperatures": rates, "both": set()}
    for case, there in at.items():
        known, said = not_identifiable(every, STEEL, there)
        assert names(every) - names(known) == left[case], case
        assert len(said) == {"neither": 2, "rates": 1, "some kelvins": 1, "temperatures": 1, "both": 0}[case]
    _, said = not_identifiable(every, STEEL, at["neither"])
    assert said[0].startswith("not asked for rate_logarithmic, rate_power") or said[0].startswith("not asked for rate_power, rate_log")
    assert "0.001 to 0.0012 1/s in all, a factor of 1.2 at the same strain" in said[0] and "293 to 296 K, 0 K apart" in said[1]
    assert "; 20 K of self-heating are computed, not measured" in said[1] and "expected more than 5 K" in said[1]
    assert "are computed" not in not_identifiable(every, STEEL, at["rates"])[1][0]
    on = STEEL.replace(**{"rate_logarithmic.C": 0.01})
    freed = STEEL.with_free(("rate_power.K",))
    assert "rate_logarithmic" in names(not_identifiable(every, on, at["neither"])[0])
    assert "rate_power" in names(not_identifiable(every, freed, at["neither"])[0])
    assert "thermal_softening" in names(not_identifiable(every, STEEL.with_free(("thermal_softening.slope",)), at["neither"])[0])
