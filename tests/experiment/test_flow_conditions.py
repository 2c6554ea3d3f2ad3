"""Rates and temperatures at which records flow, as measured, and which effects are asked by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermofit.core.parameters import Parameters
from thermofit.diagnose.case import untold
from thermofit.effects.catalogue import Effect
from thermofit.experiment.coupon_records import CouponTest, whole
from thermofit.experiment.flow_conditions import FlowConditions, flow_conditions
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
    t, e = np.array(time), np.array(strain) + NOISE["strain"] * RNG.normal(size=len(time))
    bare = CouponTest(name, t, e, 0.0 * t, np.full(len(t), theta), theta, theta, NOISE, whole(t))
    found = history_of(bare)
    return replace(bare, stress=found.stress + NOISE["stress"] * RNG.normal(size=len(t)))


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
    assert conditions(slow, replace(slow, name="b")).one_rate and conditions(slow).span == 0.0
    assert conditions(slow, replace(fast, theta=None)).span == pytest.approx(0.0, abs=0.1), "not measured: the model's own temperature"


def test_a_record_that_does_not_flow_has_one_rate() -> None:
    found = conditions(record((0.001, 1e-3, 60)))
    assert found.rows == 0 and found.one_rate and found.span == 0.0


def names(known: tuple[Effect, ...]) -> set[str]:
    return {e.name for e in known}


def test_effects_are_asked_by_what_the_records_hold() -> None:
    """Rate effects only with more than one rate, what grows with temperature only with temperatures far apart; the reasons are said. One
    that the study switches on or frees is not dormant, and stays."""
    every = effects_of_point(sensor=True)
    rates, spans = {"rate_logarithmic", "rate_power", "rate_by_temperature"}, {"rate_by_temperature", "softening_power"}
    at = {
        "neither": FlowConditions((1e-3, 1.2e-3), (293.0, 296.0), 400),
        "rates": FlowConditions((1e-3, 1e-1), (293.0, 296.0), 400),
        "temperatures": FlowConditions((1e-3, 1e-3), (293.0, 400.0), 400),
        "both": FlowConditions((1e-3, 1e-1), (293.0, 400.0), 400),
    }
    left = {"neither": rates | spans, "rates": spans, "temperatures": rates, "both": set()}
    for case, there in at.items():
        known, said = untold(every, STEEL, there)
        assert names(every) - names(known) == left[case], case
        assert len(said) == {"neither": 2, "rates": 1, "temperatures": 1, "both": 0}[case]
    _, said = untold(every, STEEL, at["neither"])
    assert said[0].startswith("not asked for rate_logarithmic, rate_power") or said[0].startswith("not asked for rate_power, rate_log")
    assert "0.001 to 0.0012 1/s" in said[0] and "293 to 296 K" in said[1]
    on = STEEL.replace(**{"rate_logarithmic.C": 0.01})
    freed = STEEL.with_free(("rate_power.K",))
    assert "rate_logarithmic" in names(untold(every, on, at["neither"])[0])
    assert "rate_power" in names(untold(every, freed, at["neither"])[0])
