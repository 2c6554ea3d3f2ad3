"""A law of the rate beyond its data: another form that fits as well lies within what the yield stress at no rate is said to be."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from thermofit.core.errors import NumericsError
from thermofit.core.parameters import Param, Parameters
from thermofit.diagnose.case import Case
from thermofit.diagnose.loop import Closed
from thermofit.diagnose.slowest_rate import doubt_of, reference_of, with_slowest_rate
from thermofit.effects.catalogue import Effect, effect
from thermofit.fit.linear_model import LinearModel
from thermofit.fit.minimise import minimise
from thermofit.fit.problem import Problem
from thermofit.fit.result import FitResult

RATE = np.geomspace(1e-3, 4e-3, 400)
"""Rates of a test, 1/s: the yield stress is seen at no other."""
YIELD, NOISE = 130.0, 0.02
VALUES = {"rate_power.K": 12.0, "rate_power.m": 0.2, "rate_power.reference": 1e-5, "M_y0": 120.0}


def stress(x: np.ndarray) -> np.ndarray:
    """M_y0 + K ((1 + rate / reference)^m - 1), MPa, by (M_y0, K, reference)."""
    return np.asarray(x[0] + x[1] * ((1.0 + RATE / x[2]) ** VALUES["rate_power.m"] - 1.0))


def fitted(free_reference: bool = False) -> FitResult:
    """A power law with its reference rate held, fitted to an arsinh law of 5 MPa over 3e-4 1/s; or with it free, fitted to itself."""
    law = stress(np.array([0.0, 12.0, 1e-5])) if free_reference else 5.0 * np.arcsinh(RATE / 3e-4)
    seen = YIELD + law + NOISE * np.random.default_rng(3).normal(size=RATE.size)
    names = ("M_y0", "rate_power.K", *(("rate_power.reference",) if free_reference else ()))
    n = len(names)

    def whole(x: np.ndarray) -> np.ndarray:
        return np.append(x, 1e-5)[:3]

    def residual(x: np.ndarray) -> np.ndarray:
        return np.asarray((stress(whole(x)) - seen) / NOISE)

    def columns(x: np.ndarray) -> np.ndarray:
        return np.stack([stress(whole(x + 1e-30j * unit)).imag / 1e-30 / NOISE for unit in np.eye(n)], axis=1)

    start, low = np.array([120.0, 12.0, 1e-5])[:n], np.array([0.0, 0.0, 1e-7])[:n]
    problem = Problem(residual, start, low, np.full(n, 1e3), np.array([100.0, 5.0, 1e-5])[:n], names, lambda x: (residual(x), columns(x)))
    fit = minimise(problem)
    jacobian = columns(fit.x)
    spread = LinearModel(fit.residual, jacobian).covariance(names, fit.at_bound)
    return replace(fit, jacobian=jacobian, covariance=spread, sigma=spread.sigma)


def case(parameters: Parameters, fails: str = "") -> Any:
    """A test at these rates, each with as much plastic strain, by a run or as the coupon knows it."""

    def linearised(p: Parameters, names: tuple[str, ...]) -> Any:
        if fails:
            raise NumericsError(fails)
        assert names == ("rate_power.reference",)
        x = np.array([p["M_y0"], p["rate_power.K"], p["rate_power.reference"]], dtype=complex)
        return None, (stress(x + np.array([0.0, 0.0, 1e-30j])).imag / 1e-30 / NOISE)[:, None]

    strain = np.linspace(0.0, 0.1, RATE.size + 1)
    model: Any = SimpleNamespace(linearised=linearised, missing=None)
    made = Case(model, parameters, (), (), frozenset())
    return replace(made, flowing=lambda _: (strain[1:], RATE, np.diff(strain)))


def closed(fit: FitResult, names: tuple[str, ...] = ("rate_power",), fails: str = "") -> Closed:
    parameters = Parameters.of({**VALUES, **dict(zip(fit.names, fit.x.tolist(), strict=True))}, fit.names)
    here: Any = SimpleNamespace(case=case(parameters, fails), problem=SimpleNamespace(model=LinearModel(fit.residual, fit.jacobian)))
    return Closed((), here, here, fit, names, (), None, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("free_reference", [False, True])
def test_another_form_that_fits_as_well_lies_within_the_interval(free_reference: bool) -> None:
    """The yield stress at no rate is megapascals off, its noise makes a thirtieth of that. What the form alone tells is in doubt too."""
    fit = fitted(free_reference)
    found = with_slowest_rate(closed(fit))
    before, after = (float(f.sigma[0]) for f in (fit, found.fit) if f.sigma is not None)
    off = abs(float(fit.x[0]) - YIELD)
    assert free_reference or (off > 30.0 * before and off > 2.0)
    assert off < 2.0 * after
    parameters = found.last.case.parameters
    overstress = stress(np.array([0.0, parameters["rate_power.K"], parameters["rate_power.reference"]]))[int(0.05 * RATE.size)]
    assert np.sqrt(after**2 - before**2) == pytest.approx(0.5 * overstress / np.sqrt(3.0), rel=0.1)
    (said,) = found.remarks
    assert said.startswith("no rate below 0.0011 1/s is in the data, and what rate_power says there rests on its form; intervals hold")
    assert "M_y0 +- " in said


def test_a_slower_flow_makes_it_small() -> None:
    """Where a twentieth of the strain flows so slowly that the law says little, little is in doubt."""
    here = case(Parameters.of(VALUES))
    slow = replace(here, flowing=lambda _: (np.full(3, 0.1), np.array([1e-7, 1e-6, 1e-3]), np.array([0.04, 0.02, 1.0])))
    assert doubt_of(slow, effect("rate_power"), reference_of(effect("rate_power")))[0] == 1e-6  # type: ignore[arg-type]
    less = [doubt_of(one, effect("rate_power"), reference_of(effect("rate_power"))) for one in (slow, here)]  # type: ignore[arg-type]
    over = [12.0 * ((1.0 + r / 1e-5) ** 0.2 - 1.0) for r, _ in less]
    assert over[0] < 0.05 * over[1]
    # Far above the reference rate, ds/d(ln r_0) = -m K (1 + z)^m = -m (s + K): the shift is m K.
    assert less[1][1] == pytest.approx(over[1] / (2.0 * np.sqrt(3.0)) * 1e-5 / (0.2 * 12.0), rel=0.1)


def test_of_a_law_that_is_a_straight_line_another_exponent_tells_the_shift() -> None:
    """K r / r_0: the reference rate does what the amplitude does, and a quotient of two zeros would make any interval endless."""
    line = case(Parameters.of({**VALUES, "rate_power.m": 1.0}))
    reference, m = reference_of(effect("rate_power")), next(p for p in effect("rate_power").exponents if p.name == "rate_power.m")
    assert reference is not None and np.isinf(doubt_of(line, effect("rate_power"), reference)[1])
    assert 0.0 < doubt_of(line, effect("rate_power"), m)[1] < 10.0
    asked = []

    def linearised(p: Parameters, names: tuple[str, ...]) -> Any:
        asked.append(names)
        z = RATE / 1e-5
        return None, (p["rate_power.K"] * (1.0 + z) * np.log1p(z) / NOISE)[:, None]

    fit = fitted()
    z = RATE / 1e-5
    straight = replace(fit, jacobian=np.column_stack([np.ones(RATE.size), z]) / NOISE)
    found = closed(straight)
    at = found.last.case.parameters.replace(**{"rate_power.m": 1.0})
    there: Any = SimpleNamespace(
        case=replace(line, parameters=at, model=SimpleNamespace(linearised=linearised, missing=None)),
        problem=SimpleNamespace(model=LinearModel(straight.residual, straight.jacobian)),
    )
    wider = with_slowest_rate(replace(found, last=there)).fit
    assert asked == [("rate_power.m",)] and wider.sigma is not None and fit.sigma is not None
    overstress = at["rate_power.K"] * float(z[int(0.05 * RATE.size)])
    assert np.sqrt(float(wider.sigma[0]) ** 2 - float(fit.sigma[0]) ** 2) == pytest.approx(0.5 * overstress / np.sqrt(3.0), rel=0.1)


def test_coupons_know_their_flow_without_a_run() -> None:
    """Increments of the plastic strain, none where the next record begins."""
    terms = SimpleNamespace(
        yield_variables=lambda _, name: {
            "accumulated plastic strain": np.array([0.01, 0.03, 0.02, 0.05]),
            "plastic strain rate": np.log([1e-4, 1e-3, 1e-4, 1e-2]),
            "temperature": np.full(4, 300.0),
        }[name]
    )
    model: Any = SimpleNamespace(missing=SimpleNamespace(of_yield=terms))
    _, rate, theta, grown = Case(model, Parameters.of({}), (), (), frozenset()).flows()
    assert rate == pytest.approx([1e-4, 1e-3, 1e-4, 1e-2]) and np.all(theta == 300.0)
    assert grown == pytest.approx([0.01, 0.02, 0.0, 0.03])


def test_what_cannot_be_told_is_said() -> None:
    fit = fitted()
    failed = with_slowest_rate(closed(fit, fails="no equilibrium"))
    (said,) = failed.remarks
    assert said == "what rate_power says below the slowest rate of the test counts as exact: a run for it failed (no equilibrium)"
    assert failed.fit is fit
    other = closed(fit, ("thermal_softening",))
    assert with_slowest_rate(other) is other
    assert reference_of(effect("thermal_softening")) is None


def test_a_law_of_a_user_without_a_reference_rate_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from thermofit.diagnose import slowest_rate

    own = Effect(
        "own_rate",
        "yield_stress",
        (Param("own_rate.a", "MPa", 0.0, 0.0, 10.0, 1.0, "amplitude", probe=1.0),),
        "sigma_y += a rate",
        "a test",
        lambda accumulated, rate, theta, law, a: a * rate,
    )
    monkeypatch.setattr(slowest_rate, "effect", lambda _: own)
    monkeypatch.setattr(Effect, "is_on", lambda *_: True)
    (said,) = with_slowest_rate(closed(fitted(), ("own_rate",))).remarks
    assert said == "own_rate has no reference rate: intervals hold nothing of what its form says below the slowest rate of the test"
